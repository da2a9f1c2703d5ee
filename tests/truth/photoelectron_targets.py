"""Targets as an intensified camera shows them: photoelectrons where the light falls, each a pulse
of light.

Pulses fall on a grid several times finer than the pixels, at random as the light before the gain
has it; a Gaussian and the square pixel make pixels of them. Nothing is shared with the methods
measured.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from tests.truth.bars import spectrum_of_bars
from tests.truth.blur import Array, TrueBlur
from tests.truth.camera_effects import PulsedTarget, correlate_noise
from tests.truth.edge import distance_across, edge_spread

# Places of pulses in a pixel, along each axis, and pixels around the frame whose pulses reach into
# it.
FINER, MARGIN_PX = 4, 8
# Blur of a fixed pattern of gains, px: that of a screen's grain rather than of single pixels.
PATTERN_PX = 0.7


@dataclass(frozen=True, kw_only=True)
class PhotoelectronTarget(PulsedTarget, ABC):
    """A target before an intensified camera, with one knob for each way in which methods break
    whatever the target.

    Parameters
    ----------
    photoelectrons
        Mean number on a pixel of the bright side in a frame.
    bright_dn
        Level of the bright side over black, DN.
    dark_share
        Light of the dark side over that of the bright one.
    vignetting
        Share of the light that the corners lose, growing with the square of the distance from the
        middle.
    interlaced
        Whether odd rows are exposed in a later field, as they are where `motion_px` displaces them.
    flicker
        Relative standard deviation of the light from exposure to exposure.
    lag
        Share of an exposure's light that returns in the next.
    ion_share, ion_photoelectrons
        Share of the pulses that an ion makes, and how many photoelectrons' light such a one has.
    pattern
        Relative standard deviation of a gain that each place keeps in all frames.
    """

    bright_dn: float = 120.0
    dark_share: float = 0.2
    frames: int = 16
    vignetting: float = 0.0
    interlaced: bool = False
    flicker: float = 0.0
    lag: float = 0.0
    ion_share: float = 0.0
    ion_photoelectrons: float = 20.0
    pattern: float = 0.0

    @property
    def gain_dn(self) -> float:
        """Light of a photoelectron's pulse, DN px^2."""
        return self.bright_dn / self.photoelectrons

    @property
    def snr(self) -> float:
        """Step over the standard deviation of the mean frame half way up, dimensionless."""
        # Squares of a pixel's shares of a pulse, over all places of it: the integral of the pulse's
        # squared transfer.
        f = (np.arange(400) - 199.5) / 100
        line = np.sum((np.exp(-2 * (np.pi * f * self.pulse_px) ** 2) * np.sinc(f)) ** 2) / 100
        light = self.bright_dn * (1.0 + self.dark_share) / 2.0
        variance = (1.0 + self.gain_spread) * self.gain_dn * light * line**2 + self.read_dn**2
        return self.bright_dn * (1.0 - self.dark_share) / float(np.sqrt(variance / self.frames))

    def _light(self, rng: np.random.Generator) -> Array:
        light = np.stack(self._frames_light(rng))
        if self.pattern:
            gains = correlate_noise(rng.standard_normal((1, *light.shape[1:])), PATTERN_PX)
            light = light * (1.0 + self.pattern * gains)
        return light

    def _frames_light(self, rng: np.random.Generator) -> Sequence[Array]:
        """Light of each frame over black, DN; of interlaced ones each field has an exposure of its
        own.
        """
        fields = 2 if self.interlaced or self.motion_px else 1
        displaced = self.drift_px * np.linspace(
            -0.5, 0.5, self.frames
        ) + self.jitter_px * rng.standard_normal(self.frames)
        positions = [
            frame + number * self.motion_px
            for frame in [displaced[0], *displaced]
            for number in range(fields)
        ]
        # A target at rest has one mean for all exposures.
        means = {position: self._mean(position) for position in set(positions)}
        shots = [self._exposure(means[position], rng) for position in positions[fields - 1 :]]
        lagged = [(1 - self.lag) * new + self.lag * old for old, new in pairwise(shots)]
        if fields == 1:
            return lagged
        odd = (np.arange(self.rows) % 2 == 1)[:, None]
        return [
            np.where(odd, later, first)
            for first, later in zip(lagged[::2], lagged[1::2], strict=True)
        ]

    def _exposure(self, mean: Array, rng: np.random.Generator) -> Array:
        """One exposure's light: pulses on the fine grid, their blur and the pixel, sampled once a
        pixel.
        """
        from scipy import fft

        flicker = (
            max(1.0 + self.flicker * float(rng.standard_normal()), 0.0) if self.flicker else 1.0
        )
        heights = self._heights(flicker * mean, rng)
        spread: Any = fft.rfft2(heights, workers=1)
        # The transform of one row in so many is the mean of as many parts of the transform.
        sampled = (spread * self._pulse).reshape(FINER, -1, spread.shape[1]).mean(axis=0)
        fine = np.asarray(fft.irfft2(sampled, (len(sampled), heights.shape[1]), workers=1))
        return (
            self.gain_dn
            * FINER**2
            * fine[MARGIN_PX:-MARGIN_PX, FINER * MARGIN_PX : -FINER * MARGIN_PX : FINER]
        )

    def _heights(self, mean: Array, rng: np.random.Generator) -> Array:
        """Heights of the pulses at each place, in means of a photoelectron's: n gamma heights add
        up to a gamma one.
        """
        counts = rng.poisson(mean)
        heights = counts.astype(float)
        if self.gain_spread > 0:
            some = counts > 0
            heights[some] = rng.standard_gamma(counts[some] / self.gain_spread) * self.gain_spread
        if self.ion_share:
            heights += self.ion_photoelectrons * rng.poisson(mean * self.ion_share)
        return heights

    def _mean(self, moved_px: float) -> Array:
        """Mean photoelectrons of each place of the fine grid."""
        row, col = self._places()
        light = self.dark_share + (1.0 - self.dark_share) * self._illumination(row, col, moved_px)
        light = light * (1 + self.gradient * (col / self.cols + 0.5))
        squared = ((2 * row / self.rows) ** 2 + (2 * col / self.cols) ** 2) / 2
        return (
            np.maximum(light * (1.0 - self.vignetting * squared), 0.0)
            * self.photoelectrons
            / FINER**2
        )

    def _places(self) -> tuple[Array, Array]:
        """Places of the fine grid off the middle of the frame, shapes (row, 1) and (1, col), px."""
        row, col = (_fine_places(size) for size in (self.rows, self.cols))
        return row[:, None], col[None, :]

    @abstractmethod
    def _illumination(self, row: Array, col: Array, moved_px: float) -> Array:
        """Light before the gain from 0 to 1 at places off the middle of the frame, px, moved along
        the rows.
        """

    @cached_property
    def _pulse(self) -> Array:
        """Transfer of the pulse and the square pixel on the fine grid."""
        down, across = (FINER * (size + 2 * MARGIN_PX) for size in (self.rows, self.cols))
        row, col = np.fft.fftfreq(down)[:, None] * FINER, np.fft.rfftfreq(across)[None, :] * FINER
        gaussian = np.exp(-2 * (np.pi * np.hypot(row, col) * self.pulse_px) ** 2)
        return gaussian * np.sinc(row) * np.sinc(col)


