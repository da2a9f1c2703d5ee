"""The summary of a session, its front page, and the sheet of EMVA 1288."""

from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import charact
from charact.cli.demo_loop import lines
from charact.cli.output import print_result
from charact.reporting import (
    compare_with_truth,
    emva_summary,
    emva_xml,
    fragment,
    in_standard_unit,
    is_tube,
    leading,
    rows_of_file,
    sheet,
    sheet_rows,
    sparkline,
    summary_of,
    verdict,
)
from charact.validation import Statistic, Validation, ValidationControl
from charact.verdict import Finding, judge
from labdata import (
    QUANTITIES,
    Measurement,
    Result,
    load_sensor,
    make_refusal,
    measurement_from_sd,
    result_io,
)
from tests.truth.sessions import session_in_memory

# What people read: the summary of any result fits one screen and hides no doubt; of a session
# every number, of a picture a line for each target and one for all together.


LONG = (
    "the light on the flats is unknown: illuminance_lux or photons_per_px of every flat is "
    "needed, and much more "
) * 3


def everything(stacks: int) -> Result:
    """A value and a refusal of every quantity and unit for each of some stacks, with long notes."""
    measurements = []
    for quantity, known in QUANTITIES.items():
        for unit in known.units:
            for number in range(stacks):
                own = {"method": "m", "stack": f"stack-{number}"}
                flags = ("lag",) if number == 1 else ()
                notes = (
                    (f"lag: {quantity} may be off; what settles it: darks", LONG)
                    if flags
                    else (LONG,)
                )
                measurements.append(
                    measurement_from_sd(
                        quantity, unit, 1.0 + number, 0.01, flags=flags, notes=notes, **own
                    )
                )
                measurements.append(make_refusal(quantity, unit, f"{LONG} {quantity}", **own))
    return Result(measurements=tuple(measurements))


@pytest.mark.parametrize("width", [60, 80, 100])
@pytest.mark.parametrize("stacks", [1, 2, 3, 30])
def test_it_is_at_most_40_lines_of_the_width(stacks, width):
    lines = summary_of(
        everything(stacks), title="measure of " + "a-long-name/" * 9, width=width
    ).splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= width


def test_a_suspect_value_that_is_not_shown_is_counted():
    shown = [
        measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, method="m", stack=f"s{n}")
        for n in range(20)
    ]
    hidden = measurement_from_sd(
        "noise_v", "DN", 1.0, 0.1, method="m", flags=("drift",), notes=("drift: 3 DN",)
    )
    text = summary_of(Result(measurements=(*shown, hidden)), title="t")
    assert "1 of them suspect" in text and "drift: 3 DN" in text


def test_what_does_not_apply_is_counted_and_not_explained():
    refused = make_refusal(
        "ebi", "pe/s/px", "the camera has no tube", method="m", refusal="not-applicable"
    )
    missing = make_refusal("dsnu", "DN", "needs darks", method="m", refusal="missing")
    good = measurement_from_sd("prnu", "%", 1.0, 0.1, method="m")
    text = summary_of(Result(measurements=(good, refused, missing)), title="t")
    assert "1 not applicable" in text and "no tube" not in text and "dsnu: needs darks" in text


def test_one_reason_of_many_stacks_is_said_once():
    refused = [
        make_refusal("snr", "1", f"flat-{n} is saturated", method="m", stack=f"flat-{n}")
        for n in range(6)
    ]
    text = summary_of(Result(measurements=tuple(refused)), title="t")
    assert text.count("saturated") == 1 and "6 stacks" in text


def test_a_file_has_a_line_for_each_target():
    two = [
        measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, method="m", region=(0, n, 9, 9))
        for n in (0, 50)
    ]
    assert len(list(rows_of_file("a.tif", Result(measurements=tuple(two))))) == 2


def test_a_sparkline_of_equal_values_is_flat():
    assert set(sparkline([3.0] * 5)) == {"▁"}
    assert len(sparkline(list(range(100)))) <= 30


def bars(col: int, **fields) -> Measurement:
    own = {
        "method": "bars-forward",
        "frequency_cy_per_px": 0.1,
        "region": (0, col, 20, 20),
        **fields,
    }
    return measurement_from_sd("mtf", "1", 0.8, 0.01, **own)


