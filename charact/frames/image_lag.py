"""Image lag: correlation of pulses of light between fields and frames by phosphor decay.

    I(t) = a exp(-t/t1) + (1 - a) exp(-t/t2)

A decay law is a sum of exponentials, `decay_components`: image lag, fit and validation follow from
it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.frames.thresholds import LAG
from labdata.camera.description import Camera, has_tube

Array = NDArray[np.float64]
# Parameters of the decay law, those of them that are at most 1, and those of which one sets the
# slowest component.
DECAY = ("phosphor.fast_fraction", "phosphor.fast_decay_ms", "phosphor.slow_decay_ms")
DECAY_FRACTIONS = DECAY[:1]
SLOWEST_DECAY = DECAY[2:]


def decay_components(values: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return weights at the start of the decay, dimensionless, and decay times, ms, of
    exponentials, shape (component, n), from parameters of shape (n,) by path.
    """
    fast, *times_ms = (values[path] for path in DECAY)
    fast = np.minimum(fast, 1.0)
    weights = np.stack(np.broadcast_arrays(fast, 1.0 - fast))
    return weights, np.stack(np.broadcast_arrays(*times_ms))


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
    known = camera.parameters()
    exposures = 1.0 / float(known["video.field_rate_hz"]) * 1e3
    weights, times_ms = decay_components(
        {path: np.array([float(known[path])]) for path in DECAY if path in known}
    )
    tau = np.maximum(times_ms[:, 0], 1e-6)
    light = weights[:, 0] * tau
    arrival = (np.arange(LAG.arrival_times) + 0.5) / LAG.arrival_times * exposures
    ends = np.arange(1, LAG.lag_fields + 1) * exposures
    remaining = np.exp(-(ends[None, :, None] - arrival[:, None, None]) / tau) @ (
        light / light.sum()
    )
    return -np.diff(remaining, axis=1, prepend=1.0)
