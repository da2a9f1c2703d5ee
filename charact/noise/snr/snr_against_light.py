"""Signal-to-noise ratio against illumination, and minimum illumination, for every gain of a session."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.noise.checks import exposure_findings, is_quantisation_limited, series_findings
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.gain.pooled_noise import pool_noise
from charact.noise.gain.series import GAINS, FlatSeries, gain_of, series_of, without_noise
from charact.noise.gain_feasibility import gain_obstacle
from charact.noise.provenance import provenance
from charact.noise.snr.area import SIDE_PX
from charact.noise.snr.figure_data import setting_figure_data, snr_figure_data
from charact.noise.snr.levels import NO_LAG, area_levels, pixel_levels, unclipped_flats
from charact.noise.snr.minimum_illumination import Scope, minimum_illumination, scope_of
from charact.noise.snr.noise_law import SignalNoiseSeries
from charact.noise.snr.stated_illumination import StatedIllumination, gathering_s, light_of_series, response_draws
from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.thresholds import SNR
from charact.noise.undetected_correlation import temporally_correlated_fraction
from labdata.conditions import Conditions
from labdata.measurement import Measurement, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

METHOD = "light-transfer"
PIXEL = "of a pixel: temporal noise of one exposure"
AREA = f"of the mean of {SIDE_PX} x {SIDE_PX} pixels of one exposure, including correlated noise"
AXES = "excludes row, column and frame noise: too few frames to measure it"


@with_timing
def snr_against_light(
    darks: list[StackStatistics], flats: list[StackStatistics], *, single: Sequence[str] = (), context: Context
) -> Result:
    """Return signal-to-noise ratios of a pixel and of an area at every level, and the minimum illumination of each.

    Parameters
    ----------
    darks, flats
        Stacks read with their spectra.
    single
        Labels of excluded stacks of a single frame.
    context
        Seed.

    Returns
    -------
    Result
        `snr` and `snr_area` of every flat, `minimum_illumination` and `minimum_illumination_area` of every gain, the
        light at SNR `LEAST_SNR`; as figure data the levels with the fitted noise law.

    Notes
    -----
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
    findings += exposure_findings(temporally_correlated_fraction(series)) if not lag.seen else []
    findings += [("lag", "image lag has not decayed at the end of the lag sum")] if lag.open else []
    words = gain_in_words(series.flats[0].conditions)
    findings += [(None, words)] if several else []
    light = light_of_series(series)
    pixel = pixel_levels(series, lag)
    if not isinstance(light, str) and not (pixel.fitted & pixel.lit).any():
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
    chosen = levels.fitted & levels.lit
    rng = np.random.default_rng([context.seed, 22])
    return response_draws(light.amount[chosen], levels.signal_dn[chosen], levels.signal_sd_dn[chosen], rng, SNR.draws)


def _ratios(series: FlatSeries, scope: Scope, findings: list[Finding], fields: dict[str, Any]) -> list[Measurement]:
    """Return the SNR at every level."""
    whole, out = unclipped_flats(series), []
    own = {"flags": flags_of(findings), "notes": (scope.sentence, *notes_of(findings))}
    for index, flat in enumerate(series.flats):
        name, told = f"snr{scope.suffix}", {**fields, "stack": flat.label}
        if not whole[index]:
            reason = f"{flat.label} is saturated: clipping lowers the noise"
            out.append(make_refusal(name, "1", reason, **told))
        elif not scope.levels.lit[index]:
            reason = f"{flat.label} is not brighter than its dark by {SNR.lit_sd:g} standard errors"
            out.append(make_refusal(name, "1", reason, **told))
        else:
            value, sd = float(scope.levels.snr[index]), float(scope.levels.snr_sd[index])
            flags = own["flags"] + _quantisation_flags(series, index)
            out.append(measurement_from_sd(name, "1", value, sd, **told, **{**own, "flags": flags}))
    return out


def _quantisation_flags(series: FlatSeries, index: int) -> tuple[str, ...]:
    """Return the flag of a signal of few DN distorted by rounding."""
    return ("quantised",) if is_quantisation_limited(series.darks[index], float(series.signal_dn[index])) else ()
