"""Layout of the chip of a session: what of its darks and flats is measured."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.pixel_survey import PixelSurvey
from charact.frames.layout import (
    LOST,
    STRIP,
    AreaView,
    Layout,
    Part,
    Region,
    layout_of,
    profiles_of,
)
from labdata import BadInput, Session, open_lazy_stack


def find_layout(session: Session, surveys: Sequence[PixelSurvey]) -> tuple[Layout | None, Session]:
    """Return the layout that surveys of darks and flats show, and the session of what is sound.

    Frames with lost rows are left out; where fewer than two frames of a stack would stay, the rows
    of all stacks are. None stands for images too small, or of several sizes.
    """
    known = [survey for survey in surveys if survey.profiles is not None]
    if not known or len({survey.size for survey in surveys}) > 1:
        return None, session
    lost = tuple(replace(rows, stack=survey.label) for survey in known for rows in survey.lost)
    sound = {
        survey.label: np.setdiff1d(np.arange(survey.frames), [rows.frame for rows in survey.lost])
        for survey in known
        if survey.lost
    }
    profiles = {"dark": [], "flat": []}
    for survey in known:
        frames = sound.get(survey.label)
        profiles[survey.kind].append(
            survey.profiles
            if frames is None or not len(frames)
            else profiles_of(_mean_frame(session, survey, frames))
        )
    layout = layout_of(profiles["dark"], profiles["flat"], lost=lost)
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


def left_out(layout: Layout) -> tuple[str, ...]:
    """Return the notes on what of the frames is not measured."""
    parts = [part.note for part in (*layout.of(STRIP), *layout.of(LOST))]
    return (f"left out: {'; '.join(parts)}",) if parts else ()


def _mean_frame(session: Session, survey: PixelSurvey, frames: NDArray[np.int64]) -> NDArray:
    """Return the mean of some frames of a stack, DN."""
    view = AreaView(region=(0, 0, *survey.size), frames=frames)
    stack = view.through(open_lazy_stack(session.stack(survey.label)))
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
