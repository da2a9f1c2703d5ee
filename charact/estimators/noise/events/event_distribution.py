"""Distribution of a filtered dark pixel: compound Poisson process of pulses.

Detected photoelectrons are uniformly distributed; each gives a pulse of random height, spread over
pixels and exposures. The characteristic function is exact at any density and includes overlapping
pulses and pulses below the noise, so no threshold is needed.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.events.frames import (
    Filter,
    PulseSpread,
    common_reach,
    quantise_amplitudes,
    responses,
)
from charact.estimators.noise.thresholds import EVENT_ACCURACY

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PulseDecay:
    """Phosphor decay of a pulse: two exponentials."""

    share: float = 0.0  # fraction of slow light, dimensionless
    # slow_exposures, fast_exposures: decay times of slow and fast light, exposures
    slow_exposures: float = 1.0
    fast_exposures: float = 0.0
    # fraction of the exposure period, from its start, in which pulses begin
    open_share: float = 1.0

    @property
    def lasts(self) -> bool:
        """Whether any light falls into later exposures."""
        return self.share > 0.0 or self.fast_exposures > 0.0

    @lru_cache(maxsize=256)  # noqa: B019
    def by_exposure(self) -> tuple[Array, Array]:
        """Return the fractions of light in a pulse's own and later exposures, and quadrature
        weights.

        Returns `light`: shape (moment, exposure); `weight`: fraction of the pulses that begin then,
        shape (moment,).
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
    """Return Gauss-Legendre start times in an exposure of length 1 and their weights, densest at
    its end.
    """
    node, weight = np.polynomial.legendre.leggauss(EVENT_ACCURACY.start_times)
    root = 0.5 * (node + 1.0)
    return 1.0 - root**2, root * weight


@dataclass(frozen=True, kw_only=True)
class PulsePopulation:
    """Pulses of a dark or dim frame."""

    density: float  # detected events per pixel and exposure
    height_dn: float  # mean pulse height, total light of a pulse, DN
    # relative variance of the pulse heights: Polya (gamma) distribution of inverse shape; 1 is
    # exponential
    relative_variance: float
    noise_dn2: float  # variance of the noise beneath the pulses, DN^2
    # line_1, line_2: fractions of a pixel's signal that the video filter moves to the next pixel of
    # the row and the one after, for noise and light alike
    line_1: float
    line_2: float
    # column_px, row_px: standard deviation of the Gaussian part of the spot along a row and a
    # column, px
    column_px: float
    row_px: float
    # strength of the other part, exp(-wings (f/f0)^exponent) with f0 of 0.1 cycles per column pitch
    wings: float
    exponent: float  # its exponent
    # glow, glow_exposures, fast_exposures: as `share`, `slow_exposures` and `fast_exposures` of
    # `PulseDecay`
    glow: float = 0.0
    glow_exposures: float = 1.0
    fast_exposures: float = 0.0
    row_pitch: float = 1.0  # row pitch of an exposure, column pitches
    open_share: float = 1.0  # as in `PulseDecay`

    def log_characteristic(self, one: Filter, frequency: Array) -> NDArray[np.complex128]:
        """Return ln E exp(i t y) of filtered pixels y at frequencies t, shape (t,), 1/DN.

        rate * integral over positions of [E exp(i t h a(x)) - 1] - t^2 var / 2, with a(x) the
        filter output of a pulse of unit light at x and E exp(i s h) = (1 - i s G v)^(-1/v) of a
        gamma distribution of mean G and relative variance v (Campbell's theorem). The output
        includes the subtracted temporal mean.
        """
        amplitude, area = pulse_outputs(one, self.spot, self.line, self.screen)
        pulse = height_transform(
            np.multiply.outer(frequency * self.height_dn, amplitude), self.relative_variance
        )
        return (
            self.density * (pulse @ area)
            - 0.5 * frequency**2 * one.noise(self.line) * self.noise_dn2
        )

    @property
    def line(self) -> tuple[float, float, float]:
        """Impulse response of the video filter along a line."""
        return 1.0 - self.line_1 - self.line_2, self.line_1, self.line_2

    @property
    def spot(self) -> PulseSpread:
        """Spread of a pulse."""
        return PulseSpread(
            column_px=self.column_px,
            row_px=self.row_px,
            wings=self.wings,
            exponent=self.exponent,
            row_pitch=self.row_pitch,
        )

    @property
    def screen(self) -> PulseDecay:
        """Phosphor decay."""
        return PulseDecay(
            share=self.glow,
            slow_exposures=self.glow_exposures,
            fast_exposures=self.fast_exposures,
            open_share=self.open_share,
        )


