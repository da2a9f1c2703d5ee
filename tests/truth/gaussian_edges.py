"""Edges of closed form: a step blurred by a Gaussian and collected by square pixels, and noise of
known covariance.
"""

import math

import numpy as np

from labdata import FrameStack

_ERF = np.vectorize(math.erf)


def _second_integral(x, sigma):
    """Function whose second derivative is the normal distribution function of x / sigma."""
    density = np.exp(-0.5 * (x / sigma) ** 2) / np.sqrt(2 * np.pi)
    cumulative = 0.5 * (1 + _ERF(x / sigma / np.sqrt(2)))
    return 0.5 * ((x**2 + sigma**2) * cumulative + sigma * x * density)


def edge_spread(distance, sigma_px, angle_deg):
    """Edge spread from 0 to 1 of a Gaussian and a unit square whose normal direction stands at an
    angle.
    """
    c, s = (max(abs(f(np.deg2rad(angle_deg))), 1e-4) for f in (np.cos, np.sin))
    grid = np.arange(-40.0, 40.0, 0.01)
    corners = [(c + s, 1), (c - s, -1), (-c + s, -1), (-c - s, 1)]
    table = sum(sign * _second_integral(grid + half / 2, sigma_px) for half, sign in corners) / (
        c * s
    )
    return np.interp(distance, grid, table)


def mtf(frequency, sigma_px, angle_deg):
    """MTF along the edge's normal."""
    turn = np.deg2rad(angle_deg)
    pixel = np.sinc(frequency * np.cos(turn)) * np.sinc(frequency * np.sin(turn))
    return np.exp(-2 * (np.pi * frequency * sigma_px) ** 2) * pixel


def frequency_at(level, sigma_px, angle_deg):
    """Frequency where the MTF falls to a level."""
    grid = np.linspace(1e-4, 1.0, 20001)
    return float(np.interp(-level, -mtf(grid, sigma_px, angle_deg), grid))


def mean_edge(
    rows, cols, *, sigma_px=0.9, angle_deg=5.0, offset_px=0.0, dark=30.0, bright=180.0, gradient=0.0
):
    """Noiseless frame; the angle is that of the edge's normal to the rows."""
    row = np.arange(rows)[:, None] - (rows - 1) / 2
    col = np.arange(cols)[None, :] - (cols - 1) / 2
    turn = np.deg2rad(angle_deg)
    distance = col * np.cos(turn) + row * np.sin(turn) - offset_px
    light = dark + (bright - dark) * edge_spread(distance, sigma_px, angle_deg)
    return light * (1 + gradient * (col / cols + 0.5))


def noisy(mean, rng, *, snr, step, frames=1, shot=0.5, blur=False):
    """Frames: variance (1 - shot) + shot of the mean over its middle; `blur` ties neighbours by a 3
    x 3 kernel.
    """
    sd = step / snr * np.sqrt(1 - shot + shot * mean / mean.mean())
    white = rng.standard_normal((frames, *mean.shape))
    if blur:
        kernel = np.array([0.5, 1.0, 0.5]) / np.sqrt(1.5)
        for axis in (1, 2):
            white = sum(
                k * np.roll(white, s, axis) for k, s in zip(kernel, (-1, 0, 1), strict=True)
            )
    return FrameStack(
        data=np.clip(np.rint(mean + sd * white), 0, 4095).astype(np.uint16), full_scale_dn=4095.0
    )


def frame_of(mtf_along_normal, rows, cols, *, angle_deg, offset_px=0.0):
    """Edge from 0 to 1 of any rotationally symmetric blur and square pixels, by a numerical
    transform of its own.

    `mtf_along_normal` maps frequencies along the normal to the transfer without the pixel. The edge
    spread is 1/2 + sum M(f) sin(2 pi f d) / (pi f) df over a frequency comb so fine that its copies
    lie 4096 px away.
    """
    turn = np.deg2rad(angle_deg)
    frequency = (np.arange(1, 8 * 4096) - 0.5) / 4096.0 / 2.0
    weight = (
        mtf_along_normal(frequency)
        * np.sinc(frequency * np.cos(turn))
        * np.sinc(frequency * np.sin(turn))
    )
    weight = weight / (np.pi * frequency) / 8192.0
    significant = np.abs(weight) > 1e-12
    distance = np.concatenate([np.arange(0.0, 16.0, 0.02), np.arange(16.0, 200.0, 0.25)])
    spread = np.array(
        [np.sin(2 * np.pi * d * frequency[significant]) @ weight[significant] for d in distance]
    )
    row = np.arange(rows)[:, None] - (rows - 1) / 2
    col = np.arange(cols)[None, :] - (cols - 1) / 2
    across = col * np.cos(turn) + row * np.sin(turn) - offset_px
    return 0.5 + np.sign(across) * np.interp(np.abs(across), distance, spread)


def transfer_of(mtf_along_normal, frequency, angle_deg):
    """MTF along the normal, pixel included."""
    turn = np.deg2rad(angle_deg)
    pixel = np.sinc(frequency * np.cos(turn)) * np.sinc(frequency * np.sin(turn))
    return np.abs(mtf_along_normal(frequency) * pixel)


def level_of(mtf_along_normal, angle_deg, level=0.5):
    """Frequency where the MTF along the normal falls to a level."""
    grid = np.linspace(1e-4, 1.5, 60001)
    under_level = transfer_of(mtf_along_normal, grid, angle_deg) < level
    return float(grid[np.argmax(under_level)])
