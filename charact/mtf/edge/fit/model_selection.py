"""Which forms of the point spread an edge's profile asks for: fitted simple ones first, weighed by their evidence."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.blur_models.one_dimensional import (
    BlurModel,
    Core,
    DiscComponent,
    ExtendedComponent,
    HaloComponent,
    ScatterComponent,
    UnresolvedGlareComponent,
)
from charact.mtf.edge.fit.extended_component_score import (
    ExtendedComponentScore,
    departure_gain,
    fit_extended_component,
    score_extended_components,
)
from charact.mtf.edge.fit.model_fit import BlurModelFit, BlurModelFitter
from charact.mtf.edge.forward_model import departure_shapes
from charact.mtf.edge.pixels.illumination_gradient import EVEN_PER_PX, SLIGHT_PER_PX, UNEVEN_PER_PX
from charact.mtf.known_transfer import halo_diameters_px

Array = NDArray[np.float64]

# Cores that are fitted after a Gaussian, each from where the one before led.
CORES: tuple[Core, ...] = ("exponential", "moffat", "airy")
# Departures from the likeliest of these, in standard deviations of what noise leaves them, from which on a pupil out of
# focus or with a hole is fitted.
PUPIL_SD = 1.0
# A form this much less probable than the best, as a share, adds nothing to the draws.
MIN_FRACTION = 0.02
# Power of the evidence by which forms are weighed: none of them is the blur itself, and the noise is an estimate too
# (power likelihoods: Gruenwald & van Ommen 2017, doi 10.1214/17-BA1085).
TEMPERED = 0.7
# Gain in chi squared from which on wide light is worth a fit of its own, and odds from which on it is with less.
WORTH_CHI2, WORTH_ODDS = 6.0, 0.6
# Gain from which on it is worth one where only slopes of the light make room for it.
WORTH_IN_SLOPES_CHI2 = 3.0
# Forms within this of the best in ln of the evidence are worth pursuing.
CLOSE = 8.0
# Half width from which a window tells a disc of light from the core, and a halo's profile or glare from a disc.
MIN_FOR_DISC_PX, MIN_FOR_HALO_PX = 6.0, 16.0
# Light that slopes is tried with forms that would come within this of the best.
SLOPED = 4.0
# A fit that began this much worse than the best in chi squared is not carried on.
HOPELESS = 100.0
# Chi squared that smooth departures of any size may take, in standard deviations of what noise leaves them.
DEPARTURE_SD = 4.5


@dataclass(frozen=True, kw_only=True)
class EvidenceWeightedModels:
    """A fitted form with its share of the evidence."""

    fit: BlurModelFit
    share: float


def candidate_components(context: Context, half_width_px: float, *, transposed: bool) -> tuple[ExtendedComponent, ...]:
    """Return what light beyond the core the window can show."""
    if context.sensor is not None:
        low, high = halo_diameters_px(context, transposed=transposed)
        return (HaloComponent(size_px=(low, high)),) if half_width_px >= 0.6 * high else ()
    found: list[ExtendedComponent] = [UnresolvedGlareComponent(size_px=(0.5 * half_width_px, 4.0 * half_width_px))]
    if half_width_px >= MIN_FOR_DISC_PX:
        found.append(DiscComponent(size_px=(6.0, 2.0 * half_width_px)))
    if half_width_px >= MIN_FOR_HALO_PX:
        found.append(HaloComponent(size_px=(6.0, 2.0 * half_width_px)))
        found.append(ScatterComponent(size_px=(2.0, 0.25 * half_width_px)))
    return tuple(found)


def fit_blur_models(fitter: BlurModelFitter, wide: tuple[ExtendedComponent, ...]) -> list[EvidenceWeightedModels]:
    """Fit the forms that the data may ask for, simple ones first, and return them, the most probable first."""
    found = _fit_cores_and_components(fitter, wide, EVEN_PER_PX)
    found = _best_of_each([*found, *_fits_with_gradients(fitter, found)])
    likeliest = max(found, key=_evidence)
    if likeliest.slope_sd_per_px > EVEN_PER_PX:
        # What was given up as hopeless in even light may be what the slopes stand for.
        found = _best_of_each([*found, *_fit_cores_and_components(fitter, wide, likeliest.slope_sd_per_px)])
    return _weight_by_evidence(_best_of_each([*found, *_fits_with_unresolved_glare(fitter, found, wide)]))


def _fit_cores_and_components(
    fitter: BlurModelFitter, wide: tuple[ExtendedComponent, ...], slope_sd_per_px: float
) -> list[BlurModelFit]:
    """Fit the cores, then light beyond those that may have it, under one prior of the light's slopes."""
    found = _fit_cores(fitter, slope_sd_per_px)
    best = max(found[:2], key=_evidence)
    # Light beyond a Moffat is asked for only where wings are likelier than none: it explains them a second time.
    wings = best.family.core != "gaussian" and found[2].log_evidence > best.log_evidence - CLOSE
    lenses = [fit for fit in found[3:] if fit.log_evidence > max(map(_evidence, found)) - CLOSE]
    pursued = [*(found[:3] if wings else found[:2]), *lenses]
    least_gains = {UNEVEN_PER_PX: WORTH_IN_SLOPES_CHI2, slope_sd_per_px: 0.0}
    promised = [one for core in pursued for one in score_extended_components(fitter, core, wide, least_gains)]
    own = _components_worth_fitting([one for one in promised if one.core.slope_sd_per_px == slope_sd_per_px])
    hidden = _components_masked_by_gradients(
        [one for one in promised if one.core.slope_sd_per_px != slope_sd_per_px], own, best
    )
    for promise in sorted([*own, *hidden], key=lambda one: wide.index(one.wide)):
        fit = fit_extended_component(fitter, promise, min(fit.cost for fit in found) + HOPELESS)
        found = found if fit is None else [*found, fit]
    return found


