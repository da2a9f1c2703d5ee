"""`auto` keeps its word on cases that no chart was drawn from: right, or told that it may not
be.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies.held_out_cases import SEED, TABLE, check_held_out_choices
from benchmarks.studies.registry import POINT
from charact.method import Method, choose
from charact.method.registry import chart_table
from labdata import FrameStack, Result, make_measurement
from tests.truth.cases.point import chart_cases


def least(cases: int) -> float:
    """Three standard errors under 95 of 100."""
    return 0.95 - 3 * np.sqrt(0.95 * 0.05 / cases)


def test_edges_measured_by_auto_are_within_two_percent(seed):
    """Right in 95 of 100, within 3 standard errors."""
    (found,) = check_held_out_choices(
        "mtf50", cases=8, seed=seed + 5000, tolerances=(2.0,), kinds=("edge",)
    )
    assert found.cases == 8
    assert found.right / found.cases >= least(8)


def test_points_measured_by_auto_are_within_the_tolerance_or_say_that_they_may_not_be(seed):
    """At 1 % the light of one case in four is too little, and that it may be must be told."""
    (found,) = check_held_out_choices(
        "mtf50", cases=4, seed=seed + 5000, tolerances=(1.0,), kinds=("point",)
    )
    assert (found.right + found.told) / 4 >= least(4)


@pytest.mark.parametrize(
    ("value", "interval95", "flags", "told"),
    [
        (0.206, (0.204, 0.208), (), 0),
        (0.206, (0.195, 0.208), (), 1),
        (0.206, (0.204, 0.220), (), 1),
        (0.206, (0.204, 0.208), ("low-signal",), 1),
        (0.201, (0.150, 0.250), (), 0),
    ],
    ids=["narrow", "low end", "high end", "flagged", "right"],
)
def test_what_is_off_is_told_by_a_flag_or_by_an_interval_beyond_the_tolerance(
    value, interval95, flags, told, monkeypatch
):
    """Truth 0.2; asked for 2 %."""

    def function(stack, *, context, **arguments):
        found = make_measurement(
            "mtf50", "cy/px", value, interval95, interval95, method="fake", flags=flags
        )
        return Result(measurements=(found,))

    fake = Method(kind="point", name="fake", quantities=("mtf50",), scope="none", function=function)
    nothing = FrameStack(data=np.zeros((1, 4, 4)))
    case = replace(chart_cases(1, 1)[0], truth=0.2, draw=lambda rng: nothing)
    monkeypatch.setattr("benchmarks.studies.held_out_cases.choose", lambda *asked, **more: fake)
    monkeypatch.setattr(
        "benchmarks.studies.held_out_cases.studies_of",
        lambda _: (replace(POINT, chart_cases=lambda seed, count: (case,)),),
    )
    (found,) = check_held_out_choices("mtf50", cases=1, tolerances=(2.0,), kinds=("point",))
    assert (found.right, found.told) == (int(abs(value / 0.2 - 1) <= 0.02), told)


@pytest.mark.parametrize(
    ("quantity", "kind", "within"),
    [
        ("mtf50", "edge", 2.0),
        ("mtf50", "edge", 5.0),
        ("covariance_gain", "flats", 5.0),
        ("covariance_gain", "flats", 10.0),
        ("covariance_gain", "flats", 20.0),
    ],
)
def test_the_committed_study_keeps_it_too(quantity, kind, within):
    table = json.loads(TABLE.read_text())
    assert table["seed"] == SEED
    (row,) = [
        one for one in table[quantity] if one["kind"] == kind and one["within_percent"] == within
    ]
    assert row["right"] / row["cases"] >= least(row["cases"])


def test_every_number_of_the_committed_study_is_right_or_told():
    table = json.loads(TABLE.read_text())
    rows = [row for quantity in ("mtf50", "mtf") for row in table[quantity]]
    assert {row["kind"] for row in rows} == {"edge", "point", "bars"}
    for row in rows:
        assert (row["right"] + row["told"]) / row["cases"] >= least(row["cases"]), row


def test_auto_takes_the_covariance_sum_for_a_gain_at_any_tolerance():
    """It is the only estimator of a covariance gain; asked for more than it gives, it is taken all
    the same.
    """
    rows = {row["method"]: row for row in chart_table("covariance_gain")}
    assert set(rows) == {"covariance-sum"}
    assert {choose("flats", within_percent=within).name for within in (1.0, 5.0, 20.0)} == {
        "covariance-sum"
    }
    assert sum(row["silent"] for row in rows.values()) == 0
