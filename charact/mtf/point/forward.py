"""Forward method for points: the core's pixels fitted with correlated pulse noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.curve import FINE, LEVELS, REPORTED, crossing_measurement, curve_of
from charact.mtf.image_lag import image_lag_model
from charact.mtf.mean_frame import Region
from charact.mtf.point.findings import finding, flag_undersampled, motion_findings, motion_flags
from charact.mtf.point.forward_fit import PointFit, fit, near_pixels
from charact.mtf.point.forward_model import KnownPointOptics
from charact.mtf.point.nonlinearity import SpotNonlinearity, fit_nonlinearity, power_log_likelihoods
from charact.mtf.point.source import DetectedSource, detect_source, round_down
from charact.mtf.point.source_window import Window, rounding_note, source_figure_data, source_window
from charact.mtf.point.thresholds import ACCURACY, LIMITS
from charact.posterior import importance_sample, sample_posterior
from charact.video_filter import VideoFilter
from labdata.errors import BadInput
from labdata.flags import Finding
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Posterior, Provenance, Result, make_refusal

Array = NDArray[np.float64]

METHOD = "point-forward"


@register(
    "point",
    METHOD,
    quantities=tuple(LEVELS),
    scope=(
        "Single point sources whose core stays below full scale, light over 6 standard uncertainties, of an "
        "intensifier or of an ordinary camera. A core beyond full scale is excluded and flagged; motion and neighbours "
        "are flagged; MTF50 below 0.42 cycles per pixel. Without a sensor description no halo is assumed: one above "
        "three standard uncertainties is flagged, a fainter one raises MTF50 by part of its uncertainty. Not detected: "
        "a second source within the blur, and a nonlinear response, which only scales the width of one spot (a gamma "
        "of g changes MTF50 by about the root of g)."
    ),
)
def point_forward(
    stack: FrameStack, *, region: Region | None = None, pinhole_px: float | None = None, context: Context
) -> Result:
    """Measure the horizontal and vertical MTF of a camera from the image of a point source.

    Parameters
    ----------
    stack
        Frames of one point source; they are averaged, and their differences give the noise.
    region
        ROW, COL, HEIGHT, WIDTH that contains the source; None: the whole frame.
    pinhole_px
        Diameter of the source's image, column pitches, whose transfer is divided out. None: a point.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf50` and `mtf10` in both directions, the curves "mtf" and "mtf_vertical", and the profile as figure data. All
        frequencies are cycles per column pitch.

    Raises
    ------
    BadInput
        If the pinhole's diameter is negative.

    Notes
    -----
    A pixel's mean is pedestal + light P(x, y), P the transform of
    pinhole x pixel x video x exp(-(f/fc)^n - 2 (pi f s)^2) x [(1 - q) + q H_halo].
    Light and pedestal are marginalised in closed form.
    """
    if pinhole_px is not None and not 0 <= pinhole_px < 50:
        raise BadInput(f"pinhole_px must lie in [0, 50) column pitches, got {pinhole_px:g}")
    used = stack if region is None else stack.region(*region)
    where = region or (0, 0, *used.shape[1:])
    task = PointTask(context=context, where=where, pinhole_px=pinhole_px)
    if min(used.shape[1:]) < LIMITS.min_region_px:
        return task.nothing(f"a point needs a region of at least {LIMITS.min_region_px} x {LIMITS.min_region_px} px, "
                            f"got {where[2:]}",
                            "window-too-small")  # fmt: skip
    source = detect_source(used.data, context.pitch_ratio)
    if isinstance(source, str):
        full = context.full_scale_dn or used.full_scale_dn
        if full is not None and used.data.max() >= full and np.median(used.data, axis=0).max() >= full:
            return task.nothing(
                "the source is too bright: pixels remain at full scale and there is no background", "saturated"
            )
        return task.nothing(source, "no-target")
    window = source_window(used, source, context)
    kept = _usable_light_fraction(window)
    if kept < LIMITS.min_valid_light:
        return task.nothing(f"the source is too bright: {100 * (1 - kept):.0f} % of its core's light lies in pixels "
                            "affected by full scale", "saturated")  # fmt: skip
    found = fit(window, context, _optics(context, pinhole_px or 0.0))
    if found is None:
        return task.nothing(
            "no target: the light above the background is not the image of a point",
            "no-target",
            *_motion_flags(window),
        )
    if found.light < LIMITS.min_light_sd * found.light_sd:
        stands = round_down(found.light / found.light_sd)
        return task.nothing(
            f"no target: the light is {stands:.1f} standard uncertainties; "
            f"at least {LIMITS.min_light_sd:g} are required",
            "no-target",
            *_motion_flags(window),
        )
    return task.result(found, window, source, used, _posterior(found, context))


def _usable_light_fraction(window: Window) -> float:
    """Return the fraction of the core's light in valid pixels; invalid ones count with their clipped height."""
    height = np.maximum(window.core - np.median(window.core), 0.0)
    return float(height[window.keep].sum() / max(float(height.sum()), 1e-12))


