"""The least error that an unbiased estimate of MTF50 can have on an edge: Cramer-Rao bound by
differences.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from tests.truth.camera_effects import correlate_noise
from tests.truth.edge import EdgeScene, edge_spread

Array = NDArray[np.float64]

FREE = {
    "gaussian": ("sigma_px",),
    "exponential": ("frequency_cy_per_px", "exponent"),
    "moffat": ("moffat_px", "moffat_exponent"),
}


def least_relative_sd(scene: EdgeScene) -> float:
    """Return the least standard deviation of MTF50 over MTF50 when the form of the blur is known.

    Free are the form's parameters, place and direction of the edge, both levels, and the slope of
    the light where there is one.

    Notes
    -----
    Fisher information of normal pixels with mean m and covariance C, dm/da C^-1 dm/db; the
    information that the covariance itself holds on the mean is left out. C = B^T V B + r^2, V the
    signal's variance at each pixel and B the blur of the noise, solved by conjugate gradients.
    """
    names = FREE[scene.blur.form] + (("halo_share", "halo_px") if scene.blur.halo_share > 0 else ())
    slopes, rates = [], []
    for name in names:
        size = 1e-3 * max(abs(getattr(scene.blur, name)), 1e-2)
        ends = [
            replace(scene, blur=replace(scene.blur, **{name: getattr(scene.blur, name) + s * size}))
            for s in (1, -1)
        ]
        slopes.append((_mean(ends[0]) - _mean(ends[1])) / (2.0 * size))
        rates.append((ends[0].truth_mtf50 - ends[1].truth_mtf50) / (2.0 * size))
    for name, size in (
        ("offset_px", 1e-3),
        ("dark_dn", 1.0),
        ("bright_dn", 1.0),
        *((("gradient", 1e-4),) if scene.gradient else ()),
    ):
        ends = [replace(scene, **{name: getattr(scene, name) + s * size}) for s in (1, -1)]
        slopes.append((_mean(ends[0]) - _mean(ends[1])) / (2.0 * size))
    slopes.append((_mean(scene, turned_deg=1e-2) - _mean(scene, turned_deg=-1e-2)) / 2e-2)
    design = np.array([slope.ravel() for slope in slopes])
    scale = np.linalg.norm(design, axis=1)
    information = design / scale[:, None] @ _solve_columns(scene, design / scale[:, None]).T
    rate = np.concatenate([rates, np.zeros(len(slopes) - len(rates))]) / scale
    return float(np.sqrt(rate @ np.linalg.solve(information, rate)) / scene.truth_mtf50)


def _mean(scene: EdgeScene, turned_deg: float = 0.0) -> Array:
    """Return the noiseless frame, the edge turned but its blur's direction kept."""
    angle = np.deg2rad(scene.angle_deg + turned_deg)
    row = np.arange(scene.rows)[:, None] - (scene.rows - 1) / 2
    col = np.arange(scene.cols)[None, :] - (scene.cols - 1) / 2
    spread = edge_spread(
        scene.blur, col * np.cos(angle) + row * np.sin(angle) - scene.offset_px, scene.angle_deg
    )
    light = scene.dark_dn - scene.black_dn + (scene.bright_dn - scene.dark_dn) * spread
    return light * (1.0 + scene.gradient * (col / scene.cols + 0.5))


def _solve_columns(scene: EdgeScene, columns: Array) -> Array:
    """Return the inverse covariance times each column, shape (parameter, pixel)."""
    sd = (scene.bright_dn - scene.dark_dn) / scene.snr
    half_way = (scene.bright_dn + scene.dark_dn) / 2.0 - scene.black_dn
    signal = scene.shot_share * sd**2 * np.maximum(_mean(scene), 0.0) / half_way
    read = (1.0 - scene.shot_share) * sd**2 + 1.0 / 12.0
    if scene.noise_blur_px == 0 or scene.shot_share == 0:
        return columns / (signal + read).ravel()
    shape = signal.shape

    def covariance(column: Array) -> Array:
        field = correlate_noise(column.reshape(1, *shape), scene.noise_blur_px)
        return (
            correlate_noise(signal * field, scene.noise_blur_px)[0] + read * column.reshape(shape)
        ).ravel()

    operator = LinearOperator((signal.size, signal.size), matvec=covariance, dtype=float)  # pyright: ignore[reportCallIssue]
    return np.array([cg(operator, column, rtol=1e-4)[0] for column in columns])
