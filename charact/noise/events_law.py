"""The law of a filtered dark pixel: pulses of random height at random places, in closed form at any density.

Photoelectrons that the plate detects fall evenly, each gives a pulse of random height, and everything after the gain
spreads it. A pixel of the filtered frame is then a compound Poisson number, whose characteristic function is exact:
overlapping pulses and pulses lost in the noise are in it, and no threshold has to be chosen or corrected for.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.noise.events_filters import Filter

Array = NDArray[np.float64]

# Places of a pulse: steps within a pixel, and the side of the square of pixels around the filter.
STEPS, SIDE_PX = 4, 48
# Frequency at which the strength of the wings is stated, cycles per pixel.
REFERENCE_CY_PER_PX = 0.1
# Amplitudes by which a filter's response to all places is represented.
NODES = 64
# Ages of pulses, the same way.
AGES = 28
# Times within an exposure at which a pulse may begin, shares of it with equal weight.
MOMENTS = (1.0 / 6.0, 0.5, 5.0 / 6.0)
# The glow of a pulse is followed until less than this share is left, at most so many exposures.
LEAST_GLOW, MOST_EXPOSURES = 3e-3, 20


@dataclass(frozen=True, kw_only=True)
class Spot:
    """How a pulse spreads after the gain. Names as in `Pulses`."""

    column_px: float
    row_px: float
    wings: float
    exponent: float
    row_pitch: float

    def transfer(self) -> Array:
        """Return the transfer from a pulse to the light on a pixel, at the frequencies of the places."""
        fy, fx = _frequencies()
        gauss = (self.column_px * fx) ** 2 + (self.row_px * fy) ** 2
        wings = self.wings * (np.hypot(fx, fy / self.row_pitch) / REFERENCE_CY_PER_PX) ** self.exponent
        return np.exp(-2.0 * np.pi**2 * gauss - wings) * np.sinc(fx) * np.sinc(fy)

    def area_px(self) -> float:
        """Return the area of a spot, 1 over the integral of its square, px."""
        power = self.transfer() ** 2
        return float(SIDE_PX**2 / (2.0 * power.sum() - power[:, 0].sum() - power[:, -1].sum()))


@dataclass(frozen=True, kw_only=True)
class Pulses:
    """Pulses of a dark or dim frame.

    Parameters
    ----------
    density
        Detected events per pixel and exposure.
    height_dn
        Mean pulse height, all light of a pulse together, DN.
    relative_variance
        Of the pulse heights: those of a Polya (gamma) law of shape 1 over it; 1 is exponential.
    noise_dn2
        Variance of the noise that pulses have no part in, DN^2.
    line_1, line_2
        Shares of a pixel's signal that the video hands on to the next pixel of the row and to the one after it; noise
        and light pass the same low pass.
    column_px, row_px
        Standard deviation of the Gaussian part of the spot along a row and along a column, px.
    wings
        Strength of the other part, exp(-wings (f/f0)^exponent) with f0 of 0.1 cycles per column pitch.
    exponent
        Its exponent.
    glow
        Share of the light that the screen gives off slowly.
    glow_exposures
        Time in which that falls to 1/e, exposures.
    row_pitch
        From row to row of an exposure, in column pitches.
    """

    density: float
    height_dn: float
    relative_variance: float
    noise_dn2: float
    line_1: float
    line_2: float
    column_px: float
    row_px: float
    wings: float
    exponent: float
    glow: float = 0.0
    glow_exposures: float = 1.0
    row_pitch: float = 1.0

    def log_characteristic(self, filters: tuple[Filter, ...], frequency: Array) -> NDArray[np.complex128]:
        """Return ln E exp(i t y) of filtered pixels y.

        Parameters
        ----------
        filters
            Filters, each through space and time.
        frequency
            t for every filter, shape (filter, t), 1/DN.

        Notes
        -----
        rate * integral over places of [E exp(i t h a(x)) - 1] - t^2 var / 2, with a(x) the filter's response to a
        pulse of unit light at x and E exp(i s h) = (1 - i s G v)^(-1/v) of a gamma law of mean G and relative
        variance v (Campbell's theorem). A mean over time that was taken away is part of the response.
        """
        spot, line = self.spot, self.line
        out = np.empty(frequency.shape, np.complex128)
        for index, one in enumerate(filters):
            amplitude, area = responses(one, spot, line)
            share, weight = self.shares(one)
            z = np.multiply.outer(frequency[index] * self.height_dn, np.multiply.outer(share, amplitude))
            pulse = height_transform(z, self.relative_variance)
            white = one.noise(line) * self.noise_dn2
            out[index] = self.density * np.einsum("tsa,s,a->t", pulse, weight, area)
            out[index] -= 0.5 * frequency[index] ** 2 * white
        return out

    def light_shares(self) -> Array:
        """Return the shares of a pulse's light in its own and the following exposures, shape (moment, exposure)."""
        if self.glow <= 0:
            return np.ones((1, 1))
        count = int(np.clip(np.ceil(self.glow_exposures * np.log(self.glow / LEAST_GLOW)), 1, MOST_EXPOSURES)) + 1
        start = np.array(MOMENTS)[:, None]
        left = self.glow * np.exp(-(np.arange(count) + 1.0 - start) / self.glow_exposures)
        before = np.concatenate([np.ones_like(start), left[:, :-1]], axis=1)
        return before - left

    def shares(self, one: Filter, moment: int | None = None) -> tuple[Array, Array]:
        """Return what a filter through time makes of pulses of every age: amplitudes and how many there are.

        A pulse begins in any exposure, at any moment of it or at the one given; the mean over the run, which holds its
        light too, is taken away.
        """
        light = self.light_shares()
        light = light if moment is None else light[moment : moment + 1]
        moments, count = light.shape
        width = (len(one.times) - 1) * one.stride
        seen = np.zeros((moments, count + width))
        for place, weight in enumerate(reversed(one.times)):
            seen[:, place * one.stride : place * one.stride + count] += weight * light
        taken = np.zeros((moments, one.stride))
        for phase in range(one.stride):
            taken[:, phase] = light[:, phase :: one.stride].sum(axis=1) * sum(one.times) / one.exposures
        age = np.arange(seen.shape[1])
        weight = np.full(seen.shape, 1.0 / moments)
        rest = np.maximum(one.exposures - np.bincount(age % one.stride, minlength=one.stride), 0.0)
        amplitude = np.concatenate([(seen - taken[:, age % one.stride]).ravel(), -taken.ravel()])
        number = np.concatenate([weight.ravel(), np.tile(rest / moments, moments)])
        if len(amplitude) <= AGES:
            return np.asarray(amplitude, np.float64), np.asarray(number, np.float64)
        return shared_out(amplitude, number, AGES)

    @property
    def line(self) -> tuple[float, float, float]:
        """Response of the video along a line to one pixel."""
        return 1.0 - self.line_1 - self.line_2, self.line_1, self.line_2

    @property
    def spot(self) -> "Spot":
        """How a pulse spreads."""
        return Spot(column_px=self.column_px, row_px=self.row_px, wings=self.wings, exponent=self.exponent,
                    row_pitch=self.row_pitch)  # fmt: skip


def height_transform(z: Array, relative_variance: float) -> NDArray[np.complex128]:
    """Return E exp(i z h) - 1 of gamma heights h of mean 1."""
    shape = 1.0 / relative_variance
    size = np.exp(-0.5 * shape * np.log1p((z * relative_variance) ** 2))
    phase = shape * np.arctan(z * relative_variance)
    return size * np.cos(phase) - 1.0 + 1j * size * np.sin(phase)


@lru_cache(maxsize=1)
def _frequencies() -> tuple[Array, Array]:
    side = STEPS * SIDE_PX
    fy, fx = np.fft.fftfreq(side)[:, None] * STEPS, np.fft.rfftfreq(side)[None, :] * STEPS
    return np.asarray(fy, np.float64), np.asarray(fx, np.float64)


def _comb(kernel: NDArray[np.float64], frequency: Array) -> NDArray[np.complex128]:
    """Transfer of weights on the pixels' lattice, counted from the middle."""
    place = np.arange(len(kernel)) - len(kernel) // 2
    return np.asarray(np.exp(-2j * np.pi * np.multiply.outer(frequency.ravel(), place)) @ kernel, np.complex128)


def responses(one: Filter, spot: Spot, line: tuple[float, ...] = (1.0,)) -> tuple[Array, Array]:
    """Return the filter's response to unit pulses at all places: amplitudes, and the area in px of each.

    The thousands of places are shared out to a few amplitudes so that area, mean response and mean square stay.
    """
    return _responses(one.rows, one.columns, spot, line)


@lru_cache(maxsize=256)
def _responses(rows: tuple[float, ...], columns: tuple[float, ...], spot: Spot, line: tuple[float, ...]
               ) -> tuple[Array, Array]:  # fmt: skip
    side = STEPS * SIDE_PX
    fy, fx = _frequencies()
    down, across = _comb(np.array(rows), fy).real, _comb(np.convolve(columns, line), fx)
    # Filters and spots are even along columns: one half stands for both, its borders for one.
    half = side // 2 + 1
    whole = np.fft.irfft2(spot.transfer() * down[:, None] * across, s=(side, side))[:half]
    once = np.full(half, 2.0)
    once[[0, -1]] = 1.0
    weight = np.broadcast_to(once[:, None], whole.shape) / STEPS**2
    return shared_out(whole.ravel() * STEPS**2, weight.ravel(), NODES)


def shared_out(value: Array, weight: Array, count: int) -> tuple[Array, Array]:
    """Return few values with weights in place of many, so that moments up to the second stay.

    Each value goes to the three nearest nodes by the weights of quadratic interpolation, some of which are negative.
    """
    low, high = float(value.min()), float(value.max())
    scale = max(high, -low) / 50.0
    place = np.linspace(np.arcsinh(low / scale), np.arcsinh(high / scale), count)
    nodes = np.asarray(scale * np.sinh(place), np.float64)
    middle = np.rint((np.arcsinh(value / scale) - place[0]) / (place[1] - place[0])).astype(np.int64)
    middle = np.clip(middle, 1, count - 2)
    out = np.zeros(count)
    for here, one, other in ((-1, 0, 1), (0, -1, 1), (1, -1, 0)):
        a, b, c = (nodes[middle + shift] for shift in (here, one, other))
        out += np.bincount(middle + here, (value - b) * (value - c) / ((a - b) * (a - c)) * weight, count)
    return nodes, out


@dataclass(frozen=True, kw_only=True)
class Observed:
    """What frames show.

    Parameters
    ----------
    filters
        Filters.
    frequency
        Frequencies of each, shape (filter, t), 1/DN.
    value
        Logarithms of the characteristic functions, real parts, then imaginary ones, shape (2 filter t,).
    covariance
        Theirs, from the scatter of blocks, shape (2 filter t, 2 filter t).
    pixels
        Pixels it comes from, over all exposures.
    """

    filters: tuple[Filter, ...]
    frequency: Array
    value: Array
    covariance: Array
    pixels: float

    def predicted(self, pulses: Pulses) -> Array:
        """Return what pulses predict, shape (2 filter t,)."""
        return both(pulses.log_characteristic(self.filters, self.frequency))


def both(values: NDArray[np.complex128]) -> Array:
    """Return real parts, then imaginary ones, as one vector."""
    return np.concatenate([values.real.ravel(), values.imag.ravel()])
