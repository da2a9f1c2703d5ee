"""Nonlinear camera response from bars: deformation of their image, and noise against signal."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.bars.fit import BarFit
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.estimators.mtf.mean_frame import usable_black_level
from charact.estimators.mtf.nonlinearity import (
    BENDING,
    MAX_LN_BAYES_FACTOR,
    contrast_of,
    curvatures,
)
from charact.frames.stack import Stack
from charact.inference.gauss_newton import Linearisation, least_squares, linearise_residual
from charact.verdict import Finding
from labdata import Array


class Power(NamedTuple):
    """Exponent with which noise grows with the light, and its standard uncertainty,
    dimensionless.
    """

    exponent: float
    sd: float


class BarNonlinearity(NamedTuple):
    """Evidence of a target on the camera response.

    Parameters
    ----------
    curvature, sd
        c of a response y = u + c u (1 - u), u the light over that of a wide bar, and its standard
        uncertainty.
    contrast
        Of the bars and their background.
    lifts
        Change of ln MTF by a curvature of one.
    width
        Fitted width of the bars over half a period, its logarithm.
    shared, per_pixel
        Powers of the light with which the covariance of neighbours and the variance of pixels grow;
        None: unknown.
    """

    curvature: float
    sd: float
    contrast: float
    lifts: float
    width: float
    shared: Power | None
    per_pixel: Power | None


def response_of(stack: Stack, fit: BarFit) -> BarNonlinearity:
    """Return the evidence of a fitted target; without a black level its noise is not used."""
    background = fit["pedestal_dn"]
    dark, bright = sorted((background, background + fit["level_dn"]))
    black_dn = usable_black_level(stack.frames.black_level_dn, dark, bright)
    powers = (None, None) if black_dn is None else noise_powers(stack.data, fit, black_dn)
    curvature, sd, lifts = _curvature(fit)
    contrast = contrast_of(dark, bright, black_dn)
    return BarNonlinearity(curvature, sd, contrast, lifts, fit["log_width"], *powers)


def response_findings(response: BarNonlinearity, mtf: float) -> list[Finding]:
    """Return `gamma` where the image or the noise of bars contradicts a linear response.

    Notes
    -----
    A curvature c of the image, of standard uncertainty s, is taken off the MTF. It may be that of
    unequal bars and gaps, and their fitted width w may be a curvature, and then moves the MTF by
    its own size: the bound is M exp(lifts (|c| + 2 s) + |w|) - M, where that is small enough for a
    series of first order. What the noise contradicts has none.

    Light pulses correlate neighbours, read-out and quantisation do not. Under a response of
    exponent g the covariance of neighbours grows as the level above black to the power 2 - 1/g,
    which is 1 for a linear response. The variance of pixels, which includes read-out noise, then
    grows at most in proportion, and does not fall.
    """
    shared, pixel_power = response.shared, response.per_pixel
    causes: dict[str, float | None] = {}
    if abs(response.curvature) > LIMITS.max_curvature_sd * response.sd:
        cause = (
            f"the image indicates a response of curvature {response.curvature:.2g} +- "
            f"{response.sd:.1g} (linear: 0); unequal bars and gaps have the same effect"
        )
        largest = abs(response.width) + abs(response.lifts) * (
            abs(response.curvature) + 2.0 * response.sd
        )
        causes[cause] = (
            mtf * float(np.expm1(largest))
            if largest < LIMITS.max_curvature_lift
            and abs(response.curvature) < LIMITS.max_curvature
            else None
        )
    if shared and abs(shared.exponent - 1.0) > LIMITS.neighbour_power[0] * float(
        np.hypot(shared.sd, LIMITS.neighbour_power[1])
    ):
        cause = (
            f"correlated noise grows as signal^({shared.exponent:.2f} +- {shared.sd:.2f}); a "
            "linear response gives exponent 1. Target motion also adds noise"
        )
        causes[cause] = None
    if (
        pixel_power
        and max(pixel_power.exponent - 1.0, -pixel_power.exponent)
        > LIMITS.pixel_power[0] * pixel_power.sd + LIMITS.pixel_power[1]
    ):
        cause = (
            f"pixel noise grows as signal^({pixel_power.exponent:.2f} +- {pixel_power.sd:.2f}); "
            "photon and read-out noise give an exponent between 0 and 1"
        )
        causes[cause] = None
    remedy = "frames with a linear response (raw, gamma 1), or the correct `black_dn`"
    return [
        Finding(flag="gamma", effect=cause, remedy=remedy, bound=bound)
        for cause, bound in causes.items()
    ]


def linearise_mtf_draws(mtf: Array, response: BarNonlinearity, seed: int) -> Array:
    """Return draws of the MTF corrected for a possibly nonlinear response."""
    rng = np.random.default_rng([seed, 62])
    curvature = curvatures(
        (response.curvature, response.sd),
        response.contrast,
        _noise_ln_odds(response.shared),
        rng,
        mtf.size,
        curved=ACCURACY.nonlinear_prior,
    )
    return mtf * np.exp(-response.lifts * curvature)


def _noise_ln_odds(shared: Power | None) -> float:
    """Return the ln Bayes factor of a nonlinear response from the power of the neighbours'
    covariance.

    A response of exponent g makes it 2 - 1/g, of mean one with the prior's spread.
    """
    if shared is None:
        return 0.0
    excess, sd = shared.exponent - 1.0, float(np.hypot(shared.sd, LIMITS.neighbour_power[1]))
    broad_sd = float(np.hypot(sd, BENDING))
    ln_odds = np.log(sd / broad_sd) + 0.5 * ((excess / sd) ** 2 - (excess / broad_sd) ** 2)
    return float(np.clip(ln_odds, -MAX_LN_BAYES_FACTOR, MAX_LN_BAYES_FACTOR))


def _curvature(fit: BarFit) -> tuple[float, float, float]:
    """Return the curvature that best fits an image, its uncertainty, and its effect on ln MTF.

    Notes
    -----
    To first order the image of bars u becomes u + c u (1 - u) times their height; the parameters
    with their priors absorb part of the change.
    """
    fraction = np.clip((fit.model_dn - fit["pedestal_dn"]) / fit["level_dn"], 0.0, 1.0)
    bent = abs(fit["level_dn"]) * fraction * (1.0 - fraction)
    weight = 1.0 / np.maximum(fit.noise.variance, ACCURACY.min_variance * fit["level_dn"] ** 2)
    known = np.concatenate([(fit.slope * np.sqrt(weight)).T, np.diag(np.sqrt(fit.precision))])
    basis = np.linalg.qr(known)[0]
    wanted = np.concatenate([bent * np.sqrt(weight), np.zeros(len(fit.names))])
    unexplained = wanted - basis @ (wanted @ basis)
    free_curvature = unexplained[: bent.size] * np.sqrt(weight)
    # What pulls parameters off their priors, the width of the bars above all, may be the response.
    pulled = unexplained[bent.size :] @ (np.sqrt(fit.precision) * (fit.prior_mean - fit.value))
    size = max(float(free_curvature @ bent), 1e-300)
    noise = (
        float(np.sqrt(max(float(fit.noise.spread(free_curvature[None], fit.window)[0, 0]), 0.0)))
        / size
    )
    # The blur of several stages mimics a curvature of 0.01.
    sd = float(np.hypot(noise, 0.01))
    return (
        float(free_curvature @ fit.residual_dn + pulled) / size,
        sd,
        float(fit.ln_mtf_slope @ (fit.estimator @ bent)),
    )


def noise_powers(data: NDArray, fit: BarFit, black_dn: float) -> tuple[Power | None, Power | None]:
    """Return the powers of the light with which the covariance of row neighbours and the pixel
    variance grow.

    `data`: shape (frame, row, col), DN; `fit`: the image fitted to their mean; `black_dn`: black
    level, DN.

    Returns
    -------
    shared, per_pixel
        None: the covariance is too small, or single pixels do not show their noise.
    """
    light = np.full(fit.window.shape, np.nan)
    light[fit.window] = fit.model_dn - black_dn
    brightest = float(np.nanquantile(light, 0.999))
    if not brightest > 0:
        return None, None
    noise = _noise(data.astype(np.float64), light)
    background, height = (
        fit["pedestal_dn"] - black_dn,
        float(np.abs(fit.model_dn - fit["pedestal_dn"]).max()),
    )
    level, product = _products(noise, light, ACCURACY.neighbour_lag_px)
    uncorrelated = [_products(noise, light, lag) for lag in (8, 9, 10)]
    common = np.concatenate(
        [
            products[np.abs(mid_light - background) < LIMITS.max_background_height * height]
            for mid_light, products in uncorrelated
        ]
    )
    product -= common.mean() if common.size else 0.0
    correlation = fit.noise.correlation
    spread = np.full(fit.window.shape, np.nan)
    spread[fit.window] = fit.noise.variance
    shared = _power(
        level / brightest,
        product,
        _between(spread, ACCURACY.neighbour_lag_px),
        max(float(np.abs(correlation).sum()), 1.0),
    )
    level, square = _products(noise, light, 0)
    if not _shows_noise(data, level, square):
        return shared, None
    return shared, _power(
        level / brightest, square, _between(spread, 0), max(float(np.sum(correlation**2)), 1.0)
    )


def _shows_noise(data: NDArray, level: Array, square: Array) -> bool:
    """Return whether the scatter of single pixels is noise, not fixed pattern or quantisation."""
    lit = level > 0.5 * level.max()
    quiet = len(data) == 1 and level[lit].mean() > LIMITS.max_single_frame_snr * np.sqrt(
        square[lit].mean()
    )
    dark = level <= np.quantile(level, 0.25)
    rounded = data.dtype.kind in "ui" and square[dark].mean() < LIMITS.min_noise_dn**2
    return not quiet and not rounded


def _noise(frames: Array, light: Array) -> Array:
    """Return the residuals of frames, with each frame's offset and flicker subtracted."""
    is_lit = np.isfinite(light)
    fraction = len(frames) / max(len(frames) - 1.0, 1.0)
    expected = (
        frames.mean(axis=0)
        if len(frames) > 1
        else light - float(np.mean((light - frames[0])[is_lit]))
    )
    residuals = np.sqrt(fraction) * np.where(is_lit, frames - expected, 0.0)
    shapes = np.stack([np.ones(np.count_nonzero(is_lit)), light[is_lit]])
    residuals[:, is_lit] -= residuals[:, is_lit] @ np.linalg.pinv(shapes) @ shapes
    return residuals


