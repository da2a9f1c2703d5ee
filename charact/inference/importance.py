"""Draws of a posterior picked by their weight from a mixture that grows where it is too thin, or by
MCMC where that is too few.

For posteriors of few parameters and curved ridges, along which a chain is slow and of which one
covariance knows the middle only.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.inference.chain import sample
from charact.inference.diagnostics import crowds_at_bound, has_several_peaks
from charact.inference.laplace_approximation import (
    Vectorised,
    bounds_of,
    covariance_root,
    draw_truncated_gaussian,
)
from charact.inference.probit_transform import ProbitTransform
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Draws from the first density and from each one added, and how many are added at most.
FIRST_DRAWS, MORE_DRAWS, MOST_ADDED = 4000, 1000, 80
# Effective draws at which the mixture fits: stopped at a thousand, tails not met yet leave 95 %
# intervals that hold 93.
ENOUGH = 3000.0
# Draws whose weighted spread shapes a density that is added, and freedom of each density's Student
# t.
NEAREST = 500
FREEDOM = 6.0
# Requested effective sample size: 95 % intervals of a hundred edges are within 0.5 % of those at
# nine thousand. Below the second number the posterior is not determined.
WANTED, LEAST_EFFECTIVE = 2000.0, 1000.0
# The first density is wider than the curvature says, in variance.
WIDER = 2.0


def importance_sample(
    log_probability: Vectorised,
    *,
    names: tuple[str, ...],
    units: tuple[str, ...],
    start: ArrayLike,
    covariance: ArrayLike,
    seed: int,
    bounds: ArrayLike,
    draws: int = 1000,
    enough: float = ENOUGH,
    first_draws: int = FIRST_DRAWS,
    max_added: int | None = None,
) -> Posterior:
    """Draw from a posterior by importance, from a mixture of densities that is made to fit it.

    Parameters
    ----------
    log_probability
        Vectorised: points (n, parameter) -> (n,), -inf outside the bounds, never NaN.
    names, units
        Name and unit of each parameter.
    start, covariance
        The peak, shape (parameter,), and covariance there, shape (parameter, parameter).
    seed
        Seed of every draw.
    bounds
        Shape (parameter, 2), infinite where there is none.
    draws
        Number of draws picked.
    enough
        Effective number of weighted draws, 1/sum w^2, after which no density is added.
    first_draws
        Draws from the density that the curvature tells.
    max_added
        Densities that are added at most; None: `MOST_ADDED`.

    Returns
    -------
    Posterior
        Its effective sample size says how far it may be trusted: the mixture stops growing after
        `max_added`.

    Notes
    -----
    Incremental mixture importance sampling (Raftery & Bao 2010, doi
    10.1111/j.1541-0420.2010.01399.x): a density is added at the draw of the largest weight, shaped
    after the weighted draws nearest to it; each draw counts as one from the whole mixture. Works in
    coordinates without walls.
    """
    walls = bounds_of(bounds, len(names))
    space, rng = ProbitTransform(walls), np.random.default_rng(seed)
    cloud = space.outside(
        draw_truncated_gaussian(
            rng, np.asarray(start, float), np.asarray(covariance, float), walls, 2000
        )
    )
    first = _StudentT(cloud.mean(axis=0), WIDER * np.atleast_2d(np.cov(cloud.T)))
    mixture, points = [(first, first_draws)], first.draw(rng, first_draws)
    heights = _heights(log_probability, space, points)
    # How densely all that was drawn lies at each point: densities add up, so that old points need
    # the new one only.
    drawn, unit = _log_density_of_draws(mixture, points), points @ first.inverse.T
    while True:
        weight = _weights(heights - drawn)
        effective = 1.0 / float(np.sum(weight**2))
        limit = MOST_ADDED if max_added is None else max_added
        if effective >= enough or len(mixture) > limit:
            break
        more = _add_component(points, unit, weight), MORE_DRAWS
        # A posterior that no draw comes near, as of a model far from its data: one draw holds all
        # weight, and what is added shrinks to nothing about it.
        if not np.isfinite(more[0].log_volume):
            break
        mixture, fresh = [*mixture, more], more[0].draw(rng, MORE_DRAWS)
        heights = np.concatenate([heights, _heights(log_probability, space, fresh)])
        drawn = np.concatenate(
            [
                np.logaddexp(drawn, _log_density_of_draws([more], points)),
                _log_density_of_draws(mixture, fresh),
            ]
        )
        points, unit = (
            np.concatenate([points, fresh]),
            np.concatenate([unit, fresh @ first.inverse.T]),
        )
    picked = space.inside(points[_pick_draws(rng, weight, draws)])
    return Posterior(
        names=names,
        units=units,
        draws=picked,
        effective_sample_size=np.full(len(names), effective),
        sampler="importance",
        seed=seed,
        flags=("prior-bound",) if crowds_at_bound(picked, walls).any() else (),
    )


class _StudentT:
    """A Student t density about a place."""

    def __init__(self, centre: Array, covariance: Array) -> None:
        self.centre, self.root = (
            centre,
            covariance_root(covariance + 1e-9 * np.diag(np.diag(covariance))),
        )
        self.inverse = np.linalg.pinv(self.root)
        self.log_volume = float(np.linalg.slogdet(self.root)[1])

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Return draws, shape (count, parameter)."""
        stretch = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, count))
        return (
            self.centre
            + (rng.standard_normal((count, self.centre.size)) * stretch[:, None]) @ self.root.T
        )

    def log_density(self, points: Array) -> Array:
        """Return ln of the density at points up to a constant that all share, shape (point,)."""
        offset = points @ self.inverse.T
        offset -= self.inverse @ self.centre
        squares = np.einsum("ij,ij->i", offset, offset)
        return -0.5 * (FREEDOM + self.centre.size) * np.log1p(squares / FREEDOM) - self.log_volume


