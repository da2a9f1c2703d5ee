"""What economy of light changes in frames: random scenes by their plans and exactly, frame beside
frame.

`make study NAME=effect-selection` writes the table; cases already in it are kept where the same
sources of `simulate.radiance` made them, so that it goes on where it was interrupted. A case is a
scene, a light and a camera (`benchmarks.studies.effect_selection_scenes`). The difference of its
two frames without noise is taken over the temporal noise of each pixel, which is found by drawing
frames; the root mean square over the frame is what the tolerance is for. A plan that its rays did
not bring to the chance it promised says so: such cases are counted apart among those beyond the
tolerance.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from benchmarks.studies.effect_selection_scenes import CAMERAS, SceneCase, case_of
from benchmarks.studies.figures import pyplot
from labdata import Conditions
from labdata.numba_cache import stamp_of
from simulate.camera.scene_to_photoelectrons import photoelectrons_from_radiance
from simulate.outdoor_rendering import RenderedView
from simulate.radiance.integrator import integrator_settings

TABLE = Path(__file__).with_name("tables") / "light_economy.json"
# One of the sources whose change makes cases old.
SOURCE = Path(integrator_settings.__file__)
CASES, TOLERANCE = 100, 0.2
# Relative error to which the temporal noise of pixels is found, root mean square, and frames drawn
# for that at first and at most: where photoelectrons are few and pulses of many heights, hundreds
# show no more of it than tens elsewhere.
NOISE_KNOWN, DRAWN, DRAWN_MOST = 0.13, 64, 8192
# Noise of a digitiser's step, DN: a pixel at full scale has no other.
STEP_DN = 12.0**-0.5

Image = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class SelectionOutcome:
    """What economy did to one case.

    Parameters
    ----------
    number
        The case, and the seed of its scene; the rays of plan and exact mode have the seeds 2 n and
        2 n + 1.
    light, sensor
        What lights it; the camera.
    difference
        Of the frames without noise over the temporal noise, root mean square over the pixels.
    difference_99
        The 99th percentile of its size.
    light_difference
        Of the light before the camera over the grain of its pixels (`Eye.grain`), root mean square.
    planned_by_chance, exact_by_chance
        Share of that which the pictures have by chance, by what their rays differ.
    short
        Whether the plan says that it did not reach the chance it promised.
    planned_s, exact_s
        Time taken, s.
    planned_rays, exact_rays
        Rays a pixel, each of which gathers 2 and 4 more.
    bands, bounces
        Of the plan.
    left_out
        What the plan leaves out.
    """

    number: int
    light: str
    sensor: str
    difference: float
    difference_99: float
    light_difference: float
    planned_by_chance: float
    exact_by_chance: float
    short: bool
    planned_s: float
    exact_s: float
    planned_rays: float
    exact_rays: float
    bands: int
    bounces: int
    left_out: tuple[str, ...]

    @property
    def saving(self) -> float:
        """Time of the exact mode over that of the plan."""
        return self.exact_s / self.planned_s


@dataclass(frozen=True, kw_only=True)
class SelectionPair:
    """A case seen by its plan and exactly, with frames without noise, their difference over the
    noise, and times.
    """

    case: SceneCase
    planned: RenderedView
    exact: RenderedView
    planned_dn: Image
    exact_dn: Image
    difference: Image
    planned_s: float
    exact_s: float


def pair_of(number: int) -> SelectionPair:
    """Render a case both ways and expose it."""
    case = case_of(number)
    _ = case.night.site.surfaces
    planned, planned_s = _time_case(case, TOLERANCE, 2 * number)
    exact, exact_s = _time_case(case, None, 2 * number + 1)
    camera, conditions = case.night.camera, case.night.conditions
    by_plan, exactly = (
        _photoelectrons_at_mcp(camera, conditions, seen) for seen in (planned, exact)
    )
    planned_dn, exact_dn = (
        _readable(camera, camera.mean_frame(light, conditions)) for light in (by_plan, exactly)
    )
    noise = _noise(camera, conditions, exactly, exact_dn, number)
    return SelectionPair(
        case=case,
        planned=planned,
        exact=exact,
        planned_dn=planned_dn,
        exact_dn=exact_dn,
        difference=(planned_dn - exact_dn) / noise,
        planned_s=planned_s,
        exact_s=exact_s,
    )


def _time_case(case: SceneCase, tolerance: float | None, seed: int) -> tuple[RenderedView, float]:
    start = time.process_time()
    seen = case.night.render(tolerance=tolerance, seed=seed, threads=1)
    return seen, time.process_time() - start


def _photoelectrons_at_mcp(camera: Any, conditions: Conditions, seen: RenderedView) -> Any:
    return camera.to_mcp_input(
        photoelectrons_from_radiance(camera, seen.picture.cube, conditions), conditions
    )


def _full_scale_dn(camera: Any) -> float:
    described = camera.description
    return float(2**described.video.bit_depth - 1)


def _readable(camera: Any, frame: Image) -> Image:
    """What the digitiser can say of a frame without noise."""
    return np.clip(frame.astype(float), 0.0, _full_scale_dn(camera))


def _noise(camera: Any, conditions: Conditions, light: Any, mean_dn: Image, seed: int) -> Image:
    """Return the temporal noise of drawn frames, DN, or `KNOWN` of the signal where that is
    larger.
    """
    stream = camera.frames(light, conditions, seed=seed)
    dark = float(np.percentile(mean_dn, 0.0))
    return np.maximum(
        temporal_noise(stream), integrator_settings.KNOWN * np.maximum(mean_dn - dark, 0.0)
    )


def temporal_noise(frames: Iterator[NDArray[Any]]) -> Image:
    """Return the standard deviation of each pixel over frames, at least a digitiser's step, DN.

    As many frames are drawn as bring it to `NOISE_KNOWN`, by the two halves of them, or
    `DRAWN_MOST`.
    """
    drawn = np.zeros((0, *next(frames).shape))
    while True:
        drawn = np.concatenate(
            [drawn, np.stack(list(islice(frames, max(DRAWN, len(drawn))))).astype(float)]
        )
        halves = [np.maximum(drawn[first::2].std(axis=0, ddof=1), STEP_DN) for first in (0, 1)]
        if (
            _rms((halves[0] - halves[1]) / (halves[0] + halves[1])) <= NOISE_KNOWN
            or len(drawn) >= DRAWN_MOST
        ):
            return np.maximum(drawn.std(axis=0, ddof=1), STEP_DN)


def measure_case(number: int) -> SelectionOutcome:
    """Return what economy did to a case."""
    pair = pair_of(number)
    planned, exact = pair.planned, pair.exact
    grain = exact.eye.noise_floor(exact.picture.signal)
    return SelectionOutcome(
        number=number,
        light=pair.case.light,
        sensor=pair.case.sensor,
        difference=_rms(pair.difference),
        difference_99=float(np.percentile(np.abs(pair.difference), 99.0)),
        light_difference=_rms((planned.picture.signal - exact.picture.signal) / grain),
        planned_by_chance=planned.chance,
        exact_by_chance=exact.chance,
        short=planned.short,
        planned_s=pair.planned_s,
        exact_s=pair.exact_s,
        planned_rays=float(planned.picture.rays.mean()),
        exact_rays=float(exact.picture.rays.mean()),
        bands=len(planned.plan.wavelength_nm),
        bounces=planned.plan.effort.max_bounces,
        left_out=tuple(sorted(planned.plan.plan.names)),
    )


def _rms(values: Image) -> float:
    return float(np.sqrt(np.mean(np.asarray(values, float) ** 2)))


def summarise_outcomes(outcomes: Sequence[SelectionOutcome]) -> dict[str, Any]:
    """Return what the cases say together."""
    difference = np.array([one.difference for one in outcomes])
    worst = outcomes[int(np.argmax(difference))]
    beyond, short = difference >= TOLERANCE, np.array([one.short for one in outcomes])
    return {
        "cases": len(outcomes),
        "tolerance": TOLERANCE,
        "within": int(np.sum(~beyond)),
        "beyond_and_told": int(np.sum(beyond & short)),
        "beyond_and_untold": int(np.sum(beyond & ~short)),
        "within_and_told_otherwise": int(np.sum(~beyond & short)),
        "exact_known_to_a_third": int(
            sum(one.exact_by_chance < TOLERANCE / 3.0 for one in outcomes)
        ),
        "light_within": int(
            np.sum(np.array([one.light_difference for one in outcomes]) < TOLERANCE)
        ),
        "median_difference": float(np.median(difference)),
        "worst": worst.number,
        "worst_difference": worst.difference,
        "median_saving": float(np.median([one.saving for one in outcomes])),
        "median_saving_of_rays": float(
            np.median([one.exact_rays / one.planned_rays for one in outcomes])
        ),
    }


def read(path: Path = TABLE) -> list[SelectionOutcome]:
    """Return the cases of a table; none if there is no table yet."""
    if not path.is_file():
        return []
    rows = json.loads(path.read_text())["cases"]
    return [SelectionOutcome(**{**row, "left_out": tuple(row["left_out"])}) for row in rows]


def load_outcomes(path: Path = TABLE) -> list[SelectionOutcome]:
    """Return the cases of a table that the present sources made."""
    same = path.is_file() and json.loads(path.read_text()).get("sources") == stamp_of(SOURCE)
    return read(path) if same else []


def write_table(outcomes: Sequence[SelectionOutcome], path: Path = TABLE) -> None:
    """Write a table: a row for each case, and what they say together."""
    table = {
        "charact": charact.__version__,
        "sources": stamp_of(SOURCE),
        "told": summarise_outcomes(outcomes),
        "cases": [asdict(one) for one in sorted(outcomes, key=lambda one: one.number)],
    }
    part = path.with_suffix(".part")
    part.write_text(json.dumps(table, indent=1) + "\n")
    part.replace(path)


def main() -> None:
    """Measure the cases that the table lacks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cases", type=int, default=CASES, help="how many cases")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--table", type=Path, default=TABLE, help="where the table is")
    asked = parser.parse_args()
    outcomes = load_outcomes(asked.table)
    have = {one.number for one in outcomes}
    for number in range(asked.first, asked.first + asked.cases):
        if number not in have:
            outcomes.append(measure_case(number))
            write_table(outcomes, asked.table)
            one = outcomes[-1]
            print(
                f"{number:3d}  {one.light:18s} {one.sensor:18s} frame {one.difference:.3f}  light "
                f"{one.light_difference:.3f}  {one.planned_s:.1f} s for {one.exact_s:.1f} s",
                flush=True,
            )
    print(json.dumps(summarise_outcomes(outcomes), indent=1))
    plot_economy(read(asked.table), FIGURE)


