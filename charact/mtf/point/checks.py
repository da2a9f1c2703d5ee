"""Checks, notes and figure data of the forward fit of a point source."""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.image_lag import image_lag_model
from charact.mtf.point.figure_data import rounding_note, source_figure_data
from charact.mtf.point.findings import finding, motion_findings
from charact.mtf.point.forward_fit import PointFit
from charact.mtf.point.motion import motion_flags
from charact.mtf.point.noise import near_pixels
from charact.mtf.point.nonlinearity import SpotNonlinearity, fit_nonlinearity, power_log_likelihoods
from charact.mtf.point.source import DetectedSource
from charact.mtf.point.source_window import Window
from labdata.flags import Finding

Array = NDArray[np.float64]

# Chi squared per value beyond which the pixels are not what the model says they are.
MISFIT, SIGNIFICANT = 1.8, 5.0
LOW_LIGHT = 10.0
# Standard deviations from its description at which a camera's cut-off is no longer that camera's.
MAX_PRIOR_SD = 3.0
# Diameters of the halos that a camera which is not described may have, how soft their rims are, px, and how many
# standard errors of their light one must stand out.
HALOS_PX, RIM_PX, HALO_ERRORS = (8.0, 11.0, 15.0, 20.0, 27.0, 36.0), 2.0, 3.0
# Power of the light by which noise falls behind its model that only a curved response explains.
FALLING, MIN_FRAMES = 0.35, 4


def fit_findings(found: PointFit, window: Window, source: DetectedSource, context: Context) -> list[Finding]:
    """Return the findings of a fitted source."""
    out = []
    if not window.keep.all():
        lost = 100.0 * float(np.mean(~window.keep))
        out.append(finding("saturated", f"full scale spoils {lost:.0f} % of the core's pixels, which are left out"))
    if window.clipped:
        out.append(finding("clipped", "noise below the lowest code is cut off; MTF50 is half a standard error high"))
    if found.light < LOW_LIGHT * found.light_sd:
        stands = found.light / found.light_sd
        effect = f"the light stands {stands:.1f} standard errors out; intervals are tested from {LOW_LIGHT:g} on"
        out.append(finding("low-signal", effect))
    halo = context.sensor is None and _has_unmodelled_halo(found)
    if halo or found.chi2 / found.free > MISFIT + SIGNIFICANT * np.sqrt(2.0 / found.free):
        effect = f"residuals are {np.sqrt(found.chi2 / found.free):.2g} times the noise"
        beyond = (
            "; light about the core, which lowers MTF50 by its fraction of the light, is not counted" if halo else ""
        )
        out.append(finding("model-misfit", effect + beyond))
    if source.others:
        out.append(finding("several-targets", "light of another source in the region is not modelled"))
    if window.cut or (context.sensor is not None and not window.holds_halo):
        effect = "light beyond the region is not counted; MTF50 may be high by the fraction of the light there"
        out.append(finding("window-too-small", effect))
    if _is_at_prior_bound(found, context):
        effect = f"the core stands at a limit or {MAX_PRIOR_SD:g} standard deviations off the description"
        out.append(finding("prior-bound", effect))
    if window.keep.all():
        out += motion_findings(
            motion_flags(window.frames_above(found.pedestal), *window.offsets_from_centre, window.row_parity)
        )
        response = _noise_nonlinearity(found, window, context)
        if response is not None and response.is_nonlinear and response.power < -FALLING:
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
    halos = found.light * np.array([_disc(radii, size) for size in HALOS_PX]) @ found.white.T
    halos = halos - (halos @ basis) @ basis.T
    left = found.white @ found.data
    left = left - basis @ (basis.T @ left)
    return bool(np.max(np.abs(halos @ left) / np.linalg.norm(halos, axis=1)) > HALO_ERRORS)


def _disc(radius_px: Array, diameter_px: float) -> Array:
    """Return a disc of unit light with a soft rim, 1/px^2."""
    return 0.5 * (1.0 - np.tanh((radius_px - 0.5 * diameter_px) / RIM_PX)) / (0.25 * np.pi * diameter_px**2)


def _noise_nonlinearity(found: PointFit, window: Window, context: Context) -> SpotNonlinearity | None:
    """Return the nonlinearity from the frames' noise; only a compressive response makes noise grow less than pulses do.

    Pulse widths are from a coarse set, so that noise may appear to grow faster.
    """
    if found.noise is None or window.frames < MIN_FRAMES:
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
    chosen = prior.chosen
    point = dict(zip(prior.free, found.point, strict=True))
    low, high = prior.bounds[chosen].T
    if np.any((np.abs(found.point - low) < 1e-6) | (np.abs(found.point - high) < 1e-6), where=_core(prior.free)):
        return True
    away = (found.point - prior.centre[chosen]) / prior.spread[chosen]
    return context.sensor is not None and bool(abs(away[list(point).index("ln_cut_off")]) > MAX_PRIOR_SD)


def _core(free: tuple[str, ...]) -> NDArray[np.bool_]:
    return np.array([name in ("x_px", "y_px", "ln_cut_off", "exponent") for name in free])


def fit_notes(found: PointFit, window: Window, context: Context, pinhole_px: float | None) -> tuple[str, ...]:
    """Return notes that do not affect validity."""
    out = ["The response is taken as straight: one spot hardly shows a gamma correction."]
    if pinhole_px is None:
        out.append("The source is taken as a point; a pinhole's own size lowers the MTF.")
    if found.model.prior.halo_px is None:
        out.append("Normalised to the light of the core; a halo would not be seen in this region.")
    elif found.noise is not None:
        out.append("Normalised to all light, the halo's share as far as pixels and the camera's description tell it.")
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
