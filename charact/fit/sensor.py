"""From a session's measurements to a sensor description: what the data identify is fitted, the rest stays a prior."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.fit.degenerate_products import distribute_product
from charact.fit.full_well import PATH as FULL_WELL
from charact.fit.full_well import fills_the_scale, full_well_draws
from charact.fit.levels import levels_of
from charact.fit.model import Model, inflate_errors, model_of, most_probable, posterior_of
from charact.fit.observations import observations
from charact.noise.snr.stated_illumination import UNSTATED_ILLUMINANCE_SD
from labdata.camera_description import Parameter
from labdata.errors import BadInput
from labdata.measurement import Posterior, Result
from labdata.sensor import Draws, Sensor
from labdata.session import Session

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

# A parameter is identified when the data leave less than this share of its prior's standard deviation.
IDENTIFIED_SHARE = 0.7
# The description's own values must reproduce the data this well, in units of chi-squared above the best there is.
WORST_MISFIT = 1.0
# Parameters that the light meter's one error goes into.
_METERED = (
    "tube.luminous_gain",
    "photocathode.luminous_sensitivity_ua_per_lm",
    "photocathode.ebi_lm_per_cm2",
    "microchannel_plate.strip_current_ua_per_cm2",
)


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
        posterior of all that were asked, for the light meter's reading as it stands: products of parameters are known
        better than each of them.

    Raises
    ------
    BadInput
        If the session names no sensor, one without interlaced analog video, or holds nothing that speaks of one.
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
    progress("choosing what the data identify", 0.9)
    fitted = description_from_posterior(
        model,
        posterior,
        illuminance_relative_sd=_illuminance_sd(session),
        scale_filled=fills_the_scale(session),
        seed=seed,
    )
    if doubt:
        fitted = replace(fitted, notes=(*fitted.notes, doubt))
    progress("fitted", 1.0)
    return fitted


def description_from_posterior(
    model: Model, posterior: Posterior, *, illuminance_relative_sd: float, seed: int, scale_filled: bool = False
) -> Sensor:
    """Return the sensor description that a posterior amounts to.

    Parameters
    ----------
    posterior
        Draws in the coordinates of the model's prior.
    illuminance_relative_sd
        Relative standard uncertainty of the illuminance; widens the ranges of what is tied to the meter.
    seed
        Seed of what the draws alone do not fix.
    scale_filled
        Whether frames reach full scale, which the full well then allows.
    """
    left = dict(zip(posterior.names, posterior.draws.std(axis=0, ddof=1) / model.prior.sd, strict=True))
    point, carriers = _consistent(model, posterior, left)
    values = dict(zip(posterior.names, model.prior.parameters(point[None])[0], strict=True))
    rng = np.random.default_rng([seed, 1])
    draws = _all_draws(model, posterior, rng)
    meter = 1.0 + illuminance_relative_sd * rng.standard_normal(len(posterior.draws))
    before = model.sensor.parameters()
    changes = {
        path: _parameter(
            before[path],
            values.get(path),
            drawn * meter if path in _METERED else drawn,
            left.get(path, 1.0),
            path in carriers,
        )
        for path, drawn in draws.items()
    }
    well = full_well_draws(model.sensor, draws, rng) if scale_filled else None
    if well is not None:
        draws[FULL_WELL] = well
        changes[FULL_WELL] = _full_well_parameter(before[FULL_WELL], well)
    table = np.stack(list(draws.values()), axis=1)
    return replace(
        model.sensor.with_parameters(changes),
        name=f"{model.sensor.name}, fitted",
        draws=Draws(names=tuple(draws), values=tuple(tuple(float(f"{x:.7g}") for x in row) for row in table)),
        notes=(*model.sensor.notes, _how(model, posterior, point)),
    )


def _all_draws(model: Model, posterior: Posterior, rng: np.random.Generator) -> dict[str, Array]:
    """Return the posterior's draws by path, products shared out among their factors."""
    draws = dict(zip(posterior.names, model.prior.parameters(posterior.draws).T, strict=True))
    for product in model.products:
        draws.update(distribute_product(model.sensor, product, draws[product.carrier], rng))
    return draws


def _consistent(model: Model, posterior: Posterior, left: dict[str, float]) -> tuple[Array, set[str]]:
    """Return one point that agrees with the data while every parameter not fitted stands at its prior value.

    Where the data know only a combination, none of its parameters need be identified; the one they tell most of is
    then fitted too, and named in the second result.
    """
    share = np.array([left[name] for name in posterior.names])
    best = most_probable(model, np.median(posterior.draws, axis=0), np.ones(share.size, bool))
    allowed = float(model.misfit(best[None])[0]) + WORST_MISFIT
    free = share < IDENTIFIED_SHARE
    own = free.copy()
    while True:
        point = most_probable(model, np.where(free, best, model.prior.centre), free)
        if float(model.misfit(point[None])[0]) <= allowed or free.all():
            return point, {name for name, one in zip(posterior.names, free & ~own, strict=True) if one}
        held = np.flatnonzero(~free)
        free[held[np.argmin(share[held])]] = True


def _parameter(before: Parameter, value: float | None, draws: Array, left: float, carrier: bool) -> Parameter:
    """Return one parameter of the fitted description; `left` is the share of its prior's width."""
    if value is None:
        said = "asked of the session's data, which know only its product with others"
        return replace(before, standing="prior", source=f"{said}; prior: {before.source}")
    if left >= IDENTIFIED_SHARE and not carrier:
        said = f"asked of the session's data and not identified: {left:.0%} of the prior's width is left"
        return replace(before, standing="prior", source=f"{said}; prior: {before.source}")
    low, high = (float(q) for q in np.quantile(draws, (0.025, 0.975)))
    how = "carries a combination that the session's data know" if carrier else "fitted to the session's data"
    source = f"{how}; value for the unidentified parameters at theirs; {left:.0%} of the prior's width is left"
    return Parameter(value=value, low=min(low, value), high=max(high, value), standing="fitted", source=source)


def _full_well_parameter(before: Parameter, draws: Array) -> Parameter:
    """Return the full well of a camera that is known to fill its scale."""
    low, value, high = (float(q) for q in np.quantile(draws, (0.025, 0.5, 0.975)))
    source = f"the prior, cut off below what fills the scale, which frames reach; prior: {before.source}"
    return Parameter(value=value, low=low, high=high, standing="prior", source=source)


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
