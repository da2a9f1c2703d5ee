"""Outdoor scene before a camera: choice of render settings from the camera's noise, and
rendering.
"""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labdata import BadInput, Conditions
from simulate.camera import tube_photometry
from simulate.camera.camera import CameraModel
from simulate.camera.chain import Slot
from simulate.camera.effect_bounds import NoiseBudget
from simulate.camera.grid import ACCURACY
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.integrator_settings import KNOWN, RenderSensor, workers
from simulate.radiance.integrator.renderer import Rendering, render_scene
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.outdoor.built_scene import BuiltScene
from simulate.radiance.outdoor.render_settings import RenderSettings, choose_render_settings, exact
from simulate.radiance.outdoor.scene import OutdoorScene

STEP_NM = 5.0


def render_sensor_of(camera: CameraModel, conditions: Conditions) -> RenderSensor:
    """Return the response of a pixel on the axis to radiance, in photoelectrons per exposure, and
    its noise.

    Notes
    -----
    Variance F^2 (signal + dark) + read noise, all referred to the photocathode (or to the silicon
    of a camera without a tube): what each photoelectron adds, detected or not, F^2 = (1 +
    1/shape)/p.
    """
    lens = camera.lens()
    table = np.asarray(lens.detector_nm, float)
    fine = np.union1d(table, np.arange(table[0], table[-1], STEP_NM))
    relative = np.interp(fine, table, lens.detector_efficiency) / max(lens.detector_efficiency)
    peak, area_m2, open_s, dark, factor, read, averaging_factor = _numbers(camera, conditions)
    per_watt = peak * relative * fine * 1e-9 / tube_photometry.JOULE_METRE
    response = per_watt * lens.gathering_sr * area_m2 * open_s
    return RenderSensor(
        response_nm=tuple(fine),
        response=tuple(response),
        dark_variance=factor * dark + read,
        variance_per_signal=factor,
        noise_averaging_factor=averaging_factor,
        name=camera.description.name,
    )


def _numbers(
    camera: CameraModel, conditions: Conditions
) -> tuple[float, float, float, float, float, float, float]:
    """Peak efficiency, area of a pixel, m2, time open, s, dark photoelectrons, F^2, pe^2 of
    reading, and `evened`.

    The light of a photoelectron's pulse falls on several pixels, and its afterglow in several
    fields.
    """
    area_m2 = camera.field_pixel_area_cm2 * 1e-4
    if not camera.has_tube:
        silicon, register = (
            camera.stage(Slot.SILICON, conditions),
            camera.stage(Slot.REGISTER, conditions),
        )
        dark = register.dark_e + register.clock_induced_e
        read = (register.read_noise_e / register.gain) ** 2
        return (
            silicon.quantum_efficiency,
            area_m2,
            silicon.exposure_s,
            dark,
            register.excess_noise_factor,
            read,
            1.0,
        )
    scene_shape = tuple(side + 2 * ACCURACY.scene_margin_px for side in camera.shape)
    budget = NoiseBudget(camera, np.zeros(scene_shape, np.float32), conditions)
    cathode = camera.stage(Slot.PHOTOCATHODE, conditions)
    read = (float(camera.description.ccd.read_noise_e) / budget.of_chain.gain_e) ** 2
    factor = budget.mcp.excess_noise_factor
    per_pe = (budget.pulses[0] + budget.of_chain.white) / budget.charge_e
    averaging_factor = min(1.0, float(np.sqrt(per_pe / factor)))
    return (
        cathode.quantum_efficiency,
        area_m2,
        cathode.open_s,
        budget.dark_pe,
        factor,
        read,
        averaging_factor,
    )


# Pixels on the longer side of a preview.
PREVIEW_PX = 192
# Most rays of one of its pixels.
PREVIEW_RAYS = 8
# An error is reported as too large from this multiple of the promised one: rays are sent in
# batches.
STEP = 1.1
SPENT = "some pixels, or all together, have had the most rays that they may"


