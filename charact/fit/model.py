"""Prior and likelihood of a sensor's parameters, their most probable point and their posterior draws."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.fit.degenerate_products import Product, products_of, widen_to_products
from charact.fit.observed import Observation
from charact.fit.predicted_quantities import Values
from charact.fit.prior import SensorPrior, prior_of, values_of_description
from labdata.measurement import Posterior
from labdata.sensor import Sensor

Array = NDArray[np.float64]

KEPT_DRAWS = 400
# Chance of a misfit that is none.
CHANCE = 1e-4


@dataclass(frozen=True, kw_only=True)
class Model:
    """Prior and likelihood of the parameters asked.

    Parameters
    ----------
    sensor
        The description that holds the parameters not asked, and the prior ranges.
    products
        Products drawn as one: their partners stand at their values.
    prior
        Of the parameters drawn; that of a product's carrier is the product's.
    observed
        What the session measured.
    """

    sensor: Sensor
    products: tuple[Product, ...]
    prior: SensorPrior
    observed: tuple[Observation, ...]

    def misfit(self, coordinates: Array) -> Array:
        """Return chi-squared of all observations for coordinates (n, parameter), shape (n,)."""
        values = self.values(coordinates)
        return np.sum([observed.chi_squared(values) for observed in self.observed], axis=0)

    def part(self, observed: Observation, coordinates: Array) -> Array:
        """Return one observation's share of chi-squared for coordinates (n, parameter), shape (n,)."""
        return observed.chi_squared(self.values(coordinates))

    def values(self, coordinates: Array) -> Values:
        """Return every parameter's value: (n,) for those drawn, at coordinates (n, parameter), else (1,)."""
        drawn = dict(zip(self.prior.names, self.prior.parameters(coordinates).T, strict=True))
        return {**self._fixed, **drawn}

    @cached_property
    def _fixed(self) -> Values:
        return values_of_description(self.sensor)

    def log_probability(self, coordinates: Array) -> Array:
        """Return the logarithm of the posterior, not normalised, shape (n,); -inf outside the prior's bounds."""
        density = self.prior.log_density(coordinates)
        inside = np.isfinite(density)
        out = np.full(len(coordinates), -np.inf)
        if inside.any():
            out[inside] = density[inside] - 0.5 * self.misfit(coordinates[inside])
        return out


def model_of(sensor: Sensor, observed: tuple[Observation, ...]) -> Model:
    """Return the model that asks exactly the parameters that the observations speak of."""
    asked = tuple(dict.fromkeys(path for one in observed for path in one.speaks_of))
    products = products_of(sensor, asked)
    riding = {path for product in products for path in product.partners}
    prior = prior_of(widen_to_products(sensor, products), tuple(path for path in asked if path not in riding))
    return Model(sensor=sensor, products=products, prior=prior, observed=observed)


def most_probable(model: Model, start: Array, free: NDArray[np.bool_]) -> Array:
    """Return the most probable point that differs from the start in the free coordinates only."""
    from charact.posterior import find_maximum

    if not free.any():
        return start

    def conditional(points: Array) -> Array:
        whole = np.tile(start, (len(points), 1))
        whole[:, free] = points
        return model.log_probability(whole)

    found = start.copy()
    found[free], _ = find_maximum(conditional, start[free], model.prior.bounds[free])
    return found


def inflate_errors(model: Model) -> tuple[Model, str | None]:
    """Return the model with errors wide enough for what it cannot explain, and the sentence that says so.

    Notes
    -----
    At the most probable point chi-squared of data and prior together has as many degrees of freedom as there are data.
    One that chance would exceed with the probability `CHANCE` is a misfit: all errors are then scaled by the root of
    chi-squared per number (Birge's ratio), so that ranges do not promise what the model does not hold.
    """
    from scipy.stats import chi2

    best = most_probable(model, model.prior.centre, np.ones(model.prior.centre.size, bool))
    parts = {one.name: float(model.part(one, best[None])[0]) for one in model.observed}
    parts["the description's own ranges"] = -2.0 * float(model.prior.log_density(best[None])[0])
    numbers, total = sum(one.value.size for one in model.observed), sum(parts.values())
    if total <= chi2.isf(CHANCE, numbers):
        return model, None
    factor = float(np.sqrt(total / numbers))
    worst = max(parts, key=lambda name: parts[name])
    said = (
        f"model-misfit: chi-squared {total:.0f} for {numbers} numbers, {parts[worst]:.0f} of it from {worst}; "
        f"all errors were taken {factor:.1f} times as large"
    )
    return replace(model, observed=tuple(one.doubted(factor) for one in model.observed)), said


def posterior_of(model: Model, *, seed: int) -> Posterior:
    """Draw the joint posterior of all parameters drawn, in the prior's coordinates."""
    from charact.posterior import find_maximum, sample

    point, covariance = find_maximum(model.log_probability, model.prior.centre, model.prior.bounds)
    return sample(
        model.log_probability,
        names=model.prior.names,
        units=("1",) * len(model.prior.names),
        start=point,
        covariance=covariance,
        seed=seed,
        bounds=model.prior.bounds,
        draws=KEPT_DRAWS,
    )
