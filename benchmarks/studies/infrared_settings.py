"""Error and time of the settings of the infrared renderer, and what its automatic choice of rays
reaches.
"""

import json
import re
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.studies import infrared_stability
from labdata import load_camera
from simulate.camera.thermal_imager import ThermalImager
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.radiance.scene import load_scene
from simulate.thermal import infrared_rendering as rendering
from simulate.thermal import infrared_surfaces as surfaces
from simulate.thermal.infrared_rendering import infrared_radiance, tracer_of
from simulate.thermal.infrared_tracer import AIR, BETWEEN, MORE, SUN
from simulate.thermal.temperatures import Temperatures, temperatures_of
from simulate.thermal.thresholds import INFRARED

Array = NDArray[np.floating]
PAGE, FIGURE = Path("docs/validation/infrared.md"), Path("docs/pictures/infrared/settings.png")
TABLE = Path("benchmarks/studies/tables/infrared_settings.json")
# Scene, its time and imager; every so many pixels of the imager's.
VIEWS = {
    "hangar at 02:00, 7.5-13.5 µm": ("hangar", "02:00", "vox-lwir-640", 20),
    "hangar at 13:00, 3.4-4.9 µm": ("hangar", "13:00", "insb-mwir-640", 20),
}
RAYS, MORE_RAYS, REPEATS = (8, 16, 32, 64, 128, 256, 512), 1024, 4
NETDS_MK = (10.0, 20.0, 40.0, 80.0, 160.0, 320.0)
GROUPS, REFLECTIONS, PARTS, PASS_MK = (
    (1, 2, 4),
    (0, 1, 2, 4),
    (1, 2, 3, 5),
    (2000.0, 200.0, 20.0, 2.0),
)


@dataclass(frozen=True, kw_only=True)
class View:
    """A scene from an imager's place, and its converged radiance, shape (pixel, bin)."""

    scene: OutdoorScene
    temperatures: Temperatures
    look: Any  # with all terms and `MORE_RAYS`
    glossy: NDArray[np.bool_]
    surface: NDArray[np.bool_]
    exact: Array

    @classmethod
    def of(cls, name: str, hour: str, sensor: str, factor: int) -> "View":
        """Return a view at an hour of a scene's day."""
        scene, camera = load_scene(name), ThermalImager(load_camera(sensor))
        assert isinstance(scene, OutdoorScene) and scene.place is not None
        place = replace(scene.place, time=re.sub(r"T\d\d:\d\d", f"T{hour}", scene.place.time))
        scene = replace(scene, place=place)
        temperatures, stands = temperatures_of(scene), scene.camera
        ahead = np.subtract(stands.look_at_m, stands.position_m)
        forward = tuple((ahead / np.linalg.norm(ahead)).tolist())
        viewpoint = camera.viewpoint(stands.position_m, forward).smaller(factor)
        look = tracer_of(temperatures, scene, viewpoint, band_um=camera.band_um, seed=0)
        look = replace(look, rays=MORE_RAYS, mirror_rays=MORE_RAYS)
        runs = [seen(replace(look, seed=100 + number)) for number in range(REPEATS)]
        parts = [look.rows(start) for start in range(0, viewpoint.shape[0], INFRARED.rows)]
        glossy, kelvin = (
            np.concatenate([getattr(part, of) for part in parts]) for of in ("glossy", "kelvin")
        )
        return cls(
            scene=scene,
            temperatures=temperatures,
            look=look,
            glossy=glossy,
            surface=np.isfinite(kelvin),
            exact=np.mean(runs, axis=0),
        )

    def error_mk(self, radiance: Array, of: NDArray[np.bool_] | None = None) -> float:
        """Return the root mean square error of surfaces, or of some pixels, mK."""
        off = (radiance - self.exact).sum(axis=1)[self.surface if of is None else of]
        per_radiance = self.look.air.kelvin_per_radiance(self.look.air.temperature_k)
        return 1e3 * per_radiance * float(np.sqrt(np.mean(np.square(off))))


