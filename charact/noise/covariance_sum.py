"""Gain of a camera that blurs after its gain: from the covariance summed over pixels and exposures."""

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from charact.method import Context, register
from charact.noise import model, standard
from charact.noise.calibrated import calibrated_quantities
from charact.noise.checks import (
    QUANTISED_DN2,
    bent,
    exposure_findings,
    exposure_flags,
    hidden_findings,
    series_findings,
)
from charact.noise.evidence import correlation_evidence, spectrum_evidence, transfer_evidence
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.hidden import Effect, shared_by_exposures, shared_by_neighbours
from charact.noise.level import Level
from charact.noise.provenance import provenance
from charact.noise.quantities import cut, dark_quantities, pattern_quantities, saturation, white_quantities
from charact.noise.series import Series, read_levels, series_of
from charact.noise.summary import Summary, summarise
from charact.noise.three_dimensional import three_dimensional
from charact.noise.verdict import lit, problem, timed, without_flats
from labdata.measurement import Measurement, Posterior, Result, from_draws, refused
from labdata.session import Session

METHOD = "covariance-sum"
# Levels whose covariance over signal departs by more than this share and this many standard errors lie on no line.
LEVEL_SHARE = 0.06
LEVEL_ERRORS = 5.0
# Relative standard error beyond which the posterior is too skewed for its interval to hold what it promises.
WIDEST_SHARE = 0.35
# Bins of spatial frequency that the blur's five parameters need.
LEAST_BINS = 24


@register(
    "flats",
    METHOD,
    quantities=("covariance_gain", "blur_factor", "system_gain", "read_noise", "photoelectron_gain"),
    preferred=True,
    scope="Flats and darks of at least two frames, intensified or not; images of some hundred pixels a side and more. "
    "Where noise is white the gains are slopes over all levels: a response that bends by up to 2 % goes unflagged.",
)
def covariance_sum(session: Session, *, context: Context) -> Result:
    """Measure covariance gain, blur factor and all that follows from darks and flats.

    Parameters
    ----------
    session
        Session with dark and flat stacks.
    context
        Seed and settings; the sensor, where known, gives pitches and priors.

    Notes
    -----
    Covariance gain is K + k F^2, the power of the noise at frequency 0 over the signal, summed over the lags of the
    phosphor. See `charact.noise.model`.
    """
    began = perf_counter()
    darks, flats, single = read_levels(session, context=context, spectra=True, cubes=True)
    return _of_levels(darks, flats, single, context, began) + three_dimensional([*darks, *flats], context=context)


def _of_levels(darks: list[Level], flats: list[Level], single: list[str], context: Context, began: float
               ) -> Result:  # fmt: skip
    """Gains and all that follows from them, or why there are none."""
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    small = too_small([*darks, *flats])
    if small is not None:
        out = [refused(name, unit, small, **fields) for name, unit in (("covariance_gain", "DN"), ("blur_factor", "1"))]
        out += dark_quantities(tuple(darks), flags=(), **fields) if darks else []
        return Result(measurements=timed(out, began))
    series = series_of(flats, darks, single) if flats else None
    if series is None or problem(series) is not None:
        out = without_flats(darks, series, single, quantity=("covariance_gain", "DN"), **fields)
        # Beside flats that cannot be used, the blur of the electronics' own noise would pass for that of the light.
        alone = _blur_of_darks(darks, context, fields) if darks and not flats else Result()
        return Result(measurements=timed([*out, *alone.measurements], began), evidence=alone.evidence)
    return _of_series(series, context, fields, began)


def too_small(levels: list[Level]) -> str | None:
    """Why images hold too few low frequencies to sum a covariance, or None."""
    least = min(levels, key=lambda level: len(level.bins.modes), default=None)
    if least is None or len(least.bins.modes) >= LEAST_BINS:
        return None
    return (
        f"images of {least.pixels} px hold too few low spatial frequencies for a covariance sum, some 100 x 100 px "
        "are needed at least; the method variance works on any size"
    )


def _of_series(series: Series, context: Context, fields: dict[str, Any], began: float) -> Result:
    """All quantities of a series of flats."""
    context.progress("posterior of the covariance gain", 0.9)
    summary = summarise(series)
    fit = model.fit(summary, seed=context.seed, quick=context.quick, exponent=_exponent(context))
    levels, spread = level_gains(series, summary, fit)
    neighbours, exposures = shared_by_neighbours(lit(series)), shared_by_exposures(series)
    white = not neighbours.seen
    if not summary.lag.tested and exposures.allowance:
        fit = replace(fit, posterior=_allowing(fit.posterior, exposures, context))
    if not white:
        fit = replace(fit, posterior=_at_low_signal(fit.posterior, series, levels, spread, context))
    common = series_findings(series, context=context)
    findings = common + _model_findings(summary, fit) + _lag_findings(summary, exposures)
    findings += (bent(series) if white else []) + _departures(series, levels, spread)
    flags, notes = flags_of(findings), notes_of(findings)
    own = {"flags": flags, "notes": notes, "posterior": fit.posterior, **fields}
    out = [
        from_draws("covariance_gain", "DN", fit.posterior["covariance_gain"], **own),
        from_draws("blur_factor", "1", fit.posterior["blur_factor"], **own),
    ]
    plain = flags_of(common)
    hidden = flags_of(bent(series) + hidden_findings(neighbours, exposures))
    allowance = float(np.hypot(neighbours.allowance, exposures.allowance))
    gain = standard.gain_line(series, context=context, allowance=allowance) if white else None
    out += (
        _white_quantities(series, gain, context, plain + hidden, fields)
        if gain is not None
        else _intensified_quantities(series, fit, context, plain, flags, fields)
    )
    out.append(saturation(series, flags=plain, **fields))
    out += dark_quantities(series.all_darks, flags=plain, **fields) if series.all_darks else []
    out += pattern_quantities(series, None if gain is None else gain.slope, flags=plain, gain_flags=hidden,
                              pair_flags=exposure_flags(exposures), **fields)  # fmt: skip
    evidence = _evidence(series, summary, fit, gain, (levels, spread))
    return Result(measurements=timed(out, began), evidence=evidence)


