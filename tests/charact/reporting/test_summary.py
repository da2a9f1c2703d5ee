"""What people read: the summary of any result fits one screen and hides no doubt; of a session
every number, of a picture a line for each target and one for all together.
"""

import pytest

from charact.cli.demo_loop import lines
from charact.cli.output import print_result
from charact.reporting import compare_with_truth, rows_of_file, sparkline, summary_of
from charact.verdict import Finding, judge
from labdata import QUANTITIES, Measurement, Result, make_refusal, measurement_from_sd

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
