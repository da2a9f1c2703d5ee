"""Fidelity against speed: the worst moment error of every tier of the simulator and its frames a
second.

`make study NAME=frontier` measures both and writes chart and tables into docs/simulator. Errors are
those of flats of a camera like the case study's, without fixed patterns and finely digitised,
against Campbell's theorem for pulses that fall anywhere; speed is that of the case study itself,
768 x 493, every stage on, an uneven scene, one thread.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.plain_chain import PlainChain
from benchmarks.scenes import uneven
from benchmarks.simulator import median_seconds, seconds_a_frame
from labdata import Camera, load_sensor
from tests.simulate import pulse_theory as events
from tests.simulate.conftest import PLAIN
from tests.simulate.samplers import SAMPLERS, Sampler
from tests.simulate.test_moments import BLOCKS, measured_flat

PAGE = Path("docs/validation/simulator.md")
CHART = Path("docs/pictures/simulator/frontier.png")
LEVELS = (0.05, 0.5, 5.0, 50.0, 500.0)
# Moments and the error that each may have; the worst error is counted in these.
TOLERANCES = {"mean": 1e-3, "variance": 5e-3, "skewness": 2e-2, "quantile": 5e-3}
WORDS = {"mean": "mean", "variance": "variance", "skewness": "skewness", "quantile": "99.9 % level"}
# Frames of 240 x 320 pixels in one of twenty blocks, by tier.
AFFORDED: dict[Sampler, int] = {"chain": 6, "fast": 60, "normal": 60}
COLOURS = {"chain": "#4477aa", "fast": "#ee6677", "normal": "#228833"}


@dataclass(frozen=True)
class Point:
    """A tier at a light level: its moments' errors with standard errors, in per cent, and the worst
    in tolerances.
    """

    level: float
    errors: dict[str, tuple[float, float]]

    @property
    def worst(self) -> float:
        """Largest error in units of its tolerance, two standard errors taken off."""
        return max(
            max(abs(error) - 2.0 * sigma, 0.0) / (100.0 * TOLERANCES[name])
            for name, (error, sigma) in self.errors.items()
        )


def measured(tier: Sampler) -> list[Point]:
    """Moments of flats by a tier, exponential pulse heights."""
    points = []
    for level in LEVELS:
        found, error, step_e = measured_flat(_camera(), level, AFFORDED[tier], 1, tier)
        truth = events.of_sensor(_camera())
        expected = events.campbell(truth, level / truth.rows_summed, step_e=step_e)
        points.append(
            Point(
                level,
                {
                    name: tuple(
                        100.0 * part / abs(getattr(expected, name))
                        for part in (
                            getattr(found, name) - getattr(expected, name),
                            getattr(error, name),
                        )
                    )
                    for name in TOLERANCES
                },
            )
        )
    return points


def _camera() -> Camera:
    sheet = load_sensor("pulnix-ag5745ef3")
    small = replace(
        sheet,
        ccd=replace(sheet.ccd, rows=240, columns=320),
        video=replace(sheet.video, bit_depth=16),
    )
    return small.with_values(PLAIN)


def speeds() -> dict[tuple[str, float], float]:
    """Frames a second of every tier at low, middling and high light, and of plain NumPy and
    OpenCV.
    """
    found = {
        (tier, level): 1.0
        / seconds_a_frame(level, sampler=tier, frames=4 if tier == "chain" else 60)
        for tier in SAMPLERS
        for level in (0.1, 1.0, 10.0, 100.0)
    }
    plain = {
        ("plain NumPy and OpenCV", level): 1.0 / median_seconds(PlainChain(uneven(level)).frame, 20)
        for level in (0.1, 1.0, 10.0, 100.0)
    }
    return found | plain


def table(points: Mapping[Sampler, list[Point]], fps: dict[tuple[str, float], float]) -> str:
    """Both tables, for the page."""
    lines = [
        "| frames a second, one thread | 0.1 pe/px | 1 pe/px | 10 pe/px | 100 pe/px |",
        "|---|---|---|---|---|",
        *(
            f"| {name} | "
            + " | ".join(f"{fps[name, level]:.3g}" for level in (0.1, 1.0, 10.0, 100.0))
            + " |"
            for name in (*points, "plain NumPy and OpenCV")
        ),
        "",
        "| sampler | pe/px | "
        + " | ".join(f"{WORDS[name]}, % of it" for name in TOLERANCES)
        + " | worst, in tolerances |",
        "|---|---|" + "---|" * (len(TOLERANCES) + 1),
    ]
    for tier, measured_points in points.items():
        for point in measured_points:
            cells = " | ".join(
                f"{error:+.2f} ± {sigma:.2f}" for error, sigma in point.errors.values()
            )
            lines.append(f"| {tier} | {point.level:g} | {cells} | {point.worst:.2g} |")
    allowed = ", ".join(f"{WORDS[name]} {100.0 * share:g} %" for name, share in TOLERANCES.items())
    lines += [
        "",
        f"Tolerances: {allowed}; ± is one standard error, and two are taken off before the worst "
        f"is counted. Each flat has {240 * 320 * BLOCKS * AFFORDED['fast'] / 1e6:.0f} million "
        f"pixels ({240 * 320 * BLOCKS * AFFORDED['chain'] / 1e6:.0f} million stage by stage).",
    ]
    return "\n".join(lines)


def draw(points: Mapping[Sampler, list[Point]], fps: dict[tuple[str, float], float]) -> None:
    """Draw the chart: one point for each tier, its speed at ten photoelectrons and its worst error
    at each level.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.2, 4.4), layout="constrained")
    floor = 0.02
    for tier, measured_points in points.items():
        speed, worst = fps[tier, 10.0], [max(point.worst, floor) for point in measured_points]
        axes.plot([speed] * len(worst), worst, "o", color=COLOURS[tier], alpha=0.45)
        axes.plot(
            speed, max(worst), "D", color=COLOURS[tier], label=f"{tier}: {speed:.3g} frames/s"
        )
        below = 0.0
        for point, height in sorted(
            zip(measured_points, worst, strict=True), key=lambda pair: pair[1]
        ):
            if np.log10(height) - below > 0.11 or below == 0.0:
                axes.annotate(
                    f"{point.level:g} pe/px",
                    (speed, height),
                    (6, -3),
                    textcoords="offset points",
                    fontsize=7,
                )
                below = np.log10(height)
    plain = fps["plain NumPy and OpenCV", 10.0]
    axes.axvline(plain, color="0.5", lw=1, ls=":")
    axes.text(
        plain, 0.028, " plain NumPy and OpenCV\n (errors not comparable)", fontsize=7, color="0.35"
    )
    axes.axhline(1.0, color="0.3", lw=1, ls="--")
    axes.text(0.99, 1.08, "tolerance", fontsize=8, ha="right", transform=axes.get_yaxis_transform())
    fastest = max(fps[tier, 10.0] for tier in points)
    axes.set(xscale="log", yscale="log", ylim=(0.6 * floor, None), xlim=(None, 1.8 * fastest))
    axes.text(
        0.5,
        floor,
        "no error beyond two standard errors",
        fontsize=7,
        va="center",
        color="0.35",
        transform=axes.get_yaxis_transform(),
    )
    axes.set(
        xlabel="frames a second, 768 x 493, 10 pe/px, one thread",
        ylabel="worst moment error, in tolerances",
    )
    axes.set_title("Fidelity against speed: lower right is better")
    axes.legend(fontsize=8)
    axes.grid(which="major", alpha=0.3)
    CHART.parent.mkdir(exist_ok=True)
    figure.savefig(CHART, dpi=130)
    plt.close(figure)


def main() -> None:
    """Measure, draw, and write the tables into the page."""
    fps = speeds()
    points: dict[Sampler, list[Point]] = {tier: measured(tier) for tier in SAMPLERS}
    draw(points, fps)
    begin, end = "<!-- frontier -->", "<!-- end frontier -->"
    text = PAGE.read_text()
    chart = "![Worst moment error against frames a second](simulator/frontier.png)"
    body = "\n\n".join((begin, chart, table(points, fps), end))
    PAGE.write_text(re.sub(f"{begin}.*{end}", lambda _: body, text, flags=re.S))
    print(table(points, fps))


if __name__ == "__main__":
    main()
