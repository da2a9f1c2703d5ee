"""Outdoor scene before an infrared imager: its radiance, and the imager's level and span for it."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.camera.thermal_imager import KELVIN, ThermalImager
from simulate.outdoor_rendering import PREVIEW_PX
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.thermal.infrared_picture import InfraredPicture
from simulate.thermal.infrared_rendering import infrared_radiance
from simulate.thermal.temperatures import Temperatures

# Spans to which an imager may be set, K, and percentiles of the surfaces that shall lie within.
SPANS_K = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
INSIDE = (2.0, 98.0)


@dataclass(frozen=True, kw_only=True)
class InfraredView:
    """Infrared image of an outdoor scene for one imager.

    Parameters
    ----------
    picture
        Radiance in bins, its error, and the truth of each pixel.
    camera
        The imager, its level and span set for the scene.
    viewpoint
        Pose and pixels.
    temperatures
        Surface temperatures of the scene, for further sensors.
    title
        What it shows, and when.
    set_for_scene
        Notes on level and span, of an imager that has them, and on materials.
    """

    picture: InfraredPicture
    camera: ThermalImager
    viewpoint: Viewpoint
    temperatures: Temperatures
    title: str
    set_for_scene: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def netd_mk(self) -> float:
        """Noise-equivalent temperature difference of a pixel, mK."""
        return 1e3 * self.camera.netd_k()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user of the frames."""
        names = ", ".join(effect.name for effect in self.picture.left_out)
        neglected_note = (
            f"infrared radiance without: {names}; see light; the truth of each pixel is in "
            f"truth, next to the frames"
        )
        return (neglected_note, *self.picture.notes, *self.set_for_scene)

    def text(self) -> str:
        """Return retained and neglected terms of temperatures and radiance, as lines."""
        solution = self.temperatures.solution
        rows = [(effect, "kept") for effect in solution.effects]
        rows += [(effect, "left out") for effect in solution.left_out]
        rows.sort(key=lambda row: -row[0].influence)
        lines = [
            (
                f"{'term of surface temperatures':58}  {'changes at most, mK':>20}  "
                f"{'times the NETD':>14}"
            )
        ]
        lines += [
            (
                f"{effect.name:58}  {effect.influence:20.3g}  "
                f"{effect.influence / self.netd_mk:14.2g}  {verdict}"
            )
            for effect, verdict in rows
        ]
        return "\n".join((*lines, "", self.picture.text(self.netd_mk)))

    def document(self) -> bytes:
        """Return retained and neglected terms as JSON."""
        solution, picture = self.temperatures.solution, self.picture
        tables = {
            "temperatures": (solution.effects, solution.left_out),
            "radiance": (picture.effects, picture.left_out),
        }
        effects_of_table: dict[str, Any] = {
            name: [
                {**_row(effect), "kept": is_kept}
                for is_kept, effect_list in zip((True, False), effects, strict=True)
                for effect in effect_list
            ]
            for name, effects in tables.items()
        }
        numbers = {
            "netd_mk": self.netd_mk,
            "by_chance_mk": 1e3 * picture.error_k,
            "rays": list(picture.rays),
        }
        return json.dumps(numbers | effects_of_table, indent=1).encode()

    @property
    def signal(self) -> NDArray[np.floating]:
        """Signal of the imager's cells, shape (row, col)."""
        return self.camera.signal(self.picture.radiance, self.picture.edges_um)


def _row(effect: Any) -> dict[str, Any]:
    effect_fields = asdict(effect)
    return {"name": effect_fields["name"], "changes_mk": effect_fields["influence"]}


def view_infrared(
    scene: OutdoorScene,
    camera: ThermalImager,
    temperatures: Temperatures,
    *,
    tolerance: float | None,
    seed: int,
    preview: bool = False,
    is_set: bool = False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> InfraredView:
    """Return the infrared image of a scene for an imager in the place of the scene's camera.

    Parameters
    ----------
    scene, camera
        The scene and the imager.
    temperatures
        Surface temperatures of the scene.
    tolerance
        What terms left out may change together, as a fraction of the imager's noise; None: none is
        left out.
    seed
        Seed of the rays.
    preview
        Few pixels, so that it takes seconds.
    is_set
        Whether level and span of the imager stay as they are.
    progress
        Called with the fraction done.
    """
    pose = scene.camera
    axis = np.subtract(pose.look_at_m, pose.position_m)
    forward = tuple((axis / np.linalg.norm(axis)).tolist())
    viewpoint = replace(camera.viewpoint(pose.position_m, forward), roll_deg=pose.roll_deg)
    if preview:
        viewpoint = viewpoint.smaller(max(1, round(max(viewpoint.shape) / PREVIEW_PX)))
    picture = infrared_radiance(
        temperatures,
        scene,
        viewpoint,
        band_um=camera.band_um,
        netd_k=camera.netd_k(),
        tolerance=tolerance,
        seed=seed,
        progress=progress,
    )
    camera, note = (camera, ()) if is_set else _set_for_scene(camera, picture)
    low, high = camera.band_um
    moment = temperatures.balance.weather.moment.isoformat(sep=" ", timespec="minutes")
    return InfraredView(
        picture=picture,
        camera=camera,
        viewpoint=viewpoint,
        temperatures=temperatures,
        title=f"{scene.name}, {moment}, {low:g} to {high:g} um",
        set_for_scene=(*note, *(surface.note for surface in scene.material if surface.note)),
    )


def _set_for_scene(
    camera: ThermalImager, picture: InfraredPicture
) -> tuple[ThermalImager, tuple[str, ...]]:
    """Set level and span of an imager that has them so that surfaces lie within, as an operator
    would.
    """
    set_span_k = camera.description.span_k
    if set_span_k is None:
        return camera, ()
    celsius = picture.apparent_k() - KELVIN
    surface = celsius[np.isfinite(picture.truth.temperature_k)]
    low, high = np.percentile(surface if surface.size else celsius, INSIDE)
    span = next((step for step in SPANS_K if step >= max(set_span_k, high - low)), SPANS_K[-1])
    level = float(np.round(0.5 * (low + high)))
    return camera.with_span(level, span), (
        f"level {level:g} C and span {span:g} K set for the surfaces of the scene",
    )
