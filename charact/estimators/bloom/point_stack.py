"""Position, detection and bloom extents of the point source in a stack."""

from dataclasses import dataclass, field, replace

import numpy as np

from charact.estimators.bloom.extent import Extent, contour_at, extent_at
from charact.estimators.bloom.source_view import Background, SourceView, background_of, view_of
from charact.frames.noise_law import NoiseLaw
from charact.frames.robust import robust_sd
from charact.frames.stack import Stack
from charact.frames.thresholds import CLIPPING
from charact.method import Context
from labdata import Array, Conditions, Session, StackEntry

# Width of the smoothing that detects a source, px; the local surroundings are three times as wide.
SMOOTHING_PX = 1.5
# Subsampling for medians.
THIN = 2
# Positions closer than this are the same, px.
NEAR_PX = 1.5
# Minimum distance of another source, px.
APART_PX = 6
DIRECTIONS = 16


@dataclass(frozen=True, kw_only=True)
class SourcePosition:
    """Position of a point source in a frame, px.

    `row`, `col`: centre, px; `significance`: height above the surroundings in standard deviations;
    `cut`: whether its peak is at full scale, so that its identity is uncertain; `settled`: whether
    it is the centre of a contour over all sectors.
    """

    row: float
    col: float
    significance: float
    cut: bool = False
    settled: bool = False


@dataclass(frozen=True, kw_only=True)
class Contrast:
    """Smoothed mean frame, its difference from the local surroundings, and the spread of that
    difference, DN.
    """

    smooth: Array
    difference: Array
    spread: float


def contrast_of(image: Array) -> Contrast:
    """Compute the contrast in which small sources stand out."""
    from scipy import ndimage

    smooth = np.asarray(ndimage.gaussian_filter(image, SMOOTHING_PX))
    difference = smooth - np.asarray(ndimage.gaussian_filter(image, 3.0 * SMOOTHING_PX))
    some = difference[::THIN, ::THIN]
    spread = robust_sd(some)
    # Quantisation may leave a background without noise.
    return Contrast(smooth=smooth, difference=difference, spread=max(spread, 0.05))


def brightest(image: Array, region: tuple[int, int, int, int] | None) -> SourcePosition:
    """Return the position with the highest contrast, moved to the centre of its connected bright
    region.
    """
    from scipy import ndimage

    contrast = contrast_of(image)
    window = np.zeros(image.shape, bool)
    if region is None:
        window[:] = True
    else:
        row, col, height, width = region
        window[row : row + height, col : col + width] = True
    top = np.unravel_index(
        int(np.argmax(np.where(window, contrast.difference, -np.inf))), image.shape
    )
    significance = float(contrast.difference[top] / contrast.spread)
    floor = float(np.median(image[::THIN, ::THIN]))
    is_bright = contrast.smooth > floor + 0.5 * (contrast.smooth[top] - floor)
    labels = np.asarray(ndimage.label(is_bright)[0])  # pyright: ignore[reportIndexIssue]
    rows, cols = (
        np.nonzero(labels == labels[top])
        if labels[top]
        else (np.array([top[0]]), np.array([top[1]]))
    )
    # Medians: a streak has few pixels compared with the spot, and is symmetric about it.
    return SourcePosition(
        row=float(np.median(rows)), col=float(np.median(cols)), significance=significance
    )


def middle(view: SourceView, row: float, col: float) -> tuple[float, float, bool] | None:
    """Return the centre of the contour at half height, and whether no sector is excluded; None
    without a contour.

    Sectors distorted by a streak or another source are excluded; clipped pixels lie inside the
    contour.
    """
    profile = view.profile[1]
    floor = float(np.median(profile))
    level = floor + 0.5 * (min(float(profile[:2].max()), view.top) - floor)
    contour_fit = contour_at(view, level) if level > 0 else None
    if contour_fit is None:
        return None
    contour, has_all_sectors = contour_fit
    down, along = contour.shift()
    # Maximum distance of a contour's centre from the detected position, px.
    if np.hypot(down, along) > 10.0:
        return None
    return row + down / view.polar.row_pitch, col + along, has_all_sectors


