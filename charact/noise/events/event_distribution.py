"""Distribution of a filtered dark pixel: compound Poisson process of pulses.

Detected photoelectrons are uniformly distributed; each gives a pulse of random height, spread over pixels and
exposures. The characteristic function is exact at any density and includes overlapping pulses and pulses below the
noise, so no threshold is needed.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.filters import Filter, PulseSpread, quantise_amplitudes, responses
from charact.noise.thresholds import EVENT_ACCURACY

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PulseDecay:
    """Phosphor decay of a pulse: two exponentials."""

    share: float = 0.0  # fraction of slow light, dimensionless
    # slow_exposures, fast_exposures: decay times of slow and fast light, exposures
    slow_exposures: float = 1.0
    fast_exposures: float = 0.0
    open_share: float = 1.0  # fraction of the exposure period, from its start, in which pulses begin

    @property
    def lasts(self) -> bool:
        """Whether any light falls into later exposures."""
        return self.share > 0.0 or self.fast_exposures > 0.0

    @lru_cache(maxsize=256)  # noqa: B019
    def by_exposure(self) -> tuple[Array, Array]:
        """Return the fractions of light in a pulse's own and later exposures, and quadrature weights.

        Returns `light`: shape (moment, exposure); `weight`: fraction of the pulses that begin then, shape (moment,).
        """
        if not self.lasts:
            return np.ones((1, 1)), np.ones(1)
        start, weight = _moments()
        start = self.open_share * start
        share = np.array([self.share, 1.0 - self.share])
        time = np.maximum([self.slow_exposures, self.fast_exposures], 1e-9)
        last = float(np.max(time * np.log(np.maximum(share / EVENT_ACCURACY.min_decay, 1.0))))
        end = np.arange(int(np.clip(np.ceil(last), 1, EVENT_ACCURACY.max_exposures)) + 1) + 1.0
        left = np.exp(-(end[None, :, None] - start[:, None, None]) / time) @ share
        return -np.diff(left, axis=1, prepend=1.0), weight


@lru_cache(maxsize=1)
def _moments() -> tuple[Array, Array]:
    """Return Gauss-Legendre start times in an exposure of length 1 and their weights, densest at its end."""
    node, weight = np.polynomial.legendre.leggauss(EVENT_ACCURACY.start_times)
    root = 0.5 * (node + 1.0)
    return 1.0 - root**2, root * weight


@dataclass(frozen=True, kw_only=True)
class PulsePopulation:
    """Pulses of a dark or dim frame."""

    density: float  # detected events per pixel and exposure
    height_dn: float  # mean pulse height, total light of a pulse, DN
    # relative variance of the pulse heights: Polya (gamma) distribution of inverse shape; 1 is exponential
    relative_variance: float
    noise_dn2: float  # variance of the noise beneath the pulses, DN^2
    # line_1, line_2: fractions of a pixel's signal that the video filter moves to the next pixel of the row and the one
    # after, for noise and light alike
    line_1: float
    line_2: float
    # column_px, row_px: standard deviation of the Gaussian part of the spot along a row and a column, px
    column_px: float
    row_px: float
    wings: float  # strength of the other part, exp(-wings (f/f0)^exponent) with f0 of 0.1 cycles per column pitch
    exponent: float  # its exponent
    # glow, glow_exposures, fast_exposures: as `share`, `slow_exposures` and `fast_exposures` of `PulseDecay`
    glow: float = 0.0
    glow_exposures: float = 1.0
    fast_exposures: float = 0.0
    row_pitch: float = 1.0  # row pitch of an exposure, column pitches
    open_share: float = 1.0  # as in `PulseDecay`

    def log_characteristic(self, one: Filter, frequency: Array) -> NDArray[np.complex128]:
        """Return ln E exp(i t y) of filtered pixels y at frequencies t, shape (t,), 1/DN.

        rate * integral over positions of [E exp(i t h a(x)) - 1] - t^2 var / 2, with a(x) the filter output of a pulse
        of unit light at x and E exp(i s h) = (1 - i s G v)^(-1/v) of a gamma distribution of mean G and relative
        variance v (Campbell's theorem). The output includes the subtracted temporal mean.
        """
        amplitude, area = pulse_outputs(one, self.spot, self.line, self.screen)
        pulse = height_transform(np.multiply.outer(frequency * self.height_dn, amplitude), self.relative_variance)
        return self.density * (pulse @ area) - 0.5 * frequency**2 * one.noise(self.line) * self.noise_dn2

    @property
    def line(self) -> tuple[float, float, float]:
        """Impulse response of the video filter along a line."""
        return 1.0 - self.line_1 - self.line_2, self.line_1, self.line_2

    @property
    def spot(self) -> PulseSpread:
        """Spread of a pulse."""
        return PulseSpread(column_px=self.column_px, row_px=self.row_px, wings=self.wings, exponent=self.exponent,
                    row_pitch=self.row_pitch)  # fmt: skip

    @property
    def screen(self) -> PulseDecay:
        """Phosphor decay."""
        return PulseDecay(share=self.glow, slow_exposures=self.glow_exposures, fast_exposures=self.fast_exposures,
                    open_share=self.open_share)  # fmt: skip


def height_transform(z: Array, relative_variance: float) -> NDArray[np.complex128]:
    """Return E exp(i z h) - 1 of gamma-distributed heights h of mean 1."""
    shape = 1.0 / relative_variance
    size = np.exp(-0.5 * shape * np.log1p((z * relative_variance) ** 2))
    phase = shape * np.arctan(z * relative_variance)
    return size * np.cos(phase) - 1.0 + 1j * size * np.sin(phase)


@lru_cache(maxsize=512)
def pulse_outputs(one: Filter, spot: PulseSpread, line: tuple[float, ...], screen: PulseDecay) -> tuple[Array, Array]:
    """Return the outputs for pulses of unit light at all positions and ages: amplitudes, and px exposures of each."""
    amplitude, area = responses(one, spot, line)
    share, number = age_amplitudes(one, screen)
    value, weight = np.multiply.outer(share, amplitude).ravel(), np.multiply.outer(number, area).ravel()
    return quantise_amplitudes(value, weight) if screen.lasts else (value, weight)


@lru_cache(maxsize=512)
def age_amplitudes(one: Filter, screen: PulseDecay) -> tuple[Array, Array]:
    """Return the output of a temporal filter for pulses of every age: amplitudes and their numbers.

    A pulse begins at any time of any exposure; the subtracted temporal mean contains its light too.
    """
    light, chance = screen.by_exposure()
    amplitude = amplitudes_by_age(one, light)
    taken = sum_by_phase(one, light)
    rest = np.maximum(one.exposures - np.bincount(np.arange(amplitude.shape[1]) % one.stride, minlength=one.stride), 0)
    number = np.broadcast_to(chance[:, None], amplitude.shape)
    value = np.concatenate([amplitude.ravel(), -taken.ravel()])
    return value, np.concatenate([number.ravel(), np.multiply.outer(chance, rest).ravel()])


def amplitudes_by_age(one: Filter, light: Array) -> Array:
    """Return the amplitude of pulses of every age, shape (moment, age), for their light, shape (moment, exposure)."""
    moments, count = light.shape
    width = (len(one.times) - 1) * one.stride
    out = np.zeros((moments, count + width))
    for place, weight in enumerate(reversed(one.times)):
        out[:, place * one.stride : place * one.stride + count] += weight * light
    return out - sum_by_phase(one, light)[:, np.arange(out.shape[1]) % one.stride]


def sum_by_phase(one: Filter, light: Array) -> Array:
    """Return the part of a pulse removed with the temporal mean, by the parity of its start, shape (moment, phase)."""
    total = np.stack([light[:, phase :: one.stride].sum(axis=1) for phase in range(one.stride)], axis=1)
    return total * sum(one.times) / one.exposures


@dataclass(frozen=True, kw_only=True)
class CharacteristicFunctionData:
    """What frames show."""

    filters: tuple[Filter, ...]  # filters
    frequency: Array  # frequencies of each, shape (filter, t), 1/DN
    value: Array  # ln of the characteristic functions, real parts, then imaginary ones, shape (2 filter t,)
    covariance: Array  # covariance of the values, from the scatter of blocks, shape (2 filter t, 2 filter t)
    pixels: float  # number of pixels over all exposures

    def model(self, pulses: PulsePopulation) -> Array:
        """Return the model of pulses, shape (2 filter t,)."""
        pairs = zip(self.filters, self.frequency, strict=True)
        return real_and_imaginary(np.stack([pulses.log_characteristic(one, frequency) for one, frequency in pairs]))


def real_and_imaginary(values: NDArray[np.complex128]) -> Array:
    """Return real parts, then imaginary ones, as one vector."""
    return np.concatenate([values.real.ravel(), values.imag.ravel()])
