"""What noise adds to a fitted MTF on the average is what the second order of the fit says it
adds.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from charact.estimators.mtf.bars.bar_image_model import BarLikelihood, initial_parameters
from charact.estimators.mtf.bars.detection import strip_of
from charact.estimators.mtf.bars.fit import BarFit, fit_bars, mtf_bias
from charact.estimators.mtf.bars.noise import WindowCovariance
from tests.truth.long_bars import STEP_DN, frames_of, gaussian, strip, tube

PAIRS, ANGLE_DEG, PHASE_PX = 80, 3.0, 0.2
Fits = Callable[[NDArray, dict[str, float] | None], tuple[BarFit, BarLikelihood]]


def correlation_of(blur_px: float) -> NDArray[np.float64]:
    """Correlation of white noise blurred by a Gaussian of s px, by distance: exp(-d^2 / (4
    s^2)).
    """
    if not blur_px:
        return np.ones((1, 1))
    lag = np.arange(-6, 7)
    along = np.exp(-((lag / (2.0 * blur_px)) ** 2))
    return np.outer(along, along)


def fits_of(image: NDArray, frequency: float, snr: float, blur_px: float) -> Fits:
    """Return what fits pictures like this one with its noise known."""
    target = strip_of(image, bars=4, frequency=frequency, pitch_ratio=1.0)
    assert target is not None
    variance = np.full(image.size, (STEP_DN / snr) ** 2)
    noise = WindowCovariance(variance=variance, correlation=correlation_of(blur_px))

    def fit(
        picture: NDArray, start: dict[str, float] | None = None
    ) -> tuple[BarFit, BarLikelihood]:
        problem = BarLikelihood(
            image=picture,
            window=np.ones(picture.shape, bool),
            variance=variance,
            asked=frequency,
            length_px=picture.shape[0],
            strip=True,
        )
        begun = start or initial_parameters(problem, target)
        return fit_bars(problem, target, begun, noise, tolerance=1e-4 if start else 1e-8), problem

    return fit


@pytest.mark.parametrize(
    ("core", "frequency", "snr", "rows", "blur_px", "sign"),
    [
        (gaussian(0.8), 0.4, 10.0, 10, 0.0, 1),
        (gaussian(0.8), 0.4, 10.0, 20, 0.7, -1),
    ],
)
def test_the_bias_of_fits_is_what_their_second_order_says(
    core, frequency, snr, rows, blur_px, sign, seed
) -> None:
    """Pairs of noise and its opposite, fitted: what is linear in it cancels, what is left is the
    bias.
    """
    image = strip(core, frequency, ANGLE_DEG, PHASE_PX, rows=rows) * STEP_DN
    fit = fits_of(image, frequency, snr, blur_px)
    clean, problem = fit(image, None)
    rng = np.random.default_rng(seed)
    means = []
    for _ in range(PAIRS):
        drawn = frames_of(0.5 + 0.0 * image, rng, snr=snr, blur_px=blur_px).data[0].astype(float)
        noise = drawn - 400.0 - 0.5 * STEP_DN
        means.append(
            np.mean([fit(image + way * noise, clean.values)[0].shape.mtf for way in (1, -1)])
        )
    found, error = np.mean(means) - clean.shape.mtf, np.std(means, ddof=1) / np.sqrt(PAIRS)
    predicted = mtf_bias(clean, problem)
    assert sign * predicted > 0
    assert abs(found - predicted) < 3.3 * error + 0.1 * abs(predicted)
    assert abs(predicted) > error


def test_the_exponent_prior_hardly_moves_a_gaussian_or_a_heavy_tail() -> None:
    """At ten times the noise, without any: a Gaussian (n = 2) and n = 1.1 are both far from the
    prior's middle.
    """
    for core, frequency in (
        (gaussian(0.8), 0.4),
        (gaussian(1.5), 0.1),
        (tube(0.25, 1.1), 0.1),
        (tube(0.25, 1.1), 0.4),
    ):
        image = strip(core, frequency, ANGLE_DEG, PHASE_PX) * STEP_DN
        weak, _ = fits_of(image, frequency, 10.0, 0.0)(image, None)
        sure, _ = fits_of(image, frequency, 1e3, 0.0)(image, None)
        assert weak.shape.mtf == pytest.approx(sure.shape.mtf, rel=0.006)
