"""Image lag: correlation of pulses of light between fields and frames by phosphor decay."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.frames.thresholds import LAG
from labdata.camera.description import Camera, has_tube

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ImageLagModel:
    """Covariance factors of light pulses, relative to a pulse that lies in one frame.

    Parameters
    ----------
    mean_same, mean_other
        Covariance of the mean of all frames times their number, for rows of the same and of
        different fields.
    frame_same, frame_other
        Expected covariance between frames (ddof 1), likewise.
    """

    mean_same: float
    mean_other: float
    frame_same: float
    frame_other: float

    def between_rows(self, parity: NDArray[np.bool_]) -> Array:
        """Return the factors of pairs of pixels from their fields, shape (pixel,) -> (pixel,
        pixel).
        """
        return np.where(parity[:, None] == parity, self.frame_same, self.frame_other)

    @property
    def widening(self) -> float:
        """Variance of the mean over that of independent frames of the same scatter."""
        return self.mean_same / self.frame_same

    @property
    def widening_of_sums(self) -> float:
        """The same for sums over the rows of both fields, which are exposed half a frame apart."""
        return (self.mean_same + self.mean_other) / (self.frame_same + self.frame_other)


def image_lag_model(camera: Camera | None, frames: int, *, interlaced: bool) -> ImageLagModel:
    """Return the image lag of the described phosphor; none without a description."""
    shares = _light_fractions(camera)
    if not interlaced:
        # All rows belong to one exposure, whatever their parity.
        same = float(np.mean(np.sum(shares**2, axis=1)))
        return _memory(1.0, 1.0, same, same, frames)
    even_field, odd = shares[:, ::2].sum(axis=1), shares[:, 1::2].sum(axis=1)
    same, other = float(np.mean(even_field**2 + odd**2)), float(np.mean(2 * even_field * odd))
    frame = float(np.mean(np.sum(shares**2, axis=1)))
    next_frame = float(np.mean(np.sum(shares[:, 1:] * shares[:, :-1], axis=1)))
    return _memory(same, other, frame, next_frame, frames)


def _memory(
    mean_same: float, mean_other: float, same: float, other: float, frames: int
) -> ImageLagModel:
    count = max(frames, 2)
    return ImageLagModel(
        mean_same=mean_same,
        mean_other=mean_other,
        frame_same=(count * same - mean_same) / (count - 1),
        frame_other=(count * other - mean_other) / (count - 1),
    )


def _light_fractions(camera: Camera | None) -> Array:
    """Return the fraction of a pulse's light in each field from its arrival on, shape (pulse,
    field).
    """
    if not has_tube(camera):
        return np.ones((1, 1))
    phosphor = camera.phosphor
    exposures = 1.0 / float(camera.video.field_rate_hz) * 1e3
    tau = np.maximum([float(phosphor.fast_decay_ms), float(phosphor.slow_decay_ms)], 1e-6)
    fast = float(phosphor.fast_fraction)
    light = np.array([fast, 1.0 - fast]) * tau
    arrival = (np.arange(LAG.arrival_times) + 0.5) / LAG.arrival_times * exposures
    ends = np.arange(1, LAG.lag_fields + 1) * exposures
    remaining = np.exp(-(ends[None, :, None] - arrival[:, None, None]) / tau) @ (
        light / light.sum()
    )
    return -np.diff(remaining, axis=1, prepend=1.0)
