"""A mean frame as seen from a source: its signal, its rings and sectors, and the noise of its pixels."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.bloom.pixel_noise import SMOOTHING_PX, PixelNoise, noise_of
from charact.bloom.polar import Polar, Rings, polar_of, rings_of

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SourceView:
    """A mean frame as seen from a source.

    Parameters
    ----------
    signal
        Mean frame over dark, shape (row, col), DN.
    smooth
        The same smoothed by one pixel.
    dark_dn
        Level without light, DN.
    top
        Highest code over dark, DN.
    polar, rings, noise
        Places of the pixels, sums over cells, and noise of a pixel.
    """

    signal: Array
    smooth: Array
    dark_dn: float
    top: float
    polar: Polar
    rings: Rings
    noise: PixelNoise

    @cached_property
    def profile(self) -> tuple[Array, Array]:
        """Radius and mean signal of the rings, what pulls few sectors left out."""
        return self.rings.radius, self.rings.median()


def view_of(
    frames: NDArray, dark_dn: float, full_scale_dn: float, row: float, col: float, row_pitch: float
) -> SourceView:
    """Prepare frames for extents around (row, col).

    Parameters
    ----------
    frames
        Shape (frame, row, col), DN.
    dark_dn, full_scale_dn
        Level without light and highest code, DN.
    row, col
        Centre of the source, px.
    row_pitch
        Row pitch over column pitch.
    """
    from scipy import ndimage

    signal = frames.mean(axis=0, dtype=np.float64) - dark_dn
    polar = polar_of((signal.shape[0], signal.shape[1]), row, col, row_pitch)
    rings, top = rings_of(signal, polar), full_scale_dn - dark_dn
    smooth = np.asarray(ndimage.gaussian_filter(signal, SMOOTHING_PX))
    return SourceView(
        signal=signal,
        smooth=smooth,
        dark_dn=dark_dn,
        top=top,
        polar=polar,
        rings=rings,
        noise=noise_of(frames, signal, smooth, top, polar, rings),
    )
