"""The report holds every number with its unit, interval, verdict and reason, and asks nothing of
the network.
"""

import re
import sys
from base64 import b64encode
from dataclasses import replace
from html import unescape
from importlib.resources import files

import numpy as np
import pytest

from charact.reporting import (
    FIGURES,
    bright_region,
    compare_with_truth,
    corner_svg,
    figure_of,
    page,
    quantity_groups,
    representative,
    round_to_spread,
    varying,
    write,
)
from charact.reporting.frequency_unit import FrequencyUnit
from charact.reporting.session_page import write_pdf
from charact.reporting.tables import bases
from labdata import (
    FLAGS,
    QUANTITIES,
    BadInput,
    Conditions,
    FrameStack,
    Posterior,
    Result,
    make_measurement,
    measurement_from_sd,
)
from labdata.measurement import Provenance
from labdata.session import About
from tests.truth.sessions import session_in_memory, stack_in_memory


@pytest.fixture(scope="module")
def html(made) -> str:
    return page(
        made.session(),
        made.result(),
        truth={"mtf50": 0.19, "mtf": lambda f, angle: np.exp(-((f / 0.26) ** 1.18))},
    )


def _text(html: str) -> str:
    return unescape(re.sub(r"<[^>]+>", " ", html))


def test_every_measurement_is_there_with_its_title_unit_method_and_verdict(made, html):
    table = _text(html[html.index('id="quantities"') : html.index('id="frames"')])
    for m in made.result().measurements:
        assert QUANTITIES[m.quantity].title.split(" at the stated")[0] in table
        assert m.quantity in table
        assert m.method in table
        assert m.unit in table
        assert m.status in table


def test_every_flag_stands_with_its_sentence_and_every_refusal_with_its_reason(made, html):
    text = _text(html)
    assert FLAGS["lag"] in text
    assert FLAGS["prior-bound"] in text
    assert made.reason in text
    assert made.note in text


def test_the_making_of_the_numbers_is_recorded(made, html):
    text = _text(html)
    for piece in ("9.8.7", "77", "window_px", "21", made.digest, "edge-1.tif", "numpy", made.wires):
        assert piece in text


def test_the_page_asks_nothing_of_the_network(html):
    assert not re.search(r"https?:|//[a-z]|\bsrc=|@import|<script|<link|<iframe", html)
    assert not re.search(r"url\((?!#)", html)
    assert set(re.findall(r'href="(.)', html)) <= {"#", "d"}


def test_labels_from_outside_are_escaped(made):
    hostile = made.result().find("covariance_gain")[0].with_(stack=made.hostile)
    evidence = {f"edge-spread:{made.hostile}": {"figure": "edge-spread", "why": made.hostile}}
    written = page(made.session(made.hostile), Result(measurements=(hostile,), evidence=evidence))
    assert "<script>alert" not in written
    assert "&lt;script&gt;" in written


def test_evidence_of_an_unknown_or_broken_kind_is_told_and_not_drawn(html):
    text = " ".join(_text(html).split())
    assert "Not plotted: no figure of the kind 'of-tomorrow'" in text
    assert "Not plotted: its data cannot be plotted" in text


def test_z_is_the_distance_in_standard_errors_of_the_side_the_truth_is_on():
    lopsided = make_measurement("mtf50", "cy/px", 0.20, None, (0.19, 0.24), method="m")
    below, above = (
        compare_with_truth(Result(measurements=(lopsided,)), {"mtf50": truth})[0].z
        for truth in (0.18, 0.22)
    )
    assert below == pytest.approx(0.02 / 0.01 * 1.96, rel=1e-3)
    assert above == pytest.approx(-0.02 / 0.04 * 1.96, rel=1e-3)