def _evidence(
    series: Series, summary: Summary, fit: model.Fit, gain: standard.Line | None, per_level
) -> dict[str, Any]:
    """What the report draws; `per_level` are the covariances over signal with their errors."""
    levels, spread = per_level
    spectra = "many" if summary.lag.seen else "few"
    return {
        "photon-transfer": transfer_evidence(
            series,
            gain=None if gain is None else float(np.median(gain.slope)),
            # Frames that share light vary less about their own mean: the variance with that undone.
            variance_dn2=[getattr(flat, spectra).variance_dn2 for flat in series.flats],
            dark_variance_dn2=[getattr(dark, spectra).variance_dn2 for dark in series.darks],
            covariance_dn2=(levels * series.signal_dn).tolist(),
            covariance_sd_dn2=(spread * series.signal_dn).tolist(),
            covariance_gain_dn=float(np.median(fit.posterior["covariance_gain"])),
            blur_factor=float(np.median(fit.posterior["blur_factor"])),
            lag_factor=float(np.median(fit.posterior["lag_factor"])),
        ),
        "noise-spectrum": spectrum_evidence(summary, fit),
        "autocorrelation": correlation_evidence(series, summary),
    }


def _at_low_signal(posterior: Posterior, series: Series, levels, spread, context: Context) -> Posterior:
    """Return the posterior with the covariance gain carried to small signals.

    A microchannel plate tires as its current rises and takes gain and covariance gain along; both are stated for
    small signals. The share lost per DN of signal is the slope of the levels' covariance over signal.
    """
    chosen = series.fitted
    if chosen.sum() < 3:
        return posterior
    signal, weight = series.signal_dn[chosen], 1.0 / spread[chosen] ** 2
    design = np.stack([np.ones_like(signal), signal / signal.max()])
    covariance = np.linalg.inv(design * weight @ design.T)
    first, slope = covariance @ (design * weight @ levels[chosen])
    excess = float(weight @ (levels[chosen] - first - slope * design[1]) ** 2) / max(1, chosen.sum() - 2)
    pooled = float(weight @ levels[chosen] / weight.sum())
    rest_sd = np.sqrt(max(1.0, excess) * max(covariance[0, 0] - 1.0 / weight.sum(), 0.0)) / pooled
    rng = np.random.default_rng([context.seed, 4])
    factor = first / pooled + rest_sd * rng.standard_normal(len(posterior.draws))
    draws = posterior.draws.copy()
    draws[:, posterior.names.index("covariance_gain")] *= factor
    return replace(posterior, draws=draws)


def _exponent(context: Context) -> tuple[float, float]:
    """Prior of the exponent of the blur: the sensor's own where it is known."""
    if context.sensor is None:
        return model.EXPONENT
    known = context.sensor.tube.mtf_exponent
    spread = 0.0 if known.low is None or known.high is None else (known.high - known.low) / 3.92
    return float(known), max(spread, 0.05)


