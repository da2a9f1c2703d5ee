"""Fit of a sensor description: model, posterior and the resulting parameters."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.fit.observations import Observation, levels_of, observations
from charact.fit.predicted_quantities import Values
from charact.fit.prior import (
    Product,
    SensorPrior,
    distribute_product,
    prior_of,
    products_of,
    values_of_description,
    widen_to_products,
)
from charact.noise.illumination import relative_sd_of
from labdata.camera_description import Parameter
from labdata.errors import BadInput
from labdata.measurement import Posterior, Result
from labdata.sensor import Draws, Sensor
from labdata.session import Session

Array = NDArray[np.float64]
KEPT_DRAWS = 400


@dataclass(frozen=True, kw_only=True)
class Model:
    """Prior and likelihood of the requested parameters."""

    sensor: Sensor  # sensor description with the prior ranges and the parameters not drawn
    products: tuple[Product, ...]  # products drawn as one, with the partners at their values
    prior: SensorPrior  # prior of the parameters drawn; that of a product's carrier is the product's
    observed: tuple[Observation, ...]  # observations of the session

    def misfit(self, coordinates: Array) -> Array:
        """Return chi squared of all observations for coordinates (n, parameter), shape (n,)."""
        values = self.values(coordinates)
        return np.sum([observed.chi_squared(values) for observed in self.observed], axis=0)

    def values(self, coordinates: Array) -> Values:
        """Return every parameter's value: (n,) for those drawn, at coordinates (n, parameter), else (1,)."""
        drawn = dict(zip(self.prior.names, self.prior.parameters(coordinates).T, strict=True))
        return {**self._description_values, **drawn}

    @cached_property
    def _description_values(self) -> Values:
        return values_of_description(self.sensor)

    def log_probability(self, coordinates: Array) -> Array:
        """Return the log-posterior, not normalised, shape (n,); -inf outside the prior's bounds."""
        density = self.prior.log_density(coordinates)
        inside = np.isfinite(density)
        out = np.full(len(coordinates), -np.inf)
        if inside.any():
            out[inside] = density[inside] - 0.5 * self.misfit(coordinates[inside])
        return out


def model_of(sensor: Sensor, observed: tuple[Observation, ...]) -> Model:
    """Return the model of the parameters that the observations depend on."""
    requested = tuple(dict.fromkeys(path for one in observed for path in one.speaks_of))
    products = products_of(sensor, requested)
    riding = {path for product in products for path in product.partners}
    prior = prior_of(widen_to_products(sensor, products), tuple(path for path in requested if path not in riding))
    return Model(sensor=sensor, products=products, prior=prior, observed=observed)


def most_probable(model: Model, start: Array, free: NDArray[np.bool_]) -> Array:
    """Return the most probable point with only the free coordinates changed."""
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
    """Return the model with errors scaled to its misfit, and the note that reports it.

    At the most probable point chi squared of data and prior has as many degrees of freedom as there are data. A p-value
    below 1e-4 is a misfit: all errors are then scaled by the root of the reduced chi squared (Birge's ratio), so that
    ranges include the model error.
    """
    from scipy.stats import chi2

    best = most_probable(model, model.prior.centre, np.ones(model.prior.centre.size, bool))
    parts = {one.name: float(one.chi_squared(model.values(best[None]))[0]) for one in model.observed}
    parts["the description's own ranges"] = -2.0 * float(model.prior.log_density(best[None])[0])
    numbers, total = sum(one.value.size for one in model.observed), sum(parts.values())
    if total <= chi2.isf(1e-4, numbers):
        return model, None
    factor = float(np.sqrt(total / numbers))
    worst = max(parts, key=lambda name: parts[name])
    said = (
        f"model-misfit: chi-squared {total:.0f} for {numbers} numbers, {parts[worst]:.0f} of it from {worst}; "
        f"all errors were multiplied by {factor:.1f}"
    )
    return replace(model, observed=tuple(one.scale_errors(factor) for one in model.observed)), said


def posterior_of(model: Model, *, seed: int) -> Posterior:
    """Draw the joint posterior in the prior's coordinates."""
    from charact.posterior import find_maximum, sample

    prior = model.prior
    point, covariance = find_maximum(model.log_probability, prior.centre, prior.bounds)
    return sample(model.log_probability, names=prior.names, units=("1",) * len(prior.names), start=point, seed=seed,
                  covariance=covariance, bounds=prior.bounds, draws=KEPT_DRAWS)  # fmt: skip