def together(note: str = "") -> Measurement:
    return measurement_from_sd(
        "mtf50", "cy/px", 0.21, 0.002, method="bars-joint", notes=(note,) if note else ()
    )


def test_a_session_with_targets_in_regions_prints_the_numbers_of_no_region_too(
    capsys: pytest.CaptureFixture,
) -> None:
    gain = measurement_from_sd("covariance_gain", "DN", 11.9, 0.1, method="covariance-sum")
    found = (
        gain,
        bars(0, stack="b1"),
        bars(40, stack="b2"),
        together("Stages: taken as known: pixel."),
    )
    print_result(Result(measurements=found), given="s", verb="v", as_json=False)
    told = " ".join(capsys.readouterr().out.split())
    pieces = (
        "covariance_gain 11.90",
        "b1 0,0,20,20",
        "b2 0,40,20,20",
        "mtf50 0.2100",
        "taken as known: pixel",
    )
    assert all(piece in told for piece in pieces)


def test_the_groups_of_a_picture_have_a_line_each_and_one_together(
    capsys: pytest.CaptureFixture,
) -> None:
    print_result(
        Result(measurements=(bars(0), bars(40), together())), given="f.tif", verb="v", as_json=False
    )
    first, second, third = capsys.readouterr().out.splitlines()
    assert "0,0,20,20" in first and "0,40,20,20" in second
    assert "all together" in third and "mtf50 0.21" in third


def test_sources_of_one_stack_are_told_apart_by_their_place(capsys: pytest.CaptureFixture) -> None:
    own = {"method": "one-frame", "stack": "spots"}
    spots = [
        measurement_from_sd("bloom_diameter", "px", 2.5, 0.1, region=(row, 9, 2, 3), **own)
        for row in (5, 60)
    ]
    halo = measurement_from_sd("halo_diameter", "px", 40.0, 0.1, **own)
    print_result(Result(measurements=(*spots, halo)), given="spots.tif", verb="v", as_json=False)
    _, first, second, third = capsys.readouterr().out.splitlines()
    assert "bloom_diameter" in first and "5,9,2,3" in first and "60,9,2,3" in second
    assert "halo_diameter" in third and "40.00" in third


def test_the_table_of_truths_tells_directions_apart() -> None:
    own = {"method": "point-forward", "stack": "point-3"}
    found = [
        measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, orientation_deg=angle, **own)
        for angle in (0.0, 90.0)
    ]
    _, along_rows, along_columns = lines(
        compare_with_truth(Result(measurements=tuple(found)), {"mtf50": 0.2})
    )
    assert along_rows.startswith("mtf50 along 0 deg ") and along_columns.startswith(
        "mtf50 along 90 deg "
    )


def test_a_bound_that_widens_an_interval_is_the_first_note():
    plain = measurement_from_sd("mtf50", "cy/px", 0.2, 0.001, method="m", notes=("a remark",))
    unseen = Finding(flag="gamma", effect="not seen", remedy="more frames", bound=0.02, sign=1)
    text = summary_of(Result(measurements=(judge(plain, [unseen]),)), title="edge")
    lines = text.splitlines()
    assert lines[1].endswith("ok")
    assert lines[2].startswith("note: gamma: not seen: at most 0.02 cy/px too high, by which")


# The first page says no more than the numbers do.


SESSION = session_in_memory(
    charact.stack(np.zeros((2, 9, 9)), kind) for kind in ("dark", "flat", "flat", "flat", "edge")
)
NOTHING = Result(measurements=(make_refusal("mtf50", "cy/px", "no edge", method="m"),))
UNITS = {"mtf50": "cy/px", "system_gain": "DN/e-", "read_noise": "DN", "prnu": "%"}


def numbers(**flags: tuple[str, ...]) -> Result:
    """Four quantities of a plain camera, with flags by quantity."""
    made = [
        measurement_from_sd(name, unit, 0.2, 0.002, method="m", flags=flags.get(name, ()))
        for name, unit in UNITS.items()
    ]
    return Result(measurements=tuple(made))


