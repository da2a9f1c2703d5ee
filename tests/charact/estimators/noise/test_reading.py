"""Laws of pixels that read light: what nothing blurs stays white, and what folds is what orders of
sampling bring.
"""

import numpy as np
import pytest

from charact.estimators.noise.gain.model import PixelReadoutModel
from labdata import load_sensor

X, ROWS = (
    axis.ravel() for axis in np.meshgrid(np.linspace(0.0, 0.25, 11), np.linspace(-0.3, 0.3, 9))
)


@pytest.mark.parametrize("row_pitch", [1.0, 1.18, 2.36])
def test_light_that_nothing_blurs_stays_white(row_pitch):
    shown = PixelReadoutModel(row_pitch=row_pitch, described=True).pixel_power(
        lambda x, y: np.zeros((1, x.size)), X, ROWS / row_pitch
    )
    assert shown == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("row_pitch", [1.0, 2.36])
@pytest.mark.parametrize("sigma", [0.5, 0.8])
def test_what_folds_back_is_the_sum_over_the_orders_of_sampling(row_pitch, sigma):
    """Poisson's sum over twenty orders, of a Gaussian blur behind which pixels touch."""

    def ln_blur(x, y):
        return -((2 * np.pi * sigma) ** 2) * (x**2 + y**2)

    row = ROWS / row_pitch
    shown = PixelReadoutModel(row_pitch=row_pitch, described=True).pixel_power(
        lambda x, y: ln_blur(x, y)[None], X, row
    )[0]
    total, plain = np.zeros(X.size), np.exp(ln_blur(X, row)) * (np.sinc(X) * np.sinc(ROWS)) ** 2
    for across in range(-10, 11):
        for down in range(-10, 11):
            x, y = X + across, row + down / row_pitch
            total += np.exp(ln_blur(x, y)) * (np.sinc(x) * np.sinc(y * row_pitch)) ** 2
    # All that folds counts as of the nearest order, a little too much, by less than is missed
    # without it.
    assert np.all(shown >= total - 1e-9)
    assert (shown - total).max() < 0.02
    assert (shown - total).max() <= 0.9 * (total - plain).max() + 1e-3


def test_a_described_video_filter_is_put_in_as_it_is():
    sensor = load_sensor("pulnix-ag5745ef3")
    plain, filtered = (
        PixelReadoutModel(row_pitch=2.0, described=True),
        PixelReadoutModel.of(2.0, sensor),
    )
    assert filtered.video is not None
    white = filtered.pixel_power(lambda x, y: np.zeros((1, x.size)), X, ROWS / 2.0)[0]
    assert white == pytest.approx(np.abs(filtered.video(X)) ** 2)
    low = np.array([0.03])
    known = -np.log(np.abs(filtered.video(low)[0]) ** 2) / 0.03**2
    assert filtered.falls[0] - plain.falls[0] == pytest.approx(known, rel=0.01)
    assert filtered.falls[1] == plain.falls[1]
