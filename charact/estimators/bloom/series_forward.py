"""Forward model of a point series: halo, core and glare from all stacks, clipping included in the
model.
"""

from typing import Any

import numpy as np

from charact.estimators.bloom.extent_measurements import (
    bloom_measurements,
    is_quantised,
    provenance,
    series_evidence,
)
from charact.estimators.bloom.findings import DIAMETERS, finding
from charact.estimators.bloom.point_stack import DETECTED, PointStack, read_point_stacks
from charact.estimators.bloom.series.halo_edge_step import Rim, rim_of
from charact.estimators.bloom.series.likelihood import RingSeries
from charact.estimators.bloom.series.model_selection import (
    MISFIT_SHARE,
    FittedHaloModel,
    candidates,
    halo_refusal_reason,
    is_uneven,
)
from charact.estimators.bloom.series.ring_series import build_ring_series
from charact.estimators.bloom.series.series_measurements import (
    OF_THE_HALO,
    FittedSeries,
    energy_radius_measurements,
    glare_measurements,
    halo_measurements,
    mcp_saturation_measurements,
    nearest_px,
    refuse_halo,
)
from charact.estimators.bloom.series_consistency import check_consistency
from charact.estimators.bloom.smear import smear_measurement
from charact.estimators.bloom.thresholds import RIM, Unmeasurable
from charact.inference import importance_sample
from charact.method import Context, register
from charact.verdict import Finding, judge
from labdata import Posterior, Result, Session, has_tube


def profile_evidence(fit: FittedSeries) -> dict[str, Any]:
    """Ring means of all stacks with the selected model, normalised residuals, and each stack's own
    halo.
    """
    problem, point, rim = fit.best.problem, fit.best.peak.point[None], fit.rim
    series = problem.series
    model, solved = problem.rings(point)[..., 0], problem.solve_amplitudes(point)
    sd = np.sqrt(np.diagonal(series.covariance(problem.misfit), axis1=1, axis2=2))
    data: dict[str, Any] = {
        "figure": "point-profile",
        "label": list(series.labels),
        "radius_px": [series.radius_px.tolist()] * len(series.labels),
        "mean_dn": series.data.tolist(),
        "sd_dn": sd.tolist(),
        "used": (~series.cut).tolist(),
        "model_dn": model.tolist(),
        "residual_sd": ((series.data - model) / sd).tolist(),
        "full_scale_dn": series.full_dn,
        "light_dn_px2": solved.amplitudes[:, 0, 0].tolist(),
        "background_dn": solved.amplitudes[:, 1, 0].tolist(),
        "form": fit.best.name,
        "model_share": problem.misfit.outer,
        "core_share": problem.misfit.core,
        "chi2": float(solved.chi2.sum()),
        "freedom": int(series.data.size - 2 * len(series.data) - point.size),
        "halo_diameter_px": None,
    }
    if rim is None or fit.no_edge is not None:
        return {"point-profile": data}
    joint, is_measured = rim.diameter_px, np.isfinite(rim.stack_diameters[0])
    data["halo_diameter_px"] = joint
    elastic = None
    if fit.no_disc is None:
        elastic, fraction = (
            float(np.median(fit.posterior[name])) for name in ("elastic_share", "halo_fraction")
        )
        data |= {"elastic_share": elastic, "halo_share": [fraction] * len(series.labels)}
    diameter, sd, significance = rim.stack_diameters[:, is_measured]
    uniformity = {
        "figure": "halo-constancy",
        "label": [
            label for label, measured in zip(series.labels, is_measured, strict=True) if measured
        ],
        "halo_diameter_px": diameter.tolist(),
        "interval95_px": np.stack([diameter - 1.96 * sd, diameter + 1.96 * sd], axis=1).tolist(),
        "significance": significance.tolist(),
        "joint_px": joint,
        "joint_elastic_share": elastic,
        "chi2_of_constancy": float((((diameter - joint) / sd) ** 2).sum()),
        "freedom": max(0, len(diameter) - 1),
    }
    return {"point-profile": data, "halo-constancy": uniformity}


def forms_evidence(forms: list[FittedHaloModel]) -> dict[str, Any]:
    """Information criterion of every fitted model."""
    rows = [
        {
            "form": model.name,
            "parameters": len(model.form.names),
            "log_likelihood": model.log_likelihood,
            "bic_over_best": model.bic - forms[0].bic,
            "off_percent": 100.0 * model.problem.misfit.outer,
            "core_off_percent": 100.0 * model.problem.misfit.core,
        }
        for model in forms
    ]
    return {"bloom-forms": {"table": rows}}


METHOD = "series-forward"
# Densities added to the proposal of the posterior: more would take longer than all else.
MOST_ADDED = 12


