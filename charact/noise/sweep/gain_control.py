"""What sets the gain: voltage, control word, multiplication or decibels, and the flats taken along each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.series import GAINS
from charact.noise.stack.stack_statistics import StackStatistics
from labdata.conditions import Conditions

Array = NDArray[np.float64]

# Read back, one setting is never quite the same twice: closer ones are one, as a share and in the knob's unit.
SAME_SHARE = 2e-3
SAME_DB = 0.05


@dataclass(frozen=True, kw_only=True)
class GainControl:
    """What sets the gain.

    Parameters
    ----------
    name
        The condition.
    unit
        Its unit.
    words
        How a sentence names it.
    logarithmic
        Whether the gain goes as a power of it; else its logarithm goes straight with it.
    tube
        Whether it acts before the chip, so that the gain per electron stays as it is.
    """

    name: str
    unit: str
    words: str
    logarithmic: bool
    tube: bool

    def place(self, value: Array) -> Array:
        """Return where values lie on the axis along which the logarithm of the gain is straight."""
        if self.logarithmic:
            return np.log(value)
        return value * (np.log(10.0) / 20.0 if self.unit == "dB" else 1.0)

    def value(self, place: Array) -> Array:
        """Return the values at places: the inverse of `place`."""
        if self.logarithmic:
            return np.exp(place)
        return place / (np.log(10.0) / 20.0 if self.unit == "dB" else 1.0)

    def text(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.4g}" if self.unit == "1" else f"{value:.4g} {self.unit}{'s' * (self.unit == 'count')}"


KNOBS = (
    GainControl(name="mcp_v", unit="V", words="plate voltage", logarithmic=True, tube=True),
    GainControl(name="gain_control", unit="count", words="control word", logarithmic=False, tube=True),
    GainControl(name="em_gain", unit="1", words="stated multiplication", logarithmic=True, tube=False),
    GainControl(name="camera_gain_db", unit="dB", words="camera gain", logarithmic=False, tube=False),
)


def setting_of(flats: list[StackStatistics], knob: GainControl) -> list[tuple[float, list[StackStatistics]]]:
    """Return the flats by value of a knob, all other knobs alike; of several such groups the one of most values."""
    others: dict[tuple, list[StackStatistics]] = {}
    for flat in flats:
        value = getattr(flat.conditions, knob.name)
        if value is not None and (value > 0 or not knob.logarithmic):
            rest = tuple(repeatable_value(flat.conditions, name) for name in GAINS if name != knob.name)
            others.setdefault(rest, []).append(flat)
    grouped = [_by_value(own, knob) for own in others.values()]
    return max(grouped, key=lambda groups: (len(groups), sum(len(own) for _, own in groups)), default=[])


def repeatable_value(conditions: Conditions, name: str) -> float | None:
    """Return a setting up to how well it repeats."""
    value = getattr(conditions, name)
    if value is None or value == 0:
        return value
    step = SAME_DB if name == "camera_gain_db" else SAME_SHARE
    return round(value / step if name == "camera_gain_db" else float(np.log(abs(value))) / step)


def _by_value(flats: list[StackStatistics], knob: GainControl) -> list[tuple[float, list[StackStatistics]]]:
    """Flats of values that are the same up to how well a setting repeats, with the mean value."""
    groups: list[list[StackStatistics]] = []
    last = None
    for flat in sorted(flats, key=lambda level: getattr(level.conditions, knob.name)):
        value = getattr(flat.conditions, knob.name)
        same = SAME_DB if knob.unit == "dB" else SAME_SHARE * abs(value)
        if last is None or value - last > same:
            groups.append([])
        groups[-1].append(flat)
        last = value
    return [(float(np.mean([getattr(flat.conditions, knob.name) for flat in own])), own) for own in groups]
