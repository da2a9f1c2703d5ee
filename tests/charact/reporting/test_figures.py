"""Figures are tested through the numbers that they draw."""

import re

import numpy as np
import pytest

from charact.reporting import (
    add_extent_data,
    as_svg,
    blooms,
    corner,
    curves,
    figure_of,
    noise,
    plot_bloom_frames,
    plot_bloom_map,
    report_style,
    style,
    white_style,
)
from labdata import Posterior, Result, measurement_from_draws, measurement_from_sd
from tests.truth.bloom import bloom_session
from tests.truth.bloom_extents import truth
from tests.truth.bloom_light import BloomScene

# Figures of blooming draw the numbers they are given, and stay whole where some of them are
# missing.


SCENE = BloomScene(frames=2)
OVERLOADS = (0.3, 30.0, 3000.0)
LABELS = [f"point-{n}" for n in range(3)]
NAMES = ("core_sd", "halo_diameter", "elastic_share", "halo_fraction")


def series() -> dict:
    return {
        "figure": "bloom-series",
        "label": LABELS,
        "overload": list(OVERLOADS),
        "overload_known": True,
        "illuminance_lux": [1e-6 * one for one in OVERLOADS],
        "gate_ns": [1.6e7] * 3,
        "bloom_diameter_px": [0.0, 7.4, 48.0],
        "streak_length_px": [0.0, 8.0, 48.0],
        "dark_dn": [12.0] * 3,
        "full_scale_dn": [255.0] * 3,
    }


def result() -> Result:
    draws = np.tile([np.sqrt(1.3**2 - 1 / 12), 46.0, 0.3, 0.1], (20, 1))
    posterior = Posterior(names=NAMES, units=("px", "px", "1", "1"), draws=draws)
    halo = measurement_from_draws(
        "halo_diameter", "px", draws[:, 1], method="made", posterior=posterior
    )
    bloom = [
        measurement_from_sd("bloom_diameter", "px", value, 0.2, method="made", stack=label)
        for label, value in (("point-1", 7.4), ("point-2", 48.0))
    ]
    return Result(measurements=(halo, *bloom), evidence={"bloom-series": series()})


@pytest.fixture(scope="module")
def evidence(seed) -> dict:
    return add_extent_data(bloom_session(SCENE, OVERLOADS, np.random.default_rng(seed)), result())


def test_measured_extents_and_their_intervals_are_drawn_with_the_halo(evidence):
    data = evidence["bloom-series"]
    assert data["measured"]["bloom_diameter"]["point-2"][0] == 48.0
    axes = blooms.plot_bloom_series(data).axes[0]
    drawn = [
        container for container in axes.containers if container.get_label() == "half of full scale"
    ]
    assert drawn[0].lines[0].get_xydata()[1].tolist() == [3000.0, 48.0]
    assert any(line.get_label().startswith("halo, 46.0") for line in axes.lines)
    assert "px" in axes.get_ylabel() and "overload" in axes.get_xlabel()


def test_the_line_through_the_diameters_is_what_the_spread_makes_of_a_point(evidence):
    foretold = evidence["bloom-series"]["foretold"]
    at, middle = np.array(foretold["overload"]), np.array(foretold["bloom_diameter"][1])
    scene = BloomScene(background_dn=0.0)
    for overload in (3.0, 30.0, 3000.0):
        expected = truth(scene, overload)["bloom_diameter"]
        assert np.interp(np.log(overload), np.log(at), middle) == pytest.approx(expected, rel=0.02)


def test_frames_show_source_bloom_and_halo_at_their_places(evidence):
    data = evidence["frames of the point series"]
    assert data["row"][0] == pytest.approx(SCENE.centre[0], abs=0.5)
    assert data["col"][0] == pytest.approx(SCENE.centre[1], abs=0.5)
    axes = plot_bloom_frames(data).axes[2]
    assert [round(patch.width) for patch in axes.patches] == [46, 48]
    tint = axes.images[1].get_array()
    assert (tint[..., 3] > 0).sum() == pytest.approx(
        truth(SCENE, 3000.0)["saturated_area"], rel=0.1
    )


def test_a_map_greys_what_is_unknown():
    fraction = np.full((40, 50), 0.3)
    fraction[:10] = np.nan
    data = {
        "signal_dn": np.ones((40, 50)),
        "fraction": fraction,
        "sd": 0.1 * fraction,
        "near_px": 3.0,
        "sources": [{"row": 5.0, "col": 6.0, "known": False}],
    }
    with white_style():
        axes = plot_bloom_map(data).axes
    shown = axes[1].images[0].get_array()
    assert np.ma.getmaskarray(shown).sum() == 500
    assert axes[0].lines[0].get_marker() == "x"


@pytest.mark.parametrize("missing", ["measured", "halo_px", "foretold"])
def test_a_series_is_drawn_without_what_a_method_does_not_give(evidence, missing):
    data = {key: value for key, value in evidence["bloom-series"].items() if key != missing}
    assert figure_of("bloom-series", data).svg


# Figures of the stage budget and of a curve through bar groups draw the numbers they are given.


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


# What figures say is whole: no text is cut at the rim of its figure, none lies over another or
# over what it names.


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


def matched_groups(pattern: str, text: str) -> list[str]:
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
    width, height = map(float, matched_groups(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg))
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
        float(place)
        for place in matched_groups(r'd="M ([\d.]+) [\d.]+ *\n?L ([\d.]+)[^"]*" clip', svg)
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
    width, height = map(float, matched_groups(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg))
    for words, left, top, right, bottom in texts(svg):
        assert left > -2 and top > -2 and right < width + 2 and bottom < height + 2, words
    # Semi-axes of the 95 % region of a normal distribution: sqrt(5.991) standard deviations; panel:
    # 0.003 to 0.997.
    (outer,) = matched_groups(r'd="([^"]*)" fill="[^"]*" fill-opacity="0.25"', svg)
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