def _fit_cores(fitter: BlurModelFitter, slope_sd_per_px: float) -> list[BlurModelFit]:
    """Fit a Gaussian, a tube's form, a Moffat and lenses, each from where the one before led."""
    guess = fitter.guess()
    found = [fitter.fit(BlurModel(core="gaussian"), _start("gaussian", guess), slope_sd_per_px)]
    for core in CORES:
        found.append(_next_core(fitter, core, found[-1], guess))
    best = max(found, key=_evidence)
    lens_like = found[-1].log_evidence > best.log_evidence - CLOSE
    return (
        [*found, _next_core(fitter, "pupil", best, guess)]
        if lens_like or _exceeds_model_by(fitter, best, PUPIL_SD)
        else found
    )


def _components_masked_by_gradients(
    promised: list[ExtendedComponentScore], own: list[ExtendedComponentScore], best: BlurModelFit
) -> list[ExtendedComponentScore]:
    """Return the light beyond a core that only slopes make room for: a halo and slopes may hide each other.

    Parameters
    ----------
    promised
        What is promised under slopes.
    own, best
        What is fitted without them, and the likeliest core.
    """
    already = {(one.core.family, one.wide) for one in own}
    return [
        one
        for one in promised
        if (one.core.family, one.wide) not in already and one.log_evidence > best.log_evidence - CLOSE
    ]


def _components_worth_fitting(promised: list[ExtendedComponentScore]) -> list[ExtendedComponentScore]:
    """Return the light beyond a core that is worth a fit: all that the edge tells, and the likeliest of what it cannot.

    An edge too weak to tell light beyond the core leaves it as likely as it was: one stands for all of that.
    """
    told = [one for one in promised if one.gains.max() >= WORTH_CHI2]
    rest = [one for one in promised if one.gains.max() < WORTH_CHI2]
    best = max((one.core.log_evidence for one in promised), default=0.0)
    likely = np.array([one.odds * np.exp(one.core.log_evidence - best) for one in rest])
    if not likely.sum() > WORTH_ODDS:
        return told
    likeliest = rest[int(np.argmax(likely))]
    stands_for = float(np.log(likely.sum() / likely.max()))
    return [*told, replace(likeliest, ln_weight=likeliest.ln_weight + stands_for)]


