"""From frames to an edge ready to be fitted: where it is, how its rows lie, and its profile."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.edge.pixels import line
from charact.mtf.edge.pixels.fields import separate_fields, steepness
from charact.mtf.edge.pixels.line import EdgeLine
from charact.mtf.edge.pixels.profile import EdgeProfile, centre_line, profile_of
from charact.mtf.edge.pixels.roughness import roughness_of
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.mean_frame import OrientedFrame, Region, mean_oriented_frame
from charact.mtf.plateau_noise import Sides, SlopeNoise, noise_on_slopes, plateau_noise
from charact.mtf.target_motion import TargetMotion, measure_line_motion
from charact.robust import NORMAL, median
from labdata.frames import FrameStack

Array = NDArray[np.float64]

MIN_ROWS = 12


def edge_extent(picture: OrientedFrame, line: EdgeLine) -> Region | None:
    """Return ROW, COL, HEIGHT, WIDTH of the original frame that hold one edge and its plateaus; None: all of it.

    Rows belong to the edge as long as the step across the line stands there; plateaus end where the mean profile of
    these rows leaves its level by a third of the step.
    """
    rows, cols = picture.value.shape
    across = line.across((rows, cols))
    size = max(4, rows // 64)
    step, error = _steps(picture.value, across, size)
    reference = _reference(step)
    if not reference > 0:
        return None
    missing = ~np.isfinite(step) | (step < 0.5 * reference - 3.0 * error)
    first, last = _longest_run(~missing)
    if (last - first) * size < MIN_ROWS:
        return None
    whole_rows = last - first >= len(step) - 1
    inset = 2 * size + 4
    top, bottom = (0, rows) if whole_rows else (first * size + inset, min(last * size, rows) - inset)
    if bottom - top < MIN_ROWS:
        return None
    left, right = _plateaus(picture.value[top:bottom], across[top:bottom], reference, error)
    middle = line.position + line.slope * (np.array([top, bottom - 1]) - (rows - 1) / 2)
    low = int(np.floor(max(middle.min() - left, 0.0)))
    high = int(np.ceil(min(middle.max() + right + 1.0, float(cols))))
    if (top, bottom, low, high) == (0, rows, 0, cols):
        return None
    return original_region(picture, (top, low, bottom - top, high - low))


def _reference(step: Array) -> float:
    """Return the usual step of the blocks that hold the edge; 0 where no block brightens."""
    finite = step[np.isfinite(step)]
    if not finite.size or not finite.max() > 0:
        return 0.0
    return median(finite[finite > 0.5 * finite.max()])


def original_region(picture: OrientedFrame, region: Region) -> Region:
    """Return a region of an upright picture in its original frame."""
    row, col, height, width = region
    if picture.mirrored:
        col = picture.value.shape[1] - col - width
    return (col, row, width, height) if picture.transposed else (row, col, height, width)


def _steps(value: Array, across: Array, size: int) -> tuple[Array, float]:
    """Return the step of each block of rows and the noise of one, NaN where a side lies outside the frame."""
    count = len(value) // size
    sides = []
    for inside in (
        (across > ACCURACY.step_near_px) & (across < ACCURACY.step_far_px),
        (across < -ACCURACY.step_near_px) & (across > -ACCURACY.step_far_px),
    ):
        number = inside.sum(axis=1).astype(float)
        total = np.where(inside, value, 0.0).sum(axis=1)
        blocks = number[: count * size].reshape(count, size).sum(axis=1)
        means = total[: count * size].reshape(count, size).sum(axis=1) / np.maximum(blocks, 1.0)
        sides.append(np.where(blocks >= size * (ACCURACY.step_far_px - ACCURACY.step_near_px - 2.0), means, np.nan))
    step = sides[0] - sides[1]
    finite = step[np.isfinite(step)]
    error = NORMAL * median(np.abs(np.diff(finite))) / np.sqrt(2.0) if finite.size > 3 else 0.0
    return step, error


def _longest_run(good: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first and one past the last index of the longest run, single gaps closed."""
    closed = good.copy()
    closed[1:-1] |= good[:-2] & good[2:]
    borders = np.flatnonzero(np.diff(np.concatenate([[0], closed.astype(int), [0]])))
    starts, ends = borders[::2], borders[1::2]
    if not starts.size:
        return 0, 0
    best = int(np.argmax(ends - starts))
    return int(starts[best]), int(ends[best])


