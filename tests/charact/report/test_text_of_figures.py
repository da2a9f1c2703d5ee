"""What figures say is whole: no text is cut at the rim of its figure, none lies over another or over what it names."""

import numpy as np
import pytest
from matplotlib.text import Text

from charact.report import blooms, corner, curves, noise, style
from labdata.measurement import Posterior

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
        {"kind": ["edge", "flat"], "target": ["edge", "flats, vertical"], "residuals_sd": [[0.1, 1.0], [0.0]]},
    ),
    "forms of light": (
        blooms.plot_spread_models,
        {
            "table": [
                {"form": "gaussian core, disc", "parameters": 4, "bic_over_best": over, "foretold_chi2_per_ring": 0.912}
                for over in (0.0, 4853.0)
            ]
        },
    ),
    "smear": (
        blooms.plot_smear,
        {"light_per_row_dn": [3.0, 1e3], "level_dn": [0.0, 0.6], "level_sd_dn": [0.01, 0.13], "label": ["a", "b"]},
    ),
}


def texts(figure) -> list:
    """Boxes of all that is written and seen, in points of the screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    found = [label for axes in figure.axes if axes.get_visible() for label in (axes.xaxis.label, axes.yaxis.label)]
    found += [tick for axes in figure.axes for beside in axes.child_axes for tick in beside.get_yticklabels()]
    found += [text for axes in figure.axes for text in axes.texts]
    return [text.get_window_extent(renderer) for text in found if isinstance(text, Text) and text.get_text().strip()]


@pytest.mark.parametrize("name", FIGURES)
def test_no_label_leaves_its_figure(name):
    drawn, data = FIGURES[name]
    with style.report_style():
        figure = drawn(data)
        boxes, paper = texts(figure), figure.bbox
    assert boxes
    for box in boxes:
        assert box.x0 > -2 and box.y0 > -2
        assert box.x1 < paper.x1 + 2 and box.y1 < paper.y1 + 2


def test_a_corner_says_the_power_of_ten_with_the_unit():
    draws = np.random.default_rng(0).normal([3.6e-6, 5.5e-5, 0.2], [1e-7, 1e-6, 0.01], (400, 3))
    posterior = Posterior(names=("light_lux", "pattern_variance", "gain"), units=("lux", "1", "1"), draws=draws)
    assert corner.parameter_label(posterior, 0) == "light lux\n(10⁻⁶ lux)"
    assert corner.parameter_label(posterior, 1) == "pattern variance\n(10⁻⁵)"
    assert corner.parameter_label(posterior, 2) == "gain\n(1)"
    svg = corner.corner_svg(posterior, "light")
    assert "1e−" not in svg and "3.6" in svg
