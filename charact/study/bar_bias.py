"""Bias and cover of the bar methods cell by cell: `python -m charact.study.bar_bias` prints the table."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from charact.method import Context
from charact.method.registry import METHODS
from charact.study.bar_strips import StripScene
from charact.study.edge import Blur

BLURS = {
    "Gaussian 0.8 px": Blur(sigma_px=0.8),
    "Gaussian 1.5 px": Blur(sigma_px=1.5),
    "tube fc 0.25 n 1.1": Blur(form="exponential", frequency_cy_per_px=0.25, exponent=1.1),
}
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.35, 0.4)
TILTS_DEG = (0.0, 2.0, 8.0)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """How a method did in one cell.

    Parameters
    ----------
    blur, scene
        Name of the blur, and the scene but for its phase.
    bias_percent, standard_error_percent, rms_percent
        Mean error over the truth, its standard error, and the root mean squared error, percent.
    cover68, cover95
        Share of the intervals that hold the truth.
    ok, refused
        Shares of verdicts; a suspect number counts in the bias all the same.
    """

    blur: str
    scene: StripScene
    bias_percent: float
    standard_error_percent: float
    rms_percent: float
    cover68: float
    cover95: float
    ok: float
    refused: float


def cells() -> Iterator[tuple[str, StripScene]]:
    """Every blur at every frequency and tilt; noise white and upright, or blurred behind the gain and turned."""
    for (name, blur), frequency, tilt, blurred in product(BLURS.items(), FREQUENCIES, TILTS_DEG, (False, True)):
        scene = StripScene(blur=blur, frequency_cy_per_px=frequency, angle_deg=tilt)
        yield name, replace(scene, noise_blur_px=0.7, turned=True) if blurred else scene


def measured(name: str, scene: StripScene, method: str, seeds: int, seed: int) -> Cell:
    """Put one method to one scene at phases drawn evenly over a pixel."""
    estimate = METHODS["bars", method].function
    truth = scene.truth_mtf
    rows = []
    for number in range(seeds):
        rng = np.random.default_rng([seed, number])
        stack = replace(scene, phase_px=float(rng.uniform(-0.5, 0.5))).frames_drawn(rng)
        context = Context(seed=number, quick=True, full_scale_dn=scene.full_scale_dn)
        asked = {"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px}
        one = estimate(stack, context=context, **asked).measurements[0]
        if one.value is not None and one.interval68 is not None and one.interval95 is not None:
            held = [low <= truth <= high for low, high in (one.interval68, one.interval95)]
            rows.append((one.value, *held, one.status == "ok"))
    table = np.array(rows, float).reshape(-1, 4)
    error = 100.0 * (table[:, 0] / truth - 1.0)
    return Cell(
        blur=name,
        scene=scene,
        bias_percent=float(error.mean()),
        standard_error_percent=float(error.std() / np.sqrt(max(len(error), 1))),
        rms_percent=float(np.sqrt(np.mean(error**2))),
        cover68=float(table[:, 1].mean()),
        cover95=float(table[:, 2].mean()),
        ok=float(table[:, 3].sum() / seeds),
        refused=1.0 - len(table) / seeds,
    )


def line(cell: Cell) -> str:
    """One cell as a row of the table."""
    scene = cell.scene
    return (
        f"{cell.blur:19s} {scene.frequency_cy_per_px:5.2f} {scene.angle_deg:4.0f} {scene.noise_blur_px:5.1f} "
        f"{scene.truth_mtf:7.4f} {cell.bias_percent:+8.2f} {cell.standard_error_percent:6.2f} {cell.rms_percent:7.1f} "
        f"{cell.cover68:5.2f} {cell.cover95:5.2f} {cell.ok:5.2f} {cell.refused:5.2f}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure every cell and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", default="bars-forward")
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    print("blur                cy/px tilt grain     MTF   bias %  se %   rms %   68%   95%    ok  refused")
    done = []
    for name, scene in cells():
        done.append(measured(name, scene, asked.method, asked.seeds, asked.seed))
        print(line(done[-1]), flush=True)
    told = [cell for cell in done if cell.scene.truth_mtf > 0.05]
    print(
        f"{len(told)} cells of MTF over 0.05: 68 % intervals hold {np.mean([c.cover68 for c in told]):.3f}, 95 % "
        f"{np.mean([c.cover95 for c in told]):.3f}; largest bias beyond 1 % in standard errors "
        f"{max((abs(c.bias_percent) - 1) / c.standard_error_percent for c in told):.1f}"
    )


if __name__ == "__main__":
    import charact.mtf  # noqa: F401  (registers the methods)

    main()
