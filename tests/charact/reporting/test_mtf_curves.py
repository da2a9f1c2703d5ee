"""Curves are drawn in the unit asked for, under plain names, and labels beside their edge."""

import numpy as np
import pytest

from charact.reporting.annotated_image import place_captions
from charact.reporting.frequency_unit import FrequencyUnit
from charact.reporting.mtf_curves import curve_title, plot_files
from labdata import Curve, Result, measurement_from_sd

FREQUENCY = np.linspace(0.0, 0.5, 51)
UNIT = FrequencyUnit(unit="lp/mm", pitch_x_um=10.0, pitch_y_um=20.0)


def result_of(normal_deg: float, name: str = "mtf") -> Result:
    """The straight MTF 1 - f of an edge along columns (0 deg) or rows (90 deg)."""
    mtf50 = measurement_from_sd(
        "mtf50", "cy/px", 0.5, 0.01, method="edge-slanted", orientation_deg=normal_deg
    )
    curve = Curve(frequency_cy_per_px=FREQUENCY, value=1.0 - FREQUENCY)
    return Result(measurements=(mtf50,), curves={name: curve})


@pytest.mark.parametrize(("normal_deg", "per_cycle"), [(0.0, 100.0), (90.0, 50.0)])
def test_a_curve_is_drawn_in_the_unit_of_its_direction(normal_deg, per_cycle):
    (axes,) = plot_files({"a.tif": result_of(normal_deg)}, frequency=UNIT).axes
    drawn = axes.lines[0]
    assert axes.get_xlabel() == "spatial frequency (lp/mm)"
    assert drawn.get_ydata() == pytest.approx(1.0 - drawn.get_xdata() / per_cycle)
    assert axes.get_xlim()[1] == pytest.approx(0.5 * per_cycle)


def test_points_and_curves_of_files_are_in_one_unit():
    point = measurement_from_sd(
        "mtf", "1", 0.6, 0.01, method="bars", frequency_cy_per_px=0.2, stack="bars"
    )
    one = result_of(0.0)
    bars = Result(measurements=(*one.measurements, point), curves=one.curves)
    (axes,) = plot_files({"a.tif": bars}, frequency=UNIT).axes
    (marker,) = (line for line in axes.lines if len(line.get_xdata()) == 1)
    assert marker.get_xdata()[0] == pytest.approx(20.0)
    (axes,) = plot_files({"a.tif": one, "b.tif": result_of(90.0)}, frequency=UNIT).axes
    assert [line.get_xdata()[-1] for line in axes.lines[:2]] == pytest.approx([50.0, 25.0])
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a.tif", "b.tif"]


@pytest.mark.parametrize(
    "name",
    [
        "mtf",
        "mtf_vertical",
        "mtf_bars",
        "mtf_joint_vertical",
        "mtf_post_gain_free",
        "mtf_post_gain_vertical_free",
    ],
)
def test_a_legend_is_words(name):
    (axes,) = plot_files({"": result_of(0.0, name)}).axes
    (text,) = axes.get_legend().get_texts()
    assert text.get_text() == curve_title(name)
    assert "_" not in text.get_text() and ("columns" in text.get_text()) == ("vertical" in name)


@pytest.mark.parametrize("normal_deg", [5.0, 95.0, 175.0])
@pytest.mark.parametrize("box", [(0, 0, 1300, 1560), (100, 300, 500, 700), (40, 40, 1000, 400)])
def test_the_label_of_an_edge_does_not_lie_on_it(normal_deg, box):
    size = (44, 160)
    (place,) = place_captions([box], [size], (1352, 1560), [normal_deg])
    top, left, bottom, right = (*place, place[0] + size[0], place[1] + size[1])
    row, col = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
    # The edge passes through the middle of its region, its distance from a point along the normal.
    theta = np.deg2rad(normal_deg)
    corners = [
        (y - row) * np.sin(theta) + (x - col) * np.cos(theta)
        for y in (top, bottom)
        for x in (left, right)
    ]
    assert min(corners) > 0.0 or max(corners) < 0.0
