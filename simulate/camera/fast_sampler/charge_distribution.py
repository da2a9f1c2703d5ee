"""Charge distribution of a cell: tabulated quantiles of a Poisson sum of gamma pulses.

A cell that expects N detected photoelectrons holds the sum of Poisson(N) pulses of mean 1 and gamma
shape k. The sum is zero with probability exp(-N); given that it is not, its standardised law
changes slowly with N. That law is kept as rows of quantiles, one for every two per cent of N; zero
probability, mean and variance are those of the cell's own N. Quantiles stand at probabilities that
are evenly spaced in each octave towards both ends, so that the exponent and leading bits of a
single-precision number are the index.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, gammaincc, gammaln, ndtri

# Rows of the standardised law: its skewness changes by one per cent from row to row.
LOWEST_ROW, ROW_STEP, ROWS, EXACT_EVERY = 1e-3, 0.02, 1100, 5
# Steps of the logarithm of the gamma shape: the skewness errs by half a per cent at most, and the
# cameras of a posterior share their rows.
SHAPE_STEP = 0.02
# Nodes: 16 in each of the octaves 2^-25 .. 2^-1 towards either end, and the last one, 1/2.
MANTISSA_BITS, OCTAVES = 4, 24
HALF = (OCTAVES << MANTISSA_BITS) + 2
NODES = 2 * HALF
SMALLEST = 2.0 ** -(OCTAVES + 1)
# Up to this mean the law is summed over the number of pulses; beyond, it is inverted from its
# characteristic function.
SUMMED_TO = 32.0


@dataclass(frozen=True, kw_only=True)
class CellLaw:
    """Tables from which the charge of cells is looked up.

    `inverse` of the probability that a cell holds anything, `rows` of its standardised law, and
    these rows, flat.
    """

    inverse: NDArray[np.float32]
    rows: NDArray[np.uint16]
    quantiles: NDArray[np.float32]


def pulse_law(shape: float, mean: NDArray[np.floating]) -> CellLaw:
    """Return the law of sums of pulses of a gamma shape, for each mean number of pulses."""
    index = np.rint(np.log(np.maximum(mean, LOWEST_ROW) / LOWEST_ROW) / ROW_STEP)
    row = np.minimum(index, ROWS - 1).astype(np.uint16)
    rows = np.flatnonzero(np.bincount(row.ravel(), minlength=ROWS))
    table_row = np.zeros(ROWS, np.uint16)
    table_row[rows] = np.arange(len(rows))
    near_shape = float(np.exp(SHAPE_STEP * np.rint(np.log(shape) / SHAPE_STEP)))
    quantiles = np.concatenate([row_quantiles(near_shape, int(number)) for number in rows])
    probability = -np.expm1(-np.asarray(mean, np.float64))
    # Beyond any use where nothing is expected, so that nothing is drawn there.
    inverse = np.divide(
        1.0, probability, out=np.full(probability.shape, 1e30), where=probability > 1e-30
    )
    return CellLaw(
        inverse=inverse.astype(np.float32),
        rows=table_row[row],
        quantiles=quantiles.astype(np.float32),
    )


def normal_law(mean: NDArray[np.floating]) -> CellLaw:
    """Return a normal law of the same mean and variance, for each mean number of pulses: one row
    for all.
    """
    inverse = np.ones(mean.shape, np.float32)
    return CellLaw(
        inverse=inverse, rows=np.zeros(mean.shape, np.uint16), quantiles=normal_quantiles()
    )


def node_probabilities() -> NDArray[np.float64]:
    """Return the probabilities of one half's nodes, ascending to 1/2, the last one twice, shape
    (HALF,).
    """
    step = np.arange(OCTAVES << MANTISSA_BITS)
    octave, mantissa = step >> MANTISSA_BITS, step & ((1 << MANTISSA_BITS) - 1)
    probability = SMALLEST * 2.0**octave * (1.0 + mantissa / (1 << MANTISSA_BITS))
    return np.append(probability, (0.5, 0.5))


@lru_cache(maxsize=2048)
def row_quantiles(shape: float, row: int) -> NDArray[np.float64]:
    """Return the quantiles of a row, shape (NODES,): every fifth by the law itself, between them by
    straight lines.
    """
    lower_row = row - row % EXACT_EVERY
    fraction = (row - lower_row) / EXACT_EVERY
    exact = unit_variance_quantiles(shape, LOWEST_ROW * float(np.exp(ROW_STEP * lower_row)))
    if fraction == 0.0:
        return exact
    next_exact = unit_variance_quantiles(
        shape, LOWEST_ROW * float(np.exp(ROW_STEP * (lower_row + EXACT_EVERY)))
    )
    return _standard((1.0 - fraction) * exact + fraction * next_exact)


@lru_cache(maxsize=4096)
def unit_variance_quantiles(shape: float, mean: float) -> NDArray[np.float64]:
    """Return the quantiles of the non-zero sum, scaled to mean 0 and variance 1, shape (NODES,).

    Notes
    -----
    P(sum > x | sum > 0) = sum_n Poisson(n; N) Q(n k, k x)/(1 - exp(-N)), n from 1, Q the
    regularised upper gamma function; for many pulses the density is the inverse Fourier transform
    of exp(N((1 - it/k)^-k - 1)).
    """
    amount, cumulative, survival = (
        _distribution_by_sum(shape, mean)
        if mean <= SUMMED_TO
        else _distribution_by_transform(shape, mean)
    )
    probability = node_probabilities()
    upper = _invert_distribution(amount, survival, probability)
    lower = _invert_distribution(amount, cumulative, probability)
    return _standard(np.concatenate([upper, lower]))


def _invert_distribution(
    amount: NDArray, cumulative: NDArray, probability: NDArray
) -> NDArray[np.float64]:
    """Amounts at which a cumulative probability, ascending or descending, has the values given."""
    is_resolved = cumulative > 0.1 * SMALLEST
    x, p = np.log(cumulative[is_resolved]), amount[is_resolved]
    order = np.argsort(x, kind="stable")
    x, p = x[order], p[order]
    distinct = np.append(True, np.diff(x) > 0.0)
    from scipy.interpolate import PchipInterpolator

    # The lowest amounts that were looked at stand for those below.
    log_probability = np.maximum(np.log(probability), x[distinct][0])
    return np.asarray(PchipInterpolator(x[distinct], p[distinct])(log_probability))


def _distribution_by_sum(shape: float, mean: float) -> tuple[NDArray, NDArray, NDArray]:
    max_number = int(mean + 10.0 * np.sqrt(mean) + 14)
    number = np.arange(1, max_number + 1)
    weight = np.exp(number * np.log(mean) - mean - gammaln(number + 1.0)) / -np.expm1(-mean)
    is_likely = weight > 1e-7 * SMALLEST
    number, weight = number[is_likely], weight[is_likely]
    max_amount = (
        mean + 1.0 + 9.0 * np.sqrt((mean + 1.0) * (1.0 + 1.0 / shape)) + 18.0 / min(shape, 1.0)
    )
    # Heights of narrow pulses leave peaks, each to be resolved.
    points = int(min(260.0 * max(1.0, np.sqrt(shape)), 6000.0))
    fine, coarse = (
        np.geomspace(1e-9, 1e-2, 60, endpoint=False),
        np.linspace(0.1, np.sqrt(max_amount), points) ** 2,
    )
    amount = np.concatenate([fine, coarse])
    scaled, shapes = shape * amount[:, None], number[None, :] * shape
    # The smaller of both probabilities keeps its digits.
    total, is_low = weight.sum(), amount < mean
    low = gammainc(shapes, scaled[is_low]) @ weight
    high = gammaincc(shapes, scaled[~is_low]) @ weight
    return amount, np.append(low, total - high), np.append(total - low, high)


def _distribution_by_transform(shape: float, mean: float) -> tuple[NDArray, NDArray, NDArray]:
    count = 4096
    spread = np.sqrt(mean * (1.0 + 1.0 / shape))
    step = 24.0 * spread / count
    frequency = 2.0 * np.pi * np.fft.fftfreq(count, step)
    start = mean - 11.0 * spread
    log_transform = mean * ((1.0 - 1j * frequency / shape) ** -shape - 1.0) - 1j * frequency * start
    density = np.fft.fft(np.exp(log_transform)).real / (count * step)
    amount = start + step * np.arange(count)
    density = np.where(density > 1e-13 * density.max(), density, 0.0)
    areas = 0.5 * step * (density[1:] + density[:-1])
    cumulative = np.append(0.0, np.cumsum(areas))
    survival = np.append(np.cumsum(areas[::-1])[::-1], 0.0)
    total = areas.sum()
    return amount, cumulative / total, survival / total


def _standard(quantiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bring quantiles to mean 0 and variance 1 as they will be drawn: straight lines between
    nodes.
    """
    mean = square = 0.0
    probability = node_probabilities()
    for half in (quantiles[:HALF], quantiles[HALF:]):
        a, b, width = half[:-1], half[1:], np.diff(probability)
        # What is rarer than the rarest node is drawn as that node.
        mean += probability[0] * half[0] + np.sum(width * 0.5 * (a + b))
        square += probability[0] * half[0] ** 2 + np.sum(width * (a * a + a * b + b * b) / 3.0)
    return (quantiles - mean) / np.sqrt(square - mean**2)


@lru_cache(maxsize=1)
def normal_quantiles() -> NDArray[np.float32]:
    """Return the quantiles of the normal law at the same nodes, shape (NODES,)."""
    upper = -ndtri(node_probabilities())
    return _standard(np.concatenate([upper, -upper])).astype(np.float32)
