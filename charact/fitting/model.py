"""Model of a fit: prior and likelihood of the requested parameters, and their posterior."""

import collections
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.fitting.modes import Mode, Slope
from charact.fitting.observation import Observation, misfit_finding
from charact.fitting.posterior_draws import draw_posterior
from charact.fitting.prior import FACTORS, SensorPrior, prior_of, values_of_description
from charact.fitting.thresholds import LIMITS, MODES, SAMPLING
from charact.observables import GivenOthers, Ridge, Values
from charact.verdict import Finding
from labdata import Array, Camera, Posterior

# Row pitch of pixels of known shape: it follows the column pitch.
TIED = {"ccd.pitch_y_um": "ccd.pitch_x_um"}


@dataclass(frozen=True, kw_only=True)
class Model:
    """Prior and likelihood of the requested parameters."""

    sensor: Camera  # sensor description with the prior ranges and the parameters not drawn
    prior: SensorPrior  # prior of the parameters drawn
    observed: tuple[Observation, ...]  # observations of the session
    # Parameters that the data determine: points hold no normal scores of them.
    determined: tuple[str, ...] = ()

    def misfit(self, coordinates: Array) -> Array:
        """Return chi squared of all observations for coordinates (n, parameter), shape (n,)."""
        values = self.values(coordinates)
        return np.sum([observed.chi_squared(values) for observed in self.observed], axis=0)

    def values(self, coordinates: Array) -> Values:
        """Return every parameter's value: (n,) for those drawn, at coordinates (n, parameter), else
        (1,).
        """
        drawn = dict(zip(self.prior.names, self.prior.parameters(coordinates).T, strict=True))
        return {**self._description_values, **drawn, **self.tied(drawn)}

    def tied(self, drawn: dict[str, Array]) -> dict[str, Array]:
        """Return the parameters that keep their ratio to one that is drawn."""
        known = self._description_values
        return {
            path: drawn[by] * (known[path] / known[by]) for path, by in TIED.items() if by in drawn
        }

    @cached_property
    def _description_values(self) -> Values:
        return values_of_description(self.sensor)

    @cached_property
    def ridges(self) -> tuple[tuple[int, Ridge, Array], ...]:
        """Place of the carrier among the coordinates, the ridge and its number at the centre of the
        prior, of every observation that has one.
        """
        known = [
            ridge.ridge
            for ridge in self.observed
            if ridge.ridge is not None and ridge.ridge.carrier in self.prior.names
        ]
        centre = self.values(self.prior.centre[None])
        return tuple(
            (self.prior.names.index(ridge.carrier), ridge, ridge.number(centre)) for ridge in known
        )

    @cached_property
    def conditionals(self) -> tuple[tuple[int, GivenOthers, Observation], ...]:
        """Index among the coordinates of every parameter that is drawn given the others, and the
        observation that shows it.
        """
        names = self.prior.names
        return tuple(
            (names.index(part.given_others.path), part.given_others, part)
            for part in self.observed
            if part.given_others is not None and part.given_others.path in names
        )

    @cached_property
    def is_carrier(self) -> NDArray[np.bool_]:
        """Which coordinates carry a ridge, shape (parameter,)."""
        return np.isin(np.arange(len(self.prior.names)), [carrier for carrier, *_ in self.ridges])

    @cached_property
    def is_scored(self) -> NDArray[np.bool_]:
        """Which coordinates points hold as normal scores, shape (parameter,): those that have the
        form of their prior, and not logarithms of factors, whose products are straight ridges.
        """
        conditional = (law.path for _, law, _ in self.conditionals)
        unscored = (*FACTORS, *self.determined, *conditional)
        return ~self.is_carrier & ~np.isin(self.prior.names, unscored)

    @cached_property
    def is_normal(self) -> NDArray[np.bool_]:
        """Which coordinates points hold as normal scores, in the prior or given the others."""
        indices = [index for index, *_ in self.conditionals]
        return self.is_scored | np.isin(np.arange(len(self.prior.names)), indices)

    def bend(self, points: Array) -> tuple[Array, Array]:
        """Return the coordinates of points (n, parameter), in which the posterior is nearly normal,
        and residuals, shape (n, k), minus half the sum of whose squares is ln of the volume of the
        coordinates over that of the points.

        Points hold normal scores in the prior of some coordinates, others reflected at their
        bounds, since of many at a bound hardly any proposal were inside, and straightened carriers:
        a carrier c of the number N = f(others) + a c stands for c + (f(others) - f(centre))/a, a
        shear of unit determinant. Others are held as normal scores given all before them, see
        `GivenOthers`: of the width s, s0 in the prior, the residual is sqrt(2 ln(s0/s)).
        """
        low, high = self.prior.bounds.T
        ends = np.clip(points, low, high)
        reflected = 2.0 * ends - points
        reflected = np.where(points == ends, points, reflected)
        out = np.where(self.is_scored, self.prior.of_scores(points), reflected)
        out[:, self.is_carrier] = points[:, self.is_carrier]
        clipped = np.clip(out, low, high)
        for carrier, ridge, number in self.ridges:
            clipped[:, carrier] = self.prior.centre[carrier]
            out[:, carrier] -= (ridge.number(self.values(clipped)) - number) / ridge.slope
        narrowed = np.zeros((len(points), len(self.conditionals)))
        for column, (index, law, observation) in enumerate(self.conditionals):
            mean, sd = self._given_others(np.clip(out, low, high), index, law, observation)
            out[:, index] = mean + sd * points[:, index]
            narrowed[:, column] = np.sqrt(2.0 * np.log(np.maximum(self.prior.sd[index] / sd, 1.0)))
        return out, narrowed

    def _given_others(
        self, coordinates: Array, index: int, law: GivenOthers, observation: Observation
    ) -> tuple[Array, Array]:
        """Return mean m and standard deviation s of a coordinate given the others, shape (n,).

            f = f1 - J'r1/J'J,  s_f^2 = 1/J'J,  1/s^2 = 1/s0^2 + (f'/s_f)^2,
            m = s^2 (c/s0^2 + (f'/s_f)^2 x(f))

        r1, f1: residuals and function at the parameter 1; J: change of residuals with the function;
        c, s0: centre and width of the prior; f': slope of the function by the coordinate x.
        """
        prior, (low, high) = self.prior, self.prior.bounds[index]
        centre, width = prior.centre[index], prior.sd[index]
        power, values = prior.power[index], self.values(coordinates)
        ends = np.array([1.0, 2.0])
        first, last = (observation.residuals({**values, law.path: end}) for end in ends[:, None])
        start, stop = law.function(ends)
        slope = (last - first) / (stop - start)
        precision = np.maximum(np.sum(slope**2, axis=1), 1e-300)
        number = start - np.sum(slope * first, axis=1) / precision
        shown = law.inverse(number, precision**-0.5)
        shown = np.clip(shown if power else np.log(shown), low, high)
        sides = shown + MODES.difference * width * np.array([[-0.5], [0.5]])
        rise = np.diff(law.function(sides if power else np.exp(sides)), axis=0)[0]
        weight = precision * (rise / (MODES.difference * width)) ** 2
        sd = (width**-2 + weight) ** -0.5
        return sd**2 * (centre / width**2 + weight * shown), sd

    def residuals(self, coordinates: Array, of_prior: Array) -> Array:
        """Return whitened residuals of the data at coordinates (n, parameter), followed by those of
        the prior, shape (n, k).
        """
        values = self.values(np.clip(coordinates, *self.prior.bounds.T))
        parts = [*(observed.residuals(values) for observed in self.observed), of_prior]
        return np.concatenate(
            [np.broadcast_to(part, (len(of_prior), part.shape[1])) for part in parts], axis=1
        )

    def residuals_of(self, points: Array) -> tuple[Array, Array]:
        """Return residuals at points, shape (n, k), and the coordinates of these, shape (n,
        parameter): the sum of their squares is minus twice the log-posterior.
        """
        coordinates, narrowed = self.bend(points)
        of_prior = np.where(self.is_scored, points, self.prior.residuals(coordinates))
        return self.residuals(coordinates, np.hstack([of_prior, narrowed])), coordinates

    def log_probability(self, points: Array) -> Array:
        """Return the log-posterior at points, not normalised, shape (n,); -inf outside bounds."""
        residuals, coordinates = self.residuals_of(points)
        (low, high), squares = self.prior.bounds.T, np.sum(residuals**2, axis=1)
        is_inside = np.all((coordinates >= low) & (coordinates <= high), axis=1)
        return np.where(is_inside, -0.5 * squares, -np.inf)

    def _searched(self, points: Array) -> Array:
        """Return residuals without those of the volume, shape (n, k): with them the highest mode is
        a needle where a parameter is free given the others, which chains do not leave.
        """
        residuals, _ = self.residuals_of(points)
        return residuals[:, : residuals.shape[1] - len(self.conditionals)]

    @cached_property
    def slope(self) -> Slope:
        """Residuals as a function of points."""
        is_free = (self.is_normal | self.is_carrier)[:, None]
        return Slope(
            residuals=self._searched,
            bounds=np.where(is_free, [-np.inf, np.inf], self.prior.bounds),
            width=np.where(self.is_normal, 1.0, self.prior.sd),
        )

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """Modes of the posterior as a density of points, from the middle of the prior and from
        draws of it.
        """
        prior, rng = self.prior, np.random.default_rng(MODES.seed)
        scores = rng.standard_normal((MODES.starts, len(prior.names)))
        drawn = np.where(self.is_normal, scores, prior.draw(rng, MODES.starts))
        return self.slope.modes((np.where(self.is_normal, 0.0, prior.centre), *drawn))

    @property
    def mode_weights(self) -> Array:
        """Fraction of the posterior that each mode holds, shape (mode,)."""
        volume = np.exp([mode.log_evidence - self.modes[0].log_evidence for mode in self.modes])
        return volume / volume.sum()

    @cached_property
    def best(self) -> Array:
        """Most probable coordinates, shape (parameter,)."""
        start = np.clip(self.bend(self.modes[0].point[None])[0][0], *self.prior.bounds.T)
        return most_probable(self, start, np.ones(start.size, bool))


