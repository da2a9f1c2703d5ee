"""Covariance gain, from the covariance summed over pixels and exposures; gain per electron without
a tube.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.dark_current import dark_current
from charact.estimators.noise.data_sheet import data_sheet
from charact.estimators.noise.events.event_measurements import pulses_of_darks
from charact.estimators.noise.findings import (
    Remarks,
    bounded,
    fields_of,
    finding,
    findings_in,
    judged,
    posterior_findings,
    rounding_findings,
)
from charact.estimators.noise.gain.checks import (
    CORRELATED,
    bend_allowance,
    exposure_findings,
    findings_of_darks,
    quantisation_findings,
    slope_findings,
    variance_ratio_changes,
)
from charact.estimators.noise.gain.emva1288 import GainLine, excess_of, gain_line
from charact.estimators.noise.gain.fit import Fit, fit_spectrum
from charact.estimators.noise.gain.model import blur_models
from charact.estimators.noise.gain.pooled_noise import PooledNoise, pool_noise
from charact.estimators.noise.gain.series import (
    FlatSeries,
    gain_obstacle,
    has_intensifier,
    read_levels,
    series_of,
)
from charact.estimators.noise.gain.single_setting import (
    SingleSetting,
    blur_exponent,
    fit_single_setting,
    misfit_findings,
)
from charact.estimators.noise.gain.stack_agreement import as_single_frames, with_drift_of_darks
from charact.estimators.noise.gain.undetected_correlation import allowance_of
from charact.estimators.noise.gain.white_floor import floor_of
from charact.estimators.noise.gain_separation import separate_gains
from charact.estimators.noise.predictive_check import (
    PredictiveResidual,
    findings_of,
    predictive_figure_data,
    predictive_residuals,
)
from charact.estimators.noise.quantities import (
    dark_clipping,
    electron_quantities,
    printed_quantities,
    printed_stacks,
    saturation_level,
    transfer_figure_data,
    without_flats,
)
from charact.estimators.noise.snr_against_light import snr_against_light
from charact.estimators.noise.sweep.sweep import gain_sweep
from charact.estimators.noise.three_dimensional import three_dimensional
from charact.estimators.noise.thresholds import GAIN
from charact.frames.spectrum import Bins
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context, register
from charact.observables import Stacks
from charact.verdict import judge
from labdata import Measurement, Result, Session, has_tube, make_refusal, measurement_from_draws


def spectrum_figure_data(summary: PooledNoise, fit: Fit) -> dict[str, Any]:
    """Return noise power over signal against radial frequency, with its fit."""
    radius = np.hypot(summary.column_cy_per_px, summary.row_cy_per_px)
    order = np.argsort(radius)
    return {
        "figure": "noise-spectrum",
        "radius_cy_per_px": radius[order].tolist(),
        "angle_deg": np.degrees(np.arctan2(summary.row_cy_per_px, summary.column_cy_per_px))[
            order
        ].tolist(),
        "power_dn": summary.power_dn[order].tolist(),
        "power_sd_dn": summary.power_sd_dn[order].tolist(),
        "model_dn": fit.model_dn[order].tolist(),
        "used": fit.in_band[order].tolist(),
        "variance_over_signal_dn": summary.variance_dn,
        "chi2": fit.best.chi2,
        "freedom": fit.best.freedom,
        "chance": fit.best.chance,
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


def gains_of(
    pooled: SingleSetting, allowance: float, context: Context
) -> tuple[GainLine, GainLine]:
    """Return the slope of the standard, and the gain per electron used for derived quantities."""
    plain = gain_line(pooled.series, context=context, allowance=allowance)
    if pooled.white:
        return plain, plain
    excess = excess_of(pooled.series.flats[0].conditions, context)
    draws = excess.divide(pooled.posterior["covariance_gain"], context.seed)
    return plain, replace(plain, posterior=pooled.posterior, slope=draws)


def _of_electrons(
    pooled: SingleSetting,
    gains: tuple[GainLine, GainLine],
    slope: Remarks,
    covariance: Remarks,
    context: Context,
    fields: dict[str, Any],
) -> list[Measurement]:
    """Return the system gain and derived quantities, and the gain behind the blur if the white
    floor is detected.
    """
    if pooled.white:
        return electron_quantities(pooled.series, gains, (slope, slope), context, fields)
    low, right = (float(np.median(gain.slope)) for gain in gains)
    remedy = f"the covariance sum, which gives {right:.4g} DN/e- (covariance_gain)"
    effect = CORRELATED.format(100 * (1 - low / right))
    gain_remarks, why = [*slope, finding("correlated-noise", effect, remedy)], covariance
    blur = float(np.median(pooled.posterior["blur_factor"]))
    if blur < GAIN.min_blur_factor:
        effect = (
            f"{100 * (1 - blur):.2g} % of the noise is correlated between pixels, so that the "
            "gain may not be per electron"
        )
        remedy = "a sensor in session.toml that describes the blur"
        why = [*covariance, finding("correlated-noise", effect, remedy)]
    out = electron_quantities(pooled.series, gains, (gain_remarks, why), context, fields)
    if blur >= GAIN.min_blur_factor:
        return out
    floor = floor_of(pooled.series, pooled.posterior, context=context)
    if floor.is_detected:
        conversion = measurement_from_draws("conversion_gain", "DN/e-", floor.draws, **fields)
        out.append(judge(conversion, findings_in(covariance)))
    return out


METHOD = "covariance-sum"


@register("flats", METHOD)
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
    Covariance gain is K + k F^2, the noise power at frequency 0 over the signal, summed over
    temporal lags. See `charact.estimators.noise.gain.model`.
    """
    darks, flats, single = read_levels(session, context=context, spectra=True, cubes=True)
    darks, flats = as_single_frames(darks, flats)
    fields = fields_of(METHOD, context)
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
    small = image_size_obstacle([level.bins for level in (*darks, *flats)])
    if small is not None:
        out = [
            make_refusal(*name, small, **fields)
            for name in (("covariance_gain", "DN"), ("blur_factor", "1"))
        ]
        stacks = Stacks(darks=tuple(darks))
        out += printed_quantities(stacks, (), with_flats=False, **fields)
        return Result(measurements=tuple(out))
    series = series_of(flats, darks, single) if flats else None
    if series is None or gain_obstacle(series) is not None:
        out = without_flats(darks, series, single, quantity=("covariance_gain", "DN"), **fields)
        # With unusable flats, the blur of the electronics' noise could be mistaken for that of the
        # light.
        alone = _blur_of_darks(darks, context, fields) if darks and not flats else Result()
        return Result(measurements=(*out, *alone.measurements), evidence=alone.evidence)
    return _measure_series(session, series, context, fields)


