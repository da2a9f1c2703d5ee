"""Noise of a stack's mean frame, from pixels and patches far from the source: how it grows with light and with area."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Pixels along a side of the patches whose means scatter as light does, blur after the gain or not.
PATCH_PX = 6
# Share of the columns nearest to the source that are left out: its halo and its column lie there.
NEAR_SHARE = 0.6
# Light over dark below which noise tells nothing of light, DN.
LEAST_LIGHT_DN = 0.5
ROUNDING_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True, kw_only=True)
class MeanFrameNoise:
    """Noise of a mean frame.

    Parameters
    ----------
    floor_variance
        Variance of a pixel of the background, DN^2.
    per_light
        Variance of a pixel over its light, DN; 0 where the background holds too little light to tell.
    neighbours
        Variance of the sum of many neighbouring pixels over that of as many independent ones, dimensionless.
    background_dn
        Level of the background over dark, DN.
    """

    floor_variance: float
    per_light: float
    neighbours: float
    background_dn: float

    def pixel_variance(self, light_dn: float) -> float:
        """Variance of a pixel under light over dark, DN^2."""
        return self.floor_variance + self.per_light * max(light_dn - self.background_dn, 0.0)

    def sum_variance(self, light_dn: float) -> float:
        """Variance of the sum of all light of a spot over dark, DN^2."""
        return self.neighbours * self.per_light * max(light_dn, 0.0)


def grain_of(image: Array, col: float, dark_dn: float) -> MeanFrameNoise:
    """Measure the noise of a mean frame far from a source.

    Parameters
    ----------
    image
        Mean frame, shape (row, col), DN.
    col
        Column of the source, px.
    dark_dn
        Level without light, DN.

    Notes
    -----
    The scatter of patches is that of frames and of fixed pattern alike: both make one frame differ from its truth.
    """
    rows, cols = (n // PATCH_PX * PATCH_PX for n in image.shape)
    tiles = image[:rows, :cols].reshape(rows // PATCH_PX, PATCH_PX, cols // PATCH_PX, PATCH_PX)
    patches = tiles.mean(axis=(1, 3))
    along = np.abs(PATCH_PX * (np.arange(patches.shape[1]) + 0.5) - col)
    far = np.flatnonzero(along >= np.quantile(along, NEAR_SHARE))
    # Differences of neighbours leave gradients out, medians other sources.
    pairs = far[:-1][np.diff(far) == 1]
    patch = 0.5 * _robust(patches[:, pairs + 1] - patches[:, pairs]) ** 2
    single = float(np.median(tiles.var(axis=(1, 3), ddof=1)[:, far])) + patch
    floor = max(single, 0.1 * ROUNDING_VARIANCE)
    background = float(np.median(patches[:, far])) - dark_dn
    told = background > LEAST_LIGHT_DN
    return MeanFrameNoise(
        floor_variance=floor,
        per_light=floor / background if told else 0.0,
        neighbours=float(np.clip(PATCH_PX**2 * patch / floor, 1.0, 12.0)),
        background_dn=max(background, 0.0),
    )


def _robust(values: Array) -> float:
    """Standard deviation from the median of absolute values."""
    return 1.4826 * float(np.median(np.abs(values))) if values.size else 0.0
