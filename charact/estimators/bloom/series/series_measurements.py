"""Measurements of a fitted series: halo, encircled energy, glare and MCP saturation."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.estimators.bloom.findings import finding
from charact.estimators.bloom.point_stack import PointStack
from charact.estimators.bloom.series.halo_edge_step import Rim
from charact.estimators.bloom.series.halo_models import HaloModel, onto_nodes, pixel_of
from charact.estimators.bloom.series.mcp_saturation import SaturatingSeriesLikelihood
from charact.estimators.bloom.series.model_selection import FittedHaloModel
from charact.frames.robust import robust_sd
from charact.inference.diagnostics import crowds_at_bound
from charact.verdict import Finding, judge
from labdata import Array, Measurement, Posterior, make_refusal, measurement_from_draws

REMEDY = "a target that is opaque around its pinhole, or a series with the pinhole covered"


def find_leak(
    group: tuple[PointStack, ...],
    light: Array,
    reach_px: float,
    area_px2: float,
    near_ratio: tuple[float, float],
) -> list[Finding]:
    """Return a finding where the background near the source rises faster with its signal than far
    from it.

    `group`: stacks of one source; `light`: source signal of each stack, DN px^2, shape (level,);
    `reach_px`: radius of the fitted background around the source, column pitches; `area_px2`: area
    of the frame, column pitches squared; `near_ratio`: uniformly spread light over the source
    signal from that background, and its standard error.
    """
    far_levels = [_far(spot, reach_px) for spot in group]
    if any(spot is None for spot in far_levels):
        return []
    level, sd = np.array(far_levels, float).T
    far_ratio = glare(light, level, sd, area_px2)
    if far_ratio is None or abs(near_ratio[0] - far_ratio[0]) < 4.0 * float(
        np.hypot(near_ratio[1], far_ratio[1])
    ):
        return []
    if abs(near_ratio[0] - far_ratio[0]) < 0.3 * max(near_ratio[0], far_ratio[0]):
        return []
    near_percent, far_percent = (
        100.0 * ratio / (1.0 + max(ratio, 0.0)) for ratio in (near_ratio[0], far_ratio[0])
    )
    effect = (
        f"veiling_glare is {near_percent:.2g} % by the background within {reach_px:.0f} px of the "
        f"source, {far_percent:.2g} % by that beyond"
    )
    return [Finding(flag="model-misfit", effect=effect, remedy=REMEDY)]


def _far(spot: PointStack, reach_px: float) -> tuple[float, float] | None:
    """Return the median of the pixels far from all sources and its standard error, DN; None with
    too few pixels.
    """
    rows, cols = np.ogrid[: spot.image.shape[0], : spot.image.shape[1]]
    far_pixels = np.hypot((rows - spot.row) * spot.row_pitch, cols - spot.col) > reach_px
    for other in spot.other_sources:
        far_pixels &= np.hypot((rows - other.row) * spot.row_pitch, cols - other.col) > 40.0
    values = spot.image[far_pixels]
    if values.size < 200:
        return None
    median = float(np.median(values))
    spread = robust_sd(values)
    # Pulse noise is correlated: a quarter of the pixels counts. A median has 1.25 times the error
    # of a mean.
    return median, max(1.2533 * 2.0 * spread / float(np.sqrt(values.size)), 1e-6)


# Radii of plateau and rim over that of the disc.
PLATEAU, RIM = (0.3, 0.7), (0.75, 1.1)
STEP_PX = 0.1


def halo_of(form: HaloModel, points: Array) -> tuple[Array, Array]:
    """Return plateau and rim of a disc at draws of its parameters, shape (draw,) each.

    Plateau: mean light between 0.3 and 0.7 of the radius over the source's total light, 1/px^2;
    rim: maximum light of the rim, blurred by the core without its wing, over the plateau.
    """
    of = form.at(points)
    radius = of["halo_diameter"][:, None] / 2.0
    at = np.arange(PLATEAU[0] * radius.min(), RIM[1] * radius.max(), 2.0 * STEP_PX)
    halo = form.halo_transform(points)
    assert halo is not None
    light = (form.blur_transform(points) * pixel_of(form.pitch_ratio) * halo) @ onto_nodes(at)
    area = at * ((at > PLATEAU[0] * radius) & (at < PLATEAU[1] * radius))
    per_px2 = (light * area).sum(axis=1) / area.sum(axis=1)
    within_rim = (at > RIM[0] * radius) & (at < RIM[1] * radius)
    rim = np.where(within_rim, light, -np.inf).max(axis=1)
    return of["halo_fraction"] * per_px2, rim / per_px2


def energy_radii(
    form: HaloModel, points: Array, shares: tuple[float, ...], reach_px: float
) -> Array:
    """Return radii that contain fractions of a point's light, shape (draw, fraction), px; NaN
    beyond the reach.
    """
    at = np.arange(STEP_PX / 2, reach_px, STEP_PX)
    light = form.transform(points) @ onto_nodes(at)
    encircled = np.cumsum(light * 2.0 * np.pi * at * STEP_PX, axis=1)
    edges = at + STEP_PX / 2
    # Ringing of the transform may give small negative light: radii need an increasing sum.
    rising = np.maximum.accumulate(encircled, axis=1)
    out = [
        [np.interp(fraction, encircled_light, edges, right=np.nan) for fraction in shares]
        for encircled_light in rising
    ]
    return np.array(out)


def glare(
    light: Array, background_dn: Array, sd_dn: Array, area_px2: float
) -> tuple[float, float] | None:
    """Ratio of uniformly spread light to the source's signal, and its standard error.

    `light`: source signal of each stack, DN px^2, shape (level,); `background_dn`, `sd_dn`:
    background of each stack and its standard error, shape (level,); `area_px2`: area of the frame,
    column pitches squared. Returns ratio and standard error, widened by excess scatter of the
    stacks; None with fewer than three stacks.
    """
    if len(light) < 3:
        return None
    design = np.stack([np.ones_like(light), light / light.max()], axis=1) / sd_dn[:, None]
    covariance = np.linalg.inv(design.T @ design)
    best = covariance @ design.T @ (background_dn / sd_dn)
    chi2 = float(((background_dn / sd_dn - design @ best) ** 2).sum()) / (len(light) - 2)
    per_light = float(best[1]) / float(light.max()) * area_px2
    sd = float(np.sqrt(covariance[1, 1] * max(chi2, 1.0))) / float(light.max()) * area_px2
    return per_light, sd


OF_THE_HALO = (
    ("halo_diameter", "px"),
    ("halo_fraction", "1"),
    ("halo_plateau", "1/px2"),
    ("halo_rim", "1"),
)
# Relative model error of a quantity: a constant, and multiples of the relative model errors beyond
# the core and near it. The constant is calibrated on closed-form series with wings, the others on
# simulated cameras: near the core all stacks have the same error, which does not average out.
LEFT_OUT = {
    "halo_fraction": (0.012, 3.0, 0.7),
    "halo_plateau": (0.012, 3.0, 0.7),
    "halo_rim": (0.013, 1.0, 0.0),
    "encircled_radius_50": (0.006, 1.0, 0.3),
    "encircled_radius_90": (0.015, 1.0, 1.0),
    "veiling_glare": (0.05, 3.0, 0.7),
    "mcp_saturation_density": (0.03, 6.0, 0.7),
}
NO_RINGS = "too few rings are unclipped to look for the edge of a halo"
LEAKS = "light that leaks through the target around its pinhole counts as glare"
# Draws of derived quantities.
DERIVED = 400


def nearest_px(group: tuple[PointStack, ...]) -> float:
    """Distance of the nearest other source in any stack, column pitches; inf where there is
    none.
    """
    pairs = ((spot, other) for spot in group for other in spot.other_sources)
    distances = (
        float(np.hypot((source.row - spot.row) * spot.row_pitch, source.col - spot.col))
        for spot, source in pairs
    )
    return min(distances, default=np.inf)


@dataclass(frozen=True, kw_only=True)
class FittedSeries:
    """Series with its models in order of likelihood, and what all its measurements have in common.

    `rim`: edge of its halo; `no_edge`: why it has none, or None; `no_disc`: why the halo's light is
    not reported, or None; `posterior`: draws of the best model's parameters; `group`: the stacks;
    `edge_findings`: of the halo's edge; `findings`, `notes`, `fields`: of the other measurements.
    """

    forms: list[FittedHaloModel]
    rim: Rim | None
    no_edge: str | None
    no_disc: str | None
    posterior: Posterior
    group: tuple[PointStack, ...]
    edge_findings: list[Finding]
    findings: list[Finding]
    notes: tuple[str, ...]
    fields: dict[str, Any]

    @property
    def best(self) -> FittedHaloModel:
        """The selected model."""
        return self.forms[0]

    @property
    def light_findings(self) -> list[Finding]:
        """Findings of quantities that another source's light affects."""
        several = [finding("several-targets")] if np.isfinite(nearest_px(self.group)) else []
        return self.findings + several

    @property
    def core_findings(self) -> list[Finding]:
        """Findings of quantities relative to the source's total signal."""
        blind = [] if shows_core(self.best, self.posterior) else [finding("prior-bound")]
        return self.light_findings + blind