def height_transform(z: Array, relative_variance: float) -> NDArray[np.complex128]:
    """Return E exp(i z h) - 1 of gamma-distributed heights h of mean 1."""
    shape = 1.0 / relative_variance
    size = np.exp(-0.5 * shape * np.log1p((z * relative_variance) ** 2))
    phase = shape * np.arctan(z * relative_variance)
    return size * np.cos(phase) - 1.0 + 1j * size * np.sin(phase)


@lru_cache(maxsize=512)
def pulse_outputs(
    one: Filter, spot: PulseSpread, line: tuple[float, ...], screen: PulseDecay
) -> tuple[Array, Array]:
    """Return the outputs for pulses of unit light at all positions and ages: amplitudes, and px
    exposures of each.
    """
    amplitude, area = responses(one, spot, line)
    share, number = age_amplitudes(one, screen)
    value, weight = (
        np.multiply.outer(share, amplitude).ravel(),
        np.multiply.outer(number, area).ravel(),
    )
    return quantise_amplitudes(value, weight) if screen.lasts else (value, weight)


@lru_cache(maxsize=512)
def age_amplitudes(one: Filter, screen: PulseDecay) -> tuple[Array, Array]:
    """Return the output of a temporal filter for pulses of every age: amplitudes and their numbers.

    A pulse begins at any time of any exposure; the subtracted temporal mean contains its light too.
    """
    light, chance = screen.by_exposure()
    amplitude = amplitudes_by_age(one, light)
    taken = sum_by_phase(one, light)
    rest = np.maximum(
        one.exposures
        - np.bincount(np.arange(amplitude.shape[1]) % one.stride, minlength=one.stride),
        0,
    )
    number = np.broadcast_to(chance[:, None], amplitude.shape)
    value = np.concatenate([amplitude.ravel(), -taken.ravel()])
    return value, np.concatenate([number.ravel(), np.multiply.outer(chance, rest).ravel()])


def amplitudes_by_age(one: Filter, light: Array) -> Array:
    """Return the amplitude of pulses of every age, shape (moment, age), for their light, shape
    (moment, exposure).
    """
    moments, count = light.shape
    width = (len(one.times) - 1) * one.stride
    out = np.zeros((moments, count + width))
    for place, weight in enumerate(reversed(one.times)):
        out[:, place * one.stride : place * one.stride + count] += weight * light
    return out - sum_by_phase(one, light)[:, np.arange(out.shape[1]) % one.stride]


def sum_by_phase(one: Filter, light: Array) -> Array:
    """Return the part of a pulse removed with the temporal mean, by the parity of its start, shape
    (moment, phase).
    """
    total = np.stack(
        [light[:, phase :: one.stride].sum(axis=1) for phase in range(one.stride)], axis=1
    )
    return total * sum(one.times) / one.exposures


@dataclass(frozen=True, kw_only=True)
class CharacteristicFunctionData:
    """What frames show."""

    filters: tuple[Filter, ...]  # filters
    frequency: Array  # frequencies of each, shape (filter, t), 1/DN
    # ln of the characteristic functions, real parts, then imaginary ones, shape (2 filter t,)
    value: Array
    # covariance of the values, from the scatter of blocks, shape (2 filter t, 2 filter t)
    covariance: Array
    pixels: float  # number of pixels over all exposures

    def model(self, pulses: PulsePopulation) -> Array:
        """Return the model of pulses, shape (2 filter t,)."""
        pairs = zip(self.filters, self.frequency, strict=True)
        return real_and_imaginary(
            np.stack([pulses.log_characteristic(one, frequency) for one, frequency in pairs])
        )


def real_and_imaginary(values: NDArray[np.complex128]) -> Array:
    """Return real parts, then imaginary ones, as one vector."""
    return np.concatenate([values.real.ravel(), values.imag.ravel()])


Images = NDArray[np.float32]


def observe(
    changes: tuple[Images, ...], usable: list[NDArray[np.bool_]], filters: tuple[Filter, ...]
) -> CharacteristicFunctionData:
    """Return ln of the characteristic functions of filtered frames, and their covariance from
    blocks.

    `changes`: fluctuations for each parity, shape (exposure, row, col), DN; `usable`: usable
    values, same shapes; `filters`: filters.

    Filter weights sum to zero, and so does their output except for pulses at the border: its mean
    is subtracted, which rotates the functions by t times it.
    """
    scales: list[Array] = []
    parts = [
        _sums(change, good, filters, scales) for change, good in zip(changes, usable, strict=True)
    ]
    sums, levels, count = (np.concatenate([part[i] for part in parts]) for i in range(3))
    frequency = np.stack(scales)
    mean, level = sums.sum(axis=0) / count.sum(), levels.sum(axis=0) / count.sum()
    off = (sums - count[:, None, None] * mean) / mean
    off = (off - 1j * (levels - count[:, None] * level)[..., None] * frequency) / count.sum()
    scatter = np.concatenate(
        [off.real.reshape(len(off), -1), off.imag.reshape(len(off), -1)], axis=1
    )
    return CharacteristicFunctionData(
        filters=filters,
        frequency=frequency,
        value=real_and_imaginary(np.log(mean * np.exp(-1j * level[:, None] * frequency))),
        covariance=scatter.T @ scatter,
        pixels=float(count.sum()),
    )


