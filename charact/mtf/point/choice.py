"""Which forms of the transfer points ask for: simple ones first, all that come near weighed by their evidence."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.forms.families import HaloPrior, Wide
from charact.mtf.point.form_fit import FormFit, PointFitter
from charact.mtf.point.forms import PointForm
from charact.mtf.point.pixels import Site, pixels, placed, with_noise
from charact.mtf.point.table import cosines, radial

Array = NDArray[np.float64]

# A form this much less probable than the best, as a share, adds nothing to the draws.
LEAST_SHARE = 0.02
# Forms within this of the best in ln of the evidence are worth pursuing.
CLOSE = 8.0
# Cores within this of the best are asked for light beyond them also where it gains nothing: it may hide in the noise.
NEAR = 3.0
# Gain in chi squared from which on wide light is worth a fit of its own for the others.
WORTH_CHI2 = 4.0
# Odds before the data of each of the two kinds of light beyond a core, of which the camera's description says nothing:
# together they are as likely as none.
WIDE_ODDS = 0.5
# Odds before the data of two blurs of different form, which every tube behind a lens has, and of blurs along rows and
# columns apart.
LENS_ODDS, SEPARABLE_ODDS = 1.0, 0.2
TURNS = 2
WIDE_SIZES = 6


@dataclass(frozen=True, kw_only=True)
class Weighed:
    """A fitted form with its share of the evidence."""

    fit: FormFit
    share: float


def fitted(sites: list[Site], pinhole: float | tuple[float, float], wide: tuple[Wide, ...]) -> tuple[
    list[Site], PointFitter, list[Weighed]
]:  # fmt: skip
    """Fit sources of one camera, places, noise and forms in turns; return all, the most probable form first."""
    begun = [placed(site) for site in sites]
    sites = [site for site, _ in begun]
    half = float(np.median([guess for _, guess in begun]))
    form = PointForm(core="exponential", pinhole_px=pinhole)
    fitter, best = _prepared(sites, form, form.start(np.log(half)), None)
    for _ in range(TURNS):
        core = fitter.fit(PointForm(core="gaussian", pinhole_px=pinhole), _moved(best, "gaussian"))
        tube = fitter.fit(form, best.point if best.form == form else _moved(best, "exponential"))
        best = max((core, tube), key=lambda one: one.log_evidence)
        sites = [with_noise(site, best, float(light)) for site, light in zip(sites, best.light, strict=True)]
        fitter, best = _prepared(sites, best.form, best.point, best.light)
    found = forms(fitter, best, wide)
    if found[0].fit.form != best.form:
        # Place and noise were those of a simpler form.
        sites, fitter = _again(sites, found[0].fit)
        found = forms(fitter, fitter.fit(best.form, best.point), wide)
    return sites, fitter, found


def _again(sites: list[Site], fit: FormFit) -> tuple[list[Site], PointFitter]:
    """Return sources with place and noise as a form sees them, and their fitter."""
    sites = [with_noise(site, fit, float(light)) for site, light in zip(sites, fit.light, strict=True)]
    return sites, _prepared(sites, fit.form, fit.point, fit.light)[0]


def _prepared(sites: list[Site], form: PointForm, point: Array, light: Array | None) -> tuple[PointFitter, FormFit]:
    """Return a fitter whose weights and slopes are those of a form, and that form fitted by it."""
    top = sites[0].aperture.top
    transfer = form.transfer(point[None], radial(top)[1], cosines())[0]
    if light is None:
        light = np.array([_light(site) for site in sites])
    fitter = PointFitter([pixels(site, transfer, float(one)) for site, one in zip(sites, light, strict=True)], top)
    return fitter, fitter.fit(form, point)


def _light(site: Site) -> float:
    """Return about the light of a source, from the sum of its core above its border."""
    area = float(np.diff(site.window.x[:2])[0] * np.diff(site.window.y[:2])[0])
    return max(float((site.window.core - site.window.border_dn).sum()) * area, 1e-9)


def _moved(fit: FormFit, core: str, **changes) -> Array:
    """Return where to begin with another form: what both have in common as it was found."""
    form = replace(fit.form, core=core, **changes)  # type: ignore[arg-type]
    start = form.start(float(fit.point[0]))
    known = dict(zip(fit.form.parameters, fit.point, strict=True))
    for index, name in enumerate(form.parameters):
        if name in ("stretch", "pinhole_px") and name in known:
            start[index] = known[name]
    return start


def forms(fitter: PointFitter, first: FormFit, wide: tuple[Wide, ...]) -> list[Weighed]:
    """Fit the forms that the data may ask for and return them with their shares, the most probable first."""
    pinhole = first.form.pinhole_px
    gaussian = fitter.fit(PointForm(core="gaussian", pinhole_px=pinhole), _moved(first, "gaussian"))
    tube = PointForm(core="exponential", pinhole_px=pinhole)
    exponential = fitter.fit(tube, first.point if first.form == tube else _moved(gaussian, "exponential"))
    found = [gaussian, exponential]
    if exponential.log_evidence > gaussian.log_evidence - CLOSE:
        found.append(fitter.fit(replace(tube, core="moffat"), _moved(exponential, "moffat")))
        lens = replace(tube, lens=True)
        half = 1.3 * float(np.exp(exponential.point[0]))
        begun = []
        for blur in (0.3, 0.7):
            start = _moved(exponential, "exponential", lens=True)
            names = list(lens.parameters)
            start[0], start[names.index("blur_px")] = np.log(half), blur
            begun.append(fitter.fit(lens, start))
        found.append(min(begun, key=lambda one: one.cost))
        apart = replace(tube, separable=True)
        if abs(float(exponential.point[1]) - 2.0) > 2.0 * np.sqrt(exponential.covariance[1, 1]):
            found.append(fitter.fit(apart, exponential.point))
    top = max(one.log_evidence for one in found)
    cores = [one for one in found if one.log_evidence > top - CLOSE]
    for light in wide:
        for core in cores:
            worth = WORTH_CHI2 if core.log_evidence < top - NEAR else -np.inf
            more = _with_wide(fitter, core, light, worth)
            found += [] if more is None else [more]
    if any(isinstance(light, HaloPrior) for light in wide):
        # A described intensifier has a halo, of however little light.
        found = [one for one in found if one.form.wide is not None and np.isfinite(one.log_evidence)] or found
    return _weighed(found)


def _odds(form: PointForm) -> float:
    """Return the odds of a form before the data."""
    wide = 1.0 if form.wide is None or isinstance(form.wide, HaloPrior) else WIDE_ODDS
    return wide * (LENS_ODDS if form.lens else 1.0) * (SEPARABLE_ODDS if form.separable else 1.0)


def _with_wide(fitter: PointFitter, core: FormFit, wide: Wide, worth: float) -> FormFit | None:
    """Fit a core with light beyond it from several sizes; None where chi squared gains less than it must."""
    form = replace(core.form, wide=wide)
    first = form.blur_parameters
    bounds = form.bounds[first : first + len(wide.parameters)]
    sizes = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** np.linspace(0.1, 0.9, WIDE_SIZES)
    begun = []
    for size in sizes:
        beyond = [0.05, size, *([0.5] if len(bounds) > 2 else [])]
        start = np.concatenate([core.point[:first], beyond, core.point[first:]])
        begun.append(fitter.fit(form, start, iterations=6))
    best = min(begun, key=lambda one: one.cost)
    if best.cost > core.cost - worth:
        return None
    return fitter.fit(form, best.point)


def _weighed(found: list[FormFit]) -> list[Weighed]:
    evidence = np.array([fit.log_evidence for fit in found]) + np.log([_odds(fit.form) for fit in found])
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    return [Weighed(fit=found[i], share=float(share[i])) for i in np.argsort(-share) if share[i] > LEAST_SHARE]
