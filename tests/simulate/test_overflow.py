"""Charge in the CCD: conserved in overflow, held at the full well, smeared along columns only."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulate.camera import Ccd, StageImage, apply_column_blooming, spread_excess_charge


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(0.0, 40.0), min_size=3, max_size=60),
    st.floats(1.0, 5.0),
)
def test_charge_and_drained_charge_are_all_that_came_in(column, ratio):
    charge = np.array(column)[:, None]
    held, drained = apply_column_blooming(charge, 1.0, ratio)
    assert held.sum() + drained == pytest.approx(charge.sum(), rel=1e-9)
    assert held.max() <= 1.0 + 1e-9
    assert held.min() >= 0.0 and drained >= -1e-9


def test_spill_without_drain_fills_a_column_symmetrically_and_keeps_its_charge():
    column = np.zeros(101)
    column[50] = 21.0
    settled = spread_excess_charge(column, 1.0)
    assert settled.sum() == pytest.approx(21.0, rel=1e-9)
    assert np.allclose(settled, settled[::-1], atol=1e-6)
    assert np.allclose(settled[40:61], 1.0, atol=1e-6)
    assert np.allclose(settled[:39], 0.0, atol=1e-6)


def test_spill_keeps_the_centre_of_charge_until_it_meets_an_end():
    column = np.full(200, 0.2)
    column[90:95] = [3.0, 8.0, 1.0, 12.0, 5.0]
    settled = spread_excess_charge(column, 1.0)
    place = np.arange(200)
    assert settled.sum() == pytest.approx(column.sum(), rel=1e-9)
    assert (settled * place).sum() == pytest.approx((column * place).sum(), rel=1e-6)
    assert settled.max() <= 1.0 + 1e-6


def test_streak_grows_with_overload_beyond_the_drain():
    def rows(overload: float) -> int:
        field = np.zeros((101, 3))
        field[50, 1] = overload
        held, _ = apply_column_blooming(field, 1.0, 10.0)
        assert not held[:, [0, 2]].any()
        return int((held[:, 1] > 0.5).sum())

    assert rows(5.0) == 1
    assert rows(10.0) == 1
    assert 1 < rows(100.0) < rows(300.0)


def test_fields_overflow_each_on_their_own():
    ccd = Ccd(quantum_efficiency=1.0, full_well_e=1.0, antibloom_ratio=1.0, interlaced=True)
    frame = np.zeros((21, 3), np.float32)
    frame[10, 1] = 5.0
    held = ccd.mean(StageImage(values=frame[None])).values[0]
    assert np.flatnonzero(held[:, 1] > 0.5).tolist() == [6, 8, 10, 12, 14]
    assert held.sum() == pytest.approx(5.0, rel=1e-6)


def test_smear_of_a_spot_a_tenth_of_the_picture_high_is_its_fraction():
    ccd = Ccd(quantum_efficiency=1.0, full_well_e=1e9, smear_fraction=1e-3)
    frame = np.zeros((100, 5), np.float32)
    frame[40:50, 2] = 1000.0
    seen = ccd.mean(StageImage(values=frame)).values
    assert seen[0, 2] == pytest.approx(1.0, rel=1e-5)
    assert seen[99, 2] == pytest.approx(1.0, rel=1e-5)
    assert not seen[:, [0, 1, 3, 4]].any()
