"""Test of one set of numbers against an ensemble of simulated ones, and correction for several such
tests.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.validation.thresholds import VALIDATION
from labdata import Array


@dataclass(frozen=True, kw_only=True)
class Ensemble:
    """Numbers of one kind from simulated sets of frames, each set from its own posterior draw.

    `values`: shape (set, number); `least_sd`: least standard deviation of each number, for counts
    that all simulated sets have in common, shape (number,).
    """

    values: Array
    least_sd: Array
    seed: int

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the numbers of one set, shape (number, number).

        Correlations are halved: of so few sets an unchanged correlation matrix would be nearly
        singular.
        """
        spread = self.values - self.values.mean(axis=0)
        return _shrink(spread[None], self.least_sd)[0]

    @property
    def sd(self) -> Array:
        """Standard deviation of a prediction, shape (number,)."""
        return np.sqrt(np.diag(self.covariance) * (1.0 + 1.0 / len(self.values)))

    def distance(self, measured: Array) -> float:
        """Return the root of chi-squared over the number of terms; 1 is usual."""
        return float(np.sqrt(self._deviations(measured[None])[0, 0] / self.values.shape[1]))

    def p_value(self, measured: Array, least: float = 1.0) -> float:
        """Return the probability of at least this deviation.

        Parameters
        ----------
        measured
            Numbers of a set, shape (number,), or of several parts of its frames, (part, number);
            the most deviating part counts.
        least
            Level to which the value is compared: repetitions are sufficient for half of it.

        Notes
        -----
        A deviation is the larger of two, each over its 99 % quantile: chi-squared of all numbers,
        which finds small errors of many, and the largest squared z-score, which finds an error of
        one. The covariance is estimated from few sets, so that neither has a tabulated
        distribution: the procedure is repeated on Gaussian sets with the estimated covariance (a
        parametric bootstrap; Davison and Hinkley 1997, section 4.2), all parts of a repetition
        against the same sets.
        """
        part_values = np.atleast_2d(measured)
        furthest = self._ranked(self._deviations(part_values)).max()
        at_least, count, most = 0, 0, VALIDATION.most_replicates(least)
        while at_least < VALIDATION.exceedances and count < most:
            run = count // VALIDATION.replicates
            single = run == 0 and len(part_values) == 1
            null = self.null if single else self._repeat(len(part_values), run)
            at_least += int(np.sum(self._ranked(null).max(axis=1) >= furthest))
            count += len(null)
        return (1 + at_least) / (count + 1)

    def finds(self, noise: Array, shift: Array, level: float) -> NDArray[np.bool_]:
        """Return which sets have a p-value below a level, shape (set,).

        `noise`: their deviations from the centre, shape (set, number), to which a shift is added,
        shape (number,) or one for each set.
        """
        null = self._ranked_null
        # As many repetitions may deviate further where (1 + number) / (1 + all) is below the level.
        further = max(int(np.ceil(level * (1 + len(null)))) - 2, 0)
        sets = self.values.mean(axis=0) + noise + shift
        return self._ranked(self._deviations(sets)) > null[-1 - further]

    def z_scores(self, measured: Array) -> Array:
        """Return each number's deviation in standard deviations of the prediction, shape
        (number,).
        """
        return (measured - self.values.mean(axis=0)) / self.sd

    def _deviations(self, measured: Array) -> Array:
        """Return chi-squared and the largest squared z-score of sets (n, number), shape (n, 2)."""
        return _deviations(
            measured - self.values.mean(axis=0), self.covariance * (1.0 + 1.0 / len(self.values))
        )

    def _ranked(self, deviations: Array) -> Array:
        """Return the larger of both deviations, each over its 99 % quantile where the simulation is
        right.
        """
        return (deviations / self._usual).max(axis=-1)

    @cached_property
    def _usual(self) -> Array:
        """99 % quantiles of both deviations where the simulation is right, shape (2,)."""
        return np.quantile(self.null[:, 0], 0.99, axis=0)

    @cached_property
    def _ranked_null(self) -> Array:
        """Deviations of one part where the simulation is right, in ascending order, shape
        (replicate,).
        """
        return np.sort(self._ranked(self.null[:, 0]))

    @cached_property
    def null(self) -> Array:
        """Deviations where the simulation is right, shape (replicate, 1, 2)."""
        return self._repeat(1)

    def _repeat(self, parts: int, run: int = 0) -> Array:
        """Return deviations of several sets from the same ensemble where it is right, shape
        (replicate, place, 2).
        """
        rng = np.random.default_rng([self.seed, 1, run])
        count, size = self.values.shape
        root = np.linalg.cholesky(self.covariance)
        deviations = []
        for _ in range(VALIDATION.replicates // 500):
            drawn = rng.standard_normal((500, count + parts, size)) @ root.T
            sets, part_draws = drawn[:, parts:], drawn[:, :parts]
            centre = sets.mean(axis=1, keepdims=True)
            covariance = _shrink(sets - centre, self.least_sd) * (1.0 + 1.0 / count)
            deviations.append(_deviations(part_draws - centre, covariance))
        return np.concatenate(deviations)


def _deviations(gap: Array, covariance: Array) -> Array:
    """Return chi-squared and the largest squared z-score of gaps (..., n, number) by covariances,
    shape (..., n, 2).
    """
    squared = np.einsum(
        "...ni,...in->...n", gap, np.linalg.solve(covariance, np.swapaxes(gap, -1, -2))
    )
    variance = np.einsum("...ii->...i", covariance)[..., None, :]
    return np.stack([squared, (gap**2 / variance).max(axis=-1)], axis=-1)


def _shrink(spread: Array, least_sd: Array) -> Array:
    """Return covariances of deviations (..., set, number) with halved correlations and a least
    variance.
    """
    covariance = np.swapaxes(spread, -1, -2) @ spread / (spread.shape[-2] - 1.0)
    variance = np.maximum(np.einsum("...ii->...i", covariance), least_sd**2)
    half = 0.5 * covariance
    np.einsum("...ii->...i", half)[...] = variance
    return half


def ensemble_of(
    sets: Sequence[Mapping[str, float]], least_sd: float, seed: int
) -> tuple[tuple[str, ...], Ensemble]:
    """Return the labels that all sets have with finite numbers, and their ensemble."""
    labels = tuple(
        label
        for label in sets[0]
        if all(np.isfinite(numbers.get(label, np.nan)) for numbers in sets)
    )
    values = np.array([[numbers[label] for label in labels] for numbers in sets], float).reshape(
        len(sets), len(labels)
    )
    # Rounding leaves a spread even of numbers that are the same in all sets.
    floor = np.maximum(least_sd, 1e-6 * np.abs(values).max(axis=0, initial=0.0)) + 1e-12
    return labels, Ensemble(
        values=values, least_sd=np.broadcast_to(floor, (len(labels),)), seed=seed
    )


def holm_levels(p_values: Sequence[float], level: float) -> tuple[float, ...]:
    """Return the level below which each of several tests fails, at a common family-wise level (Holm
    1979).

    Notes
    -----
    In the order of p, test i of m is compared with level / (m - i), i = 0 first; once one passes,
    those with larger p pass as well: they are compared with its level. So a test fails exactly
    where its p-value is below its level.

    Examples
    --------
    >>> holm_levels([0.2, 0.001, 0.012], 0.03)
    (0.03, 0.01, 0.015)
    >>> holm_levels([0.02, 0.012], 0.02)
    (0.01, 0.01)
    """
    levels, test_level = [0.0] * len(p_values), 0.0
    passed = False
    for rank, index in enumerate(np.argsort(p_values, kind="stable")):
        test_level = test_level if passed else level / (len(p_values) - rank)
        levels[index] = test_level
        passed = passed or p_values[index] >= test_level
    return tuple(levels)
