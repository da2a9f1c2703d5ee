"""Figures of the stage budget and of a curve through bar groups draw the numbers they are given."""

import numpy as np
import pytest

from charact.reporting import curves, figure_of, report_style

FREQUENCY = np.linspace(0.0, 0.5, 51)


def band(value: np.ndarray, half: float = 0.02) -> dict[str, list[float]]:
    return {"value": list(value), "low95": list(value - half), "high95": list(value + half)}


def panel(*, video: bool, after: bool) -> dict:
    lens, pixel = np.exp(-FREQUENCY), np.sinc(FREQUENCY)
    low_pass = 1.0 / (1.0 + FREQUENCY**2) if video else np.ones_like(FREQUENCY)
    known = np.where(FREQUENCY < 0.4, pixel, np.nan)
    return {
        "frequency_cy_per_column": list(FREQUENCY),
        "cathode_lp_per_mm": list(FREQUENCY / 0.018),
        "stages": {"lens": band(lens), "pixel": band(pixel, 0.0), "video": band(low_pass, 0.0)},
        "product": band(lens * pixel * low_pass),
        "measured": band(lens * pixel * low_pass, 0.03),
        # A document holds null where a curve ends.
        **(
            {"product_after_gain": band(pixel), "measured_after_gain": _with_gaps(band(known))}
            if after
            else {}
        ),
    }


def _with_gaps(lines: dict[str, list[float]]) -> dict[str, list]:
    return {name: [None if np.isnan(x) else float(x) for x in line] for name, line in lines.items()}


def budget(after: bool = False) -> dict:
    return {
        "figure": "stage-budget",
        "status": "ok",
        "chance": 0.4,
        "the_curves_say": "identified by the curves: lens",
        "identified": ["lens"],
        "known": ["pixel"],
        "products": [],
        "statement": [],
        "flags": [],
        "horizontal": panel(video=True, after=after),
        "vertical": panel(video=False, after=after),
    }


def drawn(data: dict):
    with report_style():
        figure = curves.plot_mtf_budget(data)
        figure.canvas.draw()
    return figure


def labelled(axes) -> dict[str, tuple[str, np.ndarray]]:
    """Line style and values of every labelled line."""
    return {
        line.get_label(): (line.get_linestyle(), np.asarray(line.get_ydata()))
        for line in axes.get_lines()
        if not line.get_label().startswith("_")
    }


def test_identified_and_known_stages_are_solid_and_the_others_dashed():
    rows, columns = drawn(budget()).axes[:2]
    told = labelled(rows)
    # lp/mm at the photocathode
    assert rows.child_axes[0].get_xlim() == pytest.approx((0.0, 0.5 / 0.018))
    assert {stage: told[stage][0] for stage in ("lens", "pixel", "video")} == {
        "lens": "-",
        "pixel": "-",
        "video": "--",
    }
    assert told["product of all"][1] == pytest.approx(
        np.array(budget()["horizontal"]["product"]["value"])
    )
    # A stage that does nothing in a direction would be a line along the top.
    assert "video" not in labelled(columns)


@pytest.mark.parametrize("after", [True, False])
def test_the_budget_is_drawn_in_the_section_of_the_mtf_with_its_numbers_beside_it(after: bool):
    figure = figure_of("stage budget", budget(after))
    assert figure.section == "mtf"
    assert figure.svg is not None, figure.refusal_reason
    assert ("measured after the gain, 95 %" in figure.svg) == after
    assert figure.caption.endswith("identified by the curves: lens.")


def groups() -> dict:
    return {
        "figure": "bar-groups",
        "frequency_cy_per_px": [0.1, 0.2],
        "mtf": [0.8, 0.5],
        "sd": [0.01, 0.02],
        "curve_cy_per_px": list(FREQUENCY),
        "curve": list(np.exp(-3.0 * FREQUENCY)),
        "curve_low95": list(np.exp(-3.2 * FREQUENCY)),
        "curve_high95": list(np.exp(-2.8 * FREQUENCY)),
    }


def test_bar_groups_stand_on_their_curve_with_arms_of_1_96_standard_errors():
    with report_style():
        axes = curves.plot_bar_groups(groups()).axes[0]
    (bars,) = axes.containers
    assert bars[0].get_xydata() == pytest.approx(np.array([[0.1, 0.8], [0.2, 0.5]]))
    heights = [float(np.ptp(segment[:, 1])) for segment in bars[2][0].get_segments()]
    assert heights == pytest.approx([2 * 1.96 * 0.01, 2 * 1.96 * 0.02], rel=1e-3)
    assert labelled(axes)["curve through the groups, 95 %"][1] == pytest.approx(
        np.exp(-3.0 * FREQUENCY)
    )
    assert figure_of("bar groups, rows", groups()).svg is not None
