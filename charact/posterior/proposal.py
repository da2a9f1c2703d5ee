"""The moves of the ensembles: differential evolution, its snooker, and an independent proposal with heavy tails."""

import numpy as np
from numpy.typing import NDArray

from charact.posterior.curvature import root_of

STUDENT_T_FREEDOM = 5.0


def mixed_moves(places: NDArray, covariance: NDArray) -> list:
    """Return the moves with their weights."""
    from emcee import moves

    proposal = StudentT(places, covariance)
    return [
        (moves.DEMove(), 0.25),
        (moves.DESnookerMove(), 0.05),
        (moves.MHMove(proposal, ndim=places.shape[1]), 0.7),
    ]


class StudentT:
    """Independence proposal: a mixture of Student t densities of the covariance, one at each place."""

    def __init__(self, places: NDArray, covariance: NDArray) -> None:
        self._places = places
        self._root = root_of(covariance)
        self._inverse = np.linalg.pinv(self._root)

    def __call__(self, coords: NDArray, rng: np.random.RandomState) -> tuple[NDArray, NDArray]:
        """Return new points and the log-ratio of the proposal's densities, old over new."""
        normal = rng.standard_normal(coords.shape)
        stretch = np.sqrt(STUDENT_T_FREEDOM / rng.chisquare(STUDENT_T_FREEDOM, len(coords)))
        centre = self._places[rng.randint(len(self._places), size=len(coords))]
        fresh = centre + (normal * stretch[:, None]) @ self._root.T
        return fresh, self._log_density(coords) - self._log_density(fresh)

    def _log_density(self, points: NDArray) -> NDArray:
        z = (points[:, None, :] - self._places) @ self._inverse.T
        exponent = -0.5 * (STUDENT_T_FREEDOM + points.shape[1])
        return np.logaddexp.reduce(exponent * np.log1p((z**2).sum(-1) / STUDENT_T_FREEDOM), axis=1)
