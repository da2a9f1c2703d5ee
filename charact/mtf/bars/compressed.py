"""Likelihood of the transfer's shape on the linear estimates from all pixels."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.bar_image_model import BarImageModel, BarLikelihood
from charact.mtf.bars.fit import BarFit

Array = NDArray[np.float64]

# Attenuation and the form's first number are tabulated over this many standard deviations at so many places each, and
# drawn through polynomials of this degree.
RANGE_SD, PLACES, DEGREE = 4.0, 7, 4
TABULATED, PLACE = ("log_attenuation", "form_one"), ("across_px", "along_px")
# What has no prior is as good as unknown over so many of its standard deviations.
FLAT_SD = 100.0


def shape_log_density(fit: BarFit, problem: BarLikelihood) -> Callable[[Array], Array]:
    """Return the log-probability of (log_attenuation, form_one, departure), other parameters marginalised.

    Notes
    -----
    t(theta) = E (y - mu(theta)), E the estimator at the optimum, has one value per parameter, normal with the
    covariance E S E', which includes the correlation between pixels. Level, background, position and departure enter
    linearly and are marginalised exactly; attenuation and exponent are tabulated.
    """
    picture = BarImageModel(problem, fit.target)
    centre = {**fit.values, **{name: 0.0 for name in PLACE if name in fit.names}}
    low, high = _tabulated_range(fit, problem)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    axis = np.cos(np.pi * (np.arange(PLACES) + 0.5) / PLACES)
    places = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    data = problem.image[problem.window]
    numbers = [
        fit.estimator @ (data - picture({**centre, **dict(zip(TABULATED, one, strict=True))})[0])
        for one in (middle + half * places).tolist()
    ]
    polynomial = np.linalg.lstsq(_powers(places), np.array(numbers), rcond=None)[0]
    inverse, response, offset = _marginal(fit)
    exponent = fit.names.index("form_one")
    mean, precision = fit.prior_mean[exponent], fit.precision[[exponent, fit.names.index("departure")]]

    def log_probability(theta: Array) -> Array:
        scaled = (theta[:, :2] - middle) / half
        inside = np.all(np.abs(scaled) <= 1.0, axis=1) & (theta[:, 2] > problem.bounds["departure"][0])
        off = _powers(np.clip(scaled, -1.0, 1.0)) @ polynomial - offset
        off = off - np.outer(theta[:, 2] - fit["departure"], response)
        chi2 = np.einsum("ni,ij,nj->n", off, inverse, off)
        prior = precision[0] * (theta[:, 1] - mean) ** 2 + precision[1] * theta[:, 2] ** 2
        return np.where(inside, -0.5 * (chi2 + prior), -np.inf)

    return log_probability


def _tabulated_range(fit: BarFit, problem: BarLikelihood) -> tuple[Array, Array]:
    """Return the lowest and highest attenuation and exponent to tabulate."""
    value, sd = np.array([fit[name] for name in TABULATED]), np.array([fit.sd(name) for name in TABULATED])
    low, high = np.array([problem.bounds[name] for name in TABULATED]).T
    return np.maximum(low, value - RANGE_SD * sd), np.minimum(high, value + RANGE_SD * sd)


def _powers(places: Array) -> Array:
    """Return all products of powers of two coordinates up to the degree, shape (point, power)."""
    terms = [places[:, 0] ** i * places[:, 1] ** j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.stack(terms, axis=1)


def _marginal(fit: BarFit) -> tuple[Array, Array, Array]:
    """Return the inverse covariance of the estimates with linear parameters marginalised.

    The other two values are the response of the estimates to one unit of departure, and the effect of the other priors.
    """
    linear = [k for k, name in enumerate(fit.names) if name not in (*TABULATED, "departure")]
    answer = fit.estimator @ fit.slope.T
    sd = np.sqrt(np.diag(fit.covariance))
    known = fit.precision[linear] > 0
    wide = np.where(known, 1.0 / np.sqrt(np.where(known, fit.precision[linear], 1.0)), FLAT_SD * sd[linear])
    covariance = fit.noise_covariance + (answer[:, linear] * wide**2) @ answer[:, linear].T
    inverse = np.linalg.inv(covariance / np.outer(sd, sd)) / np.outer(sd, sd)
    drawn = np.where(known, fit.prior_mean[linear] - fit.value[linear], 0.0)
    return inverse, answer[:, fit.names.index("departure")], answer[:, linear] @ drawn
