"""Kind and conditions of frames by the headers of their files."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.importers import module_of, read_conditions, read_frames
from labdata.importers.fits import header_of
from labdata.target import Kind

# Cards of the kind, the usual one first; SBFITSEXT 1.0 and its followers.
KIND_CARDS = ("IMAGETYP", "IMAGETYPE", "OBSTYPE", "FRAMETYP")
# Settings that change gain and level by amounts that no condition states: all frames of a session
# must share them.
CAMERA_CARDS = ("INSTRUME", "READOUTM", "GAIN", "OFFSET", "XBINNING", "YBINNING")
# Settings that all frames of a stack must share.
SETTING_CARDS = (*CAMERA_CARDS, "FILTER")
# A dark of a flat is a dark.
KIND_WORDS: dict[str, Kind] = {
    "dark": "dark",
    "bias": "dark",
    "zero": "dark",
    "flat": "flat",
    "light": "scene",
    "object": "scene",
}
# Temperatures further apart are those of different stacks, K: regulation and readings differ by
# some tenths.
SAME_TEMPERATURE_K = 1.0
# Settings of a header and of a session that differ by a smaller fraction are one setting, rounded.
SAME_SETTING = 0.01
# Flats whose mean levels differ by more are those of different light; a lamp drifts less.
SAME_LEVEL = 0.02


@dataclass(frozen=True, kw_only=True)
class StatedFrame:
    """What the header of a file with a single frame states.

    `kind`: None unless stated; `conditions`: those of its header; `settings`: the cards of
    `SETTING_CARDS` as text; `mean_dn`: mean level.
    """

    path: Path
    kind: Kind | None
    conditions: Conditions
    settings: dict[str, str]
    mean_dn: float


def read_stated_frame(
    path: Path, plane: str | None = None, extension: str | None = None
) -> StatedFrame | None:
    """Return what a FITS file of one frame states; None for other files, and where it states
    neither kind nor exposure.

    A file that cannot be read is BadInput; `plane`, `extension`: what to read of it.
    """
    if module_of(path) != "fits.read":
        return None
    frames = read_frames(path, plane, axis="frame", extension=extension, find_full_scale=False)
    header = header_of(path, extension)
    word = str(next((header[card] for card in KIND_CARDS if card in header), "")).lower()
    kind: Kind | None = next((of for name, of in KIND_WORDS.items() if name in word), None)
    conditions, _ = read_conditions(path, extension)
    if len(frames.data) > 1 or (kind is None and conditions.exposure_s is None):
        return None
    return StatedFrame(
        path=path,
        kind=kind,
        conditions=conditions,
        settings={card: str(header[card]).strip() for card in SETTING_CARDS if card in header},
        mean_dn=float(frames.data.mean(dtype=np.float64)),
    )


def require_one_camera(files: Sequence[tuple[Path, str | None]]) -> None:
    """Require every FITS file of a session, given with its extension, to have the same settings of
    `CAMERA_CARDS`; another is BadInput.
    """
    headers = {
        path: header_of(path, extension)
        for path, extension in files
        if module_of(path) == "fits.read"
    }
    for card in CAMERA_CARDS:
        first: dict[str, str] = {}
        for path, header in headers.items():
            first.setdefault(str(header.get(card, "none")).strip(), path.name)
        if len(first) > 1:
            shown = " and ".join(f"{value!r} in {name}" for value, name in list(first.items())[:2])
            raise BadInput(
                f"all frames of a session must have one {card}, got {shown}: import each into its "
                "own session"
            )


def with_headers(
    conditions: Conditions, paths: Sequence[Path], *, label: str, extension: str | None = None
) -> tuple[Conditions, tuple[str, ...], tuple[str, ...]]:
    """Return the conditions of a stack, what it leaves open filled from the headers of its files.

    Parameters
    ----------
    conditions
        Conditions that the session states. They precede those of the headers.
    paths, label, extension
        Files of the stack, its name for notes, and the picture to read of each file.

    Returns
    -------
    conditions, names, notes
        The conditions, the names of those that are the headers', and notes on files that contradict
        each other or the session.
    """
    try:
        stated = [read_conditions(path, extension) for path in paths]
    except BadInput:  # the reader of the frames reports it
        return conditions, (), ()
    notes = dict.fromkeys(note for _, header_notes in stated for note in header_notes)
    values: dict[str, float] = {}
    for name, of_session in vars(conditions).items():
        numbers = [getattr(header, name) for header, _ in stated]
        numbers = [number for number in numbers if number is not None]
        if not numbers:
            continue
        low, mean, high = min(numbers), float(np.mean(numbers)), max(numbers)
        if not _is_same(name, low, high):
            text = f"the headers of stack {label!r} state {name} of {low:g} to {high:g}"
            notes[text if of_session is not None else f"{text}: not used"] = None
        elif of_session is None:
            values[name] = mean
        elif not _is_same(name, of_session, mean):
            text = f"stack {label!r} has {name} {of_session:g} by the session and {mean:g} by the"
            notes[f"{text} headers of its files: the session's is used"] = None
    return replace(conditions, **values), tuple(values), tuple(notes)


def _is_same(name: str, a: float, b: float) -> bool:
    """Whether two values of a condition are of one setting."""
    if name == "temperature_c":
        return abs(a - b) <= SAME_TEMPERATURE_K
    return abs(a - b) <= SAME_SETTING * max(abs(a), abs(b))


def group_stated(
    frames: Sequence[StatedFrame], kind: Kind | None
) -> list[tuple[str, Kind, Conditions, list[Path]]]:
    """Return label, kind, conditions and files of each stack.

    Frames of a stack share kind, exposure and filter, temperatures within `SAME_TEMPERATURE_K` and,
    of flats, levels within `SAME_LEVEL`. Its temperature is the mean.

    Parameters
    ----------
    frames
        Frames of single files.
    kind
        Kind of all stacks in place of the stated one; frames that state none are scenes.
    """
    stacks: dict[tuple, list[StatedFrame]] = {}
    for frame in frames:
        stack_kind = kind or frame.kind or "scene"
        settings = replace(frame.conditions, temperature_c=None)
        stacks.setdefault((stack_kind, settings, tuple(frame.settings.items())), []).append(frame)
    differing = [
        card for card in SETTING_CARDS if len({frame.settings.get(card) for frame in frames}) > 1
    ]
    stated_stacks = []
    for (stack_kind, settings, _), members in stacks.items():
        for warm in _split(
            members,
            lambda frame: frame.conditions.temperature_c or 0.0,
            lambda _: SAME_TEMPERATURE_K,
        ):
            levels = (
                _split(
                    warm, lambda frame: frame.mean_dn, lambda frame: SAME_LEVEL * abs(frame.mean_dn)
                )
                if stack_kind == "flat"
                else [warm]
            )
            for level in levels:
                known = [
                    frame.conditions.temperature_c
                    for frame in level
                    if frame.conditions.temperature_c is not None
                ]
                temperature_c = round(float(np.mean(known)), 2) if known else None
                conditions = replace(settings, temperature_c=temperature_c)
                parts = [
                    f"{name}={value:g}"
                    for name, value in vars(conditions).items()
                    if value is not None
                ]
                parts += [
                    f"{card}={level[0].settings[card]}"
                    for card in differing
                    if card in level[0].settings
                ]
                parts += [f"level={level[0].mean_dn:.4g}"] if len(levels) > 1 else []
                paths = sorted(frame.path for frame in level)
                stated_stacks.append(
                    (
                        " ".join([stack_kind, *parts]).replace("/", "-"),
                        stack_kind,
                        conditions,
                        paths,
                    )
                )
    return stated_stacks


Of = Callable[[StatedFrame], float]


def _split(frames: list[StatedFrame], value: Of, gap: Of) -> list[list[StatedFrame]]:
    """Return frames in the order of a value, cut where it rises by more than a gap."""
    ordered = sorted(frames, key=value)
    out = [ordered[:1]]
    for before, frame in pairwise(ordered):
        if value(frame) - value(before) > gap(before):
            out.append([])
        out[-1].append(frame)
    return out
