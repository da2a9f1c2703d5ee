"""Where the edge is: a straight line found by projections and refined row by row against the edge's own profile."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.picture import Picture

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Line:
    """An edge col = position + slope (row - middle row) of an upright picture.

    Parameters
    ----------
    position, slope
        px, and px per row.
    strength
        Step over its own standard error on the coarse picture, the noise taken from neighbouring pixels.
    """

    position: float
    slope: float
    strength: float = 0.0

    def across(self, shape: tuple[int, int]) -> Array:
        """Return the distance along the columns of every pixel from the line, shape (row, col), px."""
        row = np.arange(shape[0])[:, None] - (shape[0] - 1) / 2
        return np.arange(shape[1])[None, :] - self.position - self.slope * row

    def angle_rad(self, pitch_ratio: float) -> float:
        """Angle of the edge to the columns' direction, rad; rows are `pitch_ratio` column pitches apart."""
        return float(np.arctan(self.slope / pitch_ratio))


def find(picture: Picture) -> tuple[Picture, Line]:
    """Find the strongest straight step, turn the picture upright and return both."""
    factor = max(1, int(np.ceil(max(picture.value.shape) / 160)))
    small = _binned(picture.value, factor)
    slopes = np.tan(np.deg2rad(np.arange(-48.0, 49.0, 3.0)))
    candidates = [
        (*_best_step(small.T if transpose else small, float(slope)), float(slope), transpose)
        for transpose in (False, True)
        for slope in slopes
    ]
    score, place, slope, transpose = max(candidates, key=lambda found: abs(found[0]))
    upright = picture.turned(transpose=transpose, mirror=score < 0)
    width = upright.value.shape[1]
    position = (place + 0.5) * factor - 0.5
    line = Line(position=width - 1 - position if score < 0 else position, slope=-slope if score < 0 else slope)
    return upright, replace(_sharpened(upright, line), strength=_strength(small, score))


