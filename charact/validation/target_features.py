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
from charact.observables.size import LN_VARIANCE, Size
from charact.validation.thresholds import VALIDATION
from labdata import Kind
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
# Smoothing of a point and its neighbourhood when its centre is found, px.
SPOT_PX = 2.0
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
    matters = "resolution"
    size = Size(unit="of MTF", factor=1.0)
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
    matters = "contrast near bright areas"
    least_sd = 1e-4

    def numbers(self, stacks: SetStacks) -> Numbers:
        return {} if stacks.edge is None else edge_features(stacks.edge, stacks.dark.mean_dn)

    def sizes(self, stacks: SetStacks) -> Mapping[str, Size]:
        return {"ln variance": LN_VARIANCE, "": Size(unit="% of the step")}


@observable
class PointProfile(Observable[SetStacks]):
    """Levels at distances from a point source."""

    name = "point"
    order = 22
    title = "Profile of the point source"
    cause = "halo, lens, or saturation of the microchannel plate"
    matters = "faint objects near bright ones"
    # Of asinh(level / 1 DN): over the level, or over 1 DN where that is more.
    size = Size(unit="% of level", of=np.sinh, over=np.cosh)
    least_sd = 0.01

    def numbers(self, stacks: SetStacks) -> Numbers:
        full_scale_dn, dark_dn = stacks.context.full_scale_dn, stacks.dark.mean_dn
        return {} if stacks.point is None else point_features(stacks.point, dark_dn, full_scale_dn)


@dataclass(frozen=True, kw_only=True)
class EdgeLine:
    """Line of an edge: column = at + slope row where it is upright, else row = at + slope column.

    `sign`: 1 where the light grows with the column, or row, else -1.
    """

    at: float
    slope: float
    is_upright: bool
    sign: float

    @property
    def normal(self) -> tuple[float, float]:
        """Direction (x, y) across the edge to its bright side, px."""
        along, across = -self.sign * self.slope, self.sign
        return (across, along) if self.is_upright else (along, across)

    def distance(self, shape: tuple[int, int]) -> NDArray:
        """Return the distance of each pixel from the edge, px, positive on the bright side."""
        rows, columns = np.indices(shape, sparse=True)
        across, along = (columns, rows) if self.is_upright else (rows, columns)
        return self.sign * (across - self.at - self.slope * along) / np.hypot(1.0, self.slope)


def edge_line(mean: NDArray) -> EdgeLine | None:
    """Return the line of an edge in a frame, None where none is found.

    Notes
    -----
    It is the line through the centres of gravity of the gradient within `NEAR_PX` of it in each
    row, or column of a flat edge.
    """
    import cv2

    # The net step from border to border, in which noise cancels.
    is_upright = bool(abs((mean[:, -1] - mean[:, 0]).mean()) >= abs((mean[-1] - mean[0]).mean()))
    gradient = np.diff(mean if is_upright else mean.T, axis=1)
    sign = float(np.sign(gradient.sum()))
    gradient *= sign
    rows, columns = np.arange(len(gradient)), np.arange(gradient.shape[1]) + 0.5
    # Noise far from the edge would pull the centres of gravity: they start at the steepest place of
    # the smoothed rows.
    smooth = cv2.GaussianBlur(gradient, (0, 0), 3.0)
    slope, at = np.polyfit(rows, columns[np.argmax(smooth, axis=1)], 1)
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
    return EdgeLine(at=float(at), slope=float(slope), is_upright=is_upright, sign=sign)


def band_weights(distance: NDArray, low: float, high: float) -> NDArray:
    """Return the fraction of each pixel that lies between two distances from a line, or radii about
    a point.

    A pixel is as wide as one pitch in every direction: so the fraction changes smoothly with the
    place of the line or point on the pixel grid. From 0 on, a band has all that is nearer.
    """
    inner = np.clip(low + 0.5 - distance, 0.0, 1.0) if low > 0.0 else 0.0
    return np.clip(high + 0.5 - distance, 0.0, 1.0) - inner


def edge_features(frames: NDArray, dark_dn: float) -> Mapping[str, float]:
    """Return mean levels and variances in time by distance from an edge, none where no edge is
    found.

    Notes
    -----
    Levels are over the step close to the edge. Near it they are given as the step between both
    sides at equal distances, which an error of the place hardly changes, and their mean: blur and
    sharpening. Far from it the dark side shows veiling glare and ghost images. Noise that is larger
    on the edge than on both sides shows jitter of lines, or motion.
    """
    mean = frames.mean(axis=0, dtype=np.float64) - dark_dn
    # The difference of successive frames leaves drift out.
    variance = np.diff(frames.astype(np.float32), axis=0).var(axis=0) / 2.0
    line = edge_line(mean)
    if line is None:
        return {}
    distance = line.distance(mean.shape)
    if not line.is_upright:
        mean, variance, distance = mean.T, variance.T, distance.T

    def level(low: float, high: float, sign: float, part: NDArray | float = 1.0) -> float:
        weight = band_weights(sign * distance, low, high) * part
        return float((weight * mean).sum() / weight.sum()) if weight.sum() > 50.0 else np.nan

    contrast = level(*SIDE_PX, 1.0) - level(*SIDE_PX, -1.0)
    features = {}
    for low, high in itertools.pairwise(DISTANCES_PX):
        upper, lower = (level(low, high, sign) / contrast for sign in (1.0, -1.0))
        if high < NEAR_PX:
            features[f"step over {low:g} to {high:g} px of the edge"] = upper - lower
            features[f"mean level at {low:g} to {high:g} px of the edge"] = (upper + lower) / 2.0
        else:
            features[f"bright level at {low:g} to {high:g} px of the edge"] = upper
            features[f"dark level at {low:g} to {high:g} px of the edge"] = lower
    # A blur that grows off axis is larger at the ends of an edge through the centre.
    outer = np.abs(np.linspace(-1.0, 1.0, len(mean)))[:, None] > 0.5
    steps = [
        level(*DISTANCES_PX[:2], 1.0, part) - level(*DISTANCES_PX[:2], -1.0, part)
        for part in (outer, ~outer)
    ]
    features[
        f"step over {DISTANCES_PX[0]:g} to {DISTANCES_PX[1]:g} px of the edge, ends less middle"
    ] = (steps[0] - steps[1]) / contrast
    regions = {
        "dark side": distance < -SIDE_PX[1],
        "edge itself": np.abs(distance) < 1.5,
        "bright side": distance > SIDE_PX[1],
    }
    for name, region in regions.items():
        features[f"ln variance of the {name}"] = (
            float(np.log(max(variance[region].mean(), 1e-12))) if region.sum() > 50 else np.nan
        )
    return features


