"""Selection of the halo model by the Bayesian information criterion, and acceptance of its halo."""

from dataclasses import dataclass, replace

import numpy as np

from charact.estimators.bloom.series.halo_models import (
    CORES,
    CORES_OF_TUBES,
    WINGS,
    Core,
    Halo,
    HaloModel,
)
from charact.estimators.bloom.series.likelihood import RingSeries, SeriesLikelihood
from charact.estimators.bloom.series.mcp_saturation import SaturatingHaloModel, fit_mcp_saturation
from charact.estimators.bloom.series.optimum import BoundedOptimum, optimise
from charact.estimators.bloom.series.rings import SECTORS
from labdata import Array, Camera

# Steps of a first optimisation.
FIRST_STEPS = 20
# Number of parameters of a disc.
HALO = 6
# Excess in the criterion over the best model above which a model is not fitted further.
WORTHWHILE = 400.0


@dataclass(frozen=True, kw_only=True)
class FittedHaloModel:
    """Halo model at its optimum.

    `problem`: likelihood of the series under the model, with its relative model error; `peak`:
    optimum; `log_likelihood`: log-likelihood of the rings at the optimum, in DN; `bic`: -2 log L +
    k ln N.
    """

    problem: SeriesLikelihood
    peak: BoundedOptimum
    log_likelihood: float
    bic: float

    @property
    def form(self) -> HaloModel:
        """The halo model."""
        return self.problem.form

    @property
    def name(self) -> str:
        """Name in reports."""
        halo = {"none": "no halo", "disc": "disc"}[self.form.halo]
        return f"{self.form.core} core, {halo}" + (
            ", saturating MCP" if isinstance(self.form, SaturatingHaloModel) else ""
        )


def candidates(
    series: RingSeries,
    *,
    pitch_ratio: float,
    sensor: Camera | None,
    has_tube: bool,
    first_diameter_px: float,
) -> list[FittedHaloModel]:
    """Fit all models and return them in order of the information criterion.

    `series`: ring means of all levels; `pitch_ratio`, `sensor`: row pitch over column pitch; sensor
    description, None if unknown; `has_tube`: whether the camera has a tube, whose MCP may saturate;
    `first_diameter_px`: diameter of the halo's edge; NaN where the rings show none.
    """

    def form(core: Core, halo: Halo) -> HaloModel:
        return HaloModel(
            core=core,
            halo=halo,
            reach_px=float(series.radius_px[-1]),
            pitch_ratio=pitch_ratio,
            sensor=sensor,
        )

    out: list[FittedHaloModel] = []
    for core in CORES_OF_TUBES if has_tube else CORES:
        out.append(bare := fit_model(series, form(core, "none"), []))
        disc_models = [model for model in out if model.form.halo == "disc"]
        starts = _discs(form(core, "disc"), first_diameter_px, bare, disc_models)
        out.append(fit_model(series, form(core, "disc"), starts))
    least_bic = min(model.bic for model in out)
    out = sorted(
        (
            refit_with_misfit(model) if model.bic < least_bic + WORTHWHILE else model
            for model in out
        ),
        key=lambda model: model.bic,
    )
    if not has_tube:
        return out
    # Saturation changes which core fits best, so that each core is tried with it; a described
    # tube's core is known.
    plausible = [model for model in reversed(out) if model.bic < least_bic + WORTHWHILE]
    cores = {
        model.form.core: model
        for model in plausible
        if sensor is None or not sensor.has_tube or model.form.core == "tube"
    }
    tiring = [
        saturating
        for model in cores.values()
        for saturating in _saturating_candidates(model, out[0].bic)
    ]
    return sorted([*out, *tiring], key=lambda model: model.bic)


def _saturating_candidates(best: FittedHaloModel, least_bic: float) -> list[FittedHaloModel]:
    """Fit a core's best model with a saturating MCP, where several stacks can constrain it.

    It must be clearly better than any model without saturation. If the core is clipped in every
    stack, only its wings are visible, and saturation would compensate errors of their model.
    """
    series = best.problem.series
    if best.form.halo != "disc" or len(series.labels) < 3 or series.cut[:, 0].all():
        return []
    saturating_fit = fit_mcp_saturation(best.problem, best.peak)
    first = _candidate(*saturating_fit) if saturating_fit else best
    fitted_on = [refit_with_misfit(first)] if first.bic < best.bic else []
    return [model for model in fitted_on if model.bic < least_bic - 15.0]


