"""Which form the data bear: every form is fitted, and the Bayesian information criterion decides."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.halo_models import CORES, CORES_OF_TUBES, LEAST_DIAMETER_PX, WINGS, Core, Halo, HaloModel
from charact.bloom.series.levenberg_marquardt import SeriesOptimum, optimise, optimise_from_starts
from charact.bloom.series.likelihood import RingSeries, SeriesLikelihood
from charact.bloom.series.mcp_saturation import SaturatingHaloModel, fit_mcp_saturation
from labdata.sensor import Sensor

Array = NDArray[np.float64]

# Diameters from which a disc is looked for, the best of them that are climbed from, and steps of a first climb.
STARTS, CLIMBED, FIRST_STEPS = 24, 2, 12
# Numbers of a disc, and where it is first looked for: flat, rimmed and peaked in equal parts.
HALO, FIRST_HALO = 6, (0.3, 0.3, 0.0, 0.0, 0.08)
# Shares of electrons that keep their energy from which a disc is climbed to again.
SHAKEN = (0.15, 0.6)
# Excess of the criterion over the best form's beyond which a form need not be fitted to the end.
WORTHWHILE = 400.0
# Levels that tell a plate that tires.
LEAST_LEVELS = 3
# By how much its criterion must be better: cameras that are not quite round make small gains of their own.
CLEARLY_BETTER = 15.0


@dataclass(frozen=True, kw_only=True)
class FittedHaloModel:
    """A form at its best.

    Parameters
    ----------
    problem
        The form put to the series, with the shares of the light by which its rings are off.
    peak
        Where it is best.
    log_likelihood
        There, of the rings and in DN.
    bic
        -2 log L + k ln N.
    """

    problem: SeriesLikelihood
    peak: SeriesOptimum
    log_likelihood: float
    bic: float

    @property
    def form(self) -> HaloModel:
        """The form."""
        return self.problem.form

    @property
    def name(self) -> str:
        """As reports call it."""
        halo = {"none": "no halo", "disc": "disc", "gaussian": "Gaussian halo"}[self.form.halo]
        return f"{self.form.core} core, {halo}" + (
            ", plate that tires" if isinstance(self.form, SaturatingHaloModel) else ""
        )


def candidates(
    series: RingSeries, *, pitch_ratio: float, sensor: Sensor | None, has_tube: bool, first_diameter_px: float
) -> list[FittedHaloModel]:
    """Fit all forms, the one that the data bear best first.

    Parameters
    ----------
    series
        Ring means of all levels.
    pitch_ratio, sensor
        Row pitch over column pitch; description of the camera, None if unknown.
    has_tube
        Whether the session shows that the camera has one, whose gain may saturate where it is bright.
    first_diameter_px
        Diameter of the clearest step of the rings; NaN where there is none.
    """
    reach = float(series.radius_px[-1])

    def form(core: Core, halo: Halo) -> HaloModel:
        return HaloModel(core=core, halo=halo, reach_px=reach, pitch_ratio=pitch_ratio, sensor=sensor)

    out: list[FittedHaloModel] = []
    for core in CORES_OF_TUBES if has_tube else CORES:
        bare = fit_model(series, form(core, "none"), [])
        found = [one for one in out if one.form.halo == "disc"]
        out += [bare, fit_model(series, form(core, "disc"), _discs(form(core, "disc"), first_diameter_px, bare, found))]
    likeliest = min(out, key=lambda one: one.bic)
    out.append(fit_model(series, form(likeliest.form.core, "gaussian"), []))
    least = min(one.bic for one in out)
    out = [
        refit_from_other_profiles(one) if one.form.halo == "disc" and one.bic < least + WORTHWHILE else one
        for one in out
    ]
    out = sorted(
        (refit_with_misfit(one) if one.bic < least + WORTHWHILE else one for one in out), key=lambda one: one.bic
    )
    if not has_tube:
        return out
    # A plate that tires changes which core fits best: each is tried with one; a described tube's core is known.
    near = [one for one in reversed(out) if one.bic < least + WORTHWHILE]
    cores = {one.form.core: one for one in near if sensor is None or one.form.core == "tube"}
    tiring = [found for one in cores.values() for found in _saturating_candidates(one, out[0].bic)]
    return sorted([*out, *tiring], key=lambda one: one.bic)


def _saturating_candidates(best: FittedHaloModel, least: float) -> list[FittedHaloModel]:
    """A core's best form with a plate that tires, where one level's core and another's halo can tell it.

    It must be clearly better than the least criterion of any form without. Of cores that are cut at every level only
    the wings are seen, and a plate would make up for what is wrong with their form.
    """
    series = best.problem.series
    if best.form.halo != "disc" or len(series.labels) < LEAST_LEVELS or series.cut[:, 0].all():
        return []
    found = fit_mcp_saturation(best.problem, best.peak)
    first = _candidate(*found) if found else best
    fitted_on = [refit_with_misfit(first)] if first.bic < best.bic else []
    return [one for one in fitted_on if one.bic < least - CLEARLY_BETTER]


def _discs(
    form: HaloModel, first_diameter_px: float, bare: FittedHaloModel, found: list[FittedHaloModel]
) -> list[Array]:
    """Starts of a disc: those of other cores, the step seen, and every diameter, for an edge makes many small peaks.

    A wing that was fitted without a halo stands for one: wings start beside the core of a plain one and its disc, too.
    """
    low, high = form.bounds[form.names.index("halo_diameter")]
    diameters = np.linspace(LEAST_DIAMETER_PX + 2, high - 2, STARTS)
    if np.isfinite(first_diameter_px):
        diameters = np.append(diameters, np.clip(first_diameter_px, low + 1, high - 1))
    halos = [*(one.peak.point[-HALO:] for one in found), *([diameter, *FIRST_HALO] for diameter in diameters)]
    cores = [bare.peak.point, form.first[: len(bare.peak.point)]]
    out = [np.array([*core, *halo]) for halo in halos for core in cores[: 2 if len(found) else 1]]
    if form.core in WINGS:
        plain = found[0].peak.point
        out.append(np.array([plain[0], *cores[1][1:], *plain[-HALO:]]))
    return out


def fit_model(series: RingSeries, form: HaloModel, starts: list[Array]) -> FittedHaloModel:
    """Fit one form from the best of its starts, rings taken to be off a little."""
    problem = SeriesLikelihood(series=series, form=form)
    tried = np.array(starts or [form.first])
    order = np.argsort(problem.log_probability(tried))[::-1][:CLIMBED]
    peaks = optimise_from_starts(problem, tried[order], iterations=FIRST_STEPS)
    return _candidate(problem, max(peaks, key=lambda one: one.log_probability))


def refit_from_other_profiles(candidate: FittedHaloModel) -> FittedHaloModel:
    """Climb again from other mixes of energies, with the core as it is and as cores are at first: wings hide halos."""
    form, point = candidate.form, candidate.peak.point
    at, core = form.names.index("elastic_share"), len(point) - HALO
    starts = [point]
    for share in SHAKEN:
        for first in (point[:core], form.first[:core]):
            start = np.concatenate([first, point[core:]])
            start[at] = share
            starts.append(start)
    as_it_is, *peaks = optimise_from_starts(candidate.problem, np.array(starts), iterations=FIRST_STEPS)
    best = max(peaks, key=lambda one: one.log_probability)
    return _candidate(candidate.problem, best) if best.log_probability > as_it_is.log_probability + 1.0 else candidate


def refit_with_misfit(candidate: FittedHaloModel) -> FittedHaloModel:
    """Fit a form again with rings as far off as they turned out to be."""
    for _ in range(2):
        peak = optimise(candidate.problem, candidate.peak.point)
        candidate = _candidate(candidate.problem, peak)
    return replace(candidate, peak=optimise(candidate.problem, candidate.peak.point))


def _candidate(problem: SeriesLikelihood, peak: SeriesOptimum) -> FittedHaloModel:
    misfit, value = problem.likeliest_misfit(peak.point)
    off = replace(problem, misfit=misfit)
    count = len(problem.form.names) + 2 * len(problem.series.data) + 2
    bic = -2.0 * value + count * float(np.log(problem.series.data.size))
    return FittedHaloModel(problem=off, peak=peak, log_likelihood=value, bic=bic)