@register("bloom", METHOD)
def series_forward(session: Session, *, context: Context) -> Result:
    """Measure halo, encircled energy, glare, bloom diameters and streaks of a point series.

    Parameters
    ----------
    session
        Session with stacks of kind "point".
    context
        Seed and settings; the sensor description, if known, gives pitches and the core's prior.

    Notes
    -----
    Cores (Gaussian, image tube, Gaussian with a Moffat wing), without a halo and with a disc of
    backscattered electrons, are fitted to the ring means of all stacks together and selected by the
    Bayesian information criterion. Each stack has its own signal and
    background. The halo's diameter is that of the step that the rings show under any smooth curve,
    whatever the models of core and wings; its light is reported if a disc is clearly the best
    model.
    """
    spots = read_point_stacks(session, context=context)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    evidence: dict[str, dict[str, Any]] = {}
    extents = bloom_measurements(
        spots, square=not has_tube(context.camera), sensor=context.camera, **fields
    )
    try:
        fit = _fit_series(session, spots, context, fields)
        measured = halo_measurements(fit)
        measured += energy_radius_measurements(fit) + glare_measurements(fit)
        measured += mcp_saturation_measurements(fit) if _has_tube(fit.group, context) else []
        evidence = profile_evidence(fit) | forms_evidence(fit.forms)
        labels = {spot.label for spot in fit.group}
        misfit = [check for check in fit.findings if check.flag == "model-misfit"]
        extents = [
            judge(extent, misfit)
            if extent.quantity in DIAMETERS and extent.stack in labels
            else extent
            for extent in extents
        ]
    except Unmeasurable as refusal:
        measured = refuse_halo(str(refusal), OF_THE_HALO, fields)
    smear, of_smear = smear_measurement(spots, context, **fields)
    steady = check_consistency(session, spots, context, **fields)
    halo = evidence.get("halo-constancy", {"label": (), "halo_diameter_px": ()})
    halos = dict(zip(halo["label"], halo["halo_diameter_px"], strict=True))
    return Result(
        measurements=(*map(steady.judge, (*measured, smear, *extents)), *steady.measurements),
        evidence={"bloom-series": series_evidence(spots, halos)}
        | evidence
        | of_smear
        | steady.evidence,
    )


def _has_tube(group: tuple[PointStack, ...], context: Context) -> bool:
    return has_tube(context.camera) or any(spot.conditions.mcp_v is not None for spot in group)


def _fit_series(
    session: Session, spots: tuple[PointStack, ...], context: Context, fields: dict[str, Any]
) -> FittedSeries:
    """Fit all models to the rings of a series, and draw the posterior of the best one."""
    clear = tuple(spot for spot in spots if spot.significance > DETECTED)
    if not clear:
        raise Unmeasurable("no point source is detected")
    series, group = build_ring_series(session, clear, context=context)
    context.progress("blur models of the source", 0.9)
    tube = _has_tube(group, context)
    rim = rim_of(series, pitch_ratio=context.pitch_ratio, has_tube=tube)
    diameter_px = float("nan")
    if rim is not None and rim.significance > RIM.least_sd:
        diameter_px = rim.diameter_px
    forms = candidates(
        series,
        pitch_ratio=context.pitch_ratio,
        sensor=context.camera,
        has_tube=tube,
        first_diameter_px=diameter_px,
    )
    context.progress("posterior of the series", 0.95)
    posterior = _posterior(forms[0], context)
    of_edge = _edge_findings(series, rim)
    if is_quantised(min(group, key=lambda spot: spot.full_scale_dn - spot.dark_dn)):
        of_edge.append(finding("quantised"))
    of_posterior = [finding(flag) for flag in posterior.flags if flag != "prior-bound"]
    return FittedSeries(
        forms=forms,
        rim=rim,
        no_edge=None if rim is None else rim.why_no_edge(),
        no_disc=halo_refusal_reason(forms),
        posterior=posterior,
        group=group,
        edge_findings=of_edge,
        findings=[*of_edge, *of_posterior, *misfit_findings(forms[0])],
        notes=_notes(context, group, spots),
        fields=fields,
    )


def _posterior(best: FittedHaloModel, context: Context) -> Posterior:
    """Posterior draws of the selected model's parameters."""
    return importance_sample(
        best.problem.log_probability,
        names=best.form.names,
        units=best.form.units,
        start=best.peak.point,
        covariance=best.peak.covariance,
        seed=context.seed,
        bounds=best.form.bounds,
        enough=100.0 if context.quick else 1000.0,
        first_draws=500 if context.quick else 2000,
        max_added=MOST_ADDED,
    )


def misfit_findings(best: FittedHaloModel) -> list[Finding]:
    """Return the finding of rings that no model describes."""
    if best.problem.misfit.outer <= MISFIT_SHARE:
        return []
    deviation = f"rings deviate by {100.0 * best.problem.misfit.outer:.2g} % of their signal"
    return [finding("model-misfit", deviation)]


def _edge_findings(series: RingSeries, rim: Rim | None) -> list[Finding]:
    """Findings of the rings themselves, whatever the model."""
    findings = [finding("model-misfit")] if is_uneven(series) else []
    if rim is not None and rim.diameter_px / 2.0 > 0.92 * series.radius_px[-1]:
        findings.append(finding("window-too-small"))
    return findings


def _notes(
    context: Context, group: tuple[PointStack, ...], spots: tuple[PointStack, ...]
) -> tuple[str, ...]:
    notes = (
        () if has_tube(context.camera) else ("the row pitch is unknown: pixels are assumed square",)
    )
    if np.isfinite(nearest_px(group)):
        notes += (
            (
                f"pixels nearer to another source, {nearest_px(group):.0f} px away or more, are "
                f"excluded"
            ),
        )
    if len(group) < len(spots):
        notes += (
            (
                f"{len(group)} of {len(spots)} stacks show a source at one position, the others "
                "are excluded"
            ),
        )
    return notes
