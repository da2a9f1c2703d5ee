"""The table of bars: its cells are what the method still does, and its tally keeps to what is
promised.
"""

import numpy as np
import pytest

from benchmarks.studies.bar_bias import (
    CELLS,
    FIRST,
    LEAST_PAIRS,
    BarScenarioOutcome,
    measure_scenario,
    read,
    tally,
)

TABLE = read()


def test_every_cell_stands_in_the_table_with_enough_drawings():
    assert [one.number for one in TABLE] == list(range(len(CELLS)))
    assert all(one.draws >= 2 * LEAST_PAIRS for one in TABLE)
    for one, cell in zip(TABLE, CELLS, strict=True):
        assert one.truth == pytest.approx(cell.scene.truth_mtf, rel=1e-4)
        assert (one.blur, one.tilt_deg, one.phase_px) == (
            cell.blur,
            cell.scene.angle_deg,
            cell.phase_px,
        )


@pytest.mark.parametrize("number", [0, 85])
def test_the_table_is_what_the_method_still_does(number: int):
    again = measure_scenario(number, least=FIRST // 2, most=FIRST // 2)
    assert again.first == pytest.approx(TABLE[number].first, rel=0.02)


def test_the_bias_keeps_to_one_percent_wherever_bars_are_measured():
    """Four bars, 0.05 to 0.40 cy/px, 20 rows at ten times the noise, 0 to 8 degrees, any phase, n =
    1.1 included.
    """
    found = tally(TABLE)
    assert found.verdicts["off"] == 0
    assert found.largest_standard_error_percent < 1.0
    # Only what a blur leaves of 3 % or less is not told as ok.
    assert max(one.truth for one in TABLE if one.told) < 0.03


def test_the_intervals_hold_as_often_as_they_say_in_every_class():
    found = tally(TABLE)
    share68, share95, _ = found.held["all"]
    assert 0.64 <= share68 <= 0.72
    assert 0.92 <= share95 <= 0.98
    for name, (one, other, numbers) in found.held.items():
        # Both of a pair mostly hold or mostly miss.
        chance = 3.3 * np.sqrt(0.25 / (numbers / 2))
        assert 0.64 - chance < one < 0.72 + chance, name
        assert 0.92 - chance < other, name
    # An honest Gaussian interval fails so once in ten thousand: of seven thousand more than four
    # once in a thousand.
    assert found.ok < 8000
    assert found.silent <= 4


def test_a_cell_is_judged_by_its_bias_its_error_and_its_verdicts():
    fields = {
        "number": 0,
        "blur": "b",
        "frequency_cy_per_px": 0.1,
        "tilt_deg": 0.0,
        "grain_px": 0.0,
        "phase_px": None,
        "truth": 0.5,
        "draws": 80,
        "numbers": 80,
        "ok": 80,
        "scatter_percent": 5.0,
        "held68": 54,
        "held95": 76,
        "silent": 0,
        "first": [],
    }
    seen = [
        BarScenarioOutcome(
            **{**fields, "bias_percent": bias, "standard_error_percent": 0.3, "ok": ok}
        ).verdict
        for bias, ok in ((-0.9, 80), (-1.5, 80), (1.7, 80), (9.0, 39))
    ]
    assert seen == ["within", "chance", "off", "told"]


def test_upside_down_noise_is_the_same_noise():
    upright, turned = CELLS[1].drawn(5)
    both = [
        scene.frames_drawn(np.random.default_rng(1)).data.astype(float)
        for scene in (upright, turned)
    ]
    clean = upright.pedestal_dn + upright.level_dn * upright.light().T
    assert np.abs(both[0] - clean).max() > 200
    assert np.allclose(both[0] + both[1], 2 * clean, atol=1.01)
