"""The study harness tells lies from refusals, and its table makes `auto` take the cheaper of the good methods."""

import json
import time

import numpy as np
import pytest
from scipy.stats import binom

from charact.method import Context, Method, registry
from charact.study import STUDIES, chart, run, stability, summary
from charact.study.bars import cases as bar_cases
from charact.study.bloom import cases as bloom_cases
from charact.study.edge import cases as edge_cases
from charact.study.edge.cases import chart_cases, stability_cases
from charact.study.edge.scene import EdgeScene, TrueBlur
from charact.study.harness import Case, percentile_limit
from charact.study.point import cases as point_cases
from charact.study.study_registry import methods_of
from labdata.errors import BadInput
from labdata.measurement import Result, make_measurement, make_refusal, measurement_from_sd

TRUTH = TrueBlur().mtf50(5.0)


def _case(truth: float | None = TRUTH, **changes) -> Case:
    given = {
        "kind": "edge", "name": "one edge", "axis": "edge SNR", "position": 50.0, "unit": "1", "quantity": "mtf50",
        "truth": truth, "in_scope": True, "seed": 3, "draw": EdgeScene().frames_drawn,
    }  # fmt: skip
    return Case(**{**given, **changes})


def _method(name: str, function) -> Method:
    return Method(kind="edge", name=name, quantities=("mtf50",), scope="none", function=function)


def _answering(value: float, sd: float, flags: tuple[str, ...] = (), seconds: float = 0.0):
    def function(stack, *, context, **arguments):
        until = time.process_time() + seconds
        while time.process_time() < until:
            pass
        return Result(measurements=(measurement_from_sd("mtf50", "cy/px", value, sd, method="fake", flags=flags),))

    return function


def _refusing(stack, *, context, **arguments):
    return Result(measurements=(make_refusal("mtf50", "cy/px", "nothing to see", method="fake"),))


def _raising(error: Exception):
    def function(stack, *, context, **arguments):
        raise error

    return function


def _row(function, case: Case | None = None):
    return run([_method("fake", function)], [case or _case()], context=Context())[0]


def test_a_method_that_lies_is_counted_as_a_silent_failure():
    row = _row(_answering(TRUTH * 1.2, TRUTH * 0.01))
    assert row.silent
    assert not row.covers
    assert row.error_percent == pytest.approx(20)


def test_a_method_that_says_what_to_distrust_does_not_lie():
    assert not _row(_answering(TRUTH * 1.2, TRUTH * 0.01, flags=("low-signal",))).silent


def test_a_method_that_refuses_does_not_lie():
    row = _row(_refusing)
    assert row.status == "refused"
    assert not row.silent
    assert row.value is None
    assert row.reason == "nothing to see"


def test_an_interval_that_misses_by_little_is_a_miss_but_no_lie():
    row = _row(_answering(TRUTH * 1.03, TRUTH * 0.01))
    assert not row.covers
    assert not row.silent


def test_the_arm_on_the_truths_side_counts():
    lopsided = make_measurement("mtf50", "cy/px", TRUTH * 1.1, None, (TRUTH * 1.09, TRUTH * 2), method="fake")
    assert _row(lambda stack, *, context: Result(measurements=(lopsided,))).silent


def test_an_ok_number_where_there_is_nothing_to_measure_is_a_lie():
    assert _row(_answering(0.2, 0.1), _case(truth=None)).silent
    assert not _row(_answering(0.2, 0.1, flags=("low-signal",)), _case(truth=None)).silent
    assert not _row(_refusing, _case(truth=None)).silent


def test_bad_input_is_a_refusal_and_any_other_exception_a_crash():
    assert _row(_raising(BadInput("an edge must be there, got none"))).status == "refused"
    crashed = _row(_raising(ZeroDivisionError("division by zero")))
    assert crashed.status == "crashed"
    assert crashed.reason == "ZeroDivisionError: division by zero"


def test_a_warning_is_a_crash():
    assert _row(lambda stack, *, context: np.log(np.zeros(1))).status == "crashed"


def test_a_refusal_costs_the_chart_a_hundred_percent():
    rows = run([_method("fake", _refusing)], [_case(), _case()], context=Context())
    assert summary(rows, "fake").error_percent == 100
    assert summary(rows, "fake").ok_fraction == 0


@pytest.mark.parametrize("count", [60, 100, 200])
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


def test_the_limit_of_few_errors_is_the_largest_and_of_many_is_not():
    assert percentile_limit(np.arange(24.0)) == 23.0
    assert percentile_limit(np.arange(59.0)) == 58.0
    assert 190.0 < percentile_limit(np.arange(200.0)) < 199.0


def test_a_refusal_counts_in_the_limit_as_a_hundred_percent():
    rows = run([_method("fake", _answering(TRUTH * 1.01, 0.01))], [_case()] * 3, context=Context())
    assert summary(rows, "fake").error_limit_percent == pytest.approx(1.0)
    rows += run([_method("fake", _refusing)], [_case()], context=Context())
    assert summary(rows, "fake").error_limit_percent == 100


