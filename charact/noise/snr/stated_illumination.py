"""Stated illumination of the flats of one gain, and its systematic uncertainty.

One meter and one set of filters serve a session, so its error is one factor common to all quantities per lux or photon.
Errors that differ between levels show in the responsivity and are fitted there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.series import FlatSeries
from charact.noise.rounding import rounding_sd
from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.thresholds import SNR
from labdata.conditions import Conditions

Array = NDArray[np.float64]
# Relative standard deviation of a photometer of unstated uncertainty.
UNSTATED_ILLUMINANCE_SD = 0.1


@dataclass(frozen=True, kw_only=True)
class StatedIllumination:
    """Recorded light of the flats of a series."""

    # light of each flat, shape (flat,): illuminance scaled to an exposure of `seconds`, lux, or photons per pixel and
    # exposure
    amount: Array
    unit: str  # "lux" or "photons/px"
    seconds: float | None  # longest exposure time of the series, s; None if not stated
    relative_sd: float  # common relative standard deviation of the light, dimensionless
    stated: bool  # whether the session states the uncertainty

    def scale(self, seed: int, count: int) -> Array:
        """Return draws of true over recorded light, shape (count,); equal for equal seeds."""
        from scipy.special import ndtri

        # Every quantile once, in random order, leaves the median of a product unchanged.
        place = np.random.default_rng([seed, 21]).permutation(count)
        return np.exp(self.relative_sd * ndtri((place + 0.5) / count))

    @property
    def note(self) -> str:
        """Note on the uncertainty of the light."""
        percent = f"{100 * self.relative_sd:.2g} %"
        if self.stated:
            return f"stated uncertainty of the light: {percent} (standard deviation, common to all levels)"
        if self.unit == "lux":
            return (
                f"the session states no uncertainty of its light: {percent} (standard deviation, common to all levels) "
                "is assumed, as for an uncalibrated photometer"
            )
        return "the session states no uncertainty of its photons: assumed exact"


def gathering_s(conditions: Conditions) -> float | None:
    """Return the exposure time including the gate, s; None if unknown."""
    times = [conditions.exposure_s, None if conditions.gate_ns is None else 1e-9 * conditions.gate_ns]
    known = [time for time in times if time]
    return min(known) if known else None


def relative_sd_of(conditions: list[Conditions], unit: str) -> tuple[float, bool]:
    """Return the relative standard deviation of the light, and whether any stack states it."""
    stated = [c.illuminance_relative_sd for c in conditions if c.illuminance_relative_sd is not None]
    if stated:
        return max(stated), True
    return (UNSTATED_ILLUMINANCE_SD if unit == "lux" else 0.0), False


def light_of_series(series: FlatSeries) -> StatedIllumination | str:
    """Return the light of a series, or why it is unknown."""
    known = [flat.conditions for flat in series.flats]
    lux, photons = [c.illuminance_lux for c in known], [c.photons_per_px for c in known]
    if all(lux):
        times = [gathering_s(c) for c in known]
        if any(times) and not all(times):
            return "either all flats must state exposure_s or gate_ns, or none"
        longest = max((time for time in times if time), default=None)
        share = np.array([1.0 if time is None or longest is None else time / longest for time in times])
        amount, unit = np.array(lux, float) * share, "lux"
        relative_sd, stated = relative_sd_of(known, unit)
        return StatedIllumination(amount=amount, unit=unit, seconds=longest, relative_sd=relative_sd, stated=stated)
    if all(photons):
        return light_of_photons(series, np.array(photons, float))
    return "the light on the flats is unknown: illuminance_lux or photons_per_px of every flat is needed"


def light_of_photons(series: FlatSeries, photons: Array) -> StatedIllumination:
    """Return the light of flats with known photons per pixel."""
    relative_sd, stated = relative_sd_of([flat.conditions for flat in series.flats], "photons/px")
    return StatedIllumination(amount=photons, unit="photons/px", seconds=None, relative_sd=relative_sd, stated=stated)


def signal_sd(flat: StackStatistics, dark: StackStatistics) -> float:
    """Return the standard error of the signal, DN, from the scatter of frame means and from rounding."""
    steps = [rounding_sd(level.variance_dn2)[0] for level in (flat, dark)]
    return float(np.linalg.norm([_mean_sd(flat), _mean_sd(dark), *steps]))


def _mean_sd(level: StackStatistics) -> float:
    """Return the standard error of the mean of a stack, at least that of white noise."""
    white = np.sqrt(max(level.variance_dn2, 1e-12) / (level.pixels * level.frames))
    return float(max(np.std(level.frame_mean_dn, ddof=1) / np.sqrt(level.frames), white))


def response_draws(amount: Array, signal: Array, sd: Array, rng: np.random.Generator, count: int) -> Array:
    """Return draws of the signal per recorded light, shape (count,).

    `amount`: light of each level, shape (level,), positive; `signal`, `sd`: signal of each level and its standard
    error, DN.

    ln(signal / amount) = ln R + e, e normal with the error of the signal and a departure common to the levels whose
    standard deviation is unknown, see `SNR.departure_range`. With one level the prior remains.
    """
    from scipy.special import softmax

    ratio, own = np.log(signal / amount), sd / signal
    departure = np.geomspace(*SNR.departure_range, SNR.departures)
    weight = 1.0 / (own**2 + departure[:, None] ** 2)
    total = weight.sum(axis=1)
    mean = (weight * ratio).sum(axis=1) / total
    misfit = (weight * (ratio - mean[:, None]) ** 2).sum(axis=1)
    chance = softmax(0.5 * (np.log(weight).sum(axis=1) - np.log(total) - misfit))
    pick = rng.choice(SNR.departures, count, p=chance)
    return np.exp(mean[pick] + rng.standard_normal(count) / np.sqrt(total[pick]))
