"""Layout of the chip of a session, and the session of what its darks and flats hold that is sound:
the one place where frames are read without unexposed strips and lost rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.frames.layout import (
    BORDER,
    LOST,
    STRIP,
    AreaView,
    Layout,
    Part,
    Profiles,
    Region,
    layout_of,
    lost_rows,
    profiles_of,
)
from charact.frames.thresholds import LAYOUT, STACK
from labdata import BadInput, Session, StackEntry, open_lazy_stack


@dataclass(frozen=True, kw_only=True)
class StackProfile:
    """What one dark or flat shows of the layout of its chip."""

    # label, kind, size: as in the session; rows and columns
    label: str
    kind: str
    size: tuple[int, int]
    frames: int  # number of frames
    # profiles, lost: of the mean frame, see `charact.frames.layout`; rows that were lost
    profiles: Profiles | None = None
    lost: tuple[Part, ...] = ()


def stack_profile(entry: StackEntry) -> StackProfile:
    """Return what a stack shows of the layout; a single frame or a small image shows nothing."""
    stack = open_lazy_stack(entry)
    frames, *size = stack.shape
    shown = StackProfile(label=entry.label, kind=entry.kind, size=(size[0], size[1]), frames=frames)
    if frames < 2 or min(size) < 2 * LAYOUT.bands:
        return shown
    total, lost = np.zeros(size), ()
    for first in range(0, frames, STACK.block_frames):
        block = stack.frames(first, min(first + STACK.block_frames, frames))
        total += block.sum(axis=0, dtype=float)
        lost += lost_rows(block, first)
    return replace(shown, profiles=profiles_of(total / frames), lost=lost)


def sound_session(session: Session) -> tuple[Layout | None, Session]:
    """Return the layout that the darks and flats of a session show, None without one, and the
    session of what of them is sound.
    """
    return find_layout(session, [stack_profile(entry) for entry in session.of_kind("dark", "flat")])


def find_layout(
    session: Session, profiles: Sequence[StackProfile]
) -> tuple[Layout | None, Session]:
    """Return the layout that profiles of darks and flats show, and the session of what is sound.

    Frames with lost rows are left out; where fewer than two frames of a stack would stay, the rows
    of all stacks are. None stands for images too small, or of several sizes.
    """
    known = [shown for shown in profiles if shown.profiles is not None]
    if not known or len({shown.size for shown in profiles}) > 1:
        return None, session
    lost = tuple(replace(rows, stack=shown.label) for shown in known for rows in shown.lost)
    sound = {
        shown.label: np.setdiff1d(np.arange(shown.frames), [rows.frame for rows in shown.lost])
        for shown in known
        if shown.lost
    }
    means = {"dark": [], "flat": []}
    for shown in known:
        frames = sound.get(shown.label, np.zeros(0, np.int64))
        means[shown.kind].append(
            profiles_of(_mean_frame(session, shown, frames)) if len(frames) else shown.profiles
        )
    layout = layout_of(means["dark"], means["flat"], lost=lost)
    frames = {label: numbers for label, numbers in sound.items() if len(numbers) > 1}
    region = _between(layout.exposed, [rows for rows in lost if rows.stack not in frames])
    if not frames and region == (0, 0, *layout.size):
        return layout, session
    return layout, _within(session, region, frames)


def of_amplifier(session: Session, layout: Layout | None, number: int) -> Session:
    """Return the session of one amplifier (from 1, by rows); a number without one is BadInput."""
    regions = () if layout is None else layout.amplifiers
    if layout is None or not 1 <= number <= len(regions):
        shown = f"be 1 to {len(regions)}" if regions else "be left out: the frames show only one"
        raise BadInput(f"`amplifier` must {shown}, got {number}")
    top, left, height, width = regions[number - 1]
    views = [entry.view for entry in session.of_kind("dark", "flat")]
    frames = {
        entry.label: entry.view.frames
        for entry in session.of_kind("dark", "flat")
        if isinstance(entry.view, AreaView) and entry.view.frames is not None
    }
    region = views[0].region if isinstance(views[0], AreaView) else (0, 0, *layout.size)
    first, last = max(top, region[0]), min(top + height, region[0] + region[2])
    return _within(session, (first, left, last - first, width), frames)


def left_out(layout: Layout | None) -> tuple[str, ...]:
    """Return the notes on what of the frames is not measured."""
    parts = [] if layout is None else [*layout.of(STRIP), *layout.of(LOST)]
    return (f"left out: {'; '.join(part.note for part in parts)}",) if parts else ()


def layout_notes(layout: Layout | None) -> tuple[str, ...]:
    """Return the notes on what is left out, and on borders of amplifiers measured as one."""
    borders = () if layout is None else layout.of(BORDER)
    return (*left_out(layout), *(part.note for part in borders))


def _mean_frame(session: Session, shown: StackProfile, frames: NDArray[np.int64]) -> NDArray:
    """Return the mean of some frames of a stack, DN."""
    view = AreaView(region=(0, 0, *shown.size), frames=frames)
    stack = view.through(open_lazy_stack(session.stack(shown.label)))
    return stack.frames(0, len(stack)).mean(axis=0, dtype=np.float64)


def _between(region: Region, gaps: Sequence[Part]) -> Region:
    """Return the tallest part of a region without lost rows, nor those that were lost in part."""
    top, left, height, width = region
    ends = sorted((rows.first - 1, rows.stop + 1) for rows in gaps)
    starts = [top, *(stop for _, stop in ends)]
    stops = [*(first for first, _ in ends), top + height]
    first, stop = max(zip(starts, stops, strict=True), key=lambda span: span[1] - span[0])
    return (first, left, stop - first, width) if stop > first else region


def _within(session: Session, region: Region, frames: dict[str, NDArray[np.int64]]) -> Session:
    """Return a session whose darks and flats are sound frames cut to a region."""
    row, col, height, width = region
    # Even and odd rows stay those of their field.
    region = row + row % 2, col, height - row % 2, width
    return replace(
        session,
        stacks=tuple(
            replace(entry, view=AreaView(region=region, frames=frames.get(entry.label)))
            if entry.kind in ("dark", "flat")
            else entry
            for entry in session.stacks
        ),
    )
