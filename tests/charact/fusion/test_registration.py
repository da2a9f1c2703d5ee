"""The shift between two bands is recovered with an honest interval, and a failure is a value."""

import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter

from charact.fusion import residual_shift


def bands(rng: np.random.Generator, shift: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Two bands of rectangles, some of opposed contrast, the second one shifted by (x, y) px, with
    noise.
    """
    visible, thermal = np.zeros((2, 240, 320))
    for _ in range(60):
        row, col = rng.integers(0, 220), rng.integers(0, 300)
        place = np.s_[row : row + rng.integers(8, 30), col : col + rng.integers(8, 30)]
        visible[place] += rng.uniform(20.0, 60.0)
        thermal[place] += rng.uniform(20.0, 60.0) * rng.choice([-1.0, 1.0])
    visible, thermal = (gaussian_filter(band, 1.2, mode="wrap") for band in (visible, thermal))
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(thermal), shift[::-1])).real
    return tuple(
        (band + rng.normal(0.0, 3.0, band.shape)).astype(np.float32) for band in (visible, moved)
    )


@pytest.mark.parametrize("shift", [(0.4, -0.3), (1.3, 0.8), (0.0, 0.0)])
def test_a_shift_lies_in_its_interval(shift):
    found = residual_shift(*bands(np.random.default_rng([7, round(10 * shift[0])]), shift))
    assert found.reason is None
    for true, got, (low, high) in zip(shift, found.shift_px, found.interval_px(0.95), strict=True):
        assert low - 0.1 < true < high + 0.1
        assert got == pytest.approx(true, abs=0.4)


def test_a_shift_beyond_the_limit_is_refused_by_its_reason():
    found = residual_shift(*bands(np.random.default_rng(3), (5.2, -2.0)))
    assert found.reason == "beyond-limit" and found.status == "refused"
    assert found.shift_px == pytest.approx((5.2, -2.0), abs=0.4)


def test_what_cannot_be_registered_is_a_reason_and_no_exception():
    rng = np.random.default_rng(4)
    flat = np.full((240, 320), 7.0, np.float32)
    noise = rng.normal(0.0, 1.0, (2, 240, 320)).astype(np.float32)
    nothing = np.full((240, 320), np.nan, np.float32)
    assert residual_shift(flat, noise[0]).reason == "no-structure"
    assert residual_shift(noise[0], noise[1]).reason == "not-found"
    assert residual_shift(nothing, noise[1]).reason == "too-few-pixels"
