"""Selection of blur models for an edge profile, and their weights by evidence.

Simple cores are fitted first. Extended components are scored to first order and fitted if the score
is high enough: a shape s added alone with amplitude q to a fit of residual r and design D has
q = s'(r - D x) / s'(1 - P) s, x the step that the parameters still take and P the projection on D.
The weight of model k is Z_k^t / sum Z^t, Z its evidence times prior probability and t the power of
the evidence.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import compress
from operator import attrgetter

import numpy as np

from charact.estimators.mtf.edge.fit.edge_form import KNOTS, PHASE_KNOTS, cosine_shapes
from charact.estimators.mtf.edge.fit.model_fit import (
    LINEAR,
    EdgeFit,
    EdgeFitter,
    LinearisedProfile,
    chi2_explained,
    scaled_normal,
)
from charact.estimators.mtf.edge.pixels.profile import EVEN_PER_PX, SLIGHT_PER_PX, UNEVEN_PER_PX
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.known_transfer import halo_diameters_px
from charact.inference.gauss_newton import weigh_by_evidence
from charact.method import Context
from charact.transfer.blur_model import BlurModel
from charact.transfer.cores import ON_EDGES
from charact.transfer.extended import (
    DiscComponent,
    ExtendedComponent,
    HaloComponent,
    ScatterComponent,
    UnresolvedGlareComponent,
)
from labdata import Array
from labdata.camera.description import has_tube

_evidence = attrgetter("log_evidence")


@dataclass(frozen=True, kw_only=True)
class TrialComponent:
    """An extended component of some sizes, the same for many edges.

    Its kind; sizes and other shape parameters, shape (size, parameter); fraction of the light for a
    fraction parameter of one, shape (size,); its transfer less one, shape (size, node).
    """

    component: ExtendedComponent
    shapes: Array
    unit: Array
    change: Array

    def bayes_factor(self, amplitude: Array, precision: Array) -> float:
        """Return the mean over sizes and fractions of the evidence for such light over that for
        none.

        Parameters
        ----------
        amplitude, precision
            Gaussian estimate of the fraction at each size, shape (size,).

        Notes
        -----
        The mean over fractions q of exp(a q p - q^2 p / 2).
        """
        low, high = self.component.fraction
        fractions = self.unit[:, None] * (low + (high - low) * (np.arange(100) + 0.5) / 100)
        gain = precision[:, None] * fractions * (amplitude[:, None] - 0.5 * fractions)
        sizes = self.shapes[:, 0]
        return float(np.exp(np.minimum(gain, 50.0)).mean(axis=1) @ sizes / sizes.sum())


@lru_cache(maxsize=64)
def _trial_component(component: ExtendedComponent, grid_bytes: bytes) -> TrialComponent:
    """Return an extended component of some sizes on the nodes of the transfer."""
    bounds = np.array([bound for _, bound in component.parameters.values()])
    sizes = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** np.linspace(
        0.05, 0.95, ACCURACY.component_sizes
    )
    tail_shapes = np.array([[0.1], [0.9]]) if len(bounds) > 2 else np.zeros((1, 0))
    shapes = np.array([[size, *other] for other in tail_shapes for size in sizes])
    change = component.transfer(np.frombuffer(grid_bytes), shapes) - 1.0
    return TrialComponent(
        component=component, shapes=shapes, unit=component.share_unit(shapes)[:, 0], change=change
    )


@dataclass(frozen=True, kw_only=True)
class ExtendedComponentScore:
    """What an extended component may gain over a fitted core, to first order.

    Parameters
    ----------
    core, component
        The core as fitted, under the prior of the illumination's slopes in question, and the
        component.
    gains
        Of chi squared by each size, shape (size,); a negative component gains nothing.
    odds
        Bayes factor for a component of any fraction and size.
    ln_weight
        ln of its prior probability over that of none.
    starts
        Where a fit with each size begins, shape (size, parameter); the size is the first after the
        fraction.
    sizes
        The sizes, px, shape (size,).
    """

    core: EdgeFit
    component: ExtendedComponent
    gains: Array
    odds: float
    ln_weight: float
    starts: Array
    sizes: Array

    @property
    def log_evidence(self) -> float:
        """ln of the evidence of the core with such a component, to first order."""
        return self.core.log_evidence + float(np.log(max(self.odds, 1e-300))) + self.ln_weight


def score_extended_components(
    fitter: EdgeFitter,
    fit: EdgeFit,
    components: tuple[ExtendedComponent, ...],
    least_gains: Mapping[float, float],
) -> list[ExtendedComponentScore]:
    """Return what each extended component may gain; before the data all together are as likely as
    none.

    Parameters
    ----------
    least_gains
        For each prior of the illumination's slopes in question the gain of chi squared that counts.
    """
    if not components:
        return []
    maps = fitter.maps
    trials = [_trial_component(component, maps.grid.tobytes()) for component in components]
    core = fit.family.modulus(fit.point[None, 1:], maps.grid)
    shapes = maps.transfers(
        core * np.concatenate([trial.change for trial in trials]), float(fit.point[0])
    )
    white = shapes @ maps.white * abs(fitter.profile.step)
    scores = []
    for slope, least_gain in least_gains.items():
        own_fit = fitter.under(fit, slope)
        scale = abs(fitter.profile.step) / own_fit.at.amplitude[0]
        amplitude, precision, shifts = _amplitudes_to_add(own_fit.at, white)
        amplitude, precision = amplitude * scale, precision / scale**2
        gains = np.where(amplitude > 0, amplitude * (amplitude * precision), 0.0)
        first = 0
        for trial in trials:
            of_trial = slice(first, first := first + len(trial.shapes))
            if gains[of_trial].max() < least_gain:
                continue
            # Half a step of the core: what the component changes is not small.
            points = np.clip(own_fit.point + 0.5 * shifts[of_trial], *own_fit.form.bounds.T)
            shares = np.minimum(
                np.clip(amplitude[of_trial], 0.02, 0.3) / trial.unit, trial.component.fraction[1]
            )
            score = ExtendedComponentScore(
                core=own_fit,
                component=trial.component,
                gains=gains[of_trial],
                odds=trial.bayes_factor(amplitude[of_trial], precision[of_trial]),
                ln_weight=-float(np.log(len(trials))),
                starts=np.concatenate([points, shares[:, None], trial.shapes], axis=1),
                sizes=trial.shapes[:, 0],
            )
            scores.append(score)
    return scores


def _amplitudes_to_add(at: LinearisedProfile, shapes: Array) -> tuple[Array, Array, Array]:
    """Return the amplitude of each whitened shape (shape, bin) added alone to a fit, to first
    order, and its precision.

    Also how far it moves each parameter, shape (shape, parameter).
    """
    normal, scale = scaled_normal(at.design, at.precision, 1e-12)
    inverse = np.linalg.inv(normal)
    pull = (at.design @ at.residual + at.precision * at.off) / scale
    onto = shapes @ at.design.T / scale
    through = onto @ inverse
    powers = np.sum(shapes**2, axis=1)
    # What the fit can do itself all but for rounding has no amplitude of its own.
    power = np.maximum(powers - np.sum(through * onto, axis=1), 1e-12 * powers + 1e-300)
    amplitude = (shapes @ at.residual - through @ pull) / power
    shifts = (inverse @ pull - through * amplitude[:, None]) / scale
    return amplitude, power, shifts[:, :-LINEAR]


def fit_extended_component(
    fitter: EdgeFitter, score: ExtendedComponentScore, hopeless_cost: float
) -> EdgeFit | None:
    """Fit a core with a component, from the best size and another far from it; None where both
    begin hopelessly.
    """
    order = np.argsort(-score.gains)
    family, slope = (
        BlurModel(core=score.core.family.core, wide=score.component),
        score.core.slope_sd_per_px,
    )
    sizes = np.log(score.sizes[order])
    distant = order[np.abs(sizes - sizes[0]) > ACCURACY.size_separation]
    begun = [
        fitter.optimise(family, score.starts[i], slope, ACCURACY.first_iterations)
        for i in (order[0], *distant[:1])
    ]
    best = min(begun, key=lambda optimum: optimum.at.cost)
    return (
        None
        if best.at.cost > hopeless_cost
        else fitter.fit(family, best.point, slope, score.ln_weight)
    )


def exceeds_model(
    fitter: EdgeFitter, fit: EdgeFit, deviations: float = THRESHOLDS.departure_sd
) -> bool:
    """Tell whether smooth departures of modulus and phase gain more chi squared, to first order,
    than noise allows.
    """
    maps = fitter.maps
    transfer = maps.transfers(
        fit.family.modulus(fit.point[None, 1:], maps.grid), float(fit.point[0])
    )[0]
    real, imaginary = np.split(transfer, 2)
    ratio = maps.grid / np.exp(fit.point[1])
    modulus, phase = cosine_shapes(ratio, KNOTS), cosine_shapes(ratio, PHASE_KNOTS)
    shapes = np.block([[modulus * real, modulus * imaginary], [-phase * imaginary, phase * real]])
    white = shapes @ maps.white * abs(fitter.profile.step)
    gain = chi2_explained(fit.at, white) - chi2_explained(fit.at)
    return gain > len(white) + deviations * np.sqrt(2.0 * len(white))


@dataclass(frozen=True, kw_only=True)
class EvidenceWeightedModels:
    """A fitted form with its weight by evidence."""

    fit: EdgeFit
    weight: float


def candidate_components(
    context: Context, half_width_px: float, *, transposed: bool
) -> tuple[ExtendedComponent, ...]:
    """Return the extended components that a window can show."""
    if has_tube(context.camera):
        low, high = halo_diameters_px(context, transposed=transposed)
        return (HaloComponent(size_px=(low, high)),) if half_width_px >= 0.6 * high else ()
    components: list[ExtendedComponent] = [
        UnresolvedGlareComponent(size_px=(0.5 * half_width_px, 4.0 * half_width_px))
    ]
    if half_width_px >= THRESHOLDS.min_window_disc_px:
        components.append(DiscComponent(size_px=(6.0, 2.0 * half_width_px)))
    if half_width_px >= THRESHOLDS.min_window_halo_px:
        components.append(HaloComponent(size_px=(6.0, 2.0 * half_width_px)))
        components.append(ScatterComponent(size_px=(2.0, 0.25 * half_width_px)))
    return tuple(components)


def fit_blur_models(
    fitter: EdgeFitter, components: tuple[ExtendedComponent, ...]
) -> list[EvidenceWeightedModels]:
    """Fit the models that the data may require, simple ones first, and return them, the most
    probable first.
    """
    fits = _fit_cores_and_components(fitter, components, EVEN_PER_PX)
    fits = _best_of_each([*fits, *_fits_with_gradients(fitter, fits)])
    likeliest = max(fits, key=_evidence)
    if likeliest.slope_sd_per_px > EVEN_PER_PX:
        # What was given up as hopeless in even light may be what the slopes stand for.
        fits = _best_of_each(
            [*fits, *_fit_cores_and_components(fitter, components, likeliest.slope_sd_per_px)]
        )
    fits = _best_of_each([*fits, *_fits_with_unresolved_glare(fitter, fits, components)])
    weights = weigh_by_evidence(
        [fit.log_evidence for fit in fits],
        power=THRESHOLDS.evidence_power,
        min_weight=THRESHOLDS.min_model_weight,
    )
    return [EvidenceWeightedModels(fit=fits[index], weight=weight) for index, weight in weights]


def _fit_cores_and_components(
    fitter: EdgeFitter, components: tuple[ExtendedComponent, ...], slope_sd_per_px: float
) -> list[EdgeFit]:
    """Fit cores alone, then with the extended components that may gain, under one prior of the
    gradients.
    """
    fits = _fit_cores(fitter, slope_sd_per_px)
    best = max(fits[:2], key=_evidence)
    competitive = best.log_evidence - THRESHOLDS.competitive_ln_evidence
    min_evidence = max(map(_evidence, fits)) - THRESHOLDS.competitive_ln_evidence
    # A component next to a Moffat only where wings are likelier than none: it explains them a
    # second time.
    wings = best.family.core != "gaussian" and fits[2].log_evidence > competitive
    pursued = [
        *(fits[:3] if wings else fits[:2]),
        *(fit for fit in fits[3:] if fit.log_evidence > min_evidence),
    ]
    least_gains = {UNEVEN_PER_PX: THRESHOLDS.component_in_gradient_chi2, slope_sd_per_px: 0.0}
    scores = [
        scored
        for core in pursued
        for scored in score_extended_components(fitter, core, components, least_gains)
    ]
    of_same_slope = [scored.core.slope_sd_per_px == slope_sd_per_px for scored in scores]
    chosen = _components_worth_fitting(list(compress(scores, of_same_slope)))
    already = {(scored.core.family, scored.component) for scored in chosen}
    # A halo and a gradient may hide each other.
    in_other_light = compress(scores, np.logical_not(of_same_slope))
    hidden = [
        scored
        for scored in in_other_light
        if (scored.core.family, scored.component) not in already
        and scored.log_evidence > competitive
    ]
    for score in sorted([*chosen, *hidden], key=lambda scored: components.index(scored.component)):
        fit = fit_extended_component(
            fitter, score, min(fit.cost for fit in fits) + THRESHOLDS.max_start_chi2
        )
        fits = fits if fit is None else [*fits, fit]
    return fits


def _fit_cores(fitter: EdgeFitter, slope_sd_per_px: float) -> list[EdgeFit]:
    """Fit a Gaussian, a tube's core, a Moffat and pupils, each from shift and half frequency of the
    one before.
    """
    guess = fitter.guess()
    fits: list[EdgeFit] = []

    def fit_core(core: str, former: EdgeFit | None) -> None:
        family = BlurModel(core=core)
        start = np.concatenate([[0.0], family.start(np.log(guess))])
        start[:2] = start[:2] if former is None else former.point[:2]
        fits.append(fitter.fit(family, start, slope_sd_per_px))

    for core in ON_EDGES:
        fit_core(core, fits[-1] if fits else None)
    best = max(fits, key=_evidence)
    lens = fits[ON_EDGES.index("airy")]
    lens_like = lens.log_evidence > best.log_evidence - THRESHOLDS.competitive_ln_evidence
    if lens_like or exceeds_model(fitter, best, THRESHOLDS.pupil_departure_sd):
        fit_core("pupil", best)
    return fits


def _components_worth_fitting(scores: list[ExtendedComponentScore]) -> list[ExtendedComponentScore]:
    """Return all scores that the edge can measure, and the likeliest of those it cannot.

    An edge too weak to show a component leaves it as likely as it was: one stands for all of that.
    """
    measurable = [score for score in scores if score.gains.max() >= THRESHOLDS.component_chi2]
    unmeasurable = [score for score in scores if score.gains.max() < THRESHOLDS.component_chi2]
    best = max((score.core.log_evidence for score in scores), default=0.0)
    likely = np.array(
        [score.odds * np.exp(score.core.log_evidence - best) for score in unmeasurable]
    )
    if not likely.sum() > THRESHOLDS.component_bayes_factor:
        return measurable
    stands_for = float(np.log(likely.sum() / likely.max()))
    likeliest = unmeasurable[int(np.argmax(likely))]
    return [*measurable, replace(likeliest, ln_weight=likeliest.ln_weight + stands_for)]


def _best_of_each(fits: list[EdgeFit]) -> list[EdgeFit]:
    """Return the best fit of each form: one form fitted twice must not count twice."""
    best: dict[tuple[BlurModel, float], EdgeFit] = {}
    for fit in fits:
        key = fit.family, fit.slope_sd_per_px
        if key not in best or fit.cost < best[key].cost:
            best[key] = fit
    return list(best.values())


def _fits_with_gradients(fitter: EdgeFitter, fits: list[EdgeFit]) -> list[EdgeFit]:
    """Fit again the models that an illumination gradient would make probable; a gradient may hide
    behind wings.
    """
    asked = [
        fitter.under(fit, slope)
        for fit in fits
        for slope in (SLIGHT_PER_PX, UNEVEN_PER_PX)
        if slope != fit.slope_sd_per_px
    ]
    min_evidence = max(map(_evidence, [*fits, *asked])) - THRESHOLDS.gradient_ln_evidence
    return [
        fitter.fit(refit.family, refit.point, refit.slope_sd_per_px, refit.ln_weight)
        for refit in asked
        if refit.log_evidence > min_evidence
    ]


def _fits_with_unresolved_glare(
    fitter: EdgeFitter, fits: list[EdgeFit], components: tuple[ExtendedComponent, ...]
) -> list[EdgeFit]:
    """Fit glare wider than the window to what was taken for an illumination gradient, where both
    sides rise.
    """
    veils = [prior for prior in components if isinstance(prior, UnresolvedGlareComponent)]
    sloped = [fit for fit in fits if fit.slope_sd_per_px > EVEN_PER_PX and fit.family.wide is None]
    rising = [fit for fit in sloped if fitter.side_slopes(fit).min() > 0]
    if not veils or not rising:
        return []
    best, veil = max(rising, key=_evidence), veils[0]
    widest = veil.size_px[1]
    # The edge spread of a Gaussian rises by 1 / (sqrt(2 pi) sigma) at its middle.
    fraction = min(
        float(fitter.side_slopes(best).min() / best.at.amplitude[0])
        * np.sqrt(2.0 * np.pi)
        * widest,
        0.3,
    )
    start = np.concatenate([best.point, [fraction, 0.5 * widest]])
    return [
        fitter.fit(
            BlurModel(core=best.family.core, wide=veil),
            start,
            UNEVEN_PER_PX,
            -float(np.log(len(components))),
        )
    ]
