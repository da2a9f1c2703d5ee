"""Thresholds of the validation: how many sets are simulated, and when a statistic fails."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ValidationThresholds:
    """Set the ensemble, the tests and the controls."""

    # Simulated sets of frames, each from its own posterior draw: with fewer the tails of the tests
    # grow, with more the time.
    draws: int = 20
    # Repetitions of the parametric bootstrap; the least p-value is one over them.
    replicates: int = 4000
    # Family-wise level of all statistics: a right sensor fails once in 100 sessions.
    level: float = 0.01
    # Relative change of a parameter in its negative control, and probability with which an error
    # must be found.
    control_change: float = 0.3
    power: float = 0.8
    # Frames of a stack that are compared, of an edge more since it is cropped.
    frames: int = 8
    edge_frames: int = 16
    # Least frames of a stack: EMVA 1288 sets have pairs.
    fewest_frames: int = 2
    # Share of full scale above which a flat is outside the linear range, and share of clipped
    # pixels, of a flat and of a ring about a point source.
    highest_share: float = 0.8
    most_clipped: float = 1e-3


VALIDATION = ValidationThresholds()
