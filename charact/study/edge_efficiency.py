"""Edge methods against the Cramer-Rao bound, and how often their intervals hold: `make mtf-study` writes the table.

Two studies with their seeds: one Gaussian edge under white noise from a step of 100 standard deviations down to one, on
the frame size that other programs were measured on; and regions of mixed blur, noise and light.
"""

import argparse
import json
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact.mtf  # registers the methods
from charact.method import Context
from charact.method.registry import of_kind
from charact.study.edge import Blur, EdgeScene
from charact.study.harness import judged
from charact.study.speed_accuracy import write_json
from labdata.frames import FrameStack

TABLE = Path(__file__).resolve().parent / "tables" / "edge_efficiency.json"
METHODS = ("edge-exponential", "edge-parametric", "edge-free", "edge-forward", "edge-slanted")
SNRS = (100.0, 30.0, 10.0, 5.0, 2.0, 1.0)
PEER = EdgeScene(blur=Blur(sigma_px=0.8), rows=256, cols=64, angle_deg=5.0, dark_dn=1100.0, bright_dn=1250.0)


def peer_scene(snr: float, seed: int) -> tuple[EdgeScene, FrameStack]:
    """Return the edge of the peers' table at a random phase, and a frame of it under white noise, not digitised.

    Parameters
    ----------
    snr
        Step over the standard deviation of the noise, dimensionless.
    seed
        Seed of phase and noise.
    """
    rng = np.random.default_rng([seed, round(snr)])
    scene = replace(PEER, offset_px=float(rng.uniform(-1, 1)), snr=snr)
    mean = scene.light() + scene.black_dn
    noise = (scene.bright_dn - scene.dark_dn) / snr * rng.standard_normal(mean.shape)
    return scene, FrameStack(data=(mean + noise)[None], full_scale_dn=1e9)


def cramer_rao(scene: EdgeScene, *, exponent_free: bool) -> float:
    """Return the least standard deviation of MTF50 over MTF50 that an unbiased estimator can have under white noise.

    Parameters
    ----------
    scene
        A Gaussian edge.
    exponent_free
        Whether the exponent of exp(-(f/fc)^n) must be estimated as well, besides blur, place, angle and both levels.

    Notes
    -----
    Fisher information of independent normal pixels, sum of dm/da dm/db over s^2, by differences of the closed form;
    the bound of MTF50 follows from its gradient.
    """
    sd = (scene.bright_dn - scene.dark_dn) / scene.snr
    start = np.array([scene.blur.sigma_px, scene.offset_px, scene.angle_deg, scene.dark_dn, scene.bright_dn, 2.0])
    little = np.array([1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1e-3])[: 6 if exponent_free else 5]

    def at(theta: NDArray[np.floating]) -> EdgeScene:
        sigma, offset, angle, dark, bright, exponent = theta
        cut = np.sqrt(2.0) * np.pi * sigma
        blur = Blur(form="exponential", frequency_cy_per_px=1.0 / cut, exponent=exponent)
        return replace(scene, blur=blur, offset_px=offset, angle_deg=angle, dark_dn=dark, bright_dn=bright)

    slopes, rates = [], []
    for index, size in enumerate(little):
        step = np.eye(6)[index] * size
        up, down = at(start + step), at(start - step)
        slopes.append((up.light() - down.light()).ravel() / (2.0 * size * sd))
        # The truth's own direction: MTF50 along the normal of the edge as it lies.
        rates.append((up.blur.mtf50(scene.angle_deg) - down.blur.mtf50(scene.angle_deg)) / (2.0 * size))
    design, rate = np.array(slopes), np.array(rates)
    return float(np.sqrt(rate @ np.linalg.solve(design @ design.T, rate)) / scene.truth_mtf50)


