"""`auto` keeps its word on cases that no chart was drawn from."""

import json

import numpy as np
import pytest

import charact.noise  # registers the methods
from charact.method.registry import chart_table, choose
from charact.study.held_back import SEED, TABLE, held_back


def test_edges_measured_by_auto_are_within_two_percent(seed):
    """Right in 95 of 100; 3 standard errors of a share of 40 are 10 points."""
    (found,) = held_back("mtf50", cases=40, seed=seed + 5000, tolerances=(2.0,), kinds=("edge",))
    assert found.cases == 40
    assert found.right / found.cases >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 40)


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
    (row,) = [one for one in table[quantity] if one["kind"] == kind and one["within_percent"] == within]
    assert row["right"] / row["cases"] >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / row["cases"])


def test_auto_takes_a_quicker_gain_estimator_where_its_error_is_within_the_tolerance():
    """Five estimators on one chart; asked for more than any gives, the most accurate is taken."""
    rows = {row["method"]: row for row in chart_table(charact.noise.gain.covariance_sum.QUANTITIES[0])}
    assert len(rows) >= 5
    best = min(rows, key=lambda name: rows[name]["error_percent"])
    assert choose("flats", within_percent=2.0).name == best == "covariance-sum"
    rough = choose("flats", within_percent=20.0).name
    assert rows[rough]["seconds"] == min(row["seconds"] for row in rows.values() if row["error_percent"] <= 20.0)
    assert rows[rough]["seconds"] < rows[best]["seconds"]
    assert sum(row["silent"] for row in rows.values()) == 0