@dataclass(frozen=True, kw_only=True)
class RenderedView:
    """Rendering of an outdoor scene for one camera."""

    picture: Rendering  # radiance, its error and the truth of each pixel
    plan: RenderSettings  # what it was made with
    stage: SpectralScene  # surfaces and light on the bands
    eye: RenderSensor  # the sensor as it was planned for
    viewpoint: Viewpoint  # pose and pixels
    title: str  # what it shows, where and when
    left_out: tuple[str, ...] = ()  # what files of the scene say that is not used, in sentences

    @property
    def chance(self) -> float:
        """Monte Carlo error of the pixels over their noise floor, root mean square."""
        grain = self.eye.noise_floor(self.picture.signal)
        return float(np.sqrt(np.mean(np.nan_to_num(self.picture.variance) / grain**2)))

    @property
    def short(self) -> bool:
        """Whether the Monte Carlo error exceeds that of the render settings because of the limit of
        rays.
        """
        return self.chance > STEP * self.plan.chance

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user of the frames."""
        neglected = ", ".join(sorted(self.plan.plan.names)) or "nothing"
        below_zero = self.picture.below_zero
        return (
            (
                f"light by rays: left out {neglected}; see light; the truth of each pixel is in "
                "truth, next to the frames"
            ),
            *(
                (f"{below_zero} pixels came out below zero by chance and count as dark",)
                if below_zero
                else ()
            ),
            f"by the scatter of their rays pixels are uncertain by {100.0 * self.chance:.2g} % of "
            f"their noise (or {100.0 * KNOWN * self.chance:.2g} % of the signal where that is "
            "more), root mean square",
            *self.left_out,
            *(
                (f"that is more than the {100.0 * self.plan.chance:.2g} % of the plan: {SPENT}",)
                if self.short
                else ()
            ),
        )

    def text(self) -> str:
        """Return the plan as lines."""
        return self.plan.text()

    def document(self) -> bytes:
        """Return the plan as JSON."""
        return json.dumps(self.plan.document(), indent=1).encode()


@dataclass(frozen=True)
class OutdoorRendering:
    """A scene and a camera."""

    scene: OutdoorScene  # the scene
    camera: CameraModel  # the camera, whose lens and pixels the scene's camera has
    conditions: Conditions  # gate or exposure, by which the camera's noise is judged

    @cached_property
    def site(self) -> BuiltScene:
        """The scene with surfaces and lights."""
        return BuiltScene(self.scene)

    @property
    def view(self) -> Viewpoint:
        """Viewpoint of the camera without distortion, which the camera's lens adds."""
        lens, cells, pose = self.camera.lens(), self.camera.cells, self.scene.camera
        if pose.distortion_fraction and lens.distortion_fraction:
            raise BadInput(
                "distortion must be stated once: the scene's camera has "
                f"{pose.distortion_fraction:g} and the sensor's lens {lens.distortion_fraction:g}"
            )
        forward = np.subtract(pose.look_at_m, pose.position_m)
        forward /= np.linalg.norm(forward)
        return Viewpoint(
            position_m=pose.position_m,
            forward=(float(forward[0]), float(forward[1]), float(forward[2])),
            roll_deg=pose.roll_deg,
            shape=self.camera.shape,
            focal_px=(
                lens.focal_length_mm / cells.pitch_x_mm,
                lens.focal_length_mm / cells.pitch_y_mm,
            ),
            distortion_fraction=pose.distortion_fraction,
            scan=pose.scan,
        )

    def render(
        self,
        *,
        tolerance: float | None,
        seed: int,
        preview: bool = False,
        like: RenderedView | None = None,
        threads: int | None = None,
        progress: Callable[[float], None] = lambda fraction: None,
        announce: Callable[[float], None] = lambda seconds: None,
    ) -> RenderedView:
        """Render the scene for the camera.

        Parameters
        ----------
        tolerance
            What leaving out and chance may change together, as a fraction of a pixel's noise in one
            frame; None: nothing is left out.
        seed
            Seed of all rays.
        preview
            Few pixels, so that it takes seconds.
        like
            A view of the scene with its objects or camera in other poses, whose settings and light
            this one has; None: settings are chosen by the tolerance.
        threads
            Threads that share the work; None: one for each of up to two processors.
        progress
            Called with the fraction done.
        announce
            Called with the estimated time of the rendering, s, after its first rays.
        """
        view, eye = self.view, render_sensor_of(self.camera, self.conditions)
        if preview:
            view = view.smaller(max(1, round(max(view.shape) / PREVIEW_PX)))
        if like is not None:
            plan, stage = like.plan, self.site.with_light_of(like.stage)
        elif tolerance is None:
            plan, stage = exact(self.site, view, eye, seed)
        else:
            plan, stage = choose_render_settings(self.site, view, eye, tolerance, seed)
        rays = (
            replace(plan.rays, edge=PREVIEW_RAYS, max_rays=PREVIEW_RAYS) if preview else plan.rays
        )
        count = min(2, os.cpu_count() or 1) if threads is None else threads
        with workers(count) as run:
            picture = render_scene(
                stage,
                view,
                rays,
                plan.effort,
                weight=eye.weight(plan.wavelength_nm),
                seed=seed,
                run=run,
                progress=progress,
                announce=lambda seconds: announce(seconds / count),
            )
        return RenderedView(
            picture=picture,
            plan=plan,
            stage=stage,
            eye=eye,
            viewpoint=view,
            title=self._title(),
            left_out=(
                *self.site.surfaces.notes,
                *(surface.note for surface in self.scene.material if surface.note),
            ),
        )

    def _title(self) -> str:
        location, sky = self.scene.place, self.site.sky
        if location is None or sky is None:
            return f"{self.scene.name}, without a sky"
        bodies = [f"{body.name} at {body.elevation_deg:.0f} deg" for body in sky.discs()]
        return f"{self.scene.name}, {location.time}, {', '.join(bodies) or 'no moon'}"