def _products(noise: Array, light: Array, lag: int) -> tuple[Array, Array]:
    """Return the light between pixels a lag apart in a row, DN, and the mean product of their
    noise, DN^2.
    """
    last = light.shape[1] - lag
    product = np.mean(noise[:, :, :last] * noise[:, :, lag:], axis=0)
    pairs = np.isfinite(light[:, :last] + light[:, lag:])
    return _between(light, lag), product[pairs]


def _between(field: Array, lag: int) -> Array:
    """Return the mean of pixels a lag apart in a row, where both are known, shape (pair,)."""
    mean = 0.5 * (field[:, : field.shape[1] - lag] + field[:, lag:])
    return mean[np.isfinite(mean)]


def _power(light: Array, product: Array, variance: Array, variance_factor: float) -> Power | None:
    """Return the power of the light in proportion to which noise grows; None: there is too little.

    `light`: light over the brightest, shape (pixel,); `product`: products of noise, DN^2;
    `variance`: approximate scale of their uncertainties, DN^2; `variance_factor`: that of averages
    relative to independent products.

    Notes
    -----
    Minimises the sum of ((p - c L^b) / v)^2 over c and b; uncertainties follow from the residuals.
    """
    # Below a hundredth of the brightest the black level is too uncertain.
    ln_light = np.log(np.maximum(light, 0.01))
    scaled, weight = product / variance, 1.0 / variance
    start = _start(scaled, weight, ln_light)
    if not np.isfinite(start).all():
        return None

    def linearise(theta: Array) -> Linearisation:
        expected = weight * np.exp(theta[0] + theta[1] * ln_light)
        slopes = np.stack([expected, expected * ln_light])
        return linearise_residual(scaled - expected, slopes, model=(slopes, scaled - expected))

    bounds = start[:, None] + ACCURACY.power_range * np.array([-1.0, 1.0])
    at = least_squares(
        linearise,
        start,
        bounds,
        iterations=60,
        tolerance=0.0,
        relative_tolerance=1e-12,
        max_step=0.5 / ACCURACY.power_range,
    )
    (slopes, residual), inverse = at.at.model, np.linalg.pinv(at.at.normal)
    covariance = inverse @ ((slopes * residual**2) @ slopes.T) @ inverse * variance_factor
    # The scale at the level where it is most precise.
    size_sd = np.sqrt(np.linalg.det(covariance) / covariance[1, 1])
    exponent, sd = float(at.point[1]), float(np.sqrt(covariance[1, 1]))
    return Power(exponent, sd) if size_sd < 1.0 / LIMITS.min_power_sd else None


def _start(scaled: Array, weight: Array, ln_light: Array) -> Array:
    """Return ln scale, NaN without noise, and the best of a few exponents."""
    shapes = [weight * np.exp(exponent * ln_light) for exponent in ACCURACY.power_starts]
    sizes = [float(scaled @ shape) / float(shape @ shape) for shape in shapes]
    gains = [
        size * float(np.sqrt(shape @ shape)) for size, shape in zip(sizes, shapes, strict=True)
    ]
    best = int(np.argmax(gains))
    return np.array(
        [np.log(sizes[best]) if sizes[best] > 0 else np.nan, ACCURACY.power_starts[best]]
    )