@pytest.mark.parametrize(
    ("value", "spread", "text"),
    [
        (0.18024, 0.0095, "0.1802"),
        (3.51, 0.03, "3.510"),
        (1234.6, 25.0, "1235"),
        (123456.0, 2500.0, "1.235 × 10⁵"),
        (3.5e-11, 2e-12, "3.50 × 10⁻¹¹"),
        (0.0, 0.01, "0.000"),
        (float("inf"), None, "∞"),
        (5.0, float("inf"), "5.000"),
    ],
)
def test_a_number_has_two_digits_of_its_uncertainty(value, spread, text):
    assert round_to_spread(value, spread) == text


def test_a_corner_plot_names_its_parameters_with_units_and_skips_those_that_do_not_vary(made):
    draws = np.column_stack([made.posterior().draws[:, 0], np.full(400, 2.0)])
    constant = Posterior(names=("tube_frequency", "fixed"), units=("cy/px", "px"), draws=draws)
    assert varying(constant) == (0,)
    assert "(cy/px)" in corner_svg(made.posterior(), "edge")
    assert "No parameter varies" in corner_svg(
        Posterior(names=("fixed",), units=("px",), draws=np.ones((9, 1))), "none"
    )


def test_a_region_is_drawn_with_the_worst_verdict_of_its_numbers(made):
    region = (10, 20, 60, 80)
    good = measurement_from_sd(
        "mtf50", "cy/px", 0.2, 0.01, method="m", stack="edge-1", region=region
    )
    written = page(made.session(), Result(measurements=(good, good.with_(flags=("low-signal",)))))
    assert "m: suspect" in written
    assert "m: ok" not in written