def _discs(
    form: HaloModel,
    diameter_px: float,
    bare: FittedHaloModel,
    disc_models: list[FittedHaloModel],
) -> list[Array]:
    """Start points of a disc: those of other cores, and the edge or any diameter, some profiles.

    A wing fitted without a halo takes the halo's place, so that wings also start with the first
    core, and with a Gaussian one and its disc.
    """
    low, high = form.bounds[form.names.index("halo_diameter")]
    diameters = np.linspace(low + 2.0, high - 2.0, 24)
    if np.isfinite(diameter_px):
        diameters = np.clip([diameter_px], low + 1.0, high - 1.0)
    halos = [
        *(model.peak.point[-HALO:] for model in disc_models),
        *([d, elastic, 0.3, 0.0, 0.0, 0.08] for d in diameters for elastic in (0.15, 0.3, 0.6)),
    ]
    cores = [bare.peak.point, form.first[: len(bare.peak.point)]]
    out = [np.array([*core, *halo]) for halo in halos for core in cores]
    if form.core in WINGS:
        plain = disc_models[0].peak.point
        out.append(np.array([plain[0], *cores[1][1:], *plain[-HALO:]]))
    return out


def fit_model(series: RingSeries, form: HaloModel, starts: list[Array]) -> FittedHaloModel:
    """Fit one model from the best of its starts, with a small relative model error."""
    problem = SeriesLikelihood(series=series, form=form)
    tried = np.array(starts or [form.first])
    order = np.argsort(problem.log_probability(tried))[::-1][:2]
    peaks = [
        optimise(problem, tried[index], iterations=FIRST_STEPS, tolerance=0.2) for index in order
    ]
    return _candidate(problem, max(peaks, key=lambda peak: peak.log_probability))


def refit_with_misfit(candidate: FittedHaloModel) -> FittedHaloModel:
    """Fit a model again with its estimated relative model error."""
    for _ in range(2):
        peak = optimise(candidate.problem, candidate.peak.point)
        candidate = _candidate(candidate.problem, peak)
    return replace(
        candidate, peak=optimise(candidate.problem, candidate.peak.point, tolerance=1e-4)
    )


def _candidate(problem: SeriesLikelihood, peak: BoundedOptimum) -> FittedHaloModel:
    misfit, value = problem.likeliest_misfit(peak.point)
    off = replace(problem, misfit=misfit)
    count = len(problem.form.names) + 2 * len(problem.series.data) + 2
    bic = -2.0 * value + count * float(np.log(problem.series.data.size))
    return FittedHaloModel(problem=off, peak=peak, log_likelihood=value, bic=bic)


# Relative model error above which the model is rejected.
MISFIT_SHARE = 0.12
# Consecutive rings with asymmetric sectors that reveal another source.
UNEVEN_RINGS = 3


def halo_refusal_reason(models: list[FittedHaloModel]) -> str | None:
    """Refusal reason of the halo; None where it is accepted."""
    best = models[0]
    if best.form.halo != "disc":
        return f"the data favour a {best.name}: no halo with an edge is visible"
    rival = min(
        (model for model in models if model.form.halo != "disc"), key=lambda model: model.bic
    )
    if rival.bic - best.bic < 15.0:
        return (
            f"the data fit a {rival.name} nearly as well as a halo with an edge: no halo is "
            f"reported"
        )
    return None


def is_uneven(series: RingSeries) -> bool:
    """Whether rings of a stack are asymmetric: two sources, a tail, a border."""
    variance = SECTORS * np.diagonal(series.own_covariance, axis1=1, axis2=2)
    excess = np.maximum(series.sector_sd**2 - variance, 0.0)
    clear = (excess > 4.0**2 * variance) & (excess > (0.5 * series.light) ** 2)
    clear &= ~series.cut & (series.radius_px > 6.0)
    on_end = np.array([np.convolve(is_clear, np.ones(UNEVEN_RINGS)) for is_clear in clear])
    return bool(on_end.max() >= UNEVEN_RINGS)
