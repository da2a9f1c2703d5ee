"""How often the intervals of the edge methods hold, over regions of mixed blur, noise and light:
`make study NAME=edge-coverage`.
"""

import argparse
import json
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import charact.estimators.mtf  # registers the methods
from benchmarks.studies.chart import write_json
from benchmarks.studies.harness import judge_measurement
from benchmarks.studies.stability import one_thread_each
from charact.method import Context
from charact.method.registry import methods_of_kind
from labdata import FrameStack
from tests.truth.blur import TrueBlur
from tests.truth.edge import EdgeScene

TABLE = Path(__file__).with_name("tables") / "edge_coverage.json"
METHODS = ("edge-parametric", "edge-free", "edge-slanted", "edge-gradient", "edge-forward")
# Most regions for each method: enough to tell a quarter of a percent for the one that promises
# most; the forward fit takes longest.
MOST = {**dict.fromkeys(METHODS, 1000), "edge-parametric": 4000, "edge-forward": 200}


def draw_mixed_scene(seed: int) -> EdgeScene:
    """Return a scene of mixed blur, direction, size, noise and light inside the declared scope."""
    rng = np.random.default_rng([seed, 7])
    form = str(rng.choice(["gaussian", "exponential", "moffat", "halo"]))
    blur = TrueBlur(
        form="gaussian" if form == "halo" else form,  # pyright: ignore[reportArgumentType]
        sigma_px=float(rng.uniform(0.5, 1.8)),
        frequency_cy_per_px=float(rng.uniform(0.15, 0.4)),
        exponent=float(rng.uniform(1.05, 1.8)),
        moffat_px=float(rng.uniform(1.0, 3.0)),
        moffat_exponent=float(rng.uniform(1.5, 4.0)),
        halo_share=float(rng.uniform(0.05, 0.25)) if form == "halo" else 0.0,
        halo_px=float(rng.uniform(15.0, 40.0)),
    )
    dark = float(rng.uniform(1500.0, 3000.0))
    return EdgeScene(
        blur=blur,
        rows=int(rng.integers(90, 161)),
        cols=int(rng.integers(90, 161)),
        angle_deg=float(rng.choice([0, 90, 180, 270]) + rng.choice([-1, 1]) * rng.uniform(3, 12)),
        offset_px=float(rng.uniform(-2, 2)),
        dark_dn=dark,
        bright_dn=dark + 1500.0,
        snr=float(np.exp(rng.uniform(np.log(5), np.log(50)))),
        shot_share=float(rng.choice([0.0, 0.8])),
        noise_blur_px=float(rng.choice([0.0, 0.0, 0.5, 0.9])),
        gradient=float(rng.uniform(-0.1, 0.1)) if rng.random() < 0.3 else 0.0,
        black_dn=200.0,
        full_scale_dn=dark + 1500.0 if rng.random() < 0.1 else 65535.0,
    )


@dataclass(frozen=True, kw_only=True)
class EdgeTrial:
    """What a method made of one frame."""

    method: str
    status: str
    relative_error: float | None
    covers68: bool | None
    covers95: bool | None
    silent: bool
    seconds: float


def _trial(method: str, scene: EdgeScene, stack: FrameStack, context: Context) -> EdgeTrial:
    found = methods_of_kind("edge")[method].function(stack, context=context).find("mtf50")[0]
    if found.value is None or found.interval68 is None:
        return EdgeTrial(
            method=method,
            status=found.status,
            relative_error=None,
            covers68=None,
            covers95=None,
            silent=False,
            seconds=found.seconds or 0.0,
        )
    truth = scene.truth_mtf50
    verdict = judge_measurement(found, truth)
    return EdgeTrial(
        method=method,
        status=found.status,
        relative_error=found.value / truth - 1.0,
        covers68=bool(found.interval68[0] <= truth <= found.interval68[1]),
        covers95=verdict["covers"],
        silent=verdict["silent"],
        seconds=found.seconds or 0.0,
    )


def measure_mixed_scene(
    seed: int, methods: Sequence[str], *, quick: bool = True
) -> list[EdgeTrial]:
    """Put the methods to one frame of a mixed scene."""
    scene = draw_mixed_scene(seed)
    stack = scene.frames_drawn(np.random.default_rng([seed, 8]))
    return [_trial(method, scene, stack, Context(quick=quick, seed=seed)) for method in methods]


def coverage_row(trials: Sequence[EdgeTrial], method: str) -> dict[str, Any]:
    """Return how often the intervals of one method hold, over all its numbers and over those that
    are ok.
    """
    own = [trial for trial in trials if trial.method == method]
    numbers = [trial for trial in own if trial.relative_error is not None]
    sure = [trial for trial in numbers if trial.status == "ok"]
    return {
        "method": method,
        "regions": len(own),
        "ok": len(sure),
        "suspect": len(numbers) - len(sure),
        "refused": len(own) - len(numbers),
        "covers68": float(np.mean([bool(trial.covers68) for trial in sure])),
        "covers95": float(np.mean([bool(trial.covers95) for trial in sure])),
        "silent": sum(trial.silent for trial in own),
        "rms_percent": 100.0
        * float(np.sqrt(np.mean([(trial.relative_error or 0.0) ** 2 for trial in sure]))),
        "median_seconds": float(np.median([trial.seconds for trial in own])),
    }


def study(regions: int, methods: Sequence[str] = METHODS) -> dict[str, Any]:
    """Put the methods to mixed regions on all cores.

    Parameters
    ----------
    regions
        Number of regions.
    """
    counts = {method: min(regions, MOST.get(method, regions)) for method in methods}
    with (
        one_thread_each(),
        ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool,
    ):
        trials = []
        for count in sorted(set(counts.values())):
            own = [method for method in methods if counts[method] == count]
            trials += [
                one
                for each in pool.map(
                    partial(measure_mixed_scene, methods=own), range(count), chunksize=4
                )
                for one in each
            ]
    return {
        "charact": charact.__version__,
        "coverage": [coverage_row(trials, method) for method in methods],
        "seeds": {method: [0, count] for method, count in counts.items()},
        "quick": True,
    }


def main() -> None:
    """Run the study, print it and write the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.edge_coverage", description=__doc__
    )
    parser.add_argument(
        "--regions", type=int, default=max(MOST.values()), help="most regions for a method"
    )
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write")
    parser.add_argument(
        "--methods", default=",".join(METHODS), help="names of edge methods, commas between"
    )
    asked = parser.parse_args()
    found = study(asked.regions, tuple(asked.methods.split(",")))
    for row in found["coverage"]:
        print(
            json.dumps(
                {
                    key: round(value, 4) if isinstance(value, float) else value
                    for key, value in row.items()
                }
            )
        )
    write_json(asked.out, found)


if __name__ == "__main__":
    main()
