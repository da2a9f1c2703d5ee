"""Model covariance of the characteristic functions.

An empirical covariance underestimates rare bright pulses: if few occur by chance, both their number and its error are
low, which biases the fit.
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
from charact.noise.thresholds import EVENT_ACCURACY

Array = NDArray[np.float64]


def scatter(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    """Return the covariance of the data for given pulses, shape (2 filter t, 2 filter t).

    Notes
    -----
    The mean of exp(i t y) over N pixels, divided by its expectation, is 1 plus what each pulse of height h adds,
    c(h) = integral over positions of [exp(i t h a(x)) - 1], plus the noise. Pulses are Poisson distributed: their
    covariance is rate/N <c c'>. That of Gaussian noise of covariance C(D) is sum over D of exp(t t' C(D)) - 1. The sum
    neglects noise beneath pulses, which is small for few pulses.
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
    """Return the covariances of two filters' outputs at all separations, for noise of unit variance."""
    across = np.correlate(np.convolve(one.columns, line), np.convolve(other.columns, line), "full")
    down = np.correlate(np.ones(one.high), np.ones(other.high), "full")
    time = np.correlate(one.times, other.times, "full")
    return np.multiply.outer(np.multiply.outer(time, down), across).ravel()


def blend_covariances(computed: Array, counted: Array) -> Array:
    """Return the model covariance in directions dominated by pulses, and the block covariance in all others.

    Rare bright pulses lie in the few strongest directions, the neglected noise beneath pulses in the weak ones.
    """
    # Without pulses, weights of both signs may give negative values.
    unit = np.sqrt(np.maximum(np.diag(computed), 1e-6 * np.diag(counted)))
    power, direction = np.linalg.eigh(computed / np.outer(unit, unit))
    strong = direction[:, power > EVENT_ACCURACY.strong_direction]
    weak = np.eye(len(unit)) - strong @ strong.T
    rest = weak @ (counted / np.outer(unit, unit)) @ weak
    return (
        (strong * power[power > EVENT_ACCURACY.strong_direction]) @ strong.T + EVENT_ACCURACY.block_loss * rest
    ) * np.outer(unit, unit)