def seen(look: Any) -> Array:
    """Return the radiance of the middles of all pixels, shape (pixel, bin)."""
    return np.concatenate(
        [look.rows(row).radiance for row in range(0, look.viewpoint.shape[0], INFRARED.rows)]
    )


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return a result and its processor time, s."""
    began = time.process_time()
    return work(), time.process_time() - began


def rays_of(view: View) -> list[dict[str, float]]:
    """Return error and time against the rays of a pixel, the same for diffuse surfaces and for
    glossy ones.
    """
    rows = []
    for rays in RAYS:
        radiance, seconds = timed(
            lambda rays=rays: seen(replace(view.look, rays=rays, mirror_rays=rays, seed=7))
        )
        rows.append(
            {
                "rays": rays,
                "ms_per_pixel": 1e3 * seconds / len(radiance),
                "diffuse_mk": view.error_mk(radiance, view.surface & ~view.glossy),
                "glossy_mk": view.error_mk(radiance, view.glossy),
            }
        )
    return rows


def chosen_for(view: View, rows: list[dict[str, float]]) -> list[dict[str, Any]]:
    """Return what the renderer chooses by itself for imagers of some noise, and its error."""
    band, found = view.look.air.edges_um, []
    for netd_mk in NETDS_MK:
        with patch.object(
            type(view.look), "mean_radiance", lambda look, pixels: picture_centres(look, pixels)
        ):
            picture = infrared_radiance(
                view.temperatures,
                view.scene,
                view.look.viewpoint,
                band_um=(band[0], band[-1]),
                netd_k=1e-3 * netd_mk,
                seed=3,
            )
        radiance, limit = picture.radiance.reshape(view.exact.shape), INFRARED.error_share * netd_mk
        enough = [
            next((int(row["rays"]) for row in rows if row[of] <= limit), None)
            for of in ("diffuse_mk", "glossy_mk")
        ]
        found.append(
            {
                "netd_mk": netd_mk,
                "rays": list(picture.rays),
                "cheapest": enough,
                "diffuse": view.error_mk(radiance, view.surface & ~view.glossy) / netd_mk,
                "glossy": view.error_mk(radiance, view.glossy) / netd_mk,
                "flagged": any("by chance, more than" in note for note in picture.notes),
            }
        )
    return found


def picture_centres(look: Any, pixels: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the middles of pixels where a picture has means of parts, to compare with other
    middles, without error.
    """
    row, col = np.divmod(pixels, look.viewpoint.shape[1])
    rng = np.random.default_rng([look.seed, 4, int(pixels[0])])
    even = rendering.SequenceSlice.random(len(pixels), look.rays, rng)
    return look.see(row + 0.5, col + 0.5, even, rng).radiance, np.zeros(len(pixels))


def terms_of(view: View) -> list[dict[str, Any]]:
    """Return the error and the time saved by terms left out, fewer bins, reflections and passes of
    neighbours.
    """
    few = replace(view.look, rays=256, mirror_rays=256, seed=7)
    base, base_s = timed(lambda: seen(few))
    found = []

    def add(setting: str, radiance: Array, seconds: float | None = None) -> None:
        change = (radiance - base).sum(axis=1)[view.surface]
        per_radiance = 1e3 * view.look.air.kelvin_per_radiance(view.look.air.temperature_k)
        rms, most = np.sqrt(np.mean(change**2)) * per_radiance, np.abs(change).max() * per_radiance
        found.append(
            {"setting": setting, "rms_mk": float(rms), "most_mk": float(most), "seconds": seconds}
        )

    add("all terms", base, base_s)
    for term in (AIR, MORE, SUN, BETWEEN):
        add(
            f"without {term}",
            *timed(lambda term=term: seen(replace(few, without=frozenset({term})))),
        )
    for count in GROUPS:
        add(f"{count} of {len(view.look.air.low_um)} bins for the air", _in_groups(few, count))
    temperatures, sky = view.temperatures, view.look.sky
    for count in REFLECTIONS:
        with patch.object(surfaces, "MOST_REFLECTIONS", count):
            of = surfaces.infrared_surfaces(temperatures, view.scene, view.look.air, sky)
        add(
            f"{count} reflections between facets",
            *timed(lambda of=of: seen(replace(few, surfaces=of))),
        )
    for tolerance_mk in PASS_MK:
        other, seconds = timed(lambda mk=tolerance_mk: temperatures_of(view.scene, tolerance_mk=mk))
        of = surfaces.infrared_surfaces(other, view.scene, view.look.air, sky)
        add(
            f"neighbours to {tolerance_mk:g} mK",
            seen(replace(few, temperatures=other, surfaces=of)),
            seconds,
        )
    return found


def _in_groups(look: Any, count: int) -> Array:
    """Return the radiance with one transmittance for each of some groups of bins."""
    bare, ground = (
        seen(replace(look, without=frozenset({AIR}))),
        look.air.black_body(look.air.temperature_k),
    )
    range_m = np.concatenate(
        [look.rows(row).range_m for row in range(0, look.viewpoint.shape[0], INFRARED.rows)]
    )
    met, out = np.isfinite(range_m), np.array(bare)
    through = look.air.transmittance(range_m[met])
    for bins in np.array_split(np.arange(len(ground)), count):
        through[:, bins] = ((through[:, bins] @ ground[bins]) / ground[bins].sum())[:, None]
    out[met] = through * bare[met] + (1.0 - through) * ground
    return out


def parts_of(view: View) -> list[dict[str, float]]:
    """Return error and time against the parts of pixels in which objects or faces meet."""
    look = replace(view.look, rays=64, mirror_rays=64, seed=7)
    parts = [look.rows(start) for start in range(0, look.viewpoint.shape[0], INFRARED.rows)]
    edges = np.flatnonzero(rendering._truth(look, parts).edges(shadows=look.sky.sun is not None))
    found, exact = [], None
    for side in (9, *PARTS):
        with ExitStack() as stack:
            stack.enter_context(
                patch.object(rendering, "INFRARED", replace(INFRARED, edge_parts=side))
            )
            (radiance, told), seconds = timed(lambda: look.mean_radiance(edges))
        if exact is None:
            exact = radiance
            continue
        per_radiance, off = (
            look.air.kelvin_per_radiance(look.air.temperature_k),
            (radiance - exact).sum(axis=1),
        )
        rms_mk, stated_mk = (
            1e3 * per_radiance * float(np.sqrt(np.mean(one**2))) for one in (off, told)
        )
        found.append(
            {
                "side": side,
                "rms_mk": rms_mk,
                "stated_mk": stated_mk,
                "ms_per_pixel": 1e3 * seconds / len(edges),
            }
        )
    return found