def image_size_obstacle(bins: list[Bins]) -> str | None:
    """Return why images have too few low frequencies for a covariance sum, or None."""
    smallest = min(bins, key=lambda stack_bins: len(stack_bins.modes), default=None)
    if smallest is None or len(smallest.modes) >= GAIN.min_bins:
        return None
    return (
        f"images of {smallest.window.size} px have too few low spatial frequencies for a "
        "covariance "
        "sum; about 100 x 100 px are needed at least; the method variance works on any size"
    )


def _measure_series(
    session: Session, series: FlatSeries, context: Context, fields: dict[str, Any]
) -> Result:
    """Return all quantities of a flat series."""
    context.progress("posterior of the covariance gain", 0.9)
    pooled = fit_single_setting(series, context=context, quick=context.quick)
    tube = has_intensifier(
        [level.conditions for level in (*series.flats, *series.all_darks)], context
    )
    of_pulses = tube and not pooled.white
    bend = bend_allowance(series)
    if of_pulses:
        pooled = pooled.at_low_signal(context)
    elif bend:
        pooled = pooled.allowing(bend, np.random.default_rng([context.seed, 24]))
    posterior = pooled.posterior
    slope, bent = slope_findings(series), variance_ratio_changes(series)
    lagging = exposure_findings(pooled.exposures)
    allowance = float(np.hypot(allowance_of(pooled.neighbours, pooled.exposures, tube=tube), bend))
    gains = None if of_pulses else gains_of(pooled, allowance, context)
    gain = None if gains is None else gains[1].slope
    residuals: list[PredictiveResidual] = []
    if not context.quick:
        context.progress("frames drawn from the posterior", 0.95)
        residuals = predictive_residuals(
            session.stacks, pooled, gain if pooled.white else None, context=context
        )
    misfits = findings_of(residuals)
    common = bounded(slope)
    remarks = common + misfits + pooled.remarks() + (bent if gains is not None else [])
    remarks += ([] if pooled.white else quantisation_findings(series)) + (
        pooled.departures() if tube or pooled.white else []
    )
    slope += bent + lagging + misfits
    plain, noisy = findings_in(common), findings_in(remarks)
    out = [
        judged(
            with_drift_of_darks(
                measurement_from_draws(name, unit, posterior[name], posterior=posterior, **fields),
                series,
            ),
            remarks,
        )
        for name, unit in (("covariance_gain", "DN"), ("blur_factor", "1"))
    ]
    if gains is not None:
        out += _of_electrons(pooled, gains, slope, remarks, context, fields)
    else:
        reason = (
            "noise of neighbouring pixels is correlated (blur factor "
            f"{float(np.median(posterior['blur_factor'])):.3g}): variance over signal is no gain "
            "per electron; see covariance_gain"
        )
        kind = "not-applicable" if has_tube(context.camera) else "failed"
        out.append(make_refusal("system_gain", "DN/e-", reason, refusal=kind, **fields))
        out += separate_gains(
            series, posterior, context=context, of_signal=plain, of_noise=noisy, **fields
        )
    out.append(saturation_level(series, plain, **fields))
    stacks = printed_stacks(series)
    out += printed_quantities(stacks, findings_of_darks(series), with_flats=False, **fields)
    of_gain = findings_in(bounded(slope)) if pooled.white else noisy
    out += printed_quantities(
        stacks,
        plain,
        with_flats=True,
        gain=gain,
        of_gain=of_gain,
        of_pairs=findings_in(bounded(lagging)),
        **fields,
    )
    result = Result(measurements=tuple(out), evidence=_figure_data(pooled, gain, residuals))
    if gain is None:
        return result
    return result + data_sheet(series, stacks, gain, of_gain, context.seed, **fields)