FULL_WELL = "ccd.full_well_e"
GAIN = "video.conversion_gain_dn_per_e"
CANDIDATES = 400


def fills_the_scale(session: Session) -> bool:
    """Whether a point source's frames reach full scale, so that the full well is at least as large."""
    if session.bit_depth is None:
        return False
    return any(int(entry.read().data.max()) >= 2**session.bit_depth - 1 for entry in session.of_kind("point"))


def full_well_draws(sensor: Sensor, drawn: dict[str, Array], rng: np.random.Generator) -> Array | None:
    """Return the full well for each draw of gain and black level, e-; None if not constrained.

    The prior, truncated below (full scale - black level) / gain; that charge where nothing remains.
    """
    prior = prior_of(sensor, (FULL_WELL,))
    if not prior.names or GAIN not in drawn:
        return None
    black = drawn.get("video.black_level_dn", np.array([float(sensor.video.black_level_dn)]))
    least = (2**sensor.video.bit_depth - 1 - black) / drawn[GAIN]
    tried = np.sort(prior.parameters(prior.draw(rng, CANDIDATES))[:, 0])
    first = np.searchsorted(tried, least)
    picked = first + np.floor(rng.random(least.size) * (CANDIDATES - first)).astype(int)
    return np.where(first < CANDIDATES, tried[np.minimum(picked, CANDIDATES - 1)], least)


Progress = Callable[[str, float], None]
# A parameter is identified if its posterior is narrower than this fraction of its prior, in standard deviations.
IDENTIFIED_SHARE = 0.7
# Parameters that the systematic uncertainty of the light meter affects.
_METERED = (
    "tube.luminous_gain",
    "photocathode.luminous_sensitivity_ua_per_lm",
    "photocathode.ebi_lm_per_cm2",
    "microchannel_plate.strip_current_ua_per_cm2",
)


def fit_sensor(
    session: Session, result: Result, *, seed: int = 0, progress: Progress = lambda sentence, share: None
) -> Sensor:
    """Fit the session's sensor description to its measurements.

    Parameters
    ----------
    session
        Session; its sensor description gives the priors, its darks and flats the stack means.
    result
        Measurements of the session.
    seed
        Seed of the posterior draws.
    progress
        Called with a sentence and the fraction done.

    Returns
    -------
    Sensor
        Every parameter that the data identify is `fitted` (value, 95 % range); every other requested one keeps value
        and range of its prior and is marked `prior`; the rest is unchanged. `draws` contains the joint posterior of all
        requested parameters without the systematic uncertainty of the light meter: products of parameters are better
        known than each of them.

    Raises
    ------
    BadInput
        If the session has no sensor, one without interlaced analog video, or no measurement of it.
    """
    if session.sensor is None:
        raise BadInput(f"a fit needs a sensor description with prior ranges, got none in session {session.name!r}")
    if session.sensor.video.digital or not session.sensor.video.interlaced:
        raise BadInput(f"a fit needs a camera of interlaced analog video, got {session.sensor.name!r}")
    progress("levels of darks and flats", 0.0)
    observed = observations(session, session.sensor, result, levels_of(session))
    if not observed:
        raise BadInput(f"a fit needs at least one measurement that was not refused, got none in {session.name!r}")
    model, doubt = inflate_errors(model_of(session.sensor, observed))
    progress("posterior of the sensor", 0.2)
    posterior = posterior_of(model, seed=seed)
    progress("identifying parameters", 0.9)
    lit = [entry.conditions for entry in session.of_kind("flat") if entry.conditions.illuminance_lux]
    fitted = description_from_posterior(
        model, posterior, illuminance_relative_sd=relative_sd_of(lit, "lux")[0], scale_filled=fills_the_scale(session),
        seed=seed,
    )  # fmt: skip
    if doubt:
        fitted = replace(fitted, notes=(*fitted.notes, doubt))
    progress("fitted", 1.0)
    return fitted