def _motion_flags(window: Window) -> tuple[str, ...]:
    """Return the motion flags of a source that is too faint, or appears so by its motion."""
    if window.frames < 2 or not window.keep.all():
        return ()
    return tuple(motion_flags(window.frames_above(window.border_dn), *window.offsets_from_centre, window.row_parity))


def _optics(context: Context, pinhole_px: float) -> KnownPointOptics:
    """Return the known pixel aperture and video filter."""
    return KnownPointOptics(
        width_px=1.0,
        height_px=(2.0 if context.interlaced else 1.0) * context.pitch_ratio,
        video=VideoFilter.of(context.sensor),
        pinhole_px=pinhole_px,
        top=2.0 if context.sensor is None else 1.2,
    )


def _posterior(found: PointFit, context: Context) -> Posterior:
    """Sample the posterior, by importance sampling if quick."""
    prior = found.model.prior
    arguments = {
        "names": prior.names,
        "units": prior.units,
        "start": found.point,
        "covariance": found.covariance,
        "seed": context.seed,
        "bounds": prior.bounds[prior.free_index],
    }
    if context.quick:
        return importance_sample(
            found.log_probability, **arguments, enough=ACCURACY.quick_ess, first_draws=ACCURACY.quick_first_draws
        )
    return sample_posterior(found.log_probability, **arguments, max_steps=ACCURACY.forward_chain_steps)


@dataclass(frozen=True, kw_only=True)
class PointTask:
    """Arguments of a measurement."""

    context: Context
    where: Region
    pinhole_px: float | None

    @property
    def provenance(self) -> Provenance:
        """Version, seed and settings."""
        settings = {"quick": self.context.quick, "pinhole_px": self.pinhole_px}
        return Provenance(version=charact.__version__, seed=self.context.seed, settings=settings)

    def nothing(self, reason: str, *flags: str) -> Result:
        """Return the refusal of all quantities."""
        common = {"method": METHOD, "flags": flags, "region": self.where}
        return Result(measurements=tuple(
            make_refusal(name, "cy/px", reason, orientation_deg=angle, provenance=self.provenance, **common)
            for name in LEVELS for angle in (0.0, 90.0)
        ))  # fmt: skip

    def result(
        self,
        found: PointFit,
        window: Window,
        source: DetectedSource,
        used: FrameStack,
        posterior: Posterior,
    ) -> Result:
        """Return measurements, curves and figure data of a fitted source."""
        findings = fit_findings(found, window, source, self.context)
        if "not-converged" in posterior.flags:
            findings.append(finding("not-converged", "interval from the curvature at the optimum"))
        common = {
            "method": METHOD,
            "notes": (*used.notes, *fit_notes(found, window, self.context, self.pinhole_px)),
            "region": self.where,
            "provenance": self.provenance,
        }
        measurements: list[Measurement] = []
        curves = {}
        for name, vertical in (("mtf", False), ("mtf_vertical", True)):
            fine = found.model.mtf(posterior.draws, FINE, vertical=vertical)
            angle = 90.0 if vertical else 0.0
            measurements += [
                crossing_measurement(quantity, fine, posterior, {**common, "orientation_deg": angle})
                for quantity in LEVELS
            ]
            curves[name] = curve_of(REPORTED, found.model.mtf(posterior.draws, REPORTED, vertical=vertical))
        measurements = [one.with_(findings=findings) for one in measurements]
        return Result(
            measurements=flag_undersampled(measurements, window),
            curves=curves,
            evidence={"point-profile": fit_figure_data(found, window)},
        )


