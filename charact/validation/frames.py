"""Measured and simulated frames under the same conditions, cropped to the same size."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from charact.fitting.specimen_maps import checksum
from charact.frames.layout import AreaView
from charact.frames.session_layout import layout_notes, sound_session
from charact.validation.target_features import target_centre
from charact.validation.thresholds import VALIDATION
from labdata import (
    BadInput,
    Camera,
    Conditions,
    Kind,
    Session,
    StackEntry,
    Target,
    open_lazy_stack,
)
from labdata.camera.maps import SpecimenMaps

# Size of a centred crop: sufficient for every statistic, and fast to simulate.
SHAPE = (240, 320)
# Size of an edge crop: pixels far from the edge add noise and little signal, a long one may be bent
# by the lens.
ALONG_EDGE, ACROSS_EDGE = 384, 96
# What a target must state to be simulated.
STATED = {"bars": "frequency_cy_per_px", "point": "pinhole_px"}
# Levels of the point source whose profile is drawn.
POINT_LEVELS = 4
# Samples of a plane of a mosaic lie two pixels apart: a crop of as many pixels of the camera along
# the edge, and of a dark or flat 1.7 times as many as of another camera, for the statistics of
# fewer samples.
SHAPE_OF_PLANE, ALONG_EDGE_OF_PLANE = (160, 200), 192


@dataclass(frozen=True, kw_only=True)
class MatchedFrames:
    """Frames of a stack that are compared: as in the session, their number, and corner and shape of
    the crop.

    `offset_px`: (row, col) from the centre of the crop to that of the target; `level_dn`: signal
    above the dark that sets the light of each simulated set, where it is unknown; `like`: label of
    the flat whose photons have the same unknown colour, and set it; `course`: light of each frame
    over their mean, where it drifts, else empty.
    """

    label: str
    kind: Kind
    conditions: Conditions
    target: Target
    frames: int
    corner: tuple[int, int]
    shape: tuple[int, int]
    pitch_px: int = 1  # distance of the samples, pixels of the camera
    origin: tuple[int, int] = (0, 0)  # first row and column, within the frame, that `corner` counts
    offset_px: tuple[float, float] = (0.0, 0.0)
    level_dn: float | None = None
    like: str | None = None
    course: tuple[float, ...] = ()

    @property
    def first(self) -> tuple[int, int]:
        """First row and column of the crop within the frame."""
        return self.corner[0] + self.origin[0], self.corner[1] + self.origin[1]


@dataclass(frozen=True, kw_only=True)
class MatchedStacks:
    """Stacks of a validation.

    `display_only` are for display only; `measured` has the frames by label, shape (frame, row,
    col), DN; `parts` have those of the dark and the brightest flat in other parts of the whole
    frame, of the same shape, by place, and `corners` their first rows and columns; `notes` name
    excluded stacks; `fitted` are the numbers that the light of a stack was fitted to, which are not
    compared; `maps` those of the specimen. Without an edge the MTF is not compared, without a point
    source no halo.
    """

    dark: MatchedFrames
    flats: tuple[MatchedFrames, ...]
    edge: MatchedFrames | None
    point: MatchedFrames | None
    display_only: tuple[MatchedFrames, ...]
    measured: dict[str, NDArray]
    notes: tuple[str, ...]
    parts: Mapping[str, dict[str, NDArray]] = field(default_factory=dict)
    corners: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    fitted: frozenset[str] = frozenset()
    maps: SpecimenMaps | None = None

    @property
    def compared(self) -> tuple[MatchedFrames, ...]:
        """Dark, flats, edge and point source."""
        return (
            self.dark,
            *self.flats,
            *(shot for shot in (self.edge, self.point) if shot is not None),
        )


def choose(session: Session, maps: SpecimenMaps | None = None) -> MatchedStacks:
    """Select a dark, up to three flats within the linear range, an edge, and stacks for display.

    Frames that maps of the specimen were measured from are not compared.

    Raises
    ------
    BadInput
        If there is no dark or no usable flat of at least three frames, or the session names no
        camera of visible light.
    """
    camera_of(session)
    layout, session = sound_session(session)
    session, map_notes = without_frames_of(maps, session)
    darks = _shots(session, "dark")
    if not darks:
        raise BadInput(
            f"a validation needs a dark stack of {VALIDATION.fewest_frames} frames or more, got "
            f"none in {session.name!r}"
        )
    dark = max(darks, key=lambda item: item[0].frames)
    flats, notes = _flats(session)
    edges, bars, points = (_shots(session, kind) for kind in ("edge", "bars", "point"))
    if not edges:
        notes.append("no edge: the MTF is not compared")
    elif edges[0][0].target.contrast is None:
        notes.append(
            f"the contrast of {edges[0][0].label} is not stated (target = {{ contrast = ... }}): "
            "its dark side is simulated as opaque"
        )
    if not points:
        notes.append("no point source: halo and bloom are not compared")
    brightest = points[-1:]
    corners = _corners_of_parts(dark, flats[-1])
    return MatchedStacks(
        dark=dark[0],
        flats=tuple(shot for shot, _ in flats),
        edge=edges[0][0] if edges else None,
        point=brightest[0][0] if brightest else None,
        display_only=tuple(shot for shot, _ in bars[:1]),
        measured={
            shot.label: _cut(shot, entry)
            for shot, entry in (dark, *flats, *edges[:1], *brightest, *bars[:1])
        },
        notes=(*notes, *layout_notes(layout), *map_notes),
        parts={
            place: {
                shot.label: _cut(replace(shot, corner=corner), entry)
                for shot, entry in (dark, flats[-1])
            }
            for place, corner in corners.items()
        },
        corners=corners,
        maps=maps,
    )


def known_pattern(
    maps: SpecimenMaps | None, shot: MatchedFrames, signal_dn: float
) -> NDArray[np.float32] | float:
    """Return the pattern of a stack of a signal by the maps of the specimen, about its mean, shape
    (row, col), DN; 0 without maps.
    """
    if maps is None:
        return 0.0
    here, pattern = replace(maps, corner=shot.first), np.zeros(shot.shape, np.float32)
    for measured, neutral, factor in (
        (maps.offset_dn, 0.0, 1.0),
        (maps.dark_rate_dn_per_s, 0.0, shot.conditions.exposure_s or 0.0),
        (maps.light, 1.0, signal_dn),
    ):
        if measured is not None:
            window = here.window(measured.mean, shot.shape, neutral)
            pattern += np.float32(factor) * (window - np.float32(neutral))
    return pattern


def without_frames_of(
    maps: SpecimenMaps | None, session: Session
) -> tuple[Session, tuple[str, ...]]:
    """Return a session without the frames that maps were measured from, and notes on the maps."""
    if maps is None:
        return session, ()
    stacks, withheld = [], 0
    for entry in session.stacks:
        numbers = maps.frames.get(entry.label, ())
        if not numbers or checksum(entry) != maps.checksums[entry.label]:
            stacks.append(entry)
            continue
        frames, height, width = open_lazy_stack(entry).shape
        kept = np.setdiff1d(np.arange(frames), numbers)
        withheld += frames - len(kept)
        view = entry.view if isinstance(entry.view, AreaView) else None
        if view is not None and view.frames is not None:
            kept = view.frames[kept]
        region = (0, 0, height, width) if view is None else view.region
        if len(kept):
            stacks.append(replace(entry, view=AreaView(region=region, frames=kept)))
    note = f"not compared: {withheld} frames from which the maps of the specimen were measured"
    notes = (*maps.notes, note) if withheld else maps.notes
    return replace(session, stacks=tuple(stacks)), notes


def camera_of(session: Session) -> Camera:
    """Return the session's camera; BadInput unless it is described and sees visible light."""
    camera = session.camera
    if camera is None or camera.is_thermal:
        raise BadInput(
            f"a validation needs a session of a described camera of visible light, got "
            f"{'none' if camera is None else camera.name} in {session.name!r}"
        )
    return camera


