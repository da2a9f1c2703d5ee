"""Pulse noise of a point source: covariance of the core's pixels by single-photoelectron events.

A photoelectron lands according to the blur before the gain and makes a pulse as wide as the blur after it. The
covariance is a sum of pulse shapes over landing positions, scaled by the frame differences. Phosphor decay correlates
fields and frames.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.image_lag import ImageLagModel
from charact.mtf.point.forward_model import PERIOD_PX, PointModel

Array = NDArray[np.float64]

FRACTIONS_AFTER_GAIN = (0.4, 0.6, 0.8, 1.0)
# Half the spacing of the places of landing near the core and far from it, px, and how far each reaches.
NEAR, FAR = (0.5, 3.0), (1.5, 15.0)
# Pixels whose frames are compared lie this near the source, px.
NEAR_PX = 5.5
# Variances of light tried, in those of a dark pixel.
GAINS = np.exp(np.linspace(np.log(1e-3), np.log(1e5), 200))


@dataclass(frozen=True, kw_only=True)
class PulseNoise:
    """Noise of the core's pixels.

    Parameters
    ----------
    pulse
        Covariance of one frame per unit light and unit gain, without image lag, shape (pixel, pixel).
    gain
        Covariance per light, DN px^2.
    share
        Fraction of the blur after the gain; None: independent pixels, as in ordinary cameras.
    sharpness
        Mean square of a pulse of unit light over its area, 1/px^2.
    """

    pulse: Array
    gain: float
    share: float | None
    sharpness: float


def pulse_covariance(model: PointModel, point: Array, share: float) -> Array:
    """Return the covariance of unit light at unit gain for a fraction of blur after the gain, shape (pixel, pixel)."""
    fx, fy = model.grid
    p = {name: float(value[0]) for name, value in model.prior.named(point[None]).items()}
    square = fx**2 + fy**2
    tube = np.exp(p["exponent"] * (0.5 * np.log(square) - p["ln_cut_off"]))
    gauss = (np.pi * p["blur_px"]) ** 2 * square
    behind = np.exp(-share * tube - gauss) * model.aperture_on_grid
    before = np.exp(-(1.0 - share) * tube - gauss) * model.spread(point[None], model.halo_table)[0]
    out = np.zeros((model.x.size * model.y.size,) * 2)
    for (step, reach), inner in ((NEAR, 0.0), (FAR, NEAR[1])):
        places = np.arange(-reach, reach + 1e-9, step)
        cell = np.sinc(fx * step) * np.sinc(fy * step)
        along, down = (np.cos(2 * np.pi * np.outer(places, f)) for f in (fx, fy))
        density = down @ (before * cell) @ along.T * (4.0 / PERIOD_PX**2)
        weight = np.maximum(density, 0.0) * step**2
        keep = np.maximum(*np.broadcast_arrays(np.abs(places)[:, None], np.abs(places))) > inner - 1e-9
        keep = keep if inner else np.ones_like(keep)
        shapes = _shapes(model, point, behind, places, keep)
        out += (shapes * weight[keep][:, None]).T @ shapes
    return out


def shot_covariance(model: PointModel, point: Array) -> Array:
    """Return the covariance of unit light at unit gain for independent pixels, shape (pixel, pixel)."""
    return np.diag(np.maximum(model.core(point[None])[0].ravel(), 0.0))


def _shapes(model: PointModel, point: Array, transfer: Array, places: Array, keep: NDArray[np.bool_]) -> Array:
    """Return pulses at positions around the source, shape (position, pixel)."""
    rows, cols = np.nonzero(keep)
    shifted = np.repeat(point[None], rows.size, axis=0)
    x, y = (model.prior.free.index(name) for name in ("x_px", "y_px"))
    shifted[:, x] += places[cols]
    shifted[:, y] += places[rows]
    return model.image(shifted, transfer).reshape(rows.size, -1)


def near_pixels(model: PointModel, point: Array) -> NDArray[np.int64]:
    """Return the pixels near the source, which have nearly all of its noise."""
    p = model.prior.named(point[None])
    x, y = np.broadcast_arrays(model.x - p["x_px"], (model.y - p["y_px"])[:, None])
    return np.flatnonzero((np.hypot(x, y) < NEAR_PX).ravel())


def fit_pulse_noise(
    model: PointModel,
    point: Array,
    light: float,
    deviations: Array,
    floor: float,
    parity: NDArray[np.bool_],
    memory: ImageLagModel,
    shares: tuple[float | None, ...] = FRACTIONS_AFTER_GAIN,
) -> PulseNoise:
    """Return the noise that makes the frame differences most probable.

    Parameters
    ----------
    light
        Light of the source, DN px^2.
    deviations
        Frames less their mean, shape (frame, pixel), DN.
    floor
        Variance of a pixel far from the source, DN^2.
    parity
        Field of each pixel, shape (pixel,).
    shares
        Candidate fractions of blur after the gain; None: independent pixels.
    """
    near = near_pixels(model, point)
    deviations, parity = deviations[:, near], parity[near]
    factor = memory.between_rows(parity)
    best: tuple[float, PulseNoise] | None = None
    area = float(np.diff(model.y[:2])[0] * np.diff(model.x[:2])[0])
    freedom = len(deviations) - 1
    for share in shares:
        pulse = shot_covariance(model, point) if share is None else pulse_covariance(model, point, share)
        sharp = float(np.trace(pulse)) * area
        values, vectors = np.linalg.eigh(pulse[np.ix_(near, near)] * factor * light)
        gains = GAINS * floor / max(float(values.mean()), 1e-300)
        power = ((deviations @ vectors) ** 2).sum(axis=0)
        variance = gains[:, None] * np.maximum(values, 0.0) + floor
        fit = -0.5 * (freedom * np.log(variance) + power / variance).sum(axis=1)
        top = int(np.argmax(fit))
        if best is None or fit[top] > best[0]:
            best = float(fit[top]), PulseNoise(pulse=pulse, gain=float(gains[top]), share=share, sharpness=sharp)
    assert best is not None
    return best[1]