def fit_findings(found: PointFit, window: Window, source: DetectedSource, context: Context) -> list[Finding]:
    """Return the findings of a fitted source."""
    out = []
    if not window.keep.all():
        lost = 100.0 * float(np.mean(~window.keep))
        out.append(finding("saturated", f"full scale affects {lost:.0f} % of the core's pixels, which are excluded"))
    if window.clipped:
        out.append(finding("clipped", "noise is clipped at black; MTF50 is half a standard uncertainty high"))
    if found.light < LIMITS.low_light_sd * found.light_sd:
        stands = found.light / found.light_sd
        effect = f"light {stands:.1f} standard uncertainties; intervals are validated from {LIMITS.low_light_sd:g}"
        out.append(finding("low-signal", effect))
    halo = context.sensor is None and _has_unmodelled_halo(found)
    if halo or found.chi2 / found.free > LIMITS.max_chi2 + LIMITS.max_chi2_sd * np.sqrt(2.0 / found.free):
        effect = f"residuals are {np.sqrt(found.chi2 / found.free):.2g} times the noise"
        beyond = "; light around the core, which lowers MTF50 by its fraction, is not included" if halo else ""
        out.append(finding("model-misfit", effect + beyond))
    if source.others:
        out.append(finding("several-targets", "light of another source in the region is not modelled"))
    if window.cut or (context.sensor is not None and not window.holds_halo):
        effect = "light beyond the region is not included; MTF50 may be high by its fraction"
        out.append(finding("window-too-small", effect))
    if _is_at_prior_bound(found, context):
        effect = f"the core is at a bound or {LIMITS.max_prior_sd:g} standard deviations from the description"
        out.append(finding("prior-bound", effect))
    if window.keep.all():
        out += motion_findings(
            motion_flags(window.frames_above(found.pedestal), *window.offsets_from_centre, window.row_parity)
        )
        response = _noise_nonlinearity(found, window, context)
        if response is not None and response.is_nonlinear and response.power < -LIMITS.max_negative_power:
            out.append(finding("gamma", response.effect))
    return out


def _has_unmodelled_halo(found: PointFit) -> bool:
    """Return whether a disc of light surrounds the core of a camera without a description.

    A disc of missing light, as by sharpening, counts too. Its light is fitted to first order, all parameters free.
    """
    model = found.model
    step = 0.01 * np.sqrt(np.diag(found.covariance))
    ahead, behind = (found.shapes(found.point + sign * np.diag(step)) for sign in (1.0, -1.0))
    unit = found.shapes(found.point[None])
    flat = np.ones((1, unit.shape[1]))
    own = np.concatenate([unit, flat, found.light * (ahead - behind) / (2.0 * step[:, None])]) @ found.white.T
    basis = np.linalg.qr((own / np.linalg.norm(own, axis=1, keepdims=True)).T)[0]
    at = dict(zip(model.prior.free, found.point, strict=True))
    radius = np.hypot(model.x - at["x_px"], (model.y - at["y_px"])[:, None])[found.keep]
    radii = np.concatenate([radius, model.ring_px.mean(axis=1)]) if model.ring_px.size else radius
    halos = found.light * np.array([_disc(radii, size) for size in ACCURACY.trial_halos_px]) @ found.white.T
    halos = halos - (halos @ basis) @ basis.T
    left = found.white @ found.data
    left = left - basis @ (basis.T @ left)
    return bool(np.max(np.abs(halos @ left) / np.linalg.norm(halos, axis=1)) > LIMITS.min_halo_sd)


