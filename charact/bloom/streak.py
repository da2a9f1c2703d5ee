"""The bright column of a source: rows at or above half of full scale, and the level that its overflowing wells hold."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.column_artefacts import FIRST_ROW_PX, ColumnArtefacts, compare_columns
from charact.bloom.mean_frame_noise import MeanFrameNoise, grain_of
from charact.bloom.point_stack import DETECTED, PointStack
from charact.method import Context
from labdata.measurement import Measurement, make_refusal, measurement_from_sd

Array = NDArray[np.float64]

# A column of full wells is at least this share of full scale brighter than what lies beside the source ...
LEAST_SHARE = 0.2
# ... where the source's own light is no more than this share of it.
ROUND_SHARE = 0.15
LEAST_ROWS = 3
# Light even from top to bottom is a streak from this share of full scale on: digitisers see that of full wells.
FULL_SHARE = 0.5
# Longer columns may be streaks, as long as their charge.
SPILL_ROWS = 12
# Counting whole rows: an even error of half a row at either end, whatever the noise.
COUNTING_PX = 2.0 / np.sqrt(12.0) / np.sqrt(2.0)
# Distance from the middle between two columns within which either may be the source's, px.
COLUMN_PX = 0.15
# Rows by which a streak may be longer above than below, and share of its length.
UNEVEN_PX, UNEVEN_SHARE = 4.0, 0.2


@dataclass(frozen=True, kw_only=True)
class Streak:
    """The column of one source.

    Parameters
    ----------
    length_px, length_sd_px
        Rows of the source's column at or above half of full scale, the core counted, and their standard error; 0 where
        none is.
    overflows
        Whether wells overflow: the column is bright far beyond what lies at the same distance beside the source.
    level_dn, level_sd_dn
        Level over dark at which the wells are full, DN; NaN where none overflow.
    clipped
        Whether that level is the highest code, so that the wells hold at least so much.
    meets_border, uneven
        Whether the streak ends at the frame's border; whether it is longer on one side, as no overflow is.
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
    """Read the column of a source.

    Notes
    -----
    Charge beyond the full well goes half up and half down until every well holds it, so that the column is full to
    sharp ends, the last pixels partly filled. Rows count as far as the noise leaves it sure that their mean is above
    the level. In interlaced frames the two fields overflow each by itself: near the ends every second row counts.
    """
    found = compare_columns(spot, context)
    grain = grain_of(spot.image, spot.col, spot.dark_dn)
    length, sd = _rows_above(spot, grain, round(spot.col))
    other = round(spot.col) + (1 if spot.col > round(spot.col) else -1)
    if 0.5 - abs(spot.col - round(spot.col)) < COLUMN_PX and 0 <= other < spot.image.shape[1]:
        sd = float(np.hypot(sd, 0.5 * abs(length - _rows_above(spot, grain, other)[0])))
    above, below = (_full_rows(spot, found, side) for side in (-1, 1))
    full = np.concatenate([above, below])
    rows = spot.image.shape[0]
    meets = bool(len(full)) and bool(full.min() == 0 or full.max() == rows - 1)
    level = spot.image[full, round(spot.col)] - spot.dark_dn if len(full) else np.full(1, np.nan)
    value = float(np.median(level))
    spread = 1.4826 * float(np.median(np.abs(level - value)))
    error = 1.25 * max(spread, 1.0 / np.sqrt(12.0 * spot.frames)) / np.sqrt(len(level))
    ends = [float(np.abs(found.row_offset[side]).max()) if len(side) else 0.0 for side in (above, below)]
    return Streak(
        length_px=length,
        length_sd_px=sd,
        overflows=len(full) >= LEAST_ROWS,
        level_dn=value,
        level_sd_dn=error,
        clipped=len(full) > 0 and value > spot.full_scale_dn - spot.dark_dn - max(1.0, 4.0 * spread),
        meets_border=meets,
        uneven=not meets and abs(ends[0] - ends[1]) > UNEVEN_PX + UNEVEN_SHARE * max(ends),
    )


