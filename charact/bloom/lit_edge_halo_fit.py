"""The halo beside a lit edge: the disc's chords summed up, fitted to strips of all levels together.

A half plane of light lays its halo over the dark side up to half the halo's diameter from the edge. By the slice
theorem the halo's profile across a line is the one-dimensional transform of its radial one: a disc of electrons that
keep their energy becomes a box as wide as the disc, so that the halo beside the edge is a straight ramp that ends in a
kink.
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from charact.bloom import transfer
from charact.bloom.lit_edge_profile import Strips

Array = NDArray[np.float64]

NAMES = ("halo_diameter", "elastic_share", "halo_fraction", "edge_offset", "core_spread")
UNITS = ("px", "1", "1", "px", "px2")
GAUSSIAN = len(NAMES)
LEAST_DIAMETER_PX = 12.0
MOST_FRACTION = 0.6
# Beyond 0..1 by a little: a wall at 0 would push the diameter of a halo without rim to one side.
ELASTIC_SHARE = (-0.15, 1.15)
SPREAD_PX2 = (0.05, 25.0)
# Share of the light over the background by which a model of straight edges may be off in a strip.
MODEL_SHARE = 0.004
# Frequencies: enough for 160 px from the edge.
HIGHEST_CY_PER_PX, NODES = 0.75, 280
# Starts that are followed to their peak.
CLIMBS = 2
Core = Literal["gaussian", "tube", "moffat"]
# What a core has besides its Gaussian: name, unit, bounds, first guess, and mean and standard deviation of a prior.
# Image tubes at large; a Moffat wing whose light is spread as (1 + r^2/a^2)^-b.
BESIDES: dict[Core, tuple[tuple[str, str, tuple[float, float], float, tuple[float, float] | None], ...]] = {
    "gaussian": (),
    "tube": (
        ("core_frequency", "cy/px", (0.03, 2.0), 0.4, (0.4, 0.3)),
        ("core_exponent", "1", (0.7, 2.5), 1.3, (1.3, 0.3)),
    ),
    "moffat": (
        ("wing_share", "1", (0.0, 0.7), 0.1, None),
        ("wing_radius", "px", (0.7, 12.0), 3.0, None),
        ("wing_exponent", "1", (1.2, 4.0), 2.0, None),
    ),
}


@cache
def nodes() -> tuple[Array, Array]:
    """Frequencies, cy/px, of the integral over a transfer, and their weights (Gauss and Legendre)."""
    node, weight = np.polynomial.legendre.leggauss(NODES)
    return 0.5 * HIGHEST_CY_PER_PX * (node + 1.0), 0.5 * HIGHEST_CY_PER_PX * weight


@dataclass(frozen=True, kw_only=True)
class EdgeHaloLikelihood:
    """Strips of all levels of one edge, whitened, with the transforms onto them.

    Parameters
    ----------
    strips
        Levels.
    width_px
        Width of the lit area, column pitches; inf for a half plane.
    walls
        Bounds of the parameters that every core has, shape (parameter, 2).
    white
        For each level the matrix that whitens its used strips.
    waves
        For each level sine and cosine of every frequency at its strips, shape (frequency, strip).
    core
        Family of the core.
    halo
        Whether there is a halo.
    """

    strips: tuple[Strips, ...]
    width_px: float
    walls: Array
    white: tuple[Array, ...]
    waves: tuple[tuple[Array, Array], ...]
    core: Core = "gaussian"
    halo: bool = True

    @property
    def bounds(self) -> Array:
        """Of the parameters, shape (parameter, 2)."""
        return np.array([*self.walls, *(bounds for _, _, bounds, _, _ in BESIDES[self.core])])

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return (*NAMES, *(name for name, *_ in BESIDES[self.core]))

    @property
    def units(self) -> tuple[str, ...]:
        """Of the parameters."""
        return (*UNITS, *(unit for _, unit, *_ in BESIDES[self.core]))

    def log_probability(self, points: Array) -> Array:
        """Log of the posterior with light and background of every level at their best, shape (point,)."""
        inside = np.all((points >= self.bounds[:, 0]) & (points <= self.bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, self.bounds.mean(axis=1))
        total = -0.5 * (self._prior_residuals(safe) ** 2).sum(axis=1)
        for one, strips in enumerate(self.strips):
            chi2, amplitudes = self.fitted(one, safe)
            total = total - 0.5 * (chi2 + self._short(strips, amplitudes) ** 2)
        return np.where(inside, total, -np.inf)

    def residuals(self, points: Array) -> Array:
        """What is left over, in standard errors, that of the prior at the end, shape (point, number)."""
        out = [self._prior_residuals(points)]
        for one, strips in enumerate(self.strips):
            _, amplitudes = self.fitted(one, points)
            model = amplitudes[:, :1] * self.shape(one, points)[:, strips.used] + amplitudes[:, 1:]
            out += [(strips.mean_dn[strips.used] - model) @ self.white[one].T, self._short(strips, amplitudes)[:, None]]
        return np.concatenate(out, axis=1)

    def _short(self, strips: Strips, amplitudes: Array) -> Array:
        """A lit side that is cut is at least as bright as the highest code: by how much it is not."""
        short = np.maximum(strips.least_light_dn - amplitudes[:, 0], 0.0)
        return short / max(0.03 * strips.least_light_dn, 1e-9)

    def _prior_residuals(self, points: Array) -> Array:
        known = [(place, *prior) for place, (*_, prior) in enumerate(BESIDES[self.core], GAUSSIAN) if prior]
        return np.array([(points[:, place] - mean) / sd for place, mean, sd in known]).reshape(-1, len(points)).T

    def fitted(self, one: int, points: Array) -> tuple[Array, Array]:
        """Chi squared of one level at some points, shape (point,), and its light and background, (point, 2)."""
        strips = self.strips[one]
        shape = self.shape(one, points)[:, strips.used]
        data = self.white[one] @ strips.mean_dn[strips.used]
        light = shape @ self.white[one].T
        flat = self.white[one].sum(axis=1)
        aa, ab, bb = (light**2).sum(axis=1), light @ flat, float(flat @ flat)
        ad, bd = light @ data, float(flat @ data)
        determinant = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb)
        level, ground = (bb * ad - ab * bd) / determinant, (aa * bd - ab * ad) / determinant
        chi2 = float(data @ data) - level * ad - ground * bd
        return chi2, np.stack([level, ground], axis=1)

    def shape(self, one: int, points: Array) -> Array:
        """Light across an edge of unit brightness, shape (point, strip)."""
        diameter, elastic, fraction, offset, _ = points[:, :GAUSSIAN].T
        frequency = nodes()[0]
        blur = self._core(points) * np.sinc(frequency)
        if self.halo:
            halo = transfer.disc(frequency, diameter, transfer.backscatter_profile(elastic))
            blur = blur * (1.0 - fraction[:, None] + fraction[:, None] * halo)
        near = self._step(one, blur, offset)
        if not np.isfinite(self.width_px):
            return near
        return near - self._step(one, blur, -self.width_px - offset)

    def _core(self, points: Array) -> Array:
        """Transfer of the core, shape (point, frequency)."""
        frequency, spread = nodes()[0], points[:, GAUSSIAN - 1]
        core = transfer.gaussian(frequency, spread)
        if self.core == "tube":
            return core * transfer.tube(frequency, *points[:, GAUSSIAN:].T)
        if self.core == "gaussian":
            return core
        share, radius, power = points[:, GAUSSIAN:].T
        return core * (1.0 - share[:, None]) + share[:, None] * transfer.moffat(frequency, radius, power)

    def _step(self, one: int, blur: Array, at: Array) -> Array:
        """A step at some places seen through a transfer: 1/2 - integral of T sin(2 pi f (x - x0)) / pi f."""
        sine, cosine = self.waves[one]
        frequency, weight = nodes()
        turn = 2.0 * np.pi * frequency * at[:, None]
        return 0.5 - (blur * weight * np.cos(turn) / (np.pi * frequency)) @ sine + (
            blur * weight * np.sin(turn) / (np.pi * frequency)
        ) @ cosine  # fmt: skip


def problem_of(
    strips: tuple[Strips, ...], *, width_px: float, room_px: float, offset_px: tuple[float, float]
) -> EdgeHaloLikelihood:
    """Whiten strips and set the bounds; the problem is that of a Gaussian core and a halo."""
    white, waves = [], []
    for one in strips:
        above = one.mean_dn[one.used] - np.median(one.mean_dn[one.used][-8:])
        covariance = one.covariance() + np.diag((MODEL_SHARE * above) ** 2)
        white.append(np.linalg.inv(np.linalg.cholesky(covariance)))
        turn = 2.0 * np.pi * np.outer(nodes()[0], one.distance_px)
        waves.append((np.sin(turn), np.cos(turn)))
    widest = max(2.0 * room_px, LEAST_DIAMETER_PX + 4.0)
    walls = [[LEAST_DIAMETER_PX, widest], ELASTIC_SHARE, [0.0, MOST_FRACTION], offset_px, SPREAD_PX2]
    return EdgeHaloLikelihood(
        strips=strips, width_px=width_px, walls=np.array(walls), white=tuple(white), waves=tuple(waves)
    )


@dataclass(frozen=True, kw_only=True)
class EdgeHaloOptimum:
    """The best fit: its point, (parameter,), its covariance, (parameter, parameter), and ln of its probability."""

    point: Array
    covariance: Array
    log_probability: float


def optimise_edge_halo(problem: EdgeHaloLikelihood, *, diameter_px: float | None = None) -> EdgeHaloOptimum:
    """Return the best fit, from several diameters, for the end of a disc makes many small peaks.

    `diameter_px` holds the diameter there.
    """
    low, high = problem.bounds[0]
    offset = 0.5 * problem.bounds[3].sum()
    diameters = np.linspace(low + 2, high - 2, 24) if problem.halo else np.array([0.5 * (low + high)])
    if diameter_px is not None:
        diameters = np.array([diameter_px])
    starts = np.array([[d, w, 0.1, offset, s] for d in diameters for w in (0.3, 0.8) for s in (1.0, 3.0)])
    besides = [first for *_, first, _ in BESIDES[problem.core]]
    points = np.concatenate([starts, np.tile(besides, (len(starts), 1))], axis=1)
    order = np.argsort(problem.log_probability(points))[::-1]
    free = np.ones(points.shape[1], bool)
    free[0] = problem.halo and diameter_px is None
    free[1:3] = problem.halo
    return max(
        (_optimise_from(problem, points[one], free) for one in order[:CLIMBS]), key=lambda peak: peak.log_probability
    )


def _optimise_from(problem: EdgeHaloLikelihood, start: Array, free: NDArray[np.bool_]) -> EdgeHaloOptimum:
    """Climb by least squares in the parameters that are free; the covariance is that of the slopes."""
    from scipy.optimize import least_squares

    def all_parameters(points: Array) -> Array:
        out = np.broadcast_to(start, (len(points), len(start))).copy()
        out[:, free] = points
        return out

    low, high = problem.bounds[free].T
    step = 1e-4 * (high - low)

    def slopes(point: Array) -> Array:
        # Inside the walls on either side.
        sign = np.where(point + step > high, -1.0, 1.0)
        left = problem.residuals(all_parameters(np.concatenate([point[None], point + np.diag(sign * step)])))
        return ((left[1:] - left[0]) / (sign * step)[:, None]).T

    first = np.clip(start[free], low + step, high - step)
    found = least_squares(lambda point: problem.residuals(all_parameters(point[None]))[0], first, jac=slopes,  # pyright: ignore[reportArgumentType]
                          bounds=(low, high), x_scale=high - low, max_nfev=40)  # fmt: skip
    point = all_parameters(found.x[None])[0]
    covariance = np.zeros((len(start), len(start)))
    covariance[np.ix_(free, free)] = np.linalg.pinv(found.jac.T @ found.jac + np.diag(((high - low) / 2.0) ** -2.0))
    return EdgeHaloOptimum(
        point=point, covariance=covariance, log_probability=float(problem.log_probability(point[None])[0])
    )