def test_auto_wants_a_method_whose_errors_are_surely_within_the_tolerance(monkeypatch):
    """One is quicker, and by luck of a few cases within 2 %; it is taken where its upper limit is within as well."""
    methods = (_method("edge-good", _refusing), _method("edge-lucky", _refusing))
    rows = [
        {"method": "edge-lucky", "error_percent": 1.6, "error_limit_percent": 2.7, "seconds": 0.1},
        {"method": "edge-good", "error_percent": 1.2, "error_limit_percent": 1.9, "seconds": 1.0},
    ]
    monkeypatch.setattr(registry, "METHODS", {("edge", method.name): method for method in methods})
    monkeypatch.setattr(registry, "chart_table", lambda quantity: rows)
    assert registry.choose("edge", within_percent=2.0).name == "edge-good"
    assert registry.choose("edge", within_percent=3.0).name == "edge-lucky"
    assert registry.choose("edge", within_percent=1.0).name == "edge-good"


def test_auto_takes_the_cheaper_method_within_tolerance(tmp_path, monkeypatch):
    methods = (
        _method("edge-good", _exact(0.001, 0.02)),
        _method("edge-cheap", _exact(0.015, 0.0)),
        _method("edge-poor", _exact(0.2, 0.0)),
    )
    monkeypatch.setattr("charact.study.speed_accuracy.TABLES", tmp_path / "tables")
    result = chart("mtf50", seed=1, out=tmp_path, methods=methods, cases=4, update=True)
    table = json.loads((tmp_path / "tables" / "mtf50.json").read_text())
    assert {row["method"] for row in table["methods"]} == {"edge-good", "edge-cheap", "edge-poor"}
    assert table["provenance"]["seed"] == 1
    monkeypatch.setattr(registry, "METHODS", {("edge", method.name): method for method in methods})
    monkeypatch.setattr(registry, "chart_table", lambda quantity: table["methods"])
    assert registry.choose("edge", within_percent=2.0).name == "edge-cheap"
    assert registry.choose("edge", within_percent=0.5).name == "edge-good"
    assert all(path.is_file() and path.stat().st_size > 1000 for path in result.files)
    assert all(row["error_limit_percent"] >= row["error_percent"] for row in table["methods"])
    assert "edge-cheap" in result.text()


def _exact(relative_error: float, seconds: float):
    """A method that knows the truth of the charted cases, up to an error of its own."""
    truth = {case.seed: case.truth for case in chart_cases(1, 4)}

    def function(stack, *, context, **arguments):
        return _answering((truth[context.seed] or 0) * (1 + relative_error), 0.01, seconds=seconds)(
            stack, context=context
        )

    return function


def test_the_figure_of_the_chart_names_its_axes_with_units(tmp_path):
    chart("mtf50", out=tmp_path, methods=(_method("edge-good", _exact(0.001, 0.0)),), cases=2, seed=1)
    svg = (tmp_path / "chart-mtf50.svg").read_text()
    assert "time for one stack (s)" in svg
    assert "(% of the truth)" in svg


def test_the_map_of_stability_holds_every_axis_and_every_lie(tmp_path):
    lying = _method("edge-lying", _answering(0.9, 1e-4))
    found = stability("mtf50", seed=2, out=tmp_path, methods=(lying,), repeats=1, axes=("tilt", "edge SNR"))
    data = json.loads((tmp_path / "stability-mtf50.json").read_text())
    assert len(found.silent) == len(found.rows) == len(data["silent"])
    svg = (tmp_path / "stability-mtf50-edge.svg").read_text()
    assert "tilt (deg)" in svg
    assert "edge SNR (step / noise)" in svg
    assert found.text().count("SILENT edge-lying") == len(found.silent)


def test_an_honest_method_covers_and_never_lies_on_the_map():
    cases = {case.seed: case.truth for case in stability_cases(4, 1, ("tilt",))}

    def honest(stack, *, context, **arguments):
        truth = cases[context.seed]
        if truth is None:
            return _refusing(stack, context=context)
        return _answering(truth * 1.005, truth * 0.01)(stack, context=context)

    found = stability("mtf50", seed=4, methods=(_method("edge-honest", honest),), repeats=1, axes=("tilt",))
    assert not found.silent
    assert all(row.covers for row in found.rows if row.truth is not None)


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
        match=r"must be of one of mtf50, mtf, covariance_gain, system_gain, post_gain_mtf50, halo_diameter, got 'prnu'",
    ):
        chart("prnu")


@pytest.mark.parametrize("quantity", ["mtf50", "mtf"])
def test_every_registered_method_is_charted_on_the_same_cases_of_its_kind(quantity):
    found = chart(quantity, seed=3, cases=2, quick=True)
    assert {row.method for row in found.summaries} == {method.name for method in methods_of(quantity)}
    for method in methods_of(quantity):
        own = {(row.case, row.seed) for row in found.rows if row.method == method.name}
        assert own == {(row.case, row.seed) for row in found.rows if row.kind == method.kind}
        assert len(own) == 2
    assert all(row.status != "crashed" for row in found.rows), [row.reason for row in found.rows]
