"""Steps and limits of the infrared imagers."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ImagerLimits:
    """Numbers of the imagers that are neither physics nor a description's."""

    # The picture goes on beyond the frame as it ends there, for so many pixels: ten times the blur
    # of a lens.
    margin_px: int = 8
    # Steps of time in an active line: a sixteenth of the shortest dwell; and time constants of lead
    # before it.
    line_steps: int = 4096
    lead: float = 8.0
    # Full scale of a cooled array over its well, so that a full well is at full scale under noise
    # and correction.
    full_scale_of_well: float = 0.98
    # Values of 1/f noise in a line: above their Nyquist frequency, 1 MHz, it is weaker than a knee
    # of 0.1 MHz' white.
    values_per_line: int = 128


LIMITS = ImagerLimits()