def _shots(session: Session, kind: Kind) -> list[tuple[MatchedFrames, StackEntry]]:
    """Return the stacks of a kind with enough frames, whose target is stated."""
    out, (_, pitch_px) = [], session.sampling
    whole_shape, along_edge = (
        (SHAPE, ALONG_EDGE) if pitch_px == 1 else (SHAPE_OF_PLANE, ALONG_EDGE_OF_PLANE)
    )
    for entry in session.of_kind(kind):
        frames, rows, columns = entry.read().shape
        stated = kind not in STATED or getattr(entry.target, STATED[kind])
        if frames < VALIDATION.fewest_frames or not stated:
            continue
        height, width = whole_shape
        centre, angle_deg = _centre_of(entry)
        if kind == "edge":
            upright = abs(np.cos(np.deg2rad(angle_deg))) > np.sqrt(0.5)
            height, width = (along_edge, ACROSS_EDGE) if upright else (ACROSS_EDGE, along_edge)
        shape = (min(height, rows - rows % 2), min(width, columns))
        most_frames = VALIDATION.edge_frames if kind == "edge" else VALIDATION.frames
        shot = MatchedFrames(
            label=entry.label,
            kind=entry.kind,
            conditions=entry.conditions,
            target=entry.target,
            frames=min(frames, most_frames),
            corner=_corner(centre, (rows, columns), shape),
            shape=shape,
            pitch_px=pitch_px,
            origin=entry.view.region[:2] if isinstance(entry.view, AreaView) else (0, 0),
        )
        out.append((shot, entry))
    return out


def _centre_of(entry: StackEntry) -> tuple[Target, float]:
    """Return a target whose region is the centre of that of a stack in its frames, and the angle it
    shows there, deg; dark and flat, and what shows no target, as they are stated.
    """
    target = entry.target
    if entry.kind in ("edge", "bars", "point"):
        frames = entry.read()
        row, col, height, width = target.region or (0, 0, *frames.shape[1:])
        mean = frames.region(row, col, height, width).data.mean(axis=0, dtype=float)
        centre = target_centre(entry.kind, mean)
        if centre is not None:
            about = (row + round(centre[0]), col + round(centre[1]), 0, 0)
            return replace(target, region=about), centre[2] or 0.0
    return target, target.angle_deg or 0.0