def _rows_above(spot: PointStack, grain: MeanFrameNoise, col: int) -> tuple[float, float]:
    """Rows of a column whose mean lies at or above half of full scale, and the standard error of their number."""
    from scipy.special import ndtr

    half = 0.5 * (spot.full_scale_dn - spot.dark_dn)
    share = ndtr((spot.image[:, col] - spot.dark_dn - half) / np.sqrt(grain.pixel_variance(half)))
    rows = float(share.sum())
    counted = float((share * (1.0 - share)).sum()) * grain.neighbours
    # All light of the column ends up in the streak, so its length scatters as that light does.
    spilled = float(grain.sum_variance(half * rows)) / (2.0 * half) ** 2 if rows > SPILL_ROWS else 0.0
    frames = spot.frame_streak_px
    seen = float(frames.var(ddof=1)) / len(frames) if len(frames) > 1 else 0.0
    return rows, float(np.sqrt(max(counted, spilled, seen) + COUNTING_PX**2))


def _full_rows(spot: PointStack, found: ColumnArtefacts, side: int) -> NDArray[np.int64]:
    """Rows above (-1) or below (1) the source that overflow fills, partly filled ends left out."""
    outward = np.flatnonzero(found.row_offset * side >= FIRST_ROW_PX)[::side]
    place = int(np.clip(round(spot.col) - found.first_col, 0, found.sd_dn.shape[1] - 1))
    excess, light = found.excess_dn[outward, place], found.round_dn[outward, place]
    if len(outward) < LEAST_ROWS + 1:
        return outward[:0]
    top = float(np.sort(excess)[-2])
    if top < LEAST_SHARE * (spot.full_scale_dn - spot.dark_dn):
        return outward[:0]
    # Smear lies evenly on the whole column: what the last rows hold is no streak, unless it is all there is and so
    # bright that the wells may be full.
    even = float(np.median(excess[-max(4, len(excess) // 8) :]))
    if even > 0.5 * top and even < FULL_SHARE * (spot.full_scale_dn - spot.dark_dn):
        return outward[:0]
    floor = even if even <= 0.5 * top else 0.0
    bright = (excess - floor > 0.8 * (top - floor)) & (light < ROUND_SHARE * top)
    return outward[bright]


def streak_measurements(spot: PointStack, context: Context, **fields: Any) -> list[Measurement]:
    """Return length and level of one stack's streak.

    The length is defined whether wells overflow or not: it is a chord of the bloom then. A level is refused where none
    overflow, for there is nothing that it would be the level of.
    """
    level = spot.dark_dn + 0.5 * (spot.full_scale_dn - spot.dark_dn)
    common = {"stack": spot.label, **fields}
    if spot.significance < DETECTED:
        reason = f"no point source: the brightest spot stands {spot.significance:.1f} standard deviations out, not 8"
        names = (("streak_length", "px"), ("streak_level", "DN"))
        return [make_refusal(name, unit, reason, **common) for name, unit in names]
    streak = streak_of(spot, context)
    flags = ("window-too-small",) if streak.meets_border or spot.touches_border else ()
    flags += ("several-targets",) if streak.uneven else ()
    if streak.length_px < 0.5:
        reason = f"the source stays below half of full scale, {level:.4g} DN"
        length = make_refusal("streak_length", "px", reason, **common)
    else:
        sd = streak.length_sd_px if spot.dark_known else float(np.hypot(streak.length_sd_px, _lower_rows(spot) / 1.96))
        length = measurement_from_sd("streak_length", "px", streak.length_px, sd, flags=flags, **common)
    return [length, _level(streak, flags, **common)]


def _lower_rows(spot: PointStack) -> float:
    """Rows by which a streak is longer where the level without light is 0 and not what most pixels show."""
    column = spot.image[:, int(np.clip(round(spot.col), 0, spot.image.shape[1] - 1))]
    return float((column >= 0.5 * spot.full_scale_dn).sum()) - spot.streak_px


def _level(streak: Streak, flags: tuple[str, ...], **common: Any) -> Measurement:
    if not streak.overflows:
        reason = "no wells overflow: above and below the source it is no brighter than beside it"
        return make_refusal("streak_level", "DN", reason, **common)
    if streak.clipped and streak.meets_border:
        reason = "the column is at the highest code up to the frame's border: a streak and smear look alike there"
        return make_refusal("streak_level", "DN", reason, **common)
    if streak.clipped:
        flags += ("clipped",)
        note = "the wells hold at least so much: the streak is at the highest code"
        common["notes"] = (*common.get("notes", ()), note)
    return measurement_from_sd("streak_level", "DN", streak.level_dn, streak.level_sd_dn, flags=flags, **common)
