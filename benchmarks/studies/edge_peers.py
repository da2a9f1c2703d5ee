"""Edge methods beside other programs on the same edge: `make study NAME=edge-peers` measures ours,
writes the table and the chart.

One Gaussian edge under white noise, from a step of a hundred standard deviations down to one.
"""

import argparse
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

import charact.estimators.mtf  # registers the methods
from benchmarks.studies.chart import write_json
from benchmarks.studies.cramer_rao import least_relative_sd
from benchmarks.studies.figures import COLOURS, plain_numbers, pyplot
from benchmarks.studies.harness import judge_measurement
from charact.method import Context
from charact.method.registry import methods_of_kind
from labdata import FrameStack
from tests.truth.blur import TrueBlur
from tests.truth.edge import EdgeScene

TABLE = Path(__file__).with_name("tables") / "edge_peers.json"
FIGURE = Path("docs/pictures/mtf/edge-peers.png")
# Frames for each method at each noise; the forward fit takes longest.
FRAMES = {
    "edge-parametric": 600,
    "edge-free": 600,
    "edge-forward": 60,
    "edge-slanted": 600,
    "edge-gradient": 600,
}
SNRS = (100.0, 30.0, 10.0, 5.0, 2.0, 1.0)
EDGE = EdgeScene(
    blur=TrueBlur(sigma_px=0.8),
    rows=256,
    cols=64,
    angle_deg=5.0,
    dark_dn=1100.0,
    bright_dn=1250.0,
    shot_share=0.0,
)


def scene_of(snr: float, seed: int) -> tuple[EdgeScene, FrameStack]:
    """Return the edge at a random phase, and a frame of it under white noise, not digitised.

    Parameters
    ----------
    snr
        Step over the standard deviation of the noise, dimensionless.
    seed
        Seed of phase and noise.
    """
    rng = np.random.default_rng([seed, round(snr)])
    scene = replace(EDGE, offset_px=float(rng.uniform(-1, 1)), snr=snr)
    mean = scene.light() + scene.black_dn
    noise = (scene.bright_dn - scene.dark_dn) / snr * rng.standard_normal(mean.shape)
    return scene, FrameStack(data=(mean + noise)[None], full_scale_dn=1e9)


@dataclass(frozen=True, kw_only=True)
class Peer:
    """Another program as it was measured on this edge.

    Parameters
    ----------
    name
        Name and version.
    rms_percent, rms_mtf
        Root-mean-square error of MTF50 in % of it, and of the MTF below Nyquist, by step over
        noise; where a program rejects every frame, or was not measured, there is nothing.
    without_noise_percent
        Error of MTF50 without noise, %.
    seconds
        Time for one region, s.
    seldom
        Steps over noise at which it rejects part of the frames.
    remark
        What the numbers leave out.
    """

    name: str
    rms_percent: Mapping[float, float]
    rms_mtf: Mapping[float, float]
    without_noise_percent: float
    seconds: float
    seldom: tuple[float, ...] = ()
    remark: str = ""


