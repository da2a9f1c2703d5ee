"""Offsets that rows of a target share are told, and counted in the noise of their mean."""

import numpy as np
import pytest

from charact.estimators.mtf.bars import noise


@pytest.mark.parametrize("offset_dn", [0.0, 1.5])
def test_offsets_of_rows_are_told_and_counted(offset_dn, seed):
    """The mean over a window of R rows varies by (v/C + w)/R, v of white noise, w of offsets."""
    rng, frames, shape = np.random.default_rng(seed), 8, (60, 70)
    drawn = 3.0 * rng.standard_normal((frames, *shape)) + offset_dn * rng.standard_normal(
        (frames, shape[0], 1)
    )
    window = np.ones(shape, bool)
    told = noise.noise_of(
        100.0 + drawn, np.full(window.size, 100.0), window, ground_dn=100.0, inflation=1.0
    )
    free = (frames - 1) * shape[0]
    assert told.row_variance * frames == pytest.approx(offset_dn**2, rel=5.0 * np.sqrt(2.0 / free))
    variance = (3.0**2 / shape[1] + offset_dn**2) / shape[0] / frames
    found = float(told.spread(np.full((1, window.size), 1.0 / window.size), window)[0, 0])
    assert offset_dn == 0.0 or found == pytest.approx(variance, rel=0.25)
