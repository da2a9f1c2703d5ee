"""Thresholds of the detection of bars, each with its meaning and source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectionThresholds:
    """Define when a bar target is resolved, and where its contrast is reported."""

    # Least signal-to-noise ratio of a bar (Rosell and Willson, in Perception of Displayed
    # Information, 1973).
    snr: float = 2.8
    # Least modulation of the image: where makers state the limiting resolution of a tube.
    modulation: float = 0.03
    seconds: float = 0.1  # Integration time of the eye, s (same source)
    bar_aspect: float = 7.0  # Length of a bar over its width (STANAG 4349)
    # Frequencies of the minimum resolvable contrast, over the Nyquist frequency.
    shares_of_nyquist: tuple[float, ...] = (0.25, 0.5, 0.75)
    draws: int = 2000  # Draws of a quantity without a posterior


DETECTION = DetectionThresholds()
