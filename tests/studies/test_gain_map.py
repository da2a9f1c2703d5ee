"""The committed map of gains: its cells are what the method still does, and it keeps what is
promised of it.
"""

import json

import numpy as np
import pytest

from benchmarks.studies.gain_map import BREAKING, TABLE, cell_of, measure_scenario


@pytest.fixture(scope="module")
def table():
    return json.loads(TABLE.read_text())


def cells(part):
    return [dict(zip(part["columns"], row, strict=True)) for row in part["rows"]]


def test_the_map_is_as_large_as_promised(table):
    kept = cells(table["quick"])
    assert len(kept) >= 3000
    assert len(table["chains"]["rows"]) >= 0.02 * len(kept)
    assert {one["axis"] for one in kept} == {"none", *BREAKING}


def test_three_cells_are_what_the_method_still_does(table, seed):
    """Every drawing has its own seed: the verdicts are the same, and the widths within a tenth."""
    kept = cells(table["quick"])
    for number in np.random.default_rng(seed).choice(len(kept), 3, replace=False):
        before, again = kept[number], measure_scenario(kept[number]["number"])
        assert again.ok == before["ok"], (before, again)
        assert again.refused == before["refused"], (before, again)
        if again.ok:
            assert again.sd_percent == pytest.approx(before["sd_percent"], rel=0.1)


def test_what_the_map_shows(table):
    """No crash; in scope 95 % ok; misses at most 5 % and three standard errors; silent no more than
    honest ones.
    """
    summary = table["quick"]["summary"]
    inside = summary["by_axis"]["none"]
    assert summary["crashed"] == 0
    assert summary["in_scope_ok_percent"] >= 95.0
    assert summary["missed_standard_errors_over_5_percent"] <= 3.0
    assert inside["missed"] <= 0.05 * inside["ok"] + 3.0 * np.sqrt(0.05 * 0.95 * inside["ok"])
    honest = summary["silent_of_honest_gaussian"]
    assert summary["silent"] <= honest + 3.0 * np.sqrt(honest)
    for axis in ("decay_ms", "interlaced_decay_ms"):
        glowing = summary["by_axis"][axis]
        assert glowing["missed"] <= 0.05 * glowing["ok"] + 3.0 * np.sqrt(
            0.05 * 0.95 * glowing["ok"]
        )


def test_a_cell_is_a_camera_without_lag_unless_lag_is_what_breaks_it():
    scenes = [cell_of(number) for number in range(40)]
    plain = next(cell for cell in scenes if cell.in_scope).scene
    slow = next(cell for cell in scenes if cell.axis == "decay_ms" and cell.strength > 20.0).scene
    assert plain.truth["decay_factor"] == pytest.approx(1.0, abs=1e-3)
    assert slow.truth["decay_factor"] < 0.9
    assert plain.truth["covariance_gain"] == pytest.approx(
        plain.truth["system_gain"]
        + plain.truth["photoelectron_gain"] * plain.truth["excess_noise_factor"],
        rel=1e-6,
    )