def _white_quantities(series: Series, gain: standard.Line, context: Context, flags: tuple[str, ...],
                      fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Gain in DN per electron and what follows from it, where noise is white."""
    own = flags + gain.posterior.flags
    first = from_draws("system_gain", "DN/e-", gain.slope, flags=own, posterior=gain.posterior, **fields)
    return [first, *white_quantities(series, gain, context=context, flags=own, **fields)]


def _intensified_quantities(
    series: Series,
    fit: model.Fit,
    context: Context,
    flags: tuple[str, ...],
    covariance_flags: tuple[str, ...],
    fields: dict[str, Any],
) -> list[Measurement]:
    """The gain per photoelectron where the light is known; the gain per electron is refused."""
    blur = float(np.median(fit.posterior["blur_factor"]))
    reason = (
        f"neighbouring pixels share noise (blur factor {blur:.3g}): the variance over the signal is no gain "
        "per electron; see covariance_gain"
    )
    calibrated = calibrated_quantities(
        series, fit.posterior, context=context, flags=flags, covariance_flags=covariance_flags, **fields
    )
    return [refused("system_gain", "DN/e-", reason, **fields), *calibrated]


def level_gains(series: Series, summary: Summary, fit: model.Fit):
    """Return the covariance over signal of every flat under the common blur, and its standard error, DN."""
    shape = fit.model_dn / float(np.median(fit.posterior["power"]))
    name = "many" if summary.lag.seen else "few"
    use = fit.used
    gains, errors = [], []
    for flat, dark, signal in zip(series.flats, series.darks, series.signal_dn, strict=True):
        power = getattr(flat, name).power_dn2[use, 0] - getattr(dark, name).power_dn2[use, 0]
        modes = flat.bins.modes[use] * flat.bins.efficiency
        weight = modes / modes.sum()
        scaled = power / shape[use] / signal
        gains.append(float(weight @ scaled))
        own = np.sqrt(weight**2 @ (scaled - gains[-1]) ** 2)
        errors.append(float(np.hypot(own, gains[-1] * flat.variance_sd_dn2 / max(flat.variance_dn2, 1e-12))))
    return np.array(gains) * summary.lag.factor, np.array(errors) * summary.lag.factor


def _allowing(posterior: Posterior, exposures: Effect, context: Context) -> Posterior:
    """Return the posterior with what too few frames cannot exclude of lag."""
    rng = np.random.default_rng([context.seed, 6])
    return standard.widened(posterior, "covariance_gain", exposures.allowance, rng)


def _lag_findings(summary: Summary, exposures: Effect) -> list[Finding]:
    """Light of earlier exposures that is there and was not summed to its end."""
    if summary.lag.seen and summary.lag.open:
        return [("lag", f"earlier exposures still glow after {summary.lag.lag[-1]} more, where the sum over lags ends")]
    if summary.lag.seen:
        return []
    return exposure_findings(exposures)


def _model_findings(summary: Summary, fit: model.Fit) -> list[Finding]:
    """What the fit itself says against or about its numbers."""
    found: list[Finding] = []
    if fit.chance < 1e-4:
        found.append(("model-misfit", f"residuals of the noise spectrum have chi2 {fit.chi2:.0f} of {fit.freedom}"))
    blur = float(np.median(fit.posterior["blur_factor"]))
    if blur < 0.9:
        found.append((None, f"noise is correlated between pixels (blur factor {blur:.3g}) and was treated as such"))
    if summary.lag.seen:
        found.append((None, f"earlier exposures glow on (lag factor {summary.lag.factor:.3g}); all lags were summed"))
    low, middle, high = np.quantile(fit.posterior["covariance_gain"], [0.16, 0.5, 0.84])
    if 0.5 * (high - low) > WIDEST_SHARE * middle:
        found.append(
            ("too-few-frames", "the power at frequency 0 is known to worse than a third: more frames or pixels")
        )
    found += [(flag, "see the posterior") for flag in fit.posterior.flags]
    return found


def _departures(series: Series, levels, spread) -> list[Finding]:
    """Levels whose covariance over signal is far from that of the others."""
    chosen = np.flatnonzero(series.fitted)
    middle = float(np.median(levels[chosen]))
    return [
        (
            "model-misfit",
            f"covariance over signal of {series.flats[i].label} is {levels[i]:.3g} DN, not {middle:.3g} DN",
        )
        for i in chosen
        if abs(levels[i] - middle) > max(LEVEL_SHARE * middle, LEVEL_ERRORS * spread[i])
    ]


def _blur_of_darks(darks: list[Level], context: Context, fields: dict[str, Any]) -> Result:
    """Blur factor of the noise of darks alone."""
    dark = max(darks, key=lambda level: (level.frames, -(level.conditions.exposure_s or 0.0)))
    if dark.variance_dn2 <= 0:
        return Result(measurements=(refused("blur_factor", "1", f"{dark.label} does not change", **fields),))
    nothing = replace(dark, label="nothing", variance_dn2=0.0, variance_sd_dn2=0.0, few=_zero(dark.few),
                      many=_zero(dark.many))  # fmt: skip
    one = np.ones(1)
    series = Series(flats=(dark,), darks=(nothing,), all_darks=(dark,), signal_dn=one,
                    variance_dn2=one * dark.variance_dn2, variance_sd_dn2=one * dark.variance_sd_dn2,
                    fitted=np.ones(1, bool), peak=None, reference="dark")  # fmt: skip
    summary = summarise(series)
    fit = model.fit(summary, seed=context.seed, quick=context.quick, exponent=_exponent(context))
    flags = ("model-misfit",) if fit.chance < 1e-4 else ()
    flags += cut(dark) + (("quantised",) if dark.variance_dn2 < QUANTISED_DN2 else ())
    note = ("from the darks alone: the electronics' white noise is in it",)
    found = from_draws("blur_factor", "1", fit.posterior["blur_factor"], flags=flags + fit.posterior.flags,
                       notes=note, posterior=fit.posterior, **fields)  # fmt: skip
    return Result(measurements=(found,), evidence={"noise-spectrum": spectrum_evidence(summary, fit)})


def _zero(spectrum):
    return replace(spectrum, power_dn2=0.0 * spectrum.power_dn2, variance_dn2=0.0)
