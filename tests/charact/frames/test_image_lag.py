"""How long a screen remembers: what sums and pixels of frames are worth, against pulses drawn one
moment at a time.
"""

import numpy as np
import pytest

from charact.frames import image_lag_model
from labdata import load_sensor

SHEET = load_sensor("pulnix-ag5745ef3")
FRAMES, MOMENTS, WARM_UP, SERIES = 12, 10, 30, 4000


@pytest.fixture(scope="module")
def fields(seed):
    """Light of even and odd fields, shape (series, frame, 2): white arrivals, each fading by two
    exponentials.
    """
    rng, phosphor = np.random.default_rng([seed, 61]), SHEET.phosphor
    period_ms = 1e3 / float(SHEET.video.field_rate_hz)
    end = np.arange(1, WARM_UP + 1)[:, None] * period_ms
    since = end - (np.arange(MOMENTS) + 0.5) / MOMENTS * period_ms
    fast, tau = (
        float(phosphor.fast_fraction),
        (float(phosphor.fast_decay_ms), float(phosphor.slow_decay_ms)),
    )
    weight = np.array([fast * tau[0], (1.0 - fast) * tau[1]])
    left = (
        weight[0] * np.exp(-since / tau[0]) + weight[1] * np.exp(-since / tau[1])
    ) / weight.sum()
    shares = -np.diff(left, axis=0, prepend=1.0)
    count = 2 * FRAMES
    arrivals = rng.standard_normal((SERIES, count + WARM_UP - 1, MOMENTS))
    light = sum(
        arrivals[:, WARM_UP - 1 - k : WARM_UP - 1 - k + count] @ shares[k] for k in range(WARM_UP)
    )
    return light.reshape(SERIES, FRAMES, 2)


def worth(series):
    """Variance of the mean of frames over that of as many fresh ones with the scatter seen."""
    return series.mean(axis=1).var() / (series.var(axis=1, ddof=1).mean() / FRAMES)


def test_sums_of_both_fields_and_pixels_of_one_are_widened_as_the_screen_says(fields):
    """Within four standard errors of the ratio of two variances, root of 2/4000 and little more."""
    memory = image_lag_model(SHEET, FRAMES, interlaced=True)
    assert worth(fields[:, :, 0]) == pytest.approx(memory.widening, rel=4.0 * 0.025)
    assert worth(fields.sum(axis=2)) == pytest.approx(memory.widening_of_sums, rel=4.0 * 0.025)
    assert memory.widening_of_sums > 1.2 * memory.widening


def test_a_camera_without_a_screen_remembers_nothing():
    memory = image_lag_model(None, FRAMES, interlaced=False)
    assert memory.widening == memory.widening_of_sums == pytest.approx(1.0)


def test_rows_of_one_exposure_share_their_pulses_whatever_their_parity():
    """Without fields the row above is of the same exposure: what two of its pixels share is what
    pixels of a row do.
    """
    for sensor in (None, SHEET):
        memory = image_lag_model(sensor, FRAMES, interlaced=False)
        assert (memory.mean_other, memory.frame_other) == (memory.mean_same, memory.frame_same)
