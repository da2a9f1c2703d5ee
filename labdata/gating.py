"""How the gate keeps step with the fields of the camera, and how long it is open in each field where it does not."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput

Sync = Literal["free-running", "line-locked", "triggered"]
MAINS_HZ = (50.0, 60.0)

HOLDOFF = 0.99
"""A triggered gate takes no trigger earlier than this share of a field after the one before."""

IN_STEP = 1e-3
"""Fields whose open times differ by less than this share of the opening are in step."""


@dataclass(frozen=True, kw_only=True)
class Gating:
    """What triggers the gate.

    Parameters
    ----------
    sync
        "free-running": the generator's own clock, set to the camera's field rate. "line-locked": the mains.
        "triggered": the camera's field pulse at the generator's trigger input, so that every field has its opening.
    delay_ns
        From the trigger to the opening, ns.
    line_hz
        Frequency of the mains, Hz.
    """

    sync: Sync = "free-running"
    delay_ns: float = 0.0
    line_hz: float = 60.0

    def __post_init__(self) -> None:
        if self.line_hz not in MAINS_HZ:
            raise BadInput(f"line_hz must be one of {', '.join(f'{one:g}' for one in MAINS_HZ)}, got {self.line_hz:g}")
        if not 0.0 <= self.delay_ns <= 1e9:
            raise BadInput(f"delay_ns must lie between 0 and 1e9, got {self.delay_ns:g}")

    def rate_hz(self, field_hz: float) -> float:
        """Openings a second, Hz, before a camera of a field rate, Hz."""
        return self.line_hz if self.sync == "line-locked" else field_hz

    def most_hz(self, field_hz: float) -> float:
        """Openings a second that there can be at most, Hz: triggers may come too early, and count then."""
        return self.rate_hz(field_hz) / (HOLDOFF if self.sync == "triggered" else 1.0)

    def open_time_variation(self, *, width_ns: float, exposure_s: float, field_hz: float) -> float:
        """Return by how much the open time of fields differs, largest less smallest, over the width of one opening.

        Parameters
        ----------
        width_ns
            Width of one opening, ns.
        exposure_s
            Exposure of a field, s.
        field_hz
            Fields a second, Hz.

        Notes
        -----
        A gate of its own clock, or of the mains, meets the fields at a phase that nobody set and that moves: all phases
        count. A triggered one has the phase that it was given.
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
    """Return an exposure, s, or the time of a whole field where it is next to that: a register counts in whole us."""
    field_s = 1.0 / field_hz
    return field_s if abs(exposure_s - field_s) < IN_STEP * field_s else exposure_s


def fields_open_ns(
    begins_s: NDArray[np.floating], exposure_s: float, *, width_ns: float, rate_hz: float
) -> NDArray[np.floating]:
    """Return how long a gate is open in each of many exposures, ns.

    Parameters
    ----------
    begins_s
        When each exposure begins, s after an opening began.
    exposure_s
        How long each lasts, s.
    width_ns
        Width of one opening, ns.
    rate_hz
        Openings a second, Hz.

    Notes
    -----
    The time open since the beginning is F(t) = n w + min(t - n P, w), n = floor(t / P); an exposure has F(end) -
    F(begin).
    """
    period_s, width_s = 1.0 / rate_hz, min(width_ns * 1e-9, 1.0 / rate_hz)

    def since_begin_s(time_s: NDArray[np.floating]) -> NDArray[np.floating]:
        whole = np.floor(time_s / period_s)
        return whole * width_s + np.minimum(time_s - whole * period_s, width_s)

    return 1e9 * (since_begin_s(begins_s + exposure_s) - since_begin_s(begins_s))


def out_of_step(gating: Gating, *, width_ns: float, exposure_s: float, field_hz: float) -> str | None:
    """Say in a sentence where gate and fields are not in step; None where they are."""
    uneven = gating.open_time_variation(width_ns=width_ns, exposure_s=exposure_s, field_hz=field_hz)
    if uneven < IN_STEP:
        return None
    rate_hz = gating.rate_hz(field_hz)
    beat_hz = abs(rate_hz - round(rate_hz / field_hz) * field_hz)
    often = f", a beat of {beat_hz:.3g} Hz" if beat_hz and math.isfinite(beat_hz) else ""
    return (
        f"gate and fields are not in step ({gating.sync}, {rate_hz:g} openings and {field_hz:g} fields a second): the "
        f"open time of a field varies by {100.0 * uneven:.3g}% of the opening{often}; "
        'sync = "triggered" keeps them in step'
    )
