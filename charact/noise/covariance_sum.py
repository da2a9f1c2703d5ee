"""Covariance gain, from the covariance summed over pixels and exposures; gain per electron without a tube."""

from dataclasses import replace
from typing import Any

import numpy as np

from charact.method import Context, register
from charact.noise.checks import (
    QUANTISED_DN2,
    bend_allowance,
    exposure_findings,
    exposure_flags,
    light_findings,
    quantisation_findings,
    series_findings,
    variance_ratio_changes,
)
from charact.noise.dark_current import dark_current
from charact.noise.events.event_measurements import pulses_of_darks
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.gain import emva1288
from charact.noise.gain.emva1288 import excess_of
from charact.noise.gain.fit import Fit, fit_spectrum
from charact.noise.gain.model import blur_models
from charact.noise.gain.pooled_noise import PooledNoise, pool_noise
from charact.noise.gain.series import FlatSeries, has_intensifier, read_levels, series_of
from charact.noise.gain.single_setting import SingleSetting, blur_exponent, fit_single_setting
from charact.noise.gain.white_floor import floor_of
from charact.noise.predictive_check import PredictiveResidual, findings_of, predictive_figure_data, predictive_residuals
from charact.noise.provenance import provenance
from charact.noise.quantities import (
    dark_clipping_flags,
    dark_quantities,
    gain_obstacle,
    pattern_quantities,
    saturation_level,
    white_quantities,
    without_flats,
)
from charact.noise.snr.gain_separation import separate_gains
from charact.noise.snr.snr_against_light import snr_against_light
from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.sweep.sweep import gain_sweep
from charact.noise.three_dimensional import three_dimensional
from charact.noise.thresholds import GAIN
from charact.noise.undetected_correlation import allowance_of
from labdata import flags
from labdata.measurement import Measurement, Result, make_refusal, measurement_from_draws
from labdata.session import Session


def transfer_figure_data(series: FlatSeries, *, gain: float | None = None, **more: Any) -> dict[str, Any]:
    """Return the photon transfer curve: signal, variance and fitted range."""
    return {
        "figure": "photon-transfer",
        "label": [flat.label for flat in series.flats],
        "mean_dn": [flat.mean_dn for flat in series.flats],
        "signal_dn": series.signal_dn.tolist(),
        "variance_dn2": [flat.variance_dn2 for flat in series.flats],
        "variance_sd_dn2": series.variance_sd_dn2.tolist(),
        "fitted": series.fitted.tolist(),
        "system_gain_dn_per_e": gain,
        "reference": series.reference,
        "variance_above_dark_dn2": series.variance_dn2.tolist(),
        "dark_mean_dn": [dark.mean_dn for dark in series.darks],
        "dark_variance_dn2": [dark.variance_dn2 for dark in series.darks],
        **more,
    }


def spectrum_figure_data(summary: PooledNoise, fit: Fit) -> dict[str, Any]:
    """Return noise power over signal against radial frequency, with its fit."""
    radius = np.hypot(summary.column_cy_per_px, summary.row_cy_per_px)
    order = np.argsort(radius)
    return {
        "figure": "noise-spectrum",
        "radius_cy_per_px": radius[order].tolist(),
        "angle_deg": np.degrees(np.arctan2(summary.row_cy_per_px, summary.column_cy_per_px))[order].tolist(),
        "power_dn": summary.power_dn[order].tolist(),
        "power_sd_dn": summary.power_sd_dn[order].tolist(),
        "model_dn": fit.model_dn[order].tolist(),
        "used": fit.used[order].tolist(),
        "variance_over_signal_dn": summary.variance_dn,
        "chi2": fit.chi2,
        "freedom": fit.freedom,
        "chance": fit.chance,
    }


def correlation_figure_data(series: FlatSeries, summary: PooledNoise) -> dict[str, Any]:
    """Return the correlation of neighbouring pixels and of successive exposures."""
    lag = summary.lag
    return {
        "figure": "autocorrelation",
        "label": [flat.label for flat in series.flats],
        "neighbour_correlation": [flat.neighbour_correlation for flat in series.flats],
        "neighbour_sd": [flat.neighbour_sd for flat in series.flats],
        "lag_exposures": lag.lag.tolist(),
        "lag_correlation": lag.correlation.tolist(),
        "lag_correlation_sd": lag.correlation_sd.tolist(),
        "lag_factor": lag.factor,
        "lag_factor_sd": lag.factor_sd,
    }


