"""Model of a fit: prior and likelihood of the requested parameters, and their posterior."""

import collections
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.fitting.observation import Observation, misfit_finding
from charact.fitting.prior import SensorPrior, prior_of, values_of_description
from charact.fitting.slice_sampling import slice_sample
from charact.fitting.thresholds import LIMITS
from charact.observables import Ridge, Values
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

    def log_probability(self, coordinates: Array) -> Array:
        """Return the log-posterior, not normalised, shape (n,); -inf outside the prior's bounds."""
        density = self.prior.log_density(coordinates)
        within_bounds = np.isfinite(density)
        out = np.full(len(coordinates), -np.inf)
        if within_bounds.any():
            out[within_bounds] = density[within_bounds] - 0.5 * self.misfit(
                coordinates[within_bounds]
            )
        return out

    @cached_property
    def ridges(self) -> tuple[tuple[int, Ridge], ...]:
        """Place of the carrier among the coordinates, and the ridge, of every observation that has
        one.
        """
        known = [
            ridge.ridge
            for ridge in self.observed
            if ridge.ridge is not None and ridge.ridge.carrier in self.prior.names
        ]
        return tuple((self.prior.names.index(ridge.carrier), ridge) for ridge in known)

    def bend(self, points: Array) -> Array:
        """Return the coordinates of points whose carriers are straightened, shape (n, parameter).

        A carrier c of the number N = f(others) + a c stands for c + (f(others) - f(centre))/a: a
        shear, of unit determinant.
        """
        out, centre = points.copy(), self.prior.centre[None]
        clipped = np.clip(points, self.prior.bounds[:, 0], self.prior.bounds[:, 1])
        for carrier, ridge in self.ridges:
            clipped[:, carrier] = centre[0, carrier]
            number_change = ridge.number(self.values(clipped)) - ridge.number(self.values(centre))
            out[:, carrier] -= number_change / ridge.slope
        return out


def model_of(sensor: Camera, observed: tuple[Observation, ...]) -> Model:
    """Return the model of the parameters that the observations depend on."""
    requested = tuple(
        dict.fromkeys(path for observation in observed for path in observation.parameters)
    )
    return Model(sensor=sensor, prior=prior_of(sensor, requested), observed=observed)


def most_probable(model: Model, start: Array, free: NDArray[np.bool_]) -> Array:
    """Return the most probable point with only the free coordinates changed."""
    from charact.inference import find_maximum

    if not free.any():
        return start

    def conditional(points: Array) -> Array:
        full_points = np.tile(start, (len(points), 1))
        full_points[:, free] = points
        return model.log_probability(full_points)

    optimum = start.copy()
    optimum[free], _ = find_maximum(conditional, start[free], model.prior.bounds[free])
    return optimum


def inflate_errors(model: Model) -> tuple[Model, Finding | None]:
    """Return the model with errors scaled to its misfit, and the finding that reports it.

    At the most probable point chi squared of data and prior has as many degrees of freedom as there
    are data. A p-value below 1e-4 is a misfit: all errors are then scaled by the root of the
    reduced chi squared (Birge's ratio), so that ranges include the model error.
    """
    from scipy.special import chdtri

    best = most_probable(model, model.prior.centre, np.ones(model.prior.centre.size, bool))
    values = model.values(best[None])
    parts: dict[str, float] = collections.defaultdict(float)
    for observation in model.observed:
        parts[observation.name] += float(observation.chi_squared(values)[0])
    parts["the description's own ranges"] = -2.0 * float(model.prior.log_density(best[None])[0])
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


def posterior_of(model: Model, *, seed: int) -> Posterior:
    """Draw the joint posterior in the prior's coordinates."""
    from charact.inference import find_maximum

    prior, bounds = model.prior, model.prior.bounds.copy()
    bounds[[carrier for carrier, _ in model.ridges]] = -np.inf, np.inf

    def log_probability(points: Array) -> Array:
        return model.log_probability(model.bend(points))

    point, covariance = find_maximum(log_probability, prior.centre, bounds)
    if any(observation.is_bound for observation in model.observed):
        # At a bound, where the most probable point often lies, finite differences find no
        # curvature.
        smooth = replace(
            model,
            observed=tuple(
                observation for observation in model.observed if not observation.is_bound
            ),
        )
        _, covariance = find_maximum(
            lambda points: smooth.log_probability(model.bend(points)), point, bounds
        )
    posterior = slice_sample(
        log_probability,
        names=prior.names,
        point=point,
        covariance=covariance,
        bounds=bounds,
        seed=seed,
    )
    return replace(posterior, draws=model.bend(posterior.draws))
