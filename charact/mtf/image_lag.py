"""How pulses of light are remembered: a decaying screen shows one in several fields and frames, and so ties them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context

Array = NDArray[np.float64]

# Fields over which a pulse is followed, and moments of its arrival within one.
FIELDS, MOMENTS = 64, 200


@dataclass(frozen=True, kw_only=True)
class ImageLagModel:
    """How pulses are shared out over fields and frames, relative to the light of one frame.

    Parameters
    ----------
    mean_same, mean_other
        Covariance of the mean of all frames times their number, within a field's rows and between both fields' rows.
    frame_same, frame_other
        Expected covariance between frames (ddof 1), likewise.
    """

    mean_same: float
    mean_other: float
    frame_same: float
    frame_other: float

    def between_rows(self, parity: NDArray[np.bool_]) -> Array:
        """Covariance between frames of pixels in rows of fields, shape (pixel,) -> (pixel, pixel)."""
        return np.where(parity[:, None] == parity, self.frame_same, self.frame_other)

    @property
    def widening(self) -> float:
        """Variance of the mean of pixels, over that of as many fresh frames with the scatter seen."""
        return self.mean_same / self.frame_same

    @property
    def widening_of_sums(self) -> float:
        """The same of sums over the rows of both fields, of which one follows the other by half a frame."""
        return (self.mean_same + self.mean_other) / (self.frame_same + self.frame_other)


def image_lag_model(context: Context, frames: int) -> ImageLagModel:
    """Return how long pulses are remembered: by the described screen, else not at all."""
    shares = _light_fractions(context)
    if not context.interlaced:
        # All rows are of one exposure: neighbours share their pulses whatever their parity.
        same = float(np.mean(np.sum(shares**2, axis=1)))
        return _memory(1.0, 1.0, same, same, frames)
    even, odd = shares[:, ::2].sum(axis=1), shares[:, 1::2].sum(axis=1)
    same, other = float(np.mean(even**2 + odd**2)), float(np.mean(2 * even * odd))
    frame = float(np.mean(np.sum(shares**2, axis=1)))
    between = float(np.mean(np.sum(shares[:, 1:] * shares[:, :-1], axis=1)))
    return _memory(same, other, frame, between, frames)


def _memory(mean_same: float, mean_other: float, same: float, other: float, frames: int) -> ImageLagModel:
    count = max(frames, 2)
    return ImageLagModel(
        mean_same=mean_same,
        mean_other=mean_other,
        frame_same=(count * same - mean_same) / (count - 1),
        frame_other=(count * other - mean_other) / (count - 1),
    )


def _light_fractions(context: Context) -> Array:
    """Share of a pulse's light in each field from its own on, shape (pulse, field), for an open gate."""
    if context.sensor is None:
        return np.ones((1, 1))
    phosphor = context.sensor.phosphor
    exposures = 1.0 / float(context.sensor.video.field_rate_hz) * 1e3
    tau = np.maximum([float(phosphor.fast_decay_ms), float(phosphor.slow_decay_ms)], 1e-6)
    fast = float(phosphor.fast_fraction)
    light = np.array([fast, 1.0 - fast]) * tau
    arrival = (np.arange(MOMENTS) + 0.5) / MOMENTS * exposures
    ends = np.arange(1, FIELDS + 1) * exposures
    left = np.exp(-(ends[None, :, None] - arrival[:, None, None]) / tau) @ (light / light.sum())
    return -np.diff(left, axis=1, prepend=1.0)