FIGURE = Path(__file__).resolve().parents[3] / "docs" / "pictures" / "night-scenes" / "economy.png"
# Differences of no size, as of frames that are full everywhere, are drawn here.
LOWEST = 2e-3
MARKS = dict(zip(CAMERAS, "osD", strict=True))


def plot_economy(outcomes: Sequence[SelectionOutcome], path: Path) -> Path:
    """Draw all cases of a table, and render the worst again."""
    figure, (left, *right) = pyplot().subplots(
        1, 4, figsize=(15.0, 4.0), layout="constrained", width_ratios=(1.6, 1.0, 1.0, 1.0)
    )
    whole = summarise_outcomes(outcomes)
    _draw_cases(left, outcomes)
    pair = pair_of(whole["worst"])
    low, high = np.percentile(pair.exact_dn, (0.0, 99.5))
    for axes, (title, frame) in zip(
        right, (("exact", pair.exact_dn), ("by the plan", pair.planned_dn)), strict=False
    ):
        drawn: Any = axes.imshow(frame, cmap="gray", vmin=low, vmax=max(high, low + 1.0))
        figure.colorbar(drawn, ax=axes, label="DN", shrink=0.7)
        axes.set_title(title, fontsize=9)
    drawn = right[2].imshow(pair.difference, cmap="RdBu_r", vmin=-0.5, vmax=0.5)
    figure.colorbar(drawn, ax=right[2], label="difference / noise (1)", shrink=0.7)
    right[2].set_title("difference", fontsize=9)
    for axes in right:
        axes.set_xlabel("column (px)")
        axes.grid(visible=False)
    right[0].set_ylabel("row (px)")
    figure.suptitle(
        f"{whole['within']} of {whole['cases']} frames differ from exact ones by less than "
        f"{TOLERANCE:.0%} of their noise; median saving of time "
        f"{whole['median_saving']:.1f}-fold; right: the worst, case {whole['worst']}, "
        f"{pair.case.light}, {pair.case.sensor}",
        fontsize=10,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    pyplot().close(figure)
    return path


def _draw_cases(axes: Any, outcomes: Sequence[SelectionOutcome]) -> None:
    """Draw a mark for each case, its shape by camera and its colour by light."""
    lights = sorted({one.light.removesuffix(" with lamps") for one in outcomes})
    for number, light in enumerate(lights):
        for sensor, mark in MARKS.items():
            own = [one for one in outcomes if one.light.startswith(light) and one.sensor == sensor]
            if own:
                axes.plot(
                    [one.saving for one in own],
                    [max(one.difference, LOWEST) for one in own],
                    mark,
                    color=f"C{number}",
                    alpha=0.7,
                    label=light if sensor == CAMERAS[0] else None,
                    ms=5,
                )
    for sensor, mark in MARKS.items():
        axes.plot([], [], mark, color="0.4", ms=5, label=sensor)
    axes.axhline(TOLERANCE, color="k", lw=1, ls="--")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("time of the exact mode over that of the plan (1)")
    axes.set_ylabel(f"difference of frames / noise, rms (1; at least {LOWEST:g})")
    axes.set_ylim(bottom=LOWEST / 15.0)
    axes.legend(fontsize=7, ncols=2, loc="lower left")


if __name__ == "__main__":
    main()
