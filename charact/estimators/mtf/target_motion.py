"""Target motion between frames, by analysis of variance of line positions.

Edge roughness has the same effect within a frame
(`charact.estimators.mtf.edge.pixels.prepare_edge.PreparedEdge.roughness`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import lgamma

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.thresholds import ACCURACY, LIMITS

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TargetMotion:
    """Motion of a target through a stack, or deviation of an edge from a straight line.

    Parameters
    ----------
    rms_px
        Root mean square displacement, noise subtracted, px.
    chance
        Probability of such displacements without motion.
    """

    rms_px: float = 0.0
    chance: float = 1.0

    @property
    def moves(self) -> bool:
        """Whether the motion is significant."""
        return self.chance < LIMITS.motion_p_value and self.rms_px > 0

    def mtf_loss(self, frequency_cy_per_px: float) -> float:
        """Return the relative loss of the MTF at a frequency, and approximately that of MTF50.

        The mean frame is blurred by exp(-2 (pi f s)^2). Near MTF50 ln MTF and ln frequency change
        by about the same amount.
        """
        return 2.0 * (np.pi * frequency_cy_per_px * self.rms_px) ** 2

    def undo(self, frequency: Array, modulus: Array) -> Array:
        """Return the largest MTF without the motion, M/(1 - L), L = 2 (pi f s)^2 for the largest s;
        infinite where none is left.

        Displacements t of any distribution lower it by |E exp(2 pi i f t)| >= 1 - L, as cos x >= 1
        - x^2 / 2.
        """
        loss = 2.0 * (np.pi * frequency * LIMITS.max_rms_ratio * self.rms_px) ** 2
        return np.where(loss < 1.0, modulus / np.maximum(1.0 - loss, 1e-12), np.inf)

    def max_lift(self, mtf: float, frequency_cy_per_px: float) -> float | None:
        """Return the most by which an MTF without the motion is higher; None: unbounded."""
        lift = float(self.undo(np.array(frequency_cy_per_px), np.array(mtf))) - mtf
        return lift if np.isfinite(lift) else None


def measure_line_motion(
    frames: Sequence[Array] | Array,
    across: Array,
    line: NDArray[np.int64],
    valid: NDArray[np.bool_],
) -> TargetMotion:
    """Return the motion of a target whose lines have one common profile.

    Parameters
    ----------
    frames
        Each of shape (row, col), DN.
    across
        Distance of every pixel across the lines, shape (row, col), px.
    line
        Index of each pixel's line, from 0, shape (row, col).
    valid
        Pixels that count, shape (row, col).

    Notes
    -----
    d_line = -[(X'X)^-1 X'(v - m)]_1, X = [m', m, 1]: the least-squares coefficient of -m'(d), m the
    mean profile of all lines, with the line's level and contrast free (lamp flicker).
    """
    if len(frames) < 2 or not valid.any():
        return TargetMotion()
    values = np.stack([frame[valid] for frame in frames]).astype(np.float64)
    mean, where, distance, cells_per_px = (
        values.mean(axis=0),
        line[valid],
        across[valid],
        ACCURACY.profile_cells_per_px,
    )
    # The smoothed mean profile of all lines and its slope, at every pixel.
    cell = np.floor((distance - distance.min()) * cells_per_px).astype(np.intp)
    blur = ACCURACY.profile_smoothing_px * cells_per_px
    reach = int(4.0 * blur)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / blur) ** 2)
    sums, counts = (
        np.convolve(np.bincount(cell, values_of), kernel)[reach:-reach]
        for values_of in (mean, np.ones_like(mean))
    )
    profile = sums / np.maximum(counts, 1e-12)
    cell_px = distance.min() + (np.arange(profile.size) + 0.5) / cells_per_px
    slope = np.gradient(profile) * cells_per_px if profile.size > 1 else np.zeros(1)
    template, rise = np.interp(distance, cell_px, profile), np.interp(distance, cell_px, slope)
    # The weight of each pixel in its line's displacement, and the lines that are precise enough.
    shapes = np.stack([rise, template - template.mean(), np.ones_like(rise)])
    scale = np.sqrt(np.maximum(np.mean(shapes**2, axis=1), 1e-300))
    shapes = shapes / scale[:, None]
    pixels = np.bincount(where)
    normal = np.array(
        [[np.bincount(where, values_of * other) for other in shapes] for values_of in shapes]
    ).transpose(2, 0, 1)
    size = np.maximum(pixels, 1)[:, None, None]
    inverse = np.linalg.inv(normal / size + 1e-9 * np.eye(3)) / size
    power = np.where(pixels > 0, 1.0 / inverse[:, 0, 0], 0.0)
    holds = power > LIMITS.min_line_power * np.median(power[power > 0])
    weight = -np.einsum("pk,kp->p", inverse[where, 0], shapes) / scale[0]
    positions = np.stack(
        [
            np.bincount(where, weight * (values_of - mean), minlength=holds.size)
            for values_of in values
        ]
    )
    return measure_target_motion(np.asarray(positions[:, holds], np.float64))


def measure_target_motion(positions: Array) -> TargetMotion:
    """Return the motion from line positions.

    Parameters
    ----------
    positions
        Position of each line in each frame, shape (frame, line), px; a constant offset of a line
        has no effect.

    Notes
    -----
    Groups of lines have independent noise; a displacement common to all groups of a frame is
    motion. A two-way analysis of variance compares frame means with the residual (Fisher's F). The
    mean of K frames is blurred by (K - 1)/K of the variance.
    """
    frames, lines = positions.shape
    size = min(
        max(lines // ACCURACY.line_groups, ACCURACY.min_group_lines), ACCURACY.max_group_lines
    )
    parts = lines // size
    if frames < 2 or parts < ACCURACY.min_line_groups:
        return TargetMotion()
    group_lines = size - (2 if size >= ACCURACY.wide_gap_lines else 1)
    means = (
        positions[:, : parts * size].reshape(frames, parts, size)[:, :, :group_lines].mean(axis=2)
    )
    means = means - means.mean(axis=0)
    of_frame = means.mean(axis=1)
    free_between, free_within = frames - 1, (frames - 1) * (parts - 1)
    noise = float(np.sum((means - of_frame[:, None]) ** 2)) / free_within
    shared = parts * float(np.sum(of_frame**2)) / free_between
    if not shared > noise:
        return TargetMotion()
    rms_px = float(np.sqrt((shared - noise) / parts * free_between / frames))
    return TargetMotion(
        rms_px=rms_px, chance=f_tail(free_between, free_within, shared / max(noise, 1e-300))
    )


def f_tail(numerator_freedom: float, freedom: float, ratio: float) -> float:
    """Return the probability that Fisher's F of two degrees of freedom exceeds a ratio.

    Notes
    -----
    I_x(a, b) = 2 / B(a, b) int sin(t)^(2a - 1) cos(t)^(2b - 1) dt up to sin^2 t = x, with a and b
    half the degrees of freedom of denominator and numerator and x = a / (a + b F) (DLMF 8.17.1):
    without SciPy, which takes longer to load than an edge to measure.
    """
    a, b = 0.5 * freedom, 0.5 * numerator_freedom
    angle = np.linspace(0.0, np.arctan(np.sqrt(a / (b * ratio))), ACCURACY.tail_points)[1:]
    ln_beta = lgamma(a) + lgamma(b) - lgamma(a + b)
    ln = (2.0 * a - 1.0) * np.log(np.sin(angle)) + (2.0 * b - 1.0) * np.log(np.cos(angle))
    return min(2.0 * float(np.trapezoid(np.exp(ln - ln_beta), angle)), 1.0)
