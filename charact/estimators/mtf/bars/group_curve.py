"""One MTF curve through several bar groups of a camera."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

import charact
from charact.estimators.mtf.bars.checks import finding, findings_of_posterior
from charact.estimators.mtf.bars.thresholds import LIMITS
from charact.estimators.mtf.curve import REPORTED, crossing_frequency, curve_of
from charact.estimators.mtf.known_transfer import halo_diameters_px
from charact.estimators.mtf.session.joint_model import JointBlurModel, KnownCameraTransfer
from charact.estimators.mtf.session.stage_transfers import prior_sd_of
from charact.inference import find_maximum, importance_sample, sample_posterior
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.transfer.extended import HaloComponent
from charact.verdict import judge
from labdata import (
    Array,
    BadInput,
    Curve,
    Measurement,
    Posterior,
    Provenance,
    Result,
    has_tube,
    make_refusal,
    measurement_from_draws,
)

METHOD = "bars-joint"
# Method without errors by harmonics or phase.
GROUPS_BY = "bars-forward"
# Frequency grid for MTF50, cy/px.
FINE = np.arange(0.002, 1.2, 0.002)


class Group(NamedTuple):
    """One bar group: frequency, cycles per pixel, MTF there, its standard uncertainty, direction
    across the bars.
    """

    frequency: float
    mtf: float
    sd: float
    angle_rad: float


def frame_curves(result: Result, *, context: Context) -> Result:
    """Return MTF50, curve and figure data through the bar groups of one frame, along rows and along
    columns.

    `result`: measurements of "mtf" by "bars-forward". The curves are "mtf" (rows) and
    "mtf_vertical" (columns), in cycles per column pitch; a direction without valid groups of two
    frequencies has none.
    """
    return _by_direction(result.measurements, ("mtf", "mtf_vertical"), context)


def session_curves(result: Result, kinds: Mapping[str, str], *, context: Context) -> Result:
    """Return the same through the bar targets of a session, as curves "mtf_bars" and
    "mtf_bars_vertical".

    `kinds`: kind of each stack ("edge", "bars", "point") by its label.
    """
    groups = [m for m in result.measurements if kinds.get(m.stack or "") == "bars"]
    return _by_direction(groups, ("mtf_bars", "mtf_bars_vertical"), context)


def _by_direction(
    measurements: Sequence[Measurement], names: tuple[str, str], context: Context
) -> Result:
    """Return one curve along rows and one along columns, each where valid groups of two frequencies
    exist.
    """
    sound = [
        m
        for m in measurements
        if m.quantity == "mtf" and m.method == GROUPS_BY and m.status == "ok" and m.interval68
    ]
    out = Result()
    for way, axis_deg, name in zip(("rows", "columns"), (0.0, 90.0), names, strict=True):
        parallel = _parallel_groups(sound, axis_deg)
        frequencies = [m.frequency_cy_per_px for m in parallel if m.frequency_cy_per_px]
        if not frequencies or max(frequencies) < LIMITS.min_frequency_ratio * min(frequencies):
            continue
        fitted = fit_group_curve(parallel, context=context)
        out += Result(
            measurements=fitted.measurements,
            curves={name: fitted.curves["mtf"]},
            evidence={f"bar groups, {way}": fitted.evidence["bar groups"]},
        )
    return out


def _parallel_groups(sound: Sequence[Measurement], axis_deg: float) -> list[Measurement]:
    """Return the largest set of groups near an axis within half the permitted angle of one of
    them.
    """
    near_axis = [
        m
        for m in sound
        if _angle_between_deg(m.orientation_deg, axis_deg) < LIMITS.max_axis_angle_deg
    ]
    spread = 0.5 * LIMITS.max_direction_spread_deg
    sets = [
        [
            m
            for m in near_axis
            if _angle_between_deg(m.orientation_deg, centre.orientation_deg) <= spread
        ]
        for centre in near_axis
    ]
    return max(sets, key=len, default=[])


def _angle_between_deg(one_deg: float | None, other_deg: float | None) -> float:
    """Angle between two directions, 0 to 90 degrees."""
    difference_deg = abs((one_deg or 0.0) - (other_deg or 0.0)) % 180.0
    return min(difference_deg, 180.0 - difference_deg)


@with_timing
def fit_group_curve(measurements: Sequence[Measurement], *, context: Context) -> Result:
    """Fit one curve, c^((f/f2)^n) times the known transfer, to several bar groups of one direction.

    Parameters
    ----------
    measurements
        Of "mtf" by "bars-forward"; those without an interval or not ok are excluded.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf50`, the curve "mtf" and figure data of the groups; refused with fewer than two groups,
        or where MTF50 lies far from all of them.

    Raises
    ------
    BadInput
        If the groups have different directions.

    Notes
    -----
    The likelihood is normal in each group's MTF. With more groups than parameters, `model-misfit`
    is set where chi squared has a p-value under 0.001.
    """
    # Half of a 68 % interval is 0.994458 standard deviations.
    groups = [
        Group(
            m.frequency_cy_per_px or 0.0,
            m.value,
            float(np.ptp(m.interval68)) / (2.0 * 0.994458),
            float(np.deg2rad(m.orientation_deg or 0.0)),
        )
        for m in measurements
        if m.status == "ok" and m.value is not None and m.interval68
    ]
    provenance = Provenance(
        version=charact.__version__,
        seed=context.seed,
        settings={"quick": context.quick, "groups": len(groups)},
    )
    common: dict[str, Any] = {"method": METHOD, "provenance": provenance}
    if len({group.frequency for group in groups}) < 2:
        reason = (
            f"too few groups: a curve needs bars of two frequencies measured ok, got {len(groups)}"
        )
        return Result(
            measurements=(make_refusal("mtf50", "cy/px", reason, flags=("low-signal",), **common),)
        )
    spread_deg = max(
        _angle_between_deg(*np.rad2deg([group.angle_rad, groups[0].angle_rad])) for group in groups
    )
    if spread_deg > LIMITS.max_direction_spread_deg:
        rule = (
            f"groups of bars for one curve must lie within {LIMITS.max_direction_spread_deg:g} "
            "degrees"
        )
        raise BadInput(f"{rule}, got {spread_deg:.0f} apart")
    # Directions half a turn apart are equal: average the doubled angles.
    turned = np.sum(np.exp(2j * np.array([group.angle_rad for group in groups])))
    angle_rad = 0.5 * float(np.angle(turned))
    along = float(np.cos(angle_rad)), float(np.sin(angle_rad))
    halo = (
        HaloComponent(size_px=halo_diameters_px(context, transposed=False))
        if has_tube(context.camera)
        else None
    )
    known = KnownCameraTransfer.of(context)
    model = JointBlurModel(
        core="exponential", blurred=False, wide=halo, elliptical=False, known=known
    )
    posterior, chi2 = _posterior(groups, model, along, context)

    def mtf_of(frequency: Array) -> Array:
        return model.transfer(posterior.draws, along[0] * frequency, along[1] * frequency)

    freedom = len(groups) - 2
    findings = findings_of_posterior(posterior.flags)
    if freedom > 0 and chdtrc(freedom, chi2) < LIMITS.min_group_p_value:
        effect = f"no curve fits all groups: chi-squared {chi2:.3g}, {freedom} degrees of freedom"
        findings.append(finding("model-misfit", effect))
    curves = mtf_of(REPORTED)
    curves[:, 0] = 1.0
    common |= {
        "orientation_deg": float(np.rad2deg(angle_rad)) % 180.0,
        "posterior": posterior,
    }
    mtf50 = judge(_mtf50(mtf_of(FINE), groups, common), findings)
    curve = curve_of(REPORTED, curves)
    return Result(
        measurements=(mtf50,),
        curves={"mtf": curve},
        evidence={"bar groups": _figure_data(groups, curve)},
    )


def _mtf50(curves: Array, groups: Sequence[Group], common: dict[str, Any]) -> Measurement:
    """Return MTF50 of drawn curves; refused where no group is near it."""
    crossing = crossing_frequency(FINE, curves, 0.5)
    frequencies = sorted({group.frequency for group in groups})
    notes = [
        (
            f"Curve through {len(groups)} bar groups: "
            f"{', '.join(f'{frequency:.3g}' for frequency in frequencies)} cy/px."
        )
    ]
    half = float(np.median(np.where(np.isfinite(crossing), crossing, FINE[-1])))
    if (
        not frequencies[0] / LIMITS.max_extrapolation
        < half
        < frequencies[-1] * LIMITS.max_extrapolation
        or np.mean(~np.isfinite(crossing)) > LIMITS.max_lost_draws
    ):
        reason = (
            f"MTF50 must lie within a factor of {LIMITS.max_extrapolation:g} of the groups' "
            f"frequencies, {frequencies[0]:.3g} to {frequencies[-1]:.3g} cy/px, got about "
            f"{half:.2g}"
        )
        return make_refusal("mtf50", "cy/px", reason, notes=tuple(notes), **common)
    if not frequencies[0] <= half <= frequencies[-1]:
        notes.append(
            "MTF50 lies beyond the groups; it is extrapolated by the model exp(-(f/fc)^n) times "
            "the known transfer."
        )
    return measurement_from_draws(
        "mtf50", "cy/px", crossing[np.isfinite(crossing)], notes=tuple(notes), **common
    )


def _posterior(
    groups: Sequence[Group], model: JointBlurModel, along: tuple[float, float], context: Context
) -> tuple[Posterior, float]:
    """Return draws of the parameters, and chi squared at the optimum."""
    frequency, mtf, sd, _ = np.array(groups).T
    fx, fy = along[0] * frequency, along[1] * frequency
    known, bend = model.known(fx, fy), model.known.bend(fx)

    def squares(theta: Array) -> Array:
        return np.sum(((mtf - known * model.unknown(theta, fx, fy, bend=bend)) / sd) ** 2, axis=1)

    def log_probability(theta: Array) -> Array:
        density = model.log_prior(theta) - 0.5 * squares(
            np.clip(theta, model.bounds[:, 0], model.bounds[:, 1])
        )
        if has_tube(context.camera):
            fraction = context.camera.photocathode.halo_fraction
            density -= 0.5 * ((theta[:, 2] - float(fraction)) / prior_sd_of(fraction)) ** 2
        return density

    starts = np.repeat(model.start(0.0)[None], 40 * 23, axis=0)
    grid = np.meshgrid(np.log(np.geomspace(0.03, 0.8, 40)), np.linspace(0.8, 3.0, 23))
    starts[:, 0], starts[:, 1] = (axis.ravel() for axis in grid)
    start = starts[int(np.argmax(log_probability(starts)))]
    best, covariance = find_maximum(log_probability, start, model.bounds)
    # Half frequency and exponent have a curved ridge, which a Gaussian approximation misses.
    drawn = (importance_sample if context.quick else sample_posterior)(
        log_probability,
        names=model.names,
        units=model.units,
        start=best,
        covariance=covariance,
        seed=context.seed,
        bounds=model.bounds,
    )
    return drawn, float(squares(best[None])[0])


def _figure_data(groups: Sequence[Group], curve: Curve) -> dict[str, Any]:
    low, high = curve.interval95 if curve.interval95 is not None else (curve.value, curve.value)
    return {
        "figure": "bar-groups",
        "frequency_cy_per_px": [group.frequency for group in groups],
        "mtf": [group.mtf for group in groups],
        "sd": [group.sd for group in groups],
        "curve_cy_per_px": curve.frequency_cy_per_px.tolist(),
        "curve": curve.value.tolist(),
        "curve_low95": low.tolist(),
        "curve_high95": high.tolist(),
    }