def _binned(value: Array, factor: int) -> Array:
    """Return block means, the remainder cut off."""
    rows, cols = (size // factor * factor for size in value.shape)
    return value[:rows, :cols].reshape(rows // factor, factor, cols // factor, factor).mean(axis=(1, 3))


def _profile(value: Array, slope: float, step: float = 1.0) -> tuple[Array, Array, float]:
    """Return sums and counts of the picture projected along a slope in cells, and the first cell's place, px."""
    row = np.arange(value.shape[0])[:, None] - (value.shape[0] - 1) / 2
    across = np.arange(value.shape[1])[None, :] - slope * row
    first = float(across.min())
    cell = np.rint((across - first) / step).astype(np.int64).ravel()
    sums = np.bincount(cell, weights=value.ravel())
    return np.asarray(sums, float), np.bincount(cell).astype(float), first


def _best_step(value: Array, slope: float) -> tuple[float, float]:
    """Return the largest weighted step of the projected profile, signed, and its place at the middle row, px."""
    sums, counts, first = _profile(value, slope)
    reach = max(3, min(value.shape) // 6)
    total = np.concatenate([[0.0], np.cumsum(sums)])
    weight = np.concatenate([[0.0], np.cumsum(counts)])
    cuts = np.arange(2, sums.size - 1)
    low, high = np.maximum(cuts - reach, 0), np.minimum(cuts + reach, sums.size)
    left, right = weight[cuts] - weight[low], weight[high] - weight[cuts]
    least = 0.1 * reach * min(value.shape)
    usable = (left > least) & (right > least)
    if not usable.any():
        return 0.0, 0.0
    left, right = np.maximum(left, 1), np.maximum(right, 1)
    step = (total[high] - total[cuts]) / right - (total[cuts] - total[low]) / left
    score = np.where(usable, step / np.sqrt(1 / left + 1 / right), 0.0)
    best = int(np.argmax(np.abs(score)))
    return float(score[best]), float(cuts[best] - 0.5 + first)


def _strength(small: Array, score: float) -> float:
    """Return a step score over the noise between neighbouring coarse pixels, whichever axis is the quieter."""
    noise = min(float(np.median(np.abs(np.diff(small, axis=axis)))) for axis in (0, 1)) / 0.6745 / np.sqrt(2)
    return abs(score) / max(noise, 1e-12 * (1 + abs(score)))


def _sharpened(picture: Picture, line: Line) -> Line:
    """Return the line of the slope at which the projected profile is steepest, from coarse to fine."""
    for width, steps in ((1.0, 1.0), (0.35, 0.35), (0.12, 0.12)):
        slopes = line.slope + np.tan(np.deg2rad(np.arange(-3, 4) * width))
        found = [_steepness(picture, line, float(slope), max(1.0, 4.0 * steps)) for slope in slopes]
        best = int(np.argmax([power for power, _ in found]))
        line = Line(position=found[best][1], slope=float(slopes[best]))
    return line


def _steepness(picture: Picture, line: Line, slope: float, blur_px: float) -> tuple[float, float]:
    """Return the greatest squared rise over `blur_px` of the projected profile near the line, and its place."""
    rows = picture.value.shape[0]
    window = np.abs(line.across(picture.value.shape)) < 16 + 0.06 * rows
    row = np.arange(rows)[:, None] - (rows - 1) / 2
    across = np.arange(picture.value.shape[1])[None, :] - slope * row - line.position
    cell = np.rint(across[window] / 0.5).astype(np.int64)
    first = cell.min()
    sums, counts = np.bincount(cell - first, weights=picture.value[window]), np.bincount(cell - first)
    total, weight = (np.concatenate([[0.0], np.cumsum(part)]) for part in (sums, counts.astype(float)))
    reach = max(2, round(blur_px / 0.5))
    cuts = np.arange(reach, sums.size - reach)
    if not cuts.size:
        return 0.0, line.position
    left, right = weight[cuts] - weight[cuts - reach], weight[cuts + reach] - weight[cuts]
    enough = np.minimum(left, right) > 0.5 * np.median(right)
    rise = np.where(
        enough,
        (total[cuts + reach] - total[cuts]) / np.maximum(right, 1)
        - (total[cuts] - total[cuts - reach]) / np.maximum(left, 1),
        -np.inf,
    )
    best = int(np.argmax(rise))
    return float(rise[best]), float((cuts[best] - 0.5 + first) * 0.5 + line.position)


@dataclass(frozen=True, kw_only=True)
class RowFit:
    """The line refined against the profile, and how single rows depart from it.

    Parameters
    ----------
    line
        The refined line.
    offset
        Displacement of each row's edge from the line, shape (row,), px.
    offset_sd
        Their scatter, px.
    """

    line: Line
    offset: Array
    offset_sd: float


def refine(picture: Picture, line: Line, iterations: int = 8) -> RowFit:
    """Fit the line to the edge's displacement in each row.

    Notes
    -----
    With the mean profile m of all rows as template a row's displacement is least squares on -m'(d). The template is
    smoothed by what the line can be off, less at each iteration.
    """
    rows = picture.value.shape[0]
    row = np.arange(rows) - (rows - 1) / 2
    offset = np.zeros(rows)
    for iteration in range(iterations):
        blur = max(0.5, 3.0 * 0.6**iteration)
        offset, good = _row_offsets(picture, line, blur)
        if good.sum() < 3:
            return RowFit(line=line, offset=offset, offset_sd=np.inf)
        good &= np.abs(offset - np.median(offset[good])) < 6 * _spread(offset[good]) + 1e-9
        design = np.stack([np.ones(rows), row], axis=1)[good]
        shift, turn = np.linalg.lstsq(design, offset[good], rcond=None)[0]
        shift, turn = float(np.clip(shift, -3, 3)), float(np.clip(turn * rows, -6, 6) / rows)
        line = replace(line, position=line.position + shift, slope=line.slope + turn)
        offset = offset - shift - turn * row
        if iteration >= 5 and abs(shift) < 1e-4 and abs(turn) * rows < 2e-4:
            break
    offset = np.where(good, offset, np.nan)
    return RowFit(line=line, offset=offset, offset_sd=_spread(offset[good]))


def _row_offsets(picture: Picture, line: Line, blur_px: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return each row's displacement against the mean profile, and which rows hold the edge."""
    across = line.across(picture.value.shape)
    reach = 14.0
    near = np.abs(across) < reach
    cell = np.clip(((across + reach) * 4).astype(np.int64), 0, 8 * int(reach) - 1)
    sums = np.bincount(cell[near], weights=picture.value[near], minlength=8 * int(reach))
    counts = np.bincount(cell[near], minlength=8 * int(reach))
    places = (np.arange(sums.size) + 0.5) / 4 - reach
    kernel = np.exp(-0.5 * ((places[:, None] - places) / blur_px) ** 2) * counts
    kernel = kernel / np.maximum(kernel.sum(axis=1, keepdims=True), 1e-300)
    profile = kernel @ (sums / np.maximum(counts, 1))
    rise = np.gradient(profile, places)
    inside = np.clip(across, places[0], places[-1])
    slope = np.where(near, np.interp(inside, places, rise), 0.0)
    residual = np.where(near, picture.value - np.interp(inside, places, profile), 0.0)
    power = np.sum(slope**2, axis=1)
    good = power > 0.5 * np.median(power)
    return -np.sum(residual * slope, axis=1) / np.maximum(power, 1e-300), good & (power > 0)


def _spread(values: Array) -> float:
    """Return a standard deviation that outliers do not move."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))