def outcome(
    p_value: float = 0.5, size: float | None = None, half: float = 0.1, **more: Any
) -> Validation:
    """A validation of one statistic, with a tolerance of 1 and null and negative control."""
    of_frames = {"title": "blur of frames", "distance": 1.0, "level": 0.01}
    statistic = Statistic(
        **of_frames,
        name="blur",
        p_value=p_value,
        worst="blur of the edge",
        cause="the lens",
        matters="resolution",
        departure=size,
        departure95=None if size is None else (size - half, size + half),
        departure_unit="% of noise",
        tolerance=None if size is None else 1.0,
    )
    controls = tuple(
        ValidationControl(
            name=name,
            title=f"{name} frames",
            statistics=(Statistic(**of_frames, name="point", p_value=more.pop(name, p)),),
        )
        for name, p in (("null", 0.5), ("negative", 1e-9))
    )
    return Validation(
        session="s",
        sensor="fitted",
        seed=0,
        draws=20,
        seconds=1.0,
        statistics=(statistic,),
        controls=controls,
        **more,
    )


@pytest.mark.parametrize(
    ("result", "validation", "status", "words"),
    [
        (numbers(), None, "ok", "Fit for a detector: system_gain within 5 %"),
        (numbers(), outcome(), "ok", "simulated frames agree"),
        (numbers(), outcome(1e-6, size=0.5), "ok", "simulated frames agree"),
        (
            numbers(),
            outcome(1e-6, size=1.5),
            "suspect",
            "The fitted sensor differs by 1.500 ± 0.10",
        ),
        (numbers(), outcome(1e-6, size=4.0), "refused", "Do not trust the fitted sensor: it"),
        (numbers(), outcome(1e-6), "refused", "Do not trust the fitted sensor"),
        (numbers(), outcome(size=0.1, half=2.0), "suspect", "the fitted sensor is undecided"),
        (numbers(), outcome(converged=False), "suspect", "the fitted sensor is undecided"),
        (numbers(prnu=("drift",)), None, "suspect", "Undecided for a detector: prnu is suspect"),
        (numbers(prnu=("clipped",), mtf50=("saturated",)), None, "suspect", "Not enough"),
        (numbers(**dict.fromkeys(UNITS, ("drift",))), None, "refused", "Not enough"),
        (NOTHING, None, "refused", "Not enough for a detector: add flats"),
    ],
)
def test_the_verdict_is_no_better_than_the_numbers(result, validation, status, words):
    found = verdict(SESSION, result, validation)
    assert found.status == status and words in found.heading


def test_a_validation_in_doubt_names_the_fit_first_and_then_the_null_control_alone():
    failed = outcome(null=1e-6, negative=0.5)
    assert failed.verdict == "undecided" and not failed.passed
    assert verdict(SESSION, numbers(), failed).reasons == (
        "a null control did not hold in point: null frames",
        "no negative control was noticed",
    )
    # A negative control that nothing notices is a limit of the validation, no failure.
    assert verdict(SESSION, numbers(), outcome(negative=0.5)).reasons == (
        "no negative control was noticed",
    )
    first, *_ = verdict(SESSION, numbers(), outcome(null=1e-6, converged=False)).reasons
    assert "not-converged" in first


def test_an_answer_names_quantity_flag_finding_and_remedy():
    noted = (
        numbers(prnu=("drift",))
        .measurements[-1]
        .with_(notes=("drift: 3 DN a frame; what settles it: a lamp",))
    )
    found = verdict(SESSION, Result(measurements=(*numbers().measurements[:3], noted)), None)
    assert found.heading == (
        "Undecided for a detector: prnu is suspect (drift): 3 DN a frame; what settles it: a lamp"
    )


def test_the_sheet_of_a_described_tube_is_in_its_units_and_an_ok_value_leads():
    tube = replace(SESSION, camera=load_sensor("gen3-digital-iccd"))
    doubtful, good = (
        measurement_from_sd("mtf50", "cy/px", value, 0.01, method="m", stack=name, flags=flags)
        for value, name, flags in ((0.1, "a", ("drift",)), (0.2, "b", ()))
    )
    assert leading(tube, Result(measurements=(doubtful, good))) == (good,)
    assert sheet(tube, Result(measurements=(good,)))[0].value.endswith("lp/mm at cathode")


def test_correlated_noise_makes_a_tube_of_an_unknown_camera():
    covariance = measurement_from_sd("covariance_gain", "DN", 12.0, 0.1, method="m")
    refused: Measurement = make_refusal("system_gain", "DN/e-", "correlated", method="m")
    assert is_tube(SESSION, Result(measurements=(covariance, refused)))
    assert not is_tube(SESSION, numbers())


