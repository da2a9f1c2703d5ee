"""Printed power of a validation against injection: sets of cameras with one parameter off by the
printed error, by the level of the brightest flat.

`make study NAME=power-injection` measures it and rewrites the table. A flat above
`VALIDATION.highest_share` of full scale takes no part in a validation: the two dimmer ones do.
Cameras other than the small machine-vision one have the light of `LIGHT`, and are printed alone.
"""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from charact.validation.controls import ParameterControl, detectable_error
from charact.validation.thresholds import VALIDATION
from charact.validation.validation_test import ValidationTest
from tests.charact.validation.bench_sets import FULL_SCALE, BenchSets

TABLE = Path(__file__).with_name("tables") / "power_injection.json"
# Level of the brightest flat over full scale, and of the others.
PLACES, DIMMER = (0.5, 0.65, 0.74, 0.79, 0.95), (0.1, 0.35)
SHAPE = (96, 128)
# First numbers of the sets of wrong cameras, of each parameter its own.
WRONG = 10_000


def bench_at(place: float, seed: int) -> BenchSets:
    """Return the bench of the small machine-vision camera with its brightest flat at a level."""
    levels = (*DIMMER, place) if place <= VALIDATION.highest_share else (0.05, *DIMMER)
    lights = tuple(level * FULL_SCALE for level in levels)
    return BenchSets("machine-vision", seed=seed, shape=SHAPE, lights=lights)


def inject(
    bench: BenchSets, place: float, tries: int, titles: tuple[str, ...] = ()
) -> list[dict[str, Any]]:
    """Return, by parameter, the printed error and how many of the sets off by it, half of them
    upwards, are noticed, of errors of 1 and more all; `titles`: of these parameters, none: of all.
    """
    seed = bench.seed
    sets = [bench.numbers(bench.frames(number)) for number in range(VALIDATION.draws)]
    changes = bench.changes()
    test, rows = ValidationTest(sets, seed=seed, changes=changes), []
    for index, (control, change) in enumerate(zip(bench.controls, changes, strict=True)):
        if titles and change.title not in titles:
            continue
        error = detectable_error(test, change, partial(bench.change_of, control, number=1))
        row = {
            "place": place,
            "seed": seed,
            "parameter": change.title,
            "error": error.relative_error,
            "posterior_sd": control.least_error(bench.sensor) / VALIDATION.least_of_posterior,
            "statistic": error.statistic,
        }
        if error.statistic:
            first = WRONG * (index + 1)
            row["upwards"], row["downwards"] = (
                sum(
                    _is_noticed(bench, test, first + number, control, sign * error.relative_error)
                    for number in range(tries // 2)
                )
                for sign in (1.0, -1.0 if error.relative_error < 1.0 else 1.0)
            )
            row["noticed"] = row["upwards"] + row["downwards"]
            row["tries"] = tries // 2 * 2
        rows.append(row)
        print(row, flush=True)
    return rows


def _is_noticed(
    bench: BenchSets, test: ValidationTest, number: int, control: ParameterControl, error: float
) -> bool:
    wrong = bench.change(number, control, error)
    assert wrong is not None
    return any(not statistic.passed for statistic in test.statistics(wrong[0]))


def summary(rows: list[dict[str, Any]]) -> str:
    """Return the share noticed at each level, of each parameter, and of all."""
    known = [row for row in rows if "noticed" in row]
    lines = [
        _line(str(name), [row for row in known if row[key] == name])
        for key in ("place", "parameter")
        for name in dict.fromkeys(row[key] for row in known)
    ]
    return "\n".join((*lines, _line("all", known)))


def _line(name: str, rows: list[dict[str, Any]]) -> str:
    noticed, tries = (sum(row[key] for row in rows) for key in ("noticed", "tries"))
    errors = np.median([100.0 * row["error"] for row in rows])
    return f"{name}: {noticed} of {tries} noticed ({noticed / tries:.0%}), median {errors:.2g} %"


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--places", type=float, nargs="+", default=list(PLACES))
    parser.add_argument("--tries", type=int, default=16)
    parser.add_argument("--cameras", nargs="+", default=[])
    parser.add_argument("--parameters", nargs="+", default=[])
    asked = parser.parse_args()
    benches = [
        (BenchSets(name, seed=seed, shape=SHAPE), 0.0)
        for seed in asked.seeds
        for name in asked.cameras
    ] or [(bench_at(place, seed), place) for seed in asked.seeds for place in asked.places]
    rows = [
        row
        for bench, place in benches
        for row in inject(bench, place, asked.tries, tuple(asked.parameters))
    ]
    print(summary(rows))
    if asked.cameras or asked.parameters:
        return
    TABLE.write_text(json.dumps(rows, indent=1).replace("NaN", "null") + "\n")


if __name__ == "__main__":
    main()