def test_a_pdf_without_its_library_ends_in_one_sentence_with_the_install_command(
    made, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(BadInput, match=r"pip install 'charact\[pdf\]'"):
        write(made.session(), Result(), tmp_path / "r.html", pdf=True)


def test_paper_has_a_figure_a_page_and_the_pictures_of_both_places(tmp_path, monkeypatch):
    weasyprint = pytest.importorskip("weasyprint")
    figure = '<figure><svg viewBox="0 0 56 38"><path d="M0 0L9 9"/></svg></figure>'
    picture = '<figure><svg class="picture" viewBox="0 0 9 9">{}</svg></figure>'
    html = (
        f"<style>{(files('charact.reporting') / 'templates/style.css').read_text()}</style><main>"
        + picture.format('<image id="frame-1" href="data:image/png;base64,AA" width="9"/>')
        + picture.format('<use href="#frame-1"/>')
        + '<details class="chapter drawn"><summary>MTF</summary><div id="mtf"></div>'
        + f'<div class="figures">{3 * figure}</div></details></main>'
    )
    printed = []

    class Html(weasyprint.HTML):
        def write_pdf(self, target: str) -> None:
            printed.append(self.render())

    monkeypatch.setattr(
        "weasyprint.HTML", lambda string: printed.append(string) or Html(string=string)
    )
    write_pdf(html, tmp_path / "r.pdf")
    text, document = printed
    assert text.count("<image") == 2 and "<use" not in text
    assert [page.width > page.height for page in document.pages] == [False, True, True, True]


def test_the_head_states_what_session_or_options_do(made, tmp_path):
    logo = tmp_path / "logo.png"
    logo.write_bytes(b"a logo")
    about = About(serial_number="SN <7>", operator="bench 2", logo=str(logo))
    head = page(replace(made.session(), about=about), Result()).partition("<nav>")[0]
    assert "SN &lt;7&gt;" in head and "bench 2" in head and b64encode(b"a logo").decode() in head
    plain = page(made.session(), Result()).partition("<nav>")[0]
    assert "Serial number" not in plain and "Remarks" not in plain and "<img" not in plain
    for name, rule in (("logo.txt", "must be a picture"), ("none.png", "must exist")):
        wrong = replace(made.session(), about=About(logo=str(tmp_path / name)))
        with pytest.raises(BadInput, match=rule):
            page(wrong, Result())


def test_a_leading_value_states_method_stack_region_and_seed():
    m = measurement_from_sd(
        "mtf50",
        "cy/px",
        0.2,
        0.01,
        method="edge-free",
        stack="edge-3",
        region=(10, 20, 30, 40),
        provenance=Provenance(version="1", seed=7),
    )
    ((title, basis),) = bases((m,))
    assert (title, basis) == (
        "MTF50 (cy/px)",
        "edge-free, edge-3, rows 10–39, cols 20–59, seed 7",
    )


def test_spatial_frequencies_of_a_figure_are_in_the_unit_of_the_page():
    data = {
        "curve_cy_per_px": [0.0, 0.25, 0.5],
        "curve": [1.0, 0.5, 0.1],
        "curve_low95": [1.0, 0.4, 0.0],
        "curve_high95": [1.0, 0.6, 0.2],
        "frequency_cy_per_px": [0.1],
        "mtf": [0.8],
        "sd": [0.01],
    }
    svg = figure_of("bar-groups", data, FrequencyUnit(unit="lp/mm", pitch_x_um=8.0)).svg or ""
    pattern = r'<text x="([\d.]+)"[^>]*text-anchor="middle">([^<]+)<'
    at = {words: float(x) for x, words in re.findall(pattern, svg)}
    # The label stands below the middle of the axis, 0.25 cycles per pixel of 8 µm: 31.25 lp/mm.
    middle = at["frequency (lp/mm)"]
    assert (at["50"] - middle) / (middle - at["0"]) == pytest.approx(18.75 / 31.25, abs=0.005)


def test_the_picture_of_a_small_target_is_cut_around_it():
    mean = np.full((120, 160), 10.0)
    mean[50:60, 70:85] = 100.0
    row, col, height, width = bright_region(mean)
    assert row < 50
    assert row + height > 60
    assert col < 70
    assert col + width > 85
    assert height < 40
    assert bright_region(np.full((12, 16), 3.0)) == (0, 0, 12, 16)


def test_what_is_noted_of_some_stacks_of_a_series_names_them():
    own = {"method": "three-dimensional"}
    quiet = [
        measurement_from_sd(
            "noise_t", "DN", 0.0, 1.0, stack=f"flat-{n}", notes=(f"at most {n} DN",), **own
        )
        for n in range(6)
    ]
    shaded = [
        measurement_from_sd("noise_v", "DN", 9.0, 1.0, stack=f"flat-{n}", notes=("shading",), **own)
        for n in range(6)
    ]
    (group,) = quantity_groups(Result(measurements=(*quiet, *shaded)))
    assert dict(group["notes"])["at most 3 DN"] == "noise_t of flat-3"
    assert dict(group["notes"])["shading"] == "noise_v"
    (group,) = quantity_groups(Result(measurements=(*quiet, *shaded[:5])))
    assert dict(group["notes"])["shading"] == "noise_v of flat-0, flat-1, flat-2, flat-3 and 1 more"


def test_the_picture_of_a_kind_is_of_its_most_exposed_stack():
    def chosen(*stacks: tuple[float, Conditions]) -> str:
        held_stacks = tuple(
            stack_in_memory(
                "flat", FrameStack(data=np.full((1, 4, 4), level)), conditions, label=str(number)
            )
            for number, (level, conditions) in enumerate(stacks)
        )
        (picture,) = representative(session_in_memory(held_stacks), ())
        return picture.title

    lit = Conditions(illuminance_lux=1e-4, exposure_s=0.01)
    assert (
        chosen((1.0, lit), (2.0, Conditions(illuminance_lux=1e-4, exposure_s=0.02))) == "1 (flat)"
    )
    assert chosen((1.0, lit), (2.0, Conditions(illuminance_lux=1e-3, gate_ns=1e5))) == "0 (flat)"
    assert (
        chosen((1.0, Conditions(photons_per_px=9.0)), (2.0, Conditions(photons_per_px=20.0)))
        == "1 (flat)"
    )
    assert chosen((1.0, lit), (2.0, Conditions(exposure_s=0.01))) == "1 (flat)"
    assert chosen((2.0, Conditions()), (1.0, Conditions())) == "0 (flat)"


def test_the_picture_of_flats_is_not_of_a_saturated_one():
    rng = np.random.default_rng(1)
    data = [
        np.minimum(rng.poisson(level, (3, 32, 40)), 255).astype(np.uint8)
        for level in (90, 140, 900)
    ]
    flats = [
        stack_in_memory("flat", FrameStack(data=frames, full_scale_dn=255.0), label=f"flat-{n}")
        for n, frames in enumerate(data)
    ]
    (picture,) = representative(session_in_memory(flats), ())
    assert picture.title == "flat-1 (flat)"
    (picture,) = representative(session_in_memory(flats[2:]), ())
    assert picture.title == "flat-2 (flat)"


def test_the_evidence_of_every_drawn_kind_has_axes_with_units():
    spread, level = [0.0, 1.0, 2.0], {"label": ["p1", "p2"]}
    twice = {key: [spread, spread] for key in ("radius_px", "mean_dn", "sd_dn", "model_dn")}
    ring = {f"ring_{key}": spread for key in ("px", "dn", "sd_dn", "model_dn")}
    along = {
        f"along_{way}_{kind}": spread for way in ("row", "column") for kind in ("dn", "model_dn")
    }
    band = dict.fromkeys(("value", "low95", "high95"), spread)
    axis = {"frequency_cy_per_column": spread, "cathode_lp_per_mm": spread}
    stages = {**axis, "stages": {"lens": band}, "product": band, "measured": band}
    examples = {
        "edge-spread": {
            "distance_px": spread,
            "value_dn": spread,
            "sd_dn": spread,
            "model_dn": spread,
        },
        "bars": {"distance_px": spread, "value_dn": spread, "model_dn": spread},
        "point-spread": {
            "figure": "point-profile",
            "column_px": spread,
            "row_px": spread,
            **along,
            **ring,
        },
        "point-profile": {**level, **twice, "used": [[True] * 3] * 2, "halo_diameter_px": 3.0},
        "bloom-series": {
            **level,
            "bloom_diameter_px": [1, 2],
            "streak_length_px": [1, 2],
            "gate_ns": [1, 1],
        },
        "halo-constancy": {
            **level,
            "halo_diameter_px": [None, 3.0],
            "interval95_px": [None, [2.0, 4.0]],
        },
        "agreement": {
            "pair": ["bars - edge", "edge - point", "bars - edge"],
            "frequency_cy_per_px": spread,
            "difference": spread,
            "half_width": spread,
        },
        "photon-transfer": {
            "signal_dn": spread,
            "variance_dn2": spread,
            "covariance_gain_dn": 2.0,
            "blur_factor": 0.5,
        },
        "noise-spectrum": {
            "radius_cy_per_px": spread,
            "angle_deg": [0, 90, 45],
            "power_dn": spread,
            "power_sd_dn": spread,
            "model_dn": spread,
            "used": [True, True, False],
            "variance_over_signal_dn": 0.3,
        },
        "post-gain-noise": {
            "column_cy_per_px": [0.1, 0.2, 0.0],
            "row_cy_per_px": [0.0, 0.01, 0.2],
            "power_dn2": spread,
            "dark_dn2": [0.0] * 3,
            "white_dn2": [0.1] * 3,
            "pulses_dn2": spread,
        },
        "autocorrelation": {
            "neighbour_correlation": spread,
            "neighbour_sd": spread,
            "lag_exposures": spread,
            "lag_correlation": spread,
            "lag_correlation_sd": spread,
        },
        "predictive-frames": {
            "stack": ["a", "a", "b"],
            "sign": ["tail", "rows", "tail"],
            "measured": spread,
            "expected": [0.1] * 3,
            "sd": [0.1] * 3,
        },
        "snr-light": {
            "least_snr": 1.0,
            "unit": "lux",
            "gains": [
                {
                    "gain": "plate at 800 V",
                    "unit": "lux",
                    "amount": [1e-5, 1e-4],
                    "fitted": [True, False],
                    "scopes": [
                        {
                            "name": "pixel",
                            "snr": [0.5, 4.0],
                            "snr_sd": [0.1, 0.1],
                            "law_amount": [1e-6, 1e-3],
                            "law_low": [0.1, 9.0],
                            "law_snr": [0.2, 10.0],
                            "law_high": [0.3, 11.0],
                            "law_with_pattern": [0.2, 8.0],
                            "minimum": 3e-5,
                            "minimum_interval95": [2e-5, 4e-5],
                        }
                    ],
                }
            ],
        },
        "noise-against-gain": {
            "knob": "plate voltage",
            "knob_unit": "V",
            "logarithmic": True,
            "setting": [700.0, 800.0, 850.0],
            "gain_dn": [1, 2, 3],
            "gain_relative_sd": [0.1, 0.1, 0.1],
            "joint_interval95_dn": [[1, 2, 3], [2, 3, 4]],
            "law_setting": [700.0, 850.0],
            "law_gain_dn": [1, 3],
            "law_interval95_dn": [[0.9, 2.9], [1.1, 3.1]],
            "stated_noise_dn": [[1, 2], [1.1, 2.2], [1.2, 2.4]],
            "stated_signal_pe": 1.0,
            "dark_noise_dn": [2.0, None, 2.1],
            "read_noise_dn": 1.9,
            "knee_setting": [720.0, 730.0, 745.0],
        },
        "noise-by-gain": {
            "setting": ["700 V", "800 V"],
            "signal_dn": [spread[1:], spread[1:]],
            "noise_dn": [spread[1:], spread[1:]],
            "light": [None, spread[1:]],
            "light_unit": "lx",
        },
        "three-dimensional-noise": {
            "exposure_mean_dn": spread,
            "row_mean_dn": spread,
            "column_mean_dn": spread,
            "exposure_period_s": 0.04,
            "frequency_cy_per_exposure": spread,
            "power_dn2": spread,
        },
        "pulse-heights": {
            "edge_dn": [-1.0, 0.0, 1.0, 2.0],
            "density_per_dn": [0.1, 0.4, 0.1],
            "value_dn": [-0.5, 0.5, 1.5],
            "law_per_dn": [0.1, 0.4, 0.1],
            "noise_per_dn": [0.1, 0.4, 0.01],
            "response_to_mean_pulse_dn": 1.0,
            "values": 1000,
            "filter_px": [3, 3],
        },
        "bloom-forms": {
            "table": [{"form": "tube core, disc", "parameters": 6, "bic_over_best": 0.0}]
        },
        "bloom-smear": {
            "label": ["a", "b"],
            "light_per_row_dn": [1.0, 2.0],
            "level_dn": [0.1, 0.2],
            "level_sd_dn": [0.1, 0.1],
        },
        "bloom-constancy": {
            "label": ["a", "b"],
            "background_dn": [1.0, 1.1],
            "background_sd_dn": [0.1, 0.1],
            "row_px": [[1.0, 1.1], [1.0, None]],
            "col_px": [[2.0, 2.1], [2.0, None]],
        },
        "bloom-frames": {
            "label": ["a"],
            "frame_dn": [np.ones((40, 40))],
            "row": [20.0],
            "col": [20.0],
            "dark_dn": [0.0],
            "full_scale_dn": [255.0],
            "halo_diameter_px": 20.0,
            "bloom_diameter_px": [8.0],
            "streak_length_px": [None],
        },
        "bloom-map": {
            "signal_dn": np.ones((20, 20)),
            "fraction": np.ones((20, 20)),
            "sd": np.ones((20, 20)),
            "near_px": 3.0,
        },
        "lit-edge": {
            "label": ["a"],
            "distance_px": [[1, 2]],
            "mean_dn": [[5, 4]],
            "sd_dn": [[1, 1]],
            "used": [[True, True]],
            "model_dn": [[5, 4]],
            "edge_px": 0.0,
            "halo_diameter_px": 3.0,
        },
        "joint-mtf": {
            "kind": ["edge", "bars"],
            "target": ["edge", "bars-0.1"],
            "residuals_sd": [spread, [0.3]],
        },
        "constancy": {
            "slopes": {"row_px": 0.0},
            "row_px": spread,
            "mtf50_cy_per_px": spread,
            "sd_cy_per_px": spread,
            "mean_mtf50_cy_per_px": 1.0,
        },
        "stage-budget": {
            "identified": ["lens"],
            "known": [],
            "horizontal": stages,
            "vertical": stages,
        },
        "bar-groups": {
            "frequency_cy_per_px": spread,
            "mtf": spread,
            "sd": spread,
            "curve_cy_per_px": spread,
            "curve": spread,
            "curve_low95": spread,
            "curve_high95": spread,
        },
        "limiting-resolution": {
            "illuminance_lux": spread[1:],
            "directions": [
                {
                    "orientation_deg": 0.0,
                    "limit_lp_per_mm": spread[1:],
                    "limit_interval95": [[one, one] for one in spread[1:]],
                    "frequency_lp_per_mm": spread,
                    "contrast": [spread for _ in spread[1:]],
                }
            ],
        },
        "signal-transfer": {
            "blackbody_c": spread,
            "mean_dn": spread,
            "mean_sd_dn": spread,
            "law_c": spread,
            "law_mean_dn": spread,
            "law": "8-12 µm",
            "background_c": 22.0,
            "residual_k": spread,
        },
        "sfr": {
            **dict.fromkeys(("frequency_cy_per_px", "mtf", "sfr"), spread),
            "method": "edge-parametric",
        },
        "neq": {
            "frequency_cy_per_px": spread,
            "neq_per_px": spread,
            "interval95": [spread, spread],
        },
        "through-focus": dict.fromkeys(("focus_mm", "mtf50_cy_per_px", "sd_cy_per_px"), spread),
        "linearity": dict.fromkeys(
            ("photons", "signal_dn", "fitted_photons", "line_dn", "deviation_percent"), spread
        ),
        "signal-to-noise-ratio": {
            **dict.fromkeys(("photons", "snr"), spread[1:]),
            **dict.fromkeys(("electrons_per_photon", "dark_e2", "dsnu_e", "prnu"), 0.5),
            "threshold_photons": 1.0,
            "saturation_photons": 9.0,
        },
        "dark-current": dict.fromkeys(
            ("exposure_s", "mean_dn", "mean_sd_dn", "variance_dn2", "variance_sd_dn2"), spread
        ),
        "spectrograms": {
            f"{name}_{unit}": spread[1:] if name in ("horizontal", "vertical") else 0.5
            for name in ("horizontal", "vertical", "temporal", "measured", "1288")
            for unit in ("dn", "percent")
        },
        "profiles": {
            **dict.fromkeys(("horizontal_px", "vertical_px"), len(spread)),
            **{
                f"{stack}_{way}_{name}_dn": spread
                for stack in ("dark", "bright")
                for way in ("horizontal", "vertical")
                for name in ("largest", "least", "middle", "mean")
            },
        },
        "defect-histograms": dict.fromkeys(
            (
                "deviation_dn",
                "deviation_percent",
                *(
                    f"{name}_of_{part}"
                    for name in ("pixels", "normal", "share")
                    for part in ("dsnu", "prnu")
                ),
            ),
            spread,
        ),
    }
    assert examples.keys() == FIGURES.keys()
    for kind, data in examples.items():
        figure = figure_of(kind, {"figure": kind, **data})
        assert figure.svg is not None, (kind, figure.refusal_reason)
        texts = re.findall(r"<text[^>]*>([^<]*)</text>", figure.svg)
        unit = r"\((px|DN|DN²|1|.*px\)?|.*cycles.*|.*fitted.*|standard deviations\))"
        assert any(re.search(unit, text) for text in texts), kind
