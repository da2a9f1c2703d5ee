"""Noise of a target's pixels: whatever lags were estimated, no sum of pixels has a variance below none."""

import numpy as np

from charact.mtf.bars.noise import Noise


def test_correlations_of_no_noise_make_no_negative_variance(seed):
    """0.45 at every lag up to four is a box, whose spectrum is negative at many frequencies."""
    rng = np.random.default_rng(seed)
    correlation = np.full((9, 9), 0.45)
    correlation[4, 4] = 1.0
    window = np.ones((24, 30), bool)
    noise = Noise(variance=np.ones(window.sum()), correlation=correlation)
    spread = noise.spread(rng.standard_normal((40, window.sum())), window)
    assert np.linalg.eigvalsh(spread).min() > -1e-9 * np.trace(spread)
    column = np.arange(30) * np.ones((24, 1))
    waves = np.stack([np.cos(np.pi * step / 12 * column[window]) for step in range(1, 12)])
    assert np.diag(noise.spread(waves, window)).min() > -1e-9