def mixed_scene(seed: int) -> EdgeScene:
    """Return a scene of mixed blur, direction, size, noise and light inside the declared scope."""
    rng = np.random.default_rng([seed, 7])
    form = str(rng.choice(["gaussian", "exponential", "moffat", "halo"]))
    blur = Blur(
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
class Trial:
    """What a method made of one frame."""

    method: str
    status: str
    relative_error: float | None
    covers68: bool | None
    covers95: bool | None
    silent: bool
    seconds: float


def _trial(method: str, scene: EdgeScene, stack: FrameStack, context: Context) -> Trial:
    found = of_kind("edge")[method].function(stack, context=context).find("mtf50")[0]
    if found.value is None or found.interval68 is None:
        return Trial(
            method=method, status=found.status, relative_error=None, covers68=None, covers95=None, silent=False,
            seconds=found.seconds or 0.0,
        )  # fmt: skip
    truth = scene.truth_mtf50
    verdict = judged(found, truth)
    return Trial(
        method=method,
        status=found.status,
        relative_error=found.value / truth - 1.0,
        covers68=bool(found.interval68[0] <= truth <= found.interval68[1]),
        covers95=verdict["covers"],
        silent=verdict["silent"],
        seconds=found.seconds or 0.0,
    )


def efficient(seed: int, snr: float, methods: Sequence[str]) -> list[Trial]:
    """Put the methods to one frame of the peers' edge."""
    scene, stack = peer_scene(snr, seed)
    return [_trial(method, scene, stack, Context(quick=True, seed=seed)) for method in methods]


def covered(seed: int, methods: Sequence[str], *, quick: bool = True) -> list[Trial]:
    """Put the methods to one frame of a mixed scene."""
    scene = mixed_scene(seed)
    stack = scene.frames_drawn(np.random.default_rng([seed, 8]))
    return [_trial(method, scene, stack, Context(quick=quick, seed=seed)) for method in methods]


def efficiency_rows(trials: Sequence[Trial], snr: float) -> list[dict[str, Any]]:
    """Return RMS error, its ratio to the bound and the share of intervals that hold, method by method."""
    scene, _ = peer_scene(snr, 0)
    bounds = {free: cramer_rao(scene, exponent_free=free) for free in (False, True)}
    rows = []
    for method in dict.fromkeys(trial.method for trial in trials):
        own = [trial for trial in trials if trial.method == method]
        errors = np.array([trial.relative_error for trial in own if trial.relative_error is not None])
        rms = float(np.sqrt(np.mean(errors**2))) if errors.size else None
        rows.append(
            {
                "method": method,
                "snr": snr,
                "frames": len(own),
                "numbers": int(errors.size),
                "rms_percent": None if rms is None else 100.0 * rms,
                "bias_percent": 100.0 * float(errors.mean()) if errors.size else None,
                "bound_percent": 100.0 * bounds[False],
                "bound_exponent_free_percent": 100.0 * bounds[True],
                "ratio": None if rms is None else rms / bounds[False],
                "covers95": float(np.mean([trial.covers95 for trial in own if trial.covers95 is not None]))
                if errors.size
                else None,
            }
        )
    return rows


def coverage_row(trials: Sequence[Trial], method: str) -> dict[str, Any]:
    """Return how often the intervals of one method hold, over all its numbers and over those that are ok."""
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
        "rms_percent": 100.0 * float(np.sqrt(np.mean([(trial.relative_error or 0.0) ** 2 for trial in sure]))),
        "median_seconds": float(np.median([trial.seconds for trial in own])),
    }


def study(frames: int, regions: int, methods: Sequence[str] = METHODS) -> dict[str, Any]:
    """Run both studies on all cores.

    Parameters
    ----------
    frames
        Frames of the peers' edge at each signal-to-noise ratio.
    regions
        Regions of mixed scenes.
    """
    with ProcessPoolExecutor(max_workers=os.cpu_count()) as pool:
        rows = []
        for snr in SNRS:
            drawn = pool.map(partial(efficient, snr=snr, methods=methods), range(frames), chunksize=8)
            rows += efficiency_rows([trial for each in drawn for trial in each], snr)
        drawn = pool.map(partial(covered, methods=methods), range(regions), chunksize=8)
        mixed = [trial for each in drawn for trial in each]
    return {
        "charact": charact.__version__,
        "efficiency": rows,
        "coverage": [coverage_row(mixed, method) for method in methods],
        "seeds": {"frames": [0, frames], "regions": [0, regions]},
        "quick": True,
    }


def main() -> None:
    """Run the studies, print them and write the table."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.edge_efficiency", description=__doc__)
    parser.add_argument("--frames", type=int, default=600, help="frames at each signal-to-noise ratio")
    parser.add_argument("--regions", type=int, default=1000, help="regions of mixed blur, noise and light")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write")
    parser.add_argument("--methods", default=",".join(METHODS), help="names of edge methods, commas between")
    asked = parser.parse_args()
    found = study(asked.frames, asked.regions, tuple(asked.methods.split(",")))
    for row in [*found["efficiency"], *found["coverage"]]:
        print(json.dumps({key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}))
    write_json(asked.out, found)


if __name__ == "__main__":
    main()
