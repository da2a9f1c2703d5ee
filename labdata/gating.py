"""Synchronisation of the gate with the camera's fields."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput, check_range

Sync = Literal["free-running", "line-locked", "triggered"]
MAINS_HZ = (50.0, 60.0)

HOLDOFF = 0.99  # Hold-off of a triggered gate, as a fraction of a field
IN_STEP = 1e-3  # Largest relative difference of the open times of synchronous fields


@dataclass(frozen=True, kw_only=True)
class Gating:
    """Trigger of the gate."""

    #: "free-running": the generator's own clock, set to the camera's field rate. "line-locked": the
    #: mains. "triggered": the camera's field pulse at the generator's trigger input, one gate
    #: pulse per field
    sync: Sync = "free-running"
    delay_ns: float = 0.0  #: Delay from the trigger to the gate pulse, ns
    line_hz: float = 60.0  #: Frequency of the mains, Hz

    def __post_init__(self) -> None:
        if self.line_hz not in MAINS_HZ:
            raise BadInput(
                f"line_hz must be one of {', '.join(f'{one:g}' for one in MAINS_HZ)}, got "
                f"{self.line_hz:g}"
            )
        check_range(self, 0.0, 1e9, "delay_ns")

    def rate_hz(self, field_hz: float) -> float:
        """Return the gate rate for a camera of a field rate, Hz."""
        return self.line_hz if self.sync == "line-locked" else field_hz

    def most_hz(self, field_hz: float) -> float:
        """Return the largest gate rate, Hz; the hold-off admits triggers that come early."""
        return self.rate_hz(field_hz) / (HOLDOFF if self.sync == "triggered" else 1.0)

    def open_time_variation(self, *, width_ns: float, exposure_s: float, field_hz: float) -> float:
        """Return the largest difference between open times of fields, relative to the gate width.

        A free-running or line-locked gate has an undefined, drifting phase to the fields: all
        phases are considered. A triggered gate has a fixed phase.
        """
        if not width_ns:
            return 0.0
        exposure_s = whole_field_s(exposure_s, field_hz)
        starts_s = np.linspace(0.0, 1.0 / self.rate_hz(field_hz), 401)
        if self.sync == "triggered":
            starts_s = starts_s[:1]
        begins_s = max(0.0, 1.0 / field_hz - exposure_s)
        open_ns = fields_open_ns(
            starts_s + begins_s - self.delay_ns * 1e-9,
            exposure_s,
            width_ns=width_ns,
            rate_hz=self.rate_hz(field_hz),
        )
        return float(np.ptp(open_ns)) / width_ns


def whole_field_s(exposure_s: float, field_hz: float) -> float:
    """Return an exposure, s; one within the resolution of 1 us of a field time becomes the field
    time.
    """
    field_s = 1.0 / field_hz
    return field_s if abs(exposure_s - field_s) < IN_STEP * field_s else exposure_s


def fields_open_ns(
    begins_s: NDArray[np.floating], exposure_s: float, *, width_ns: float, rate_hz: float
) -> NDArray[np.floating]:
    """Return the open time of the gate in each exposure, ns.

    Parameters
    ----------
    begins_s
        Start of each exposure relative to the start of a gate pulse, s.

    Notes
    -----
    The cumulative open time is F(t) = n w + min(t - n P, w), n = floor(t / P); an exposure has
    F(end) - F(begin).
    """
    period_s, width_s = 1.0 / rate_hz, min(width_ns * 1e-9, 1.0 / rate_hz)

    def since_begin_s(time_s: NDArray[np.floating]) -> NDArray[np.floating]:
        periods = np.floor(time_s / period_s)
        return periods * width_s + np.minimum(time_s - periods * period_s, width_s)

    return 1e9 * (since_begin_s(begins_s + exposure_s) - since_begin_s(begins_s))


def out_of_step(
    gating: Gating, *, width_ns: float, exposure_s: float, field_hz: float
) -> str | None:
    """Return a sentence if gate and fields are not synchronous, else None."""
    uneven = gating.open_time_variation(width_ns=width_ns, exposure_s=exposure_s, field_hz=field_hz)
    if uneven < IN_STEP:
        return None
    rate_hz = gating.rate_hz(field_hz)
    beat_hz = abs(rate_hz - round(rate_hz / field_hz) * field_hz)
    often = f", a beat of {beat_hz:.3g} Hz" if beat_hz and math.isfinite(beat_hz) else ""
    return (
        f"gate and fields are not in step ({gating.sync}, {rate_hz:g} openings and {field_hz:g} "
        f"fields a second): the "
        f"open time of a field varies by {100.0 * uneven:.3g}% of the opening{often}; "
        'sync = "triggered" keeps them in step'
    )
