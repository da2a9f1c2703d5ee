"""Verdicts on limits: inside, outside, and everything else."""

from pathlib import Path

import pytest

from charact.comparison import Limit, Limits, check, load_check, load_limits, save_check
from labdata import (
    BadInput,
    Measurement,
    Result,
    from_toml,
    make_measurement,
    make_refusal,
    measurement_from_sd,
    to_toml,
)


def mtf50(low: float, high: float, **fields) -> Measurement:
    """An MTF50 with a 95 % interval."""
    return make_measurement(
        "mtf50", "cy/px", (low + high) / 2, None, (low, high), method="edge-forward", **fields
    )


def verdicts(limit: Limit, *measurements: Measurement) -> list[tuple[str, str]]:
    found = check(Result(measurements=measurements), Limits(limit=(limit,)))
    return [(one.verdict, one.cause) for one in found.outcomes]


@pytest.mark.parametrize(
    ("limits", "verdict", "cause"),
    [
        ({"min": 0.15}, "pass", ""),
        ({"min": 0.18}, "pass", ""),
        ({"max": 0.25}, "pass", ""),
        ({"min": 0.15, "max": 0.25}, "pass", ""),
        ({"min": 0.20}, "undecided", "straddles"),
        ({"min": 0.19, "max": 0.21}, "undecided", "straddles"),
        ({"max": 0.20}, "undecided", "straddles"),
        ({"min": 0.23}, "fail", "outside"),
        ({"max": 0.17}, "fail", "outside"),
        ({"min": 0.23, "max": 0.30}, "fail", "outside"),
    ],
)
def test_a_limit_passes_with_the_whole_interval_and_fails_without_any_of_it(
    limits, verdict, cause
) -> None:
    assert verdicts(Limit(quantity="mtf50", **limits), mtf50(0.18, 0.22)) == [(verdict, cause)]


def test_what_is_suspect_refused_absent_or_without_interval_is_undecided() -> None:
    limit = Limit(quantity="mtf50", min=0.15)
    suspect = mtf50(0.18, 0.22).with_(flags=("low-signal",))
    refused = make_refusal("mtf50", "cy/px", "no edge was found", method="edge-forward")
    bare = make_measurement("mtf50", "cy/px", 0.2, None, None, method="edge-slanted")
    for measurements, cause in (
        ((suspect,), "suspect"),
        ((refused,), "refused"),
        ((), "absent"),
        ((bare,), "no-interval"),
    ):
        assert verdicts(limit, *measurements) == [("undecided", cause)]
    reasons = [
        one.reason
        for one in check(Result(measurements=(suspect, refused)), Limits(limit=(limit,))).outcomes
    ]
    assert reasons == ["the measurement is suspect: low-signal", "not measured: no edge was found"]


def test_a_limit_applies_to_all_measurements_of_its_quantity_stack_and_direction() -> None:
    both = (
        mtf50(0.18, 0.22, stack="edge-1"),
        mtf50(0.10, 0.12, stack="edge-2", orientation_deg=92.0),
    )
    assert verdicts(Limit(quantity="mtf50", min=0.15), *both) == [("pass", ""), ("fail", "outside")]
    assert verdicts(Limit(quantity="mtf50", min=0.15, stack="edge-1"), *both) == [("pass", "")]
    assert verdicts(Limit(quantity="mtf50", min=0.15, orientation_deg=90.0), *both) == [
        ("fail", "outside")
    ]
    assert verdicts(Limit(quantity="mtf50", min=0.15, stack="edge-3"), *both) == [
        ("undecided", "absent")
    ]


def test_a_limit_of_the_mtf_at_one_frequency_disregards_the_others() -> None:
    curve = [
        measurement_from_sd(
            "mtf", "1", value, 0.01, method="edge-forward", frequency_cy_per_px=frequency
        )
        for frequency, value in ((0.1, 0.8), (0.2, 0.5), (0.3, 0.2))
    ]
    assert verdicts(Limit(quantity="mtf", min=0.4, frequency_cy_per_px=0.2), *curve) == [
        ("pass", "")
    ]


