"""Where the point source is, how bright it stands against its surroundings, and how far it blooms."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from charact.bloom.background import Background, background_of
from charact.bloom.extent import Extent, extent_at
from charact.bloom.source_position import NEAR_PX, SourcePosition, brightest, is_bright_at, middle, others
from charact.bloom.source_view import view_of
from charact.method import Context
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]

# Standard errors by which the smoothed source must stand above its surroundings.
DETECTED = 8.0
# Share of full scale from which on noise is cut by the highest code.
LINEAR_SHARE = 0.75
# Share of full scale from which on a peak is taken for cut.
CUT_SHARE = 0.9
# A middle that moves by less than this has been found, px.
MOVED_PX, MOST_MOVES = 0.4, 5
# The codes of a level are whole: from half a step below on, the highest one is shown.
HALF_STEP_DN = 0.5


@dataclass(frozen=True, kw_only=True)
class PointStack:
    """One stack of a point source.

    Parameters
    ----------
    label, conditions
        As in the session.
    image
        Mean of its frames, shape (row, col), DN.
    frames
        Number of frames.
    dark_dn, full_scale_dn
        Level without light and highest code.
    dark_known
        Whether the level without light was measured or recorded.
    row, col
        Centre, px.
    significance
        Height of the smoothed source above its surroundings in their standard deviations.
    frame_streak_px
        Streak length of single frames, shape (frame,), px.
    row_pitch
        Row pitch over column pitch.
    half, background, clip
        The region at or above half of full scale, twice the background over dark, and the highest code; None where
        the source does not reach the level (or there is no background to take twice).
    light
        The background.
    others
        Further sources in the frame.
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
    row_pitch: float = 1.0
    half: Extent | None = None
    background: Extent | None = None
    clip: Extent | None = None
    light: Background = field(default_factory=lambda: Background(level_dn=0.0, sd_dn=0.0, even=False))
    others: tuple[SourcePosition, ...] = ()

    @property
    def half_dn(self) -> float:
        """Half of full scale over dark, DN."""
        return self.dark_dn + 0.5 * (self.full_scale_dn - self.dark_dn)

    @property
    def bloom_px(self) -> float:
        """Bloom diameter at half of full scale, column pitches; 0 where the source stays below."""
        return 0.0 if self.half is None else self.half.diameter_px

    @property
    def streak_px(self) -> float:
        """Rows of the source's column at or above half of full scale."""
        col = int(np.clip(round(self.col), 0, self.image.shape[1] - 1))
        return float((self.image[:, col] >= self.half_dn).sum())

    @property
    def touches_border(self) -> bool:
        """Whether the bloom runs into the frame's border."""
        return self.half is not None and self.half.touches_border


def read_point_stacks(session: Session, *, context: Context) -> tuple[PointStack, ...]:
    """Read every point stack, one at a time, twice: the stacks agree on where the source is before it is measured."""
    levels = {dark.label: dark.read().mean_dn for dark in session.of_kind("dark")}

    def dark_of(entry: StackEntry) -> float | None:
        dark = session.dark_like(entry.conditions)
        return None if dark is None else levels[dark.label]

    entries = sorted(session.of_kind("point"), key=lambda entry: entry.conditions.illuminance_lux or 0.0)
    places = [_place(entry, dark_of(entry), context) for entry in entries]
    spots: list[PointStack] = []
    behind: list[tuple[Conditions, Background]] = []
    for done, (entry, place) in enumerate(zip(entries, places, strict=True)):
        context.progress(f"blooming of {entry.label}", done / len(entries))
        same = [other for other, one in zip(places, entries, strict=True) if one.target.region == entry.target.region]
        dark, stack = dark_of(entry), entry.read()
        place = common_position(place, same, stack.data.mean(axis=0, dtype=np.float64))
        spots.append(spot_of(entry, stack, dark, place, context, behind))
        behind.append((entry.conditions, spots[-1].light))
    return tuple(spots)


def _place(entry: StackEntry, dark: float | None, context: Context) -> SourcePosition:
    """Find the source of one stack."""
    stack = entry.read()
    return place_of(stack, entry.target.region, _level(stack, dark), full_scale_of(stack, context), context)


def place_of(stack: FrameStack, region, dark_dn: float, full_scale_dn: float, context: Context) -> SourcePosition:
    """Find the source of a stack, and the middle of its contour where it has one."""
    found = brightest(stack.data.mean(axis=0, dtype=np.float64), region)
    if found.significance < DETECTED:
        return found
    row, col = found.row, found.col
    view = view_of(stack.data, dark_dn, full_scale_dn, row, col, context.pitch_ratio)
    cut = float(view.signal[view.polar.radius < 1.5].max(initial=0.0)) > CUT_SHARE * view.top
    settled = False
    for _ in range(MOST_MOVES):
        better = middle(view, row, col)
        if better is None or not _inside(better[0], better[1], view.signal.shape):
            break
        moved = float(np.hypot(better[0] - row, better[1] - col))
        row, col, settled = better
        if moved < MOVED_PX:
            break
        view = view_of(stack.data, dark_dn, full_scale_dn, row, col, context.pitch_ratio)
    return SourcePosition(row=row, col=col, significance=found.significance, cut=cut, settled=settled)


