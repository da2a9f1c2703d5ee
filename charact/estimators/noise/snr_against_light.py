"""Signal-to-noise ratio against illumination, and minimum illumination, for every gain of a
session.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.findings import (
    Remarks,
    Unmeasurable,
    bounded,
    fields_of,
    finding,
    findings_in,
    judged,
)
from charact.estimators.noise.gain.checks import (
    exposure_findings,
    is_quantisation_limited,
    series_findings,
)
from charact.estimators.noise.gain.pooled_noise import NO_LAG, pool_noise
from charact.estimators.noise.gain.series import (
    FlatSeries,
    gain_obstacle,
    group_by_gain,
    series_of,
    without_noise,
)
from charact.estimators.noise.gain.stack_agreement import with_drift_of_darks
from charact.estimators.noise.gain.undetected_correlation import temporally_correlated_fraction
from charact.estimators.noise.illumination import (
    StatedIllumination,
    gathering_s,
    light_of_series,
    response_draws,
)
from charact.estimators.noise.noise_law import (
    NAMES,
    UNITS,
    FittedNoiseLaw,
    SignalNoiseSeries,
    area_levels,
    fit_noise_law,
    flats_without_clipping,
    pixel_levels,
)
from charact.estimators.noise.thresholds import SNR
from charact.frames.stack_statistics import SIDE_PX, StackStatistics
from charact.method import Context
from charact.method.stopwatch import with_timing
from labdata import (
    Array,
    Conditions,
    Measurement,
    Posterior,
    Result,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
)
from labdata.conditions import GAINS

# Defining signal-to-noise ratio.
LEAST_SNR = 1.0
ALTERNATIVE = (
    "the signal is not proportional to the light: an automatic gain or brightness "
    "control was active"
)


@dataclass(frozen=True, kw_only=True)
class Scope:
    """A signal-to-noise ratio of a pixel or an area."""

    suffix: str  # suffix of the quantity names
    sentence: str  # description for notes
    levels: SignalNoiseSeries  # signal and noise
    fit: FittedNoiseLaw  # of the levels


def minimum_illumination(
    scope: Scope,
    light: StatedIllumination,
    response: Array,
    remarks: Remarks,
    *,
    seed: int,
    **fields: Any,
) -> Measurement:
    """Return the light at which the SNR is `LEAST_SNR`, or a refusal.

    `light`: light of the flats. `response`: draws of the signal per recorded light. `remarks`: what
    was seen of the series.
    """
    name = f"minimum_illumination{scope.suffix}"
    amount = scope.fit.law.signal_at(LEAST_SNR)[:, 0] / response
    try:
        if any(entry.flag == "agc" for entry in findings_in(remarks)):
            raise Unmeasurable(ALTERNATIVE)
        farther = _extrapolation(amount, scope.levels, light)
    except Unmeasurable as reason:
        return make_refusal(name, light.unit, str(reason), **fields)
    scale = light.scale(seed, len(amount))
    misfit = [] if scope.fit.misfit is None else [finding("model-misfit", scope.fit.misfit)]
    unequal = ", unequal pixels counted" if scope.levels.pattern_sd else ""
    time = "" if light.seconds is None else f", light gathered for {light.seconds:.3g} s"
    sentence = f"signal-to-noise ratio {LEAST_SNR:g} {scope.sentence}{unequal}{time}"
    posterior = Posterior(
        names=(*NAMES, "response", "light_scale", name),
        units=(*UNITS, f"DN/{light.unit}", "1", light.unit),
        draws=np.column_stack([scope.fit.posterior.draws, response, scale, amount * scale]),
        sampler="laplace",
        seed=seed,
    )
    minimum = measurement_from_draws(
        name,
        light.unit,
        amount * scale,
        posterior=posterior,
        notes=(sentence, light.note),
        **fields,
    )
    return judged(minimum, [*remarks, *farther, *misfit])


def _extrapolation(amount: Array, levels: SignalNoiseSeries, light: StatedIllumination) -> Remarks:
    """Return what was seen of an extrapolation beyond the flats; Unmeasurable if it is too
    large.
    """
    chosen = levels.fitted & levels.is_illuminated
    low, high = float(light.amount[chosen].min()), float(light.amount[chosen].max())
    if np.mean(~np.isfinite(amount)) > SNR.max_unreached:
        raise Unmeasurable(f"the ratio may stay below {LEAST_SNR:g} at any light")
    middle = float(np.median(amount))
    if middle > SNR.max_factor_above * high:
        raise Unmeasurable(
            f"the ratio stays below {LEAST_SNR:g} up to the brightest flat, {high:.3g} {light.unit}"
        )
    if middle < low / SNR.max_factor_below:
        raise Unmeasurable(
            f"it is about {middle:.1g} {light.unit}, too far below the dimmest flat of {low:.3g} "
            f"{light.unit} to assume a linear camera response"
        )
    if middle > high:
        return [finding("extrapolated", f"the brightest flat has {high:.3g} {light.unit}")]
    if middle < low:
        sentence = (
            f"the dimmest flat has {low:.3g} {light.unit}; below it the camera response is "
            f"assumed linear"
        )
        is_far = middle < low / SNR.interpolation_factor
        return [finding("extrapolated", sentence) if is_far else sentence]
    return []


def setting_figure_data(
    series: FlatSeries,
    words: str,
    lit: tuple[StatedIllumination, Array] | None,
    scopes: list[Scope],
    measurements: list[Measurement],
) -> dict[str, Any]:
    """Return levels, noise laws and minima of one gain; without light the signal is the abscissa.

    `words`: the gain setting. `lit`: recorded light and draws of the signal per light.
    """
    amount, per_amount, unit = series.signal_dn, 1.0, "DN"
    if lit is not None:
        amount, per_amount, unit = lit[0].amount, float(np.median(lit[1])), lit[0].unit
    shown = scopes[0].levels.is_illuminated & flats_without_clipping(series)
    return {
        "gain": words,
        "unit": unit,
        "label": [flat.label for flat in series.flats],
        "amount": amount[shown].tolist(),
        "fitted": series.fitted[shown].tolist(),
        "scopes": [_scope(scope, shown, amount, per_amount, measurements) for scope in scopes],
    }


def _scope(
    scope: Scope,
    shown: NDArray[np.bool_],
    amount: Array,
    per_amount: float,
    measurements: list[Measurement],
) -> dict[str, Any]:
    """Return levels, noise law and minimum of a pixel or an area."""
    minima = [
        m
        for m in measurements
        if m.quantity == f"minimum_illumination{scope.suffix}" and m.value is not None
    ]
    law = scope.fit.law
    middle = float(np.median(law.signal_at(LEAST_SNR))) / per_amount
    low = (
        min(float(amount[shown].min(initial=np.inf)), middle if np.isfinite(middle) else np.inf)
        / 2.0
    )
    grid = np.geomspace(low, 2.0 * float(amount[shown].max(initial=low)), 60)
    signal = grid * per_amount
    temporal = np.quantile(signal / law.sd(signal), [0.025, 0.5, 0.975], axis=0).tolist()
    return {
        "name": "area" if scope.suffix else "pixel",
        "snr": scope.levels.snr[shown].tolist(),
        "snr_sd": scope.levels.snr_sd[shown].tolist(),
        "law_amount": grid.tolist(),
        **dict(zip(("law_low", "law_snr", "law_high"), temporal, strict=True)),
        "law_with_pattern": np.median(signal / law.sd(signal, pattern=True), axis=0).tolist(),
        "minimum": minima[0].value if minima else None,
        "minimum_interval95": list(minima[0].interval95 or ()) if minima else None,
    }


METHOD = "light-transfer"
PIXEL = "of a pixel: temporal noise of one exposure"
AREA = f"of the mean of {SIDE_PX} x {SIDE_PX} pixels of one exposure, including correlated noise"
AXES = "excludes row, column and frame noise: too few frames to measure it"


@with_timing
def snr_against_light(
    darks: list[StackStatistics],
    flats: list[StackStatistics],
    *,
    single: Sequence[str] = (),
    context: Context,
) -> Result:
    """Return signal-to-noise ratios of a pixel and of an area at every level, and the minimum
    illumination of each.

    `darks`, `flats`: stacks read with their spectra. `single`: labels of excluded stacks of a
    single frame. Returns `snr` and `snr_area` of every flat, `minimum_illumination` and
    `minimum_illumination_area` of every gain, the light at SNR `LEAST_SNR`; as figure data the
    levels with the fitted noise law.

    Noise is that of one exposure less the mean dark. The minimum illumination includes PRNU, and
    its interval the common uncertainty of the light; see `charact.estimators.noise.illumination`.
    """
    groups = group_by_gain(flats)
    parts = [
        _measure_setting(series_of(group, darks, single), len(groups) > 1, context)
        for group in groups
    ]
    measurements = tuple(m for of_gain, _ in parts for m in of_gain)
    gains = [evidence for _, evidence in parts if evidence is not None]
    units = {gain["unit"] for gain in gains}
    unit = units.pop() if len(units) == 1 else ""
    figure = {"figure": "snr-light", "least_snr": LEAST_SNR, "unit": unit, "gains": gains}
    return Result(measurements=measurements, evidence={"snr-light": figure} if gains else {})


def gain_in_words(conditions: Conditions) -> str:
    """Return the gain setting in words."""
    known = [
        (name, getattr(conditions, name)) for name in GAINS if getattr(conditions, name) is not None
    ]
    words = {
        "mcp_v": "MCP at {:g} V",
        "gain_control": "gain control at {:g}",
        "em_gain": "multiplication of {:g}",
        "camera_gain_db": "camera gain of {:g} dB",
    }
    return ", ".join(words[name].format(value) for name, value in known) or "gain not stated"


def _measure_setting(
    series: FlatSeries, several: bool, context: Context
) -> tuple[list[Measurement], dict[str, Any] | None]:
    """Return quantities and figure data of the flats of one gain."""
    fields = fields_of(METHOD, context)
    reason = gain_obstacle(series)
    if series.reference != "dark":
        parts = (
            "there are no darks of two frames or more: the signal is unknown",
            without_noise(series.single),
        )
        reason = "; ".join(part for part in parts if part)
    if reason is not None or not len(series.flats):
        return [
            make_refusal(
                "minimum_illumination",
                "lux",
                reason or "there are no flats",
                refusal="missing",
                **fields,
            )
        ], None
    small = _area_obstacle(series)
    lag = NO_LAG if small else pool_noise(series, None).lag
    remarks = series_findings(series)
    if not lag.is_detected:
        remarks += bounded(exposure_findings(temporally_correlated_fraction(series)))
    if lag.open:
        remarks.append(finding("lag", "image lag has not decayed at the end of the lag sum"))
    words = gain_in_words(series.flats[0].conditions)
    remarks += [words] if several else []
    pixel, lit, unlit = pixel_levels(series, lag), None, ""
    try:
        lit = _responsivity(series, pixel, context)
    except Unmeasurable as reason:
        unlit = str(reason)
    # The dark of the dimmest flat of the longest exposure gives the read noise.
    reference = int(np.argmax([gathering_s(flat.conditions) or 0.0 for flat in series.flats]))
    parts = [("", PIXEL, pixel)]
    if small is None:
        has_cubes = all(level.cube is not None for level in (*series.flats, *series.darks))
        sentence = AREA if has_cubes else f"{AREA}; {AXES}"
        parts.append(("_area", sentence, area_levels(series, lag)))
    scopes = []
    for suffix, sentence, levels in parts:
        rng = np.random.default_rng([context.seed, 23, len(suffix)])
        fit = fit_noise_law(levels, rng, reference=int(levels.dark[reference]))
        scopes.append(Scope(suffix=suffix, sentence=sentence, levels=levels, fit=fit))
    out = [m for scope in scopes for m in _ratios(series, scope, remarks, fields)]
    if lit is None:
        out += [
            make_refusal(
                f"minimum_illumination{scope.suffix}", "lux", unlit, refusal="missing", **fields
            )
            for scope in scopes
        ]
    else:
        out += [
            minimum_illumination(scope, *lit, remarks, seed=context.seed, **fields)
            for scope in scopes
        ]
    out += (
        []
        if small is None
        else [make_refusal("snr_area", "1", small, refusal="not-applicable", **fields)]
    )
    return out, setting_figure_data(series, words, lit, scopes, out)


def _responsivity(
    series: FlatSeries, pixel: SignalNoiseSeries, context: Context
) -> tuple[StatedIllumination, Array]:
    """Return the light of the flats and draws of the signal per light; Unmeasurable without known
    light.
    """
    light, chosen = light_of_series(series.flats), pixel.fitted & pixel.is_illuminated
    if not chosen.any():
        raise Unmeasurable(
            f"no flat below saturation is brighter than its dark by {SNR.lit_sd:g} standard errors"
        )
    levels = light.amount[chosen], pixel.signal_dn[chosen], pixel.signal_sd_dn[chosen]
    return light, response_draws(*levels, np.random.default_rng([context.seed, 22]), SNR.draws)


def _area_obstacle(series: FlatSeries) -> str | None:
    """Return why the images are too small for an area, or None."""
    rows, cols = series.flats[0].bins.window.shape
    if min(rows, cols) >= SNR.squares * SIDE_PX:
        return None
    return (
        f"exposures of {rows} x {cols} px are too small for the noise of {SIDE_PX} x {SIDE_PX} "
        f"px: {SNR.squares} a side"
    )


def _ratios(
    series: FlatSeries, scope: Scope, remarks: Remarks, fields: dict[str, Any]
) -> list[Measurement]:
    """Return the SNR at every level."""
    is_unclipped, out, levels = flats_without_clipping(series), [], scope.levels
    for index, (flat, dark) in enumerate(zip(series.flats, series.darks, strict=True)):
        name, stack_fields = f"snr{scope.suffix}", {**fields, "stack": flat.label}
        if not is_unclipped[index]:
            out.append(
                make_refusal(
                    name,
                    "1",
                    f"{flat.label} is saturated: clipping lowers the noise",
                    refusal="not-applicable",
                    **stack_fields,
                )
            )
        elif not levels.is_illuminated[index]:
            reason = f"{flat.label} is not brighter than its dark by {SNR.lit_sd:g} standard errors"
            out.append(make_refusal(name, "1", reason, **stack_fields))
        else:
            signal_dn, coarse = float(series.signal_dn[index]), []
            if is_quantisation_limited(dark, signal_dn):
                effect = f"rounding removes the faint parts of pulses at {signal_dn:.2g} DN"
                coarse = [finding("quantised", effect, "brighter flats")]
            ratio = measurement_from_sd(
                name,
                "1",
                float(levels.snr[index]),
                float(levels.snr_sd[index]),
                notes=(scope.sentence,),
                **stack_fields,
            )
            ratio = with_drift_of_darks(ratio, series, index)
            out.append(judged(ratio, [*remarks, *coarse]))
    return out
