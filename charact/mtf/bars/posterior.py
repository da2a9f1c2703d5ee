"""Posterior of the MTF at the bar frequency, from a fitted image or from sums over a target."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.bars.amplitudes import Amplitudes
from charact.mtf.bars.bar_image_model import BarLikelihood
from charact.mtf.bars.compressed import shape_log_density
from charact.mtf.bars.fit import BarFit
from charact.posterior import importance_sample, laplace, sample, sample_posterior
from labdata.measurement import Posterior

Array = NDArray[np.float64]

LARGEST_MTF = 1.5
# What straight lines between the places of a picture's table make of the MTF without any noise, as a share of it.
TABLE_SD = 3e-4
# Effective draws by importance where an answer is wanted quickly.
QUICK_ESS = 500.0
# Standard deviations of its draws by which a full posterior may lie beside the fit that it began from.
MAX_OFFSET_SD = 2.0
SHAPE = ("log_attenuation", "form_one", "departure")


def sample_fit(fit: BarFit, problem: BarLikelihood, context: Context, bias: float) -> Posterior:
    """Sample the transfer's shape: attenuation and exponent of the blur model, and the departure at the bar frequency.

    The fitted MTF M = p exp(-a) (1 + departure) has a bias from the square of the noise. It is corrected by a shift of
    ln(a) by bias / (a M), limited to one standard deviation, the range of the expansion.
    """
    own = [fit.names.index(name) for name in SHAPE]
    lifted = bias / fit.shape.mtf / np.exp(fit["log_attenuation"])
    sd = fit.sd("log_attenuation")
    shift = np.array([np.clip(lifted, -sd, sd), 0.0, 0.0])
    asked = {
        "names": SHAPE,
        "units": ("1", "1", "1"),
        "start": fit.value[own] + shift,
        "covariance": fit.covariance[np.ix_(own, own)],
        "bounds": np.array([problem.bounds[name] for name in SHAPE]),
        "seed": context.seed,
    }
    if context.quick:
        return laplace(lambda theta: np.zeros(len(theta)), **asked)
    density = shape_log_density(fit, problem)
    posterior = sample(lambda theta: density(theta - shift), **asked)
    if not _differs_from_fit(posterior, fit, shift):
        return posterior
    return replace(posterior, flags=(*posterior.flags, "model-misfit"))


def _differs_from_fit(posterior: Posterior, fit: BarFit, shift: Array) -> bool:
    """Return whether the draws contradict the fit.

    Both are efficient under the model and agree within part of their uncertainty; priors that the pixels contradict,
    such as with an unmodelled halo, separate them.
    """
    start = np.array([fit[name] for name in SHAPE]) + shift
    fitted = np.log1p(start[2]) - np.exp(start[0])
    drawn = np.log1p(posterior["departure"]) - np.exp(posterior["log_attenuation"])
    return bool(abs(drawn.mean() - fitted) > MAX_OFFSET_SD * drawn.std())


def mtf_of(posterior: Posterior, fit: BarFit, context: Context) -> Array:
    """Return the MTF of each draw at the reference frequency, pixel included, with the error of the image's table."""
    core = np.exp(-np.exp(posterior["log_attenuation"]))
    table = 1.0 + TABLE_SD * np.random.default_rng([context.seed, len(core)]).standard_normal(len(core))
    return fit.shape.pixel * core * (1.0 + posterior["departure"]) * table


def sample_sums(found: Amplitudes, lost: tuple[float, float], context: Context) -> Posterior:
    """Sample light, MTF and the fraction of light beyond the window.

    Priors: light and MTF uniform over (0, 2 I(0)) and (0, 1.5); the fraction normal from the sensor description, not
    negative. Student's t likelihood with the degrees of freedom of the estimated covariance.
    """
    inverse = np.linalg.inv(found.covariance)
    share, share_sd = lost
    known = share_sd == 0.0
    bounds = np.array([(0.0, 2.0), (0.0, LARGEST_MTF), (max(0.0, share - 8 * share_sd), share + 8 * share_sd)])
    bounds = bounds[:2] if known else bounds

    def log_probability(theta: Array) -> Array:
        light, mtf = theta[:, 0], theta[:, 1]
        beyond = np.full(len(theta), share) if known else theta[:, 2]
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        expected = found.light * light[:, None] * np.stack([1.0 - beyond, 2.0 / np.pi * mtf], axis=1)
        off = np.array([found.light, found.fundamental]) - expected
        chi2 = np.einsum("ni,ij,nj->n", off, inverse, off)
        likelihood = -0.5 * (found.freedom + 2.0) * np.log1p(chi2 / found.freedom)
        prior = 0.0 if known else -0.5 * ((beyond - share) / share_sd) ** 2
        return np.where(inside, likelihood + prior, -np.inf)

    ratio = min(np.pi / 2 * found.fundamental / found.light * (1.0 - share), LARGEST_MTF - 0.01)
    start = np.array([1.0 / (1.0 - share), ratio, share])
    relative = found.covariance / found.light**2
    spread = np.diag([relative[0, 0], (np.pi / 2) ** 2 * relative[1, 1] + ratio**2 * relative[0, 0], share_sd**2])
    count = len(bounds)
    asked = {
        "names": ("light", "mtf", "lost_share")[:count],
        "units": ("1", "1", "1")[:count],
        "start": start[:count],
        "covariance": spread[:count, :count],
    }
    if context.quick:
        return importance_sample(
            log_probability, **asked, seed=context.seed, bounds=bounds, enough=QUICK_ESS, first_draws=1000
        )
    return sample_posterior(log_probability, **asked, seed=context.seed, bounds=bounds)
