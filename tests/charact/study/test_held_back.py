"""`auto` keeps its word on cases that no chart was drawn from."""

import json

import numpy as np
import pytest

from charact.study.held_back import SEED, TABLE, held_back


def test_edges_measured_by_auto_are_within_two_percent(seed):
    """Right in 95 of 100; 3 standard errors of a share of 40 are 10 points."""
    (found,) = held_back("mtf50", cases=40, seed=seed + 5000, tolerances=(2.0,), kinds=("edge",))
    assert found.cases == 40
    assert found.right / found.cases >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 40)


@pytest.mark.parametrize(("quantity", "kind", "within"), [("mtf50", "edge", 2.0), ("mtf50", "edge", 5.0)])
def test_the_committed_study_keeps_it_too(quantity, kind, within):
    table = json.loads(TABLE.read_text())
    assert table["seed"] == SEED
    (row,) = [one for one in table[quantity] if one["kind"] == kind and one["within_percent"] == within]
    assert row["right"] / row["cases"] >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / row["cases"])
