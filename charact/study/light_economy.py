"""What economy of light changes in frames: random scenes by their plans and exactly, frame beside frame.

`make radiance-economy` writes the table; cases already in it are kept, so that it goes on where it was interrupted. A
case is a scene, a light and a camera (`charact.study.light_scenes`). The difference of its two frames without noise is
taken over the temporal noise of each pixel, which is found by drawing frames; the root mean square over the frame is
what the tolerance is for.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.study.light_scenes import Case, case_of
from labdata.conditions import Conditions
from simulate.iiccd import tiers
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.exposure import freed_by_radiance
from simulate.night import Seen
from simulate.radiance.transport.eye import KNOWN

TABLE = Path(__file__).resolve().parent / "tables" / "light_economy.json"
CASES, TOLERANCE = 100, 0.2
# Frames from which the temporal noise is found: to 13 %.
DRAWN = 32
# Noise of a digitiser's step, DN: a pixel at full scale has no other.
STEP_DN = 12.0**-0.5

Image = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What economy did to one case.

    Parameters
    ----------
    number
        The case, and the seed of its scene; the rays of plan and exact mode have the seeds 2 n and 2 n + 1.
    light, sensor
        What lights it; the camera.
    difference
        Of the frames without noise over the temporal noise, root mean square over the pixels.
    difference_99
        The 99th percentile of its size.
    light_difference
        Of the light before the camera over the grain of its pixels (`Eye.grain`), root mean square.
    exact_by_chance
        Share of that which the exact mode has by chance, by the scatter of its rays.
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
    exact_by_chance: float
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
class Pair:
    """A case seen by its plan and exactly, with frames without noise, their difference over the noise, and times."""

    case: Case
    planned: Seen
    exact: Seen
    planned_dn: Image
    exact_dn: Image
    difference: Image
    planned_s: float
    exact_s: float


def pair_of(number: int) -> Pair:
    """Render a case both ways and expose it."""
    case = case_of(number)
    _ = case.night.site.surfaces
    planned, planned_s = _timed(case, TOLERANCE, 2 * number)
    exact, exact_s = _timed(case, None, 2 * number + 1)
    camera, conditions = case.night.camera, case.night.conditions
    by_plan, exactly = (_received(camera, conditions, seen) for seen in (planned, exact))
    planned_dn, exact_dn = (_readable(camera, camera.mean_frame(light, conditions)) for light in (by_plan, exactly))
    noise = _noise(camera, conditions, exactly, exact_dn, number)
    return Pair(
        case=case,
        planned=planned,
        exact=exact,
        planned_dn=planned_dn,
        exact_dn=exact_dn,
        difference=(planned_dn - exact_dn) / noise,
        planned_s=planned_s,
        exact_s=exact_s,
    )


def _timed(case: Case, tolerance: float | None, seed: int) -> tuple[Seen, float]:
    start = time.process_time()
    seen = case.night.seen(tolerance=tolerance, seed=seed, threads=1)
    return seen, time.process_time() - start


def _received(camera: Any, conditions: Conditions, seen: Seen) -> Any:
    return camera.received(freed_by_radiance(camera, seen.picture.cube, conditions), conditions)


def _full_scale_dn(camera: Any) -> float:
    described = camera.sensor if isinstance(camera, IntensifiedCamera) else camera.description
    return float(2**described.video.bit_depth - 1)


def _readable(camera: Any, frame: Image) -> Image:
    """What the digitiser can say of a frame without noise."""
    return np.clip(frame.astype(float), 0.0, _full_scale_dn(camera))


def _noise(camera: Any, conditions: Conditions, light: Any, mean_dn: Image, seed: int) -> Image:
    """Temporal noise of drawn frames, DN; or `KNOWN` of the signal where that is more, as in plans of light."""
    if isinstance(camera, IntensifiedCamera):
        stream = tiers.frames(camera, light, conditions, seed=seed)
    else:
        stream = camera.frames(light, conditions, seed=seed)
    drawn = np.stack(list(islice(stream, DRAWN))).astype(float)
    dark = float(np.percentile(mean_dn, 0.0))
    temporal = np.maximum(drawn.std(axis=0, ddof=1), STEP_DN)
    return np.maximum(temporal, KNOWN * np.maximum(mean_dn - dark, 0.0))


def measured(number: int) -> Outcome:
    """Return what economy did to a case."""
    pair = pair_of(number)
    planned, exact = pair.planned, pair.exact
    grain = exact.eye.grain(exact.picture.signal)
    return Outcome(
        number=number,
        light=pair.case.light,
        sensor=pair.case.sensor,
        difference=_rms(pair.difference),
        difference_99=float(np.percentile(np.abs(pair.difference), 99.0)),
        light_difference=_rms((planned.picture.signal - exact.picture.signal) / grain),
        exact_by_chance=exact.chance,
        planned_s=pair.planned_s,
        exact_s=pair.exact_s,
        planned_rays=float(planned.picture.rays.mean()),
        exact_rays=float(exact.picture.rays.mean()),
        bands=len(planned.plan.wavelength_nm),
        bounces=planned.plan.effort.bounces,
        left_out=tuple(sorted(planned.plan.plan.names)),
    )


def _rms(values: Image) -> float:
    return float(np.sqrt(np.mean(np.asarray(values, float) ** 2)))


def told(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return what the cases say together."""
    difference = np.array([one.difference for one in outcomes])
    worst = outcomes[int(np.argmax(difference))]
    return {
        "cases": len(outcomes),
        "tolerance": TOLERANCE,
        "within": int(np.sum(difference < TOLERANCE)),
        "light_within": int(np.sum(np.array([one.light_difference for one in outcomes]) < TOLERANCE)),
        "median_difference": float(np.median(difference)),
        "worst": worst.number,
        "worst_difference": worst.difference,
        "median_saving": float(np.median([one.saving for one in outcomes])),
        "median_saving_of_rays": float(np.median([one.exact_rays / one.planned_rays for one in outcomes])),
    }


def read(path: Path = TABLE) -> list[Outcome]:
    """Return the cases of a table; none if there is no table yet."""
    if not path.is_file():
        return []
    rows = json.loads(path.read_text())["cases"]
    return [Outcome(**{**row, "left_out": tuple(row["left_out"])}) for row in rows]


def written(outcomes: Sequence[Outcome], path: Path = TABLE) -> None:
    """Write a table: a row for each case, and what they say together."""
    table = {
        "charact": charact.__version__,
        "told": told(outcomes),
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
    parser.add_argument("--again", action="store_true", help="measure all anew")
    parser.add_argument("--table", type=Path, default=TABLE, help="where the table is")
    asked = parser.parse_args()
    outcomes = [] if asked.again else read(asked.table)
    have = {one.number for one in outcomes}
    for number in range(asked.first, asked.first + asked.cases):
        if number not in have:
            outcomes.append(measured(number))
            written(outcomes, asked.table)
            one = outcomes[-1]
            print(
                f"{number:3d}  {one.light:18s} {one.sensor:18s} frame {one.difference:.3f}  light "
                f"{one.light_difference:.3f}  {one.planned_s:.1f} s for {one.exact_s:.1f} s",
                flush=True,
            )
    print(json.dumps(told(outcomes), indent=1))


if __name__ == "__main__":
    main()
