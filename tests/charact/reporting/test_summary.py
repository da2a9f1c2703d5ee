"""The summary of any result fits one screen, and hides no doubt."""

import pytest

from charact.reporting.summary import rows_of_file, sparkline, summary
from labdata import QUANTITIES, Result, make_refusal, measurement_from_sd

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
    lines = summary(
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
    text = summary(Result(measurements=(*shown, hidden)), title="t")
    assert "1 of them suspect" in text and "drift: 3 DN" in text


def test_what_does_not_apply_is_counted_and_not_explained():
    refused = make_refusal(
        "ebi", "pe/s/px", "the camera has no tube", method="m", refusal="not-applicable"
    )
    missing = make_refusal("dsnu", "DN", "needs darks", method="m", refusal="missing")
    good = measurement_from_sd("prnu", "%", 1.0, 0.1, method="m")
    text = summary(Result(measurements=(good, refused, missing)), title="t")
    assert "1 not applicable" in text and "no tube" not in text and "dsnu: needs darks" in text


def test_one_reason_of_many_stacks_is_said_once():
    refused = [
        make_refusal("snr", "1", f"flat-{n} is saturated", method="m", stack=f"flat-{n}")
        for n in range(6)
    ]
    text = summary(Result(measurements=tuple(refused)), title="t")
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