def _disc(radius_px: Array, diameter_px: float) -> Array:
    """Return a disc of unit light with a soft rim, 1/px^2."""
    return (
        0.5 * (1.0 - np.tanh((radius_px - 0.5 * diameter_px) / ACCURACY.halo_rim_px)) / (0.25 * np.pi * diameter_px**2)
    )


def _noise_nonlinearity(found: PointFit, window: Window, context: Context) -> SpotNonlinearity | None:
    """Return the nonlinearity from the frames' noise; only a compressive response makes noise grow less than pulses do.

    Pulse widths are from a coarse set, so that noise may appear to grow faster.
    """
    if found.noise is None or window.frames < ACCURACY.min_noise_frames:
        return None
    light = found.light * found.model.core(found.point[None])[0].ravel()
    pulses = found.noise.gain * found.light * found.noise.pulse
    pulses = pulses * image_lag_model(context, window.frames).between_rows(window.parity)
    dark = window.floor * np.eye(light.size)
    near = near_pixels(found.model, found.point)
    near = near[window.exceeds_rounding(np.diag(pulses + dark)[near])]
    both = np.ix_(near, near)
    return fit_nonlinearity([power_log_likelihoods(window.contrasts[:, near], light[near], pulses[both], dark[both])])


def _is_at_prior_bound(found: PointFit, context: Context) -> bool:
    """Return whether the core is at a bound or far from the sensor description."""
    prior = found.model.prior
    chosen = prior.free_index
    point = dict(zip(prior.free, found.point, strict=True))
    low, high = prior.bounds[chosen].T
    if np.any((np.abs(found.point - low) < 1e-6) | (np.abs(found.point - high) < 1e-6), where=_core(prior.free)):
        return True
    away = (found.point - prior.centre[chosen]) / prior.spread[chosen]
    return context.sensor is not None and bool(abs(away[list(point).index("ln_cut_off")]) > LIMITS.max_prior_sd)


def _core(free: tuple[str, ...]) -> NDArray[np.bool_]:
    return np.array([name in ("x_px", "y_px", "ln_cut_off", "exponent") for name in free])


def fit_notes(found: PointFit, window: Window, context: Context, pinhole_px: float | None) -> tuple[str, ...]:
    """Return notes that do not affect validity."""
    out = ["The camera response is assumed linear: a single spot hardly shows a gamma."]
    if pinhole_px is None:
        out.append("The source is assumed to be a point; the size of a pinhole lowers the MTF.")
    if found.model.prior.halo_px is None:
        out.append("MTF normalised to the core; this region cannot show a halo.")
    elif found.noise is not None:
        out.append("MTF normalised to all light; the halo fraction comes from the pixels and the sensor description.")
    out += rounding_note(window)
    if context.sensor is None:
        out.append("Pixels taken as square.")
    return tuple(out)


def fit_figure_data(found: PointFit, window: Window) -> dict:
    """Return the figure data of a fit, with the estimated quantisation shift of faint light."""
    core = found.pedestal + found.light * found.model.core(found.point[None])[0]
    rings = (
        found.pedestal + found.light * found.model.rings(found.point[None])[0] if window.ring_dn.size else np.empty(0)
    )
    shift = found.shift_of_rounding()
    core[window.keep] += shift[: shift.size - rings.size]
    rings = rings + shift[shift.size - rings.size :]
    at = dict(zip(found.model.prior.free, found.point.tolist(), strict=True))
    return source_figure_data(
        window,
        (at["x_px"], at["y_px"]),
        core,
        rings,
        light_dn_px2=found.light,
        light_sd_dn_px2=found.light_sd,
        pedestal_dn=found.pedestal,
        chi_squared=found.chi2,
        degrees_of_freedom=found.free,
    )
