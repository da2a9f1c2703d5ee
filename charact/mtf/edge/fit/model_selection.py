"""Selection of blur models for an edge profile, and their weights by evidence.

Simple cores are fitted first. Extended components are scored to first order and fitted if the score is high enough.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit
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
from charact.mtf.edge.fit.gauss_newton import amplitudes, chi2_explained
from charact.mtf.edge.fit.model_fit import BlurModelFit, BlurModelFitter
from charact.mtf.edge.forward_model import departure_shapes
from charact.mtf.edge.pixels.profile import EVEN_PER_PX, SLIGHT_PER_PX, UNEVEN_PER_PX
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.known_transfer import halo_diameters_px

Array = NDArray[np.float64]

Departures = Callable[[Array, float], NDArray[np.complex128]]

# Fractions over which the evidence is summed, and the largest exponent of a term.
SHARES, LARGEST = 100, 50.0


@dataclass(frozen=True, kw_only=True)
class ExtendedComponentScore:
    """What light beyond a core may gain.

    Parameters
    ----------
    core, wide
        The core as it was fitted, under the prior of the light's slopes that is asked about, and the light beyond it.
    gains
        Of chi squared by each size, to first order, shape (size,); light that would have to be taken away gains
        nothing.
    odds
        Evidence for such light of any share and size over that for none, to first order.
    ln_weight
        ln of its probability before the data over that of none.
    points, shares, shapes
        Where a fit with each size begins: the core's parameters, the share of light and its shape, shapes
        (size, parameter), (size,) and (size, shape).
    """

    core: BlurModelFit
    wide: ExtendedComponent
    gains: Array
    odds: float
    ln_weight: float
    points: Array
    shares: Array
    shapes: Array

    @property
    def log_evidence(self) -> float:
        """ln of the evidence of the core with such light, to first order."""
        return self.core.log_evidence + float(np.log(max(self.odds, ACCURACY.min_bayes_factor))) + self.ln_weight

    def start(self, size: int) -> Array:
        """Return where a fit with one of the sizes begins."""
        return np.concatenate([self.points[size], self.shares[size, None], self.shapes[size]])


@dataclass(frozen=True, kw_only=True)
class ComponentFit:
    """Light beyond the core of some sizes, the same for many edges.

    Parameters
    ----------
    wide
        Its kind.
    shapes
        Its sizes and what else shapes it, shape (size, parameter).
    unit
        Share of light for a share of one in its parameters, shape (size,).
    change
        Its transfer less one, shape (size, node).
    """

    wide: ExtendedComponent
    shapes: Array
    unit: Array
    change: Array


@lru_cache(maxsize=64)
def trial_components(wide: ExtendedComponent, grid_bytes: bytes) -> ComponentFit:
    """Return light of some sizes beyond the core, on the nodes of the transfer."""
    bounds = np.array([bound for _, bound in wide.parameters.values()])
    sizes = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** np.linspace(0.05, 0.95, ACCURACY.component_sizes)
    others = np.array([[0.1], [0.9]]) if len(bounds) > 2 else np.zeros((1, 0))
    shapes = np.array([[size, *other] for other in others for size in sizes])
    change = wide.transfer(np.frombuffer(grid_bytes), shapes) - 1.0
    return ComponentFit(wide=wide, shapes=shapes, unit=wide.share_unit(shapes)[:, 0], change=change)


def score_extended_components(
    fitter: BlurModelFitter,
    fit: BlurModelFit,
    components: tuple[ExtendedComponent, ...],
    least_gains: Mapping[float, float],
) -> list[ExtendedComponentScore]:
    """Return what each kind of light beyond a core may gain; before the data all are together as likely as none.

    Parameters
    ----------
    least_gains
        For each prior of the illumination's slopes that is asked about the gain of chi squared that is worth telling.
    """
    if not components:
        return []
    maps, step = fitter.maps, abs(fitter.profile.step)
    asked = [trial_components(wide, maps.grid.tobytes()) for wide in components]
    core = maps.shift_transfers(fit.family.modulus(fit.point[None, 1:], maps.grid), float(fit.point[0]))
    away = maps.white(core * np.concatenate([one.change for one in asked])) * step
    return [
        promise
        for slope, least_gain in least_gains.items()
        for promise in _score_components(fitter, fitter.under(fit, slope), asked, away, least_gain)
    ]


def _score_components(
    fitter: BlurModelFitter, fit: BlurModelFit, asked: Sequence[ComponentFit], away: Array, least_gain: float
) -> Iterator[ExtendedComponentScore]:
    """Yield what each kind of light beyond a core gains, where enough, from whitened shapes, shape (size, bin)."""
    scale = abs(fitter.profile.step) / fit.amplitude[0]
    amplitude, precision, moved = amplitudes(fit.residual, fit.design, fit.off, fit.precision, away)
    amplitude, precision = amplitude * scale, precision / scale**2
    gains = np.where(amplitude > 0, amplitude * (amplitude * precision), 0.0)
    low, high = fitter.bounds(fit.family).T
    first = 0
    for one in asked:
        own = slice(first, first := first + len(one.shapes))
        if gains[own].max() < least_gain:
            continue
        yield ExtendedComponentScore(
            core=fit,
            wide=one.wide,
            gains=gains[own],
            odds=ln_bayes_factor_of(one, amplitude[own], precision[own]),
            ln_weight=-float(np.log(len(asked))),
            # Half a step of the core: what the light beyond it changes is not small.
            points=np.clip(fit.point + 0.5 * moved[own], low, high),
            shares=np.minimum(np.clip(amplitude[own], 0.02, 0.3) / one.unit, one.wide.fraction[1]),
            shapes=one.shapes,
        )


def ln_bayes_factor_of(light: ComponentFit, amplitude: Array, precision: Array) -> float:
    """Return the evidence for light beyond the core over that for none: shares and sizes even within their bounds."""
    sizes = light.shapes[:, 0]
    return float(_mean_ratios(*light.wide.fraction, light.unit, amplitude, precision) @ sizes) / float(sizes.sum())


@njit(cache=True)
def _mean_ratios(low: float, high: float, unit: Array, amplitude: Array, precision: Array) -> Array:
    """Return at each size the evidence for light over that for none, its share even between two bounds.

    Notes
    -----
    The mean over shares q of exp(a q p - q^2 p / 2), a their Gaussian estimate and p its precision.
    """
    out = np.zeros(unit.size)
    for i in range(unit.size):
        for k in range(SHARES):
            share = unit[i] * (low + (high - low) * (k + 0.5) / SHARES)
            out[i] += np.exp(min(precision[i] * share * (amplitude[i] - 0.5 * share), LARGEST)) / SHARES
    return out


def fit_extended_component(
    fitter: BlurModelFitter, promise: ExtendedComponentScore, hopeless_cost: float
) -> BlurModelFit | None:
    """Fit a core with light beyond it, from the size that promises most and another far from it.

    Returns
    -------
    FamilyFit or None
        The best fit; None where its beginning costs more than is hopeless.
    """
    core, wide = promise.core, promise.wide
    order = np.argsort(-promise.gains)
    family, slope = BlurModel(core=core.family.core, wide=wide), core.slope_sd_per_px
    sizes = np.log(promise.shapes[order, 0])
    apart = order[np.abs(sizes - sizes[0]) > ACCURACY.size_separation]
    begun = [
        fitter.optimise(family, promise.start(i), slope, ACCURACY.first_iterations) for i in (order[0], *apart[:1])
    ]
    point, reached = min(begun, key=lambda one: one[1][-1])
    return None if reached[-1] > hopeless_cost else fitter.fit(family, point, slope, promise.ln_weight)


def departure_gain(fitter: BlurModelFitter, fit: BlurModelFit, shapes_at: Departures) -> tuple[float, int]:
    """Return the gain in chi squared from smooth departures of modulus and phase, to first order, and how many.

    Parameters
    ----------
    shapes_at
        Departures of the transfer's logarithm, complex, from frequencies and the half frequency.
    """
    maps = fitter.maps
    transfer = maps.shift_transfers(fit.family.modulus(fit.point[None, 1:], maps.grid), float(fit.point[0]))
    moved = maps.white(transfer * shapes_at(maps.grid, float(np.exp(fit.point[1])))) * abs(fitter.profile.step)
    both, none = np.concatenate([fit.design, moved]), np.zeros(len(moved))
    off, precision = np.concatenate([fit.off, none]), np.concatenate([fit.precision, none])
    with_them = chi2_explained(fit.residual, both, off, precision)
    return with_them - chi2_explained(fit.residual, fit.design, fit.off, fit.precision), len(moved)


# Cores that are fitted after a Gaussian, each from where the one before led.
CORES: tuple[Core, ...] = ("exponential", "moffat", "airy")


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
    if half_width_px >= THRESHOLDS.min_window_disc_px:
        found.append(DiscComponent(size_px=(6.0, 2.0 * half_width_px)))
    if half_width_px >= THRESHOLDS.min_window_halo_px:
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
    wings = (
        best.family.core != "gaussian"
        and found[2].log_evidence > best.log_evidence - THRESHOLDS.competitive_ln_evidence
    )
    lenses = [
        fit for fit in found[3:] if fit.log_evidence > max(map(_evidence, found)) - THRESHOLDS.competitive_ln_evidence
    ]
    pursued = [*(found[:3] if wings else found[:2]), *lenses]
    least_gains = {UNEVEN_PER_PX: THRESHOLDS.component_in_gradient_chi2, slope_sd_per_px: 0.0}
    promised = [one for core in pursued for one in score_extended_components(fitter, core, wide, least_gains)]
    own = _components_worth_fitting([one for one in promised if one.core.slope_sd_per_px == slope_sd_per_px])
    hidden = _components_masked_by_gradients(
        [one for one in promised if one.core.slope_sd_per_px != slope_sd_per_px], own, best
    )
    for promise in sorted([*own, *hidden], key=lambda one: wide.index(one.wide)):
        fit = fit_extended_component(fitter, promise, min(fit.cost for fit in found) + THRESHOLDS.max_start_chi2)
        found = found if fit is None else [*found, fit]
    return found


def _fit_cores(fitter: BlurModelFitter, slope_sd_per_px: float) -> list[BlurModelFit]:
    """Fit a Gaussian, a tube's form, a Moffat and lenses, each from where the one before led."""
    guess = fitter.guess()
    found = [fitter.fit(BlurModel(core="gaussian"), _start("gaussian", guess), slope_sd_per_px)]
    for core in CORES:
        found.append(_next_core(fitter, core, found[-1], guess))
    best = max(found, key=_evidence)
    lens_like = found[-1].log_evidence > best.log_evidence - THRESHOLDS.competitive_ln_evidence
    return (
        [*found, _next_core(fitter, "pupil", best, guess)]
        if lens_like or _exceeds_model_by(fitter, best, THRESHOLDS.pupil_departure_sd)
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
        if (one.core.family, one.wide) not in already
        and one.log_evidence > best.log_evidence - THRESHOLDS.competitive_ln_evidence
    ]