def is_bright_at(image: Array, source: SourcePosition, other: SourcePosition) -> bool:
    """Whether another position is within a pixel or two, or as bright as the source detected
    here.
    """
    if (
        np.hypot(source.row - other.row, source.col - other.col) < NEAR_PX
        or source.significance < 16.0
    ):
        return True
    positions = ((round(position.row), round(position.col)) for position in (source, other))
    source_mean, other_mean = (
        image[max(0, row - 1) : row + 2, max(0, col - 1) : col + 2].mean() for row, col in positions
    )
    floor = float(np.median(image[::THIN, ::THIN]))
    return bool(other_mean - floor > 0.7 * (source_mean - floor))


def further_sources(
    image: Array, source: SourcePosition, span_dn: float, row_pitch: float
) -> tuple[SourcePosition, ...]:
    """Return further sources in a frame, brightest first; they fall off in every direction, unlike
    streaks.

    `image`: mean frame, shape (row, col), DN; `source`: the known source; `span_dn`: full scale
    above dark, DN; `row_pitch`: row pitch over column pitch.
    """
    from skimage.feature import peak_local_max

    contrast = contrast_of(image)
    least_height = max(0.04 * span_dn, 16.0 * contrast.spread)
    peaks = peak_local_max(
        contrast.difference, min_distance=APART_PX, threshold_abs=least_height, exclude_border=False
    )
    source_distance = np.hypot((peaks[:, 0] - source.row) * row_pitch, peaks[:, 1] - source.col)
    detected = [
        SourcePosition(
            row=float(row),
            col=float(col),
            significance=float(contrast.difference[row, col] / contrast.spread),
        )
        for (row, col), distance in zip(peaks, source_distance, strict=True)
        if distance > APART_PX
        and _falls_off(
            contrast.smooth, int(row), int(col), float(contrast.difference[row, col]), row_pitch
        )
    ]
    return tuple(sorted(detected, key=lambda position: -position.significance))


def _falls_off(smooth: Array, row: int, col: int, height: float, row_pitch: float) -> bool:
    """Whether the signal around a peak is lower in every direction."""
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    distance_px = 4.0 + SMOOTHING_PX
    rows = np.rint(row + distance_px * np.sin(angle) / row_pitch).astype(int)
    cols = np.rint(col + distance_px * np.cos(angle)).astype(int)
    within_frame = (rows >= 0) & (rows < smooth.shape[0]) & (cols >= 0) & (cols < smooth.shape[1])
    return bool(
        np.all(smooth[row, col] - smooth[rows[within_frame], cols[within_frame]] > 0.4 * height)
    )


# Standard errors by which the smoothed source must exceed its surroundings.
DETECTED = 8.0
# Grey values are rounded: full scale is shown from half a step below.
HALF_STEP_DN = 0.5