def _start(core: Core, half_frequency_cy_per_px: float) -> Array:
    return np.concatenate([[0.0], BlurModel(core=core).start(half_frequency_cy_per_px)])


def _next_core(
    fitter: BlurModelFitter, core: Core, near: BlurModelFit, half_frequency_cy_per_px: float
) -> BlurModelFit:
    """Fit a core from the shift and half frequency of another."""
    start = _start(core, half_frequency_cy_per_px)
    start[:2] = near.point[:2]
    return fitter.fit(BlurModel(core=core), start, near.slope_sd_per_px)


def _evidence(fit: BlurModelFit) -> float:
    return fit.log_evidence


def _best_of_each(fits: list[BlurModelFit]) -> list[BlurModelFit]:
    """Return the likeliest fit of each form: one form fitted twice must not count twice."""
    best: dict[tuple[BlurModel, float], BlurModelFit] = {}
    for fit in fits:
        key = fit.family, fit.slope_sd_per_px
        if key not in best or fit.cost < best[key].cost:
            best[key] = fit
    return list(best.values())


def _fits_with_gradients(fitter: BlurModelFitter, found: list[BlurModelFit]) -> list[BlurModelFit]:
    """Fit again the forms that uneven light would make probable.

    All of them are asked: light that slopes on both sides may hide behind wings or a halo fitted to it.
    """
    asked = [
        fitter.under(fit, slope)
        for fit in found
        for slope in (SLIGHT_PER_PX, UNEVEN_PER_PX)
        if slope != fit.slope_sd_per_px
    ]
    least = max(map(_evidence, [*found, *asked])) - SLOPED
    return [
        fitter.fit(one.family, one.point, one.slope_sd_per_px, one.ln_weight)
        for one in asked
        if one.log_evidence > least
    ]


def _fits_with_unresolved_glare(
    fitter: BlurModelFitter, found: list[BlurModelFit], wide: tuple[ExtendedComponent, ...]
) -> list[BlurModelFit]:
    """Fit light wider than the window to what was taken for uneven light, where it rises on both sides."""
    veils = [prior for prior in wide if isinstance(prior, UnresolvedGlareComponent)]
    sloped = [fit for fit in found if fit.slope_sd_per_px > EVEN_PER_PX and fit.family.wide is None]
    rising = [fit for fit in sloped if fitter.side_slopes(fit).min() > 0]
    if not veils or not rising:
        return []
    best, veil = max(rising, key=_evidence), veils[0]
    widest = veil.size_px[1]
    # The edge spread of a Gaussian rises by 1 / (sqrt(2 pi) sigma) at its middle.
    share = min(float(fitter.side_slopes(best).min() / best.amplitude[0]) * np.sqrt(2.0 * np.pi) * widest, 0.3)
    start = np.concatenate([best.point, [share, 0.5 * widest]])
    return [fitter.fit(BlurModel(core=best.family.core, wide=veil), start, UNEVEN_PER_PX, -float(np.log(len(wide))))]


def _weight_by_evidence(found: list[BlurModelFit]) -> list[EvidenceWeightedModels]:
    evidence = np.array([fit.log_evidence for fit in found])
    share = np.exp(TEMPERED * (evidence - evidence.max()))
    share /= share.sum()
    return [
        EvidenceWeightedModels(fit=found[i], share=float(share[i]))
        for i in np.argsort(-share)
        if share[i] > MIN_FRACTION
    ]


def exceeds_model(fitter: BlurModelFitter, fit: BlurModelFit) -> bool:
    """Tell whether smooth departures from the form would take more chi squared than noise leaves them."""
    return _exceeds_model_by(fitter, fit, DEPARTURE_SD)


def _exceeds_model_by(fitter: BlurModelFitter, fit: BlurModelFit, deviations: float) -> bool:
    gain, count = departure_gain(fitter, fit, departure_shapes)
    return gain > count + deviations * np.sqrt(2.0 * count)