def _components_worth_fitting(promised: list[ExtendedComponentScore]) -> list[ExtendedComponentScore]:
    """Return the light beyond a core that is worth a fit: all that the edge tells, and the likeliest of what it cannot.

    An edge too weak to tell light beyond the core leaves it as likely as it was: one stands for all of that.
    """
    measurable = [one for one in promised if one.gains.max() >= THRESHOLDS.component_chi2]
    rest = [one for one in promised if one.gains.max() < THRESHOLDS.component_chi2]
    best = max((one.core.log_evidence for one in promised), default=0.0)
    likely = np.array([one.odds * np.exp(one.core.log_evidence - best) for one in rest])
    if not likely.sum() > THRESHOLDS.component_bayes_factor:
        return measurable
    likeliest = rest[int(np.argmax(likely))]
    stands_for = float(np.log(likely.sum() / likely.max()))
    return [*measurable, replace(likeliest, ln_weight=likeliest.ln_weight + stands_for)]


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
    least = max(map(_evidence, [*found, *asked])) - THRESHOLDS.gradient_ln_evidence
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
    share = np.exp(THRESHOLDS.evidence_power * (evidence - evidence.max()))
    share /= share.sum()
    return [
        EvidenceWeightedModels(fit=found[i], share=float(share[i]))
        for i in np.argsort(-share)
        if share[i] > THRESHOLDS.min_model_weight
    ]


def exceeds_model(fitter: BlurModelFitter, fit: BlurModelFit) -> bool:
    """Tell whether smooth departures from the form would take more chi squared than noise leaves them."""
    return _exceeds_model_by(fitter, fit, THRESHOLDS.departure_sd)


def _exceeds_model_by(fitter: BlurModelFitter, fit: BlurModelFit, deviations: float) -> bool:
    gain, count = departure_gain(fitter, fit, departure_shapes)
    return gain > count + deviations * np.sqrt(2.0 * count)