def draw(results: dict[str, Any]) -> None:
    """Draw error against time by rays, and the error of the automatic choice over the noise."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    settings, auto = figure.subplots(1, 2)
    for number, (name, result) in enumerate(results.items()):
        for of, style in (("diffuse", "o-"), ("glossy", "s--")):
            rows = result["rays"]
            settings.plot(
                [row["ms_per_pixel"] for row in rows],
                [row[f"{of}_mk"] for row in rows],
                style,
                color=f"C{number}",
                label=f"{name}, {of}",
            )
            chosen = result["auto"]
            auto.plot(
                [row["netd_mk"] for row in chosen],
                [row[of] for row in chosen],
                style,
                color=f"C{number}",
            )
    settings.set(
        xscale="log",
        yscale="log",
        xlabel="processor time of a pixel, ms",
        ylabel="error of a pixel, mK",
    )
    settings.set_title(f"{', '.join(map(str, RAYS))} rays of a pixel", fontsize=9)
    settings.legend(fontsize=7)
    auto.axhline(INFRARED.error_share, color="grey", ls=":")
    auto.set(
        xscale="log",
        xlabel="NETD of the imager, mK",
        ylabel="error of a pixel over the NETD",
        ylim=(0.0, None),
    )
    auto.set_title("automatic choice of rays", fontsize=9)
    FIGURE.parent.mkdir(exist_ok=True)
    figure.savefig(FIGURE, dpi=100, pil_kwargs={"optimize": True})


def text_of(results: dict[str, Any]) -> str:
    """Return the tables of the page."""
    lines = []
    for name, result in results.items():
        lines += [f"## {name[0].upper()}{name[1:]}", ""]
        lines += [
            "| rays of a pixel | ms a pixel | diffuse, mK | glossy and metals, mK |",
            "|---|---|---|---|",
        ]
        lines += [
            (
                f"| {row['rays']} | {row['ms_per_pixel']:.2g} | {row['diffuse_mk']:.3g} | "
                f"{row['glossy_mk']:.3g} |"
            )
            for row in result["rays"]
        ]
        lines += [
            "",
            (
                "| NETD, mK | rays chosen | fewest that suffice | error over NETD: diffuse | "
                "glossy | flagged |"
            ),
        ]
        lines += ["|---|---|---|---|---|---|"]
        for row in result["auto"]:
            chosen, least = (
                " / ".join("none" if n is None else str(n) for n in row[k])
                for k in ("rays", "cheapest")
            )
            lines.append(
                f"| {row['netd_mk']:g} | {chosen} | {least} | {row['diffuse']:.2f} | "
                f"{row['glossy']:.2f} | {'yes' if row['flagged'] else 'no'} |"
            )
        lines += [
            "",
            "| setting | changes by, mK rms | at most, mK | processor time, s |",
            "|---|---|---|---|",
        ]
        lines += [
            f"| {row['setting']} | {row['rms_mk']:.3g} | {row['most_mk']:.3g} | "
            f"{'–' if row['seconds'] is None else format(row['seconds'], '.2g')} |"
            for row in result["terms"]
        ]
        lines += [
            "",
            "| parts of a pixel where faces meet | error, mK rms | stated | ms a pixel |",
            "|---|---|---|---|",
        ]
        lines += [
            f"| {row['side']} x {row['side']} | {row['rms_mk']:.3g} | {row['stated_mk']:.3g} | "
            f"{row['ms_per_pixel']:.2g} |"
            for row in result["parts"]
        ]
        lines.append("")
    return "\n".join(lines)


def write_block(name: str, body: str) -> None:
    """Replace what stands between two markers of the page."""
    begin, end = f"<!-- {name} -->", f"<!-- end {name} -->"
    text = PAGE.read_text()
    PAGE.write_text(
        re.sub(f"{begin}.*{end}", lambda _: f"{begin}\n\n{body}\n\n{end}", text, flags=re.S)
    )


def main() -> None:
    """Measure, draw, and write tables and verdicts into the page."""
    results = {}
    for name, which in VIEWS.items():
        view = View.of(*which)
        rows = rays_of(view)
        results[name] = {
            "rays": rows,
            "auto": chosen_for(view, rows),
            "terms": terms_of(view),
            "parts": parts_of(view),
        }
    draw(results)
    print(text_of(results))
    write_block("settings", text_of(results))
    verdicts = infrared_stability.sweep()
    print(infrared_stability.text_of(verdicts))
    write_block("stability", infrared_stability.text_of(verdicts))
    rounded = json.loads(json.dumps(results), parse_float=lambda text: float(f"{float(text):.3g}"))
    rows = [row.as_json() for row in verdicts]
    TABLE.write_text(json.dumps({"settings": rounded, "stability": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