@dataclass(frozen=True, kw_only=True)
class PointStack:
    """One stack of a point source.

    `label`, `conditions`: as in the session; `image`: mean of its frames, shape (row, col), DN;
    `frames`: number of frames; `dark_dn`, `full_scale_dn`: black level and full scale;
    `dark_known`: whether the black level was measured or recorded; `row`, `col`: centre, px;
    `significance`: height of the smoothed source above its surroundings in standard deviations;
    `frame_streak_px`: streak length of single frames, shape (frame,), px; `noise`: noise of a pixel
    of the mean frame; `row_pitch`: row pitch
    over column pitch; `half`, `background`, `clip`: region at or above half of full scale, twice
    the background above dark, and full scale; None where the source stays below the threshold or
    the background is not measurable; `light`: the background; `other_sources`: further sources in
    the frame.
    """

    label: str
    conditions: Conditions
    image: Array
    frames: int
    dark_dn: float
    full_scale_dn: float
    dark_known: bool
    row: float
    col: float
    significance: float
    frame_streak_px: Array
    noise: NoiseLaw
    row_pitch: float = 1.0
    half: Extent | None = None
    background: Extent | None = None
    clip: Extent | None = None
    light: Background = field(
        default_factory=lambda: Background(level_dn=0.0, sd_dn=0.0, is_uniform=False)
    )
    other_sources: tuple[SourcePosition, ...] = ()

    @property
    def why_undetected(self) -> str:
        """Refusal reason without a detected source; empty with one."""
        if self.significance >= DETECTED:
            return ""
        return (
            f"no point source: the brightest spot has {self.significance:.1f} standard "
            f"deviations, at least 8 needed"
        )

    @property
    def half_dn(self) -> float:
        """Half of full scale above dark, DN."""
        return self.dark_dn + 0.5 * (self.full_scale_dn - self.dark_dn)

    @property
    def bloom_px(self) -> float:
        """Bloom diameter at half of full scale, column pitches; 0 where the source stays below
        it.
        """
        return 0.0 if self.half is None else self.half.diameter_px

    @property
    def streak_px(self) -> float:
        """Rows of the source's column at or above half of full scale."""
        col = int(np.clip(round(self.col), 0, self.image.shape[1] - 1))
        return float((self.image[:, col] >= self.half_dn).sum())

    @property
    def exposure_lux_ns(self) -> float | None:
        """Illuminance times gate, lx ns (times 1 without a gate); None if the illuminance is
        unknown.
        """
        lux = self.conditions.illuminance_lux
        return None if lux is None else lux * (self.conditions.gate_ns or 1.0)


def read_point_stacks(session: Session, *, context: Context) -> tuple[PointStack, ...]:
    """Read all point stacks one at a time, in two passes: locate the sources, then measure them."""
    levels = {dark.label: dark.read().mean_dn for dark in session.of_kind("dark")}
    entries = sorted(
        session.of_kind("point"), key=lambda entry: entry.conditions.illuminance_lux or 0.0
    )
    darks = [
        None if (d := session.dark_like(entry.conditions)) is None else levels[d.label]
        for entry in entries
    ]
    positions = []
    for entry, dark in zip(entries, darks, strict=True):
        stack = Stack.of(entry.read(), context)
        level, _ = stack.black_level_dn(dark, CLIPPING.unlit_around_points)
        positions.append(place_of(stack, entry.target.region, level, context))
    spots: list[PointStack] = []
    behind: list[tuple[Conditions, Background]] = []
    for done, (entry, dark, position) in enumerate(zip(entries, darks, positions, strict=True)):
        context.progress(f"blooming of {entry.label}", done / len(entries))
        same = [
            other
            for other, other_entry in zip(positions, entries, strict=True)
            if other_entry.target.region == entry.target.region
        ]
        stack = Stack.of(entry.read(), context)
        position = common_position(position, same, stack.mean_frame_dn)
        spots.append(spot_of(entry, stack, dark, position, context, behind))
        behind.append((entry.conditions, spots[-1].light))
    return tuple(spots)


def place_of(stack: Stack, region, dark_dn: float, context: Context) -> SourcePosition:
    """Locate the source of a stack, at the centre of its contour where it has one."""
    position = brightest(stack.mean_frame_dn, region)
    if position.significance < DETECTED:
        return position
    row, col = position.row, position.col
    view = view_of(stack, dark_dn, row, col, context.pitch_ratio)
    # Fraction of full scale above which a peak counts as clipped.
    cut = float(view.signal[view.polar.radius < 1.5].max(initial=0.0)) > 0.9 * view.top
    settled = False
    for _ in range(5):
        better = middle(view, row, col)
        # The contour of a cropped bloom may be centred outside the frame.
        if better is None or any(
            not -0.5 <= at < n - 0.5 for at, n in zip(better, view.signal.shape, strict=False)
        ):
            break
        shift_px = float(np.hypot(better[0] - row, better[1] - col))
        row, col, settled = better
        if shift_px < 0.4:
            break
        view = view_of(stack, dark_dn, row, col, context.pitch_ratio)
    return SourcePosition(
        row=row, col=col, significance=position.significance, cut=cut, settled=settled
    )


