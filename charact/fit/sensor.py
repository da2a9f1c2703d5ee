"""From a session's measurements to a sensor description: what the data identify is fitted, the rest stays a prior."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.fit.gather import observations
from charact.fit.levels import levels_of
from charact.fit.observed import Observed
from charact.fit.prior import ILLUMINANCE_SCALE, Prior, prior_of, values_of
from labdata.errors import BadInput
from labdata.measurement import Posterior, Result
from labdata.parameter import Parameter
from labdata.sensor import Draws, Sensor
from labdata.session import Session

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

# A parameter is identified when the data leave less than this share of its prior's standard deviation.
IDENTIFIED_SHARE = 0.7
# The description's own values must reproduce the data this well, in units of chi-squared above the best there is.
WORST_MISFIT = 1.0
# A photometer whose uncertainty nobody stated.
UNSTATED_ILLUMINANCE_SD = 0.1
KEPT_DRAWS = 400
# The pilot that shapes the chain's proposal.
PILOT_ROUNDS, PILOT_POINTS, PILOT_FREEDOM = 4, 6000, 8.0


@dataclass(frozen=True, kw_only=True)
class Model:
    """Prior and likelihood of the parameters asked.

    Parameters
    ----------
    sensor
        The description that holds the parameters not asked.
    prior
        Of the parameters asked.
    observed
        What the session measured.
    """

    sensor: Sensor
    prior: Prior
    observed: tuple[Observed, ...]

    def misfit(self, points: Array) -> Array:
        """Return chi-squared of all observations for coordinates (n, parameter), shape (n,)."""
        values = values_of(self.sensor, self.prior, points)
        return np.sum([observed.chi_squared(values) for observed in self.observed], axis=0)

    def log_probability(self, points: Array) -> Array:
        """Return the logarithm of the posterior, not normalised, shape (n,); -inf outside the prior's bounds."""
        density = self.prior.log_density(points)
        inside = np.isfinite(density)
        out = np.full(len(points), -np.inf)
        if inside.any():
            out[inside] = density[inside] - 0.5 * self.misfit(points[inside])
        return out


def fit_sensor(
    session: Session, result: Result, *, seed: int = 0, progress: Progress = lambda sentence, share: None
) -> Sensor:
    """Fit the session's sensor description to what was measured.

    Parameters
    ----------
    session
        The session; its sensor description gives the priors, its darks and flats the levels.
    result
        What was measured in it.
    seed
        Seed of the posterior draws.
    progress
        Called with a sentence and the share done.

    Returns
    -------
    Sensor
        Every parameter that the data identify is `fitted` (value, 95 % range); every other one that was asked keeps
        value and range of its prior and is marked `prior`; those never asked are untouched. `draws` holds the joint
        posterior of all that were asked: products of parameters are known better than each of them.

    Raises
    ------
    BadInput
        If the session names no sensor, or holds nothing that speaks of one.
    """
    if session.sensor is None:
        raise BadInput(f"a fit needs a sensor description with prior ranges, got none in session {session.name!r}")
    progress("levels of darks and flats", 0.0)
    observed = observations(session, result, levels_of(session))
    if not observed:
        raise BadInput(f"a fit needs at least one measurement that was not refused, got none in {session.name!r}")
    model = model_of(session.sensor, observed, _illuminance_sd(session))
    progress("posterior of the sensor", 0.2)
    posterior = posterior_of(model, seed=seed)
    progress("choosing what the data identify", 0.9)
    fitted = described(model, posterior)
    progress("fitted", 1.0)
    return fitted


def model_of(sensor: Sensor, observed: tuple[Observed, ...], illuminance_relative_sd: float) -> Model:
    """Return the model that asks exactly the parameters that the observations speak of."""
    asked = tuple(dict.fromkeys(path for one in observed for path in one.speaks_of))
    lit = any("tube.luminous_gain" in one.speaks_of for one in observed)
    return Model(
        sensor=sensor,
        prior=prior_of(sensor, asked, illuminance_relative_sd if lit else 0.0),
        observed=observed,
    )


def posterior_of(model: Model, *, seed: int) -> Posterior:
    """Draw the joint posterior of all parameters asked, in the prior's coordinates."""
    from charact.posterior import maximum, sample

    point, covariance = maximum(model.log_probability, model.prior.centre, model.prior.bounds)
    mean, covariance = _moments(model.log_probability, point, covariance, np.random.default_rng(seed))
    return sample(
        model.log_probability,
        names=model.prior.names,
        units=("1",) * len(model.prior.names),
        start=mean,
        covariance=covariance,
        seed=seed,
        bounds=model.prior.bounds,
        draws=KEPT_DRAWS,
        walkers=2 * len(mean) + 8,
    )


