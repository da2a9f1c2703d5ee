"""Dark current against exposure, and its doubling temperature."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.estimators.noise.findings import (
    Remarks,
    bounded,
    fields_of,
    finding,
    judged,
    scaled,
)
from charact.estimators.noise.gain.checks import drift_and_flicker
from charact.estimators.noise.gain.series import group_by_gain
from charact.estimators.noise.linear_fit import linear_fit
from charact.estimators.noise.thresholds import CHECKS, DARK_CURRENT, DATA_SHEET
from charact.frames.rounding import QUANTISATION_DN2, QUANTISED_DN2, rounding_sd
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.verdict import inherited
from labdata import Array
from labdata.measurement import Measurement, Result, make_refusal, measurement_from_draws

METHOD = "dark-exposures"


@dataclass(frozen=True, kw_only=True)
class DarkSlope:
    """Dark current at one temperature."""

    temperature_c: float | None  # mean temperature, degrees Celsius; None if unknown
    draws: Array  # draws of the dark current, shape (draw,), DN/s
    variance_draws: Array  # draws of the slope of the temporal variance, shape (draw,), DN^2/s
    darks: tuple[StackStatistics, ...]  # in the order of their exposures
    remarks: Remarks  # with bounds in DN/s


@with_timing
def dark_current(darks: list[StackStatistics], result: Result, *, context: Context) -> Result:
    """Return the dark current of an exposure series, and the temperature difference that doubles
    it.

    `darks`: darks; the group of one gain and temperature with most exposures is used; `result`:
    previous measurements; a valid system gain converts DN to electrons.

    The mean of darks is mu_d = mu_d0 + mu_I t (EMVA 1288 Release 3.1, 3.1) and mu_I doubles every
    T_d kelvin (3.2). Scatter about the line beyond the noise widens the interval (Student's t).
    """
    if not darks:
        return Result()
    fields = fields_of(METHOD, context)
    rng = np.random.default_rng([context.seed, 11])
    slopes = [
        group_slope for group in _groups(darks) if (group_slope := _slope(group, rng)) is not None
    ]
    if not slopes:
        known = sorted(
            {d.conditions.exposure_s for d in darks if d.conditions.exposure_s is not None}
        )
        reason = (
            "dark current needs darks of at least two exposures at one gain and temperature, got "
            + (
                f"only {known[0]:.4g} s"
                if len(known) == 1
                else "no two alike but for their exposure"
                if known
                else "none whose exposure is stated"
            )
        )
        return Result(
            measurements=(
                make_refusal("dark_current", "DN/s", reason, refusal="missing", **fields),
            )
        )
    best = max(slopes, key=lambda slope: len({d.conditions.exposure_s for d in slope.darks}))
    out = [
        _current(best, "DN/s", best.draws, best.remarks, **fields),
        *_electrons(best, result, rng, **fields),
    ]
    out.append(_doubling(slopes, rng, **fields))
    return Result(measurements=tuple(out), evidence={"dark-current": _figure_data(best)})


def _groups(darks: list[StackStatistics]) -> list[list[StackStatistics]]:
    """Group darks by temperature, at the gain of most darks."""
    usable = [
        dark
        for dark in darks
        if dark.conditions.exposure_s is not None
        and max(dark.low_fraction, dark.high_fraction) <= CHECKS.max_clipped_fraction
    ]
    groups: list[list[StackStatistics]] = []
    last = None
    for dark in sorted(
        max(group_by_gain(usable), key=len, default=[]),
        key=lambda level: level.conditions.temperature_c or 0.0,
    ):
        temperature_c = dark.conditions.temperature_c
        differs = abs((temperature_c or 0.0) - (last or 0.0)) >= DARK_CURRENT.same_temperature_k
        if not groups or (last is None) != (temperature_c is None) or differs:
            groups.append([])
        groups[-1].append(dark)
        last = temperature_c
    return groups


def _slope(darks: list[StackStatistics], rng: np.random.Generator) -> DarkSlope | None:
    """Fit level against exposure; None for a single exposure."""
    time = np.array([d.conditions.exposure_s for d in darks], float)
    if len(np.unique(time)) < 2:
        return None
    mean = np.array([d.mean_dn for d in darks])
    sd = np.array([d.mean_sd_above(QUANTISATION_DN2) for d in darks])
    line = np.stack([np.ones_like(time), time / time.max()])
    fit = linear_fit(list(line), mean, sd)
    value, error = (
        float(fit.best[1] / time.max()),
        float(np.sqrt(fit.covariance[1, 1]) / time.max()),
    )
    # Change of the slope with each level, 1/s.
    weight = fit.covariance[1] @ line / np.maximum(sd, 1e-12) ** 2 / time.max()
    freedom = len(time) - 2
    if freedom:
        student = rng.standard_t(freedom, DARK_CURRENT.draws)
    else:
        student = rng.standard_normal(DARK_CURRENT.draws)
    noise = np.array([(d.variance_dn2, d.variance_sd_dn2) for d in darks])
    of_noise = linear_fit(list(line), *noise.T)
    noise_error = np.sqrt(of_noise.covariance[1, 1]) * of_noise.stretch(len(time))
    warm = [d.conditions.temperature_c for d in darks if d.conditions.temperature_c is not None]
    return DarkSlope(
        temperature_c=float(np.mean(warm)) if warm else None,
        draws=value + error * fit.stretch(len(time)) * student,
        variance_draws=(of_noise.best[1] + noise_error * student) / time.max(),
        darks=tuple(sorted(darks, key=lambda level: level.conditions.exposure_s or 0.0)),
        remarks=_remarks(darks, time, mean, sd, value, np.abs(weight)),
    )


def _remarks(
    darks: list[StackStatistics], time: Array, mean: Array, sd: Array, slope: float, weight: Array
) -> Remarks:
    """Return what was seen of an exposure series, with bounds of the slope in DN/s.

    A curve a + b x + c x^2, x = t/T, has slopes between those of its ends, which differ from that
    of its line by c. The slope is sum w y of the levels y: a drift of d from first to last frame
    changes it by at most |w| d/2, rounding by sum |w| pi/2 times the first harmonic of its
    sawtooth, see `rounding_shifts`.
    """
    remarks: Remarks = []
    if len(np.unique(time)) == 2:
        effect = "from two exposures: proportionality cannot be checked"
        remarks.append(finding("too-few-frames", effect, "darks of a third exposure"))
    if len(np.unique(time)) > 3:
        x = time / time.max()
        fit = linear_fit([np.ones_like(x), x, x**2], mean, sd)
        bend, error = abs(fit.best[2]), fit.stretch(len(x)) * float(np.sqrt(fit.covariance[2, 2]))
        if bend > max(
            DARK_CURRENT.curvature * abs(slope) * time.max(), DARK_CURRENT.curvature_sd * error
        ):
            effect = "the level of darks is not linear in the exposure"
            remedy = "shorter exposures, or a camera that does not correct its dark level"
            remarks.append(finding("nonlinear", effect, remedy, bound=float(bend / time.max())))
    if any(dark.variance_dn2 < QUANTISED_DN2 for dark in darks):
        effect = "the noise of darks is below the quantisation step, which biases their level"
        harmonic_dn = [np.sqrt(2.0) * rounding_sd(dark.variance_dn2)[0] for dark in darks]
        remarks.append(
            finding("quantised", effect, bound=float(np.pi / 2.0 * weight @ harmonic_dn))
        )
    rise = abs(slope) * float(np.ptp(time))
    for dark, per_dn in zip(darks, weight, strict=True):
        drift = abs(drift_and_flicker(dark)[0])
        if drift > 0.1 * rise:
            effect = (
                f"{dark.label} drifts by {drift:.3g} DN, compared with {rise:.3g} DN between "
                f"exposures"
            )
            remedy = "a camera that has settled in temperature"
            remarks.append(finding("drift", effect, remedy, bound=float(0.5 * per_dn * drift)))
    if any((d.conditions.mcp_v or 0.0) > 0 for d in darks):
        remarks.append("with the tube on: includes the tube's background illumination (EBI)")
    return remarks


def _figure_data(slope: DarkSlope) -> dict[str, Any]:
    """Return level and variance of the darks against their exposure, and which exposures of the
    standard are missing.
    """
    exposures = len({dark.conditions.exposure_s for dark in slope.darks})
    return {
        "figure": "dark-current",
        "exposure_s": [dark.conditions.exposure_s for dark in slope.darks],
        "mean_dn": [dark.mean_dn for dark in slope.darks],
        "mean_sd_dn": [dark.mean_sd_dn for dark in slope.darks],
        "variance_dn2": [dark.variance_dn2 for dark in slope.darks],
        "variance_sd_dn2": [dark.variance_sd_dn2 for dark in slope.darks],
        "missing": ""
        if exposures >= DATA_SHEET.exposures
        else f"{exposures} exposures of darks instead of {DATA_SHEET.exposures} (7.1); add darks "
        "of two frames at more exposures",
    }


def _current(
    slope: DarkSlope,
    unit: str,
    draws: Array,
    remarks: Remarks,
    quantity: str = "dark_current",
    **fields: Any,
) -> Measurement:
    notes = (
        () if slope.temperature_c is None else (f"at {slope.temperature_c:.1f} degrees Celsius",)
    )
    return judged(measurement_from_draws(quantity, unit, draws, notes=notes, **fields), remarks)


def _electrons(
    slope: DarkSlope, result: Result, rng: np.random.Generator, **fields: Any
) -> list[Measurement]:
    """Return the dark current in electrons, if the system gain is known."""
    known = [
        m
        for m in result.find("system_gain")
        if m.value is not None and "correlated-noise" not in m.flags
    ]
    if not known:
        reason = "dark current in electrons needs the system gain, which was not measured"
        return [make_refusal("dark_current", "e-/s", reason, **fields)]
    low, high = known[0].interval68 or (0.0, 0.0)
    draws = float(known[0].value or 0.0) + 0.5 * (high - low) * rng.standard_normal(
        DARK_CURRENT.draws
    )
    gain = float(np.median(draws))
    per_electron = scaled(slope.remarks, 1.0 / gain) if gain else bounded(slope.remarks)
    remarks = [*per_electron, *inherited(known[0])]
    # A drift of the level is none of the variance.
    unbounded: Remarks = [e for e in remarks if isinstance(e, str)]
    name = "dark_current_from_variance"
    return [
        _current(slope, "e-/s", slope.draws / draws, remarks, **fields),
        *(
            _current(slope, unit, slope.variance_draws / draws**power, unbounded, name, **fields)
            for unit, power in (("DN/s", 1), ("e-/s", 2))
        ),
    ]


def _doubling(slopes: list[DarkSlope], rng: np.random.Generator, **fields: Any) -> Measurement:
    """Return the temperature difference that doubles the dark current, from all temperatures."""
    name = ("dark_doubling_temperature", "K")
    known = [slope for slope in slopes if slope.temperature_c is not None]
    if len(known) < 2:
        need = "darks of two exposures each at two temperatures"
        return make_refusal(
            *name,
            f"the temperature law of the dark current needs {need}, got one",
            refusal="missing",
            **fields,
        )
    warm = np.array([slope.temperature_c for slope in known], float)
    draws = np.array([slope.draws for slope in known])
    unseen = [
        f"{t:.1f}"
        for t, current in zip(warm, draws, strict=True)
        if np.quantile(current, 0.025) <= 0
    ]
    if unseen:
        reason = (
            f"no dark current detected at {', '.join(unseen)} degrees Celsius; use longer exposures"
        )
        return make_refusal(*name, reason, **fields)
    log2, law_sd = (
        np.log2(np.maximum(draws, 1e-12 * draws.max())),
        DARK_CURRENT.law_relative_sd / np.log(2.0),
    )
    spread = np.hypot(log2.std(axis=1), law_sd)
    log2 = log2 + law_sd * rng.standard_normal(log2.shape)
    centred_k = warm - np.average(warm, weights=spread**-2)
    rise = (centred_k / spread**2) @ log2 / ((centred_k / spread**2) @ warm)
    if np.quantile(rise, 0.025) <= 0:
        reason = (
            f"the dark current does not rise between {warm.min():.1f} and {warm.max():.1f} "
            f"degrees Celsius"
        )
        return make_refusal(*name, reason, **fields)
    remarks = bounded(entry for slope in known for entry in slope.remarks)
    middle = np.median(log2, axis=1)
    residual = middle - np.average(middle, weights=spread**-2) - np.median(rise) * centred_k
    if np.any(np.abs(residual) > DARK_CURRENT.curvature_sd * spread):
        effect = "the dark current does not double at equal temperature steps"
        remarks.append(finding("model-misfit", effect, "the temperatures as they were"))
    if len(known) == 2:
        remarks.append("from two temperatures: exponential growth cannot be checked")
    return judged(measurement_from_draws(*name, 1.0 / rise, **fields), remarks)
