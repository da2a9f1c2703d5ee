"""Signal-to-noise ratio against illumination, and minimum illumination, for every gain of a session."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.noise.checks import exposure_findings, is_quantisation_limited, series_findings
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.gain.pooled_noise import pool_noise
from charact.noise.gain.series import GAINS, FlatSeries, gain_of, series_of, without_noise
from charact.noise.provenance import provenance
from charact.noise.quantities import gain_obstacle
from charact.noise.snr.noise_law import (
    NAMES,
    NO_LAG,
    UNITS,
    NoiseLaw,
    SignalNoiseSeries,
    area_levels,
    flats_without_clipping,
    noise_law,
    pixel_levels,
)
from charact.noise.snr.stated_illumination import StatedIllumination, gathering_s, light_of_series, response_draws
from charact.noise.stack.stack_statistics import SIDE_PX, StackStatistics
from charact.noise.thresholds import SNR
from charact.noise.undetected_correlation import temporally_correlated_fraction
from labdata.conditions import Conditions
from labdata.measurement import (
    Measurement,
    Posterior,
    Result,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
)

Array = NDArray[np.float64]
# Defining signal-to-noise ratio.
LEAST_SNR = 1.0
ALTERNATIVE = "the signal is not proportional to the light: an automatic gain or brightness control was active"


@dataclass(frozen=True, kw_only=True)
class Scope:
    """A signal-to-noise ratio of a pixel or an area."""

    suffix: str  # suffix of the quantity names
    sentence: str  # description for notes
    levels: SignalNoiseSeries  # signal and noise
    law: NoiseLaw  # fitted noise law


def scope_of(suffix: str, sentence: str, levels: SignalNoiseSeries, reference: int, context: Context) -> Scope:
    """Fit the noise law of a pixel or an area; its read noise is that of the dark of flat `reference`."""
    rng = np.random.default_rng([context.seed, 23, len(suffix)])
    law = noise_law(levels, rng, reference=int(levels.dark[reference]))
    return Scope(suffix=suffix, sentence=sentence, levels=levels, law=law)


def minimum_illumination(
    scope: Scope,
    light: StatedIllumination | str,
    response: Array | None,
    findings: list[Finding],
    *,
    seed: int,
    **fields: Any,
) -> Measurement:
    """Return the light at which the SNR is `LEAST_SNR`, or a refusal.

    `scope`: pixel or area; `light`: light of the flats, or why it is unknown; `response`: draws of the signal per
    recorded light; `findings`: findings of the series.
    """
    name = f"minimum_illumination{scope.suffix}"
    if isinstance(light, str) or response is None:
        return make_refusal(name, "lux", str(light), **fields)
    if "agc" in flags_of(findings):
        return make_refusal(name, light.unit, ALTERNATIVE, **fields)
    amount = scope.law.signal_at(LEAST_SNR) / response
    reason, farther = _beyond(amount, scope.levels, light)
    if reason is not None:
        return make_refusal(name, light.unit, reason, **fields)
    scale = light.scale(seed, len(amount))
    found = [*findings, *farther, *law_findings(scope.law)]
    unequal = ", unequal pixels counted" if scope.levels.pattern_sd else ""
    sentence = f"signal-to-noise ratio {LEAST_SNR:g} {scope.sentence}{unequal}{_time(light)}"
    notes = (sentence, light.note, *notes_of(found))
    posterior = Posterior(
        names=(*NAMES, "response", "light_scale", name),
        units=(*UNITS, f"DN/{light.unit}", "1", light.unit),
        draws=np.column_stack([scope.law.posterior.draws, response, scale, amount * scale]),
        sampler="laplace",
        seed=seed,
    )
    return measurement_from_draws(
        name, light.unit, amount * scale, flags=flags_of(found), notes=notes, posterior=posterior, **fields
    )


def law_findings(law: NoiseLaw) -> list[Finding]:
    """Return the findings of the noise law."""
    return [] if law.misfit is None else [("model-misfit", law.misfit)]


def _time(light: StatedIllumination) -> str:
    return "" if light.seconds is None else f", light gathered for {light.seconds:.3g} s"


def _beyond(amount: Array, levels: SignalNoiseSeries, light: StatedIllumination) -> tuple[str | None, list[Finding]]:
    """Return the reason to refuse an extrapolation, or None, and the findings of a smaller one."""
    chosen = levels.fitted & levels.is_illuminated
    low, high = float(light.amount[chosen].min()), float(light.amount[chosen].max())
    if np.mean(~np.isfinite(amount)) > SNR.max_unreached:
        return f"the ratio may stay below {LEAST_SNR:g} at any light", []
    middle = float(np.median(amount))
    if middle > SNR.max_factor_above * high:
        return f"the ratio stays below {LEAST_SNR:g} up to the brightest flat, {high:.3g} {light.unit}", []
    if middle < low / SNR.max_factor_below:
        return (
            f"it is about {middle:.1g} {light.unit}, too far below the dimmest flat of {low:.3g} {light.unit} to "
            "assume a linear camera response"
        ), []
    if middle > high:
        return None, [("extrapolated", f"the brightest flat has {high:.3g} {light.unit}")]
    if middle < low:
        sentence = f"the dimmest flat has {low:.3g} {light.unit}; below it the camera response is assumed linear"
        return None, [("extrapolated" if middle < low / SNR.interpolation_factor else None, sentence)]
    return None, []


def snr_figure_data(gains: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figure data of all gains; the unit of light is empty if they differ."""
    units = {gain["unit"] for gain in gains}
    return {
        "figure": "snr-light",
        "least_snr": LEAST_SNR,
        "unit": units.pop() if len(units) == 1 else "",
        "gains": gains,
    }