def halo_measurements(fit: FittedSeries) -> list[Measurement]:
    """Return the halo's diameter by its edge, and fraction, plateau and rim by its model.

    Light of another source contaminates the rings, but not the position of the edge.
    """
    best, posterior, group, rim = fit.best, fit.posterior, fit.group, fit.rim
    if rim is None or fit.no_edge is not None:
        return refuse_halo(fit.no_edge or NO_RINGS, OF_THE_HALO, fit.fields)
    count, middle = len(posterior.draws), rim.diameter_px
    diameter = rim.draws(count, posterior.seed or 0)
    if nearest_px(group) < middle:
        rng = np.random.default_rng([posterior.seed or 0, 1])
        diameter += 0.005 * middle * rng.standard_normal(count)
    common = {"notes": fit.notes, "posterior": posterior, **fit.fields}
    number = measurement_from_draws("halo_diameter", "px", diameter, **common)
    out = [judge(number, fit.edge_findings)]
    if fit.no_disc is not None:
        return out + refuse_halo(fit.no_disc, OF_THE_HALO[1:], fit.fields)
    plateau, edge = halo_of(best.form, posterior.draws[:DERIVED])
    of_light = {
        "halo_fraction": (posterior["halo_fraction"], fit.core_findings),
        "halo_plateau": (plateau, fit.core_findings),
        "halo_rim": (edge, fit.light_findings),
    }
    for name, unit in OF_THE_HALO[1:]:
        draws, findings = of_light[name]
        draws = draws * _model_error_factors(best, name, len(draws), posterior)
        out.append(judge(measurement_from_draws(name, unit, draws, **common), findings))
    return out


