"""Power of a validation against the number of simulated sets and their time, verified by frames of
wrong cameras.

`make study NAME=validation-power` measures it and rewrites the table and the figure.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from charact.validation.controls import PARAMETERS, detectable_error
from charact.validation.frame_features import Numbers
from charact.validation.thresholds import VALIDATION
from charact.validation.validation_result import DetectableError
from charact.validation.validation_test import ParameterChange, ValidationTest
from tests.charact.validation.bench_sets import BenchSets

Groups = Mapping[str, Numbers]

TABLE = Path(__file__).with_name("tables") / "validation_power.json"
FIGURE = Path("docs/pictures/validation/power.png")
DRAWS = (8, 12, 16, 20, 28, 40)
# First numbers of the sets of wrong cameras, of each parameter its own.
WRONG = 10_000
# Parameters whose printed error is verified, one a stage.
VERIFIED = (
    "detection probability, as 1/F²",
    "frequency of the tube's MTF, or blur of the lens",
    "video bandwidth",
    "slow decay of the phosphor",
    "gain",
)


@dataclass(frozen=True, kw_only=True)
class PowerStudy:
    """Numbers of the sets of one camera, changes by its parameters, and processor time of a
    set, s.
    """

    bench: BenchSets
    sets: tuple[Groups, ...]
    changes: tuple[ParameterChange, ...]
    seconds: float

    @classmethod
    def of(cls, bench: BenchSets, count: int) -> "PowerStudy":
        """Simulate the sets, and the first one with each parameter changed."""
        began = time.process_time()
        sets = tuple(bench.numbers(bench.frames(number)) for number in range(count))
        seconds = (time.process_time() - began) / count
        return cls(bench=bench, sets=sets, changes=bench.changes(), seconds=seconds)

    def test(self, draws: int) -> ValidationTest:
        """Return the test by the first sets."""
        return ValidationTest(self.sets[:draws], seed=1, changes=self.changes)

    def detectable(self, test: ValidationTest, change: ParameterChange) -> DetectableError:
        """Return the error of a parameter that is printed."""
        control = next(one for one in PARAMETERS if one.title == change.title)
        return detectable_error(test, change, partial(self.bench.change_of, control, number=1))


def chart(study: PowerStudy) -> list[dict[str, Any]]:
    """Return, by number of sets, the errors found, false alarms of the other sets, and processor
    time.
    """
    rows = []
    for draws in DRAWS:
        if draws > len(study.sets) - 8:
            continue
        began = time.process_time()
        test = study.test(draws)
        found = {one.title: study.detectable(test, one) for one in study.changes}
        seconds = time.process_time() - began + draws * study.seconds
        alarms = [any(not one.passed for one in test.statistics(own)) for own in study.sets[draws:]]
        rows.append(
            {
                "draws": draws,
                "seconds": seconds,
                "false_alarms": sum(alarms),
                "tried": len(alarms),
                "errors": {name: one.relative_error for name, one in found.items()},
                "statistics": {name: one.statistic for name, one in found.items()},
            }
        )
        print(rows[-1], flush=True)
    return rows


def verify(study: PowerStudy, tries: int) -> list[dict[str, Any]]:
    """Return how often frames of a camera with one parameter off by its printed error fail."""
    test, rows = study.test(VALIDATION.draws), []
    controls = {one.title: one for one in PARAMETERS}
    for index, change in enumerate(one for one in study.changes if one.title in VERIFIED):
        error = study.detectable(test, change).relative_error
        wrong = [
            study.bench.change(WRONG * (index + 1) + i, controls[change.title], error)
            for i in range(tries)
        ]
        numbers = [own for own, _ in (one for one in wrong if one is not None)]
        fails = [any(not one.passed for one in test.statistics(own)) for own in numbers]
        rows.append(
            {"parameter": change.title, "error": error, "failed": sum(fails), "tries": tries}
        )
        print(rows[-1], flush=True)
    return rows


def draw(results: Mapping[str, Any]) -> None:
    """Draw the errors found and the seconds against the number of sets, and the verification."""
    rows: Sequence[Mapping[str, Any]] = results["chart"]
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    errors, seconds = figure.subplots(1, 2, width_ratios=(3, 2))
    draws = [row["draws"] for row in rows]
    verified = {
        row["parameter"]: f" ({row['failed']}/{row['tries']} failed)" for row in results["verified"]
    }
    for index, name in enumerate(rows[0]["errors"]):
        values = [
            np.nan if (error := row["errors"][name]) is None else 100.0 * error for row in rows
        ]
        style = {"color": f"C{index % 10}", "linestyle": "--" if index >= 10 else "-"}
        errors.plot(
            draws, values, marker="o", markersize=3, label=name + verified.get(name, ""), **style
        )
    ticks = (1, 2, 5, 10, 20, 50, 100)
    errors.set(
        xlabel="simulated sets", ylabel="relative error found in 80 % of sessions, %", yscale="log"
    )
    errors.set_yticks(ticks, [str(tick) for tick in ticks])
    errors.minorticks_off()
    errors.axvline(VALIDATION.draws, color="0.6", linewidth=0.8)
    errors.set_title("power, and frames with that error at the line that failed", fontsize=9)
    figure.legend(
        *errors.get_legend_handles_labels(), loc="outside right center", fontsize=7, frameon=False
    )
    seconds.plot(draws, [row["seconds"] for row in rows], "o-", color="0.2", markersize=3)
    seconds.set(xlabel="simulated sets", ylabel="processor time, s", ylim=(0.0, None))
    seconds.set_title("time of the sets and their test", fontsize=9)
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURE, dpi=100, pil_kwargs={"optimize": True})


def main() -> None:
    """Measure, print, keep and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--camera", default="pulnix-ag5745ef3")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--sets", type=int, default=56)
    parser.add_argument("--tries", type=int, default=20)
    asked = parser.parse_args()
    study = PowerStudy.of(BenchSets(asked.camera, seed=asked.seed), asked.sets)
    print(f"{study.seconds:.2f} s a set", flush=True)
    results = {
        "camera": asked.camera,
        "seed": asked.seed,
        "chart": chart(study),
        "verified": verify(study, asked.tries),
    }
    TABLE.write_text(json.dumps(results, indent=1).replace("NaN", "null") + "\n")
    draw(json.loads(TABLE.read_text()))


if __name__ == "__main__":
    main()