def test_the_result_of_one_analysis_replaces_its_quantities_only(tmp_path):
    result_io.save(numbers(), tmp_path)
    again = measurement_from_sd("prnu", "%", 0.5, 0.01, method="m")
    result_io.save_into(Result(measurements=(again,)), tmp_path)
    kept = result_io.load(tmp_path)
    assert kept is not None and {m.quantity: m.value for m in kept.measurements} == {
        "mtf50": 0.2,
        "system_gain": 0.2,
        "read_noise": 0.2,
        "prnu": 0.5,
    }


# The EMVA 1288 summary stands for a camera of white noise, and says for any other why it does not.


PLAIN = {"method": "variance"}


def white(**more):
    return (
        measurement_from_sd("system_gain", "DN/e-", 0.28, 0.001, **PLAIN, **more),
        measurement_from_sd("quantum_efficiency", "%", 45.2, 0.3, **PLAIN),
        measurement_from_sd("read_noise", "DN", 3.1, 0.01, **PLAIN),
        make_refusal("snr_max", "1", "no flat reaches saturation", **PLAIN),
    )


def test_figures_stand_under_the_standards_names_and_what_is_missing_is_named():
    found = emva_summary(Result(measurements=white()))
    assert found is not None and not found["reason"]
    measured = [row for row in found["rows"] if row.text]
    assert [(row.entry.symbol, row.entry.clause) for row in measured] == [
        ("η", "eq. 52"),
        ("K", "eq. 50"),
        ("1/K", "eq. 50"),
        ("σ_y.dark", "eq. 53"),
    ]
    assert measured[1].text.startswith("0.28")
    reasons = {row.entry.element[1]: row.departure for row in found["rows"] if not row.text}
    assert reasons["SNR_max"] == "no flat reaches saturation"
    assert "photons_per_px" in reasons["u_p_min"]


def test_a_ratio_in_decibels_and_the_inverse_gain_carry_their_intervals():
    entries = {entry.symbol: entry for entry in sheet_rows()}
    ratio = measurement_from_sd("snr_max", "1", 100.0, 5.0, **PLAIN)
    shown = in_standard_unit(entries["SNR_max.dB"], ratio)
    assert shown.value == 40.0 and shown.unit == "dB"
    assert np.allclose(shown.interval95, 20 * np.log10(ratio.interval95))
    gain = measurement_from_sd("system_gain", "DN/e-", 0.25, 0.01, **PLAIN)
    inverse = in_standard_unit(entries["1/K"], gain)
    assert inverse.value == 4.0
    assert np.allclose(sorted(1.0 / np.array(gain.interval95)), inverse.interval95)


def test_the_xml_states_symbol_clause_and_what_is_not_to_standard():
    lacking = {"spectrograms": {"figure": "spectrograms", "missing": "4 frames; add 12"}}
    measurements = (*white(), measurement_from_sd("prnu_1288", "%", 1.0, 0.01, **PLAIN))
    result = Result(measurements=measurements, evidence=lacking)
    sheet = ElementTree.fromstring(emva_xml(result, "day"))
    assert sheet.attrib["release"] == "4.0 Linear"
    assert [part.tag for part in sheet.find("sensitivity/K")] == [
        "section",
        "short",
        "symbol",
        "unit",
        "value",
        "low95",
        "high95",
        "clause",
        "status",
    ]
    assert sheet.find("spatial/PRNU1288/not_to_standard").text == "4 frames; add 12"
    assert sheet.find("sensitivity/QE/not_to_standard") is None
    assert sheet.find("sensitivity/SNR_max/value").text == "nan"


def test_an_intensified_camera_gets_a_reason_and_no_figure():
    """Either method: the variance's gain with its flag, or only the covariance gain."""
    gain = measurement_from_sd("covariance_gain", "DN", 40.0, 0.3, method="covariance-sum")
    for measurements in (white(flags=("correlated-noise",)), (gain,)):
        found = emva_summary(Result(measurements=measurements))
        assert found is not None and "rows" not in found and "blur factor" in found["reason"]


def test_without_a_gain_there_is_nothing_to_say():
    assert (
        emva_summary(
            Result(measurements=(make_refusal("system_gain", "DN/e-", "no flats", **PLAIN),))
        )
        is None
    )
    assert "EMVA" not in fragment(Result(measurements=white()))
