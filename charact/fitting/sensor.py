"""Fit of a sensor description: from a session to the parameters of its posterior."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from charact.estimators.noise.findings import step_finding
from charact.estimators.noise.illumination import relative_sd_of
from charact.fitting.fitted_session import camera_of, per_pixel, require_noise, with_fixed_gain
from charact.fitting.model import (
    TIED,
    Model,
    convergence_findings,
    inflate_errors,
    model_of,
    most_probable,
    posterior_of,
)
from charact.fitting.observation import (
    findings_of,
    observations_of,
)
from charact.fitting.prior import (
    COMBINATIONS,
    Combination,
    prior_of,
)
from charact.fitting.stack_levels import (
    dark_rise_dn_per_s,
    levels_of,
    note_on_exclusions,
    stacks_of,
)
from charact.fitting.thresholds import LIMITS
from charact.fitting.well_evidence import FULL_WELL, ShownLevel, full_well_draws, shown_levels
from charact.frames.session_layout import layout_notes, sound_session
from labdata import Array, BadInput, Camera, Posterior, Result, Session
from labdata.camera.parameters import Draws, Parameter

# Noise and pattern of the chip, which the noise of a tube or a coarse digitiser hides: where no
# observation depends on them, a drawn camera has those of the prior.
HIDDEN = ("ccd.read_noise_e", "ccd.dark_current_e_per_s", "ccd.dsnu_e")
PLANE_NOTE = (
    "Fitted to the plane {} of a mosaic: lengths, charges and gain are those of the camera's "
    "pixels, the quantum efficiency that behind their colour filter; rows, neighbours and "
    "interference of the read-out are the plane's."
)


RISE_NOTE = (
    "The dark level rises by {:.3g} DN/s of exposure. The description subtracts dark charge (a "
    "clamp): its black level is that of the shortest dark, and simulated darks do not rise."
)


Progress = Callable[[str, float], None]
# Parameters that the systematic uncertainty of the light meter affects.
_METERED = (
    "tube.luminous_gain",
    "photocathode.luminous_sensitivity_ua_per_lm",
    "photocathode.ebi_lm_per_cm2",
    "microchannel_plate.strip_current_ua_per_cm2",
)


def fit_sensor(
    session: Session,
    result: Result,
    *,
    seed: int = 0,
    progress: Progress = lambda sentence, fraction: None,
) -> Camera:
    """Fit the session's camera description to its measurements.

    Parameters
    ----------
    session
        Session of a described camera of visible light, with a tube or without; its description
        gives the priors, its darks and flats the stack means.
    result
        Measurements of the session.
    seed
        Seed of the posterior draws.
    progress
        Called with a sentence and the fraction done.

    Returns
    -------
    Camera
        Every requested parameter has the value of the joint posterior's mode. One that the data
        identify is `fitted` (95 % range of the posterior); every other one keeps the range of its
        prior and is marked `prior`, and its value departs from the prior's only as a factor of a
        combination that the data determine. The rest is unchanged. `draws` contains the joint
        posterior of all requested parameters, with a tube without the systematic uncertainty of the
        light meter: products of parameters are better known than each of them. Frame size and bit
        depth are the session's; those of a plane of a mosaic are of the camera that has it, see
        `PLANE_NOTE`.

    Raises
    ------
    BadInput
        If the session names no camera, one of the thermal infrared, has no measurement of it, or
        stacks of several colour planes, or an automatic gain or brightness control was on in every
        dark or in every flat.
    """
    plane, pitch_px = session.sampling
    camera = camera_of(session, pitch_px)
    session, left_out = with_fixed_gain(session)
    layout, session = sound_session(session)
    result = per_pixel(result, pitch_px)
    progress("levels of darks and flats", 0.0)
    levels = levels_of(session)
    observed = observations_of(stacks_of(session, camera, result, levels))
    if not observed:
        raise BadInput(
            f"a fit needs at least one measurement that was not refused, got none in "
            f"{session.name!r}"
        )
    require_noise(session, observed)
    model, doubt = inflate_errors(model_of(camera, observed))
    progress("posterior of the sensor", 0.2)
    posterior = posterior_of(model, seed=seed)
    progress("identifying parameters", 0.9)
    lit = [
        entry.conditions for entry in session.of_kind("flat") if entry.conditions.illuminance_lux
    ]
    metered = camera.has_tube
    fitted = description_from_posterior(
        model,
        posterior,
        illuminance_relative_sd=relative_sd_of(lit, "lux")[0] if metered else 0.0,
        shown=shown_levels(session, levels),
        seed=seed,
    )
    known = (*convergence_findings(model, posterior), step_finding(session), left_out, doubt)
    findings = {
        finding.flag: finding for finding in (*findings_of(result), *known) if finding is not None
    }
    rise = 0.0 if metered else dark_rise_dn_per_s(levels)
    noted = (
        PLANE_NOTE.format(plane) if pitch_px > 1 else None,
        *layout_notes(layout),
        note_on_exclusions(session, levels),
        RISE_NOTE.format(rise) if rise else None,
        *(finding.note for finding in findings.values()),
    )
    notes = (*fitted.notes, *(note for note in noted if note))
    progress("fitted", 1.0)
    return replace(fitted, notes=notes)


def description_from_posterior(
    model: Model,
    posterior: Posterior,
    *,
    illuminance_relative_sd: float,
    seed: int,
    shown: tuple[ShownLevel, ...] = (),
) -> Camera:
    """Return the camera description of a posterior.

    `posterior`: draws in the coordinates of the model's prior; `illuminance_relative_sd`: relative
    standard uncertainty of the illuminance; widens the ranges of the parameters that depend on the
    meter; `shown`: levels that frames show, which constrain the full well.
    """
    point = _typical(model, posterior.draws)
    values = dict(
        zip(posterior.names, model.prior.parameters(point[None])[0].tolist(), strict=True)
    )
    rng = np.random.default_rng([seed, 1])
    draws = dict(zip(posterior.names, model.prior.parameters(posterior.draws).T, strict=True))
    known = model.values(posterior.draws)
    combined = tuple(
        _combination(
            combination,
            combination.product(known),
            float(combination.product(model.values(point[None]))[0]),
        )
        for combination in COMBINATIONS
        if set(combination.paths) <= set(posterior.names)
    )
    draws.update(model.tied(draws))
    values.update(
        {
            path: float(tied_values[0])
            for path, tied_values in model.tied(
                {p: np.array([v]) for p, v in values.items()}
            ).items()
        }
    )
    meter = 1.0 + illuminance_relative_sd * rng.standard_normal(len(posterior.draws))
    before = model.sensor.parameters()
    changes = {
        path: _parameter(
            before[path],
            values[path],
            drawn * meter if path in _METERED else drawn,
            _remaining_width(model.sensor, path, drawn),
            has_converged="not-converged" not in posterior.flags,
        )
        for path, drawn in draws.items()
    }
    well = full_well_draws(model.sensor, known, shown, rng)
    if well is not None:
        draws[FULL_WELL] = well
        low, value, high = (float(q) for q in np.quantile(well, (0.025, 0.5, 0.975)))
        words = "the prior, truncated below the charge that frames show; prior: "
        changes[FULL_WELL] = Parameter(
            value=value,
            low=low,
            high=high,
            standing="prior",
            source=words + before[FULL_WELL].source,
        )
    hidden = prior_of(model.sensor, tuple(path for path in HIDDEN if path not in draws))
    if hidden.names:
        free = hidden.draw(np.random.default_rng([seed, 2]), len(posterior.draws))
        draws.update(zip(hidden.names, hidden.parameters(free).T, strict=True))
    table = np.stack(list(draws.values()), axis=1)
    return replace(
        model.sensor.with_parameters(changes),
        name=f"{model.sensor.name}, fitted",
        draws=Draws(
            names=tuple(draws), values=tuple(tuple(float(f"{x:.7g}") for x in row) for row in table)
        ),
        notes=(
            *model.sensor.notes,
            _how(model, posterior, point),
            *combined,
            *_out_of_range(before, changes),
        ),
    )


def _typical(model: Model, draws: Array) -> Array:
    """Return the posterior's mode, in which a coordinate that stands at a bound of the data has its
    median.
    """
    middle, point = np.median(draws, axis=0), model.best
    probability = np.mean(draws < point, axis=0)
    is_inside = (probability > LIMITS.edge) & (probability < 1.0 - LIMITS.edge)
    return most_probable(model, np.where(is_inside, point, middle), is_inside)


def _combination(combination: Combination, drawn: Array, value: float) -> str:
    """Return the note on a product that the data determine, and its range relative to its value."""
    low, high = (float(q) / value for q in np.quantile(drawn, (0.025, 0.975)))
    first, *other_paths = combination.paths
    return (
        f"The data determine {first} only together with {', '.join(other_paths)}: the combination "
        f"is known to {low - 1.0:+.1%} to {high - 1.0:+.1%} (95 %), and its departure from the "
        "description is divided over the factors as their prior ranges allow."
    )


def _remaining_width(sensor: Camera, path: str, drawn: Array) -> float:
    """Return the posterior's standard deviation over the prior's, in the coordinate of the
    prior.
    """
    prior = prior_of(sensor, (TIED.get(path, path),))
    return float(prior.coordinates(drawn[:, None]).std(ddof=1) / prior.sd[0])


def _parameter(
    before: Parameter, value: float, draws: Array, remaining: float, *, has_converged: bool
) -> Parameter:
    """Return one parameter of the fitted description; `remaining` is the remaining fraction of its
    prior's width.
    """
    low, high = (value if end is None else end for end in (before.low, before.high))
    if not has_converged:
        standing = "not-converged"
        source = f"requested, but the chains of the fit did not converge; prior: {before.source}"
    elif remaining < LIMITS.identified:
        low, high = (float(q) for q in np.quantile(draws, (0.025, 0.975)))
        standing = "fitted"
        source = f"fitted to the session's data; {remaining:.0%} of the prior's width remains"
    else:
        standing = "prior"
        source = (
            f"requested, but not identified by the session's data: {remaining:.0%} of the prior's "
            f"width remains; prior: {before.source}"
        )
    return Parameter(
        value=value, low=min(low, value), high=max(high, value), standing=standing, source=source
    )


def _out_of_range(before: dict[str, Parameter], fitted: dict[str, Parameter]) -> Iterator[str]:
    """Yield a note on each fitted value outside the description's range, which its interval does
    not reach.
    """
    for path, p in fitted.items():
        low, high = before[path].low, before[path].high
        if low is None or high is None or p.low is None or p.high is None or p.standing != "fitted":
            continue
        if p.high < low or p.low > high:
            yield (
                f"{path} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] is outside the description's "
                f"{low:g} to {high:g}: another description, or conditions other than stated"
            )


def _how(model: Model, posterior: Posterior, point: Array) -> str:
    """Return the note that summarises the fit."""
    numbers = sum(observed.value.size for observed in model.observed)
    chi_squared = float(model.misfit(point[None])[0])
    flags = f"; flags: {', '.join(posterior.flags)}" if posterior.flags else ""
    return (
        f"Fitted with {len(posterior.names)} parameters to {numbers} measured numbers, "
        f"chi-squared {chi_squared:.1f}, {posterior.sampler}, seed {posterior.seed}{flags}."
    )
