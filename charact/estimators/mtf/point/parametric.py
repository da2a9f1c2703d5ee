"""Points measured by blur models that are fitted to pixels and averaged by evidence; the parametric
method.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import charact
from charact.estimators.mtf.curve import FINE, mtf_measurements, widen_by
from charact.estimators.mtf.known_transfer import halo_diameters_px
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.point.blur_models_2d import (
    BANDWIDTH_ORDERS,
    BlurModel2D,
    mtf_of_camera,
)
from charact.estimators.mtf.point.checks import (
    camera_nonlinearity,
    finding,
    judge_by,
    light_sd,
    source_findings,
    undersampled,
)
from charact.estimators.mtf.point.located_source import locate_source
from charact.estimators.mtf.point.model_fit import BlurModelFit2D, PointFitter
from charact.estimators.mtf.point.model_selection import (
    EvidenceWeightedModels2D,
    fit_source,
)
from charact.estimators.mtf.point.source import (
    PointRefusal,
    refuse_all,
)
from charact.estimators.mtf.point.source_pixels import SourcePixels
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.thresholds import CLIPPING
from charact.inference import importance_sample, laplace
from charact.method import Context, register
from charact.transfer.cores import ON_POINTS
from charact.transfer.extended import (
    DiscComponent,
    ExtendedComponent,
    HaloComponent,
    ScatterComponent,
)
from labdata import (
    Array,
    BadInput,
    Curve,
    FrameStack,
    Measurement,
    Posterior,
    Provenance,
    Result,
    has_tube,
)

METHOD = "point-parametric"
# Cores of a described tube.
TUBES = ("gaussian", "exponential", "moffat")


@register("point", METHOD)
def point_parametric(
    stack: FrameStack,
    *,
    region: Region | None = None,
    pinhole_px: float | tuple[float, float] | None = None,
    context: Context,
) -> Result:
    """Measure the horizontal and vertical MTF of a camera from the image of a point.

    Parameters
    ----------
    stack
        Frames of the source; they are averaged, and their differences give the noise.
    region
        ROW, COL, HEIGHT, WIDTH that contains the source; None: the whole frame.
    pinhole_px
        Diameter of the source's image, column pitches, whose transfer is divided out, or its bounds
        if unknown. None: a point.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf50`, `mtf10` and `mtf` at fixed frequencies in both directions, and the curves "mtf" and
        "mtf_vertical". All frequencies are cycles per column pitch.

    Raises
    ------
    BadInput
        If the pinhole's diameter is negative or its bounds are no interval.

    Notes
    -----
    A pixel's mean is level + slopes + light P(x, y), P the transform of pinhole x pixel x video x
    blur model. Level, slopes and the shift from the best position are marginalised in closed form;
    pixels at full scale enter by the probability of at least that value. The draws are those of
    every blur model in proportion to its evidence.
    """
    described = has_tube(context.camera)

    def forms(pinhole: float | tuple[float, float], holds_halo: bool, reach_px: float):
        cores = [
            BlurModel2D(core=core, round=not described, pinhole_px=pinhole)
            for core in (TUBES if described else ON_POINTS)
        ]
        return cores, _widen_components(context, holds_halo, reach_px)

    method = PointMethod(name=METHOD, quantities=("mtf50", "mtf10", "mtf"), forms=forms)
    return measure_point(method, stack, region, pinhole_px, context)


def _widen_components(
    context: Context, holds_halo: bool, reach_px: float
) -> tuple[ExtendedComponent, ...]:
    """Return the extended components that regions can show."""
    if has_tube(context.camera):
        return (
            (HaloComponent(size_px=halo_diameters_px(context, transposed=False)),)
            if holds_halo
            else ()
        )
    if not reach_px:
        return ()
    return DiscComponent(size_px=(6.0, 2.0 * reach_px)), ScatterComponent(
        size_px=(2.0, reach_px / 3.0)
    )


class PointMethod(NamedTuple):
    """A method for points: its name, quantities and blur models.

    `forms` takes the pinhole's diameter, whether the regions hold a described halo, and the
    distance to which they can show light, px. It returns cores, and extended components to refine
    them with, or None.
    """

    name: str
    quantities: tuple[str, ...]
    forms: Callable[..., tuple[list[BlurModel2D], tuple[ExtendedComponent, ...] | None]]


def measure_point(
    method: PointMethod,
    stack: FrameStack,
    region: Region | None,
    pinhole_px: float | tuple[float, float] | None,
    context: Context,
) -> Result:
    """Measure the MTF from a point by the blur models of a method."""
    pinhole = _pinhole(pinhole_px)
    common = {
        "method": method.name,
        "region": region or (0, 0, *stack.shape[1:]),
        "provenance": Provenance(
            version=charact.__version__,
            seed=context.seed,
            settings={"quick": context.quick, "pinhole_px": pinhole},
        ),
    }
    site = locate_source(stack.region(*region) if region else stack, context)
    if isinstance(site, PointRefusal):
        return refuse_all(common, *site)
    # Rings beyond the light are needed to separate it from the background.
    outer = site.window.ring_px[: -ACCURACY.empty_rings]
    step_px = site.aperture.summed_px
    in_squares = (
        (pinhole[0] / step_px, pinhole[1] / step_px)
        if isinstance(pinhole, tuple)
        else pinhole / step_px
    )
    cores, components = method.forms(
        in_squares, site.window.holds_halo, float(outer[-1].max()) if len(outer) else 0.0
    )
    if any(form.bandwidth_order > 1 for form in cores):
        site = replace(site, aperture=replace(site.aperture, orders=BANDWIDTH_ORDERS))
    site, fitter, models = fit_source(site, cores, components)
    if not models or not models[0].fit.cost < LIMITS.max_cost * models[0].fit.free:
        reason = (
            "no blur model describes the source: it may be light of another shape, or far "
            "beyond full scale"
        )
        return refuse_all(common, reason, "model-misfit")
    best = models[0].fit
    # The noise of a single frame's light is poorly known; there the detection decides.
    is_weak = best.light < LIMITS.min_light_sd * light_sd(fitter, best)
    if (is_weak and site.window.frames > 1) or best.light <= 0:
        n_neighbours = len(site.window.neighbours)
        crowd = (
            f"; {n_neighbours} neighbours interfere, use `roi` around an isolated one"
            if n_neighbours
            else ""
        )
        required = (
            f"no target: the light must be at least {LIMITS.min_light_sd:g} standard "
            f"uncertainties{crowd}"
        )
        return refuse_all(common, required)
    return _result(method, site, fitter, models, {**common, "notes": stack.notes}, pinhole, context)


def _pinhole(pinhole_px: float | tuple[float, float] | None) -> float | tuple[float, float]:
    """Return valid diameter or bounds."""
    low, high = LIMITS.pinhole_px
    if isinstance(pinhole_px, tuple | list):
        smallest, largest = (float(number) for number in pinhole_px)
        if not low <= smallest < largest < high:
            raise BadInput(
                "bounds of pinhole_px must rise within [0, 50) column pitches, got "
                f"{smallest:g} to {largest:g}"
            )
        return smallest, largest
    if pinhole_px is not None and not low <= pinhole_px < high:
        raise BadInput(f"pinhole_px must lie in [0, 50) column pitches, got {pinhole_px:g}")
    return float(pinhole_px or 0.0)


def _result(
    method: PointMethod,
    site: SourcePixels,
    fitter: PointFitter,
    models: list[EvidenceWeightedModels2D],
    common: dict[str, Any],
    pinhole: float | tuple[float, float],
    context: Context,
) -> Result:
    """Return measurements, curves and figure data of a fitted source."""
    best, aperture = models[0].fit, site.aperture
    response = camera_nonlinearity(site, best)
    findings = source_findings(site, fitter, best)
    # Draws of a rejected form are of no use.
    rejected = any(check.flag == "model-misfit" for check in findings)
    drawn = [
        _posterior(fitter, model, number, context, quick=rejected)
        for number, model in enumerate(models)
    ]
    # Of a described tube the pulse widths are tried coarsely, so that noise may appear to grow
    # faster than the light.
    is_clear = response.power < -LIMITS.max_negative_power or not best.form.known
    if response.is_nonlinear and is_clear:
        findings.append(finding("gamma", response.effect))
    if has_tube(context.camera) and site.cut.any():
        findings.append(
            finding(
                "saturated",
                "wells may fill before the digitiser clips; MTF50 may be 26 to 43 % low",
            )
        )
    if any("not-converged" in posterior.flags for posterior in drawn):
        findings.append(finding("not-converged", "draws of a form are too few for its interval"))
    common["notes"] = (*common["notes"], *_notes(site, models, pinhole, context), response.note)
    total = sum(model.weight for model in models)
    wanted = ACCURACY.quick_draws if context.quick else ACCURACY.draws
    counts = [max(1, round(wanted * model.weight / total)) for model in models]
    measured: list[tuple[list[Measurement], Curve, Array]] = []

    def curves_of(frequency: Array, vertical: bool) -> Array:
        """Return the curves that are drawn of all models, shape (draw, frequency)."""
        return np.concatenate(
            [
                mtf_of_camera(
                    model.fit.form, posterior.draws[:count], frequency, aperture, vertical=vertical
                )
                for model, posterior, count in zip(models, drawn, counts, strict=True)
            ]
        )

    for vertical, angle in ((False, 0.0), (True, 90.0)):
        exact = aperture.video is None or vertical or best.form.bandwidth_order > 1
        numbers, curve, _ = mtf_measurements(
            partial(curves_of, vertical=vertical),
            {**common, "orientation_deg": angle},
            posterior=drawn[0],
            doubt=None if exact or aperture.video is None else aperture.video.doubt,
            names=method.quantities,
        )
        measured.append((numbers, curve, np.median(curves_of(FINE, vertical), axis=0)))
    every = [number for numbers, _, _ in measured for number in numbers]
    steps_px = (float(np.diff(at[:2])[0]) for at in (site.window.x, site.window.y))
    aliased = undersampled(every, dict(zip((0.0, 90.0), steps_px, strict=True)))
    measurements: list[Measurement] = []
    curves: dict[str, Curve] = {}
    for name, angle, (numbers, curve, modulus) in zip(
        ("mtf", "mtf_vertical"), (0.0, 90.0), measured, strict=True
    ):
        checks = [*findings, aliased[angle]] if aliased else findings
        measurements += [judge_by(checks, number, FINE, modulus) for number in numbers]
        curves[name] = widen_by(checks, curve, FINE, modulus)
    return Result(
        measurements=tuple(measurements),
        curves=curves,
        evidence={"point-profile": _model_figure_data(site, fitter, best)},
    )


def _posterior(
    fitter: PointFitter,
    model: EvidenceWeightedModels2D,
    number: int,
    context: Context,
    *,
    quick: bool,
) -> Posterior:
    """Sample the posterior of one blur model, by importance sampling; from its curvature if
    quick.
    """
    fit = model.fit
    arguments = {
        "names": fit.form.names,
        "units": fit.form.units,
        "start": fit.point,
        "covariance": fit.covariance,
        "seed": context.seed + number,
        "bounds": fit.form.bounds,
        "draws": ACCURACY.quick_draws if context.quick else ACCURACY.draws,
    }
    log_probability = partial(fitter.log_probability, fit.form)
    if quick:
        return laplace(log_probability, **arguments)
    effort = max(model.weight, 0.15)
    enough, first = ACCURACY.quick_effective if context.quick else ACCURACY.effective
    posterior = importance_sample(
        log_probability,
        **arguments,
        enough=enough * effort,
        first_draws=round(first * effort),
        max_added=ACCURACY.max_added,
    )
    effective = posterior.effective_sample_size
    if effective is not None and effective.min() < ACCURACY.min_effective * effort:
        return replace(posterior, flags=(*posterior.flags, "not-converged"))
    return posterior


def _model_figure_data(
    site: SourcePixels, fitter: PointFitter, fit: BlurModelFit2D
) -> dict[str, Any]:
    """Return the figure data of the most probable model, with the estimated
    quantisation shift.
    """
    pixels, light, background = fitter.pixels, fit.light, site.background()
    nodes = fit.form.nodes(fit.point[None])[0]
    lit = light * (site.matrix()[:, : nodes.size] @ nodes)
    white = pixels.root @ background[site.value_mask]
    level = np.linalg.lstsq(white, pixels.root @ (site.values - lit)[site.value_mask], rcond=None)[
        0
    ]
    mean, mask = lit + background @ level, site.value_mask
    residual = pixels.root.T @ (pixels.root @ (site.values - mean)[mask])
    mean[mask] += pixels.rounding @ residual
    window, (x_px, y_px), step_px = site.window, site.position, site.aperture.summed_px
    core, rings = np.split(mean, [window.core.size])
    core = core.reshape(window.core.shape)
    # The lines through the source's centre.
    row, col = int(np.argmin(np.abs(window.y - y_px))), int(np.argmin(np.abs(window.x - x_px)))
    return {
        "figure": "point-profile",
        "column_px": (step_px * (window.x - x_px)).tolist(),
        "row_px": (step_px * (window.y - y_px)).tolist(),
        "value_dn": window.core.tolist(),
        "model_dn": core.tolist(),
        "used": window.keep.tolist(),
        "along_row_dn": window.core[row].tolist(),
        "along_row_model_dn": core[row].tolist(),
        "along_column_dn": window.core[:, col].tolist(),
        "along_column_model_dn": core[:, col].tolist(),
        "ring_px": (step_px * window.ring_px.mean(axis=1)).tolist(),
        "ring_dn": window.ring_dn.tolist(),
        "ring_sd_dn": np.sqrt(window.ring_variance).tolist(),
        "ring_model_dn": rings.tolist(),
        "light_dn_px2": light,
        "light_sd_dn_px2": light_sd(fitter, fit),
        "pedestal_dn": float(level[0]),
        "chi_squared": fit.chi2,
        "degrees_of_freedom": fit.free,
    }


def _notes(
    site: SourcePixels,
    models: list[EvidenceWeightedModels2D],
    pinhole: float | tuple[float, float],
    context: Context,
) -> tuple[str, ...]:
    """Return notes that do not affect validity."""
    parts = ", ".join(f"{model.fit.form.name} {100 * model.weight:.0f} %" for model in models)
    out = [f"Blur models by evidence: {parts}."]
    cut = int(np.count_nonzero(site.cut.any(axis=0)))
    if cut:
        out.append(f"{cut} pixels at full scale are treated as lower limits.")
        if has_tube(context.camera):
            out.append("Wells may fill before the digitiser clips; use less light.")
            lost = int(np.count_nonzero(~site.window.keep)) - cut
            out.append(
                f"{lost} pixels after full scale, which the video filter affects, are excluded."
            )
    if n_neighbours := len(site.window.neighbours):
        out.append(
            f"{n_neighbours} neighbours of the source are masked; the light of close ones is "
            f"fitted too."
        )
    if (step_px := site.aperture.summed_px) > 1:
        out.append(
            f"The spot is wider than the pixels of a fit: squares of {step_px} x {step_px} pixels "
            "are fitted, in which the parameters of the blur are counted."
        )
    if pinhole == 0.0:
        out.append("The source is assumed to be a point; the size of a pinhole lowers the MTF.")
    if all(model.fit.form.wide is None for model in models):
        out.append("MTF normalised to the core; any halo is not included.")
    if site.dark.correlation.size > 1:
        out.append("Noise is correlated between pixels; accounted for.")
    shift_dn = float(np.exp(-2.0 * np.pi**2 * site.window.quiet_sd**2) / np.pi)
    if shift_dn >= CLIPPING.min_rounding_shift_dn:
        out.append(
            f"Quantisation may shift faint light and its level by up to {shift_dn:.2f} DN; the fit "
            "includes this, and the plotted model the estimated shift."
        )
    return tuple(out)