def setting_figure_data(
    series: FlatSeries,
    words: str,
    light: StatedIllumination | str,
    response: Array | None,
    scopes: list[Scope],
    found: list[Measurement],
) -> dict[str, Any]:
    """Return levels, noise laws and minima of one gain.

    `series`, `words`: the flats, and their gain setting in words; `light`, `response`: recorded light and signal per
    light; without light the signal is the abscissa; `scopes`: pixel and area; `found`: the measurements.
    """
    if isinstance(light, str) or response is None:
        amount, per_amount, unit = series.signal_dn, 1.0, "DN"
    else:
        amount, per_amount, unit = light.amount, float(np.median(response)), light.unit
    shown = scopes[0].levels.is_illuminated & flats_without_clipping(series)
    return {
        "gain": words,
        "unit": unit,
        "label": [flat.label for flat in series.flats],
        "amount": amount[shown].tolist(),
        "fitted": series.fitted[shown].tolist(),
        "scopes": [_scope(scope, shown, amount, per_amount, found) for scope in scopes],
    }


def _scope(scope: Scope, shown: NDArray[np.bool_], amount: Array, per_amount: float, found: list[Measurement]
           ) -> dict[str, Any]:  # fmt: skip
    """Return levels, noise law and minimum of a pixel or an area."""
    least = [m for m in found if m.quantity == f"minimum_illumination{scope.suffix}" and m.value is not None]
    middle = float(np.median(scope.law.signal_at(LEAST_SNR))) / per_amount
    low = min(float(amount[shown].min(initial=np.inf)), middle if np.isfinite(middle) else np.inf) / 2.0
    grid = np.geomspace(low, 2.0 * float(amount[shown].max(initial=low)), SNR.figure_points)
    temporal = np.quantile(scope.law.snr(grid * per_amount), [0.025, 0.5, 0.975], axis=0)
    total = np.median(scope.law.snr(grid * per_amount, pattern=True), axis=0)
    return {
        "name": "area" if scope.suffix else "pixel",
        "snr": scope.levels.snr[shown].tolist(),
        "snr_sd": scope.levels.snr_sd[shown].tolist(),
        "law_amount": grid.tolist(),
        "law_low": temporal[0].tolist(),
        "law_snr": temporal[1].tolist(),
        "law_high": temporal[2].tolist(),
        "law_with_pattern": total.tolist(),
        "minimum": least[0].value if least else None,
        "minimum_interval95": list(least[0].interval95 or ()) if least else None,
    }


METHOD = "light-transfer"
PIXEL = "of a pixel: temporal noise of one exposure"
AREA = f"of the mean of {SIDE_PX} x {SIDE_PX} pixels of one exposure, including correlated noise"
AXES = "excludes row, column and frame noise: too few frames to measure it"


@with_timing
def snr_against_light(
    darks: list[StackStatistics], flats: list[StackStatistics], *, single: Sequence[str] = (), context: Context
) -> Result:
    """Return signal-to-noise ratios of a pixel and of an area at every level, and the minimum illumination of each.

    `darks`, `flats`: stacks read with their spectra; `single`: labels of excluded stacks of a single frame.

    Returns `snr` and `snr_area` of every flat, `minimum_illumination` and `minimum_illumination_area` of every gain,
    the light at SNR `LEAST_SNR`; as figure data the levels with the fitted noise law.

    Noise is that of one exposure less the mean dark. The minimum illumination includes PRNU, and its interval the
    common uncertainty of the light; see `charact.noise.snr.stated_illumination`.
    """
    groups: dict[tuple, list[StackStatistics]] = {}
    for flat in flats:
        groups.setdefault(gain_of(flat.conditions), []).append(flat)
    parts = [_measure_setting(series_of(group, darks, single), len(groups) > 1, context) for group in groups.values()]
    measurements = tuple(one for found, _ in parts for one in found)
    gains = [evidence for _, evidence in parts if evidence is not None]
    return Result(measurements=measurements, evidence={"snr-light": snr_figure_data(gains)} if gains else {})


