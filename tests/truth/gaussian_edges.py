"""Edges of a Gaussian blur without noise, noise of known covariance, and edges of any blur by a sum
of their own.
"""

import numpy as np

from labdata import FrameStack
from tests.truth.blur import TrueBlur
from tests.truth.edge import EdgeScene


def mtf(frequency, sigma_px, angle_deg):
    """MTF along the edge's normal."""
    return TrueBlur(sigma_px=sigma_px).mtf(frequency, angle_deg)


def frequency_at(level, sigma_px, angle_deg):
    """Frequency where the MTF falls to a level."""
    return TrueBlur(sigma_px=sigma_px).mtf50(angle_deg, level)


def mean_edge(rows, cols, *, sigma_px=0.9, dark=30.0, bright=180.0, **scene):
    """Noiseless frame; `scene` are further fields of `EdgeScene`."""
    light = {"black_dn": 0.0, "dark_dn": dark, "bright_dn": bright}
    return EdgeScene(
        blur=TrueBlur(sigma_px=sigma_px), rows=rows, cols=cols, **light, **scene
    ).mean()


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