def _figure_data(
    pooled: SingleSetting, gain: NDArray[np.float64] | None, residuals: list[PredictiveResidual]
) -> dict[str, Any]:
    """Return the figure data."""
    series, summary, posterior = pooled.series, pooled.summary, pooled.posterior
    spectra = "many_lags" if summary.lag.is_detected else "few_lags"
    middle = {
        name: float(np.median(posterior[name]))
        for name in ("covariance_gain", "blur_factor", "lag_factor")
    }
    figures = {
        "photon-transfer": transfer_figure_data(
            series,
            gain=None if gain is None else float(np.median(gain)),
            # Variances corrected for the correlation of frames by image lag.
            variance_dn2=[getattr(flat, spectra).variance_dn2 for flat in series.flats],
            dark_variance_dn2=[getattr(dark, spectra).variance_dn2 for dark in series.darks],
            covariance_dn2=(pooled.levels_dn * series.signal_dn).tolist(),
            covariance_sd_dn2=(pooled.levels_sd_dn * series.signal_dn).tolist(),
            covariance_gain_dn=middle["covariance_gain"],
            blur_factor=middle["blur_factor"],
            lag_factor=middle["lag_factor"],
        ),
        "noise-spectrum": spectrum_figure_data(summary, pooled.fit),
        "autocorrelation": correlation_figure_data(series, summary),
    }
    return figures | ({"predictive-frames": predictive_figure_data(residuals)} if residuals else {})


def _blur_of_darks(
    darks: list[StackStatistics], context: Context, fields: dict[str, Any]
) -> Result:
    """Return the blur factor of the noise of darks."""
    dark = max(darks, key=lambda level: (level.frames, -(level.conditions.exposure_s or 0.0)))
    if dark.variance_dn2 <= 0:
        return Result(
            measurements=(
                make_refusal("blur_factor", "1", f"{dark.label} does not change", **fields),
            )
        )
    few_lags, many_lags = (
        replace(spectrum, power_dn2=0.0 * spectrum.power_dn2, variance_dn2=0.0)
        for spectrum in (dark.few_lags, dark.many_lags)
    )
    nothing = replace(
        dark,
        label="nothing",
        variance_dn2=0.0,
        variance_sd_dn2=0.0,
        few_lags=few_lags,
        many_lags=many_lags,
    )
    unit = np.ones(1)
    series = FlatSeries(
        flats=(dark,),
        darks=(nothing,),
        all_darks=(dark,),
        signal_dn=unit,
        variance_dn2=unit * dark.variance_dn2,
        variance_sd_dn2=unit * dark.variance_sd_dn2,
        fitted=np.ones(1, bool),
        peak=None,
        reference="dark",
    )
    # Electronic noise is not filtered by the pixel aperture.
    summary = pool_noise(series, None)
    forms = blur_models(blur_exponent(context), blurred=False, floor=False)
    blur = fit_spectrum(summary, seed=context.seed, quick=context.quick, forms=forms)
    remarks = [
        "from the darks alone: includes the white noise of the electronics",
        *misfit_findings(blur.best),
        *dark_clipping(dark),
        *bounded(rounding_findings(dark.variance_dn2)),
        *posterior_findings(blur.posterior),
    ]
    blur_factor = measurement_from_draws(
        "blur_factor", "1", blur.posterior["blur_factor"], posterior=blur.posterior, **fields
    )
    return Result(
        measurements=(judged(blur_factor, remarks),),
        evidence={"noise-spectrum": spectrum_figure_data(summary, blur)},
    )
