"""Selection and averaging of blur models of points by evidence."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from charact.estimators.mtf.point.blur_models_2d import BlurModel2D
from charact.estimators.mtf.point.model_fit import BlurModelFit2D, PointFitter
from charact.estimators.mtf.point.source_pixels import (
    SourcePixels,
    add_noise,
    noise_likelihood,
    position_source,
    whiten_source,
)
from charact.estimators.mtf.point.thresholds import ACCURACY
from charact.inference.gauss_newton import weigh_by_evidence
from charact.transfer.cores import ON_POINTS
from charact.transfer.extended import ExtendedComponent, HaloComponent
from labdata import Array

# Prior odds of each extended component of a camera without a description, of a Gaussian with an
# exponential, and of an ellipse: a parameter that the data do not ask for biases the others.
WIDE_ODDS, LENS_ODDS, ELLIPSE_ODDS = 0.1, 0.2, 0.5
# Model departures, fraction of the transfer, and their prior odds.
DEPARTURES, DEPARTURES_ODDS = (0.02, 0.1), 0.03


class EvidenceWeightedModels2D(NamedTuple):
    """A fitted blur model with its weight by evidence."""

    fit: BlurModelFit2D
    weight: float


def fit_source(
    site: SourcePixels,
    cores: list[BlurModel2D],
    components: tuple[ExtendedComponent, ...] | None,
) -> tuple[SourcePixels, PointFitter, list[EvidenceWeightedModels2D]]:
    """Fit position, noise and blur models of a source in turn; the most probable model comes first.

    There are no models where none has a finite evidence.

    `components` are the extended components to be tried with refined cores; None: the cores are the
    only models.
    """
    site, half = position_source(site)
    first = next(form for form in cores if form.core == "exponential")
    fitter = _fitter_for(site, first, first.start(np.log(half)), _light_of_core(site))
    starts = {form: form.start(np.log(half)) for form in cores}
    for lower in ACCURACY.noise_factors:
        fits = [_fit_pupil(fitter, form, starts[form]) for form in cores]
        starts = {fit.form: fit.point for fit in fits}
        best = max(fits, key=lambda fit: _likelihood(site, fit))
        site = add_noise(site, best, lower=lower)
        fitter = _fitter_for(site, best.form, best.point, best.light)
    models = fit_models(fitter, starts, components)
    if models and models[0].fit.form != best.form:
        # Position and noise were those of a simpler model.
        best = models[0].fit
        site = add_noise(site, best)
        fitter = _fitter_for(site, best.form, best.point, best.light)
        models = fit_models(fitter, starts, components)
    return site, fitter, models


def _likelihood(site: SourcePixels, fit: BlurModelFit2D) -> float:
    """Return the score by which models are compared before the noise is known."""
    if site.window.frames > 1:
        return fit.log_evidence
    # A parameter gains half a unit of ln likelihood by chance (Akaike).
    return noise_likelihood(site, fit) - fit.point.size


def _fit_pupil(fitter: PointFitter, form: BlurModel2D, start: Array) -> BlurModelFit2D:
    """Fit a model; one with defocus from near focus and from far off."""
    near_focus = fitter.fit(form, start)
    if "defocus_square" not in form.names:
        return near_focus
    defocused = start.copy()
    defocused[0], defocused[form.names.index("defocus_square")] = (
        start[0] + np.log(ACCURACY.defocus_start[0]),
        ACCURACY.defocus_start[1],
    )
    return min(near_focus, fitter.fit(form, defocused), key=lambda fit: fit.cost)


def _fitter_for(site: SourcePixels, form: BlurModel2D, point: Array, light: float) -> PointFitter:
    """Return a fitter whose weights and slopes are those of a model."""
    return PointFitter(whiten_source(site, form.transfer(point[None])[0], light))


def _light_of_core(site: SourcePixels) -> float:
    """Return the approximate light of a source: the sum of its core above its border."""
    area = float(np.diff(site.window.x[:2])[0] * np.diff(site.window.y[:2])[0])
    core = site.window.core
    border_dn = np.median(np.concatenate([core[0], core[-1], core[:, 0], core[:, -1]]))
    return max(float((core - border_dn).sum()) * area, 1e-9)


def start_from(fit: BlurModelFit2D, form: BlurModel2D) -> Array:
    """Return starting values of another model from the parameters in common."""
    start = form.start(float(fit.point[0]))
    known = dict(zip(fit.form.names, fit.point, strict=True))
    return np.array(
        [known.get(name, default) for name, default in zip(form.names, start, strict=True)]
    )


def fit_models(
    fitter: PointFitter,
    starts: dict[BlurModel2D, Array],
    components: tuple[ExtendedComponent, ...] | None,
) -> list[EvidenceWeightedModels2D]:
    """Fit candidate blur models and return them with their weights, the most probable first."""
    fits = [fitter.fit(form, start) for form, start in starts.items()]
    if components is None:
        return _rank_by_evidence(fits)
    fits += [
        fitter.fit(form, start_from(candidate, form))
        for candidate in _cores_within(fits, ACCURACY.candidate_ln_evidence)
        if candidate.form.round and (form := replace(candidate.form, round=False))
    ]
    for light in components:
        for core in _cores_within(fits, ACCURACY.candidate_ln_evidence)[:4]:
            more = _fit_extended(fitter, core, light)
            fits += [] if more is None else [more]
    if any(isinstance(light, HaloComponent) for light in components):
        # A described intensifier has a halo.
        fits = [candidate for candidate in fits if candidate.form.wide is not None] or fits
    best = max(fits, key=_weight)
    fits += [
        fitter.fit(form, start_from(best, form))
        for size in DEPARTURES
        if (form := replace(best.form, departures=size))
    ]
    return _rank_by_evidence(fits)


def _cores_within(fits: list[BlurModelFit2D], distance: float) -> list[BlurModelFit2D]:
    """Return the cores whose ln evidence is within a distance of the best, best first."""
    cores = sorted(
        (candidate for candidate in fits if candidate.form.wide is None),
        key=lambda candidate: -_weight(candidate),
    )
    return [candidate for candidate in cores if _weight(candidate) > _weight(cores[0]) - distance]


def _weight(fit: BlurModelFit2D) -> float:
    """Return ln evidence plus ln prior probability of a model."""
    form = fit.form
    odds = ON_POINTS[form.core][1] * (1.0 if form.round else ELLIPSE_ODDS)
    odds *= LENS_ODDS if form.lens else 1.0
    odds *= 1.0 if form.wide is None or isinstance(form.wide, HaloComponent) else WIDE_ODDS
    odds *= DEPARTURES_ODDS if form.departures else 1.0
    return fit.log_evidence + float(np.log(odds))


def _fit_extended(
    fitter: PointFitter, core: BlurModelFit2D, component: ExtendedComponent
) -> BlurModelFit2D | None:
    """Fit a core with an extended component from the size that the residual asks for most; None if
    it asks for none: light in it then stands less than `ACCURACY.component_sd` out of the noise.
    """
    form = replace(core.form, wide=component)
    first = form.blur_parameters
    bounds = form.bounds[first : first + len(component.parameters)]
    sizes = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** np.linspace(0.1, 0.9, 6)
    elastic = [0.5] if len(bounds) > 2 else []
    starts = np.array(
        [[*core.point[:first], 0.05, size, *elastic, *core.point[first:]] for size in sizes]
    )
    shapes = form.nodes(starts) - core.form.nodes(core.point[None])
    residual, columns = fitter.beyond(core, fitter.pixels.matrix[:, : shapes.shape[1]] @ shapes.T)
    overlap = residual @ columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-6)
    best = int(np.argmax(overlap))
    if overlap[best] < ACCURACY.component_sd and not isinstance(component, HaloComponent):
        return None
    fit = fitter.fit(form, starts[best])
    # Without light in it the component is the core alone.
    return fit if fit.point[first] > bounds[0, 0] else None


def _rank_by_evidence(fits: list[BlurModelFit2D]) -> list[EvidenceWeightedModels2D]:
    ranked = weigh_by_evidence([_weight(fit) for fit in fits], min_weight=ACCURACY.min_model_weight)
    return [EvidenceWeightedModels2D(fit=fits[index], weight=weight) for index, weight in ranked]
