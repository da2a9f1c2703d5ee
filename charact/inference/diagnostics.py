"""The signs by which draws are distrusted: slow mixing, ensembles that disagree, walls and several
peaks.

Sources: autocorrelation time averaged over walkers, Goodman & Weare 2010 and Foreman-Mackey et al.
2013 (doi 10.1086/670067); split R-hat, Gelman et al., Bayesian Data Analysis, 3rd edition, section
11.4.
"""

import numpy as np
from numpy.typing import NDArray

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


def split_r_hat(chain: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return split R-hat of chains (step, chain, parameter): halves of each must agree, shape
    (parameter,).

    Notes
    -----
    sqrt(((n - 1) W / n + V) / W), W the mean variance inside the half chains and V the variance of
    their means.
    """
    half = len(chain) // 2
    halves = np.concatenate([chain[:half], chain[half : 2 * half]], axis=1)
    within_variance = halves.var(axis=0, ddof=1).mean(axis=0)
    between_variance = halves.mean(axis=0).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt((half - 1) / half + between_variance / within_variance)
    return np.where(within_variance > 0, ratio, np.where(between_variance > 0, np.inf, 1.0))


def ensemble_r_hat(chains: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return split R-hat between ensembles (ensemble, step, walker, parameter), each pooled over
    its walkers.
    """
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, half : 2 * half]])
    pooled = halves.reshape(len(halves), -1, chains.shape[-1])
    return split_r_hat_of_pooled(pooled)


def split_r_hat_of_pooled(pooled: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R-hat of pooled half chains (half, draw, parameter)."""
    within_variance = pooled.var(axis=1, ddof=1).mean(axis=0)
    between_variance = pooled.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(1.0 + between_variance / within_variance)
    return np.where(within_variance > 0, ratio, np.where(between_variance > 0, np.inf, 1.0))


def autocorrelation_time(chain: NDArray[np.float64], window: float = 5.0) -> NDArray[np.float64]:
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


def mixes_well(acceptance: NDArray[np.float64], local_acceptance: float) -> bool:
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


def crowds_at_bound(draws: NDArray[np.float64], walls: NDArray[np.float64]) -> NDArray[np.bool_]:
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


def has_several_peaks(draws: NDArray[np.float64]) -> bool:
    """Tell whether any parameter, or any principal direction of the draws, has a second peak."""
    spread = draws.std(axis=0)
    scaled = (draws - draws.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    if scaled.shape[1] > 1:
        _, _, directions = np.linalg.svd(scaled, full_matrices=False)
        scaled = np.concatenate([scaled, scaled @ directions.T], axis=1)
    return any(_two_peaked(line) for line in scaled.T)


def _two_peaked(line: NDArray[np.float64]) -> bool:
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