def common_position(
    source: SourcePosition, positions: list[SourcePosition], image: Array
) -> SourcePosition:
    """Return the position common to the stacks, unless this stack's source is elsewhere.

    The clearest stack locates the source best: it is neither faint nor saturated. Where two spots
    have merged, the common position still lies inside; where the source has moved, it does not.
    Positions are ordered by illuminance: two sources at full scale look alike, and the faintest
    stack identifies the brighter one.
    """
    clear = [position for position in positions if position.significance > 2 * DETECTED]
    unclipped = [position for position in clear if not position.cut]
    anchor = max(unclipped or clear[:1] or positions, key=lambda position: position.significance)
    same = [
        candidate
        for candidate in positions
        if np.hypot(candidate.row - anchor.row, candidate.col - anchor.col) < NEAR_PX
    ]
    best = max(same, key=lambda position: (position.settled, position.significance))
    if best.significance <= 2 * DETECTED or not is_bright_at(image, source, best):
        return source
    return SourcePosition(row=best.row, col=best.col, significance=source.significance)


def spot_of(
    entry: StackEntry,
    stack: Stack,
    dark: float | None,
    position: SourcePosition,
    context: Context,
    behind: list[tuple[Conditions, Background]],
) -> PointStack:
    """Measure position, extents and background of one stack.

    `entry`, `stack`: the stack and its frames. `dark`: black level from dark frames, DN.
    `position`: position of the source. `behind`: conditions and backgrounds of the previous stacks,
    the faintest first. The background of the faintest stack with the same conditions is used, since
    a bright source illuminates the whole frame.
    """
    full, (level, known) = stack.top_dn, stack.black_level_dn(dark, CLIPPING.unlit_around_points)
    view = view_of(stack, level, position.row, position.col, context.pitch_ratio)
    own_background = background_of(view)
    earlier_backgrounds = [
        light
        for conditions, light in behind
        if has_same_settings(conditions, entry.conditions) and light.is_uniform
    ]
    light = earlier_backgrounds[0] if earlier_backgrounds else own_background
    half = level + 0.5 * (full - level)
    extents: dict[str, Extent | None] = {"half": None, "background": None, "clip": None}
    if position.significance >= DETECTED:
        extents["half"] = extent_at(view, half, seed=context.seed)
        if not known and extents["half"] is not None:
            # An unknown black level lies between 0 and the median of the frame.
            lowest = extent_at(view, 0.5 * full, seed=context.seed)
            draws = (
                extents["half"].draws
                if lowest is None
                else np.concatenate([extents["half"].draws, lowest.draws])
            )
            extents["half"] = replace(extents["half"], draws=draws)
        extents["clip"] = extent_at(view, full - HALF_STEP_DN, seed=context.seed)
        if light.is_illuminated and light.is_uniform:
            extents["background"] = extent_at(
                view, level + 2.0 * light.level_dn, level_sd=2.0 * light.sd_dn, seed=context.seed
            )
    image = view.signal + level
    col = int(np.clip(round(position.col), 0, image.shape[1] - 1))
    clear = position.significance >= DETECTED
    return PointStack(
        label=entry.label,
        conditions=entry.conditions,
        image=image,
        frames=len(stack),
        dark_dn=level,
        full_scale_dn=full,
        dark_known=known,
        row=position.row,
        col=position.col,
        significance=position.significance,
        frame_streak_px=(stack.data[:, :, col] >= half).sum(axis=1).astype(float),
        noise=view.noise.scaled(1.0 / len(stack)),
        row_pitch=context.pitch_ratio,
        half=extents["half"],
        background=extents["background"],
        clip=extents["clip"],
        light=light,
        other_sources=further_sources(image, position, full - level, context.pitch_ratio)
        if clear
        else (),
    )


def has_same_settings(conditions: Conditions, other: Conditions) -> bool:
    """Whether two stacks were taken at the same gain, gate and exposure."""
    names = ("mcp_v", "camera_gain_db", "gate_ns", "exposure_s", "gain_control", "em_gain")
    return all(getattr(conditions, name) == getattr(other, name) for name in names)
