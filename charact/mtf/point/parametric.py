"""Parametric method for points: blur models fitted to pixels and averaged by evidence."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.blur_models.one_dimensional import DiscComponent, ExtendedComponent, HaloComponent, ScatterComponent
from charact.mtf.curve import (
    FINE,
    LEVELS,
    PINNED,
    REPORTED,
    crossing_frequency,
    crossing_measurement,
    curve_of,
    flag_filter_uncertainty,
)
from charact.mtf.image_lag import image_lag_model
from charact.mtf.known_transfer import halo_diameters_px
from charact.mtf.mean_frame import Region
from charact.mtf.point.findings import finding, flag_undersampled
from charact.mtf.point.model_fit import BlurModelFit2D, PointFitter
from charact.mtf.point.model_selection import EvidenceWeightedModels2D, fit_sources
from charact.mtf.point.parametric_checks import camera_nonlinearity, light_sd, source_findings
from charact.mtf.point.parametric_noise import measure_surroundings_noise
from charact.mtf.point.source import detect_source
from charact.mtf.point.source_pixels import SourcePixels
from charact.mtf.point.source_window import neighbour_mask, rounding_note, source_figure_data, source_window
from charact.mtf.point.spot_image_matrix import Aperture
from charact.mtf.point.thresholds import ACCURACY, LIMITS
from charact.posterior import has_several_peaks, importance_sample, sample_posterior
from charact.video_filter import VideoFilter
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Posterior, Provenance, Result, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

METHOD = "point-parametric"


@register(
    "point",
    METHOD,
    quantities=("mtf50", "mtf10", "mtf"),
    scope=(
        "Single point sources or pinholes of known, bounded or zero size, light over 6 standard uncertainties, one "
        "frame or more, blur of lenses and tubes: Gaussian, exp(-(f/fc)^n) with or without a Gaussian, Moffat, "
        "diffraction with or without central obscuration and defocus, round, elliptical or separable with an aspect "
        "up to 1.5, with halo, disc or scatter inside the region, neighbours at least 5 px away; "
        "MTF50 below 0.42 cycles per pixel. "
        "Pixels at full scale are treated as lower limits; with a sensor description, whose wells may fill first and "
        "whose video filter spreads clipped light, the result is suspect. Not detected: a second source within the "
        "blur, a pinhole of unstated size, and a nonlinear response that the noise does not show: a gamma of g changes "
        "MTF50 by about the root of g, and more with a halo."
    ),
)
def point_parametric(
    stack: FrameStack,
    *,
    region: Region | None = None,
    regions: tuple[Region, ...] | None = None,
    pinhole_px: float | tuple[float, float] | None = None,
    context: Context,
) -> Result:
    """Measure the horizontal and vertical MTF of a camera from the image of one or several points.

    Parameters
    ----------
    stack
        Frames of the sources; they are averaged, and their differences give the noise.
    region
        ROW, COL, HEIGHT, WIDTH that contains the source; None: the whole frame.
    regions
        Regions of several sources of one size, fitted with one transfer; they replace `region`.
    pinhole_px
        Diameter of the source's image, column pitches, whose transfer is divided out, or its bounds if unknown. None: a
        point.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf50`, `mtf10` and `mtf` at fixed frequencies in both directions, and the curves "mtf" and "mtf_vertical". All
        frequencies are cycles per column pitch.

    Raises
    ------
    BadInput
        If the pinhole's diameter is negative or its bounds are no interval, or if there are no regions.

    Notes
    -----
    A pixel's mean is level + slopes + light P(x, y), P the transform of pinhole x pixel x video x blur model. Level,
    slopes and the shift from the best position are marginalised in closed form; pixels at full scale enter by the
    probability of at least that value. The draws are those of every blur model in proportion to its evidence.
    """
    task = _Task(context=context, region=region or (0, 0, *stack.shape[1:]), pinhole=_pinhole(pinhole_px))
    if regions is not None and not regions:
        raise BadInput("several sources require at least one region, got none")
    parts = [stack.region(*one) for one in regions] if regions else [stack if region is None else stack.region(*region)]
    sites = []
    for part in parts:
        site = _locate_source(part, context)
        if isinstance(site, tuple):
            return task.nothing(*site)
        sites.append(site)
    sites, fitter, found = fit_sources(sites, task.pinhole, _extended_components(sites, parts, context))
    best = found[0].fit
    # The noise of a single frame's light is poorly known; there the detection decides.
    weak = best.light < LIMITS.min_light_sd * light_sd(fitter, best)
    if (weak.any() and sites[0].window.frames > 1) or (best.light <= 0).any():
        n_neighbours = sum(len(site.window.neighbours) for site in sites)
        crowd = f"; {n_neighbours} neighbours interfere, use --roi around an isolated one" if n_neighbours else ""
        return task.nothing(
            f"no target: the light must be at least {LIMITS.min_light_sd:g} standard uncertainties{crowd}", "no-target"
        )
    return task.result(sites, fitter, found, stack.notes)


def _pinhole(pinhole_px: float | tuple[float, float] | None) -> float | tuple[float, float]:
    """Return valid diameter or bounds."""
    low, high = LIMITS.pinhole_px
    if isinstance(pinhole_px, tuple | list):
        least, most = (float(number) for number in pinhole_px)
        if not low <= least < most < high:
            raise BadInput(f"bounds of pinhole_px must rise within [0, 50) column pitches, got {least:g} to {most:g}")
        return least, most
    if pinhole_px is not None and not low <= pinhole_px < high:
        raise BadInput(f"pinhole_px must lie in [0, 50) column pitches, got {pinhole_px:g}")
    return float(pinhole_px or 0.0)


def _locate_source(part: FrameStack, context: Context) -> SourcePixels | tuple[str, str]:
    """Return the source of a part of the frames, or reason and flag of a refusal."""
    if min(part.shape[1:]) < LIMITS.min_region_px:
        return (
            f"a point needs a region of at least {LIMITS.min_region_px} x {LIMITS.min_region_px} px",
            "window-too-small",
        )
    full = context.full_scale_dn or part.full_scale_dn
    source = detect_source(part.data, context.pitch_ratio)
    if isinstance(source, str):
        bright = full is not None and np.median(part.data, axis=0).max() >= full
        return ("the source is too bright: there is no background", "saturated") if bright else (source, "no-target")
    window = source_window(part, source, context, source.neighbours)
    height = np.maximum(window.core - np.median(window.core), 0.0)
    if height[window.keep].sum() < LIMITS.min_unclipped_light * height.sum():
        return "the source is too bright: pixels below full scale contain too little of its light", "saturated"
    rows = 2.0 if context.interlaced else 1.0
    site = SourcePixels(
        window=window,
        aperture=Aperture(height_px=rows * context.pitch_ratio, video=VideoFilter.of(context.sensor)),
        dark=measure_surroundings_noise(
            part.data, source.row, source.col, neighbour_mask(part.shape[1:], source.neighbours, context.pitch_ratio)
        ),
        memory=image_lag_model(context, window.frames),
        full_scale_dn=full,
        screen=context.sensor is not None,
    )
    return site


def _extended_components(
    sites: list[SourcePixels], parts: list[FrameStack], context: Context
) -> tuple[ExtendedComponent, ...]:
    """Return the extended components that the regions can show."""
    if context.sensor is not None:
        low, high = halo_diameters_px(context, transposed=False)
        return (HaloComponent(size_px=(low, high)),) if all(site.window.holds_halo for site in sites) else ()
    # Rings beyond the light are needed to separate it from the background.
    rings = min((site.window.ring_px for site in sites), key=len)
    if len(rings) <= ACCURACY.empty_rings:
        return ()
    reach = float(rings[-1 - ACCURACY.empty_rings].max())
    return DiscComponent(size_px=(6.0, 2.0 * reach)), ScatterComponent(size_px=(2.0, reach / 3.0))


@dataclass(frozen=True, kw_only=True)
class _Task:
    """Arguments of a measurement."""

    context: Context
    region: Region
    pinhole: float | tuple[float, float]

    @property
    def _common(self) -> dict[str, Any]:
        settings = {"quick": self.context.quick, "pinhole_px": self.pinhole}
        provenance = Provenance(version=charact.__version__, seed=self.context.seed, settings=settings)
        return {"method": METHOD, "region": self.region, "provenance": provenance}

    def nothing(self, reason: str, flag: str) -> Result:
        """Return the refusal of all quantities."""
        return Result(measurements=tuple(
            make_refusal(name, "cy/px", reason, orientation_deg=angle, flags=(flag,), **self._common)
            for angle in (0.0, 90.0) for name in ("mtf50", "mtf10")
        ))  # fmt: skip

    def result(
        self,
        sites: list[SourcePixels],
        fitter: PointFitter,
        found: list[EvidenceWeightedModels2D],
        notes: tuple[str, ...],
    ) -> Result:
        """Return measurements and curves of fitted sources."""
        drawn = [self._posterior(fitter, one, number) for number, one in enumerate(found)]
        pedestals = np.array([float(np.median(site.window.core)) for site in sites])
        response = camera_nonlinearity(sites, found[0].fit)
        findings = source_findings(sites, fitter, found, pedestals)
        if response.is_nonlinear:
            findings.append(finding("gamma", response.effect))
        if self.context.sensor and any(site.cut.any() for site in sites):
            findings.append(
                finding("saturated", "wells may fill before the digitiser clips; MTF50 may be 26 to 43 % low")
            )
        if any("not-converged" in one.flags for one in drawn):
            findings.append(finding("not-converged", "interval from the curvature at the optimum"))
        common = {
            **self._common,
            "notes": (*notes, *_notes(sites, found, self.pinhole, self.context), response.note),
        }
        total = sum(one.share for one in found)
        wanted = ACCURACY.quick_draws if self.context.quick else ACCURACY.draws
        counts = [max(1, round(wanted * one.share / total)) for one in found]
        measurements: list[Measurement] = []
        curves = {}
        frequency = np.concatenate([FINE, PINNED, np.maximum(REPORTED, 1e-6)])
        for name, cosine, angle in (("mtf", 1.0, 0.0), ("mtf_vertical", -1.0, 90.0)):
            aperture = sites[0].aperture
            known = np.abs(aperture.horizontal(frequency) if cosine > 0 else aperture.vertical(frequency))
            draws = known * np.abs(np.concatenate([
                one.fit.form.camera(posterior.draws[:count], frequency, np.array([cosine]))[:, 0]
                for one, posterior, count in zip(found, drawn, counts, strict=True)
            ]))  # fmt: skip
            fine, pinned, reported = np.split(draws, [FINE.size, FINE.size + len(PINNED)], axis=1)
            one = {**common, "orientation_deg": angle}
            own = [
                _note_several_peaks(
                    crossing_measurement(quantity, fine, drawn[0], one), crossing_frequency(FINE, fine, at)
                )
                for quantity, at in LEVELS.items()
            ]
            own += [
                _note_several_peaks(
                    measurement_from_draws("mtf", "1", pinned[:, index], frequency_cy_per_px=float(f), **one),
                    pinned[:, index],
                )
                for index, f in enumerate(PINNED)
            ]
            doubt = aperture.video.doubt if aperture.video is not None and cosine > 0 else None
            crossing = partial(_crossing, fine)
            measurements += [flag_filter_uncertainty(number, doubt, crossing) for number in own]
            curves[name] = curve_of(REPORTED, reported)
        measurements = [one.with_(findings=findings) for one in measurements]
        return Result(
            measurements=flag_undersampled(measurements, sites[0].window),
            curves=curves,
            evidence={"point-profile": _model_figure_data(sites[0], fitter, found[0].fit)},
        )

    def _posterior(self, fitter: PointFitter, one: EvidenceWeightedModels2D, number: int) -> Posterior:
        """Sample the posterior of one blur model, by importance sampling if quick."""
        fit = one.fit
        arguments = {
            "names": tuple(fit.form.parameters),
            "units": tuple(unit for unit, _ in fit.form.parameters.values()),
            "start": fit.point,
            "covariance": fit.covariance,
            "seed": self.context.seed + number,
            "bounds": fit.form.bounds,
            "draws": ACCURACY.quick_draws if self.context.quick else ACCURACY.draws,
        }

        def log_probability(theta: Array) -> Array:
            return fitter.log_probability(fit.form, theta)

        if self.context.quick:
            fraction = max(one.share, ACCURACY.min_quick_effort)
            enough, first = ACCURACY.quick_ess * fraction, round(ACCURACY.quick_first_draws * fraction)
            return importance_sample(log_probability, **arguments, enough=enough, first_draws=first)
        return sample_posterior(
            log_probability,
            **arguments,
            max_steps=ACCURACY.parametric_chain_steps,
            effort=max(one.share, ACCURACY.min_full_effort),
        )


def _model_figure_data(site: SourcePixels, fitter: PointFitter, fit: BlurModelFit2D) -> dict[str, Any]:
    """Return the figure data of the most probable model for the first source, with the estimated quantisation shift."""
    pixels, light, background = fitter.pixels[0], float(fit.light[0]), site.background()
    lit = light * (site.matrix() @ fitter.nodes(fit.form, fit.point[None])[0])
    white = pixels.root @ background[site.value_mask]
    level = np.linalg.lstsq(white, pixels.root @ (site.values - lit)[site.value_mask], rcond=None)[0]
    mean, used = lit + background @ level, site.value_mask
    left = pixels.root.T @ (pixels.root @ (site.values - mean)[used])
    mean[used] += pixels.rounding @ left
    core, rings = np.split(mean, [site.window.core.size])
    return source_figure_data(
        site.window,
        site.place,
        core.reshape(site.window.core.shape),
        rings,
        light_dn_px2=light,
        light_sd_dn_px2=float(light_sd(fitter, fit)[0]),
        pedestal_dn=float(level[0]),
        chi_squared=fit.chi2,
        degrees_of_freedom=fit.free,
    )


def _crossing(fine: Array, level: float) -> float:
    return float(np.nanmedian(crossing_frequency(FINE, fine, level)))


def _note_several_peaks(one: Measurement, draws: Array) -> Measurement:
    """Add a note where the draws have several peaks, which the interval spans."""
    finite = draws[np.isfinite(draws)]
    if one.value is None or not has_several_peaks(finite[:, None]):
        return one
    low, high = np.quantile(finite, (0.16, 0.84))
    return one.with_(notes=(*one.notes, f"Blur models of similar evidence give {low:.3g} and {high:.3g}."))


def _notes(
    sites: list[SourcePixels],
    found: list[EvidenceWeightedModels2D],
    pinhole: float | tuple[float, float],
    context: Context,
) -> tuple[str, ...]:
    """Return notes that do not affect validity."""
    parts = ", ".join(f"{one.fit.form.name} {100 * one.share:.0f} %" for one in found)
    out = [f"Blur models by evidence: {parts}."]
    cut = sum(int(np.count_nonzero(site.cut.any(axis=0))) for site in sites)
    if cut:
        out.append(f"{cut} pixels at full scale are treated as lower limits.")
        if context.sensor is not None:
            out.append("Wells may fill before the digitiser clips; use less light.")
            lost = sum(int(np.count_nonzero(~site.window.keep)) for site in sites) - cut
            out.append(f"{lost} pixels after full scale, which the video filter affects, are excluded.")
    if n_neighbours := sum(len(site.window.neighbours) for site in sites):
        out.append(f"{n_neighbours} neighbours of the source are masked; the light of close ones is fitted too.")
    if pinhole == 0.0:
        out.append("The source is assumed to be a point; the size of a pinhole lowers the MTF.")
    if all(one.fit.form.wide is None for one in found):
        out.append("MTF normalised to the core; any halo is not included.")
    if any(site.dark.common > 0 for site in sites):
        out.append("Noise is correlated between pixels; accounted for.")
    out += rounding_note(min((site.window for site in sites), key=lambda window: window.quiet_sd))
    if context.sensor is None:
        out.append("Pixels taken as square.")
    return tuple(out)
