"""Second-order bias of the fitted MTF by noise, and its uncertainty by quantisation."""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.bar_image_model import BarImageModel, BarLikelihood
from charact.mtf.bars.fit import BarFit

Array = NDArray[np.float64]

# Steps of the slopes' differences: of shape, of what moves bars by a share of their period, and in px at most.
STEP_SHAPE, STEP_PERIODS, STEP_PX = 0.1, 0.06, 0.25
# An MTF of a smaller relative standard deviation has a bias, of the order of its square, under a thousandth.
SURE = 0.015


def mtf_bias(fit: BarFit, problem: BarLikelihood) -> float:
    """Return the expected excess of the fitted MTF by noise.

    Notes
    -----
    A phase, direction or frequency that follows the noise raises the bars' amplitude. With slopes J, second derivatives
    H, weights W, estimator E = (J' W J + P)^-1 J' W and noise covariance S the bias of the estimate is (Box 1971, doi
    10.1111/j.2517-6161.1971.tb00871.x, for weights that may differ from the noise's)

        b = (J' W J + P)^-1 [sum_k H_k' W q_k - J' W tr(H C) / 2],   C = E S E',   q = (1 - J E) S E',

    and that of the MTF M is M' b + tr(M'' C) / 2, to second order in the noise. It is neglected for an MTF of less than
    1.5 % uncertainty.
    """
    own = [fit.names.index("log_attenuation"), fit.names.index("departure")]
    first, second = _mtf_slopes(fit)
    covariance = fit.noise_covariance
    if first @ covariance[np.ix_(own, own)] @ first < (SURE * fit.shape.mtf) ** 2:
        return 0.0
    shared = fit.noise.shared(fit.estimator, fit.window)
    unlike = shared - covariance @ fit.slope
    bends = _bends(fit, problem)
    pull = np.zeros(len(fit.names))
    bent = np.zeros(fit.slope.shape[1])
    for (one, other), bend in bends.items():
        pull[one] += np.sum(bend * unlike[other] / problem.variance)
        bent += covariance[one, other] * bend
        if one != other:
            pull[other] += np.sum(bend * unlike[one] / problem.variance)
            bent += covariance[one, other] * bend
    off = fit.inverse @ pull - 0.5 * fit.estimator @ bent
    return float(first @ off[own] + 0.5 * np.sum(second * covariance[np.ix_(own, own)]))


def rounding_sd(fit: BarFit) -> float:
    """Return the relative standard uncertainty of the MTF by quantisation."""
    rounding = fit.noise.rounding
    if rounding is None or not len(rounding):
        return 0.0
    own = [fit.names.index("log_attenuation"), fit.names.index("departure")]
    moved = rounding @ fit.estimator[own].T @ _mtf_slopes(fit)[0]
    return float(np.sqrt(np.mean(moved**2))) / fit.shape.mtf


def _mtf_slopes(fit: BarFit) -> tuple[Array, Array]:
    """Return the MTF's first and second derivatives by log attenuation and departure."""
    attenuation = np.exp(fit["log_attenuation"])
    family = fit.shape.pixel * np.exp(-attenuation)
    whole = fit.shape.mtf
    by_both = -attenuation * family
    second = np.array([[whole * attenuation * (attenuation - 1.0), by_both], [by_both, 0.0]])
    return np.array([-attenuation * whole, family]), second


def _bends(fit: BarFit, problem: BarLikelihood) -> dict[tuple[int, int], Array]:
    """Return the image's second derivatives over the pixels by pair of parameters.

    Level, pedestal and departure enter linearly: they have mixed derivatives only.
    """
    picture, index = BarImageModel(problem, fit.target), fit.names.index
    here = {**fit.values, **{name: 0.0 for name in ("across_px", "along_px") if name in fit.names}}
    bends: dict[tuple[int, int], Array] = {}
    for name, step in _steps(fit, picture).items():
        up, down = (picture({**here, name: here[name] + sign * step})[1] for sign in (1.0, -1.0))
        own = index(name)
        for other, bend in enumerate((up - down) / (2.0 * step)):
            pair = (min(own, other), max(own, other))
            bends[pair] = 0.5 * (bends[pair] + bend) if pair in bends else bend
    departure, level = index("departure"), index("level_dn")
    bends[departure, level] = fit.slope[departure] / fit["level_dn"]
    return bends


def _steps(fit: BarFit, picture: BarImageModel) -> dict[str, float]:
    """Return the finite-difference step of each nonlinear parameter, for positions part of a period."""
    reach = picture.reach
    move = min(STEP_PERIODS / fit.target.frequency, STEP_PX)
    steps = {
        "log_attenuation": STEP_SHAPE,
        "form_one": STEP_SHAPE,
        "log_frequency": STEP_SHAPE / fit.target.bars,
        "log_length": STEP_SHAPE / fit.target.bars,
        "across_px": move,
        "along_px": move,
        "angle_rad": move / reach[1],
    }
    return {name: step for name, step in steps.items() if name in fit.names}
