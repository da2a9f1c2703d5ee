"""The light on the flats of one gain as the session states it, and how far the truth may be from what it states.

One meter reads, and one set of filters weakens, the light of a whole session: its error is a factor common to every
number per lux or per photon, drawn here from the stated uncertainty and never taken for exactly one. What differs from
level to level, the filters among themselves, shows in the response and is found there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.series import FlatSeries
from charact.noise.snr.rounding import rounding_sd
from charact.noise.stack.stack_statistics import StackStatistics
from labdata.conditions import Conditions

Array = NDArray[np.float64]

# Relative standard deviation of a photometer whose uncertainty nobody stated.
UNSTATED_ILLUMINANCE_SD = 0.1
# Departures of the levels from a straight response beyond their noise, as shares of the signal: the range of the prior
# of their standard deviation, flat in its logarithm.
DEPARTURE = (1e-3, 0.1)
DEPARTURES = 41


@dataclass(frozen=True, kw_only=True)
class StatedIllumination:
    """Light of the flats of a series as recorded.

    Parameters
    ----------
    amount
        Light of each flat, shape (flat,): illuminance that would give as much in `seconds`, lux, or photons on a
        pixel in one exposure.
    unit
        "lux" or "photons/px".
    seconds
        The longest time for which one exposure of the series gathers light, s; None where no stack states a time.
    relative_sd
        Relative standard deviation of the light as a whole, dimensionless.
    stated
        Whether the session states it.
    """

    amount: Array
    unit: str
    seconds: float | None
    relative_sd: float
    stated: bool

    def scale(self, seed: int, count: int) -> Array:
        """Return draws of true over recorded light, shape (count,): for one seed alike at every gain of a session."""
        from scipy.special import ndtri

        # Every quantile once, in random order: the median of what is multiplied by it stays where it was.
        place = np.random.default_rng([seed, 21]).permutation(count)
        return np.exp(self.relative_sd * ndtri((place + 0.5) / count))

    @property
    def note(self) -> str:
        """What the interval takes the light for."""
        percent = f"{100 * self.relative_sd:.2g} %"
        if self.stated:
            return f"the light is taken as known to {percent} (standard deviation, common to all levels), as stated"
        if self.unit == "lux":
            return (
                f"the session states no uncertainty of its light: {percent} (standard deviation, common to all levels) "
                "is taken, as for a photometer that nobody calibrated"
            )
        return "the session states no uncertainty of its photons: they are taken for exact"


def gathering_s(conditions: Conditions) -> float | None:
    """Return how long one exposure gathers light, s: the gate's time within the camera's; None if unknown."""
    times = [conditions.exposure_s, None if conditions.gate_ns is None else 1e-9 * conditions.gate_ns]
    known = [time for time in times if time]
    return min(known) if known else None


def relative_sd_of(conditions: list[Conditions], unit: str) -> tuple[float, bool]:
    """Return the relative standard deviation of the light, and whether any of the stacks states it."""
    stated = [c.illuminance_relative_sd for c in conditions if c.illuminance_relative_sd is not None]
    if stated:
        return max(stated), True
    return (UNSTATED_ILLUMINANCE_SD if unit == "lux" else 0.0), False


def light_of_series(series: FlatSeries) -> StatedIllumination | str:
    """Return the light of a series, or a sentence why it is not known."""
    known = [flat.conditions for flat in series.flats]
    lux, photons = [c.illuminance_lux for c in known], [c.photons_per_px for c in known]
    if all(lux):
        times = [gathering_s(c) for c in known]
        if any(times) and not all(times):
            return "some flats state the time for which they gather light (exposure_s, gate_ns) and some do not"
        longest = max((time for time in times if time), default=None)
        share = np.array([1.0 if time is None or longest is None else time / longest for time in times])
        amount, unit = np.array(lux, float) * share, "lux"
        relative_sd, stated = relative_sd_of(known, unit)
        return StatedIllumination(amount=amount, unit=unit, seconds=longest, relative_sd=relative_sd, stated=stated)
    if all(photons):
        return light_of_photons(series, np.array(photons, float))
    return "the light on the flats is unknown: illuminance_lux or photons_per_px of every flat is needed"


def light_of_photons(series: FlatSeries, photons: Array) -> StatedIllumination:
    """Return the light of flats whose photons on a pixel are known."""
    relative_sd, stated = relative_sd_of([flat.conditions for flat in series.flats], "photons/px")
    return StatedIllumination(amount=photons, unit="photons/px", seconds=None, relative_sd=relative_sd, stated=stated)


def signal_sd(flat: StackStatistics, dark: StackStatistics) -> float:
    """Return the standard error of the signal, DN, from how the means of frames scatter and from rounding."""
    steps = [rounding_sd(level.variance_dn2)[0] for level in (flat, dark)]
    return float(np.linalg.norm([_mean_sd(flat), _mean_sd(dark), *steps]))


def _mean_sd(level: StackStatistics) -> float:
    """Standard error of the mean of a stack; that of white noise at least."""
    white = np.sqrt(max(level.variance_dn2, 1e-12) / (level.pixels * level.frames))
    return float(max(np.std(level.frame_mean_dn, ddof=1) / np.sqrt(level.frames), white))


def response_draws(amount: Array, signal: Array, sd: Array, rng: np.random.Generator, count: int) -> Array:
    """Return draws of the signal per amount of light as recorded, shape (count,).

    Parameters
    ----------
    amount
        Light of each level, shape (level,), positive.
    signal, sd
        Signal of each level and its standard error, DN.

    Notes
    -----
    ln(signal / amount) = ln R + e, e normal with the error of the signal and a departure common to the levels whose
    standard deviation is unknown, see `DEPARTURE`. One level tells nothing of it and leaves its prior.
    """
    from scipy.special import softmax

    ratio, own = np.log(signal / amount), sd / signal
    departure = np.geomspace(*DEPARTURE, DEPARTURES)
    weight = 1.0 / (own**2 + departure[:, None] ** 2)
    total = weight.sum(axis=1)
    mean = (weight * ratio).sum(axis=1) / total
    misfit = (weight * (ratio - mean[:, None]) ** 2).sum(axis=1)
    chance = softmax(0.5 * (np.log(weight).sum(axis=1) - np.log(total) - misfit))
    pick = rng.choice(DEPARTURES, count, p=chance)
    return np.exp(mean[pick] + rng.standard_normal(count) / np.sqrt(total[pick]))
