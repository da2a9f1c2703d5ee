"""Flats of exactly known MTF after the gain: pulses in continuous space through a closed form, from
no simulator.

Pulses fall on a grid several times finer than the pixels; their spectrum is multiplied with the
transfer and folded as sampling folds it, so that replicas of the spectrum are there as a real pixel
makes them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from labdata import Array, FrameStack, Kind, Session, StackEntry
from tests.truth.sessions import session_in_memory, tube_stack

# Places of pulses in a pixel, along each axis.
FINER = 4


@dataclass(frozen=True, kw_only=True)
class ScintillatingFlats:
    """Flats of an intensified camera, with one knob for each way in which a noise spectrum
    breaks.
    """

    # half_frequency_cy_per_px, exponent: f2 and n of the transfer after the gain exp(-ln 2
    # (f/f2)^n), times the square pixel's; n = 2 is a Gaussian
    half_frequency_cy_per_px: float = 0.25
    exponent: float = 1.5
    anisotropy: float = 1.0  # f2 along columns over f2 along rows
    # halo_fraction, halo_px: share of the light after the gain in a Gaussian veil of this standard
    # deviation, px
    halo_fraction: float = 0.0
    halo_px: float = 6.0
    # mean photoelectrons per pixel and exposure of each flat, all detected, pulse heights
    # exponential
    photoelectrons: tuple[float, ...] = (2.0, 8.0)
    gain_dn: float = 20.0  # k, DN per photoelectron; 0: no intensifier, electrons alone
    # electron_gain_dn, read_noise_dn: K, DN per electron, white; and read noise, DN
    electron_gain_dn: float = 0.05
    read_noise_dn: float = 3.0
    # standard deviation of a Gaussian along rows over the read noise, px: electronics that are not
    # white
    read_smoothing_px: float = 0.0
    # rows, cols, frames: size of each stack
    rows: int = 128
    cols: int = 128
    frames: int = 12
    lag: float = 0.0  # share of an exposure's light that returns in the next
    gamma: float = 1.0  # exponent of the response over full scale
    # full_scale_dn, black_dn: highest code and offset, DN
    full_scale_dn: float = 4095.0
    black_dn: float = 60.0
    interlaced: bool = False  # whether odd and even rows are exposed one after the other
    darks: bool = True  # whether there is a dark stack
    # share of the light that the corners lose, growing with the square of the distance from the
    # middle
    vignetting: float = 0.0
    flicker: float = 0.0  # relative standard deviation of the light from exposure to exposure
    # standard deviation of an offset that each row of each frame has for itself, DN
    row_noise_dn: float = 0.0
    # ion_share, ion_photoelectrons: share of the pulses that an ion makes, and how many
    # photoelectrons' light such a one has
    ion_share: float = 0.0
    ion_photoelectrons: float = 20.0

    def core(self, column: Array, row: Array) -> Array:
        """Transfer without the pixel at frequencies in cycles per pixel."""
        radius = np.hypot(column, row / self.anisotropy)
        core = np.exp(-np.log(2.0) * (radius / self.half_frequency_cy_per_px) ** self.exponent)
        veil = np.exp(-2.0 * (np.pi * radius * self.halo_px) ** 2)
        return (1.0 - self.halo_fraction) * core + self.halo_fraction * veil

    def mtf(self, frequency: Array, *, vertical: bool = False) -> Array:
        """Transfer after the gain along rows or columns, pixel included."""
        none = np.zeros_like(frequency)
        core = self.core(none, frequency) if vertical else self.core(frequency, none)
        return core * np.abs(np.sinc(frequency))

    def mtf50(self, *, vertical: bool = False) -> float:
        """Frequency at which it is one half, cycles per pixel."""
        frequency = np.linspace(1e-6, 1.0, 200001)
        return float(frequency[np.argmax(self.mtf(frequency, vertical=vertical) < 0.5)])

    @cached_property
    def _transfer(self) -> Array:
        row = np.fft.fftfreq(self.rows * FINER)[:, None] * FINER
        column = np.fft.rfftfreq(self.cols * FINER)[None, :] * FINER
        return self.core(column, row) * np.sinc(column) * np.sinc(row)

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw the dark stack, if any, and one flat stack for each level."""
        levels = (*((0.0,) if self.darks else ()), *self.photoelectrons)
        stacks = tuple(self._entry(number, level, rng) for number, level in enumerate(levels))
        depth = int(np.log2(self.full_scale_dn + 1))
        return session_in_memory(
            stacks, name="scintillating flats", interlaced=self.interlaced, bit_depth=depth
        )

    def _entry(self, number: int, level: float, rng: np.random.Generator) -> StackEntry:
        kind: Kind = "flat" if level else "dark"
        signal = np.stack(self._frames(level, rng)) + self._read_noise(rng)
        top = self.full_scale_dn - self.black_dn
        curved = np.sign(signal) * top * (np.abs(signal) / top) ** self.gamma
        codes = np.clip(np.rint(self.black_dn + curved), 0, self.full_scale_dn).astype(np.uint16)
        frames = FrameStack(
            data=codes, time_s=np.arange(self.frames) / 30, full_scale_dn=self.full_scale_dn
        )
        return tube_stack(kind, f"{kind}-{number}", frames, 1e-6 * level)

    def _frames(self, level: float, rng: np.random.Generator) -> Sequence[Array]:
        """Light signal of each frame, DN; of interlaced ones each field has an exposure of its
        own.
        """
        if level == 0.0:
            return [np.zeros((self.rows, self.cols))] * self.frames
        count = self.frames * (2 if self.interlaced else 1)
        shots = [self._exposure(level, rng) for _ in range(count + 1)]
        lagged = [(1 - self.lag) * new + self.lag * old for old, new in pairwise(shots)]
        if self.electron_gain_dn > 0:
            electrons = [
                rng.poisson(np.maximum(light, 0) / self.electron_gain_dn) for light in lagged
            ]
            lagged = [self.electron_gain_dn * exposure for exposure in electrons]
        if not self.interlaced:
            return lagged
        frames = []
        for first, second in zip(lagged[::2], lagged[1::2], strict=True):
            frame = first.copy()
            frame[1::2] = second[1::2]
            frames.append(frame)
        return frames

    def _exposure(self, level: float, rng: np.random.Generator) -> Array:
        """One exposure's light before the electrons: pulses, transfer, and sampling as a fold of
        the spectrum.
        """
        if self.gain_dn == 0.0:
            return np.full((self.rows, self.cols), 20.0 * level)
        from scipy import fft

        heights = self._pulses(level * (1.0 + self.flicker * float(rng.standard_normal())), rng)

        spread: Any = fft.rfft2(heights, workers=1)
        fine = fft.irfft2(spread * self._transfer, heights.shape, workers=1)
        return self.gain_dn * FINER**2 * np.asarray(fine)[::FINER, ::FINER]

    def _pulses(self, level: float, rng: np.random.Generator) -> Array:
        """Heights of the pulses of one exposure on the fine grid, in means of a photoelectron's."""
        light = self._even * max(level, 0.0) / FINER**2
        counts = rng.poisson(light, (self.rows * FINER, self.cols * FINER))
        heights = np.zeros(counts.shape)
        heights[counts > 0] = rng.standard_gamma(counts[counts > 0])
        if self.ion_share:
            heights += self.ion_photoelectrons * rng.poisson(light * self.ion_share, counts.shape)
        return heights

    @cached_property
    def _even(self) -> Array | float:
        """Light at each place of the fine grid over that in the middle."""
        if not self.vignetting:
            return 1.0
        row, col = (np.linspace(-1.0, 1.0, n * FINER) for n in (self.rows, self.cols))
        return 1.0 - self.vignetting * 0.5 * (row[:, None] ** 2 + col[None, :] ** 2)

    def _read_noise(self, rng: np.random.Generator) -> Array:
        white = rng.standard_normal((self.frames, self.rows, self.cols))
        if self.read_smoothing_px > 0:
            from scipy.ndimage import gaussian_filter1d

            white = gaussian_filter1d(white, self.read_smoothing_px, axis=2, mode="wrap")
            white = white / white.std()
        noise = self.read_noise_dn * white
        if self.row_noise_dn:
            noise += self.row_noise_dn * rng.standard_normal((self.frames, self.rows, 1))
        return noise
