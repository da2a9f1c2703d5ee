"""Bar targets as an intensified camera shows them, photoelectron by photoelectron."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tests.charact.estimators.mtf.photoelectron_targets import FINER, PhotoelectronTarget
from tests.truth.bars import spectrum_of_bars
from tests.truth.blur import TrueBlur

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class PulsedBars(PhotoelectronTarget):
    """Bright bars before an intensified camera; the ground around them is the dark side.

    Parameters
    ----------
    bars, frequency_cy_per_px
        Number of bars, and their frequency across them.
    row_px, col_px
        Where the target's middle stands off the middle of the frame, px.
    """

    bars: int = 4
    frequency_cy_per_px: float = 0.12
    row_px: float = 0.0
    col_px: float = 0.0

    @property
    def truth_mtf(self) -> float:
        """MTF at the bars' frequency across them, pixel included, dimensionless."""
        return float(self.mtf(self.frequency_cy_per_px))

    def _illumination(self, row: Array, col: Array, moved_px: float) -> Array:
        shape, first = (row.size, col.size), (float(row[0, 0]), float(col[0, 0]))
        place = self.row_px - first[0], self.col_px + moved_px - first[1]
        return _blurred(
            self.blur, self.bars, self.frequency_cy_per_px, self.angle_deg, shape, place
        )


@lru_cache(maxsize=4)
def _blurred(
    blur: TrueBlur,
    bars: int,
    frequency: float,
    angle_deg: float,
    shape: tuple[int, int],
    place: tuple[float, float],
) -> Array:
    """Bars through the blur alone, 1 on a wide bar, on the fine grid; their middle at a place from
    its corner, px.

    What lies beyond the grid's own Nyquist frequency, 2 cycles per pixel, is left out: there a blur
    has nothing left.
    """
    from scipy.fft import irfft2

    fy, fx = np.fft.fftfreq(shape[0])[:, None] * FINER, np.fft.rfftfreq(shape[1])[None, :] * FINER
    shift = np.exp(-2j * np.pi * (fy * place[0] + fx * place[1]))
    spectrum = (
        spectrum_of_bars(bars, frequency, angle_deg, fx, fy)
        * blur.before_pixel(np.hypot(fx, fy))
        * shift
    )
    return np.asarray(irfft2(spectrum, shape)) * FINER**2
