"""Posterior of the MTF at the bar frequency, from a fitted image or from sums over a target."""

import numpy as np

from charact.estimators.mtf.bars.amplitudes import Amplitudes
from charact.estimators.mtf.bars.bar_image_model import BarLikelihood
from charact.estimators.mtf.bars.fit import BarFit
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.inference import importance_sample, laplace
from charact.method import Context
from labdata import Array
from labdata.measurement import Posterior

SHAPE = ("log_attenuation", "form_one", "departure")


def sample_fit(fit: BarFit, problem: BarLikelihood, context: Context, bias: float) -> Posterior:
    """Draw the transfer's shape from its Laplace approximation: attenuation and first parameter of
    the blur model, and the departure at the bar frequency.

    The pixels are linear in a small attenuation, so it is drawn and not its logarithm. The fitted
    MTF M = p exp(-a) (1 + departure) has a bias from the square of the noise. It is corrected by a
    shift of a by bias / M, limited to one standard deviation, the range of the expansion.
    """
    shape_indices = [fit.names.index(name) for name in SHAPE]
    start, bounds = fit.value[shape_indices], np.array([problem.bounds[name] for name in SHAPE])
    scale = np.array([np.exp(start[0]), 1.0, 1.0])
    covariance = fit.covariance[np.ix_(shape_indices, shape_indices)] * np.outer(scale, scale)
    start[0], bounds[0] = np.exp(start[0]), np.exp(bounds[0])
    sd = float(np.sqrt(covariance[0, 0]))
    start[0] = np.clip(start[0] + np.clip(bias / fit.shape.mtf, -sd, sd), *bounds[0])
    return laplace(
        lambda theta: np.zeros(len(theta)),
        names=("attenuation", *SHAPE[1:]),
        units=("1", "1", "1"),
        start=start,
        covariance=covariance,
        bounds=bounds,
        seed=context.seed,
    )


def mtf_of(posterior: Posterior, fit: BarFit, context: Context) -> Array:
    """Return the MTF of each draw at the reference frequency, pixel included, with the error of
    the forms.
    """
    table = 1.0 + ACCURACY.form_sd * np.random.default_rng(
        [context.seed, len(posterior.draws)]
    ).standard_normal(len(posterior.draws))
    return (
        fit.shape.pixel * np.exp(-posterior["attenuation"]) * (1.0 + posterior["departure"]) * table
    )


def sample_sums(amplitudes: Amplitudes, lost: tuple[float, float], context: Context) -> Posterior:
    """Sample light, MTF and the fraction of light beyond the window.

    Priors: light and MTF uniform over (0, 2 I(0)) and (0, 1.5); the fraction normal from the sensor
    description, not negative. Student's t likelihood with the degrees of freedom of the estimated
    covariance.
    """
    inverse = np.linalg.inv(amplitudes.covariance)
    fraction, share_sd = lost
    known = share_sd == 0.0
    bounds = np.array(
        [
            (0.0, 2.0),
            (0.0, LIMITS.max_mtf),
            (max(0.0, fraction - 8 * share_sd), fraction + 8 * share_sd),
        ]
    )
    bounds = bounds[:2] if known else bounds

    def log_probability(theta: Array) -> Array:
        light, mtf = theta[:, 0], theta[:, 1]
        lost_light = np.full(len(theta), fraction) if known else theta[:, 2]
        in_bounds = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        expected = (
            amplitudes.light
            * light[:, None]
            * np.stack([1.0 - lost_light, 2.0 / np.pi * mtf], axis=1)
        )
        off = np.array([amplitudes.light, amplitudes.fundamental]) - expected
        chi2 = np.einsum("ni,ij,nj->n", off, inverse, off)
        likelihood = -0.5 * (amplitudes.freedom + 2.0) * np.log1p(chi2 / amplitudes.freedom)
        prior = 0.0 if known else -0.5 * ((lost_light - fraction) / share_sd) ** 2
        return np.where(in_bounds, likelihood + prior, -np.inf)

    ratio = min(
        np.pi / 2 * amplitudes.fundamental / amplitudes.light * (1.0 - fraction),
        LIMITS.max_mtf - 0.01,
    )
    start = np.array([1.0 / (1.0 - fraction), ratio, fraction])
    relative = amplitudes.covariance / amplitudes.light**2
    spread = np.diag(
        [relative[0, 0], (np.pi / 2) ** 2 * relative[1, 1] + ratio**2 * relative[0, 0], share_sd**2]
    )
    count = len(bounds)
    arguments = {
        "names": ("light", "mtf", "lost_share")[:count],
        "units": ("1", "1", "1")[:count],
        "start": start[:count],
        "covariance": spread[:count, :count],
    }
    return importance_sample(
        log_probability,
        **arguments,
        seed=context.seed,
        bounds=bounds,
        enough=500.0,
        first_draws=1000,
    )