def _sums(
    change: Images, usable: NDArray[np.bool_], filters: tuple[Filter, ...], scales: list[Array]
):
    """Return sums of exp(i t y) and of y over blocks, shapes (block, filter, t) and (block,
    filter), and their counts.

    The first parity also sets the frequencies of every filter.
    """
    reach = common_reach(filters)
    length = len(change) - max(len(one.times) for one in filters) + 1
    good = usable[
        :length, reach[0] : change.shape[1] - reach[0], reach[1] : change.shape[2] - reach[1]
    ]
    blocks = _Blocks.of(
        good, EVENT_ACCURACY.block_exposures if any(len(one.times) > 1 for one in filters) else 1
    )
    still = {}
    out, known = [], len(scales) == len(filters)
    for index, one in enumerate(filters):
        key = one.high, one.broad
        if key not in still:
            still[key] = Filter(high=one.high, broad=one.broad).within(change, reach)
        values = one.through_time(still[key])[:length]
        if not known:
            scales.append(frequencies(values))
        out.append(blocks.sums(values, scales[index]))
    return (
        np.stack([total for total, _ in out], axis=1),
        np.stack([y for _, y in out], axis=1),
        blocks.count,
    )


def frequencies(values: Images) -> Array:
    """Return the frequencies of the characteristic function of a filter's output, shape (t,),
    1/DN.
    """
    sample = values.ravel()[:: max(1, values.size // EVENT_ACCURACY.sample)]
    places = (np.array([0.25, 0.5, 0.999]) * (len(sample) - 1)).astype(int)
    sample = np.partition(sample, places)
    low, middle = sample[places[:2]]
    # Noise without pulses, and mean of the brightest thousandth.
    noise, bright = max(float(middle - low) / 0.6745, 1e-9), float(sample[places[2] :].mean())
    high = EVENT_ACCURACY.highest_frequency / noise
    low = min(EVENT_ACCURACY.lowest_frequency / max(bright, 1e-12), 0.25 * high)
    return np.geomspace(low, high, EVENT_ACCURACY.frequencies)


@dataclass(frozen=True, kw_only=True)
class _Blocks:
    """Blocks of pixels and exposures: first bin of each exposure and pixel, usable values, values
    per block.
    """

    first: NDArray[np.int64]
    good: NDArray[np.bool_] | None
    count: Array

    @classmethod
    def of(cls, good: NDArray[np.bool_], least_depth: int) -> "_Blocks":
        block = EVENT_ACCURACY.block_px
        high, wide = (
            np.minimum(np.arange(n) // block, max(n // block, 1) - 1) for n in good.shape[1:]
        )
        across = int(wide[-1]) + 1
        place = high[:, None] * across + wide
        images = int(place[-1, -1]) + 1
        depth = max(least_depth, -(-len(good) * images // EVENT_ACCURACY.max_blocks))
        time = np.arange(len(good)) // depth
        first = (time[:, None, None] * images + place) * EVENT_ACCURACY.bins
        chosen = None if good.all() else good
        inside = np.bincount(
            (first if chosen is None else first[good]).ravel() // EVENT_ACCURACY.bins,
            minlength=(int(time[-1]) + 1) * images,
        )
        return cls(first=first, good=chosen, count=inside.astype(float))

    def sums(self, values: Images, frequency: Array) -> tuple[NDArray[np.complex128], Array]:
        """Return sums of exp(i t y) over blocks, shape (block, t), and of y, shape (block,)."""
        bins = EVENT_ACCURACY.bins
        step, half = EVENT_ACCURACY.bin_width / frequency[-1], bins // 2
        place = values * np.float32(1.0 / step)
        place += np.float32(half + 0.5)
        # The first and the last bin are summed individually.
        np.clip(place, 0.0, bins - 0.5, out=place)
        index = place.astype(np.intp)
        far = (index == 0) | (index == bins - 1)
        index += self.first
        if self.good is not None:
            index, far = index[self.good], far & self.good
        count = np.bincount(index.ravel(), minlength=len(self.count) * bins).reshape(-1, bins)
        count[:, [0, -1]] = 0
        centre = step * (np.arange(bins) - half)
        # Averaging over a bin lowers a wave by sin(x)/x of half its phase.
        waves = np.exp(1j * np.multiply.outer(centre, frequency)) * np.sinc(
            0.5 * step * frequency / np.pi
        )
        number = count.astype(np.float64)
        total, level = np.asarray(number @ waves, np.complex128), number @ centre
        y, block = values[far].astype(np.float64), self.first[far] // bins
        np.add.at(total, block, np.exp(1j * np.multiply.outer(y, frequency)))
        np.add.at(level, block, y)
        return total, level


def scatter(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    """Return the covariance of the data for given pulses, shape (2 filter t, 2 filter t).

    The mean of exp(i t y) over N pixels, divided by its expectation, is 1 plus what each pulse of
    height h adds, c(h) = integral over positions of [exp(i t h a(x)) - 1], plus the noise. Pulses
    are Poisson distributed: their covariance is rate/N <c c'>. That of Gaussian noise of covariance
    C(D) is sum over D of exp(t t' C(D)) - 1. The sum neglects noise beneath pulses, which is small
    for few pulses.
    """
    return (_by_pulses(pulses, observed) + _by_noise(pulses, observed)) / observed.pixels


def _by_pulses(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    height, chance = _heights(pulses.relative_variance)
    added = np.empty((len(height), *observed.frequency.shape), np.complex128)
    for index, (one, frequency) in enumerate(
        zip(observed.filters, observed.frequency, strict=True)
    ):
        amplitude, area = pulse_outputs(one, pulses.spot, pulses.line, pulses.screen)
        z = np.multiply.outer(np.multiply.outer(height * pulses.height_dn, frequency), amplitude)
        added[:, index] = np.expm1(1j * z) @ area
    vector = np.stack([real_and_imaginary(np.asarray(one)) for one in added])
    return pulses.density * (vector.T * chance) @ vector


def _heights(relative_variance: float) -> tuple[Array, Array]:
    """Return Gauss-Laguerre heights of a gamma distribution of mean 1 and their weights."""
    from scipy.special import roots_genlaguerre

    shape = 1.0 / relative_variance
    if shape > 60.0:
        node, weight = np.polynomial.hermite_e.hermegauss(EVENT_ACCURACY.heights // 2)
        return np.maximum(1.0 + node / np.sqrt(shape), 1e-3), weight / weight.sum()
    node, weight = roots_genlaguerre(EVENT_ACCURACY.heights, shape - 1.0)
    return node / shape, weight / weight.sum()


def _by_noise(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    filters, frequency = observed.filters, observed.frequency
    count, times = frequency.shape
    even, odd = np.zeros((2, count, times, count, times))
    for a, one in enumerate(filters):
        for b, other in enumerate(filters):
            if b < a:
                even[a, :, b], odd[a, :, b] = even[b, :, a].T, odd[b, :, a].T
                continue
            shared = _output_covariance(one, other, pulses.line) * pulses.noise_dn2
            x = np.multiply.outer(np.multiply.outer(frequency[a], frequency[b]), shared)
            even[a, :, b] = (np.cosh(x) - 1.0).sum(axis=-1)
            odd[a, :, b] = np.sinh(x).sum(axis=-1)
    out = np.zeros((2 * count * times, 2 * count * times))
    half = count * times
    out[:half, :half], out[half:, half:] = even.reshape(half, half), odd.reshape(half, half)
    return out


def _output_covariance(one: Filter, other: Filter, line: tuple[float, ...]) -> Array:
    """Return the covariances of two filters' outputs at all separations, for noise of unit
    variance.
    """
    across = np.correlate(np.convolve(one.columns, line), np.convolve(other.columns, line), "full")
    down = np.correlate(np.ones(one.high), np.ones(other.high), "full")
    time = np.correlate(one.times, other.times, "full")
    return np.multiply.outer(np.multiply.outer(time, down), across).ravel()


def blend_covariances(computed: Array, counted: Array) -> Array:
    """Return the model covariance in directions dominated by pulses, and the block covariance in
    all others.

    Rare bright pulses lie in the few strongest directions, the neglected noise beneath pulses in
    the weak ones.
    """
    # Without pulses, weights of both signs may give negative values.
    unit = np.sqrt(np.maximum(np.diag(computed), 1e-6 * np.diag(counted)))
    power, direction = np.linalg.eigh(computed / np.outer(unit, unit))
    strong = direction[:, power > EVENT_ACCURACY.strong_direction]
    weak = np.eye(len(unit)) - strong @ strong.T
    rest = weak @ (counted / np.outer(unit, unit)) @ weak
    kept = (strong * power[power > EVENT_ACCURACY.strong_direction]) @ strong.T
    return (kept + EVENT_ACCURACY.block_loss * rest) * np.outer(unit, unit)
