"""The harness of studies, and cases that it holds out."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.studies.chart import chart
from benchmarks.studies.harness import percentile_limit, run, summary
from benchmarks.studies.held_out_cases import SEED, TABLE, check_held_out_choices
from benchmarks.studies.registry import POINT, STUDIES, methods_of
from benchmarks.studies.stability import stability
from charact.method import Context, Method, choose, registry
from charact.method.registry import chart_table
from labdata import (
    BadInput,
    FrameStack,
    Result,
    make_measurement,
    make_refusal,
    measurement_from_sd,
)
from tests.truth import EdgeScene, TrueBlur
from tests.truth.cases import bars as bar_cases
from tests.truth.cases import bloom as bloom_cases
from tests.truth.cases import edge as edge_cases
from tests.truth.cases import point as point_cases
from tests.truth.cases.case import Case
from tests.truth.cases.point import chart_cases

# The study harness tells lies from refusals, and its table makes `auto` take the cheaper of the
# good methods.


TRUTH = TrueBlur().mtf50(5.0)


def _case(truth: float | None = TRUTH, **changes) -> Case:
    given = {
        "kind": "edge",
        "name": "one edge",
        "axis": "edge SNR",
        "position": 50.0,
        "unit": "1",
        "quantity": "mtf50",
        "truth": truth,
        "in_scope": True,
        "seed": 3,
        "draw": EdgeScene().frames_drawn,
    }
    return Case(**{**given, **changes})


def _method(name: str, function) -> Method:
    return Method(kind="edge", name=name, quantities=("mtf50",), scope="none", function=function)


def _answering(value: float, sd: float, flags: tuple[str, ...] = (), seconds: float = 0.0):
    def function(stack, *, context, **arguments):
        until = time.process_time() + seconds
        while time.process_time() < until:
            pass
        return Result(
            measurements=(
                measurement_from_sd("mtf50", "cy/px", value, sd, method="fake", flags=flags),
            )
        )

    return function


def _refusing(stack, *, context, **arguments):
    return Result(measurements=(make_refusal("mtf50", "cy/px", "nothing to see", method="fake"),))


def _raising(error: Exception):
    def function(stack, *, context, **arguments):
        raise error

    return function


LOPSIDED = make_measurement(
    "mtf50", "cy/px", TRUTH * 1.1, None, (TRUTH * 1.09, TRUTH * 2), method="fake"
)


@pytest.mark.parametrize(
    ("function", "truth", "status", "silent", "covers"),
    [
        (_answering(TRUTH * 1.2, TRUTH * 0.01), TRUTH, "ok", True, False),
        (
            _answering(TRUTH * 1.2, TRUTH * 0.01, flags=("low-signal",)),
            TRUTH,
            "suspect",
            False,
            False,
        ),
        (_answering(TRUTH * 1.03, TRUTH * 0.01), TRUTH, "ok", False, False),
        (lambda stack, *, context: Result(measurements=(LOPSIDED,)), TRUTH, "ok", True, False),
        (_refusing, TRUTH, "refused", False, None),
        (_answering(0.2, 0.1), None, "ok", True, None),
        (_answering(0.2, 0.1, flags=("low-signal",)), None, "suspect", False, None),
        (_refusing, None, "refused", False, None),
        (_raising(BadInput("an edge must be there, got none")), TRUTH, "refused", False, None),
        (_raising(ZeroDivisionError("division by zero")), TRUTH, "crashed", False, None),
        (lambda stack, *, context: np.log(np.zeros(1)), TRUTH, "crashed", False, None),
    ],
    ids=[
        "lie",
        "flagged lie",
        "near miss",
        "arm on the truth's side",
        "refusal",
        "lie about nothing",
        "flagged about nothing",
        "refusal of nothing",
        "bad input",
        "exception",
        "warning",
    ],
)
def test_lies_are_silent_failures_and_refusals_are_not(function, truth, status, silent, covers):
    row = run([_method("fake", function)], [_case(truth) or _case()], context=Context())[0]
    assert (row.status, row.silent, row.covers) == (status, silent, covers)


@pytest.mark.parametrize("count", [60, 200])
def test_the_limit_of_a_percentile_lies_above_it_as_often_as_it_says(count, seed):
    """Whatever the distribution; a share p of n trials errs by sqrt(p (1 - p) / n)."""
    rng, trials = np.random.default_rng(seed), 2000
    errors = rng.lognormal(0.0, 1.0, (trials, count))
    percentile = np.exp(1.6448536)
    above = np.mean([percentile_limit(one) > percentile for one in errors])
    k = next(k for k in range(1, count + 1) if binom.cdf(k - 1, count, 0.95) >= 0.95)
    promised = binom.cdf(k - 1, count, 0.95)
    assert promised >= 0.95
    assert above == pytest.approx(promised, abs=4.5 * np.sqrt(promised * (1.0 - promised) / trials))


def test_a_refusal_counts_in_the_limit_as_a_hundred_percent():
    rows = run([_method("fake", _answering(TRUTH * 1.01, 0.01))], [_case()] * 3, context=Context())
    assert summary(rows, "fake").error_limit_percent == pytest.approx(1.0)
    rows += run([_method("fake", _refusing)], [_case()], context=Context())
    assert summary(rows, "fake").error_limit_percent == 100


def test_auto_takes_the_cheaper_method_within_tolerance(tmp_path, monkeypatch):
    methods = (
        _method("edge-good", _exact(0.001, 0.02)),
        _method("edge-cheap", _exact(0.015, 0.0)),
        _method("edge-poor", _exact(0.2, 0.0)),
    )
    monkeypatch.setattr("benchmarks.studies.chart.TABLES", tmp_path / "tables")
    result = chart("mtf50", seed=1, out=tmp_path, methods=methods, cases=4, update=True)
    table = json.loads((tmp_path / "tables" / "mtf50.json").read_text())
    assert {row["method"] for row in table["methods"]} == {"edge-good", "edge-cheap", "edge-poor"}
    assert table["provenance"]["seed"] == 1
    monkeypatch.setattr(registry, "METHODS", {("edge", method.name): method for method in methods})
    monkeypatch.setattr(registry, "chart_table", lambda quantity: table["methods"])
    assert registry.choose("edge", within_percent=2.0).name == "edge-cheap"
    assert registry.choose("edge", within_percent=0.5).name == "edge-good"
    assert all(path.is_file() and path.stat().st_size > 1000 for path in result.files)
    assert "time for one stack (s)" in (tmp_path / "chart-mtf50.svg").read_text()
    assert all(row["error_limit_percent"] >= row["error_percent"] for row in table["methods"])
    assert "edge-cheap" in result.text()


def _exact(relative_error: float, seconds: float):
    """A method that knows the truth of the charted cases, up to an error of its own."""
    truth = {case.seed: case.truth for case in edge_cases.chart_cases(1, 4)}

    def function(stack, *, context, **arguments):
        return _answering((truth[context.seed] or 0) * (1 + relative_error), 0.01, seconds=seconds)(
            stack, context=context
        )

    return function


def test_the_map_of_stability_holds_every_axis_and_every_lie(tmp_path):
    lying = _method("edge-lying", _answering(0.9, 1e-4))
    found = stability(
        "mtf50", seed=2, out=tmp_path, methods=(lying,), repeats=1, axes=("tilt", "edge SNR")
    )
    data = json.loads((tmp_path / "stability-mtf50.json").read_text())
    assert len(found.silent) == len(found.rows) == len(data["silent"])
    svg = (tmp_path / "stability-mtf50-edge.svg").read_text()
    assert "tilt (deg)" in svg
    assert "edge SNR (step / noise)" in svg
    assert found.text().count("SILENT edge-lying") == len(found.silent)


def test_a_sweep_over_processes_has_the_rows_of_one_process():
    methods = tuple(method for method in methods_of("mtf") if method.name == "bars-forward")
    alone, shared = (
        stability("mtf", quick=True, axes=("tilt",), methods=methods, workers=workers).rows
        for workers in (1, 2)
    )
    assert [replace(row, seconds=0.0) for row in shared] == [
        replace(row, seconds=0.0) for row in alone
    ]


@pytest.mark.parametrize("cases", [edge_cases, bar_cases, point_cases, bloom_cases])
def test_every_axis_is_swept_past_its_scope_or_lies_wholly_inside(cases):
    for axis, (_, positions, (low, high), *_) in cases.AXES.items():
        inside = [low <= position <= high for position in positions]
        assert any(inside), axis
        assert not all(inside) or axis == "frames"


@pytest.mark.parametrize("quantity", list(STUDIES))
def test_cases_are_the_same_for_the_same_seed_and_others_for_another(quantity):
    for study in STUDIES[quantity]:
        first, again, other = (study.chart_cases(seed, 3) for seed in (5, 5, 6))
        assert [(c.truth, c.seed) for c in first] == [(c.truth, c.seed) for c in again]
        assert {c.seed for c in first}.isdisjoint(c.seed for c in other)


def test_a_quantity_without_a_study_is_refused_with_those_that_have_one():
    with pytest.raises(
        BadInput,
        match=r"must be one of mtf50, mtf, .*fusion_error, halo_diameter, got prnu",
    ):
        chart("prnu")


def test_every_registered_method_is_charted_on_the_same_cases_of_its_kind():
    quantity = "mtf"
    found = chart(quantity, seed=3, cases=1, quick=True)
    assert {row.method for row in found.summaries} == {
        method.name for method in methods_of(quantity)
    }
    for method in methods_of(quantity):
        own = {(row.case, row.seed) for row in found.rows if row.method == method.name}
        assert own == {(row.case, row.seed) for row in found.rows if row.kind == method.kind}
        assert len(own) == 1
    assert all(row.status != "crashed" for row in found.rows), [row.reason for row in found.rows]


# `auto` keeps its word on cases that no chart was drawn from: right, or told that it may not be.


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
