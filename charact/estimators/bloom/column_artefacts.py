"""Column artefacts: streaks of overflowing wells, and smear."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.findings import finding
from charact.estimators.bloom.point_stack import PointStack
from charact.estimators.bloom.source_view import polar_of
from charact.frames.noise_law import NoiseLaw
from charact.frames.robust import robust_sd
from charact.method import Context
from charact.verdict import judge
from labdata import Array, Mask
from labdata.measurement import Measurement, make_refusal, measurement_from_sd

# Minimum row distance for the comparison; the profile is too steep closer to the source.
FIRST_ROW_PX = 5.0
# Rows averaged for the detection of a streak.
BLOCK_ROWS = 4
# Noise of a frame without noise of its own, DN: quantisation.
ROUNDED_DN = 0.02


@dataclass(frozen=True, kw_only=True)
class ColumnArtefacts:
    """Signal above and below a source in excess of that at the same distance left and right.

    `first_col`: first column of the arrays; `row_offset`: distance of each row from the source,
    column pitches, shape (row,); `round_dn`: mean at the same distance left and right, above its
    minimum, shape (row, col), DN; `excess_dn`, `sd_dn`: excess over it, and the noise of one pixel,
    shape (row, col), DN; `block_factor`: variance of the mean of some successive rows over that of
    as many independent pixels, dimensionless.
    """

    first_col: int
    row_offset: Array
    round_dn: Array
    excess_dn: Array
    sd_dn: Array
    block_factor: float


def column_artefact_mask(spot: PointStack, context: Context) -> Mask:
    """Return the pixels of a mean frame that column blooming or smear has brightened, shape (row,
    col).

    For each column near the source the rows with a visible streak, all of them under smear; a
    radial profile excludes these pixels. The core, which outshines the column signal, is not
    included.
    """
    from scipy import ndimage

    mask = np.zeros(spot.image.shape, bool)
    columns = compare_columns(spot, context)
    (above_px, up), (below_px, down) = (_reach(columns, side) for side in (-1, 1))
    # Smear is equal above and below; if one side is outside the frame, the other must be more
    # significant.
    has_both_sides = np.isfinite(up).all() and np.isfinite(down).all()
    smeared = (np.minimum(up, down) if has_both_sides else np.fmax(up, down)) > (
        3.0 if has_both_sides else 6.0
    )
    row_distance = np.abs(columns.row_offset)[:, None]
    streak_px = np.stack(
        [np.where(smeared, row_distance.max() + 1.0, side_px) for side_px in (above_px, below_px)]
    )
    streaked_cols = run_through(streak_px.max(axis=0) > 0, round(spot.col) - columns.first_col)
    if not streaked_cols.any():
        return mask
    widened_px = ndimage.maximum_filter1d(
        np.where(streaked_cols, streak_px, 0), 3, axis=-1, mode="constant"
    )
    within_streak = row_distance <= widened_px[np.where(columns.row_offset < 0, 0, 1)]
    beyond_core = within_streak & (row_distance >= FIRST_ROW_PX)
    level = np.where(beyond_core, columns.excess_dn, 0.0).sum(axis=0) / np.maximum(
        beyond_core.sum(axis=0), 1
    )
    # Column signal below 1/30 of the source's is harmless.
    within_streak &= columns.round_dn < 30.0 * ndimage.maximum_filter1d(level, 3, mode="constant")
    mask[:, columns.first_col : columns.first_col + within_streak.shape[1]] = within_streak
    return mask


def compare_columns(
    spot: PointStack, context: Context, *, half_width_px: int | None = None
) -> ColumnArtefacts:
    """Compare the columns near the source with pixels at the same distance left and right.

    `half_width_px`: columns on either side of the source; None: those that may overflow or smear.
    """
    rows, cols = spot.image.shape
    polar = polar_of((rows, cols), spot.row, spot.col, context.pitch_ratio)
    dx, dy, radius = polar.dx[0], polar.dy[:, 0], polar.radius
    half = _half_width(spot) if half_width_px is None else half_width_px
    first, last = max(0, round(spot.col) - half), min(cols, round(spot.col) + half + 1)
    mean, sd = _horizontal_profile(spot.image, dx, dy, radius)
    column_radius = radius[:, first:last]
    grid = np.arange(len(mean), dtype=float)
    light, noise = np.interp(column_radius, grid, mean), np.interp(column_radius, grid, sd)
    floor = float(mean.min())
    # Noise correlated over an area is correlated along a line by its square root.
    # Cameras may deviate from rotational symmetry by 5 % of the source's signal.
    return ColumnArtefacts(
        first_col=first,
        row_offset=dy,
        round_dn=light - floor,
        excess_dn=spot.image[:, first:last] - light,
        sd_dn=np.hypot(noise, 0.05 * (light - floor)),
        block_factor=float(min(spot.noise.correlation_factor**0.5, BLOCK_ROWS)),
    )


def _half_width(spot: PointStack) -> int:
    """Columns on either side that may overflow or smear: those bright in the source's rows, with a
    margin.
    """
    row, col = round(spot.row), round(spot.col)
    source_rows_mean = spot.image[max(0, row - 1) : row + 2].mean(axis=0)
    bright = source_rows_mean - spot.dark_dn > 0.5 * min(
        source_rows_mean.max() - spot.dark_dn, 0.5 * (spot.full_scale_dn - spot.dark_dn)
    )
    run = np.flatnonzero(run_through(bright, col))
    bright_half_px = int(np.abs(run - col).max()) if len(run) else 0
    # Video filter or smear carry the signal into at least 5 columns, 3 beyond the bright ones.
    return max(5, bright_half_px + 3)


def _horizontal_profile(image: Array, dx: Array, dy: Array, radius: Array) -> tuple[Array, Array]:
    """Mean and scatter of pixels by distance left and right of the source; the fainter side where
    they differ.

    Only pixels closer in rows than in columns count, outside the columns of the source.
    """
    lateral = np.abs(dx)[None, :] > np.abs(dy)[:, None]
    rings = int(radius.max()) + 2
    mean, sd, count = np.zeros((3, 2, rings))
    for side, sign in enumerate((-1, 1)):
        take = lateral & (np.sign(dx) == sign)[None, :]
        ring, value = np.rint(radius[take]).astype(int), image[take]
        count[side] = np.bincount(ring, minlength=rings)
        mean[side] = np.bincount(ring, value, minlength=rings) / np.maximum(count[side], 1)
        square = np.bincount(ring, (value - mean[side][ring]) ** 2, minlength=rings)
        sd[side] = np.sqrt(square / np.maximum(count[side] - 1, 1))
    full = count >= 4
    error = np.sqrt((sd**2 / np.maximum(count, 1)).sum(axis=0))
    differ = np.abs(mean[0] - mean[1]) > 6.0 * np.maximum(error, 1e-9)
    sides_mean = np.where(
        differ, mean.min(axis=0), (mean * count).sum(axis=0) / np.maximum(count.sum(axis=0), 1)
    )
    light = np.where(full.all(axis=0), sides_mean, np.where(full[0], mean[0], mean[1]))
    scatter = np.where(full.all(axis=0), sd.max(axis=0), np.where(full[0], sd[0], sd[1]))
    grid, known = np.arange(rings), np.flatnonzero(full.any(axis=0))
    least_sd = max(0.5 * float(np.median(scatter[known])) if len(known) else 0.5, ROUNDED_DN)
    return np.interp(grid, known, light[known]), np.maximum(
        np.interp(grid, known, scatter[known]), least_sd
    )


def _reach(columns: ColumnArtefacts, side: int) -> tuple[Array, Array]:
    """Distance over which each column stays brighter than its surroundings on one side, px, and its
    significance.

    The significance is that of the mean over the outer half of its rows; NaN with too few rows.
    """
    rows = np.flatnonzero(columns.row_offset * side >= FIRST_ROW_PX)[::side]
    count = len(rows) // BLOCK_ROWS
    out = np.zeros(columns.excess_dn.shape[1])
    if count < 4:
        return out, np.full(out.shape, np.nan)
    rows = rows[: count * BLOCK_ROWS]
    blocks = rows.reshape(count, BLOCK_ROWS)
    excess, variance = (
        columns.excess_dn[blocks].mean(axis=1),
        (columns.sd_dn[blocks] ** 2).mean(axis=1),
    )
    error = np.sqrt(variance * columns.block_factor / BLOCK_ROWS)
    # A streak fills all its rows; a single pulse among dark pixels does not.
    filled = np.partition(columns.excess_dn[blocks], 1, axis=1)[:, 1] > 1.5 * np.sqrt(variance)
    ends = np.abs(columns.row_offset)[blocks].max(axis=1)
    for col in range(out.size):
        bright = np.flatnonzero((excess[:, col] > 5.0 * error[:, col]) & filled[:, col])
        out[col] = ends[bright[-1]] + BLOCK_ROWS if len(bright) else 0.0
    outer = slice(count // 2, None)
    noise = np.sqrt(
        np.maximum((error[outer] ** 2).mean(axis=0), excess[outer].var(axis=0))
        / (count - count // 2)
    )
    return out, excess[outer].mean(axis=0) / noise


def run_through(bright: Mask, position: int) -> Mask:
    """The run of true values through a position, which may be off by one."""
    from scipy import ndimage

    labels = np.asarray(ndimage.label(bright)[0])  # pyright: ignore[reportIndexIssue]
    candidates = [
        index
        for index in (position, position - 1, position + 1)
        if 0 <= index < len(bright) and bright[index]
    ]
    return labels == labels[candidates[0]] if candidates else np.zeros(bright.shape, bool)


LEAST_ROWS = 3
# A uniform column above this fraction of full scale is a streak of full wells, not smear.
FULL_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class Streak:
    """Streak of one source.

    `length_px`, `length_sd_px`: rows of the source's column at or above half of full scale, core
    included, and their standard error; 0 without any; `overflows`: whether wells overflow: the
    column is far brighter than the same distance left and right of the source; `level_dn`,
    `level_sd_dn`: signal above dark of full wells, DN; NaN without overflow; `clipped`: whether
    that signal is at full scale, a lower limit of the full well; `meets_border`, `uneven`: whether
    the streak ends at the frame's border; whether it is longer on one side, unlike overflow.
    """

    length_px: float
    length_sd_px: float
    overflows: bool
    level_dn: float
    level_sd_dn: float
    clipped: bool
    meets_border: bool
    uneven: bool


def streak_of(spot: PointStack, context: Context) -> Streak:
    """Measure the column of a source.

    Charge beyond the full well spreads up and down until every well contains its part: the column
    is full to sharp ends, with partly filled last pixels. Rows count by the probability that their
    mean is above the threshold. In interlaced frames the two fields overflow separately, so that
    every second row counts near the ends.
    """
    columns = compare_columns(spot, context)
    noise = spot.noise
    length, sd = _rows_above(spot, noise, round(spot.col))
    other = round(spot.col) + (1 if spot.col > round(spot.col) else -1)
    # Near the middle between two columns either may be the source's.
    if 0.5 - abs(spot.col - round(spot.col)) < 0.15 and 0 <= other < spot.image.shape[1]:
        sd = float(np.hypot(sd, 0.5 * abs(length - _rows_above(spot, noise, other)[0])))
    rows_above, rows_below = (_full_rows(spot, columns, side) for side in (-1, 1))
    full = np.concatenate([rows_above, rows_below])
    rows = spot.image.shape[0]
    meets = bool(len(full)) and bool(full.min() == 0 or full.max() == rows - 1)
    level = spot.image[full, round(spot.col)] - spot.dark_dn if len(full) else np.full(1, np.nan)
    value = float(np.median(level))
    spread = robust_sd(level)
    error = 1.25 * max(spread, 1.0 / np.sqrt(12.0 * spot.frames)) / np.sqrt(len(level))
    ends = [
        float(np.abs(columns.row_offset[side]).max()) if len(side) else 0.0
        for side in (rows_above, rows_below)
    ]
    return Streak(
        length_px=length,
        length_sd_px=sd,
        overflows=len(full) >= LEAST_ROWS,
        level_dn=value,
        level_sd_dn=error,
        clipped=len(full) > 0
        and value > spot.full_scale_dn - spot.dark_dn - max(1.0, 4.0 * spread),
        meets_border=meets,
        uneven=not meets and abs(ends[0] - ends[1]) > 4.0 + 0.2 * max(ends),
    )


def _rows_above(spot: PointStack, noise: NoiseLaw, col: int) -> tuple[float, float]:
    """Number of rows of a column with a mean at or above half of full scale, and its standard
    error.
    """
    from scipy.special import ndtr

    half = 0.5 * (spot.full_scale_dn - spot.dark_dn)
    above_probability = ndtr((spot.image[:, col] - spot.dark_dn - half) / noise.sd(half))
    rows = float(above_probability.sum())
    counted = (
        float((above_probability * (1.0 - above_probability)).sum()) * noise.correlation_factor
    )
    # The column's total signal determines the streak's length and its scatter.
    spilled = noise.sum_variance(half * rows) / (2.0 * half) ** 2 if rows > 12 else 0.0
    frames = spot.frame_streak_px
    frame_variance = float(frames.var(ddof=1)) / len(frames) if len(frames) > 1 else 0.0
    return rows, float(
        np.sqrt(max(counted, spilled, frame_variance) + (2.0 / np.sqrt(12.0) / np.sqrt(2.0)) ** 2)
    )


def _full_rows(spot: PointStack, columns: ColumnArtefacts, side: int) -> NDArray[np.int64]:
    """Rows above (-1) or below (1) the source with full wells; partly filled ends excluded."""
    outward = np.flatnonzero(columns.row_offset * side >= FIRST_ROW_PX)[::side]
    col = int(np.clip(round(spot.col) - columns.first_col, 0, columns.sd_dn.shape[1] - 1))
    excess, light = columns.excess_dn[outward, col], columns.round_dn[outward, col]
    if len(outward) < LEAST_ROWS + 1:
        return outward[:0]
    top = float(np.sort(excess)[-2])
    if top < 0.2 * (spot.full_scale_dn - spot.dark_dn):
        return outward[:0]
    # Smear is uniform along the column: the last rows are no streak, unless they are bright enough
    # for full wells.
    column_level = float(np.median(excess[-max(4, len(excess) // 8) :]))
    if column_level > 0.5 * top and column_level < FULL_SHARE * (spot.full_scale_dn - spot.dark_dn):
        return outward[:0]
    floor = column_level if column_level <= 0.5 * top else 0.0
    bright = (excess - floor > 0.8 * (top - floor)) & (light < 0.15 * top)
    return outward[bright]


def streak_measurements(spot: PointStack, context: Context, **fields: Any) -> list[Measurement]:
    """Return length and signal of one stack's streak.

    The length is defined with or without overflow, as a chord of the bloom. The level is refused
    without overflow.
    """
    half, common = spot.half_dn, {"stack": spot.label, **fields}
    if reason := spot.why_undetected:
        names = (("streak_length", "px"), ("streak_level", "DN"))
        return [make_refusal(name, unit, reason, **common) for name, unit in names]
    streak = streak_of(spot, context)
    findings = []
    if streak.meets_border or (spot.half is not None and spot.half.touches_border):
        findings.append(finding("window-too-small"))
    if streak.uneven:
        findings.append(
            finding("several-targets", "the streak is longer on one side, unlike overflow")
        )
    if streak.length_px < 0.5:
        reason = f"the source stays below half of full scale, {half:.4g} DN"
        length = make_refusal("streak_length", "px", reason, refusal="not-applicable", **common)
    else:
        sd = streak.length_sd_px
        if not spot.dark_known:
            # Additional rows if the black level is 0 instead of the frame's median.
            column = spot.image[:, int(np.clip(round(spot.col), 0, spot.image.shape[1] - 1))]
            lower = float((column >= 0.5 * spot.full_scale_dn).sum()) - spot.streak_px
            sd = float(np.hypot(sd, lower / 1.96))
        number = measurement_from_sd("streak_length", "px", streak.length_px, sd, **common)
        length = judge(number, findings)
    reason = ""
    if not streak.overflows:
        reason = (
            "no wells overflow: the column is no brighter than the same distance left and right"
        )
    elif streak.clipped and streak.meets_border:
        reason = (
            "the column is at full scale up to the frame's border: a streak and smear look "
            "alike there"
        )
    elif streak.clipped:
        findings.append(finding("clipped"))
    if reason:
        kind = "failed" if streak.overflows else "not-applicable"
        return [length, make_refusal("streak_level", "DN", reason, refusal=kind, **common)]
    level = measurement_from_sd("streak_level", "DN", streak.level_dn, streak.level_sd_dn, **common)
    return [length, judge(level, findings)]
