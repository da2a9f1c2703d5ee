"""Groups of bars of one camera taken together: one MTF curve through the readings at their fundamentals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

import charact
from charact.method import Context
from charact.mtf.curve import REPORTED, curve_of, falls_to
from charact.mtf.forms import transfer as forms
from charact.posterior import laplace, sample
from labdata.errors import BadInput
from labdata.measurement import Measurement, Provenance, Result, from_draws, refused

Array = NDArray[np.float64]

METHOD = "bars-joint"
# Families lie in these ranges of half frequency, cycles per pixel, and exponent; the exponent's prior is n = 2, a
# Gaussian, to 1.2, a tube.
BOUNDS = np.array([(0.01, 1.5), (0.7, 3.5)])
EXPONENT_PRIOR = (1.6, 0.6)
HALF68_SD = 0.994458
# Chance below which the groups do not tell of one member of the family, and directions that have one MTF, degrees.
MISFIT_LEVEL, SAME_DIRECTION_DEG = 0.001, 15.0
GRID = (np.geomspace(0.03, 0.8, 40), np.linspace(0.8, 3.0, 23))


@dataclass(frozen=True, kw_only=True)
class Group:
    """What one group of bars says.

    Parameters
    ----------
    frequency
        Cycles per pixel.
    mtf, sd
        MTF there, pixel included, and its standard deviation.
    angle_rad
        Direction across the bars.
    """

    frequency: float
    mtf: float
    sd: float
    angle_rad: float


def group_of(measurement: Measurement) -> Group:
    """Return what a measurement of "mtf" at the frequency of bars says.

    Raises
    ------
    BadInput
        If it has no value, interval or frequency.
    """
    value, interval, frequency = measurement.value, measurement.interval68, measurement.frequency_cy_per_px
    if value is None or interval is None or frequency is None:
        raise BadInput(f"a group of bars must have an MTF with an interval at a frequency, got {measurement.status}")
    return Group(
        frequency=frequency,
        mtf=value,
        sd=(interval[1] - interval[0]) / (2.0 * HALF68_SD),
        angle_rad=float(np.deg2rad(measurement.orientation_deg or 0.0)),
    )


def joint(measurements: Sequence[Measurement], *, context: Context) -> Result:
    """Fit one curve, c^((f/f2)^n) times the pixel, to several groups of bars of one direction.

    Parameters
    ----------
    measurements
        Of "mtf" at the groups' frequencies, by "bars-forward"; those without a value or not ok are left out.
    context
        Seed, and whether a Markov chain is wanted.

    Returns
    -------
    Result
        `mtf50`, the curve "mtf" with its intervals, and the groups as evidence; refused with fewer than two groups.

    Raises
    ------
    BadInput
        If the groups point in different directions.

    Notes
    -----
    Likelihood normal in each group's MTF, whose error is near linear in it. More groups than two tell whether they
    are of one member of the family: `model-misfit` where chi squared has a chance under 0.001.
    """
    groups = [group_of(one) for one in measurements if one.status == "ok" and one.value is not None]
    provenance = Provenance(version=charact.__version__, seed=context.seed, settings={"groups": len(groups)})
    common = {"method": METHOD, "provenance": provenance}
    if len({group.frequency for group in groups}) < 2:
        reason = f"too few groups: a curve needs bars of two frequencies measured ok, got {len(groups)}"
        return Result(measurements=(refused("mtf50", "cy/px", reason, flags=("low-signal",), **common),))
    _checked_directions(groups)
    posterior, left = _posterior(groups, context)
    angle = groups[0].angle_rad
    curves = _curves(REPORTED, posterior["half_frequency"], posterior["exponent"], angle)
    curves[:, 0] = 1.0
    fine = np.arange(0.002, 1.2, 0.002)
    crossing = falls_to(fine, _curves(fine, posterior["half_frequency"], posterior["exponent"], angle), 0.5)
    flags = [flag for flag in posterior.flags if flag != "prior-bound"]
    if len(groups) > 2 and chi2.sf(left, len(groups) - 2) < MISFIT_LEVEL:
        flags.append("model-misfit")
    orientation = float(np.rad2deg(angle)) % 180.0
    mtf50 = from_draws(
        "mtf50", "cy/px", crossing[np.isfinite(crossing)], flags=tuple(flags), orientation_deg=orientation,
        posterior=posterior, **common,
    )  # fmt: skip
    return Result(
        measurements=(mtf50,), curves={"mtf": curve_of(REPORTED, curves)}, evidence={"bar groups": _evidence(groups)}
    )


def _checked_directions(groups: Sequence[Group]) -> None:
    """Refuse groups of different directions, whose MTFs need not be the same."""
    apart = [abs(np.rad2deg(group.angle_rad - groups[0].angle_rad)) % 180.0 for group in groups]
    largest = max(min(one, 180.0 - one) for one in apart)
    if largest > SAME_DIRECTION_DEG:
        raise BadInput(
            f"groups of bars for one curve must lie within {SAME_DIRECTION_DEG:g} degrees, got {largest:.0f} apart"
        )


def _curves(frequency: Array, half: Array, exponent: Array, angle_rad: float) -> Array:
    """Return the transfer of each draw with the pixel, shape (draw, frequency)."""
    core = np.exp(forms.exponential(np.maximum(frequency, 1e-9), half, exponent))
    return core * forms.aperture(frequency, angle_rad)


def _posterior(groups: Sequence[Group], context: Context):
    """Return draws of half frequency and exponent, and chi squared at the best of them."""
    frequency, mtf, sd = np.array([(group.frequency, group.mtf, group.sd) for group in groups]).T
    pixel = np.array([forms.aperture(np.array([g.frequency]), g.angle_rad)[0] for g in groups])
    mean, width = EXPONENT_PRIOR

    def squares(theta: Array) -> Array:
        model = np.exp(forms.exponential(frequency, theta[:, 0], theta[:, 1])) * pixel
        return np.sum(((mtf - model) / sd) ** 2, axis=1)

    def log_probability(theta: Array) -> Array:
        inside = np.all((theta > BOUNDS[:, 0]) & (theta < BOUNDS[:, 1]), axis=1)
        safe = np.clip(theta, BOUNDS[:, 0], BOUNDS[:, 1])
        prior = ((safe[:, 1] - mean) / width) ** 2
        return np.where(inside, -0.5 * (squares(safe) + prior), -np.inf)

    grid = np.stack(np.meshgrid(*GRID, indexing="ij"), axis=-1).reshape(-1, 2)
    start = grid[int(np.argmax(log_probability(grid)))]
    quick = laplace(
        log_probability, names=("half_frequency", "exponent"), units=("cy/px", "1"), start=start, seed=context.seed,
        bounds=BOUNDS,
    )  # fmt: skip
    best = np.median(quick.draws, axis=0)
    left = float(squares(best[None])[0])
    if context.quick:
        return quick, left
    covariance = np.cov(quick.draws.T)
    chain = sample(
        log_probability, names=quick.names, units=quick.units, start=best, covariance=covariance, seed=context.seed,
        bounds=BOUNDS,
    )  # fmt: skip
    return chain, left


def _evidence(groups: Sequence[Group]) -> dict:
    return {
        "figure": "bar groups",
        "frequency_cy_per_px": [group.frequency for group in groups],
        "mtf": [group.mtf for group in groups],
        "sd": [group.sd for group in groups],
    }