def _fine_places(size: int) -> Array:
    """Places along one axis of the fine grid, margins included, px off the middle of the frame."""
    return np.arange(FINER * (size + 2 * MARGIN_PX)) / FINER - MARGIN_PX - (size - 1) / 2


@dataclass(frozen=True)
class _BeforePixel:
    """A blur without the pixel, usable where an edge's spread is asked for."""

    blur: TrueBlur

    def mtf(self, frequency_cy_per_px: Array, angle_deg: float) -> Array:
        """MTF at frequencies, the same in any direction."""
        return self.blur.before_pixel(frequency_cy_per_px)


@dataclass(frozen=True, kw_only=True)
class PulseEdge(PhotoelectronTarget):
    """A blurred step before an intensified camera.

    Parameters
    ----------
    offset_px
        Where the edge passes the middle of the frame, px along the normal.
    sagitta_px
        Bow of the edge over its length, px.
    """

    offset_px: float = 0.0
    sagitta_px: float = 0.0

    def _illumination(self, row: Array, col: Array, moved_px: float) -> Array:
        distance = distance_across(
            row,
            col,
            (self.rows, self.cols),
            angle_deg=self.angle_deg,
            moved_px=moved_px,
            sagitta_px=self.sagitta_px,
        )
        distance = distance - self.offset_px
        spread: Any = edge_spread(_BeforePixel(self.blur), distance, self.angle_deg)  # pyright: ignore[reportArgumentType]
        return spread


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
        centre = self.row_px - first[0], self.col_px + moved_px - first[1]
        return _blurred(
            self.blur, self.bars, self.frequency_cy_per_px, self.angle_deg, shape, centre
        )


@lru_cache(maxsize=4)
def _blurred(
    blur: TrueBlur,
    bars: int,
    frequency: float,
    angle_deg: float,
    shape: tuple[int, int],
    centre: tuple[float, float],
) -> Array:
    """Bars through the blur alone, 1 on a wide bar, on the fine grid; their middle at a place from
    its corner, px.

    What lies beyond the grid's own Nyquist frequency, 2 cycles per pixel, is left out: there a blur
    has nothing left.
    """
    from scipy.fft import irfft2

    fy, fx = np.fft.fftfreq(shape[0])[:, None] * FINER, np.fft.rfftfreq(shape[1])[None, :] * FINER
    shift = np.exp(-2j * np.pi * (fy * centre[0] + fx * centre[1]))
    spectrum = (
        spectrum_of_bars(bars, frequency, angle_deg, fx, fy)
        * blur.before_pixel(np.hypot(fx, fy))
        * shift
    )
    return np.asarray(irfft2(spectrum, shape)) * FINER**2
