"""What lies along columns and not around the source: charge that overflows from full wells, and smear of reading.

Optics, tube and glare are round: at equal distance a source lights what is above it as it lights what is beside it.
Only the detector, which moves charge along columns, makes the one brighter than the other.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.point_stack import PointStack
from charact.method import Context

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Rows from the source on which round light is compared: nearer, it falls too steeply.
FIRST_ROW_PX = 5.0
# Rows averaged to see a streak, and standard errors by which their mean and all but one of them must be brighter than
# what lies beside the source; those of the mean of a column's outer half, above and below, or on one side alone.
BLOCK_ROWS, LEAST_BLOCKS = 4, 4
SEEN_BLOCK, FILLED = 5.0, 1.5
SEEN_BOTH, SEEN_ONE = 3.0, 6.0
# Share of the source's light by which cameras that are not quite round may be off.
ROUND_SHARE = 0.05
# Columns beside those that are bright in the source's own rows into which video or smear carries their light.
ADJACENT_COLUMNS_PX = 3
LEAST_HALF_WIDTH_PX = 5
# Noise of a frame that rounding leaves without any, DN.
ROUNDED_DN = 0.02
# Light of the source that is so many times the streak's or smear's is not spoiled by it.
HARMLESS = 30.0


@dataclass(frozen=True, kw_only=True)
class ColumnArtefacts:
    """Light above and below a source beyond what lies at the same distance to its left and right.

    Parameters
    ----------
    first_col
        Column of the frame that is the first here.
    row_offset
        Distance of each row from the source, column pitches, shape (row,).
    round_dn
        Light at equal distance to the left and right, over its faintest level, shape (row, col), DN.
    excess_dn, sd_dn
        What the frame shows beyond it, and the noise of one pixel, shape (row, col), DN.
    block_factor
        Variance of the mean of a few successive rows over that of as many independent pixels, dimensionless.
    """

    first_col: int
    row_offset: Array
    round_dn: Array
    excess_dn: Array
    sd_dn: Array
    block_factor: float


def column_artefact_mask(spot: PointStack, context: Context) -> Mask:
    """Tell the pixels of a stack's mean frame that overflow or smear has made brighter.

    Parameters
    ----------
    spot
        One stack of a point source.
    context
        Its sensor's pitches, where known.

    Returns
    -------
    mask
        True where light of the detector's columns lies on that of the source, shape (row, col): of each column next to
        the source as many rows as show it, all of them under smear. Nothing is True where none is seen, and nothing
        inside the core, whose own light outshines it. A radial profile leaves these pixels out.
    """
    mask = np.zeros(spot.image.shape, bool)
    found = compare_columns(spot, context)
    (above, up), (below, down) = (_reach(found, side) for side in (-1, 1))
    # Smear lies above and below alike; where the frame has no rows on one side the other must show it the more clearly.
    both = np.isfinite(up).all() and np.isfinite(down).all()
    smeared = (np.minimum(up, down) if both else np.fmax(up, down)) > (SEEN_BOTH if both else SEEN_ONE)
    far = np.abs(found.row_offset).max() + 1.0
    reach = np.stack([np.where(smeared, far, one) for one in (above, below)])
    seen = _around(reach.max(axis=0) > 0, round(spot.col) - found.first_col)
    if not seen.any():
        return mask
    wide = np.where(seen, reach, 0)
    wide = np.maximum(wide, np.maximum(_shift_columns(wide, 1), _shift_columns(wide, -1)))
    side = np.where(found.row_offset < 0, 0, 1)
    inside = np.abs(found.row_offset)[:, None] <= wide[side]
    beyond = np.abs(found.row_offset)[:, None] >= FIRST_ROW_PX
    count = np.maximum((inside & beyond).sum(axis=0), 1)
    level = np.where(inside & beyond, found.excess_dn, 0.0).sum(axis=0) / count
    level = np.maximum(level, np.maximum(_shift_columns(level, 1), _shift_columns(level, -1)))
    inside &= found.round_dn < HARMLESS * level
    mask[:, found.first_col : found.first_col + inside.shape[1]] = inside
    return mask


def compare_columns(spot: PointStack, context: Context, *, half_width_px: int | None = None) -> ColumnArtefacts:
    """Compare the columns near the source with what lies at the same distance beside it.

    Parameters
    ----------
    half_width_px
        Columns looked at on either side of the source; None: those that may spill or smear.
    """
    rows, cols = spot.image.shape
    dy = (np.arange(rows) - spot.row) * context.pitch_ratio
    dx = np.arange(cols) - spot.col
    half = _half_width(spot) if half_width_px is None else half_width_px
    first, last = max(0, round(spot.col) - half), min(cols, round(spot.col) + half + 1)
    radius = np.hypot(dx[None, :], dy[:, None])
    mean, sd = _horizontal_profile(spot.image, dx, dy, radius)
    near = radius[:, first:last]
    grid = np.arange(len(mean), dtype=float)
    light, noise = np.interp(near, grid, mean), np.interp(near, grid, sd)
    floor = float(mean.min())
    far = np.abs(dx) > max(2.0 * _half_width(spot), 0.3 * cols)
    return ColumnArtefacts(
        first_col=first,
        row_offset=dy,
        round_dn=light - floor,
        excess_dn=spot.image[:, first:last] - light,
        sd_dn=np.hypot(noise, ROUND_SHARE * (light - floor)),
        block_factor=_block_factor(spot.image[:, far]),
    )


def _half_width(spot: PointStack) -> int:
    """Columns on either side that may spill or smear: those that are bright in the source's own rows, and some more."""
    row, col = round(spot.row), round(spot.col)
    near = spot.image[max(0, row - 1) : row + 2].mean(axis=0)
    bright = near - spot.dark_dn > 0.5 * min(near.max() - spot.dark_dn, 0.5 * (spot.full_scale_dn - spot.dark_dn))
    run = np.flatnonzero(_around(bright, col))
    reach = int(np.abs(run - col).max()) if len(run) else 0
    return max(LEAST_HALF_WIDTH_PX, reach + ADJACENT_COLUMNS_PX)