def gain_of(pooled: SingleSetting, allowance: float, context: Context) -> tuple[emva1288.GainLine, emva1288.GainLine]:
    """Return the slope of the standard, and the gain per electron used for derived quantities."""
    plain = emva1288.gain_line(pooled.series, context=context, allowance=allowance)
    if pooled.white:
        return plain, plain
    excess = excess_of(pooled.series.flats[0].conditions, context)
    draws = excess.divide(pooled.posterior["covariance_gain"], context.seed)
    return plain, replace(plain, posterior=pooled.posterior, slope=draws)


def electron_quantities(
    pooled: SingleSetting,
    gains: tuple[emva1288.GainLine, emva1288.GainLine],
    findings: list[Finding],
    covariance: list[Finding],
    context: Context,
    fields: dict[str, Any],
) -> list[Measurement]:
    """Return the system gain and derived quantities.

    `pooled`: noise of the flats of one setting; `gains`: see `gain_of`; `findings`, `covariance`: findings on the
    slope, and on the covariance sum.
    """
    series, (plain, gain) = pooled.series, gains
    excess = excess_of(series.flats[0].conditions, context)
    notes = () if excess.note is None else (excess.note,)
    own = findings if pooled.white else [*findings, _correlation_finding(pooled, plain, gain)]
    first = measurement_from_draws("system_gain", "DN/e-", plain.slope, flags=flags_of(own) + plain.posterior.flags,
                       notes=notes_of(own) + notes, posterior=plain.posterior, **fields)  # fmt: skip
    why = findings if pooled.white else [*covariance, *_blur_findings(pooled)]
    out = [first, *white_quantities(series, gain, context=context, findings=why, light=light_findings(series),
                                    notes=notes, factor=excess.factor, **fields)]  # fmt: skip
    return out if pooled.white else [*out, *_floor(pooled, covariance, context, fields)]


def _correlation_finding(pooled: SingleSetting, plain: emva1288.GainLine, gain: emva1288.GainLine) -> Finding:
    """Return the finding of correlated neighbours, relative to the gain."""
    low, right = float(np.median(plain.slope)), float(np.median(gain.slope))
    percent = 100.0 * (1.0 - low / right)
    return flags.Finding(
        flag="correlated-noise",
        effect=f"noise of neighbouring pixels is correlated, so that the slope of EMVA 1288 is {percent:.2g} % low",
        remedy=f"the covariance sum, which gives {right:.4g} DN/e- (covariance_gain)",
    )


def _blur_findings(pooled: SingleSetting) -> list[Finding]:
    """Return the finding of stronger correlation than charge diffusion allows."""
    blur = float(np.median(pooled.posterior["blur_factor"]))
    if blur >= GAIN.min_blur_factor:
        return []
    effect = (
        f"{100 * (1 - blur):.2g} % of the noise is correlated between pixels, so that the gain may not be per electron"
    )
    remedy = "a sensor in session.toml that describes the blur"
    return [flags.Finding(flag="correlated-noise", effect=effect, remedy=remedy)]


def _floor(
    pooled: SingleSetting, covariance: list[Finding], context: Context, fields: dict[str, Any]
) -> list[Measurement]:
    """Return the gain per electron behind the blur, if the white floor is detected."""
    if not _blur_findings(pooled):
        return []
    floor = floor_of(pooled.series, pooled.posterior, context=context)
    if not floor.is_detected:
        return []
    return [measurement_from_draws("conversion_gain", "DN/e-", floor.draws, flags=flags_of(covariance), **fields)]


METHOD = "covariance-sum"
QUANTITIES = ("covariance_gain", "blur_factor", "system_gain", "read_noise", "photoelectron_gain")


@register(
    "flats",
    METHOD,
    quantities=QUANTITIES,
    scope="Flats and darks of at least two frames, intensified or not; images of some hundred pixels a side and more. "
    "For white noise the gains are slopes over all levels; a nonlinearity of up to 2 % is not flagged.",
)
def covariance_sum(session: Session, *, context: Context) -> Result:
    """Measure covariance gain, blur factor and all derived quantities from darks and flats.

    Parameters
    ----------
    session
        Session with dark and flat stacks.
    context
        Seed and settings; a sensor description gives pitches and priors.

    Notes
    -----
    Covariance gain is K + k F^2, the noise power at frequency 0 over the signal, summed over temporal lags. See
    `charact.noise.gain.model`.
    """
    darks, flats, single = read_levels(session, context=context, spectra=True, cubes=True)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    result = _measure_levels(session, darks, flats, single, context, fields)
    result += three_dimensional([*darks, *flats], context=context)
    result += dark_current(darks, result, context=context)
    result += gain_sweep(darks, flats, context=context)
    result += pulses_of_darks(session, darks, context=context)
    return result + snr_against_light(darks, flats, single=single, context=context)