# Measured on the same edge (Gaussian of 0.8 px, pixel, 5 degrees, 256 x 64 px, white noise), each
# program as it is installed and with its own defaults, on two cores with one thread each.
PEERS = (
    Peer(
        name="sfrmat5 (C++)",
        rms_percent={30.0: 1.5, 10.0: 5.3, 5.0: 24.0, 2.0: 75.0, 1.0: 81.0},
        rms_mtf={30.0: 0.012, 10.0: 0.041, 5.0: 0.12},
        without_noise_percent=0.0,
        seconds=0.0007,
    ),
    Peer(
        name="MTF Mapper 0.7.38",
        rms_percent={30.0: 0.87, 10.0: 2.7, 5.0: 5.5, 2.0: 15.8, 1.0: 49.0},
        rms_mtf={30.0: 0.007, 10.0: 0.022, 5.0: 0.040, 2.0: 0.11, 1.0: 0.40},
        without_noise_percent=0.17,
        seconds=0.1,
        remark="a process for each frame; 47 to 51 % at a step of one standard deviation",
    ),
    Peer(
        name="quickMTF (PyPI)",
        rms_percent={30.0: 2.7, 10.0: 3.9, 5.0: 6.7},
        rms_mtf={},
        without_noise_percent=2.4,
        seconds=0.008,
        seldom=(5.0,),
        remark="5 of 16 frames rejected at a step of five standard deviations, all at two and one",
    ),
)


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a method made of one frame: errors and cover are None where it refused."""

    method: str
    status: str
    relative_error: float | None
    covers95: bool | None
    rms_mtf: float | None
    seconds: float


def answer(method: str, scene: EdgeScene, stack: FrameStack, seed: int) -> Answer:
    """Put a method to a frame."""
    result = methods_of_kind("edge")[method].function(stack, context=Context(quick=True, seed=seed))
    found, curve = result.find("mtf50")[0], result.curves.get("mtf")
    away = None
    if found.value is not None and curve is not None:
        frequency = np.asarray(curve.frequency_cy_per_px)
        below = frequency <= 0.5
        away = np.asarray(curve.value)[below] - scene.blur.mtf(frequency[below], scene.angle_deg)
    return Answer(
        method=method,
        status=found.status,
        relative_error=None if found.value is None else found.value / scene.truth_mtf50 - 1.0,
        covers95=judge_measurement(found, scene.truth_mtf50).get("covers"),
        rms_mtf=None if away is None else float(np.sqrt(np.mean(away**2))),
        seconds=found.seconds or 0.0,
    )


def answers(seed: int, snr: float, frames: Mapping[str, int]) -> list[Answer]:
    """Put every method that wants so many frames to the frame of a seed."""
    scene, stack = scene_of(snr, seed)
    return [answer(method, scene, stack, seed) for method, count in frames.items() if seed < count]


def without_noise(methods: Iterable[str], phases: int = 5) -> dict[str, float]:
    """Return the RMS error of MTF50 of each method over phases of the edge without noise, %."""
    errors: dict[str, list[float]] = {method: [] for method in methods}
    for phase in np.arange(phases) / phases:
        scene = replace(EDGE, offset_px=float(phase))
        stack = FrameStack(data=(scene.light() + scene.black_dn)[None], full_scale_dn=1e9)
        for method, own in errors.items():
            own.append(100.0 * (answer(method, scene, stack, 0).relative_error or 0.0))
    return {method: float(np.sqrt(np.mean(np.square(own)))) for method, own in errors.items()}


def row(given: Sequence[Answer], snr: float) -> dict[str, Any]:
    """Return the RMS errors of one method at one noise over the frames that gave a number, beside
    the bound.
    """
    numbers = [one for one in given if one.relative_error is not None]
    curves = [one.rms_mtf for one in numbers if one.rms_mtf is not None]
    rms = _rms([100.0 * (one.relative_error or 0.0) for one in numbers])
    return {
        "method": given[0].method,
        "snr": snr,
        "frames": len(given),
        "numbers": len(numbers),
        "ok": sum(one.status == "ok" for one in given),
        "rms_percent": rms,
        "ratio": None if rms is None else rms / bound(snr)["rms_percent"],
        "bias_percent": 100.0 * float(np.mean([one.relative_error or 0.0 for one in numbers]))
        if numbers
        else None,
        "covers95": float(np.mean([bool(one.covers95) for one in numbers])) if numbers else None,
        "rms_mtf": _rms(curves),
        "median_seconds": float(np.median([one.seconds for one in given])),
    }


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


@cache
def bound(snr: float) -> dict[str, float]:
    """Return the least RMS errors of MTF50, %, and of the MTF below Nyquist that an unbiased
    estimator can have.

    Notes
    -----
    A Gaussian of unknown width, place, direction and levels. Its whole curve follows from its
    width, so that the error of the curve is that of MTF50 times the curve's change with it.
    """
    scene, _ = scene_of(snr, 0)
    relative = least_relative_sd(scene)
    frequency, little = np.linspace(0.0, 0.5, 101), 1e-3
    wide, narrow = (
        replace(scene.blur, sigma_px=scene.blur.sigma_px + sign * little) for sign in (1, -1)
    )
    change = wide.mtf(frequency, scene.angle_deg) - narrow.mtf(frequency, scene.angle_deg)
    of_half = wide.mtf50(scene.angle_deg) - narrow.mtf50(scene.angle_deg)
    curve = relative * scene.truth_mtf50 * float(np.sqrt(np.mean((change / of_half) ** 2)))
    return {"snr": snr, "rms_percent": 100.0 * relative, "rms_mtf": curve}


def study(
    frames: Mapping[str, int], snrs: Sequence[float] = SNRS, workers: int | None = None
) -> dict[str, Any]:
    """Measure our methods on the edge that the peers were measured on.

    Parameters
    ----------
    frames
        Frames for each method at each noise.
    snrs
        Steps over the standard deviation of the noise.
    workers
        Processes; None: one for each core.
    """
    rows = []
    with ProcessPoolExecutor(max_workers=workers or os.cpu_count()) as pool:
        for snr in snrs:
            drawn = pool.map(
                partial(answers, snr=snr, frames=frames), range(max(frames.values())), chunksize=5
            )
            given = [one for each in drawn for one in each]
            rows += [row([one for one in given if one.method == method], snr) for method in frames]
    return {
        "charact": charact.__version__,
        "edge": "Gaussian sigma 0.8 px, pixel aperture, 5 degrees, 256 x 64 px, white noise",
        "ours": rows,
        "without_noise_percent": without_noise(frames),
        "bound": [bound(snr) for snr in snrs],
        "peers": [asdict(peer) for peer in PEERS],
        "seeds": {method: [0, count] for method, count in frames.items()},
        "quick": True,
    }


def main() -> None:
    """Run the study, print it, write table and figure."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.edge_peers", description=__doc__
    )
    parser.add_argument(
        "--frames", type=int, help="frames for each method at each noise; else as many as are usual"
    )
    parser.add_argument("--workers", type=int, help="processes; else one for each core")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write")
    parser.add_argument("--figure", type=Path, default=FIGURE, help="figure to write, PNG")
    parser.add_argument(
        "--draw", action="store_true", help="draw the table that is there; measure nothing"
    )
    asked = parser.parse_args()
    if asked.draw:
        found = json.loads(asked.out.read_text())
    else:
        found = study(
            {method: asked.frames or count for method, count in FRAMES.items()},
            workers=asked.workers,
        )
        write_json(asked.out, found)
    for each in (*found["ours"], *found["bound"]):
        print(
            json.dumps(
                {
                    key: round(value, 4) if isinstance(value, float) else value
                    for key, value in each.items()
                }
            )
        )
    from benchmarks.studies.edge_peers import plot_peers

    plot_peers(found, asked.figure)