def refuse_halo(
    reason: str, quantities: tuple[tuple[str, str], ...], fields: dict[str, Any]
) -> list[Measurement]:
    """Return refusals of quantities of the halo."""
    return [make_refusal(quantity, unit, reason, **fields) for quantity, unit in quantities]


def _model_error_factors(
    best: FittedHaloModel, quantity: str, draws: int, posterior: Posterior
) -> Array:
    """Factors for the model error of a quantity, general and by rotational asymmetry."""
    of_any, of_outer, of_core = LEFT_OUT[quantity]
    misfit = best.problem.misfit
    sd = np.linalg.norm([of_any, of_outer * misfit.outer, of_core * misfit.core])
    return np.exp(sd * np.random.default_rng(posterior.seed).standard_normal(draws))


def shows_core(best: FittedHaloModel, posterior: Posterior) -> bool:
    """Whether the source's total signal is known; unknown where every core is clipped."""
    if best.form.halo == "none":
        return True
    fraction_index = best.form.names.index("halo_fraction")
    bounds = best.form.bounds[[fraction_index]]
    pressed = np.abs(bounds - best.peak.point[fraction_index]).min() < 1e-3 * np.ptp(bounds)
    return not pressed and not crowds_at_bound(posterior.draws[:, [fraction_index]], bounds).any()


def energy_radius_measurements(fit: FittedSeries) -> list[Measurement]:
    """Return the radii that contain 50 and 90 % of the signal."""
    best, posterior = fit.best, fit.posterior
    reach_px = float(best.problem.series.radius_px[-1])
    radii = energy_radii(best.form, posterior.draws[:DERIVED], (0.5, 0.9), reach_px)
    out = []
    for quantity, draws in zip(
        ("encircled_radius_50", "encircled_radius_90"), radii.T, strict=True
    ):
        if np.isnan(draws).any():
            reason = (
                f"part of this light lies beyond the {reach_px:.0f} px analysed around the source"
            )
            out.append(make_refusal(quantity, "px", reason, **fit.fields))
        else:
            draws = draws * _model_error_factors(best, quantity, len(draws), posterior)
            number = measurement_from_draws(quantity, "px", draws, notes=fit.notes, **fit.fields)
            out.append(judge(number, fit.core_findings))
    return out


