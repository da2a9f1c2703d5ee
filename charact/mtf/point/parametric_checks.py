"""Checks of the parametric fit of points."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.curve import FINE, crossing_frequency
from charact.mtf.point.blur_models_2d import BUMP_WIDTH, BUMPS
from charact.mtf.point.findings import finding, motion_findings, motion_flags
from charact.mtf.point.model_fit import BlurModelFit2D, PointFitter
from charact.mtf.point.model_selection import DEPARTURES, EvidenceWeightedModels2D
from charact.mtf.point.nonlinearity import SpotNonlinearity, fit_nonlinearity, power_log_likelihoods
from charact.mtf.point.source_pixels import SourcePixels, dark_noise
from charact.mtf.point.spot_image_matrix import cosines, pictures, radial
from charact.mtf.point.thresholds import LIMITS
from labdata.flags import Finding

Array = NDArray[np.float64]


def source_findings(
    sites: list[SourcePixels], fitter: PointFitter, found: list[EvidenceWeightedModels2D], pedestals: Array
) -> list[Finding]:
    """Return the findings of fitted sources."""
    fit, out = found[0].fit, []
    if any(site.window.clipped for site in sites):
        out.append(finding("clipped", "noise is clipped at black; MTF50 is half a standard uncertainty high"))
    stands = float((fit.light / light_sd(fitter, fit)).min())
    if stands < LIMITS.low_light_sd:
        effect = f"light {stands:.1f} standard uncertainties; intervals are validated from {LIMITS.low_light_sd:g}"
        out.append(finding("low-signal", effect))
    if fit.chi2 / fit.free > LIMITS.max_chi2 + LIMITS.max_chi2_sd * np.sqrt(2.0 / fit.free) or has_departures(
        sites, fitter, fit
    ):
        out.append(finding("model-misfit", _misfit_effect(fitter, fit)))
    along, down = _half_frequencies(fit)
    if max(along / down, down / along) > LIMITS.max_elongation:
        effect = (
            f"MTF50 along rows is {along / down:.2f} times that along columns; light next to the source has this effect"
        )
        out.append(finding("several-targets", effect))
    if any(site.window.cut or (site.screen and not site.window.holds_halo) for site in sites):
        effect = "light beyond the region is not included; MTF50 may be high by its fraction"
        out.append(finding("window-too-small", effect))
    at = np.min(np.abs(fit.point - fit.form.bounds.T), axis=0)
    bound = [name for name, distance in zip(fit.form.parameters, at, strict=True) if distance < 1e-6]
    if {"ln_half_frequency", "stretch"} & set(bound):
        out.append(finding("prior-bound", f"{', '.join(bound)} at its bound; MTF50 may lie anywhere beyond"))
    for site, pedestal in zip(sites, pedestals, strict=True):
        if site.window.sound:
            window = site.window
            frames = window.frames_above(float(pedestal))
            out += motion_findings(motion_flags(frames, *window.offsets_from_centre, window.row_parity))
    return out


def _half_frequencies(fit: BlurModelFit2D) -> tuple[float, float]:
    """Return MTF50 along rows and along columns, cycles per column pitch, without aperture."""
    along, down = crossing_frequency(FINE, fit.form.camera(fit.point[None], FINE, np.array([1.0, -1.0]))[0], 0.5)
    return float(along), float(down)


def _misfit_effect(fitter: PointFitter, fit: BlurModelFit2D) -> str:
    """Return the effect of a misfit: the change of MTF50 by fitted model departures."""
    form = replace(fit.form, departures=max(DEPARTURES))
    start = form.start(float(fit.point[0]))
    known = dict(zip(fit.form.parameters, fit.point, strict=True))
    free = fitter.fit(form, np.array([known.get(name, own) for name, own in zip(form.parameters, start, strict=True)]))
    moves = [abs(b / a - 1.0) for a, b in zip(_half_frequencies(fit), _half_frequencies(free), strict=True)]
    left = np.sqrt(fit.chi2 / fit.free)
    return f"residuals are {left:.2g} times the noise; model departures change MTF50 by {100 * max(moves):.2g} %"


def light_sd(fitter: PointFitter, fit: BlurModelFit2D) -> Array:
    """Return the standard uncertainty of each light for a fixed model, DN px^2."""
    nodes = fitter.nodes(fit.form, fit.point[None])
    return np.array([1.0 / np.sqrt(np.sum((one.matrix @ nodes[0]) ** 2)) for one in fitter.pixels])


def has_departures(sites: list[SourcePixels], fitter: PointFitter, fit: BlurModelFit2D) -> bool:
    """Return whether model departures reduce chi squared beyond noise.

    Departures are bumps of the transfer along frequency, a rotation of the ellipse, and asymmetry in both directions,
    each to first order with all parameters free.
    """
    bounds = fit.form.bounds
    moves = np.where(fit.point > bounds.mean(axis=1), -1e-5, 1e-5) * (bounds[:, 1] - bounds[:, 0])
    nodes = fitter.nodes(fit.form, np.concatenate([fit.point[None], fit.point + np.diag(moves)]))
    frequency = radial(sites[0].aperture.top)[1]
    ratio = np.log(frequency) - fit.point[0]
    bumps = np.exp(-0.5 * ((ratio - np.array(BUMPS)[:, None]) / BUMP_WIDTH) ** 2)
    bumped = (nodes[0].reshape(1, -1, frequency.size) * bumps[:, None]).reshape(len(bumps), -1)
    own, more, residual = [], [], []
    for site, one, light in zip(sites, fitter.pixels, fit.light, strict=True):
        unit = one.matrix @ nodes[0]
        own.append(np.concatenate([unit[:, None], light * (one.matrix @ (nodes[1:] - nodes[0]).T) / moves], axis=1))
        more.append(
            np.concatenate([light * (one.matrix @ bumped.T), light * _asymmetry_columns(site, one, nodes[0])], axis=1)
        )
        residual.append(one.data - light * unit)
    gain = _chi2_explained(np.concatenate([_blocks(own), np.concatenate(more)], axis=1), np.concatenate(residual))
    gain -= _chi2_explained(_blocks(own), np.concatenate(residual))
    count = more[0].shape[1]
    return bool(gain > count + LIMITS.max_departure_sd * np.sqrt(2.0 * count))


def _asymmetry_columns(site: SourcePixels, one, nodes: Array) -> Array:
    """Return the effect of rotation and asymmetry on the whitened pixels at unit light, shape (value, 3)."""
    frequency = radial(site.aperture.top)[1]
    transfer = nodes.reshape(cosines().size, -1)
    half = float(np.interp(-0.5, -transfer[0], frequency))
    sharp = pictures(site.aperture, transfer * (frequency / half) ** 2, *site.axes)
    tilted = pictures(site.aperture, transfer, *site.axes)[3]
    columns = np.stack([tilted, sharp[1], sharp[2]], axis=1)
    columns = np.concatenate([columns, np.zeros((site.window.ring_dn.size, 3))])
    return one.whiten(columns[site.value_mask])


def _blocks(own: list[Array]) -> Array:
    """Return design columns of all sources: separate lights, common model parameters."""
    lights = np.zeros((sum(len(part) for part in own), len(own)))
    first = 0
    for index, part in enumerate(own):
        lights[first : first + len(part), index] = part[:, 0]
        first += len(part)
    return np.concatenate([lights, np.concatenate([part[:, 1:] for part in own])], axis=1)


def _chi2_explained(columns: Array, residual: Array) -> float:
    """Return the chi squared of a residual that columns explain."""
    basis, values, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    basis = basis[:, values > 1e-6 * values[0]]
    return float(np.sum((basis.T @ residual) ** 2))


def camera_nonlinearity(sites: list[SourcePixels], fit: BlurModelFit2D) -> SpotNonlinearity:
    """Return the nonlinearity from the frames' noise of sources."""
    transfer = fit.form.transfer(fit.point[None], radial(sites[0].aperture.top)[1], cosines())[0]
    found = []
    for site, light in zip(sites, fit.light, strict=True):
        if site.window.frames < 2 or site.pulses is None or not site.window.sound:
            continue
        mean = light * pictures(site.aperture, transfer, *site.axes)[0]
        pulses, dark = site.pulses.covariance * site.memory.between_rows(site.window.parity), dark_noise(site)
        near = site.near[site.window.exceeds_rounding(np.diag(pulses + dark)[site.near])]
        both = np.ix_(near, near)
        found.append(power_log_likelihoods(site.window.contrasts[:, near], mean[near], pulses[both], dark[both]))
    return fit_nonlinearity(found)