def _corner(
    target: Target, frame_shape: tuple[int, int], shape: tuple[int, int]
) -> tuple[int, int]:
    """Return the first row and column of a crop centred on the target; an even row keeps the field
    parity.
    """
    row, col, height, width = target.region or (0, 0, *frame_shape)
    top = int(np.clip(round(row + (height - shape[0]) / 2), 0, frame_shape[0] - shape[0]))
    first_col = int(np.clip(round(col + (width - shape[1]) / 2), 0, frame_shape[1] - shape[1]))
    return top - top % 2, first_col


def _cut(shot: MatchedFrames, entry: StackEntry) -> NDArray:
    return np.array(entry.read().region(*shot.corner, *shot.shape).data[: shot.frames])


def _corners_of_parts(*stacks: tuple[MatchedFrames, StackEntry]) -> dict[str, tuple[int, int]]:
    """Return first row and column of the parts of the frame that cover it besides the centred crop
    of stacks, by place.

    Stacks of unlike frames have none. Strips below a tenth of the crop between two parts are left
    out.
    """
    sizes = {(entry.read().shape[1:], shot.shape) for shot, entry in stacks}
    if len(sizes) > 1:
        return {}
    frame_shape, shape = next(iter(sizes))
    starts = []
    for size, length in zip(frame_shape, shape, strict=True):
        count = max(1, int(np.ceil(size / length - 0.1)))
        # An even row keeps the field parity.
        starts.append([round(at) // 2 * 2 for at in np.linspace(0, size - length, count)])
    corners = list(itertools.product(*starts))
    return {
        f"rows from {row}, columns from {col}": (row, col)
        for row, col in corners
        if len(corners) > 1
    }


def _flats(session: Session) -> tuple[list[tuple[MatchedFrames, StackEntry]], list[str]]:
    """Select flats of low, medium and high signal; return them and notes on excluded ones."""
    full = float(2 ** (session.bit_depth or camera_of(session).video.bit_depth) - 1)
    usable, excluded = [], []
    for shot, entry in _shots(session, "flat"):
        frames = _cut(shot, entry)
        clipped = float(np.mean((frames >= full) | (frames <= 0)))
        if frames.mean() > VALIDATION.highest_share * full or clipped > VALIDATION.most_clipped:
            excluded.append(shot.label)
        else:
            usable.append((float(frames.mean()), (shot, entry)))
    if not usable:
        raise BadInput(
            f"a validation needs a flat inside the range with {VALIDATION.fewest_frames} frames "
            "or more, got none"
        )
    notes = [
        f"not compared: {', '.join(excluded)}, above {VALIDATION.highest_share:.0%} of full scale, "
        f"or more than {VALIDATION.most_clipped:.1%} of their pixels clip"
    ] * bool(excluded)
    usable.sort(key=lambda item: item[0])
    picked = sorted(
        {round(index) for index in np.linspace(0, len(usable) - 1, min(3, len(usable)))}
    )
    return [usable[index][1] for index in picked], notes


def point_levels(
    session: Session, chosen: MatchedStacks
) -> tuple[tuple[MatchedFrames, ...], dict[str, NDArray]]:
    """Return stacks of the point source at other levels than the compared one, at most
    `POINT_LEVELS` - 1.

    They are cut like the compared one and drawn only. Their frames come by label, shape (frame,
    row, col), DN.
    """
    if chosen.point is None:
        return (), {}
    compared, candidates = chosen.point, []
    for entry in session.of_kind("point"):
        light = _light(entry.conditions, like=compared.conditions)
        if entry.label == compared.label or light is None:
            continue
        stack = entry.read()
        fits = all(
            size <= length - first
            for size, length, first in zip(
                compared.shape, stack.shape[1:], compared.corner, strict=True
            )
        )
        if fits and len(stack) >= VALIDATION.fewest_frames:
            shot = replace(
                compared,
                label=entry.label,
                conditions=entry.conditions,
                target=entry.target,
                frames=VALIDATION.fewest_frames,
                course=(),
            )
            candidates.append(
                (light, shot, stack.region(*shot.corner, *shot.shape).data[: shot.frames])
            )
    candidates.sort(key=lambda candidate: candidate[0])
    count = POINT_LEVELS - 1
    indices = sorted(
        {round(index) for index in np.linspace(0, len(candidates) - 1, min(count, len(candidates)))}
    )
    picked = [candidates[index] for index in indices]
    return tuple(shot for _, shot, _ in picked), {
        shot.label: np.array(data) for _, shot, data in picked
    }


def _light(conditions: Conditions, *, like: Conditions) -> float | None:
    """Return the light of a stack in the unit of another one; None where it is unknown."""
    if like.illuminance_lux is not None:
        return conditions.illuminance_lux
    return conditions.photons_per_px