def _inside(row: float, col: float, shape: tuple[int, ...]) -> bool:
    """Whether a place lies in the frame: the contour of a bloom that runs out of it may have its middle elsewhere."""
    return -0.5 <= row < shape[0] - 0.5 and -0.5 <= col < shape[1] - 0.5


def common_position(own: SourcePosition, places: list[SourcePosition], image: Array) -> SourcePosition:
    """The place that the stacks share, unless this one's light is elsewhere.

    The clearest stack knows it best, for there the source is neither faint nor a blob. Where two blobs have run into
    one, the shared place still lies inside; where the source has moved, it does not. Places come in the order of the
    light: two sources at the highest code look alike, and the faintest stack shows best which is the brighter one.
    """
    clear = [place for place in places if place.significance > 2 * DETECTED]
    whole = [place for place in clear if not place.cut]
    anchor = max(whole or clear[:1] or places, key=lambda place: place.significance)
    same = [one for one in places if np.hypot(one.row - anchor.row, one.col - anchor.col) < NEAR_PX]
    best = max(same, key=lambda place: (place.settled, place.significance))
    if best.significance <= 2 * DETECTED or not is_bright_at(image, own, best):
        return own
    return SourcePosition(row=best.row, col=best.col, significance=own.significance)


def full_scale_of(stack: FrameStack, context: Context) -> float:
    """Highest code: as told, as recorded, else the highest value seen."""
    told = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    return told if told is not None else float(stack.data.max())


def _dark_or_black_level(stack: FrameStack, dark: float | None) -> float | None:
    return dark if dark is not None else stack.black_level_dn


def _level(stack: FrameStack, dark: float | None) -> float:
    """Level without light: measured, recorded, or else what most pixels show."""
    recorded = _dark_or_black_level(stack, dark)
    return float(np.median(stack.data.mean(axis=0, dtype=np.float64))) if recorded is None else recorded


def spot_of(entry: StackEntry, stack: FrameStack, dark: float | None, place: SourcePosition, context: Context,
            behind: list[tuple[Conditions, Background]]) -> PointStack:  # fmt: skip
    """Statistics of one stack.

    Parameters
    ----------
    entry, stack
        The stack and its frames.
    dark
        Level without light from dark frames, DN.
    place
        Where the source is.
    behind
        Conditions and backgrounds of the stacks read before, the faintest first: the background of a level is that of
        the faintest taken alike, for a bright source lights the whole frame.
    """
    full, level = full_scale_of(stack, context), _level(stack, dark)
    view = view_of(stack.data, level, full, place.row, place.col, context.pitch_ratio)
    own = background_of(view)
    alike = [light for conditions, light in behind if _alike(conditions, entry.conditions) and light.even]
    light = alike[0] if alike else own
    half = level + 0.5 * (full - level)
    found: dict[str, Extent | None] = {"half": None, "background": None, "clip": None}
    if place.significance >= DETECTED:
        found["half"] = extent_at(view, half, seed=context.seed)
        if _dark_or_black_level(stack, dark) is None and found["half"] is not None:
            # Where nothing tells the level without light it lies between 0 and what most pixels show.
            lowest = extent_at(view, 0.5 * full, seed=context.seed)
            draws = found["half"].draws if lowest is None else np.concatenate([found["half"].draws, lowest.draws])
            found["half"] = replace(found["half"], draws=draws)
        found["clip"] = extent_at(view, full - HALF_STEP_DN, seed=context.seed)
        if light.lit and light.even:
            found["background"] = extent_at(
                view, level + 2.0 * light.level_dn, level_sd=2.0 * light.sd_dn, seed=context.seed
            )
    image = view.signal + level
    col = int(np.clip(round(place.col), 0, image.shape[1] - 1))
    clear = place.significance >= DETECTED
    return PointStack(
        label=entry.label,
        conditions=entry.conditions,
        image=image,
        frames=len(stack),
        dark_dn=level,
        full_scale_dn=full,
        dark_known=_dark_or_black_level(stack, dark) is not None,
        row=place.row,
        col=place.col,
        significance=place.significance,
        frame_streak_px=(stack.data[:, :, col] >= half).sum(axis=1).astype(float),
        row_pitch=context.pitch_ratio,
        half=found["half"],
        background=found["background"],
        clip=found["clip"],
        light=light,
        others=others(image, place, full - level, context.pitch_ratio) if clear else (),
    )


def _alike(one: Conditions, other: Conditions) -> bool:
    """Whether two stacks were taken at the same gain and gate."""
    names = ("mcp_v", "camera_gain_db", "gate_ns", "exposure_s", "gain_control", "em_gain")
    return all(getattr(one, name) == getattr(other, name) for name in names)
