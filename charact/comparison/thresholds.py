"""Thresholds of comparisons, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ComparisonLimits:
    """Thresholds that decide which measurements and conditions of two sessions match."""

    # Draws of each side; the standard uncertainty of a probability is at most 0.0035
    draws: int = 20_000
    # Of matched frequencies; changes a Gaussian MTF by at most 0.0037
    relative_frequency: float = 0.005
    # Of matched directions; changes an MTF50 whose axes differ by 30 % by at most 2.2 %
    direction_deg: float = 5.0
    # Of a limit's direction; contains the 5 deg of a slanted edge (ISO 12233)
    limit_direction_deg: float = 10.0
    relative_setting: float = 0.01  # Of exposure, gate and light: 1 % of signal
    # Of MCP voltage and control word: 1 % of gain at a gain exponent of 10
    relative_gain_control: float = 0.001
    gain_db: float = 0.1  # Of the camera gain: 1.2 % of signal
    filter_density: float = 0.005  # Optical density: 1.2 % of light
    # Of black body and background: 1.7 % of dL/dT in 3-5 um, 0.5 % in 8-12 um
    infrared_c: float = 0.5


LIMITS = ComparisonLimits()
