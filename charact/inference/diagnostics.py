"""Checks of a posterior: of its draws (slow mixing, ensembles that disagree, crowding at a bound,
several peaks), and of its model by replicated data.

Sources: autocorrelation time averaged over walkers, Goodman & Weare 2010 and Foreman-Mackey et al.
2013 (doi 10.1086/670067); split R-hat, Gelman et al., Bayesian Data Analysis, 3rd edition, section
11.4.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput

Array = NDArray[np.float64]

# Shares of proposals taken by chains that move as they should, and of the median walker by one that
# is stuck.
LEAST_ACCEPTANCE, LARGEST_ACCEPTANCE = 0.1, 0.8
STUCK_SHARE = 0.05
# Width of the strip at a wall, as a share of what the draws span, and how crowded it may be against
# a uniform one.
WALL_STRIP = 0.1
WALL_CROWD = 1.6
# A second peak counts when it holds this share of the draws and the valley is this much lower than
# it.
PEAK_SHARE = 0.02
VALLEY_DEPTH = 0.5
# Probability of rejecting a correct model, divided between the three discrepancies.
MISFIT_LEVEL = 0.01


def split_r_hat(chain: Array) -> Array:
    """Return split R-hat of chains (step, chain, parameter): halves of each must agree, shape
    (parameter,).
    """
    half = len(chain) // 2
    halves = np.concatenate([chain[:half], chain[half : 2 * half]], axis=1)
    return _r_hat(np.moveaxis(halves, 1, 0))


def ensemble_r_hat(chains: Array) -> Array:
    """Return split R-hat between ensembles (ensemble, step, walker, parameter), each pooled over
    its walkers.
    """
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, half : 2 * half]])
    return _r_hat(halves.reshape(len(halves), -1, chains.shape[-1]))


def _r_hat(halves: Array) -> Array:
    """Return R-hat of half chains (half, draw, parameter), shape (parameter,).

    sqrt(((n - 1) W / n + V) / W), W the mean variance inside the half chains of n draws and V the
    variance of their means.
    """
    count, within_variance = halves.shape[1], halves.var(axis=1, ddof=1).mean(axis=0)
    between_variance = halves.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt((count - 1) / count + between_variance / within_variance)
    return np.where(within_variance > 0, ratio, np.where(between_variance > 0, np.inf, 1.0))


def autocorrelation_time(chain: Array, window: float = 5.0) -> Array:
    """Return the integrated autocorrelation time of each parameter, steps, from chains (step,
    walker, parameter).

    Notes
    -----
    tau = 1 + 2 sum rho(t) up to the first t > `window` tau; rho is the walkers' mean autocovariance
    over their mean variance, both about the mean of all walkers: about each one's own mean, walkers
    that never leave their own peak would look healthy. A parameter that never moves has an infinite
    tau.
    """
    steps = len(chain)
    padded = 2 ** int(np.ceil(np.log2(2 * steps)))
    # (walker, parameter, step)
    lines = np.ascontiguousarray(np.moveaxis(chain - chain.mean(axis=(0, 1)), 0, -1))
    power = (np.abs(np.fft.rfft(lines, n=padded)) ** 2).mean(axis=0)
    covariance = np.fft.irfft(power, n=padded)[:, :steps]
    moving = np.ptp(chain, axis=0).any(axis=0)
    correlation = covariance / np.where(moving, covariance[:, 0], 1.0)[:, None]
    times = 2.0 * np.cumsum(correlation, axis=1) - 1.0
    exceeds_window = np.arange(steps) >= window * times
    last = np.where(exceeds_window.any(axis=1), np.argmax(exceeds_window, axis=1), steps - 1)
    return np.where(moving, np.maximum(times[np.arange(len(times)), last], 1.0), np.inf)


def mixes_well(acceptance: Array, local_acceptance: float) -> bool:
    """Tell whether walkers move as they should.

    Parameters
    ----------
    acceptance
        Share of the steps in which each walker moved, shape (walker,).
    local_acceptance
        Share of the local proposals taken; where nearly all are, their steps are small compared
        with the posterior.

    Notes
    -----
    At least a tenth of all steps and at most four fifths of the local ones are taken, and no walker
    is stuck, moving a twentieth as often as the median one or less.
    """
    stuck = acceptance.min() <= STUCK_SHARE * np.median(acceptance)
    return bool(
        acceptance.mean() >= LEAST_ACCEPTANCE
        and local_acceptance <= LARGEST_ACCEPTANCE
        and not stuck
    )


def crowds_at_bound(draws: Array, walls: Array) -> NDArray[np.bool_]:
    """Tell which parameters crowd at a wall: many more draws than a uniform density would put
    there.

    Parameters
    ----------
    draws
        Shape (draw, parameter).
    walls
        Lower and upper bounds, shape (parameter, 2), infinite where there are none.
    """
    leaning, ordered = np.zeros(draws.shape[1], bool), np.sort(draws, axis=0)
    for wall, far_quantile in ((walls[:, 0], 0.995), (walls[:, 1], 0.005)):
        span = np.abs(ordered[round(far_quantile * (len(draws) - 1))] - wall)
        with np.errstate(invalid="ignore"):
            is_in_strip = np.abs(draws - wall) <= WALL_STRIP * span
        leaning |= np.isfinite(wall) & (is_in_strip.mean(axis=0) > WALL_CROWD * WALL_STRIP)
    return leaning


# Cells of the histogram in which peaks are looked for.
CELLS = 256


def has_several_peaks(draws: Array) -> bool:
    """Tell whether any parameter, or any principal direction of the draws, has a second peak."""
    spread = draws.std(axis=0)
    scaled = (draws - draws.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    if scaled.shape[1] > 1:
        _, _, directions = np.linalg.svd(scaled, full_matrices=False)
        scaled = np.concatenate([scaled, scaled @ directions.T], axis=1)
    return any(_two_peaked(line) for line in scaled.T)


def _two_peaked(line: Array) -> bool:
    """Tell whether the smoothed histogram of draws has a valley between two peaks worth the
    name.
    """
    count = len(line)
    width = 1.5 * 0.9 * line.std() * count**-0.2
    # Draws so small that their squares vanish have no width either.
    if width <= 0 or count < 100:
        return False
    low, high = line.min() - 3 * width, line.max() + 3 * width
    step = (high - low) / CELLS
    hist = np.bincount(((line - low) / step).astype(np.int64), minlength=CELLS)
    kernel = np.exp(-0.5 * ((np.arange(CELLS) - CELLS // 2) * step / width) ** 2)
    density = np.convolve(hist, kernel / kernel.sum(), "same")
    inner = density[1:-1]
    peaks = 1 + np.flatnonzero((inner >= density[:-2]) & (inner > density[2:]))
    return any(
        _separate(density, hist, int(a), int(b))
        for i, a in enumerate(peaks)
        for b in peaks[i + 1 :]
    )


def _separate(density: NDArray, hist: NDArray, first: int, second: int) -> bool:
    """Tell whether a deep enough valley parts two peaks that both hold draws."""
    valley = first + int(np.argmin(density[first : second + 1]))
    mass = hist[:valley].sum() / hist.sum()
    deep = density[valley] < VALLEY_DEPTH * min(density[first], density[second])
    return bool(deep and min(mass, 1.0 - mass) > PEAK_SHARE)


@dataclass(frozen=True, kw_only=True)
class PredictiveCheck:
    """Posterior predictive p-values of three discrepancies, uniform between 0 and 1 under the
    model.

    Parameters
    ----------
    chi_squared
        p-value of the sum of squares: excess noise, or any misfit.
    runs
        p-value of the number of runs of one sign: a wrong mean.
    neighbours
        p-value of the correlation of neighbouring residuals, over lags up to the root of their
        number: a wrong mean.
    level
        Probability of rejecting a correct model.
    """

    chi_squared: float
    runs: float
    neighbours: float
    level: float = MISFIT_LEVEL

    @property
    def probability(self) -> float:
        """Smallest p-value, corrected for three tests (Bonferroni)."""
        return min(1.0, 3.0 * min(self.chi_squared, self.runs, self.neighbours))

    @property
    def flags(self) -> tuple[str, ...]:
        """`model-misfit` where the model is rejected."""
        return ("model-misfit",) if self.probability < self.level else ()


def predictive_check(
    data: ArrayLike,
    predictions: ArrayLike,
    noise: ArrayLike,
    *,
    rng: np.random.Generator,
    replicates: int = 2000,
    level: float = MISFIT_LEVEL,
) -> PredictiveCheck:
    """Compare the residuals of data with those of data replicated from the posterior.

    Parameters
    ----------
    data
        Measured data in their natural order, shape (datum,).
    predictions
        Predicted mean of the data at each posterior draw, shape (draw, datum).
    noise
        Standard deviation of the noise, shape (datum,), or its covariance, shape (datum, datum).
    rng
        Generator of the replicates.
    replicates
        Number of replicated data sets, which limits the resolution of the p-values.
    level
        Probability of rejecting a correct model.

    Raises
    ------
    BadInput
        If the shapes do not fit, a number is not finite, or the noise is no covariance.

    Notes
    -----
    Whitened residuals at the posterior's mean prediction, z = L^-1 (y - m), have covariance 1 - H
    under the model, with H the posterior covariance of L^-1 times the prediction: exact for
    Gaussian noise and a mean linear in the parameters with a Gaussian prior, where H is the hat
    matrix. Replicates are drawn from that distribution, so that the data are not used twice, which
    would bias the p-values towards 1/2 (Meng 1994, doi 10.1214/aos/1176325622).
    """
    measured, mean = np.asarray(data, float), np.asarray(predictions, float)
    if (
        measured.ndim != 1
        or mean.ndim != 2
        or mean.shape[1] != measured.size
        or len(mean) < 2
        or measured.size < 4
    ):
        raise BadInput(
            f"predictions must be (draw, datum) for 4 data or more, got {mean.shape} and "
            f"{measured.shape}"
        )
    if not (np.isfinite(measured).all() and np.isfinite(mean).all()):
        raise BadInput("data and predictions must be finite")
    whiten = _whitener(np.asarray(noise, float), measured.size)
    spread = whiten((mean - mean.mean(axis=0)).T).T / np.sqrt(len(mean) - 1)
    residual = whiten((measured - mean.mean(axis=0))[:, None])[:, 0]
    ours = _discrepancies(residual[None])
    blocks = np.array_split(np.arange(replicates), -(-replicates * measured.size // (1 << 20)))
    theirs = [
        _discrepancies(_shrink_by_fit(rng.standard_normal((len(block), measured.size)), spread))
        for block in blocks
    ]
    odd = [
        _tail(observed[0], replicated, rng)
        for observed, replicated in zip(ours, np.concatenate(theirs, axis=1), strict=True)
    ]
    return PredictiveCheck(chi_squared=odd[0], runs=odd[1], neighbours=odd[2], level=level)


def _whitener(noise: Array, size: int) -> Callable[[Array], Array]:
    """Return the map that makes noise white and of unit variance, along the first axis."""
    if noise.shape == (size,):
        if not (np.isfinite(noise).all() and (noise > 0).all()):
            raise BadInput("the noise's standard deviations must be positive")
        return lambda columns: columns / noise[:, None]
    if noise.shape != (size, size):
        raise BadInput(f"the noise must be ({size},) or ({size}, {size}), got {noise.shape}")
    try:
        root = np.linalg.cholesky(noise)
    except np.linalg.LinAlgError as error:
        raise BadInput("the noise's covariance must be positive definite") from error
    return lambda columns: np.asarray(np.linalg.solve(root, columns), np.float64)


def _shrink_by_fit(white: Array, spread: Array) -> Array:
    """Return white noise (replicate, datum) after a fit: each direction has variance 1 - H.

    A direction that the noise alone determines has H = 1 at most; excess scatter of the draws is
    clipped.
    """
    _, values, directions = np.linalg.svd(spread, full_matrices=False)
    remaining = np.sqrt(np.clip(1.0 - values**2, 0.0, 1.0))
    return white - ((white @ directions.T) * (1.0 - remaining)) @ directions


def _discrepancies(residual: Array) -> Array:
    """Return the three discrepancies of white residuals (data set, datum), shape (discrepancy, data
    set).
    """
    squares = np.sum(residual**2, axis=1)
    runs = np.sum(np.diff(residual > 0, axis=1), axis=1).astype(float)
    # Autocorrelations up to the root of the number of data, weighted by 1 - lag/(last + 1).
    last = max(1, round(np.sqrt(residual.shape[1])))
    products = [
        np.einsum("rn,rn->r", residual[:, lag:], residual[:, :-lag]) for lag in range(1, last + 1)
    ]
    weights = 1.0 - np.arange(1, last + 1) / (last + 1)
    return np.array([squares, -runs, weights @ np.array(products) / squares])


def _tail(ours: float, theirs: Array, rng: np.random.Generator) -> float:
    """Return the probability of a sign as large, ties broken at random, so that it is uniform under
    the model.
    """
    larger, level = np.sum(theirs > ours), np.sum(theirs == ours)
    return float((larger + rng.uniform() * (level + 1)) / (len(theirs) + 1))