def model_of(sensor: Camera, observed: tuple[Observation, ...]) -> Model:
    """Return the model of the parameters that the observations depend on."""
    requested = tuple(
        dict.fromkeys(path for observation in observed for path in observation.parameters)
    )
    return Model(sensor=sensor, prior=prior_of(sensor, requested), observed=observed)


def inflate_errors(model: Model) -> tuple[Model, Finding | None]:
    """Return the model with errors scaled to its misfit, and the finding that reports it.

    At the most probable point chi squared of data and prior has as many degrees of freedom as there
    are data. A p-value below 1e-4 is a misfit: all errors are then scaled by the root of the
    reduced chi squared (Birge's ratio), so that ranges include the model error.
    """
    from scipy.special import chdtri

    best = model.best[None]
    values = model.values(best)
    parts: dict[str, float] = collections.defaultdict(float)
    for observation in model.observed:
        parts[observation.name] += float(observation.chi_squared(values)[0])
    parts["the description's own ranges"] = float(np.sum(model.prior.residuals(best) ** 2))
    numbers, total = (
        sum(observation.value.size for observation in model.observed),
        sum(parts.values()),
    )
    if total <= chdtri(numbers, LIMITS.misfit):
        return model, None
    factor = float(np.sqrt(total / numbers))
    return replace(
        model, observed=tuple(observation.scale_errors(factor) for observation in model.observed)
    ), misfit_finding(parts, numbers, factor)


