"""Numbers that frames of targets are compared by: MTF and levels of an edge, profile of a point
source.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.observables import FrameView, Numbers, Observable, Stacks, observable
from charact.validation.thresholds import VALIDATION
from labdata.frames import FrameStack

# Centres of bands up to 0.8 of the sampling limit, and distances from them at which an MTF is
# averaged: its errors at frequencies that differ by more than one over the width of the picture are
# independent.
FREQUENCY_CY_PER_PX = np.arange(0.05, 0.4001, 0.05)
WITHIN_CY_PER_PX = np.linspace(-0.02, 0.02, 5)
# Ends of the ranges of distance from an edge on both sides, and of radii about a point, px.
DISTANCES_PX = (0.5, 1.5, 3.0, 5.0, 8.0, 15.0, 30.0)
# Distance from an edge within which its place is found, and ends of the range whose levels are its
# contrast, px.
NEAR_PX, SIDE_PX = 6.0, (3.0, 8.0)
# Smoothing of a ghost image, and its least distance from its point, px.
GHOST_PX, LEAST_GHOST_PX = 1.5, 12.0
RADII_PX = (0.0, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 26.0, 40.0)


@dataclass(frozen=True, kw_only=True)
class SetStacks(Stacks[FrameView]):
    """Darks and flats of a set of frames, and those of an edge and a point source."""

    edge: NDArray | None = None  # shape (frame, row, col), DN
    point: NDArray | None = None
    context: Context


@observable
class EdgeMtf(Observable[SetStacks]):
    """MTF of an edge in bands about `FREQUENCY_CY_PER_PX`, none where the method refuses."""

    name = "mtf"
    order = 20
    title = "MTF of the edge up to 0.8 of the sampling limit"
    cause = "lens, focus, tube, fibres, video bandwidth, or sharpening"
    least_sd = 1e-4

    def numbers(self, stacks: SetStacks) -> Numbers:
        from charact.estimators import mtf

        if stacks.edge is None:
            return {}
        frames = FrameStack(data=stacks.edge)
        result = mtf.measure("edge", frames, method="edge-slanted", context=stacks.context)
        line = next(iter(result.curves.values()), None)
        if line is None:
            return {}
        frequency = FREQUENCY_CY_PER_PX[:, None] + WITHIN_CY_PER_PX
        values = np.interp(frequency, line.frequency_cy_per_px, line.value).mean(axis=1)
        return {
            f"MTF at {at:.2f} cy/px": float(value)
            for at, value in zip(FREQUENCY_CY_PER_PX, values, strict=True)
        }


@observable
class EdgeLevels(Observable[SetStacks]):
    """Levels at distances from an edge."""

    name = "edge"
    order = 21
    title = "Levels on both sides of the edge"
    cause = "veiling glare, halo, ghost images, sharpening, or a nonlinear response"
    least_sd = 1e-4

    def numbers(self, stacks: SetStacks) -> Numbers:
        return {} if stacks.edge is None else edge_features(stacks.edge, stacks.dark.mean_dn)


@observable
class PointProfile(Observable[SetStacks]):
    """Levels at distances from a point source."""

    name = "point"
    order = 22
    title = "Profile of the point source"
    cause = "halo, lens, or saturation of the microchannel plate"
    least_sd = 0.01

    def numbers(self, stacks: SetStacks) -> Numbers:
        full_scale_dn, dark_dn = stacks.context.full_scale_dn, stacks.dark.mean_dn
        return {} if stacks.point is None else point_features(stacks.point, dark_dn, full_scale_dn)


def edge_features(frames: NDArray, dark_dn: float) -> Mapping[str, float]:
    """Return mean levels and variances in time by distance from an edge, none where no edge is
    found.

    Notes
    -----
    The edge is the line through the centres of gravity of the gradient near it in each row, or
    column of a flat edge. Levels are over the step close to the edge. Near it they are given as the
    step between both sides at equal distances, which an error of the place hardly changes, and
    their mean: blur and sharpening. Far from it the dark side shows veiling glare and ghost images.
    Noise that is larger on the edge than on both sides shows jitter of lines, or motion.
    """
    mean = frames.mean(axis=0, dtype=np.float64) - dark_dn
    # The difference of successive frames leaves drift out.
    variance = np.diff(frames.astype(np.float32), axis=0).var(axis=0) / 2.0
    steps = [np.abs(np.diff(mean, axis=axis)).sum() for axis in (0, 1)]
    if steps[0] > steps[1]:
        mean, variance = mean.T, variance.T
    distance = _distance_from_edge(mean)
    if distance is None:
        return {}
    near_edge, far_from_edge = (
        (np.abs(distance) > SIDE_PX[0]) & (np.abs(distance) <= SIDE_PX[1]),
        np.abs(distance) > SIDE_PX[1],
    )
    contrast = float(
        mean[near_edge & (distance > 0.0)].mean() - mean[near_edge & (distance < 0.0)].mean()
    )
    features = {}
    for low, high in itertools.pairwise(DISTANCES_PX):
        sides = [(sign * distance > low) & (sign * distance <= high) for sign in (1.0, -1.0)]
        enough = min(int(region.sum()) for region in sides) > 50
        upper, lower = (
            float(mean[region].mean()) / contrast if enough else np.nan for region in sides
        )
        if high < NEAR_PX:
            features[f"step over {low:g} to {high:g} px of the edge"] = upper - lower
            features[f"mean level at {low:g} to {high:g} px of the edge"] = (upper + lower) / 2.0
        else:
            features[f"bright level at {low:g} to {high:g} px of the edge"] = upper
            features[f"dark level at {low:g} to {high:g} px of the edge"] = lower
    # A blur that grows off axis is larger at the ends of an edge through the centre.
    outer = np.abs(np.linspace(-1.0, 1.0, len(mean)))[:, None] > 0.5
    upper, lower = (
        (sign * distance > DISTANCES_PX[0]) & (sign * distance <= DISTANCES_PX[1])
        for sign in (1.0, -1.0)
    )
    steps = [
        float(mean[upper & part].mean() - mean[lower & part].mean()) for part in (outer, ~outer)
    ]
    features[
        f"step over {DISTANCES_PX[0]:g} to {DISTANCES_PX[1]:g} px of the edge, ends less middle"
    ] = (steps[0] - steps[1]) / contrast
    bright = distance > 0.0
    regions = {
        "dark side": far_from_edge & ~bright,
        "edge itself": np.abs(distance) < 1.5,
        "bright side": far_from_edge & bright,
    }
    for name, region in regions.items():
        features[f"ln variance of the {name}"] = (
            float(np.log(max(variance[region].mean(), 1e-12))) if region.sum() > 50 else np.nan
        )
    return features


def _distance_from_edge(mean: NDArray) -> NDArray | None:
    """Return the distance of each pixel from an upright edge, px, positive on the bright side; None
    without an edge.
    """
    import cv2

    gradient = np.diff(mean, axis=1)
    gradient *= np.sign(gradient.sum())
    rows, columns = np.arange(len(mean)), np.arange(gradient.shape[1]) + 0.5
    # Noise far from the edge would pull the centres of gravity: they start at the steepest place of
    # the smoothed rows.
    steepest = columns[np.argmax(cv2.GaussianBlur(gradient, (0, 0), 3.0), axis=1)]
    slope, at = np.polyfit(rows, steepest, 1)
    for _ in range(4):
        offset = columns[None, :] - (at + slope * rows[:, None])
        near_gradient = np.where(np.abs(offset) < NEAR_PX, gradient, 0.0)
        if not near_gradient.sum() > 0.0:
            return None
        # Moments of all rows together, as the gradient of a single one may cancel.
        shift, turn = (
            float(
                (near_gradient * offset * weight[:, None]).sum()
                / (near_gradient * weight[:, None] ** 2).sum()
            )
            for weight in (np.ones(len(rows)), rows - rows.mean())
        )
        slope, at = slope + turn, at + shift - turn * rows.mean()
    distance = (np.arange(mean.shape[1])[None, :] - (at + slope * rows[:, None])) / np.hypot(
        1.0, slope
    )
    if mean[distance > NEAR_PX].mean() < mean[distance < -NEAR_PX].mean():
        return -distance
    return distance


def point_features(
    frames: NDArray, dark_dn: float, full_scale_dn: float | None
) -> Mapping[str, float]:
    """Return mean levels in rings about the brightest point, above dark, as asinh(level / 1 DN),
    and the highest spot.

    A ring that clips is NaN: it has no distribution that a few sets would show.
    The highest spot is that of the smoothed frame above the mean of its ring, outside the inner
    rings: a ghost image.
    """
    import cv2

    mean = (frames.mean(axis=0, dtype=np.float64) - dark_dn).astype(np.float32)
    blurred = cv2.GaussianBlur(mean, (0, 0), 2.0)
    _, peak, _, (col, row) = cv2.minMaxLoc(blurred)
    y, x = np.indices(mean.shape)
    # The brightest pixel of a clipped point may be any of its plateau.
    parts = np.asarray(cv2.connectedComponents((blurred >= 0.9 * peak).astype(np.uint8))[1])
    core = parts == parts[row, col]
    row, col = float(y[core].mean()), float(x[core].mean())
    near_peak = np.hypot(y - row, x - col) < 6.0
    light = np.maximum(mean[near_peak], 0.0)
    if not light.sum() > 0.0:
        return {}
    row, col = float(light @ y[near_peak] / light.sum()), float(light @ x[near_peak] / light.sum())
    radius = np.hypot(y - row, x - col)
    features, highest = {}, 0.0
    clipped = (frames >= (np.inf if full_scale_dn is None else full_scale_dn)).mean(axis=0)
    smooth = cv2.GaussianBlur(mean, (0, 0), GHOST_PX)
    for low, high in itertools.pairwise(RADII_PX):
        ring = (radius >= low) & (radius < high)
        known = ring.any() and clipped[ring].mean() <= VALIDATION.most_clipped
        features[f"level at {low:g} to {high:g} px of the point"] = (
            float(np.arcsinh(mean[ring].mean())) if known else np.nan
        )
        if ring.any() and low >= LEAST_GHOST_PX:
            highest = max(highest, float(smooth[ring].max() - smooth[ring].mean()))
    features[f"highest spot beyond {LEAST_GHOST_PX:g} px of the point"] = float(np.arcsinh(highest))
    return features
