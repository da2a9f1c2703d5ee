"""Posterior of the MTF at the bar frequency, from a fitted image or from sums over a target."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from charact.estimators.mtf.bars.amplitudes import Amplitudes
from charact.estimators.mtf.bars.bar_image_model import BarImageModel, BarLikelihood
from charact.estimators.mtf.bars.fit import BarFit
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.inference import importance_sample, laplace, sample, sample_posterior
from charact.method import Context
from labdata import Array
from labdata.measurement import Posterior

TABULATED, PLACE = ("log_attenuation", "form_one"), ("across_px", "along_px")


SHAPE = ("log_attenuation", "form_one", "departure")


def shape_log_density(fit: BarFit, problem: BarLikelihood) -> Callable[[Array], Array]:
    """Return the log-probability of (log_attenuation, form_one, departure), other parameters
    marginalised.

    Notes
    -----
    t(theta) = E (y - mu(theta)), E the estimator at the optimum, has one value per parameter,
    normal with the covariance E S E', which includes the correlation between pixels. Level,
    background, position and departure enter linearly and are marginalised exactly; attenuation and
    exponent are tabulated.
    """
    image = BarImageModel(problem, fit.target)
    centre = {**fit.values, **{name: 0.0 for name in PLACE if name in fit.names}}
    value, sd = (
        _coordinates(np.array([[fit[name] for name in TABULATED]]))[0],
        np.array([fit.sd(name) for name in TABULATED]),
    )
    sd[0] *= value[0]
    low, high = _coordinates(np.array([problem.bounds[name] for name in TABULATED]).T)
    low = np.maximum(low, value - ACCURACY.table_range_sd * sd)
    high = np.minimum(high, value + ACCURACY.table_range_sd * sd)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    axis = np.cos(np.pi * (np.arange(ACCURACY.table_points) + 0.5) / ACCURACY.table_points)
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    data = problem.image[problem.window]
    numbers = [
        fit.estimator
        @ (data - image.mean({**centre, TABULATED[0]: np.log(attenuation), TABULATED[1]: shape}))
        for attenuation, shape in (middle + half * positions).tolist()
    ]
    polynomial = np.linalg.lstsq(_powers(positions), np.array(numbers), rcond=None)[0]
    inverse, response, offset = _marginal(fit)
    exponent = fit.names.index("form_one")
    mean, precision = (
        fit.prior_mean[exponent],
        fit.precision[[exponent, fit.names.index("departure")]],
    )

    def log_probability(theta: Array) -> Array:
        scaled = (_coordinates(theta[:, :2]) - middle) / half
        in_bounds = np.all(np.abs(scaled) <= 1.0, axis=1) & (
            theta[:, 2] > problem.bounds["departure"][0]
        )
        off = _powers(np.clip(scaled, -1.0, 1.0)) @ polynomial - offset
        off = off - np.outer(theta[:, 2] - fit["departure"], response)
        chi2 = np.einsum("ni,ij,nj->n", off, inverse, off)
        prior = precision[0] * (theta[:, 1] - mean) ** 2 + precision[1] * theta[:, 2] ** 2
        # Flat in the attenuation: below what the pixels resolve all of its logarithms fit alike.
        return np.where(in_bounds, theta[:, 0] - 0.5 * (chi2 + prior), -np.inf)

    return log_probability


def _coordinates(tabulated: Array) -> Array:
    """Return the coordinates of the table: attenuation, in which a sharp image is linear, and
    exponent.
    """
    return np.stack([np.exp(tabulated[:, 0]), tabulated[:, 1]], axis=1)


def _powers(points: Array) -> Array:
    """Return all products of powers of two coordinates up to the degree, shape (point, power)."""
    terms = [
        points[:, 0] ** i * points[:, 1] ** j
        for i in range(ACCURACY.table_degree + 1)
        for j in range(ACCURACY.table_degree + 1 - i)
    ]
    return np.stack(terms, axis=1)


def _marginal(fit: BarFit) -> tuple[Array, Array, Array]:
    """Return the inverse covariance of the estimates with linear parameters marginalised.

    The other two values are the response of the estimates to one unit of departure, and the effect
    of the other priors.
    """
    linear = [k for k, name in enumerate(fit.names) if name not in (*TABULATED, "departure")]
    answer = fit.estimator @ fit.slope.T
    sd = np.sqrt(np.diag(fit.covariance))
    known = fit.precision[linear] > 0
    linear_sd = np.where(
        known, 1.0 / np.sqrt(np.where(known, fit.precision[linear], 1.0)), 100.0 * sd[linear]
    )
    covariance = fit.noise_covariance + (answer[:, linear] * linear_sd**2) @ answer[:, linear].T
    inverse = np.linalg.inv(covariance / np.outer(sd, sd)) / np.outer(sd, sd)
    drawn = np.where(known, fit.prior_mean[linear] - fit.value[linear], 0.0)
    return inverse, answer[:, fit.names.index("departure")], answer[:, linear] @ drawn


def sample_fit(fit: BarFit, problem: BarLikelihood, context: Context, bias: float) -> Posterior:
    """Sample the transfer's shape: attenuation and exponent of the blur model, and the departure at
    the bar frequency.

    The fitted MTF M = p exp(-a) (1 + departure) has a bias from the square of the noise. It is
    corrected by a shift of ln(a) by bias / (a M), limited to one standard deviation, the range of
    the expansion.
    """
    shape_indices = [fit.names.index(name) for name in SHAPE]
    lifted = bias / fit.shape.mtf / np.exp(fit["log_attenuation"])
    sd = fit.sd("log_attenuation")
    shift = np.array([np.clip(lifted, -sd, sd), 0.0, 0.0])
    arguments = {
        "names": SHAPE,
        "units": ("1", "1", "1"),
        "start": fit.value[shape_indices] + shift,
        "covariance": fit.covariance[np.ix_(shape_indices, shape_indices)],
        "bounds": np.array([problem.bounds[name] for name in SHAPE]),
        "seed": context.seed,
    }
    if context.quick:
        return laplace(lambda theta: np.zeros(len(theta)), **arguments)
    density = shape_log_density(fit, problem)
    posterior = sample(lambda theta: density(theta - shift), **arguments)
    # Draws and fit are efficient under the model and agree within part of their uncertainty; priors
    # that the pixels contradict, such as with an unmodelled halo, separate them.
    start = fit.value[shape_indices] + shift
    fitted = np.log1p(start[2]) - np.exp(start[0])
    drawn = np.log1p(posterior["departure"]) - np.exp(posterior["log_attenuation"])
    if abs(drawn.mean() - fitted) <= LIMITS.max_posterior_offset_sd * drawn.std():
        return posterior
    return replace(posterior, flags=(*posterior.flags, "model-misfit"))


def mtf_of(posterior: Posterior, fit: BarFit, context: Context) -> Array:
    """Return the MTF of each draw at the reference frequency, pixel included, with the error of the
    image's table.
    """
    core = np.exp(-np.exp(posterior["log_attenuation"]))
    table = 1.0 + ACCURACY.image_table_sd * np.random.default_rng(
        [context.seed, len(core)]
    ).standard_normal(len(core))
    return fit.shape.pixel * core * (1.0 + posterior["departure"]) * table


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
    if context.quick:
        return importance_sample(
            log_probability,
            **arguments,
            seed=context.seed,
            bounds=bounds,
            enough=500.0,
            first_draws=1000,
        )
    return sample_posterior(log_probability, **arguments, seed=context.seed, bounds=bounds)