def _measure_levels(
    session: Session,
    darks: list[StackStatistics],
    flats: list[StackStatistics],
    single: list[str],
    context: Context,
    fields: dict[str, Any],
) -> Result:
    """Return the gains and derived quantities, or refusals."""
    small = image_size_obstacle([*darks, *flats])
    if small is not None:
        out = [
            make_refusal(name, unit, small, **fields)
            for name, unit in (("covariance_gain", "DN"), ("blur_factor", "1"))
        ]
        out += dark_quantities(tuple(darks), flags=(), **fields) if darks else []
        return Result(measurements=tuple(out))
    series = series_of(flats, darks, single) if flats else None
    if series is None or gain_obstacle(series) is not None:
        out = without_flats(darks, series, single, quantity=("covariance_gain", "DN"), **fields)
        # With unusable flats, the blur of the electronics' noise could be mistaken for that of the light.
        alone = _blur_of_darks(darks, context, fields) if darks and not flats else Result()
        return Result(measurements=(*out, *alone.measurements), evidence=alone.evidence)
    return _measure_series(session, series, context, fields)


def image_size_obstacle(levels: list[StackStatistics]) -> str | None:
    """Return why images have too few low frequencies for a covariance sum, or None."""
    least = min(levels, key=lambda level: len(level.bins.modes), default=None)
    if least is None or len(least.bins.modes) >= GAIN.min_bins:
        return None
    return (
        f"images of {least.pixels} px have too few low spatial frequencies for a covariance sum; about 100 x 100 px "
        "are needed at least; the method variance works on any size"
    )


def _measure_series(session: Session, series: FlatSeries, context: Context, fields: dict[str, Any]) -> Result:
    """Return all quantities of a flat series."""
    context.progress("posterior of the covariance gain", 0.9)
    pooled = fit_single_setting(series, context=context, quick=context.quick)
    tube = has_intensifier([level.conditions for level in (*series.flats, *series.all_darks)], context)
    if tube and not pooled.white:
        pooled = pooled.at_low_signal(context)
    bend = bend_allowance(series)
    if bend and not (tube and not pooled.white):
        pooled = pooled.allowing(bend, np.random.default_rng([context.seed, 24]))
    fit = pooled.fit
    common = series_findings(series, context=context)
    hidden = variance_ratio_changes(series) + exposure_findings(pooled.exposures)
    allowance = float(np.hypot(allowance_of(pooled.neighbours, pooled.exposures, tube=tube), bend))
    gains = None if tube and not pooled.white else gain_of(pooled, allowance, context)
    gain = None if gains is None else gains[1]
    residuals = _predictive_residuals(session, pooled, gain, context)
    findings = (
        common
        + findings_of(residuals)
        + pooled.findings()
        + (variance_ratio_changes(series) if gains is not None else [])
        + ([] if pooled.white else quantisation_findings(series))
        + (pooled.departures() if tube or pooled.white else [])
    )
    flags, notes = flags_of(findings), notes_of(findings)
    own = {"flags": flags, "notes": notes, "posterior": fit.posterior, **fields}
    out = [
        measurement_from_draws("covariance_gain", "DN", fit.posterior["covariance_gain"], **own),
        measurement_from_draws("blur_factor", "1", fit.posterior["blur_factor"], **own),
    ]
    plain = flags_of(common)
    slope = common + hidden + findings_of(residuals)
    out += (
        electron_quantities(pooled, gains, slope, findings, context, fields)
        if gains is not None
        else _photoelectron_quantities(series, fit, context, plain, flags, fields)
    )
    out.append(saturation_level(series, flags=plain, **fields))
    out += dark_quantities(series.all_darks, flags=plain, **fields) if series.all_darks else []
    gain_flags = flags_of(slope if pooled.white else findings)
    out += pattern_quantities(series, None if gain is None else gain.slope, flags=plain, gain_flags=gain_flags,
                              pair_flags=exposure_flags(pooled.exposures), **fields)  # fmt: skip
    evidence = _figure_data(pooled, gain) | (
        {"predictive-frames": predictive_figure_data(residuals)} if residuals else {}
    )
    return Result(measurements=tuple(out), evidence=evidence)