def glare_measurements(fit: FittedSeries) -> list[Measurement]:
    """Return the veiling glare, from the backgrounds of all stacks."""
    best, posterior, group = fit.best, fit.posterior, fit.group
    settings = {
        (spot.conditions.mcp_v, spot.conditions.camera_gain_db, spot.conditions.gain_control)
        for spot in group
    }
    if len(settings) > 1:
        return [
            make_refusal(
                "veiling_glare", "%", "the stacks were taken at different gains", **fit.fields
            )
        ]
    solved = best.problem.solve_amplitudes(posterior.draws[:200])
    rows, cols = group[0].image.shape
    area = rows * cols * best.form.pitch_ratio
    source, background = solved.slopes
    aa, ab, bb = (
        (first * second).sum(axis=1)
        for first, second in ((source, source), (source, background), (background, background))
    )
    # Standard error of each stack's background, shape (level, point).
    sd = np.sqrt(np.maximum(aa / np.maximum(aa * bb - ab**2, 1e-300), 1e-12))
    ratios = [
        glare(light, level, error, area)
        for light, level, error in zip(
            solved.amplitudes[:, 0].T, solved.amplitudes[:, 1].T, sd.T, strict=True
        )
    ]
    known = np.array([ratio for ratio in ratios if ratio is not None])
    if not len(known):
        return [
            make_refusal(
                "veiling_glare",
                "%",
                "the backgrounds of at least three stacks are needed",
                **fit.fields,
            )
        ]
    rng = np.random.default_rng([posterior.seed, 1])
    ratio = known[:, 0] + known[:, 1] * rng.standard_normal(len(known))
    ratio = ratio * _model_error_factors(best, "veiling_glare", len(ratio), posterior)
    draws = 100.0 * ratio / (1.0 + np.maximum(ratio, 0.0))
    reach_px = float(best.problem.series.radius_px[-1])
    light = np.median(solved.amplitudes[:, 0], axis=1)
    near_ratio = (float(np.median(ratio)), float(np.hypot(ratio.std(), np.median(known[:, 1]))))
    number = measurement_from_draws(
        "veiling_glare", "%", draws, notes=(*fit.notes, LEAKS), **fit.fields
    )
    leak = find_leak(group, light, reach_px, area, near_ratio)
    return [judge(number, fit.light_findings + leak)]


def mcp_saturation_measurements(fit: FittedSeries) -> list[Measurement]:
    """Return the signal density at half MCP gain, and each stack's core compression.

    The densities of different core models differ by factors; their distance is a systematic
    uncertainty.
    """
    best, posterior, findings = fit.best, fit.posterior, fit.light_findings
    if not isinstance(best.problem, SaturatingSeriesLikelihood):
        reason = "the cores are linear in all stacks: no MCP saturation is visible"
        return [
            make_refusal(
                "mcp_saturation_density", "DN", reason, refusal="not-applicable", **fit.fields
            )
        ]
    # Distance, in ln, of the densities of other cores' models from the best one's.
    saturating = [
        model for model in fit.forms if isinstance(model.problem, SaturatingSeriesLikelihood)
    ]
    ln = np.log(
        [
            max(float(model.peak.point[model.form.names.index("plate_load")]), 1e-9)
            for model in saturating
        ]
    )
    unlike = float(np.abs(ln - ln[0]).max())
    if unlike > float(np.log(4.0)):
        reason = (
            f"core models give densities that differ by a factor of {np.exp(unlike):.2g}: "
            f"describe the camera"
        )
        return [make_refusal("mcp_saturation_density", "DN", reason, **fit.fields)]
    load = best.form.names.index("plate_load")
    if crowds_at_bound(posterior.draws[:, [load]], best.form.bounds[[load]]).any():
        findings.append(
            finding("prior-bound", "the density lies at its bound, and may lie anywhere beyond")
        )
    # For two equally likely cores, the error of either is their distance over root two.
    rng = np.random.default_rng([posterior.seed, 2])
    factors = np.exp(unlike / np.sqrt(2.0) * rng.standard_normal(len(posterior.draws)))
    points = posterior.draws.copy()
    points[:, load] = np.clip(points[:, load] / factors, *best.form.bounds[load])
    density = 1.0 / np.maximum(points[:, load], 1e-9)
    density = density * _model_error_factors(
        best, "mcp_saturation_density", len(density), posterior
    )
    out = [
        measurement_from_draws(
            "mcp_saturation_density", "DN", density, notes=fit.notes, **fit.fields
        )
    ]
    compression = best.problem.compression(points[:DERIVED])
    for label, draws in zip(best.problem.series.labels, compression, strict=True):
        out.append(
            measurement_from_draws("core_compression", "1", draws, stack=label, **fit.fields)
        )
    return [judge(number, findings) for number in out]