def test_a_quantity_that_a_stack_does_not_have_is_no_failure_of_it() -> None:
    refused = make_refusal("mtf50", "cy/px", "not a target", method="x", refusal="not-applicable")
    assert verdicts(Limit(quantity="mtf50", min=0.15), mtf50(0.18, 0.22), refused) == [("pass", "")]
    assert verdicts(Limit(quantity="mtf50", min=0.15), refused) == [("undecided", "refused")]


def test_the_verdict_of_all_is_the_worst() -> None:
    good, unsure, bad = (Limit(quantity="mtf50", min=value) for value in (0.1, 0.2, 0.3))
    result = Result(measurements=(mtf50(0.18, 0.22),))
    assert check(result, Limits(limit=(good, good))).verdict == "pass"
    assert check(result, Limits(limit=(good, unsure))).verdict == "undecided"
    assert check(result, Limits(limit=(unsure, bad))).verdict == "fail"


def test_a_limits_file_is_read_as_written(tmp_path: Path) -> None:
    limits = Limits(
        limit=(Limit(quantity="mtf50", min=0.15), Limit(quantity="read_noise", unit="e-", max=3.0))
    )
    path = tmp_path / "limits.toml"
    path.write_text(to_toml(limits))
    assert from_toml(path, Limits) == limits == load_limits(path) == load_limits(limits)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "at least one"),
        ('[[limit]]\nquantity = "mtf50"\n', "must have min or max, got neither"),
        ("[[limit]]\nmin = 1.0\n", "missing key 'quantity' in limit 1"),
        (
            '[[limit]]\nquantity = "mtf5"\nmin = 1.0\n',
            r"got 'mtf5' \(did you mean 'mtf50'\?\), in limit 1",
        ),
        ('[[limit]]\nquantity = "mtf50"\nmini = 1.0\n', "unknown key 'mini' in limit 1"),
        (
            '[[limit]]\nquantity = "mtf50"\nunit = "lp/mm"\nmin = 1.0\n',
            "must be one of cy/px, got 'lp/mm'",
        ),
        ('[[limit]]\nquantity = "read_noise"\nmax = 1.0\n', "must be one of DN, e-, got none"),
        ('[[limit]]\nquantity = "mtf50"\nmin = "0.1"\n', 'min must be a number, got "0.1"'),
        ('[[limit]]\nquantity = "mtf50"\nmin = nan\n', "finite"),
        (
            '[[limit]]\nquantity = "mtf50"\nmin = 0.3\nmax = 0.2\n',
            "must not exceed max, got 0.3 and 0.2",
        ),
        ("limit = 3\n", "limit must be"),
        ("[[limit]\n", "must be a TOML file"),
    ],
)
def test_bad_limits_are_one_sentence(text: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(BadInput, match=sentence) as caught:
        load_limits(path)
    assert "\n" not in str(caught.value)


def test_saved_verdicts_come_back_and_know_a_new_result(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text("one")
    result = Result(measurements=(mtf50(0.18, 0.22, stack="edge-1"),))
    checked = check(
        result, load_limits([{"quantity": "mtf50", "min": 0.2}, {"quantity": "prnu", "max": 1.0}])
    )
    assert load_check(tmp_path) is None
    save_check(checked, tmp_path)
    assert load_check(tmp_path) == (checked, True)
    (tmp_path / "results.json").write_text("another")
    assert load_check(tmp_path) == (checked, False)
    text = (tmp_path / "checked.json").read_text()
    for damaged in (
        "{}",
        text[:-20],
        text.replace("prnu", "prnux"),
        text.replace('"absent"', '"gone"'),
    ):
        (tmp_path / "checked.json").write_text(damaged)
        with pytest.raises(BadInput, match=r"checked\.json"):
            load_check(tmp_path)
