"""Darks of a camera with a tube: the noise between pulses, and the events that are larger than pulses."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from charact.fit.prior import values_of_description
from charact.fit.stack_levels import StackMean
from charact.fit.tube_time_observations import field_products, frames_of
from labdata.sensor import Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Values that stand out of the noise by so much are pulses, standard deviations and DN; so are their surroundings, rows
# and columns.
PULSE_SD, PULSE_DN, PULSE_REACH = 4.5, 1.5, (7, 9)
# Fewest values below a grey value and largest fraction of them that locate the noise of a coarse digitiser, and both
# fractions for a fine one.
LEAST_COUNT, MOST_BELOW, FINE_BELOW = 50, 0.9, (0.05, 0.5)
# Largest fraction of one grey value of a fine digitiser.
FINE_FRACTION = 0.05
# Fewest quiet values, as a fraction, and fewest frames.
LEAST_QUIET, LEAST_FRAMES = 0.05, 4
# Whole charge of an ion event over k F^2, and of each pixel of its window, DN: no single pulse is as large, and no
# noise that rounding doubles along a line.
ION_CHARGE, ION_PIXEL_DN = 8.0, 1.5
# Window, field rows and columns, in which the charge of a pulse is summed, and the fraction of it that it contains.
WINDOW, WINDOW_FRACTION = (3, 5), 0.8
# Least charge of an ion event over the noise of the window, and the area that its light reaches, rows and columns.
ION_SD, ION_REACH = 7.0, (13, 13)


@dataclass(frozen=True, kw_only=True)
class Darks:
    """Frames of a dark, what is quiet in them, and how its pulses are expected to look."""

    data: NDArray[np.float32]  # shape (frame, row, col), DN
    level: StackMean
    sensor: Sensor
    level_dn: float  # mean of the quiet pixels before rounding, DN
    noise_dn: float  # their standard deviation before rounding, DN
    noise_relative_sd: float  # relative error of that by the pulses among them
    quiet: Mask  # pixels without a pulse near by, shape (frame, row, col)
    event_dn: float  # k F^2 as measured, DN
    reached: Mask  # pixels that the light of an ion event may reach in any frame, shape (row, col)
    ion_charge_dn: tuple[float, ...]  # whole charge of each ion event, DN
    least_ion_dn: float  # whole charge from which an event counts as that of an ion, DN

    @property
    def step(self) -> int:
        """Frame rows from one row of a field to the next."""
        return 2 if self.sensor.video.interlaced else 1

    @property
    def fields(self) -> int:
        """Number of fields in the frames."""
        return len(self.data) * self.step


def darks_of(level: StackMean, sensor: Sensor, event_dn: float) -> Darks | None:
    """Return the frames of a dark and what is quiet in them, or None where its noise cannot be located."""
    from scipy.ndimage import maximum_filter

    data = frames_of(level, sensor)
    if data is None or len(data) < LEAST_FRAMES:
        return None
    first = quiet_noise(data.ravel())
    if first is None:
        return None
    pulse = data >= first[0] + max(PULSE_DN, PULSE_SD * first[1])
    quiet = maximum_filter(pulse, size=(1, *PULSE_REACH)) == 0
    noise = quiet_noise(data[quiet]) if quiet.mean() > LEAST_QUIET else None
    # Pulses among all pixels raise their noise by up to a seventh, among quiet ones by some percent.
    noise, relative_sd = (noise, 0.03) if noise else (first, 0.15)
    reached, charges, least = _find_ions(data, level, sensor, event_dn)
    return Darks(
        data=data, level=level, sensor=sensor, level_dn=noise[0], noise_dn=noise[1], noise_relative_sd=relative_sd,
        quiet=quiet, event_dn=event_dn, reached=reached, ion_charge_dn=charges, least_ion_dn=least,
    )  # fmt: skip


def thresholds_of(values: NDArray[np.floating]) -> tuple[float, float] | None:
    """Return two levels between grey values that locate the lower side and the middle of the noise, DN."""
    codes, counts = np.unique(values, return_counts=True)
    below = np.cumsum(counts)
    fine = counts.max() < FINE_FRACTION * values.size
    least = FINE_BELOW[0] * values.size if fine else float(LEAST_COUNT)
    most = (FINE_BELOW[1] if fine else MOST_BELOW) * values.size
    low, high = np.searchsorted(below, least), np.searchsorted(below, most, side="right") - 1
    return (float(codes[low]) + 0.5, float(codes[high]) + 0.5) if high > low else None


def quiet_noise(values: NDArray[np.floating]) -> tuple[float, float] | None:
    """Return level and standard deviation before rounding of normal noise, from its lower side, DN.

    The fraction below a level c between grey values is the normal distribution at (c - level)/sd, rounded or not.
    Pulses only raise values. None of noise that reaches no second grey value.
    """
    levels = thresholds_of(values)
    if levels is None:
        return None
    return level_and_sd(np.array([float(np.mean(values < level)) for level in levels]), levels)


def level_and_sd(below: Array, levels: tuple[float, float]) -> tuple[float, float]:
    """Return level and standard deviation of normal noise from the fractions below two levels, shape (2,), DN."""
    from scipy.special import ndtri

    low, high = ndtri(below)
    sd = (levels[1] - levels[0]) / (high - low)
    return float(levels[0] - low * sd), float(sd)


def _find_ions(
    data: NDArray[np.float32], level: StackMean, sensor: Sensor, event_dn: float
) -> tuple[Mask, tuple[float, ...], float]:
    """Return the pixels that ion events reach, each event's whole charge and the least charge of one, DN."""
    from scipy.ndimage import label, maximum, maximum_filter, uniform_filter

    step = 2 if sensor.video.interlaced else 1
    charge, window = np.empty_like(data), cast(Any, (0, *WINDOW))
    for parity in range(step):
        charge[:, parity::step] = uniform_filter(data[:, parity::step], size=window) - data.mean()
    charge *= WINDOW[0] * WINDOW[1]
    in_field = field_products(values_of_description(sensor), level.gate_s, 1)[0, 0]
    share = WINDOW_FRACTION * float(np.sqrt(in_field))
    low, middle = np.quantile(charge[0], (0.16, 0.5))
    noise_dn = max(ION_SD * float(middle - low), ION_PIXEL_DN * WINDOW[0] * WINDOW[1])
    least = max(ION_CHARGE * event_dn, noise_dn / share)
    seed = charge > least * share
    # An event is seen in both fields and in later frames: what touches is one event.
    parts, count = cast(Any, label(maximum_filter(seed, size=(1, 5, 5)), structure=np.ones((3, 3, 3))))
    largest = np.atleast_1d(maximum(charge, parts, np.arange(1, count + 1))) if count else np.empty(0)
    reached = maximum_filter(seed.any(axis=0), size=ION_REACH) > 0
    return reached, tuple(float(one) / share for one in largest), least
