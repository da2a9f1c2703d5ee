"""Phases of an edge's transfers as they are, whatever the shift."""

import numpy as np
import pytest

from charact.estimators.mtf.edge.fit.edge_maps import apply_phases

GRID = np.concatenate([[1e-5, 1e-3], np.linspace(0.01, 4.3, 40)])


def test_phases_of_shifts_near_and_far_are_those_of_numpy(seed):
    """From none to hundreds of turns, and where a quarter begins."""
    rng = np.random.default_rng(seed)
    shift = np.concatenate([[0.0], np.arange(-2.0, 2.01, 0.125), 30.0 * rng.standard_normal(200)])
    modulus, fixed = rng.random((shift.size, GRID.size)), rng.standard_normal((2, GRID.size))
    grid = np.where(GRID > 0.1, GRID, np.round(GRID, 1) + 0.5)
    expected = modulus * (fixed[0] + 1j * fixed[1]) * np.exp(-2j * np.pi * shift[:, None] * grid)
    found = apply_phases(modulus, shift[:, None] * grid, fixed)
    # Turns by the hundred have lost the last three digits before any sine is taken.
    assert found == pytest.approx(np.concatenate([expected.real, expected.imag], axis=1), abs=1e-11)