def _predictive_residuals(
    session: Session, pooled: SingleSetting, gain: emva1288.GainLine | None, context: Context
) -> list[PredictiveResidual]:
    """Return the posterior predictive residuals; none for a quick measurement."""
    if context.quick:
        return []
    context.progress("frames drawn from the posterior", 0.95)
    slope = gain.slope if gain is not None and pooled.white else None
    return predictive_residuals(session.stacks, pooled, slope, context=context)


def _figure_data(pooled: SingleSetting, gain: emva1288.GainLine | None) -> dict[str, Any]:
    """Return the figure data."""
    series, summary, fit = pooled.series, pooled.summary, pooled.fit
    spectra = "many" if summary.lag.is_detected else "few"
    return {
        "photon-transfer": transfer_figure_data(
            series,
            gain=None if gain is None else float(np.median(gain.slope)),
            # Variances corrected for the correlation of frames by image lag.
            variance_dn2=[getattr(flat, spectra).variance_dn2 for flat in series.flats],
            dark_variance_dn2=[getattr(dark, spectra).variance_dn2 for dark in series.darks],
            covariance_dn2=(pooled.levels_dn * series.signal_dn).tolist(),
            covariance_sd_dn2=(pooled.levels_sd_dn * series.signal_dn).tolist(),
            covariance_gain_dn=float(np.median(fit.posterior["covariance_gain"])),
            blur_factor=float(np.median(fit.posterior["blur_factor"])),
            lag_factor=float(np.median(fit.posterior["lag_factor"])),
        ),
        "noise-spectrum": spectrum_figure_data(summary, fit),
        "autocorrelation": correlation_figure_data(series, summary),
    }


def _photoelectron_quantities(
    series: FlatSeries,
    fit: Fit,
    context: Context,
    flags: tuple[str, ...],
    covariance_flags: tuple[str, ...],
    fields: dict[str, Any],
) -> list[Measurement]:
    """Return the gain per photoelectron, if the light is known; refuse the gain per electron."""
    blur = float(np.median(fit.posterior["blur_factor"]))
    reason = (
        f"noise of neighbouring pixels is correlated (blur factor {blur:.3g}): variance over signal is no gain "
        "per electron; see covariance_gain"
    )
    apart = separate_gains(
        series, fit.posterior, context=context, flags=flags, covariance_flags=covariance_flags, **fields
    )
    return [make_refusal("system_gain", "DN/e-", reason, **fields), *apart]


def _blur_of_darks(darks: list[StackStatistics], context: Context, fields: dict[str, Any]) -> Result:
    """Return the blur factor of the noise of darks."""
    dark = max(darks, key=lambda level: (level.frames, -(level.conditions.exposure_s or 0.0)))
    if dark.variance_dn2 <= 0:
        return Result(measurements=(make_refusal("blur_factor", "1", f"{dark.label} does not change", **fields),))
    nothing = replace(dark, label="nothing", variance_dn2=0.0, variance_sd_dn2=0.0, few=_zero(dark.few),
                      many=_zero(dark.many))  # fmt: skip
    one = np.ones(1)
    series = FlatSeries(flats=(dark,), darks=(nothing,), all_darks=(dark,), signal_dn=one,
                    variance_dn2=one * dark.variance_dn2, variance_sd_dn2=one * dark.variance_sd_dn2,
                    fitted=np.ones(1, bool), peak=None, reference="dark")  # fmt: skip
    # Electronic noise is not filtered by the pixel aperture.
    summary = pool_noise(series, None)
    forms = blur_models(blur_exponent(context), blurred=False, floor=False)
    blur = fit_spectrum(summary, seed=context.seed, quick=context.quick, forms=forms)
    flags = ("model-misfit",) if blur.chance < 1e-4 else ()
    flags += dark_clipping_flags(dark) + (("quantised",) if dark.variance_dn2 < QUANTISED_DN2 else ())
    note = ("from the darks alone: includes the white noise of the electronics",)
    found = measurement_from_draws(
        "blur_factor",
        "1",
        blur.posterior["blur_factor"],
        flags=flags + blur.posterior.flags,
        notes=note,
        posterior=blur.posterior,
        **fields,
    )
    return Result(measurements=(found,), evidence={"noise-spectrum": spectrum_figure_data(summary, blur)})


def _zero(spectrum):
    return replace(spectrum, power_dn2=0.0 * spectrum.power_dn2, variance_dn2=0.0)