def _moments(
    log_probability: Callable[[Array], Array], point: Array, covariance: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return mean and covariance of a posterior whose peak stands at the kink of a lopsided prior.

    Notes
    -----
    Importance sampling from a Student t of the present moments, repeated; weights are cut at the square root of
    their number times their mean (Ionides 2008), which keeps one lucky point from being all.
    """
    for _ in range(PILOT_ROUNDS):
        root = np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diag(covariance)))
        normal = rng.standard_normal((PILOT_POINTS, point.size))
        stretch = np.sqrt(PILOT_FREEDOM / rng.chisquare(PILOT_FREEDOM, PILOT_POINTS))
        tail = -0.5 * (PILOT_FREEDOM + point.size) * np.log1p((normal**2).sum(1) * stretch**2 / PILOT_FREEDOM)
        points = point + (normal * stretch[:, None]) @ root.T
        weight = log_probability(points) - tail
        weight = np.exp(weight - weight.max())
        weight = np.minimum(weight, weight.mean() * np.sqrt(PILOT_POINTS))
        point = np.average(points, axis=0, weights=weight)
        covariance = np.cov(points.T, aweights=weight)
    return point, covariance


def described(model: Model, posterior: Posterior) -> Sensor:
    """Return the sensor description that a posterior amounts to."""
    share = posterior.draws.std(axis=0, ddof=1) / model.prior.sd
    own = share < IDENTIFIED_SHARE
    point, carriers = _consistent(model, posterior, own, share)
    values, parameters = (model.prior.parameters(at) for at in (point[None], posterior.draws))
    kept = [index for index, name in enumerate(posterior.names) if name != ILLUMINANCE_SCALE]
    changes = {
        posterior.names[index]: _parameter(
            model.sensor.parameters()[posterior.names[index]],
            values[0, index],
            parameters[:, index],
            left=float(share[index]),
            identified=bool(own[index]),
            carrier=bool(carriers[index]),
        )  # fmt: skip
        for index in kept
    }
    draws = Draws(
        names=tuple(posterior.names[index] for index in kept),
        values=tuple(tuple(float(f"{x:.7g}") for x in row) for row in parameters[:, kept]),
    )
    notes = (*model.sensor.notes, _how(model, posterior, point))
    return replace(model.sensor.with_parameters(changes), draws=draws, notes=notes)


def _consistent(
    model: Model, posterior: Posterior, own: NDArray[np.bool_], share: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return one point that agrees with the data while every parameter not fitted stands at its prior value.

    Where the data know only a product, none of its factors need be identified; the one they tell most of is then
    fitted too, as the carrier of the product.
    """
    from charact.posterior import maximum

    best, _ = maximum(model.log_probability, np.median(posterior.draws, axis=0), model.prior.bounds)
    allowed = float(model.misfit(best[None])[0]) + WORST_MISFIT
    nuisance = np.array([name == ILLUMINANCE_SCALE for name in posterior.names])
    free = own & ~nuisance
    while True:
        point = _climbed(model, np.where(free, best, model.prior.centre), free)
        open_to = np.flatnonzero(~free & ~nuisance)
        if float(model.misfit(point[None])[0]) <= allowed or not open_to.size:
            return point, free & ~own
        free[open_to[np.argmin(share[open_to])]] = True


def _climbed(model: Model, point: Array, free: NDArray[np.bool_]) -> Array:
    """Return the most probable point with only some parameters free to move."""
    from charact.posterior import maximum

    if not free.any():
        return point

    def conditional(points: Array) -> Array:
        whole = np.tile(point, (len(points), 1))
        whole[:, free] = points
        return model.log_probability(whole)

    top, _ = maximum(conditional, point[free], model.prior.bounds[free])
    found = point.copy()
    found[free] = top
    return found


def _parameter(
    before: Parameter, value: float, draws: Array, *, left: float, identified: bool, carrier: bool
) -> Parameter:
    """Return one parameter of the fitted description; `left` is the share of its prior's width."""
    if not identified and not carrier:
        said = f"asked of the session's data and not identified: {left:.0%} of the prior's width is left"
        return replace(before, standing="prior", source=f"{said}; prior: {before.source}")
    low, high = (float(q) for q in np.quantile(draws, (0.025, 0.975)))
    how = "fitted to the session's data" if identified else "carries a product that the data know, fitted"
    source = f"{how}; value for the unidentified parameters at theirs; {left:.0%} of the prior's width is left"
    return Parameter(value=value, low=min(low, value), high=max(high, value), standing="fitted", source=source)


def _how(model: Model, posterior: Posterior, point: Array) -> str:
    """Return the sentence that says how the fit went."""
    numbers = sum(observed.value.size for observed in model.observed)
    chi_squared = float(model.misfit(point[None])[0])
    flags = f"; distrust: {', '.join(posterior.flags)}" if posterior.flags else ""
    return (
        f"Fitted with {len(posterior.names)} parameters to {numbers} measured numbers, chi-squared {chi_squared:.1f}, "
        f"{posterior.sampler}, seed {posterior.seed}{flags}."
    )


def _illuminance_sd(session: Session) -> float:
    """Return the relative uncertainty of the session's one light meter."""
    lit = [entry.conditions for entry in session.of_kind("flat") if entry.conditions.illuminance_lux]
    stated = [c.illuminance_relative_sd for c in lit if c.illuminance_relative_sd is not None]
    return max(stated) if stated else UNSTATED_ILLUMINANCE_SD
