"""What figures say is whole: no text is cut at the rim of its figure, none lies over another or
over what it names.
"""

import re

import numpy as np
import pytest

from charact.reporting import as_svg, blooms, corner, curves, noise, style
from labdata import Posterior

SPREAD = [0.1, 0.1]
FIGURES = {
    "noise in three dimensions": (
        noise.plot_three_dimensional_noise,
        {
            "exposure_mean_dn": [1.0, 2.0, 1.5],
            "row_mean_dn": [1.0, 1.2],
            "column_mean_dn": list(np.linspace(0.0, 1.0, 768)),
            "frequency_cy_per_exposure": [0.1, 0.5],
            "power_dn2": SPREAD,
        },
    ),
    "joint MTF": (
        curves.plot_joint_mtf,
        {
            "kind": ["edge", "flat"],
            "target": ["edge", "flats, vertical"],
            "residuals_sd": [[0.1, 1.0], [0.0]],
        },
    ),
    "forms of light": (
        blooms.plot_spread_models,
        {
            "table": [
                {
                    "form": "gaussian core, disc",
                    "parameters": 4,
                    "bic_over_best": over,
                    "foretold_chi2_per_ring": 0.912,
                }
                for over in (0.0, 4853.0)
            ]
        },
    ),
    "smear": (
        blooms.plot_smear,
        {
            "light_per_row_dn": [3.0, 1e3],
            "level_dn": [0.0, 0.6],
            "level_sd_dn": [0.01, 0.13],
            "label": ["a", "b"],
        },
    ),
}


def number_in(tag: str, *patterns: str) -> float:
    return next(float(found[1]) for pattern in patterns if (found := re.search(pattern, tag)))


def groups(pattern: str, text: str) -> list[str]:
    found = re.search(pattern, text)
    assert found is not None, pattern
    return [str(group) for group in found.groups()]


def texts(svg: str) -> list[tuple[str, float, float, float, float]]:
    """Words, left, top, right and bottom of all texts, a character half as wide as it is high."""
    found = []
    for tag, words in re.findall(r"(<text[^>]*>)([^<]*)</text>", svg):
        size = number_in(tag, r'font-size="([\d.]+)"', r"font(?:-size)?: ([\d.]+)px")
        x = number_in(tag, r' x="(-?[\d.]+)"', r"translate\((-?[\d.]+)")
        y = number_in(tag, r' y="(-?[\d.]+)"', r"translate\(-?[\d.]+ (-?[\d.]+)")
        turn = re.search(r"rotate\((-?[\d.]+)(?: (-?[\d.]+) (-?[\d.]+))?", tag)
        centre = complex(float(turn[2]), float(turn[3])) if turn and turn[2] else complex(x, y)
        anchor = re.search(r"text-anchor[=:] ?\"?(\w+)", tag)
        start = (
            {"start": 0.0, "middle": -0.5, "end": -1.0}[anchor[1] if anchor else "start"]
            * 0.5
            * size
            * len(words)
        )
        ends = np.array(
            [complex(x + start, y), complex(x + start + 0.5 * size * len(words), y - 0.7 * size)]
        )
        if turn:
            ends = centre + (ends - centre) * np.exp(1j * np.deg2rad(float(turn[1])))
        found.append((words, *np.sort(np.real(ends)), *np.sort(np.imag(ends))))
    return [(words, left, top, right, bottom) for words, left, right, top, bottom in found]


@pytest.mark.parametrize("name", FIGURES)
def test_no_text_leaves_its_figure(name):
    drawn, data = FIGURES[name]
    with style.report_style():
        svg = as_svg(drawn(data), name)
    width, height = map(float, groups(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg))
    boxes = texts(svg)
    assert len(boxes) > 6
    for words, left, top, right, bottom in boxes:
        assert left > -2 and top > -2 and right < width + 2 and bottom < height + 2, words


def test_labels_of_the_ticks_stand_at_their_values():
    with style.report_style():
        figure, axes = style.panel(
            xlim=(0.0, 10.0), ylim=(1e-3, 1e3), yscale="log", xlabel="time (s)"
        )
        axes.plot([1.0, 9.0], [0.01, 100.0])
        svg = as_svg(figure, "ticks")
    shown = {
        words: (0.5 * (left + right), 0.5 * (top + bottom))
        for words, left, top, right, bottom in texts(svg)
    }
    across = [shown[words][0] for words in ("0", "2", "4", "10")]
    assert np.interp([2.0, 4.0], [0.0, 10.0], [across[0], across[3]]) == pytest.approx(
        across[1:3], abs=0.2
    )
    up = [shown[words][1] for words in ("10⁻³", "10⁻¹", "10¹", "10³")]
    assert np.diff(up) == pytest.approx([(up[3] - up[0]) / 3.0] * 3, abs=0.2)
    assert up[0] > up[3] and "$" not in svg and shown["time (s)"][1] > shown["0"][1] + 8.0
    # The line ends where the axes say: at a tenth of the width less than its end.
    start, end = (
        float(place) for place in groups(r'd="M ([\d.]+) [\d.]+ *\n?L ([\d.]+)[^"]*" clip', svg)
    )
    assert (start, end) == pytest.approx(
        np.interp([1.0, 9.0], [0.0, 10.0], [across[0], across[3]]), abs=0.3
    )


def test_the_same_figure_has_the_same_bytes():
    drawn, data = FIGURES["noise in three dimensions"]
    with style.report_style():
        assert as_svg(drawn(data), "noise") == as_svg(drawn(data), "noise")


def test_a_corner_plot_holds_its_texts_and_its_region_the_draws():
    draws = np.random.default_rng(1).multivariate_normal(
        [0.2, 5.0], [[1e-4, 0.0], [0.0, 0.04]], 20000
    )
    posterior = Posterior(names=("mtf50", "height_dn"), units=("cy/px", "DN"), draws=draws)
    svg = corner.corner_svg(posterior, "edge")
    width, height = map(float, groups(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg))
    for words, left, top, right, bottom in texts(svg):
        assert left > -2 and top > -2 and right < width + 2 and bottom < height + 2, words
    # Semi-axes of the 95 % region of a normal distribution: sqrt(5.991) standard deviations; panel:
    # 0.003 to 0.997.
    (outer,) = groups(r'd="([^"]*)" fill="[^"]*" fill-opacity="0.25"', svg)
    places = np.array([list(map(float, step.split())) for step in re.split("[ML]", outer)[1:]])
    reach = 1.16 * 2.0 * 2.748  # width of the panel, standard deviations
    half_width = 0.5 * np.ptp(places[:, 0]) / (corner.SIDE - corner.GAP) * reach
    # The smoothing of the histogram, 0.95 bins of 22, adds to the variance.
    assert half_width == pytest.approx(
        np.sqrt(5.991 * (1.0 + (0.95 * reach / corner.BINS) ** 2)), rel=0.05
    )


def test_a_corner_says_the_power_of_ten_with_the_unit():
    draws = np.random.default_rng(0).normal([3.6e-6, 5.5e-5, 0.2], [1e-7, 1e-6, 0.01], (400, 3))
    posterior = Posterior(
        names=("light_lux", "pattern_variance", "gain"), units=("lux", "1", "1"), draws=draws
    )
    assert corner.parameter_label(posterior, 0) == "light lux\n(10⁻⁶ lux)"
    assert corner.parameter_label(posterior, 1) == "pattern variance\n(10⁻⁵)"
    assert corner.parameter_label(posterior, 2) == "gain\n(1)"
    svg = corner.corner_svg(posterior, "light")
    assert "1e−" not in svg and "3.6" in svg