def gain_in_words(conditions: Conditions) -> str:
    """Return the gain setting in words."""
    known = [(name, getattr(conditions, name)) for name in GAINS if getattr(conditions, name) is not None]
    words = {"mcp_v": "MCP at {:g} V", "gain_control": "gain control at {:g}", "em_gain": "multiplication of {:g}",
             "camera_gain_db": "camera gain of {:g} dB"}  # fmt: skip
    return ", ".join(words[name].format(value) for name, value in known) or "gain not stated"


def _measure_setting(
    series: FlatSeries, several: bool, context: Context
) -> tuple[list[Measurement], dict[str, Any] | None]:
    """Return quantities and figure data of the flats of one gain."""
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    reason = gain_obstacle(series) if series.reference == "dark" else _no_darks(series)
    if reason is not None or not len(series.flats):
        return [make_refusal("minimum_illumination", "lux", reason or "there are no flats", **fields)], None
    small = _area_obstacle(series)
    lag = NO_LAG if small else pool_noise(series, None).lag
    findings = series_findings(series, context=context)
    findings += exposure_findings(temporally_correlated_fraction(series)) if not lag.is_detected else []
    findings += [("lag", "image lag has not decayed at the end of the lag sum")] if lag.open else []
    words = gain_in_words(series.flats[0].conditions)
    findings += [(None, words)] if several else []
    light = light_of_series(series)
    pixel = pixel_levels(series, lag)
    if not isinstance(light, str) and not (pixel.fitted & pixel.is_illuminated).any():
        light = f"no flat below saturation is brighter than its dark by {SNR.lit_sd:g} standard errors"
    response = None if isinstance(light, str) else _response(pixel, light, context)
    scopes = [scope_of("", PIXEL, pixel, _reference(series), context)]
    if small is None:
        area = area_levels(series, lag)
        scopes.append(scope_of("_area", _area_words(series), area, _reference(series), context))
    out = [one for scope in scopes for one in _ratios(series, scope, findings, fields)]
    out += [minimum_illumination(scope, light, response, findings, seed=context.seed, **fields) for scope in scopes]
    out += [] if small is None else [make_refusal("snr_area", "1", small, **fields)]
    return out, setting_figure_data(series, words, light, response, scopes, out)


def _no_darks(series: FlatSeries) -> str:
    reason = "there are no darks of two frames or more: the signal is unknown"
    return "; ".join(part for part in (reason, without_noise(series.single)) if part)


def _area_words(series: FlatSeries) -> str:
    whole = all(level.cube is not None for level in (*series.flats, *series.darks))
    return AREA if whole else f"{AREA}; {AXES}"


def _area_obstacle(series: FlatSeries) -> str | None:
    """Return why the images are too small for an area, or None."""
    rows, cols = series.flats[0].bins.window.shape
    if min(rows, cols) >= SNR.squares * SIDE_PX:
        return None
    return (
        f"exposures of {rows} x {cols} px are too small for the noise of {SIDE_PX} x {SIDE_PX} px: {SNR.squares} a side"
    )


def _reference(series: FlatSeries) -> int:
    """Return the flat whose dark gives the read noise: the dimmest of the longest exposure."""
    times = [gathering_s(flat.conditions) or 0.0 for flat in series.flats]
    return int(np.argmax(times))


def _response(levels: SignalNoiseSeries, light: StatedIllumination, context: Context) -> Array:
    """Draws of the signal per recorded light."""
    chosen = levels.fitted & levels.is_illuminated
    rng = np.random.default_rng([context.seed, 22])
    return response_draws(light.amount[chosen], levels.signal_dn[chosen], levels.signal_sd_dn[chosen], rng, SNR.draws)


def _ratios(series: FlatSeries, scope: Scope, findings: list[Finding], fields: dict[str, Any]) -> list[Measurement]:
    """Return the SNR at every level."""
    whole, out = flats_without_clipping(series), []
    own = {"flags": flags_of(findings), "notes": (scope.sentence, *notes_of(findings))}
    for index, flat in enumerate(series.flats):
        name, labelled = f"snr{scope.suffix}", {**fields, "stack": flat.label}
        if not whole[index]:
            reason = f"{flat.label} is saturated: clipping lowers the noise"
            out.append(make_refusal(name, "1", reason, **labelled))
        elif not scope.levels.is_illuminated[index]:
            reason = f"{flat.label} is not brighter than its dark by {SNR.lit_sd:g} standard errors"
            out.append(make_refusal(name, "1", reason, **labelled))
        else:
            value, sd = float(scope.levels.snr[index]), float(scope.levels.snr_sd[index])
            flags = own["flags"] + _quantisation_flags(series, index)
            out.append(measurement_from_sd(name, "1", value, sd, **labelled, **{**own, "flags": flags}))
    return out


def _quantisation_flags(series: FlatSeries, index: int) -> tuple[str, ...]:
    """Return the flag of a signal of few DN distorted by rounding."""
    return ("quantised",) if is_quantisation_limited(series.darks[index], float(series.signal_dn[index])) else ()
