"""What noise adds to a fitted MTF on the average is what the second order of the fit says it
adds.
"""

import numpy as np
import pytest

from charact.estimators.mtf.bars import bar_image_model, detection, fit, noise
from tests.truth import StripScene, TrueBlur, correlate_noise

STEP_DN, SNR, PAIRS = 1000.0, 10.0, 80


def fits_of(image, blur_px):
    """Return what fits pictures like this one with its noise known, and its parts."""
    target = detection.strip_of(image, bars=4, frequency=0.4, pitch_ratio=1.0)
    assert target is not None
    variance = np.full(image.size, (STEP_DN / SNR) ** 2)
    # White noise blurred by a Gaussian of s px, by distance: exp(-d^2 / (4 s^2)).
    along = np.exp(-((np.arange(-6, 7) / (2.0 * max(blur_px, 1e-3))) ** 2))
    known = noise.WindowCovariance(variance=variance, correlation=np.outer(along, along))

    def fit_of(picture, start=None):
        problem = bar_image_model.BarLikelihood(
            image=picture,
            window=np.ones(picture.shape, bool),
            variance=variance,
            asked=0.4,
            length_px=picture.shape[0],
            strip=True,
        )
        begun = start or bar_image_model.initial_parameters(problem, target)
        tolerance = 1e-4 if start else 1e-8
        return fit.fit_bars(problem, target, begun, known, tolerance=tolerance), problem

    return fit_of


@pytest.mark.parametrize(("rows", "blur_px", "sign"), [(10, 0.0, 1), (20, 0.7, -1)])
def test_the_bias_of_fits_is_what_their_second_order_says(rows, blur_px, sign, seed) -> None:
    """Pairs of noise and its opposite, fitted: what is linear in it cancels, what is left is the
    bias.
    """
    pose = {"frequency_cy_per_px": 0.4, "angle_deg": 3.0, "phase_px": 0.2}
    image = STEP_DN * StripScene(blur=TrueBlur(sigma_px=0.8), rows=rows, **pose).light()
    fit_of, rng, means = fits_of(image, blur_px), np.random.default_rng(seed), []
    clean, problem = fit_of(image)
    for _ in range(PAIRS):
        drawn = correlate_noise(rng.standard_normal((1, *image.shape)), blur_px)[0] * STEP_DN / SNR
        both = (fit_of(image + way * drawn, clean.values)[0] for way in (1, -1))
        means.append(np.mean([one.shape.mtf for one in both]))
    found, error = np.mean(means) - clean.shape.mtf, np.std(means, ddof=1) / np.sqrt(PAIRS)
    predicted = fit.mtf_bias(clean, problem)
    assert sign * predicted > 0
    assert abs(found - predicted) < 3.3 * error + 0.1 * abs(predicted)
    assert abs(predicted) > error