def _horizontal_profile(image: Array, dx: Array, dy: Array, radius: Array) -> tuple[Array, Array]:
    """Mean and scatter of pixels at each whole distance left and right of the source; where they differ, the fainter's.

    Only what is nearer in rows than in columns counts, for there no column of the source passes.
    """
    beside = np.abs(dx)[None, :] > np.abs(dy)[:, None]
    reach = int(radius.max()) + 2
    means, sds, counts = [], [], []
    for side in (-1, 1):
        take = beside & (np.sign(dx) == side)[None, :]
        ring, value = np.rint(radius[take]).astype(int), image[take]
        count = np.bincount(ring, minlength=reach).astype(float)
        mean = np.bincount(ring, value, minlength=reach) / np.maximum(count, 1)
        square = np.bincount(ring, (value - mean[ring]) ** 2, minlength=reach) / np.maximum(count - 1, 1)
        means.append(mean)
        sds.append(np.sqrt(square))
        counts.append(count)
    mean, sd, count = np.array(means), np.array(sds), np.array(counts)
    full = count >= 4
    error = np.sqrt((sd**2 / np.maximum(count, 1)).sum(axis=0))
    differ = np.abs(mean[0] - mean[1]) > 6.0 * np.maximum(error, 1e-9)
    both = np.where(differ, np.minimum(mean[0], mean[1]), (mean * count).sum(axis=0) / np.maximum(count.sum(axis=0), 1))
    one = np.where(full[0], mean[0], mean[1])
    light = np.where(full.all(axis=0), both, one)
    known = np.flatnonzero(full.any(axis=0))
    scatter = np.where(full.all(axis=0), sd.max(axis=0), np.where(full[0], sd[0], sd[1]))
    grid = np.arange(reach)
    least = float(np.median(scatter[known])) if len(known) else 1.0
    return np.interp(grid, known, light[known]), np.maximum(
        np.interp(grid, known, scatter[known]), max(0.5 * least, ROUNDED_DN)
    )


def _block_factor(image: Array) -> float:
    """How much the noise of neighbouring rows adds up: noise shared by them, and columns that differ."""
    rows = image.shape[0] // BLOCK_ROWS * BLOCK_ROWS
    if rows < 4 * BLOCK_ROWS or image.shape[1] < 4:
        return 2.0
    # Columns are compared within a row: whatever is common to them, as a gradient down the frame, is no noise.
    even = image[:rows] - np.median(image[:rows], axis=1, keepdims=True)
    blocks = even.reshape(-1, BLOCK_ROWS, image.shape[1]).mean(axis=1)
    single, block = (float(np.median(np.abs(one - np.median(one)))) for one in (even, blocks))
    return float(np.clip(BLOCK_ROWS * block**2 / single**2, 1.0, BLOCK_ROWS)) if single > 0 else 2.0


def _reach(found: ColumnArtefacts, side: int) -> tuple[Array, Array]:
    """How far each column stays brighter on one side of the source than what is beside it, px, 0 where it does not.

    And by how many standard errors it does so on average in the outer half of its rows; NaN where there are too few.
    """
    rows = np.flatnonzero(found.row_offset * side >= FIRST_ROW_PX)[::side]
    count = len(rows) // BLOCK_ROWS
    out = np.zeros(found.excess_dn.shape[1])
    if count < LEAST_BLOCKS:
        return out, np.full(out.shape, np.nan)
    rows = rows[: count * BLOCK_ROWS]
    blocks = rows.reshape(count, BLOCK_ROWS)
    excess, variance = found.excess_dn[blocks].mean(axis=1), (found.sd_dn[blocks] ** 2).mean(axis=1)
    error = np.sqrt(variance * found.block_factor / BLOCK_ROWS)
    # A streak fills its rows; one bright pulse among dark pixels fills none but its own.
    filled = np.partition(found.excess_dn[blocks], 1, axis=1)[:, 1] > FILLED * np.sqrt(variance)
    ends = np.abs(found.row_offset)[blocks].max(axis=1)
    for place in range(out.size):
        bright = np.flatnonzero((excess[:, place] > SEEN_BLOCK * error[:, place]) & filled[:, place])
        out[place] = ends[bright[-1]] + BLOCK_ROWS if len(bright) else 0.0
    outer = slice(count // 2, None)
    noise = np.sqrt(np.maximum((error[outer] ** 2).mean(axis=0), excess[outer].var(axis=0)) / (count - count // 2))
    return out, excess[outer].mean(axis=0) / noise


def _around(bright: Mask, place: int) -> Mask:
    """Those of a row of yes and no that hang together with a place, which may itself be off by one."""
    out = np.zeros(bright.shape, bool)
    near = [one for one in (place, place - 1, place + 1) if 0 <= one < len(bright) and bright[one]]
    if not near:
        return out
    first = last = near[0]
    while first > 0 and bright[first - 1]:
        first -= 1
    while last < len(bright) - 1 and bright[last + 1]:
        last += 1
    out[first : last + 1] = True
    return out


def _shift_columns(values: Array, by: int) -> Array:
    out = np.roll(values, by, axis=-1)
    out[..., 0 if by > 0 else -1] = 0.0
    return out
