"""Position of an edge: a straight line found by projections and refined row by row, and
displacements of fields.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.pixels.bow import bow_of
from charact.estimators.mtf.edge.thresholds import THRESHOLDS
from charact.estimators.mtf.mean_frame import OrientedFrame
from charact.frames.robust import NORMAL, median, robust_sd
from charact.frames.stack import Stack

Array = NDArray[np.float64]

# Slopes among which the strongest step is searched, px per row.
SLOPES = np.tan(np.deg2rad(np.arange(-48.0, 49.0, 2.0)))
# Distance from the edge up to which a row locates it, px, and cells per px of the mean profile it
# is compared with.
ROW_REACH_PX, CELLS_PER_PX = 14.0, 4
# Cells of the rows' mean profile, px, and the weights that smooth it, shape (cell, cell).
CELLS_PX = (np.arange(2 * CELLS_PER_PX * int(ROW_REACH_PX)) + 0.5) / CELLS_PER_PX - ROW_REACH_PX
SMOOTHING = np.exp(-0.5 * ((CELLS_PX[:, None] - CELLS_PX) / 0.5) ** 2)
# Times a line is bent after its edge.
MAX_BENDS = 3
# Displacement of the odd lines against the even ones, px, and its standard uncertainty.
Displacement = tuple[float, float]


def _strongest_step(value: Array, slopes: Array) -> tuple[float, float, float]:
    """Return the largest weighted step of the profiles projected along slopes: signed, its position
    and its slope.
    """
    rows, cols = value.shape
    side, middle = min(rows, cols), 0.5 * (rows - 1)
    reach_cells = max(3, side // 6)
    strongest = (0.0, 0.0, 0.0)
    for slope in slopes:
        # Running sums of the pixels projected along the slope and of their number.
        first = -abs(slope) * middle
        size = int(np.rint(cols - 1 - 2.0 * first)) + 1
        begin = np.rint(-slope * (np.arange(rows) - middle) - first).astype(np.int64) + 1
        cell = (begin[:, None] + np.arange(cols)).ravel()
        total = np.cumsum(np.bincount(cell, value.ravel(), size + 1))
        count = np.cumsum(np.bincount(cell, minlength=size + 1))
        cut = np.arange(2, size - 1)
        low, high = np.maximum(cut - reach_cells, 0), np.minimum(cut + reach_cells, size)
        before, after = count[cut] - count[low], count[high] - count[cut]
        # Each side of a step has at least a tenth of a full side's pixels.
        full = np.minimum(before, after) > 0.1 * reach_cells * side
        cut, low, high, before, after = (part[full] for part in (cut, low, high, before, after))
        if cut.size:
            step = (total[high] - total[cut]) / after - (total[cut] - total[low]) / before
            score = step * np.sqrt(before * after / (before + after))
            index = int(np.argmax(np.abs(score)))
            if abs(score[index]) > abs(strongest[0]):
                strongest = (float(score[index]), float(cut[index] - 0.5 + first), float(slope))
    return strongest


@dataclass(frozen=True, kw_only=True)
class EdgeLine:
    """An edge col = position + slope (row - middle row) of an upright picture.

    Parameters
    ----------
    position, slope
        px, and px per row.
    strength
        Step over its own standard error on the coarse picture, the noise taken from neighbouring
        pixels.
    fields_apart_px, fields
        How far further along the columns the edge lies in the odd field, px, and the field of every
        pixel, 0 or 1, shape (row, col); None: the fields do not lie apart.
    bend
        How far the edge lies beyond the line in each row, by curvature or distortion, shape (row,),
        px; None: it is straight.
    """

    position: float
    slope: float
    strength: float = 0.0
    fields_apart_px: float = 0.0
    fields: NDArray[np.int64] | None = None
    bend: Array | None = None

    def across(self, shape: tuple[int, int]) -> Array:
        """Return the distance along the columns of every pixel from the line, shape (row, col),
        px.
        """
        row = np.arange(shape[0])[:, None] - (shape[0] - 1) / 2
        distance = np.arange(shape[1])[None, :] - self.position - self.slope * row
        if self.bend is not None:
            distance = distance - self.bend[:, None]
        return (
            distance
            if self.fields is None
            else distance - self.fields_apart_px * (self.fields - 0.5)
        )

    def distance(self, shape: tuple[int, int], pitch_ratio: float) -> Array:
        """Return the distance of every pixel along the normal, shape (row, col), px."""
        slope = self.slope if self.bend is None else self.slope + np.gradient(self.bend)[:, None]
        return self.across(shape) / np.hypot(1.0, slope / pitch_ratio)

    def angle_rad(self, pitch_ratio: float) -> float:
        """Angle of the edge to the columns' direction, rad; rows are `pitch_ratio` column pitches
        apart.
        """
        return float(np.arctan(self.slope / pitch_ratio))


def find(stack: Stack) -> tuple[OrientedFrame, EdgeLine]:
    """Find the strongest straight step of a stack's mean frame, turned upright, and return both."""
    rows, cols = stack.mean_frame_dn.shape
    picture = OrientedFrame(
        stack=stack,
        value=stack.mean_frame_dn,
        row_index=np.broadcast_to(np.arange(rows)[:, None], (rows, cols)),
        transposed=False,
        mirrored=False,
        pitch_ratio=stack.pitch_ratio,
    )
    factor = max(1, int(np.ceil(max(picture.value.shape) / 96)))
    rows, cols = (size // factor * factor for size in (rows, cols))
    small = (
        picture.value[:rows, :cols]
        .reshape(rows // factor, factor, cols // factor, factor)
        .mean(axis=(1, 3))
    )
    steps = [_strongest_step(np.ascontiguousarray(frame), SLOPES) for frame in (small, small.T)]
    transpose = abs(steps[1][0]) > abs(steps[0][0])
    score, cell, slope = steps[int(transpose)]
    upright = picture.turned(transpose=transpose, mirror=score < 0)
    width = upright.value.shape[1]
    position = (cell + 0.5) * factor - 0.5
    line = EdgeLine(
        position=width - 1 - position if score < 0 else position,
        slope=-slope if score < 0 else slope,
    )
    noise = min(robust_sd(np.diff(small, axis=axis), 0.0) for axis in (0, 1)) / np.sqrt(2.0)
    strength = abs(score) / max(noise, 1e-12 * (1 + abs(score)))
    return upright, replace(iterate_edge_line(upright, line), strength=strength)


def iterate_edge_line(picture: OrientedFrame, line: EdgeLine) -> EdgeLine:
    """Return the line that fits the pixels around it best with a smooth step, by damped
    Gauss-Newton.

    Notes
    -----
    Model: level + rise tanh((col - position - slope row) / width), level and rise changing evenly
    along the edge, as uneven light has it. A symmetric template is unbiased for the course of any
    edge, and nearly as precise as the edge's own shape. Single wild pixels count as little more
    than far ones.
    """
    rows, cols = picture.value.shape
    row = np.arange(rows) - (rows - 1) / 2
    slack = 0.5 * rows * 0.035
    across = line.across((rows, cols))
    reach_px = 12.0 + slack
    band = np.nonzero(np.abs(across) < reach_px)
    every = picture.value[band], across[band], row[band[0]] / rows
    if every[0].size < 16:
        return line
    # The first steps are far from exact: some of the pixels tell them.
    few = tuple(np.ascontiguousarray(part[:: max(1, every[0].size // 2000)]) for part in every)
    shift, turn, width, clip = 0.0, 0.0, max(2.0, slack), np.inf
    last = np.inf
    for iteration in range(12):
        value, distance, height = few if iteration < 3 else every
        bend_argument = (distance - shift - turn * height) / width
        renew = iteration in (3, 6)
        across_step, along_step, wider, clip = _smooth_step(
            value, bend_argument, height, width, clip, renew
        )
        # On single numbers NumPy's clip takes fifty times as long.
        across_step, along_step = min(max(across_step, -4.0), 4.0), min(max(along_step, -8.0), 8.0)
        shift, turn = min(max(shift + across_step, -reach_px), reach_px), turn + along_step
        width = min(max(width + min(max(wider, -0.5 * width), width), 0.4), 20.0)
        size = abs(across_step) + abs(along_step)
        if iteration > 3 and size < 1e-3 and last < 0.1:
            break
        last = size
    return replace(line, position=line.position + shift, slope=line.slope + turn / rows)


def _smooth_step(
    value: Array, bend_argument: Array, height: Array, width: float, clip: float, renew: bool
) -> tuple[float, float, float, float]:
    """Return the Gauss-Newton step of position, turn and width of a smooth step, and the clip of
    residuals.

    Level, rise and their slopes along the edge are fitted first. `renew`: whether the clip is set
    from the residuals.
    """
    bend = np.tanh(bend_argument)
    amplitudes = np.stack([np.ones_like(bend), bend, height, height * bend])
    levels = _least_squares(amplitudes, value)
    steep = -(levels[1] + levels[3] * height) / width * (1.0 - bend**2)
    residual = value - levels @ amplitudes
    if renew:
        clip = 6.0 * NORMAL * median(np.abs(residual[:: max(1, value.size // 4000)]))
    design = np.concatenate([amplitudes, [steep, steep * height, steep * bend_argument]])
    return *_least_squares(design, np.clip(residual, -clip, clip))[4:].tolist(), clip


def _least_squares(design: Array, value: Array) -> Array:
    """Return the amplitudes of rows of a design, shape (row, pixel); one that has no effect stays
    at 0.
    """
    normal = design @ design.T
    normal += np.diag(1e-9 * np.diag(normal) + 1e-300)
    return np.asarray(np.linalg.solve(normal, design @ value), np.float64)


@dataclass(frozen=True, kw_only=True)
class RowFit:
    """The line refined against the profile, and how single rows depart from it.

    Parameters
    ----------
    line
        The refined line, or the rim of a disc.
    offset
        Displacement of each row's edge from the line, shape (row,), px.
    offset_sd
        Their scatter, px.
    """

    line: EdgeLine
    offset: Array
    offset_sd: float


def refine(picture: OrientedFrame, line: EdgeLine) -> RowFit:
    """Return the displacement of each row's edge from the line, which is corrected by them.

    Notes
    -----
    With the mean profile m of all rows as template a row's displacement is least squares on -m'(d).
    Where the displacements follow a parabola or cubic the line is bent by it, and they are measured
    anew: a bent edge smears the first template.
    """
    rows = picture.value.shape[0]
    row = np.arange(rows) - (rows - 1) / 2
    corrected, bends = False, 0
    while True:
        across = line.across(picture.value.shape)
        col, near = _near_columns(line, across)
        value, distance = (np.take_along_axis(part, col, 1) for part in (picture.value, across))
        position = np.clip((distance + ROW_REACH_PX) * CELLS_PER_PX - 0.5, 0, CELLS_PX.size - 1)
        sums, counts = _profile_sums(value[near], position[near])
        profile = SMOOTHING @ sums / np.maximum(SMOOTHING @ counts, 1e-300)
        cells = np.arange(profile.size)
        template = np.interp(position, cells, profile)
        rise = np.interp(position, cells, np.gradient(profile, CELLS_PX))
        weights, power = displacement_weights(rise, template - profile.mean(), near)
        offset = np.sum(weights * (value - template), axis=1)
        usable = (power > 0.5 * median(power)) & (power > 0)
        if usable.sum() < 3:
            return RowFit(line=line, offset=offset, offset_sd=np.inf)
        usable &= np.abs(offset - median(offset[usable])) < 6 * robust_sd(offset[usable]) + 1e-9
        design = np.stack([np.ones_like(row), row], axis=1)[usable]
        shift, turn = np.linalg.lstsq(design, offset[usable], rcond=None)[0].tolist()
        if corrected or abs(shift) + abs(turn) * rows <= 0.02:
            displacement = np.where(usable, offset - shift - turn * row, np.nan)
            coefficients = bow_of(displacement) if bends < MAX_BENDS else np.zeros(2)
            if not coefficients.any():
                break
            known = np.flatnonzero(usable)
            at = np.clip(2.0 * (row - row[known[0]]) / (known[-1] - known[0]) - 1.0, -1.0, 1.0)
            bend = np.polynomial.legendre.legval(at, [0.0, 0.0, *coefficients])
            line = replace(line, bend=bend if line.bend is None else line.bend + bend)
            bends += 1
            continue
        shift, turn = min(max(shift, -3.0), 3.0), min(max(turn * rows, -6.0), 6.0) / rows
        line, corrected = (
            replace(line, position=line.position + shift, slope=line.slope + turn),
            True,
        )
    if usable.sum() < 3:
        return RowFit(line=line, offset=offset, offset_sd=np.inf)
    offset = np.where(usable, offset - shift - turn * row, np.nan)
    return RowFit(line=line, offset=offset, offset_sd=robust_sd(offset[usable]))


def _near_columns(line: EdgeLine, across: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the columns of each row around a line, shape (row, near column), and which of their
    pixels locate the edge.
    """
    rows, cols = across.shape
    reach_px = ROW_REACH_PX + 0.5 * abs(line.fields_apart_px)
    middle = line.position + line.slope * (np.arange(rows)[:, None] - (rows - 1) / 2)
    if line.bend is not None:
        middle = middle + line.bend[:, None]
    col = np.floor(middle - reach_px).astype(np.int64) + np.arange(2 * int(reach_px) + 4)
    inside = (col >= 0) & (col < cols)
    col = np.clip(col, 0, cols - 1)
    return col, inside & (np.abs(np.take_along_axis(across, col, 1)) < ROW_REACH_PX)


def _profile_sums(value: Array, position: Array) -> tuple[Array, Array]:
    """Return the sum of the pixels in each cell of the rows' mean profile, and their number.

    A pixel between the middles of two cells counts in both as it is near: at 45 degrees all rows
    cross the cells at one place, and pixels that passed from one cell to the next along the edge
    would seem to bend it. `position`: that of each pixel, in cells.
    """
    position = np.minimum(position, CELLS_PX.size - 1.001)
    cell = position.astype(np.int64)
    cells = np.concatenate([cell, cell + 1])
    weights = np.concatenate([1.0 - position + cell, position - cell])
    sums, counts = (
        np.bincount(cells, weight, CELLS_PX.size).astype(np.float64)
        for weight in (weights * np.tile(value, 2), weights)
    )
    return sums, counts


def displacement_weights(
    rise: Array, profile: Array, near: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return the weights by which the pixels of a row, less their profile, sum to its displacement,
    shape (row, near column), px per DN, and the power that tells it, shape (row,).

    A row's own level and step are free: light that changes along the edge must not move it.

    Parameters
    ----------
    rise, profile, near
        Slope of the profile at each pixel, its value less a mean one, and which pixels count, shape
        (row, near column).
    """
    shape = np.stack([rise, np.ones_like(rise), profile], axis=1) * near[:, None]
    normal = shape @ shape.mT
    diagonal = np.einsum("rkk->rk", normal)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    normal = normal / (scale[:, :, None] * scale[:, None]) + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(normal)[:, 0] / (scale * scale[:, :1])
    return -np.einsum("rk,rkc->rc", inverse, shape), near.any(axis=1) / inverse[:, 0]


def is_significant(displacement: Displacement) -> bool:
    """Return whether fields are displaced by more than chance, and by enough to matter."""
    displacement_px, error = displacement
    return bool(
        abs(displacement_px)
        > max(THRESHOLDS.field_displacement_sd * error, THRESHOLDS.field_displacement_px)
    )


def field_displacement(
    picture: OrientedFrame,
    rows: RowFit,
    valid: NDArray[np.bool_],
    distance: Array,
    profile: tuple[Array, Array],
    noise: float | None = None,
) -> Displacement:
    """Return the displacement of the edge in odd lines of the frame across the edge, px, and its
    standard uncertainty.

    Parameters
    ----------
    valid, distance
        Pixels that show it where lines run along the edge, and their distance from it, shape (row,
        col), px.
    profile
        Places, px, and values of the mean profile, DN.
    noise
        Standard deviation of a pixel, DN; None: that of the pixels less their profile.

    Notes
    -----
    Lines across the edge are rows of the picture: the medians of their displacements are compared.
    For lines along it the displacement is least squares on single pixels.
    """
    if not picture.transposed:
        odd, finite = (picture.row_index[:, 0] % 2).astype(bool), np.isfinite(rows.offset)
        odd_offset, even_offset = rows.offset[finite & odd], rows.offset[finite & ~odd]
        if min(odd_offset.size, even_offset.size) < 6:
            return 0.0, np.inf
        error = 1.25 * np.hypot(
            robust_sd(odd_offset) / np.sqrt(odd_offset.size),
            robust_sd(even_offset) / np.sqrt(even_offset.size),
        )
        return median(odd_offset) - median(even_offset), float(error)
    offset_px, parity = distance[valid], picture.row_index[valid] % 2
    residual = picture.value[valid] - np.interp(offset_px, *profile)
    shape = (0.5 - parity) * steepness(*profile, offset_px)
    power = float(shape @ shape)
    if power <= 0 or parity.min() == parity.max():
        return 0.0, np.inf
    return float(shape @ residual) / power, float(
        np.std(residual) if noise is None else noise
    ) / np.sqrt(power)


def steepness(position: Array, value: Array, distance: Array) -> Array:
    """Return the slope of a profile at distances, DN per px, smoothed over even steps, as bins may
    lie close together.

    Zero within a pixel of its ends, and for a profile that is too short.
    """
    step_px, smooth = 0.25, 5
    even_px = np.arange(position[0], position[-1], step_px)
    if even_px.size < smooth + 6:
        return np.zeros_like(distance)
    running = np.convolve(np.interp(even_px, position, value), np.ones(smooth) / smooth, "valid")
    middle = even_px[smooth // 2 : -(smooth // 2)]
    return np.interp(
        distance, middle[2:-2], np.gradient(running, step_px)[2:-2], left=0.0, right=0.0
    )