THEIRS = ("#333333", "#777777", "#aaaaaa")
PANELS = (
    ("rms_percent", "RMS error of MTF50 (% of the truth)"),
    ("rms_mtf", "RMS error of the MTF below 0.5 cy/px (1)"),
)
# Share of frames with a number from which a mark is full.
MOSTLY = 0.95


def plot_peers(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `benchmarks.studies.edge_peers.study`; other programs are dashed.

    Parameters
    ----------
    found
        The table.
    path
        Where the PNG goes.
    """
    figure, panels = pyplot().subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
    for panel, (quantity, label) in zip(panels, PANELS, strict=True):
        _draw_panel(panel, found, quantity)
        panel.set(
            xscale="log",
            yscale="log",
            xlabel="step / standard deviation of the noise (1)",
            ylabel=label,
        )
        plain_numbers(panel.xaxis, panel.yaxis)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", frameon=False, fontsize=8)
    figure.suptitle(
        f"{found['edge']}\nopen marks: fewer than {MOSTLY:.0%} of the frames gave a number",
        fontsize=9,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot().close(figure)
    return path


def _draw_panel(panel: Any, found: Mapping[str, Any], quantity: str) -> None:
    """One quantity: our methods, the other programs and the bound."""
    methods = list(dict.fromkeys(row["method"] for row in found["ours"]))
    for method, colour in zip(methods, cycle(COLOURS), strict=False):
        rows = [
            row for row in found["ours"] if row["method"] == method and row[quantity] is not None
        ]
        panel.plot(
            [row["snr"] for row in rows],
            [row[quantity] for row in rows],
            color=colour,
            label=method,
        )
        for row in rows:
            full = row["numbers"] >= MOSTLY * row["frames"]
            panel.plot(
                row["snr"],
                row[quantity],
                "o",
                color=colour,
                markerfacecolor=colour if full else "white",
                markersize=4.5,
            )
    for peer, colour, mark in zip(found["peers"], THEIRS, ("s", "D", "^"), strict=True):
        # Keys of JSON objects are text.
        points = {float(snr): value for snr, value in peer[quantity].items()}
        panel.plot(
            points.keys(),
            points.values(),
            f"{mark}--",
            color=colour,
            markersize=4.5,
            label=peer["name"],
        )
        for snr in points.keys() & peer["seldom"]:
            panel.plot(
                snr, points[snr], mark, color=colour, markerfacecolor="white", markersize=4.5
            )
    panel.plot(
        [row["snr"] for row in found["bound"]],
        [row[quantity] for row in found["bound"]],
        ":",
        color="black",
        linewidth=1.8,
        label="Cramer-Rao bound",
    )


if __name__ == "__main__":
    main()
