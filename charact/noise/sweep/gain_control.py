"""Settings of a gain sweep: the varied control, and flats and darks at each of its values."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.series import GAINS
from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.thresholds import SWEEP
from labdata.conditions import Conditions

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class GainControl:
    """A control of the gain.

    Parameters
    ----------
    name
        Name of the condition.
    unit
        Unit.
    words
        Name in notes.
    logarithmic
        Whether the gain is a power of it; else the gain is exponential in it.
    tube
        Whether it acts in the tube, so that the gain per electron is constant.
    """

    name: str
    unit: str
    words: str
    logarithmic: bool
    tube: bool

    def place(self, value: Array) -> Array:
        """Return positions on the axis along which ln gain is linear."""
        if self.logarithmic:
            return np.log(value)
        return value * (np.log(10.0) / 20.0 if self.unit == "dB" else 1.0)

    def value(self, place: Array) -> Array:
        """Return the values at positions, the inverse of `place`."""
        if self.logarithmic:
            return np.exp(place)
        return place / (np.log(10.0) / 20.0 if self.unit == "dB" else 1.0)

    def text(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.4g}" if self.unit == "1" else f"{value:.4g} {self.unit}{'s' * (self.unit == 'count')}"


KNOBS = (
    GainControl(name="mcp_v", unit="V", words="MCP voltage", logarithmic=True, tube=True),
    GainControl(name="gain_control", unit="count", words="control word", logarithmic=False, tube=True),
    GainControl(name="em_gain", unit="1", words="stated multiplication", logarithmic=True, tube=False),
    GainControl(name="camera_gain_db", unit="dB", words="camera gain", logarithmic=False, tube=False),
)


def setting_of(flats: list[StackStatistics], knob: GainControl) -> list[tuple[float, list[StackStatistics]]]:
    """Return the flats by value of a control with all other controls equal; of several groups the one of most
    values."""
    others: dict[tuple, list[StackStatistics]] = {}
    for flat in flats:
        value = getattr(flat.conditions, knob.name)
        if value is not None and (value > 0 or not knob.logarithmic):
            rest = tuple(repeatable_value(flat.conditions, name) for name in GAINS if name != knob.name)
            others.setdefault(rest, []).append(flat)
    grouped = [_by_value(own, knob) for own in others.values()]
    return max(grouped, key=lambda groups: (len(groups), sum(len(own) for _, own in groups)), default=[])


def repeatable_value(conditions: Conditions, name: str) -> float | None:
    """Return a setting rounded to its repeatability."""
    value = getattr(conditions, name)
    if value is None or value == 0:
        return value
    step = SWEEP.same_setting_db if name == "camera_gain_db" else SWEEP.same_setting
    return round(value / step if name == "camera_gain_db" else float(np.log(abs(value))) / step)


def _by_value(flats: list[StackStatistics], knob: GainControl) -> list[tuple[float, list[StackStatistics]]]:
    """Return the flats grouped by value within its repeatability, with the mean value."""
    groups: list[list[StackStatistics]] = []
    last = None
    for flat in sorted(flats, key=lambda level: getattr(level.conditions, knob.name)):
        value = getattr(flat.conditions, knob.name)
        same = SWEEP.same_setting_db if knob.unit == "dB" else SWEEP.same_setting * abs(value)
        if last is None or value - last > same:
            groups.append([])
        groups[-1].append(flat)
        last = value
    return [(float(np.mean([getattr(flat.conditions, knob.name) for flat in own])), own) for own in groups]
