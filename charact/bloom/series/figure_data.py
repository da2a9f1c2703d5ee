"""What a report draws of a fitted series: rings with their model, forms with their criterion, diameters by level."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.levenberg_marquardt import optimise
from charact.bloom.series.likelihood import RingSeries, select_levels
from charact.bloom.series.model_selection import FittedHaloModel
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Forms that are cross-validated.
VALIDATED = 3


def profile_evidence(
    best: FittedHaloModel, posterior: Posterior, own: tuple[Array, Array, Array] | None
) -> dict[str, Any]:
    """Rings of all levels with the best form, residuals in their noise, and each level's own halo."""
    series, point = best.problem.series, best.peak.point[None]
    model = best.problem.rings(point)[..., 0]
    solved = best.problem.solve_amplitudes(point)
    sd = np.sqrt(np.diagonal(series.covariance(best.problem.misfit), axis1=1, axis2=2))
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
        "form": best.name,
        "model_share": best.problem.misfit.share,
        "core_share": best.problem.misfit.core,
        "chi2": float(solved.chi2.sum()),
        "freedom": int(series.data.size - 2 * len(series.data) - len(best.peak.point)),
        "halo_diameter_px": None,
    }
    if own is None:
        return {"point-profile": data}
    data |= {
        "halo_diameter_px": float(np.median(posterior["halo_diameter"])),
        "elastic_share": float(np.median(posterior["elastic_share"])),
        "halo_share": [float(np.median(posterior["halo_fraction"]))] * len(series.labels),
    }
    return {"point-profile": data, "halo-constancy": _constancy(series, posterior, own)}


def _constancy(series: RingSeries, posterior: Posterior, own: tuple[Array, Array, Array]) -> dict[str, Any]:
    """Each level's own diameter beside that of all: geometry fixes it whatever the light."""
    seen = np.isfinite(own[0])
    diameter, sd = own[0][seen], np.maximum(own[1][seen], 1e-6)
    joint = float(np.median(posterior["halo_diameter"]))
    return {
        "figure": "halo-constancy",
        "label": [label for label, one in zip(series.labels, seen, strict=True) if one],
        "halo_diameter_px": diameter.tolist(),
        "interval95_px": np.stack([diameter - 1.96 * sd, diameter + 1.96 * sd], axis=1).tolist(),
        "significance": own[2][seen].tolist(),
        "joint_px": joint,
        "joint_elastic_share": float(np.median(posterior["elastic_share"])),
        "chi2_of_constancy": float((((diameter - joint) / sd) ** 2).sum()),
        "freedom": max(0, len(diameter) - 1),
    }


def forms_evidence(forms: list[FittedHaloModel], *, quick: bool) -> dict[str, Any]:
    """Every form tried with its criterion, and with what it foretells of levels it has not seen."""
    foretold = (
        [None] * len(forms) if quick else [cross_validate(one) for one in forms[:VALIDATED]] + [None] * len(forms)
    )
    least = forms[0].bic
    rows = [
        {
            "form": one.name,
            "parameters": len(one.form.names),
            "log_likelihood": one.log_likelihood,
            "bic_over_best": one.bic - least,
            "off_percent": 100.0 * one.problem.misfit.share,
            "core_off_percent": 100.0 * one.problem.misfit.core,
            "foretold_chi2_per_ring": value,
        }
        for one, value in zip(forms, foretold, strict=False)
    ]
    return {"bloom-forms": {"table": rows}}


def cross_validate(candidate: FittedHaloModel) -> float | None:
    """Mean square of what a form leaves of levels that it was not fitted to, in their noise; None with one level.

    Every second level is left out, then the others: core and halo come from the one half, each level's own light and
    background from itself.
    """
    series = candidate.problem.series
    count = len(series.labels)
    if count < 2:
        return None
    total = 0.0
    for fold in (0, 1):
        seen = np.arange(count) % 2 == fold
        peak = optimise(replace(candidate.problem, series=select_levels(series, seen)), candidate.peak.point)
        total += float(
            replace(candidate.problem, series=select_levels(series, ~seen))
            .solve_amplitudes(peak.point[None])
            .chi2.sum()
        )
    return total / series.data.size
