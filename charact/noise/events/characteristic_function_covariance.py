"""How characteristic functions of filtered frames scatter from stack to stack, computed rather than counted.

A scatter that is counted from the frames knows too little of the rare bright pulses that cause most of it: where by
chance few came, both their number and its error read low, and a fit that weighs by it is drawn that way.
"""

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.event_distribution import (
    CharacteristicFunctionData,
    PulsePopulation,
    pulse_outputs,
    real_and_imaginary,
)
from charact.noise.events.filters import Filter

Array = NDArray[np.float64]

# Heights that stand for the law of the heights.
HEIGHTS = 20
# Directions whose variance is beyond this, in units of the mean one, are computed; and what blocks miss of the variance
# as pulses on their borders are counted in halves.
STRONG, MORE_THAN_COUNTED = 4.0, 1.4


def scatter(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    """Return the covariance of `CharacteristicFunctionData.value` for given pulses, shape (2 filter t, 2 filter t).

    Notes
    -----
    The mean of exp(i t y) over N pixels, divided by its expectation, is 1 plus what each pulse of height h adds,
    c(h) = integral over places of [exp(i t h a(x)) - 1], and what the noise adds. Pulses come by chance: their
    covariance is rate/N <c c'>. That of Gaussian noise of covariance C(D) is sum over D of exp(t t' C(D)) - 1. Both
    together leave out what noise under pulses adds, which is small as long as pulses are few.
    """
    return (_by_pulses(pulses, observed) + _by_noise(pulses, observed)) / observed.pixels


def _by_pulses(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    height, chance = _heights(pulses.relative_variance)
    added = np.empty((len(height), *observed.frequency.shape), np.complex128)
    for index, (one, frequency) in enumerate(zip(observed.filters, observed.frequency, strict=True)):
        amplitude, area = pulse_outputs(one, pulses.spot, pulses.line, pulses.screen)
        z = np.multiply.outer(np.multiply.outer(height * pulses.height_dn, frequency), amplitude)
        added[:, index] = np.expm1(1j * z) @ area
    vector = np.stack([real_and_imaginary(np.asarray(one)) for one in added])
    return pulses.density * (vector.T * chance) @ vector


def _heights(relative_variance: float) -> tuple[Array, Array]:
    """Heights of a gamma law of mean 1 and their chances, by Gauss and Laguerre."""
    from scipy.special import roots_genlaguerre

    shape = 1.0 / relative_variance
    if shape > 60.0:
        node, weight = np.polynomial.hermite_e.hermegauss(HEIGHTS // 2)
        return np.maximum(1.0 + node / np.sqrt(shape), 1e-3), weight / weight.sum()
    node, weight = roots_genlaguerre(HEIGHTS, shape - 1.0)
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
    """Covariances of two filters' outputs at all distances, for noise of unit variance."""
    across = np.correlate(np.convolve(one.columns, line), np.convolve(other.columns, line), "full")
    down = np.correlate(np.ones(one.high), np.ones(other.high), "full")
    time = np.correlate(one.times, other.times, "full")
    return np.multiply.outer(np.multiply.outer(time, down), across).ravel()


def blend_covariances(computed: Array, counted: Array) -> Array:
    """Return the covariance as computed where pulses make it, and as counted from blocks in all other directions.

    Rare bright pulses lie in the few strongest directions, and noise under pulses, which the computation leaves out,
    in the weak ones.
    """
    # Where pulses add nothing, weights of both signs may leave less than nothing.
    unit = np.sqrt(np.maximum(np.diag(computed), 1e-6 * np.diag(counted)))
    power, direction = np.linalg.eigh(computed / np.outer(unit, unit))
    strong = direction[:, power > STRONG]
    weak = np.eye(len(unit)) - strong @ strong.T
    rest = weak @ (counted / np.outer(unit, unit)) @ weak
    return ((strong * power[power > STRONG]) @ strong.T + MORE_THAN_COUNTED * rest) * np.outer(unit, unit)
