"""From frames to an edge ready to be measured: its place, its rows, its profile, motion, roughness
and noise.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.pixels.bins import bin_pixels
from charact.estimators.mtf.edge.pixels.line import (
    ROW_REACH_PX,
    EdgeLine,
    RowFit,
    field_displacement,
    find,
    is_significant,
    refine,
    steepness,
)
from charact.estimators.mtf.edge.pixels.plateau_noise import (
    NoiseGrowth,
    SlopeVariance,
    noise_growth,
    noise_on_slopes,
    plateau_noise,
)
from charact.estimators.mtf.edge.pixels.profile import (
    EdgeProfile,
    centre_line,
    profile_of,
)
from charact.estimators.mtf.edge.pixels.rim import Rim, find_rim
from charact.estimators.mtf.edge.pixels.roughness import measure_roughness
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.mean_frame import OrientedFrame, Region
from charact.estimators.mtf.target_motion import TargetMotion, measure_line_motion
from charact.frames.robust import median, robust_sd
from charact.frames.stack import Stack
from charact.method import Context
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
    where
        ROW, COL, HEIGHT, WIDTH of the edge and its plateaus in the frames of the caller.
    picture
        Mean frame cut to that, the edge upright.
    rows
        Its line and the displacements of single rows.
    profile
        Its profile with its noise.
    flags, notes
        Those of finding it.
    """

    where: Region
    picture: OrientedFrame
    rows: RowFit
    profile: EdgeProfile
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @cached_property
    def target_motion(self) -> TargetMotion:
        """Displacement across the edge from frame to frame."""
        if isinstance(self.rows.line, Rim):
            return TargetMotion()
        across = self.rows.line.across(self.picture.value.shape)
        row = np.broadcast_to(np.arange(len(across))[:, None], across.shape)
        normal = across * np.cos(self.profile.angle_rad)
        return measure_line_motion(
            self.picture.upright_frames, normal, row, np.abs(across) < ROW_REACH_PX
        )

    @cached_property
    def roughness(self) -> TargetMotion:
        """Deviation from a straight line along its length, the same in all frames."""
        if isinstance(self.rows.line, Rim):
            return TargetMotion()
        return measure_roughness(self.picture, self.profile)

    @cached_property
    def expected(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Profile at every pixel, DN and from 0 to 1, and its plateau: 1 dark, 2 bright, else 0."""
        profile, plateau = self.profile, ACCURACY.plateau_fraction
        value = np.zeros(profile.keep.size)
        value[profile.keep] = profile.value
        value = value[profile.gathered.bin_index]
        level = (value - profile.dark) / (profile.step or 1.0)
        sides = np.select([level < plateau, level > 1.0 - plateau], [1, 2])
        return value, level, sides * profile.gathered.valid

    @cached_property
    def slope_noise(self) -> SlopeVariance:
        """Temporal noise of the slopes over that of the plateaus."""
        profile, (_, level, sides) = self.profile, self.expected
        steep = steepness(profile.distance, profile.value, profile.gathered.distance)
        return noise_on_slopes(
            self.picture.upright_frames, level, steep * profile.gathered.valid, sides
        )

    @cached_property
    def noise_growth(self) -> NoiseGrowth:
        """How the noise grows with the light: from frame to frame where there are several that
        differ, or by covariances above a known black level; else by the noise of the mean frame.
        """
        profile, correlation_sum = self.profile, self.profile.correlated_noise.correlation_factor
        if len(self.picture.stack.data) > 1 or profile.black is not None:
            value, _, sides = self.expected
            plateaus = plateau_noise(
                self.picture.upright_frames,
                value,
                sides,
                along=0 if self.picture.transposed else 1,
                correlation_sum=correlation_sum,
            )
            several = len(self.picture.stack.data) > 1
            growth = plateaus and noise_growth(plateaus, profile.black, several=several)
            if growth:
                return growth
        pixels = 0.5 * np.count_nonzero(profile.gathered.valid)
        pixels /= max(correlation_sum, 1.0)
        photons, (dark_variance, bright_variance) = None, profile.side_variances
        if profile.black is not None and profile.dark > profile.black:
            bright_dn = profile.bright - profile.black
            if bright_dn < THRESHOLDS.photon_noise_snr * np.sqrt(bright_variance):
                photons = bright_dn / (profile.dark - profile.black)
        return NoiseGrowth(
            ratio=bright_variance / dark_variance,
            # A variance of n pixels scatters by the root of 2/n, a ratio of two by that of 4/n.
            scatter=float(np.sqrt(4.0 / max(pixels, 1.0))),
            photon_ratio=photons,
        )


def prepare_edge(
    frames: FrameStack,
    region: Region | None,
    context: Context,
    *,
    quickly: bool = False,
    fields_apart: bool = False,
    closed: bool = False,
) -> PreparedEdge | EdgeRefusal:
    """Find the one edge of a region or, where the frame shows more, its most prominent one.

    Parameters
    ----------
    quickly
        As of `charact.estimators.mtf.edge.pixels.profile.profile_of`.
    fields_apart
        Whether the two fields of an interlaced frame are taken each at its own position, where the
        edge moved between them; else that is left to be flagged.
    closed
        Whether the edge may be the rim of a disc.
    """
    stack = Stack.of(frames if region is None else frames.region(*region), context)
    row, col, *_ = region or (0, 0)
    height, width = stack.data.shape[1:]
    where: Region = (row, col, height, width)
    cut = False
    while True:
        if min(height, width) < 8:
            reason = f"an edge needs a region of at least 8 x 8 px, got {height} x {width}"
            return EdgeRefusal(reason=reason, where=where, flag="window-too-small")
        picture, coarse = find(stack)
        rim = find_rim(picture) if closed and not cut else None
        if rim is not None:
            break
        part = (
            edge_extent(picture, coarse) if min(height, width) >= 2 * MIN_ROWS and not cut else None
        )
        if part is None:
            break
        stack, where, cut = (
            stack.region(*part),
            (row + part[0], col + part[1], part[2], part[3]),
            True,
        )
        height, width = part[2:]
    if rim is not None:
        profile = profile_of(picture, rim, WIDEST_PX, quickly=quickly)
        apart = np.full(picture.value.shape[0], np.nan)
        note = (
            f"The edge is a closed curve of {rim.radii[0]:.1f} px mean radius: the MTF is that of "
            "all directions."
        )
        rows = RowFit(line=rim, offset=apart, offset_sd=np.inf)
        return PreparedEdge(where=where, picture=picture, rows=rows, profile=profile, notes=(note,))
    rows = refine(picture, coarse)
    if context.interlaced and fields_apart:
        rows = separate_fields(picture, rows)
    # A line found in noise may run outside: it must leave pixels on both sides.
    no_step = EdgeRefusal(
        reason="no target: no step from dark to bright was found in the region", where=where
    )
    distance, band_px = rows.line.across(picture.value.shape), 2 * THRESHOLDS.min_half_width_px
    sides = (np.count_nonzero((side > 0) & (side < band_px)) for side in (distance, -distance))
    if min(sides) < THRESHOLDS.min_side_pixels:
        return no_step
    edge = centre_line(picture, rows.line)
    profile = profile_of(picture, edge, WIDEST_PX, quickly=quickly)
    if not profile.step > 0 or profile.gathered.half_width_px < THRESHOLDS.min_half_width_px:
        return no_step
    notes, black = [], stack.frames.black_level_dn
    if cut:
        notes.append("The frame shows more than this edge; the region is the part that was used.")
    if edge.fields is not None:
        displacement_px = abs(edge.fields_apart_px)
        notes.append(
            f"The edge lies {displacement_px:.2f} px apart in the two fields; each is taken at its "
            "own place."
        )
    if profile.black is not None:
        notes.append(f"Black level {profile.black:.4g} DN.")
    elif black is not None:
        notes.append(
            f"The black level of {black:.4g} DN is above the edge's dark side at "
            f"{profile.dark:.4g} DN: it is not used."
        )
    return PreparedEdge(
        where=where,
        picture=picture,
        rows=replace(rows, line=edge),
        profile=profile,
        flags=("several-targets",) if cut and region is not None else (),
        notes=tuple(notes),
    )


def separate_fields(picture: OrientedFrame, rows: RowFit) -> RowFit:
    """Return an edge whose two fields are taken each at its own position, where they are
    displaced.
    """

    def displacement() -> tuple[float, float]:
        # Distances grow along the picture's columns, so that an edge displaced by d stands at a
        # distance of -d.
        gathered = bin_pixels(picture, rows.line, ACCURACY.field_band_px)
        mean, count = gathered.means(picture.value)
        profile = gathered.mean_distance[count > 0], mean[count > 0]
        across_px, error = field_displacement(
            picture, rows, gathered.valid, gathered.distance, profile
        )
        cosine = (
            float(np.cos(rows.line.angle_rad(picture.pitch_ratio))) if picture.transposed else 1.0
        )
        return across_px / cosine, error

    measured = displacement()
    if not is_significant(measured):
        return rows
    # The profile of displaced fields is at first smeared: repeated.
    for _ in range(5):
        fields_apart_px = rows.line.fields_apart_px + measured[0]
        rows = refine(
            picture,
            replace(rows.line, fields_apart_px=fields_apart_px, fields=picture.row_index % 2),
        )
        measured = displacement()
        if abs(measured[0]) < ACCURACY.field_tolerance_px:
            break
    return rows


def edge_extent(picture: OrientedFrame, line: EdgeLine) -> Region | None:
    """Return ROW, COL, HEIGHT, WIDTH of the original frame that hold one edge and its plateaus;
    None: all of it.

    Rows belong to the edge as long as the step across the line stands there; plateaus end where the
    mean profile of these rows leaves its level by a third of the step.
    """
    rows, cols = picture.value.shape
    across = line.across((rows, cols))
    # The step of each block of rows, NaN where a side lies outside the frame, and the noise of one.
    size = max(4, rows // 64)
    count, near_px, far_px = rows // size, ACCURACY.step_near_px, ACCURACY.step_far_px
    sides = []
    for on_side in (
        (across > near_px) & (across < far_px),
        (across < -near_px) & (across > -far_px),
    ):
        parts = on_side.sum(axis=1).astype(float), np.where(on_side, picture.value, 0.0).sum(axis=1)
        number, total = (
            per_row[: count * size].reshape(count, size).sum(axis=1) for per_row in parts
        )
        sides.append(
            np.where(
                number >= size * (far_px - near_px - 2.0), total / np.maximum(number, 1.0), np.nan
            )
        )
    step = sides[0] - sides[1]
    finite = step[np.isfinite(step)]
    error = robust_sd(np.diff(finite), 0.0) / np.sqrt(2.0) if finite.size > 3 else 0.0
    reference = (
        median(finite[finite > 0.5 * finite.max()]) if finite.size and finite.max() > 0 else 0.0
    )
    if not reference > 0:
        return None
    # The longest run of blocks that hold the edge, single gaps closed.
    has_step = np.isfinite(step) & ~(step < 0.5 * reference - 3.0 * error)
    has_step[1:-1] |= has_step[:-2] & has_step[2:]
    borders = np.flatnonzero(np.diff(np.concatenate([[0], has_step.astype(int), [0]])))
    if not borders.size:
        return None
    best = 2 * int(np.argmax(borders[1::2] - borders[::2]))
    first, last = int(borders[best]), int(borders[best + 1])
    if (last - first) * size < MIN_ROWS:
        return None
    inset = 2 * size + 4
    all_rows = last - first >= len(step) - 1
    top, bottom = (0, rows) if all_rows else (first * size + inset, min(last * size, rows) - inset)
    if bottom - top < MIN_ROWS:
        return None
    dark_px, bright_px = (
        _plateau_reach(picture.value[top:bottom], across[top:bottom], s, reference, error)
        for s in (-1, 1)
    )
    middle = line.position + line.slope * (np.array([top, bottom - 1]) - (rows - 1) / 2)
    low = int(np.floor(max(middle.min() - dark_px, 0.0)))
    high = int(np.ceil(min(middle.max() + bright_px + 1.0, float(cols))))
    if (top, bottom, low, high) == (0, rows, 0, cols):
        return None
    col = cols - high if picture.mirrored else low
    return (
        (col, top, high - low, bottom - top)
        if picture.transposed
        else (top, col, bottom - top, high - low)
    )


def _plateau_reach(value: Array, across: Array, sign: int, step: float, error: float) -> float:
    """Return how far a plateau reaches, px; infinite where nothing interrupts it."""
    cell = np.floor(across / 2.0).astype(np.int64)
    low = int(cell.min())
    count = np.bincount((cell - low).ravel())
    mean = np.bincount((cell - low).ravel(), weights=value.ravel()) / np.maximum(count, 1)
    cells = np.arange(3, 400) * sign - (1 if sign < 0 else 0) - low
    cells = cells[(cells >= 0) & (cells < mean.size)]
    cells = cells[(count > 0.3 * median(count))[cells]]
    if cells.size < 6:
        return np.inf
    # The level varies with the light: each is compared with the median of itself and up to twelve
    # before it.
    levels, back = mean[cells], 12
    padded = np.concatenate([np.full(back, np.inf), levels])
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, back + 1))
    index = np.arange(levels.size)
    known = np.minimum(index + 1, back + 1)
    before = 0.5 * (windows[index, (known - 1) // 2] + windows[index, known // 2])
    departs = np.abs(levels - before) > 0.3 * step + 3.0 * error
    return 2.0 * (3 + int(np.argmax(departs)) - 4) if departs.any() else np.inf


def fit_refusal(
    edge: PreparedEdge, chi2: float, chi2_without: float, free: int, half_frequency_cy_per_px: float
) -> EdgeRefusal | None:
    """Return why the best step in a region is no edge that it can show, if so.

    Where even the best step does not describe the profile, noise is larger than estimated; where it
    leaves more than a fifth unexplained besides, what varies across the region is something else.
    """
    misfit, half_width = max(chi2 / free, 1.0), edge.profile.gathered.half_width_px
    sd, unexplained = np.sqrt(max((chi2_without - chi2) / misfit, 0.0)), chi2 / chi2_without
    if sd**2 < THRESHOLDS.min_edge_chi2:
        reason = (
            f"the best step in the region stands {sd:.1f} standard errors out of the noise, "
            f"fewer than 9.5"
        )
    elif misfit > THRESHOLDS.no_edge_reduced_chi2 and unexplained > THRESHOLDS.no_edge_fraction:
        reason = (
            f"the best step in the region leaves {100 * unexplained:.0f} % of what varies across "
            f"it unexplained"
        )
    elif half_width < 0.6 / half_frequency_cy_per_px:
        reason = f"the blur is wider than the region, which ends {half_width:.0f} px from it"
    else:
        return None
    return EdgeRefusal(reason=f"no target: {reason}", where=edge.where)