def _add_component(points: Array, unit: Array, weight: Array) -> _StudentT:
    """Return the density of the draws nearest to the one that weighs most, in units of the first
    density.
    """
    heaviest = int(np.argmax(weight))
    centre, offset = points[heaviest], unit - unit[heaviest]
    offset = np.einsum("ij,ij->i", offset, offset)
    nearest = np.argpartition(offset, min(NEAREST, offset.size) - 1)[:NEAREST]
    component_weight = 0.5 * (weight[nearest] + 1.0 / len(points))
    off = points[nearest] - centre
    return _StudentT(centre, (off * (component_weight / component_weight.sum())[:, None]).T @ off)


def _log_density_of_draws(mixture: list[tuple[_StudentT, int]], points: Array) -> Array:
    """Return ln of how densely the draws from some densities lie at points, shape (point,)."""
    return np.logaddexp.reduce(
        [np.log(count) + density.log_density(points) for density, count in mixture], axis=0
    )


def _heights(log_probability: Vectorised, space: ProbitTransform, points: Array) -> Array:
    return log_probability(space.inside(points)) + space.log_volume(points)


def _pick_draws(rng: np.random.Generator, weight: Array, count: int) -> NDArray[np.int64]:
    """Return which draws are picked, each as often as its weight says but for one, in random
    order.
    """
    steps = (np.arange(count) + rng.random()) / count
    return rng.permutation(np.minimum(np.searchsorted(np.cumsum(weight), steps), len(weight) - 1))


def _weights(log_weight: Array) -> Array:
    weight = np.exp(log_weight - log_weight.max())
    return weight / weight.sum()


def sample_posterior(
    log_probability: Vectorised,
    *,
    names: tuple[str, ...],
    units: tuple[str, ...],
    start: ArrayLike,
    covariance: ArrayLike,
    seed: int,
    bounds: ArrayLike,
    draws: int = 1000,
    max_steps: int = 20000,
    effort: float = 1.0,
) -> Posterior:
    """Draw from a posterior of one mode, or of several close ones, by importance sampling where
    sufficient.

    Parameters
    ----------
    log_probability, names, units, start, covariance, seed, bounds, draws
        As of `importance_sample`.
    max_steps
        Maximum number of steps of each ensemble of the Markov chain.
    effort
        Fraction of the first draws and of the requested effective sample size: low for models of
        small weight.

    Returns
    -------
    Posterior
        Its sampler is recorded; `several-modes` if its draws have several modes.

    Notes
    -----
    Importance sampling finds the modes near the first one. Distant modes are found only by the
    optimisations of a Markov chain.
    """
    asked = {
        "names": names,
        "units": units,
        "start": start,
        "covariance": covariance,
        "seed": seed,
        "bounds": bounds,
        "draws": draws,
    }
    posterior = importance_sample(
        log_probability, **asked, enough=WANTED * effort, first_draws=round(FIRST_DRAWS * effort)
    )
    if posterior.effective_sample_size.min() < LEAST_EFFECTIVE * effort:
        return sample(log_probability, **asked, max_steps=max_steps)
    return (
        replace(posterior, flags=(*posterior.flags, "several-modes"))
        if has_several_peaks(posterior.draws)
        else posterior
    )