def _plateaus(value: Array, across: Array, step: float, error: float) -> tuple[float, float]:
    """Return how far both plateaus reach, px; infinite where nothing interrupts them."""
    cell = np.floor(across / 2.0).astype(np.int64)
    low = int(cell.min())
    count = np.bincount((cell - low).ravel())
    mean = np.bincount((cell - low).ravel(), weights=value.ravel()) / np.maximum(count, 1)
    enough = count > 0.3 * median(count)
    reach = []
    for sign in (-1, 1):
        places = np.arange(3, 400) * sign - (1 if sign < 0 else 0) - low
        places = places[(places >= 0) & (places < mean.size)]
        places = places[enough[places]]
        if places.size < 6:
            reach.append(np.inf)
            continue
        # The level wanders with the light: it is compared with what it was a little before.
        levels = mean[places]
        before = _running_median(levels, 12)
        away = np.abs(levels - before) > 0.3 * step + 3.0 * error
        reach.append(2.0 * (3 + int(np.argmax(away)) - 4) if away.any() else np.inf)
    return reach[0], reach[1]


def _running_median(values: Array, back: int) -> Array:
    """Return the median of each value and of up to so many before it."""
    windows = np.sort(
        np.lib.stride_tricks.sliding_window_view(np.concatenate([np.full(back, np.inf), values]), back + 1)
    )
    count = np.minimum(np.arange(values.size) + 1, back + 1)
    each = np.arange(values.size)
    return 0.5 * (windows[each, (count - 1) // 2] + windows[each, count // 2])


WIDEST_PX = 110.0
NO_STEP = "no target: no step from dark to bright was found in the region"


@dataclass(frozen=True, kw_only=True)
class PreparedEdge:
    """An edge found in frames.

    Parameters
    ----------
    used
        The frames cut to the edge and its plateaus.
    where
        ROW, COL, HEIGHT, WIDTH of that in the frames given.
    picture
        Mean frame, the edge upright.
    rows
        Its line and how single rows depart from it.
    profile
        Its profile with the noise that is in it.
    flags, notes
        What finding it brought up.
    """

    used: FrameStack
    where: Region
    picture: OrientedFrame
    rows: line.RowFit
    profile: EdgeProfile
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @cached_property
    def target_motion(self) -> TargetMotion:
        """How it moves across itself from frame to frame."""
        if len(self.used.data) < 2:
            return TargetMotion()
        edge, picture = self.rows.line, self.picture
        across = edge.across(picture.value.shape)
        row = np.broadcast_to(np.arange(len(across))[:, None], across.shape)
        normal = across * float(np.cos(edge.angle_rad(picture.pitch_ratio)))
        return measure_line_motion(list(self._upright), normal, row, np.abs(across) < line.ROW_REACH_PX)

    @cached_property
    def roughness(self) -> TargetMotion:
        """How it wanders about a straight line along its length, the same in all frames."""
        return roughness_of(self.picture, self.profile)

    @cached_property
    def plateau_noise(self) -> Sides | None:
        """The noise of both its sides; None: a side has few pixels."""
        value, _, sides = self._levels
        tied = self.profile.grain.covariance_over_variance
        return plateau_noise(self._upright, value, sides, along=0 if self.picture.transposed else 1, tied=tied)

    @cached_property
    def slope_noise(self) -> SlopeNoise:
        """How much noisier it is where it rises than its plateaus are."""
        _, level, sides = self._levels
        gathered = self.profile.gathered
        steep = steepness(self.profile.distance, self.profile.value, gathered.distance) * gathered.used
        return noise_on_slopes(self._upright, level, steep, sides)

    def blur_flags(self, matters: Callable[[TargetMotion], bool]) -> Iterator[str]:
        """Yield flags of what blurs or alters its mean frame unseen: `matters` tells from when on motion does."""
        drifts = self.target_motion.moves and matters(self.target_motion)
        if drifts:
            yield "drift"
        if self.roughness.moves and matters(self.roughness):
            yield "curved-edge"
        # An edge that moves far leaves more on its slopes than rows that move in one piece.
        if self.slope_noise.is_smoothed and not drifts:
            yield "processed"

    @cached_property
    def _upright(self) -> NDArray[np.float64]:
        return np.stack([self.picture.upright(one) for one in self.used.data])

    @cached_property
    def _levels(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """The profile at every pixel, DN and from 0 to 1, and which side it is on, 0: neither."""
        profile = self.profile
        value = np.zeros(profile.keep.size)
        value[profile.keep] = profile.value
        value = value[profile.gathered.bin_index]
        level = (value - profile.dark) / (profile.step or 1.0)
        sides = (
            np.where(level < ACCURACY.plateau_fraction, 1, np.where(level > 1.0 - ACCURACY.plateau_fraction, 2, 0))
            * profile.gathered.used
        )
        return value, level, sides


@dataclass(frozen=True, kw_only=True)
class EdgeRefusal:
    """Why there is no edge to be fitted."""

    reason: str
    where: Region


def prepare_edge(
    stack: FrameStack, region: Region | None, context: Context, *, quickly: bool = False, fields_apart: bool = False
) -> PreparedEdge | EdgeRefusal:
    """Find the one edge of a region or, where the frame shows more, its most prominent one.

    Parameters
    ----------
    quickly
        As of `charact.mtf.edge.pixels.profile.profile_of`.
    fields_apart
        Whether the two fields of an interlaced frame are taken each at its own place, where the edge moved between
        them; else that is left to be flagged.
    """
    used = stack if region is None else stack.region(*region)
    row, col, height, width = region or (0, 0, *used.shape[1:])
    where: Region = (row, col, height, width)
    if min(height, width) < 8:
        return EdgeRefusal(reason=f"an edge needs a region of at least 8 x 8 px, got {height} x {width}", where=where)
    picture, coarse = line.find(mean_oriented_frame(used, context.pitch_ratio, interlaced=bool(context.interlaced)))
    part = edge_extent(picture, coarse) if min(height, width) >= 2 * MIN_ROWS else None
    if part is not None:
        used, where = used.region(*part), (row + part[0], col + part[1], part[2], part[3])
        if min(part[2:]) < 8:
            return EdgeRefusal(
                reason=f"an edge needs a region of at least 8 x 8 px, got {part[2]} x {part[3]}", where=where
            )
        picture, coarse = line.find(mean_oriented_frame(used, context.pitch_ratio, interlaced=bool(context.interlaced)))
    rows = line.refine(picture, coarse)
    if context.interlaced and fields_apart:
        rows = separate_fields(picture, rows)
    if not _has_both_sides(picture, rows.line):
        return EdgeRefusal(reason=NO_STEP, where=where)
    rows = replace(rows, line=centre_line(picture, rows.line))
    profile = profile_of(picture, rows.line, WIDEST_PX, quickly=quickly)
    if not profile.step > 0 or profile.gathered.half_width_px < THRESHOLDS.min_half_width_px:
        return EdgeRefusal(reason=NO_STEP, where=where)
    return PreparedEdge(
        used=used,
        where=where,
        picture=picture,
        rows=rows,
        profile=profile,
        flags=("several-targets",) if part is not None and region is not None else (),
        notes=_notes(used, profile, rows.line, cut=part is not None),
    )


def _notes(used: FrameStack, profile: EdgeProfile, edge: line.EdgeLine, *, cut: bool) -> tuple[str, ...]:
    """Return what finding an edge brought up that lowers no trust."""
    notes = ["The frame shows more than this edge; the region is the part that was used."] if cut else []
    if edge.fields is not None:
        notes.append(
            f"The edge lies {abs(edge.fields_apart_px):.2f} px apart in the two fields; each is taken at its own place."
        )
    if profile.black is not None:
        notes.append(f"No light is at {profile.black:.4g} DN.")
    elif used.black_level_dn is not None:
        notes.append(
            f"No light would be at {used.black_level_dn:.4g} DN, above the edge's dark side at {profile.dark:.4g} DN: "
            "taken as not known."
        )
    return tuple(notes)


def _has_both_sides(picture: OrientedFrame, edge: line.EdgeLine) -> bool:
    """Tell whether a line leaves pixels enough on both sides of it: one found in noise may run outside."""
    distance = edge.across(picture.value.shape)
    sides = (np.count_nonzero((side > 0) & (side < 2 * THRESHOLDS.min_half_width_px)) for side in (distance, -distance))
    return bool(min(sides) >= THRESHOLDS.min_side_pixels)


def edge_refusal(chi2: float, chi2_without: float, free: int) -> str | None:
    """Return why the best step in a region is none, if so.

    Where even it does not describe the profile, noise is larger than was thought; where it leaves more than a fifth
    unexplained besides, what varies across the region is something else.
    """
    misfit = max(chi2 / free, 1.0)
    sd = np.sqrt(max((chi2_without - chi2) / misfit, 0.0))
    if sd**2 < THRESHOLDS.min_edge_chi2:
        return (
            f"no target: the best step in the region stands {sd:.1f} standard errors out of the noise, fewer than 9.5"
        )
    left = chi2 / chi2_without
    if misfit > THRESHOLDS.no_edge_reduced_chi2 and left > THRESHOLDS.no_edge_fraction:
        return f"no target: the best step in the region leaves {100 * left:.0f} % of what varies across it unexplained"
    return None


def blur_refusal(profile: EdgeProfile, half_frequency_cy_per_px: float) -> str | None:
    """Return why a blur is too wide for the region, if so."""
    half_width = profile.gathered.half_width_px
    if half_width < 0.6 / half_frequency_cy_per_px:
        return f"no target: the blur is wider than the region, which ends {half_width:.0f} px from it"
    return None
