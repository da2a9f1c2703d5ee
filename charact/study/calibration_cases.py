"""Calibration of the posterior engine on an edge profile: parameters that are correlated, bounded and not linear."""

import numpy as np
from numpy.typing import NDArray

from charact.posterior import maximum, sample
from charact.study.calibration import Calibration, calibrate
from charact.study.harness import Progress
from labdata.measurement import Posterior

Array = NDArray[np.float64]

NAMES = ("dark", "step", "centre", "width", "tail")
UNITS = ("DN", "DN", "px", "px", "1")
# The prior is uniform between these: the last two are often poorly told and lean on them.
BOUNDS = np.array([[15.0, 25.0], [20.0, 60.0], [-1.0, 1.0], [0.3, 3.0], [0.0, 0.5]])
DISTANCE = np.linspace(-10.0, 10.0, 80)
NOISE_DN = 2.0
TAIL_PX = 4.0


def edge_mean(points: Array) -> Array:
    """Return profiles, shape (point, distance): a step blurred by a logistic spread, a share of it more widely.

    dark + step ((1 - tail) S((x - centre) / width) + tail S((x - centre) / 4 px)), S(u) = 1 / (1 + exp(-u)).
    """
    dark, step, centre, width, tail = np.moveaxis(np.atleast_2d(points)[..., None], 1, 0)
    offset = DISTANCE - centre
    return dark + step * ((1.0 - tail) * _logistic(offset / width) + tail * _logistic(offset / TAIL_PX))


def _logistic(u: Array) -> Array:
    return 0.5 * (1.0 + np.tanh(0.5 * u))


def edge_posterior(data: Array, seed: int) -> Posterior:
    """Return the posterior of a profile, started from its peak as the edge methods do."""

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= BOUNDS[:, 0]) & (points <= BOUNDS[:, 1]), axis=1)
        mean = edge_mean(np.where(inside[:, None], points, BOUNDS.mean(axis=1)))
        return np.where(inside, -0.5 * np.sum(((data - mean) / NOISE_DN) ** 2, axis=1), -np.inf)

    grid = np.random.default_rng(seed).uniform(BOUNDS[:, 0], BOUNDS[:, 1], (400, len(NAMES)))
    start, covariance = maximum(log_probability, grid[np.argmax(log_probability(grid))], BOUNDS)
    return sample(
        log_probability,
        names=NAMES,
        units=UNITS,
        start=start,
        covariance=covariance,
        seed=seed,
        bounds=BOUNDS,
        draws=1000,
    )


def edge_calibration(trials: int, seed: int, progress: Progress = lambda text, share: None) -> Calibration:
    """Rank the truths of profiles whose parameters are drawn from the prior.

    `prior-bound` and `several-modes` describe what a right posterior looks like and leave nobody out; a chain that
    did not converge does.
    """

    def posterior(data: Array, seed: int) -> Posterior | Array:
        found = edge_posterior(data, seed)
        return found if "not-converged" in found.flags else found.draws

    return calibrate(
        lambda rng: rng.uniform(BOUNDS[:, 0], BOUNDS[:, 1]),
        lambda truth, rng: edge_mean(truth)[0] + NOISE_DN * rng.standard_normal(len(DISTANCE)),
        posterior,
        names=NAMES,
        trials=trials,
        seed=seed,
        progress=progress,
    )
