"""Observations of the frames of a tube's darks and flats: lag, darks, and the PRNU parted from
coarser patterns.
"""

import numpy as np
from numpy.typing import NDArray

from charact.fitting.observation import Observation, scalar_observation
from charact.fitting.thresholds import FRAMES, PATTERN
from charact.fitting.tube_dark_observations import dark_observations
from charact.fitting.tube_ions import IonEvents
from charact.fitting.tube_time_observations import (
    block_sums,
    filter_covariance,
    frames_of,
    time_observations,
)
from charact.observables import Values
from charact.observables.stack_level import StackLevel
from labdata.camera.description import Camera

Array = NDArray[np.float64]
PRNU = "ccd.prnu"


def frame_observations(
    sensor: Camera, levels: tuple[StackLevel, ...], ions: IonEvents | None
) -> list[Observation]:
    """Return what the frames of darks and flats show in time and space, each only where it
    shows.
    """
    return [
        *time_observations(sensor, levels),
        *dark_observations(ions),
        *pattern_observations(sensor, levels),
    ]


def pattern_observations(sensor: Camera, levels: tuple[StackLevel, ...]) -> list[Observation]:
    """Return the observation of the PRNU in the brightest flats, or none where their noise hides
    it.
    """
    black_dn = min(
        (level.mean_dn for level in levels if level.dark),
        default=float(sensor.video.black_level_dn),
    )
    lit = sorted((level for level in levels if not level.dark), key=lambda level: -level.mean_dn)[
        : FRAMES.most_flats
    ]
    flats = ((frames_of(level, sensor), level.mean_dn - black_dn) for level in lit)
    step = 2 if sensor.video.interlaced else 1
    measured = [
        white_pattern(data, signal, step)
        for data, signal in flats
        if data is not None and len(data) >= PATTERN.least_frames
    ]
    if not measured:
        return []
    value, variance = (np.array(column) for column in zip(*measured, strict=True))
    mean, mean_variance = (
        float(np.sum(value / variance) / np.sum(1.0 / variance)),
        float(1.0 / np.sum(1.0 / variance)),
    )
    borders = PATTERN.border_residue * (float(sensor.taper.pattern_contrast) ** 2)
    sd = float(np.sqrt(mean_variance + (PATTERN.pattern_sd * mean) ** 2 + borders**2))

    def predict(values: Values) -> Array:
        return values[PRNU] ** 2 * filter_covariance(values, 1)[:, 0]

    high = sensor.parameters()[PRNU].high
    return (
        [scalar_observation("PRNU", mean, sd, predict, (PRNU,))]
        if high is not None and sd < high**2
        else []
    )


def white_pattern(data: NDArray[np.float32], signal_dn: float, step: int) -> tuple[float, float]:
    """Return the relative variance of the pattern that is white from row to row, and the square of
    its error.

    `data`: frames of a flat, shape (frame, row, col); `step`: fields of a frame.

    Notes
    -----
    The covariance of the mean frames of two halves is that of the fixed pattern. What the optics
    have blurred is even and smooth over rows, c(y) = c(0) (1 - a y^2): its part of the variance is
    (4 c(1) - c(2))/3, from the covariances one and two rows apart.
    """
    half = (len(data) - min(PATTERN.gap_frames, len(data) // 4)) // 2
    early, late = (_pattern(part, step) for part in (data[:half], data[-half:]))
    middle, rows = slice(2, early.shape[0] - 2), early.shape[0] - 4

    def covariance(row_offset: int) -> Array:
        return (
            early[middle]
            * (
                late[2 - row_offset : 2 - row_offset + rows]
                + late[2 + row_offset : 2 + row_offset + rows]
            )
            / 2.0
        )

    white = covariance(0) - (4.0 * covariance(1) - covariance(2)) / 3.0
    block_variance = block_sums(white) / block_sums(np.ones(white.shape)) / signal_dn**2
    return float(white.mean()) / signal_dn**2, float(
        block_variance.var(ddof=1) / block_variance.size
    )


def _pattern(frames: NDArray[np.float32], step: int) -> Array:
    """Return the mean frame without the mean of each field."""
    mean = frames.mean(axis=0, dtype=np.float64)
    for parity in range(step):
        mean[parity::step] -= mean[parity::step].mean()
    return mean