def description_from_posterior(
    model: Model, posterior: Posterior, *, illuminance_relative_sd: float, seed: int, scale_filled: bool = False
) -> Sensor:
    """Return the sensor description of a posterior.

    `posterior`: draws in the coordinates of the model's prior; `illuminance_relative_sd`: relative standard uncertainty
    of the illuminance; widens the ranges of the parameters that depend on the meter; `scale_filled`: whether frames
    reach full scale, which constrains the full well.
    """
    left = dict(zip(posterior.names, posterior.draws.std(axis=0, ddof=1) / model.prior.sd, strict=True))
    point, carriers = _consistent(model, posterior, left)
    values = dict(zip(posterior.names, model.prior.parameters(point[None])[0], strict=True))
    rng = np.random.default_rng([seed, 1])
    draws = dict(zip(posterior.names, model.prior.parameters(posterior.draws).T, strict=True))
    for product in model.products:
        draws.update(distribute_product(model.sensor, product, draws[product.carrier], rng))
    meter = 1.0 + illuminance_relative_sd * rng.standard_normal(len(posterior.draws))
    before = model.sensor.parameters()
    changes = {
        path: _parameter(before[path], values.get(path), drawn * meter if path in _METERED else drawn,
                         left.get(path, 1.0), path in carriers)
        for path, drawn in draws.items()
    }  # fmt: skip
    well = full_well_draws(model.sensor, draws, rng) if scale_filled else None
    if well is not None:
        draws[FULL_WELL] = well
        low, value, high = (float(q) for q in np.quantile(well, (0.025, 0.5, 0.975)))
        words = "the prior, truncated below the charge at full scale, which frames reach; prior: "
        changes[FULL_WELL] = Parameter(
            value=value, low=low, high=high, standing="prior", source=words + before[FULL_WELL].source
        )
    table = np.stack(list(draws.values()), axis=1)
    return replace(
        model.sensor.with_parameters(changes),
        name=f"{model.sensor.name}, fitted",
        draws=Draws(names=tuple(draws), values=tuple(tuple(float(f"{x:.7g}") for x in row) for row in table)),
        notes=(*model.sensor.notes, _how(model, posterior, point)),
    )


def _consistent(model: Model, posterior: Posterior, left: dict[str, float]) -> tuple[Array, set[str]]:
    """Return a point consistent with the data while unidentified parameters keep their prior value.

    If the data determine only a combination, none of its parameters may be identified; the best-determined one is then
    fitted as well, and returned in the second result.
    """
    share = np.array([left[name] for name in posterior.names])
    best = most_probable(model, np.median(posterior.draws, axis=0), np.ones(share.size, bool))
    allowed = float(model.misfit(best[None])[0]) + 1.0
    free = share < IDENTIFIED_SHARE
    own = free.copy()
    while True:
        point = most_probable(model, np.where(free, best, model.prior.centre), free)
        if float(model.misfit(point[None])[0]) <= allowed or free.all():
            return point, {name for name, one in zip(posterior.names, free & ~own, strict=True) if one}
        held = np.flatnonzero(~free)
        free[held[np.argmin(share[held])]] = True


def _parameter(before: Parameter, value: float | None, draws: Array, left: float, carrier: bool) -> Parameter:
    """Return one parameter of the fitted description; `left` is the remaining fraction of its prior's width."""
    if value is None:
        said = "requested, but the session's data determine only its product with others"
        return replace(before, standing="prior", source=f"{said}; prior: {before.source}")
    if left >= IDENTIFIED_SHARE and not carrier:
        said = f"requested, but not identified by the session's data: {left:.0%} of the prior's width remains"
        return replace(before, standing="prior", source=f"{said}; prior: {before.source}")
    low, high = (float(q) for q in np.quantile(draws, (0.025, 0.975)))
    how = "represents a combination that the session's data determine" if carrier else "fitted to the session's data"
    source = f"{how}; value with the unidentified parameters at theirs; {left:.0%} of the prior's width remains"
    return Parameter(value=value, low=min(low, value), high=max(high, value), standing="fitted", source=source)


def _how(model: Model, posterior: Posterior, point: Array) -> str:
    """Return the note that summarises the fit."""
    numbers = sum(observed.value.size for observed in model.observed)
    chi_squared = float(model.misfit(point[None])[0])
    flags = f"; flags: {', '.join(posterior.flags)}" if posterior.flags else ""
    return (
        f"Fitted with {len(posterior.names)} parameters to {numbers} measured numbers, chi-squared {chi_squared:.1f}, "
        f"{posterior.sampler}, seed {posterior.seed}{flags}."
    )