def spot_centre(mean: NDArray) -> tuple[float, float] | None:
    """Return the centre of gravity (row, col) of the brightest spot of a frame above the dark, None
    without light.

    Notes
    -----
    Light is weighted by a Gaussian of `SPOT_PX` about the centre itself: a border of the window
    would make the centre depend on its place on the pixel grid. The centre of light so weighted
    lies between both centres, so that its steps are doubled (Bernstein and Jarvis 2002,
    doi:10.1086/338085).
    """
    import cv2

    image = np.asarray(mean, np.float32)
    blurred = cv2.GaussianBlur(image, (0, 0), SPOT_PX)
    _, peak, _, (col, row) = cv2.minMaxLoc(blurred)
    # The brightest pixel of a clipped point may be any of its plateau.
    parts = np.asarray(cv2.connectedComponents((blurred >= 0.9 * peak).astype(np.uint8))[1])
    centre = np.argwhere(parts == parts[row, col]).mean(axis=0)
    window = 4.0 * SPOT_PX
    # The top of a clipped point is flat, and its centre comes slowly.
    for _ in range(100):
        first = np.maximum(np.ceil(centre - window).astype(int), 0)
        last = np.floor(centre + window).astype(int) + 1
        light = image[first[0] : last[0], first[1] : last[1]]
        y, x = np.ogrid[: light.shape[0], : light.shape[1]]
        y, x = y + first[0] - centre[0], x + first[1] - centre[1]
        weight = light * np.exp(-(y**2 + x**2) / (2.0 * SPOT_PX**2))
        total = weight.sum()
        if not total > 0.0:
            return None
        relative_variance = (weight * (y**2 + x**2)).sum() / (2.0 * SPOT_PX**2 * total)
        step = np.array([(weight * y).sum(), (weight * x).sum()]) / total
        centre = centre + step / np.clip(1.0 - relative_variance, 0.5, 1.0)
        if np.hypot(*step) < 1e-4:
            break
    return float(centre[0]), float(centre[1])


def target_centre(kind: Kind, mean: NDArray) -> tuple[float, float, float | None] | None:
    """Return the centre (row, col) of an edge, bars or a point in a frame, and the angle of edge or
    bars, deg; None where there is none.

    The centre of an edge is its place nearest to the centre of the frame. An angle is that of
    `Target.angle_deg` for square pixels: of an edge to its bright side, of bars as their gradients
    have it.
    """
    import cv2

    if kind == "point":
        spot = spot_centre(mean - np.median(mean))
        return spot and (*spot, None)
    if kind == "edge":
        line = edge_line(mean)
        if line is None:
            return None
        normal, middle = np.array(line.normal), (np.array(mean.shape) - 1.0) / 2.0
        away = float(line.distance(mean.shape)[int(middle[0]), int(middle[1])])
        row, col = middle.astype(int) - away * normal[::-1] / np.hypot(*normal)
        return float(row), float(col), float(np.rad2deg(np.arctan2(normal[1], normal[0])))
    image = np.asarray(mean - np.median(mean), np.float32)
    blurred = cv2.GaussianBlur(image, (0, 0), NEAR_PX)
    light = np.maximum(blurred - 0.5 * blurred.max(), 0.0)
    down, right = np.gradient(cv2.GaussianBlur(image, (0, 0), GHOST_PX))
    if not light.sum() > 0.0:
        return None
    y, x = np.indices(light.shape, sparse=True)
    products = [float((light * term).sum()) for term in (right * down, right**2, down**2)]
    angle = 0.5 * np.arctan2(2.0 * products[0], products[1] - products[2])
    row, col = (float((light * axis).sum() / light.sum()) for axis in (y, x))
    return row, col, float(np.rad2deg(angle))


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
    centre = spot_centre(mean)
    if centre is None:
        return {}
    y, x = np.indices(mean.shape, sparse=True)
    radius = np.hypot(y - centre[0], x - centre[1])
    features, highest = {}, 0.0
    clipped = (frames >= (np.inf if full_scale_dn is None else full_scale_dn)).mean(axis=0)
    smooth = cv2.GaussianBlur(mean, (0, 0), GHOST_PX)
    for low, high in itertools.pairwise(RADII_PX):
        weight = band_weights(radius, low, high)
        ring, area = weight > 0.0, weight.sum()
        known = area > 0.0 and (clipped * weight).sum() <= VALIDATION.most_clipped * area
        features[f"level at {low:g} to {high:g} px of the point"] = (
            float(np.arcsinh((weight * mean).sum() / area)) if known else np.nan
        )
        if ring.any() and low >= LEAST_GHOST_PX:
            highest = max(highest, float(smooth[ring].max() - smooth[ring].mean()))
    features[f"highest spot beyond {LEAST_GHOST_PX:g} px of the point"] = float(np.arcsinh(highest))
    return features
