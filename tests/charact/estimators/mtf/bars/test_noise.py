"""Noise of a target's pixels: whatever lags were estimated, no sum of pixels has a variance below
none.
"""

import numpy as np
import pytest

from charact.estimators.mtf.bars.noise import WindowCovariance, noise_of


def test_correlations_of_no_noise_make_no_negative_variance(seed):
    """0.45 at every lag up to four is a box, whose spectrum is negative at many frequencies."""
    rng = np.random.default_rng(seed)
    correlation = np.full((9, 9), 0.45)
    correlation[4, 4] = 1.0
    window = np.ones((24, 30), bool)
    noise = WindowCovariance(variance=np.ones(window.sum()), correlation=correlation)
    spread = noise.spread(rng.standard_normal((40, window.sum())), window)
    assert np.linalg.eigvalsh(spread).min() > -1e-9 * np.trace(spread)
    column = np.arange(30) * np.ones((24, 1))
    waves = np.stack([np.cos(np.pi * step / 12 * column[window]) for step in range(1, 12)])
    assert np.diag(noise.spread(waves, window)).min() > -1e-9


@pytest.mark.parametrize("offset_dn", [0.0, 1.5])
def test_offsets_of_rows_are_told_and_counted(offset_dn, seed):
    """The mean over a window of R rows varies by (v/C + w)/R, v of white noise, w of offsets."""
    rng, frames, shape = np.random.default_rng(seed), 8, (60, 70)
    drawn = 3.0 * rng.standard_normal((frames, *shape)) + offset_dn * rng.standard_normal(
        (frames, shape[0], 1)
    )
    window = np.ones(shape, bool)
    noise = noise_of(
        100.0 + drawn, np.full(window.size, 100.0), window, ground_dn=100.0, inflation=1.0
    )
    free = (frames - 1) * shape[0]
    assert noise.row_variance * frames == pytest.approx(offset_dn**2, rel=5.0 * np.sqrt(2.0 / free))
    variance = (3.0**2 / shape[1] + offset_dn**2) / shape[0] / frames
    found = float(noise.spread(np.full((1, window.size), 1.0 / window.size), window)[0, 0])
    assert offset_dn == 0.0 or found == pytest.approx(variance, rel=0.25)