def most_probable(model: Model, start: Array, free: NDArray[np.bool_]) -> Array:
    """Return the most probable coordinates with only the free ones changed."""
    bounds = np.where(free[:, None], model.prior.bounds, start[:, None])

    def residuals(coordinates: Array) -> Array:
        return model.residuals(coordinates, model.prior.residuals(coordinates))

    return Slope(residuals=residuals, bounds=bounds, width=model.prior.sd).ascend(start).point


def posterior_of(model: Model, *, seed: int) -> Posterior:
    """Draw the joint posterior in the prior's coordinates.

    Of several modes each has the fraction of the draws that it holds of the posterior by Laplace's
    approximation.
    """
    modes = model.modes
    posteriors = [_draw_about(model, mode, seed) for mode in modes]
    counts = np.round(model.mode_weights * SAMPLING.chains).astype(int)
    draws = [part.draws[:count] for part, count in zip(posteriors, counts, strict=True)]
    several = ("several-modes",) if len(modes) > 1 else ()
    return replace(
        posteriors[0],
        draws=np.concatenate(draws),
        flags=(*several, *(flag for part in posteriors for flag in part.flags)),
    )


def _draw_about(model: Model, mode: Mode, seed: int) -> Posterior:
    """Draw the posterior about a mode, in the prior's coordinates."""
    prior, sd = model.prior, np.sqrt(np.diag(mode.covariance))
    is_narrow = model.is_scored & (sd < MODES.scored_sd)
    determined = tuple(name for name, narrow in zip(prior.names, is_narrow, strict=True) if narrow)
    model = replace(model, determined=determined)
    start = np.where(is_narrow, prior.of_scores(mode.point[None])[0], mode.point)
    # Chains start as wide as the wider side of a prior of two halves.
    widest = np.maximum(prior.sd_below, prior.sd_above)
    below, above = (
        np.where(model.is_scored, side, widest) for side in (prior.sd_below, prior.sd_above)
    )
    wide = replace(model, prior=replace(prior, sd_below=below, sd_above=above))
    point = model.slope.ascend(start).point
    posterior = draw_posterior(
        model.log_probability,
        names=prior.names,
        point=point,
        covariance=wide.slope.covariance(point),
        seed=seed,
    )
    coordinates = np.clip(model.bend(posterior.draws)[0], *prior.bounds.T)
    return replace(posterior, draws=coordinates)


def convergence_findings(model: Model, posterior: Posterior) -> Iterator[Finding]:
    """Yield a finding where the chains of a posterior did not converge, and one where it has other
    modes.
    """
    names = posterior.names
    if "not-converged" in posterior.flags:
        index = int(np.argmin(posterior.effective_sample_size))
        yield Finding(
            flag="not-converged",
            effect=(
                "neither slice sampling nor an ensemble of walkers converged, effective draws "
                f"{posterior.effective_sample_size[index]:.0f} of {names[index]}: no parameter "
                "is fitted"
            ),
            remedy="a description of narrower ranges, or darks and flats of more levels",
        )
    best = model.modes[0]
    for mode, weight in zip(model.modes[1:], model.mode_weights[1:], strict=True):
        there, here = model.prior.parameters(model.bend(np.stack([mode.point, best.point]))[0])
        index = int(np.argmax(np.abs(mode.point - best.point) / np.sqrt(np.diag(best.covariance))))
        yield Finding(
            flag="several-modes",
            effect=(
                f"another camera explains the data with {weight:.0%} of the "
                f"probability: {names[index]} {there[index]:.4g} in place of {here[index]:.4g}"
            ),
            remedy="frames that show that parameter, or a description of narrower ranges",
        )
