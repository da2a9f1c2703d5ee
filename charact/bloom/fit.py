"""The joint fit of all profiles of a point series: one halo and one core for all, amplitudes for each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.model import NAMES, UNITS, Optics, optics_of, shapes
from charact.bloom.profile import Profile
from charact.method import Context
from charact.posterior import laplace, maximum, sample
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Flat priors of diameter (px, up to 0.85 of the profile's width), elastic share and spread; normal ones of the core's
# cut-off and exponent: those of the sensor, else of image tubes at large.
SPREAD_PX2 = (0.0, 16.0)
# Beyond 0..1 by a little: a wall at 0 would push the diameter of a halo without rim to one side.
ELASTIC_SHARE = (-0.15, 1.15)
CUT_OFF_CY_PER_PX = (0.45, 0.15)
EXPONENT = (1.3, 0.2)
LEAST_DIAMETER_PX = 12.0
# Share of the core's and halo's brightness by which a model of round shapes may be off in a ring: cameras are not
# quite round, and rings near the core are measured far better than that.
MODEL_SHARE = 0.03
# Standard errors of its brightness that a halo needs to be seen at all, and in one level to be judged there.
SEEN = 7.0
SEEN_LEVEL = 8.0
# What a diameter off by these factors must cost in log-probability: wings without an edge pass for any disc.
OFF = (0.75, 1.3)
OFF_COST = 12.5


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Profiles made ready for the fit: whitened, with their transforms.

    Parameters
    ----------
    labels
        Stacks.
    optics
        Transforms onto rings; stacks with the source in one place share one.
    which, used, white, data
        For each stack: its transform, the rings used, the matrix that whitens them, and the whitened ring means.
    bounds, centre, spread
        Bounds of the parameters, and mean and sd of normal priors (infinite sd: none).
    """

    labels: tuple[str, ...]
    optics: tuple[Optics, ...]
    which: tuple[int, ...]
    used: tuple[NDArray[np.bool_], ...]
    white: tuple[Array, ...]
    data: tuple[Array, ...]
    bounds: Array
    centre: Array
    spread: Array

    def log_probability(self, points: Array) -> Array:
        """Log of the posterior with amplitudes and pedestals integrated out, shape (point,)."""
        inside = np.all((points >= self.bounds[:, 0]) & (points <= self.bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, self.bounds.mean(axis=1))
        total = -0.5 * (((safe - self.centre) / self.spread) ** 2).sum(axis=1)
        drawn = [shapes(safe, optics) for optics in self.optics]
        for one, which in enumerate(self.which):
            total = total + self.level(one, safe, drawn[which])[0]
        return np.where(inside, total, -np.inf)

    def level(self, one: int, points: Array, drawn: tuple[Array, Array] | None = None) -> tuple[Array, Array]:
        """Log-likelihood of one stack, and its best core, pedestal and halo, shape (point, 3)."""
        core, disc = (of[:, self.used[one]] for of in drawn or shapes(points, self.optics[self.which[one]]))
        flat = np.ones_like(core)
        design = np.stack([core, flat, disc], axis=-1)
        scale = np.abs(design).max(axis=1, keepdims=True)
        design = self.white[one] @ (design / scale)
        normal = np.swapaxes(design, 1, 2) @ design
        right = np.swapaxes(design, 1, 2) @ self.data[one]
        best = np.linalg.solve(normal, right[..., None])[..., 0]
        rest = self.data[one] - (design @ best[..., None])[..., 0]
        return -0.5 * (rest**2).sum(axis=1), best / scale[:, 0, :]

    def halo_significance(self, one: int, point: Array) -> float:
        """Brightness of the halo of one stack in its standard errors."""
        core, disc = (of[:, self.used[one]] for of in shapes(point[None], self.optics[self.which[one]]))
        design = self.white[one] @ np.stack([core[0], np.ones_like(core[0]), disc[0]], axis=-1)
        scale = np.abs(design).max(axis=0)
        covariance = np.linalg.inv((design / scale).T @ (design / scale))
        best = covariance @ (design / scale).T @ self.data[one]
        return float(best[2] / np.sqrt(covariance[2, 2]))


@dataclass(frozen=True, kw_only=True)
class HaloFit:
    """Posterior of the halo with what speaks for it.

    Parameters
    ----------
    posterior
        Draws of `charact.bloom.model.NAMES`.
    point
        The best fit.
    significance
        Brightness of each level's halo in its standard errors, shape (level,).
    chi2, freedom
        Of the best fit.
    diameters, diameter_sd
        Own estimate of each level and its standard error, NaN where its halo is not seen, shape (level,).
    amplitudes
        Core, pedestal and halo of each level, DN px^2, DN and DN px^2, shape (level, 3).
    """

    posterior: Posterior
    point: Array
    significance: Array
    chi2: float
    freedom: int
    diameters: Array
    diameter_sd: Array
    amplitudes: Array


def problem_of(profiles: list[Profile], reach_px: int, *, context: Context) -> Problem:
    """Whiten profiles and set the priors."""
    white, data = [], []
    for profile in profiles:
        covariance = profile.covariance()
        above = np.abs(profile.mean_dn[profile.used] - np.median(profile.mean_dn[profile.used][-6:]))
        covariance = covariance + np.diag((MODEL_SHARE * above) ** 2)
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        white.append(root)
        data.append(root @ profile.mean_dn[profile.used])
    cut_off, exponent = _core_priors(context)
    places = {profile.radius_px.tobytes(): profile.radius_px for profile in profiles}
    order = list(places)
    return Problem(
        labels=tuple(profile.label for profile in profiles),
        optics=tuple(optics_of(radius) for radius in places.values()),
        which=tuple(order.index(profile.radius_px.tobytes()) for profile in profiles),
        used=tuple(profile.used for profile in profiles),
        white=tuple(white),
        data=tuple(data),
        bounds=np.array([[LEAST_DIAMETER_PX, 1.7 * reach_px], ELASTIC_SHARE, [0.1, 3.0], [0.7, 2.5], SPREAD_PX2]),
        centre=np.array([0.0, 0.0, cut_off[0], exponent[0], 0.0]),
        spread=np.array([np.inf, np.inf, cut_off[1], exponent[1], np.inf]),
    )


def _core_priors(context: Context) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean and sd of cut-off and exponent of the core."""
    if context.sensor is None:
        return CUT_OFF_CY_PER_PX, EXPONENT
    tube, sensor = context.sensor.tube, context.sensor
    scale = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification) * 1e-3
    cut_off = float(tube.mtf_frequency_lp_per_mm) * scale
    return (cut_off, 0.15 * cut_off), (float(tube.mtf_exponent), 0.1)


def fit(problem: Problem, *, seed: int, quick: bool, first_diameter_px: float) -> HaloFit | None:
    """Fit one halo to all levels; None where it is not seen."""
    point, covariance = _best(problem, first_diameter_px)
    levels = range(len(problem.data))
    significance = np.array([problem.halo_significance(i, point) for i in levels])
    if np.sqrt(np.sum(np.clip(significance, 0.0, None) ** 2)) < SEEN or not _has_edge(problem, point):
        return None
    draw = laplace if quick else sample
    posterior = draw(problem.log_probability, names=NAMES, units=UNITS, start=point, covariance=covariance, seed=seed,
                     bounds=problem.bounds)  # fmt: skip
    own = [own_diameter(problem, i, point) if significance[i] > SEEN_LEVEL else (np.nan, np.nan) for i in levels]
    found = [problem.level(i, point[None]) for i in levels]
    return HaloFit(
        posterior=posterior,
        point=point,
        significance=significance,
        chi2=-2.0 * float(sum(one[0][0] for one in found)),
        freedom=sum(len(data) for data in problem.data) - 3 * len(problem.data) - len(point),
        diameters=np.array([d for d, _ in own]),
        diameter_sd=np.array([s for _, s in own]),
        amplitudes=np.array([one[1][0] for one in found]),
    )


def _has_edge(problem: Problem, point: Array) -> bool:
    """Whether the diameter is tied to one place: a smooth wing is fitted about as well by discs of any size."""
    peak = float(problem.log_probability(point[None])[0])
    for factor in OFF:
        off = point.copy()
        off[0] = np.clip(factor * point[0], *problem.bounds[0])

        def fixed(points: Array, off: Array = off) -> Array:
            return problem.log_probability(np.concatenate([np.full((len(points), 1), off[0]), points], axis=1))

        best = maximum(fixed, off[1:], problem.bounds[1:])[0]
        if peak - float(fixed(best[None])[0]) < OFF_COST:
            return False
    return True


def _best(problem: Problem, first_diameter_px: float) -> tuple[Array, Array]:
    """Climb from several diameters, for the edge of a disc makes many small peaks."""
    low, high = problem.bounds[0]
    diameters = np.concatenate([[first_diameter_px], np.linspace(low + 2, high - 2, 40)])
    starts = np.array([[d, w, problem.centre[2], problem.centre[3], 0.7] for d in diameters for w in (0.3, 0.8)])
    starts[:, 0] = np.clip(starts[:, 0], low + 1, high - 1)
    values = problem.log_probability(starts)
    best = starts[np.argsort(values)[::-1][:3]]
    climbed = [maximum(problem.log_probability, start, problem.bounds) for start in best]
    return max(climbed, key=lambda pair: float(problem.log_probability(pair[0][None])[0]))


def own_diameter(problem: Problem, one: int, point: Array) -> tuple[float, float]:
    """Return diameter and standard error that one level alone gives, its rim free, the core as all levels have it."""

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= problem.bounds[:2, 0]) & (points <= problem.bounds[:2, 1]), axis=1)
        full = np.broadcast_to(point, (len(points), len(point))).copy()
        full[:, :2] = np.where(inside[:, None], points, point[:2])
        return np.where(inside, problem.level(one, full)[0], -np.inf)

    peak, covariance = maximum(log_probability, point[:2], problem.bounds[:2])
    return float(peak[0]), float(np.sqrt(max(covariance[0, 0], 0.0)))
