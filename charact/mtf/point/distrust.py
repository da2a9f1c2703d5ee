"""The ways in which points deceive a fit of forms, each looked for in the pixels."""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.curve import FINE, falls_to
from charact.mtf.point.choice import Weighed
from charact.mtf.point.form_fit import FormFit, PointFitter
from charact.mtf.point.motion import motion_flags
from charact.mtf.point.pixels import Site, dark_noise
from charact.mtf.point.response import Response, profile, response_of
from charact.mtf.point.table import cosines, pictures, radial

Array = NDArray[np.float64]

# Chi squared that departures from a form may take, in standard deviations of what noise leaves them.
DEPARTED_SD = 4.5
# Where the transfer may depart, ln of frequency over half frequency, and how wide each bump is.
BUMPS, BUMP_WIDTH = (-2.0, -1.0, -0.4, 0.2, 0.7), 0.5
MISFIT, SIGNIFICANT = 1.8, 5.0
LOW_LIGHT = 10.0
# Ratio of the half frequencies along rows and columns from which on light is that of no one source.
ELONGATED = 1.5


def flags(sites: list[Site], fitter: PointFitter, found: list[Weighed], pedestals: Array) -> tuple[str, ...]:
    """Return the flags of fitted sources."""
    fit, out = found[0].fit, []
    if any(site.window.clipped for site in sites):
        out.append("clipped")
    if (fit.light < LOW_LIGHT * light_errors(fitter, fit)).any():
        out.append("low-signal")
    if fit.chi2 / fit.free > MISFIT + SIGNIFICANT * np.sqrt(2.0 / fit.free) or departs(sites, fitter, fit):
        out.append("model-misfit")
    if _elongated(fit):
        out.append("several-targets")
    if any(site.window.cut or (site.screen and not site.window.holds_halo) for site in sites):
        out.append("window-too-small")
    at = np.min(np.abs(fit.point - fit.form.bounds.T), axis=0)[: fit.form.blur_parameters]
    if at.min() < 1e-6 and not fit.form.lens:
        out.append("prior-bound")
    for site, pedestal in zip(sites, pedestals, strict=True):
        if site.window.keep.all():
            window = site.window
            out += motion_flags(window.frames_above(float(pedestal)), *window.centred, window.row_parity)
    return tuple(dict.fromkeys(out))


def _elongated(fit: FormFit) -> bool:
    """Tell whether light is spread much further along rows than along columns, or the other way."""
    along, down = falls_to(FINE, fit.form.camera(fit.point[None], FINE, np.array([1.0, -1.0]))[0], 0.5)
    return bool(max(along / down, down / along) > ELONGATED)


def light_errors(fitter: PointFitter, fit: FormFit) -> Array:
    """Return the standard error of each light at a fixed form, DN px^2."""
    nodes = fitter.nodes(fit.form, fit.point[None])
    return np.array([1.0 / np.sqrt(np.sum((one.matrix @ nodes[0]) ** 2)) for one in fitter.pixels])


def departs(sites: list[Site], fitter: PointFitter, fit: FormFit) -> bool:
    """Tell whether departures from a form take more chi squared than noise leaves them.

    Departures are bumps of the transfer along frequency, a tilt of the ellipse, and lopsidedness in both directions,
    each to first order and with all parameters free to give way.
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
        more.append(np.concatenate([light * (one.matrix @ bumped.T), light * _uneven(site, one, nodes[0])], axis=1))
        residual.append(one.data - light * unit)
    gain = _explained(np.concatenate([_blocks(own), np.concatenate(more)], axis=1), np.concatenate(residual))
    gain -= _explained(_blocks(own), np.concatenate(residual))
    count = more[0].shape[1]
    return bool(gain > count + DEPARTED_SD * np.sqrt(2.0 * count))


def _uneven(site: Site, one, nodes: Array) -> Array:
    """Return what a tilted ellipse and lopsidedness add to the whitened pixels at unit light, shape (value, 3)."""
    frequency = radial(site.aperture.top)[1]
    transfer = nodes.reshape(cosines().size, -1)
    half = float(np.interp(-0.5, -transfer[0], frequency))
    sharp = pictures(site.aperture, transfer * (frequency / half) ** 2, *site.axes)
    tilted = pictures(site.aperture, transfer, *site.axes)[3]
    columns = np.stack([tilted, sharp[1], sharp[2]], axis=1)
    columns = np.concatenate([columns, np.zeros((site.window.ring_dn.size, 3))])
    return one.whitened(columns[site.used])


def _blocks(own: list[Array]) -> Array:
    """Return columns of all sources: lights apart, the form's parameters in common."""
    lights = np.zeros((sum(len(part) for part in own), len(own)))
    first = 0
    for index, part in enumerate(own):
        lights[first : first + len(part), index] = part[:, 0]
        first += len(part)
    return np.concatenate([lights, np.concatenate([part[:, 1:] for part in own])], axis=1)


def _explained(columns: Array, residual: Array) -> float:
    """Return how much of a residual's chi squared columns explain."""
    basis, values, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    basis = basis[:, values > 1e-6 * values[0]]
    return float(np.sum((basis.T @ residual) ** 2))


def response(sites: list[Site], fit: FormFit) -> Response:
    """Return what the frames' noise of sources says of the camera's response."""
    transfer = fit.form.transfer(fit.point[None], radial(sites[0].aperture.top)[1], cosines())[0]
    found = []
    for site, light in zip(sites, fit.light, strict=True):
        if site.window.frames < 2 or site.pulses is None or not site.window.keep.all():
            continue
        mean = light * pictures(site.aperture, transfer, *site.axes)[0]
        pulses, dark = site.pulses.covariance * site.memory.between_rows(site.window.parity), dark_noise(site)
        near = site.near[site.window.noisy(np.diag(pulses + dark)[site.near])]
        both = np.ix_(near, near)
        found.append(profile(site.window.contrasts[:, near], mean[near], pulses[both], dark[both]))
    return response_of(found)
