"""From frames to an edge ready to be fitted: where it is, how its rows lie, and its profile."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.edge.pixels import line
from charact.mtf.edge.pixels.line import EdgeLine, RowFit, steepness
from charact.mtf.edge.pixels.profile import EdgeProfile, bin_pixels, centre_line, profile_of
from charact.mtf.edge.pixels.roughness import roughness_of
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.mean_frame import OrientedFrame, Region, mean_oriented_frame
from charact.mtf.plateau_noise import Sides, SlopeNoise, noise_on_slopes, plateau_noise
from charact.mtf.target_motion import TargetMotion, measure_line_motion
from charact.robust import NORMAL, median
from labdata.frames import FrameStack

Array = NDArray[np.float64]

MIN_ROWS = 12
# Half width of the band along an edge, px.
WIDEST_PX = 110.0


@dataclass(frozen=True, kw_only=True)
class EdgeRefusal:
    """Why no edge can be measured: the reason, the region, and the flag that says so."""

    reason: str
    where: Region
    flag: str = "no-target"


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
        Its line and the displacements of single rows.
    profile
        Its profile with its noise.
    flags, notes
        Those of finding it.
    """

    used: FrameStack
    where: Region
    picture: OrientedFrame
    rows: RowFit
    profile: EdgeProfile
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @cached_property
    def target_motion(self) -> TargetMotion:
        """Displacement across the edge from frame to frame."""
        if len(self.used.data) < 2:
            return TargetMotion()
        edge, picture = self.rows.line, self.picture
        across = edge.across(picture.value.shape)
        row = np.broadcast_to(np.arange(len(across))[:, None], across.shape)
        normal = across * float(np.cos(edge.angle_rad(picture.pitch_ratio)))
        return measure_line_motion(list(self._upright), normal, row, np.abs(across) < line.ROW_REACH_PX)

    @cached_property
    def roughness(self) -> TargetMotion:
        """Deviation from a straight line along its length, the same in all frames."""
        return roughness_of(self.picture, self.profile)

    @cached_property
    def plateau_noise(self) -> Sides | None:
        """The noise of both its sides; None: a side has few pixels."""
        value, _, sides = self._levels
        tied = self.profile.grain.covariance_over_variance
        return plateau_noise(self._upright, value, sides, along=0 if self.picture.transposed else 1, tied=tied)

    @cached_property
    def slope_noise(self) -> SlopeNoise:
        """Noise where it rises over that of its plateaus."""
        _, level, sides = self._levels
        gathered = self.profile.gathered
        steep = steepness(self.profile.distance, self.profile.value, gathered.distance) * gathered.used
        return noise_on_slopes(self._upright, level, steep, sides)

    def blur_flags(self, matters: Callable[[TargetMotion], bool]) -> Iterator[str]:
        """Yield flags of what blurs or alters its mean frame: `matters` tells whether motion is large enough."""
        drifts = self.target_motion.moves and matters(self.target_motion)
        if drifts:
            yield "drift"
        if self.roughness.moves and matters(self.roughness):
            yield "curved-edge"
        # An edge that moves far leaves more on its slopes than rows that move in one piece.
        if self.slope_noise.is_smoothed and not drifts:
            yield "processed"

    @cached_property
    def _upright(self) -> Array:
        return np.stack([self.picture.upright(one) for one in self.used.data])

    @cached_property
    def _levels(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """The profile at every pixel, DN and from 0 to 1, and which side it is on, 0: neither."""
        profile = self.profile
        value = np.zeros(profile.keep.size)
        value[profile.keep] = profile.value
        value = value[profile.gathered.bin_index]
        level = (value - profile.dark) / (profile.step or 1.0)
        sides = np.select([level < ACCURACY.plateau_fraction, level > 1.0 - ACCURACY.plateau_fraction], [1, 2])
        return value, level, sides * profile.gathered.used


def prepare_edge(
    stack: FrameStack, region: Region | None, context: Context, *, quickly: bool = False, fields_apart: bool = False
) -> PreparedEdge | EdgeRefusal:
    """Find the one edge of a region or, where the frame shows more, its most prominent one.

    Parameters
    ----------
    quickly
        As of `charact.mtf.edge.pixels.profile.profile_of`.
    fields_apart
        Whether the two fields of an interlaced frame are taken each at its own position, where the edge moved between
        them; else that is left to be flagged.
    """
    used = stack if region is None else stack.region(*region)
    row, col, *_ = region or (0, 0)
    height, width = used.shape[1:]
    where: Region = (row, col, height, width)
    cut = False
    while True:
        if min(height, width) < 8:
            reason = f"an edge needs a region of at least 8 x 8 px, got {height} x {width}"
            return EdgeRefusal(reason=reason, where=where, flag="window-too-small")
        mean = mean_oriented_frame(used, context.pitch_ratio, interlaced=bool(context.interlaced))
        picture, coarse = line.find(mean)
        part = edge_extent(picture, coarse) if min(height, width) >= 2 * MIN_ROWS and not cut else None
        if part is None:
            break
        used, where, cut = used.region(*part), (row + part[0], col + part[1], part[2], part[3]), True
        height, width = part[2:]
    rows = line.refine(picture, coarse)
    if context.interlaced and fields_apart:
        rows = separate_fields(picture, rows)
    # A line found in noise may run outside: it must leave pixels on both sides.
    no_step = EdgeRefusal(reason="no target: no step from dark to bright was found in the region", where=where)
    distance, near = rows.line.across(picture.value.shape), 2 * THRESHOLDS.min_half_width_px
    sides = (np.count_nonzero((side > 0) & (side < near)) for side in (distance, -distance))
    if min(sides) < THRESHOLDS.min_side_pixels:
        return no_step
    rows = replace(rows, line=centre_line(picture, rows.line))
    profile = profile_of(picture, rows.line, WIDEST_PX, quickly=quickly)
    if not profile.step > 0 or profile.gathered.half_width_px < THRESHOLDS.min_half_width_px:
        return no_step
    return PreparedEdge(
        used=used,
        where=where,
        picture=picture,
        rows=rows,
        profile=profile,
        flags=("several-targets",) if cut and region is not None else (),
        notes=tuple(_notes(used, profile, rows.line, cut=cut)),
    )


def _notes(used: FrameStack, profile: EdgeProfile, edge: EdgeLine, *, cut: bool) -> Iterator[str]:
    """Yield notes on finding an edge."""
    if cut:
        yield "The frame shows more than this edge; the region is the part that was used."
    if edge.fields is not None:
        apart = abs(edge.fields_apart_px)
        yield f"The edge lies {apart:.2f} px apart in the two fields; each is taken at its own place."
    if profile.black is not None:
        yield f"No light is at {profile.black:.4g} DN."
    elif used.black_level_dn is not None:
        yield (
            f"No light would be at {used.black_level_dn:.4g} DN, above the edge's dark side at {profile.dark:.4g} DN: "
            "taken as not known."
        )


def separate_fields(picture: OrientedFrame, rows: RowFit) -> RowFit:
    """Return an edge whose two fields are taken each at its own position, where they are displaced."""

    def displacement() -> line.Displacement:
        if not picture.transposed:
            return line.field_displacement_of_rows(picture, rows)
        # Lines run along the edge: by single pixels. Distances grow along the picture's columns, so that an edge
        # displaced by d stands at a distance of -d.
        gathered = bin_pixels(picture, rows.line, ACCURACY.field_band_px)
        mean, count = gathered.means(picture.value)
        place, value = gathered.place[count > 0], mean[count > 0]
        used, distance = gathered.used, gathered.distance[gathered.used]
        residual = picture.value[used] - np.interp(distance, place, value)
        parity, steep = picture.row_index[used] % 2, steepness(place, value, distance)
        found, error = line.field_displacement_of_pixels(parity, residual, steep, float(np.std(residual)))
        return found / float(np.cos(rows.line.angle_rad(picture.pitch_ratio))), error

    moved = displacement()
    if not line.is_significant(moved):
        return rows
    # The profile of displaced fields is at first smeared: repeated.
    for _ in range(5):
        apart = rows.line.fields_apart_px + moved[0]
        rows = line.refine(picture, replace(rows.line, fields_apart_px=apart, fields=picture.row_index % 2))
        moved = displacement()
        if abs(moved[0]) < ACCURACY.field_tolerance_px:
            break
    return rows


def edge_extent(picture: OrientedFrame, line: EdgeLine) -> Region | None:
    """Return ROW, COL, HEIGHT, WIDTH of the original frame that hold one edge and its plateaus; None: all of it.

    Rows belong to the edge as long as the step across the line stands there; plateaus end where the mean profile of
    these rows leaves its level by a third of the step.
    """
    rows, cols = picture.value.shape
    across = line.across((rows, cols))
    size = max(4, rows // 64)
    step, error = _steps(picture.value, across, size)
    finite = step[np.isfinite(step)]
    reference = median(finite[finite > 0.5 * finite.max()]) if finite.size and finite.max() > 0 else 0.0
    if not reference > 0:
        return None
    # The longest run of blocks that hold the edge, single gaps closed.
    held = np.isfinite(step) & ~(step < 0.5 * reference - 3.0 * error)
    held[1:-1] |= held[:-2] & held[2:]
    borders = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
    if not borders.size:
        return None
    best = 2 * int(np.argmax(borders[1::2] - borders[::2]))
    first, last = int(borders[best]), int(borders[best + 1])
    if (last - first) * size < MIN_ROWS:
        return None
    inset = 2 * size + 4
    whole = last - first >= len(step) - 1
    top, bottom = (0, rows) if whole else (first * size + inset, min(last * size, rows) - inset)
    if bottom - top < MIN_ROWS:
        return None
    left, right = (_plateau_reach(picture.value[top:bottom], across[top:bottom], s, reference, error) for s in (-1, 1))
    middle = line.position + line.slope * (np.array([top, bottom - 1]) - (rows - 1) / 2)
    low = int(np.floor(max(middle.min() - left, 0.0)))
    high = int(np.ceil(min(middle.max() + right + 1.0, float(cols))))
    if (top, bottom, low, high) == (0, rows, 0, cols):
        return None
    col = cols - high if picture.mirrored else low
    return (col, top, high - low, bottom - top) if picture.transposed else (top, col, bottom - top, high - low)


def _steps(value: Array, across: Array, size: int) -> tuple[Array, float]:
    """Return the step of each block of rows, NaN where a side lies outside the frame, and the noise of one."""
    count, near, far = len(value) // size, ACCURACY.step_near_px, ACCURACY.step_far_px
    sides = []
    for inside in ((across > near) & (across < far), (across < -near) & (across > -far)):
        parts = inside.sum(axis=1).astype(float), np.where(inside, value, 0.0).sum(axis=1)
        number, total = (one[: count * size].reshape(count, size).sum(axis=1) for one in parts)
        sides.append(np.where(number >= size * (far - near - 2.0), total / np.maximum(number, 1.0), np.nan))
    step = sides[0] - sides[1]
    finite = step[np.isfinite(step)]
    error = NORMAL * median(np.abs(np.diff(finite))) / np.sqrt(2.0) if finite.size > 3 else 0.0
    return step, error


def _plateau_reach(value: Array, across: Array, sign: int, step: float, error: float) -> float:
    """Return how far a plateau reaches, px; infinite where nothing interrupts it."""
    cell = np.floor(across / 2.0).astype(np.int64)
    low = int(cell.min())
    count = np.bincount((cell - low).ravel())
    mean = np.bincount((cell - low).ravel(), weights=value.ravel()) / np.maximum(count, 1)
    places = np.arange(3, 400) * sign - (1 if sign < 0 else 0) - low
    places = places[(places >= 0) & (places < mean.size)]
    places = places[(count > 0.3 * median(count))[places]]
    if places.size < 6:
        return np.inf
    # The level varies with the light: each is compared with the median of itself and up to twelve before it.
    levels, back = mean[places], 12
    padded = np.concatenate([np.full(back, np.inf), levels])
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, back + 1))
    each = np.arange(levels.size)
    known = np.minimum(each + 1, back + 1)
    before = 0.5 * (windows[each, (known - 1) // 2] + windows[each, known // 2])
    away = np.abs(levels - before) > 0.3 * step + 3.0 * error
    return 2.0 * (3 + int(np.argmax(away)) - 4) if away.any() else np.inf


def fit_refusal(
    edge: PreparedEdge, chi2: float, chi2_without: float, free: int, half_frequency_cy_per_px: float
) -> EdgeRefusal | None:
    """Return why the best step in a region is no edge that it can show, if so.

    Where even the best step does not describe the profile, noise is larger than estimated; where it leaves more than a
    fifth unexplained besides, what varies across the region is something else.
    """
    misfit, half_width = max(chi2 / free, 1.0), edge.profile.gathered.half_width_px
    sd, left = np.sqrt(max((chi2_without - chi2) / misfit, 0.0)), chi2 / chi2_without
    if sd**2 < THRESHOLDS.min_edge_chi2:
        reason = f"the best step in the region stands {sd:.1f} standard errors out of the noise, fewer than 9.5"
    elif misfit > THRESHOLDS.no_edge_reduced_chi2 and left > THRESHOLDS.no_edge_fraction:
        reason = f"the best step in the region leaves {100 * left:.0f} % of what varies across it unexplained"
    elif half_width < 0.6 / half_frequency_cy_per_px:
        reason = f"the blur is wider than the region, which ends {half_width:.0f} px from it"
    else:
        return None
    return EdgeRefusal(reason=f"no target: {reason}", where=edge.where)
