"""A stack of frames, split into its mean frame and what changes from frame to frame."""

import itertools
from collections.abc import Iterator, Mapping
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.frames.noise_law import masked_covariance
from charact.observables.size import Size, part_of_noise
from charact.observables.thresholds import FRAMES

Array = NDArray[np.float64]
Frames = NDArray[np.floating]


class FrameView:
    """A stack of frames, split into its mean frame and what changes from frame to frame.

    `mean`: mean frame, shape (row, col); `steady`: mean frame of the middle half of each pixel's
    values, in which pulses of single frames leave no trace; `change`: frames less the mean frame,
    scaled so that their variance is that of a frame, shape (frame, row, col); `interlaced`: whether
    odd rows were exposed at another time than even ones; `excess_ones`: fraction of ones in the
    lowest bits of whole DN less that of values of the same level and noise, shape (bit,); `known`:
    pattern that maps of the specimen give, about its mean, DN, from which defects depart.
    """

    def __init__(
        self,
        label: str,
        frames: NDArray,
        *,
        interlaced: bool = False,
        known: Frames | float = 0.0,
    ) -> None:
        self.label, self.interlaced = label, interlaced
        data = np.asarray(frames, np.float32)
        count = len(data)
        self.mean = data.mean(axis=0)
        middle = _ordered_in_time(data)[count // 4 : count - count // 4]
        self.steady = np.mean(middle, axis=0)
        # Bits of more than the noise follow the level: the mean frame with the noise of other
        # pixels has it too, but is on no grid of the digitiser.
        noise = np.roll(data[0] - self.mean, data.shape[2] // 2, axis=1)
        # Halves, which means of a few whole DN often are, are rounded to odd as often as to even.
        halves = np.where(np.arange(data.shape[2]) % 2, 1e-3, -1e-3)
        codes = np.rint([data[0], self.mean + noise + halves]).astype(np.int64)
        ones = [(codes >> bit & 1).mean(axis=(1, 2)) for bit in range(FRAMES.bits)]
        self.excess_ones = np.array([measured - expected for measured, expected in ones])
        self.change = (data - self.mean) * np.float32(np.sqrt(count / (count - 1.0)))
        # Without changes of whole frames, as EMVA 1288 takes the variance: lags would sum them up.
        change = self.change - self.change.mean(axis=(1, 2), keepdims=True)
        self.covariance, _ = masked_covariance(change, np.ones(self.mean.shape, bool), FRAMES.reach)
        self.power = self.spectrum(self.change)
        # A plane and a bowl are shading, not pattern.
        self.shading, self.pattern = _without_shading(self.mean)
        self.known = known

    @property
    def mean_dn(self) -> float:
        """Mean, DN."""
        return float(self.mean.mean())

    @property
    def variance_dn2(self) -> float:
        """Variance of a pixel in time, DN^2."""
        # Frames that repeat each other have none.
        return max(float(self.covariance[FRAMES.reach, FRAMES.reach]), 1e-12)

    @cached_property
    def ordered(self) -> Frames:
        """Changes in ascending order as far as tails and `robust_sd` need it, shape
        (frame * row * col,).
        """
        size = self.change.size
        tails = (max(1, round(fraction * size)) for fraction in FRAMES.tails)
        ranks = {*self._central, *(rank for count in tails for rank in (count - 1, size - count))}
        return np.partition(self.change, sorted(ranks), axis=None)

    @property
    def _central(self) -> list[int]:
        """Ranks of the ends of the central 68 % of changes."""
        return [int(fraction * self.change.size) for fraction in (0.159, 0.841)]

    @property
    def robust_sd(self) -> float:
        """Half the range of the central 68 % of changes, DN; the step of whole numbers where it is
        0.
        """
        low, high = self.ordered[self._central]
        return max(float(high - low) / 2.0, 0.3)

    @cached_property
    def line_variances(self) -> Mapping[str, float]:
        """Variance in time of the means of rows and columns less those of their frames, DN^2."""
        lines = {"rows": self.change.mean(axis=2), "columns": self.change.mean(axis=1)}
        return {
            name: float((line - line.mean(axis=1, keepdims=True)).var())
            for name, line in lines.items()
        }

    @staticmethod
    def spectrum(images: Frames) -> Array:
        """Return the mean power of images per pixel, 1 for white noise of variance 1, shape (row,
        col / 2 + 1).
        """
        from scipy import fft

        transform: Any = fft.rfft2(images)
        rows, cols = images.shape[-2:]
        power = np.abs(transform) ** 2 / (rows * cols)
        return power.reshape(-1, *power.shape[-2:]).mean(axis=0)


def log(value: float) -> float:
    """Return the logarithm of a positive number; that of a small one where frames repeat."""
    return float(np.log(max(value, 1e-12)))


def cube_root(value: float) -> float:
    """Return the cube root, in which a variance is nearly Gaussian (Wilson and Hilferty 1931)."""
    return float(np.cbrt(value))


def bands_of(power: Array, reference: Array, what: str) -> dict[str, float]:
    """Return the power over a reference in bands along both axes and over all directions, and its
    highest peak.
    """
    features = {}
    for label, cut, band, _ in _bands(power.shape, what):
        ratio = float(power[cut][band].mean()) / max(float(reference[cut][band].mean()), 1e-12)
        features[label] = cube_root(ratio)
    highest = float(power.ravel()[1:].max()) / max(float(power.mean()), 1e-12)
    return features | {f"ln peak in the {what}": log(highest)}


def band_sizes(shape: tuple[int, ...], what: str, mean: float = 1.0) -> dict[str, Size]:
    """Return what departures of the numbers of `bands_of` are measured in: each band's part of the
    noise of a pixel.

    `mean`: mean power over the variance of a pixel.
    """
    bins = shape[0] * 2 * (shape[1] - 1)
    sizes = {
        label: part_of_noise(weight * band.sum() / bins)
        for label, _, band, weight in _bands(shape, what)
    }
    line = Size(unit="% of noise", of=lambda peak: np.sqrt(2.0 * mean / bins * np.exp(peak)))
    return sizes | {f"ln peak in the {what}": line}


def _bands(shape: tuple[int, ...], what: str) -> Iterator[tuple[str, Any, NDArray[np.bool_], int]]:
    """Yield the label, cut and members of each band of a spectrum (row, col / 2 + 1), and how often
    each stands in the whole plane.
    """
    rows, half = shape
    x, y = np.fft.rfftfreq(2 * (half - 1))[:half], np.abs(np.fft.fftfreq(rows))
    cuts: dict[str, tuple[NDArray, Any, int]] = {
        "horizontal": (x, (0, slice(None)), 2),
        "vertical": (y, (slice(None), 0), 1),
        "radial": (np.hypot(y[:, None], x), ..., 2),
    }
    for name, (frequency, cut, weight) in cuts.items():
        for low, high in itertools.pairwise(FRAMES.bands):
            band = (frequency > low) & (frequency <= high)
            if band.any():
                yield f"{name} {what}, {low:g} to {high:g} cy/px", cut, band, weight


def highest(values: Frames, count: int) -> float:
    """Return the mean of the highest values."""
    flat = values.ravel()
    # The highest values lie in the blocks of the highest maxima: they are at least the least of as
    # many maxima.
    maxima = np.maximum.reduceat(flat, np.arange(0, flat.size, FRAMES.block))
    if maxima.size > count:
        flat = flat[flat >= np.partition(maxima, maxima.size - count)[-count]]
    return float(np.partition(flat, flat.size - count)[-count:].mean())


def correlations_of(images: Frames, lags: tuple[int, ...], what: str) -> dict[str, float]:
    """Return the mean correlation of images at lags, and the largest of any two, of images (image,
    row, col).
    """
    flat = images.reshape(len(images), -1)
    gram = flat @ flat.T
    gram = gram / max(float(np.trace(gram)) / len(gram), 1e-12)
    features = {
        f"correlation of {what}, {lag} apart": float(np.diag(gram, lag).mean())
        for lag in lags
        if lag < len(gram)
    }
    return features | {
        f"largest correlation of two {what}": float(gram[np.triu_indices(len(gram), 1)].max())
    }


def _ordered_in_time(frames: Frames) -> list[Frames]:
    """Return the values of each pixel in ascending order, shapes (row, col).

    Whole frames are exchanged (odd-even transposition sort; Knuth, vol. 3, 5.3.4): to sort pixel by
    pixel takes five times as long.
    """
    ordered = list(frames)
    for first in range(len(ordered)):
        for at in range(first % 2, len(ordered) - 1, 2):
            pair = ordered[at], ordered[at + 1]
            ordered[at], ordered[at + 1] = np.minimum(*pair), np.maximum(*pair)
    return ordered


def _without_shading(mean: Frames) -> tuple[Array, Frames]:
    """Return slopes and curvatures of a frame over coordinates -1..1, and the frame without
    them.
    """
    terms, products = _terms_of_shading(*mean.shape)
    coefficients = np.linalg.solve(products, (terms @ mean.ravel()).astype(float))
    shading = (coefficients.astype(np.float32) @ terms).reshape(mean.shape)
    return np.asarray(coefficients[1:], np.float64), mean - shading


@lru_cache(maxsize=2)
def _terms_of_shading(rows: int, cols: int) -> tuple[Frames, Array]:
    """Return the terms of a plane and a bowl over coordinates -1..1, shape (term, pixel), and their
    products, shape (term, term).
    """
    y, x = (np.linspace(-1.0, 1.0, size, dtype=np.float32) for size in (rows, cols))
    images = np.broadcast_arrays(
        np.float32(1.0),
        x[None, :],
        y[:, None],
        x[None, :] ** 2,
        y[:, None] ** 2,
        x[None, :] * y[:, None],
    )
    terms = np.stack(images).reshape(6, -1)
    return terms, (terms @ terms.T).astype(float)
