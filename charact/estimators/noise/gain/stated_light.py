"""Checks of the signal of flats against the light that the session states."""

import numpy as np

from charact.estimators.noise.findings import finding
from charact.estimators.noise.gain.series import FlatSeries
from charact.estimators.noise.gain.undetected_correlation import gamma_of_light
from charact.estimators.noise.thresholds import CHECKS
from charact.verdict import Finding
from labdata import Array, Conditions


def _light_of_conditions(series: FlatSeries) -> tuple[Array, Array] | None:
    """Return stated light and signal of the fitted flats; None if one is unknown, or there is one
    flat only.
    """
    chosen = np.flatnonzero(series.fitted)
    light = [light_of(series.flats[i].conditions) for i in chosen]
    if len(chosen) < 2 or any(value is None or value <= 0 for value in light):
        return None
    return np.array(light, float), series.signal_dn[chosen]


def light_statement_findings(series: FlatSeries) -> list[Finding]:
    """Return the finding of different levels under the same stated light."""
    stated = _light_of_conditions(series)
    if stated is None:
        return []
    exposure, signal = stated
    ratio = signal / exposure
    levels, light = (values.max() / values.min() for values in (ratio, exposure))
    if light >= CHECKS.min_light_ratio or levels < CHECKS.min_light_ratio:
        return []
    effect = (
        f"levels differ {levels:.3g}-fold under light stated to differ {light:.3g}-fold, so that "
        "numbers per photon or lux may be off as much"
    )
    return [
        finding(
            "agc", effect, "illuminance_lux, photons_per_px or exposure_s of each flat as it was"
        )
    ]


def light_of(conditions: Conditions) -> float | None:
    """Return the stated exposure in arbitrary units; None if the light is unknown."""
    if conditions.photons_per_px is not None:
        return conditions.photons_per_px
    if conditions.illuminance_lux is None:
        return None
    time = conditions.gate_ns if conditions.gate_ns is not None else conditions.exposure_s
    return conditions.illuminance_lux * (1.0 if time is None else time)


def proportionality_findings(series: FlatSeries) -> list[Finding]:
    """Return findings of a signal that is not proportional to the stated light."""
    # A gain change common to all levels does not show in flats; the session must state it.
    if any(
        flat.conditions.automatic_gain or flat.conditions.brightness_control
        for flat in series.flats
    ):
        return [finding("agc", "an automatic gain or brightness control was on")]
    stated = _light_of_conditions(series)
    if stated is None:
        return []
    exposure, signal = stated
    span = exposure.max() / exposure.min()
    if span < CHECKS.min_light_ratio:
        return []
    if gamma := gamma_of_light(exposure, signal):
        return gamma
    slope = float(
        np.polyfit(np.log(exposure), np.log(np.maximum(signal, 1e-3 * signal.max())), 1)[0]
    )
    if slope < CHECKS.min_light_exponent:
        effect = f"the light changed {span:.3g}-fold and the mean as its power {slope:.2f} only"
        return [finding("agc", effect)]
    ratio = signal / exposure
    reference = float(exposure @ signal / (exposure @ exposure))
    off = float(np.abs(ratio / reference - 1.0)[signal > 0.05 * signal.max()].max())
    if off > CHECKS.nonlinear_fraction:
        effect = f"signal over light deviates by {100 * off:.1f} % from its mean"
        return [finding("nonlinear", effect)]
    return []
