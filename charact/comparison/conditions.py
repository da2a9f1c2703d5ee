"""Conditions of two sessions side by side, and those that make them unlike.

Stacks are matched by their conditions, those of one label first; of two series of levels the flats
and darks that have no match are left out. Two sessions are unlike if the camera differs, or if a
matched stack was acquired with another gain, gate, exposure or illumination, with another kind of
target, or from another plane of the camera. Values are alike within the tolerances of
`charact.comparison.thresholds`, illuminances also within their uncertainty.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any

from charact.comparison.thresholds import LIMITS
from charact.verdict.thresholds import LEVELS
from labdata import BadInput, Conditions, Session, StackEntry, to_mapping

GAIN_AND_TIME = (
    "mcp_v",
    "gain_control",
    "luminous_gain",
    "camera_gain_db",
    "em_gain",
    "automatic_gain",
    "brightness_control",
    "gate_ns",
    "exposure_s",
    "blackbody_c",
    "background_c",
)
# Measures of the illumination; the first that is known on both sides decides.
LIGHT = ("illuminance_lux", "photons_per_px", "filter_density", "lamp_a")
# Conditions in which the levels of one series differ.
STEPS = ("exposure_s", *LIGHT)
# Times and readings of meters; the conditions in force are compared instead.
READINGS = ("metered_time_s", "temperature_time_s", "metered_w", "metered_lux")
ABSOLUTE = {
    "camera_gain_db": LIMITS.gain_db,
    "filter_density": LIMITS.filter_density,
    "blackbody_c": LIMITS.infrared_c,
    "background_c": LIMITS.infrared_c,
}
RELATIVE = {"mcp_v": LIMITS.relative_gain_control, "gain_control": LIMITS.relative_gain_control}


@dataclass(frozen=True, kw_only=True)
class ConditionPair:
    """A property of the session or of a matched stack that differs between two sessions."""

    name: str  #: Field of the conditions, or "sensor", "bit_depth", "interlaced", "kind", "plane"
    a: Any  #: Value in the first session; None if unknown
    b: Any  #: Value in the second session; None if unknown
    stack: str | None = None  #: Label of the stack; None for the whole session
    unlike: bool = False  #: Whether measurements under the two values should not be compared


def condition_pairs(a: Session, b: Session) -> tuple[ConditionPair, ...]:
    """Return the properties in which two sessions and their matched stacks differ.

    Parameters
    ----------
    a, b
        The sessions; stacks are matched as by `pair_stacks`.

    Returns
    -------
    tuple of ConditionPair
        Those of the sessions first. A condition that is unknown on one side is listed and is not
        unlike.

    Examples
    --------
    >>> import numpy as np
    >>> from charact import session, stack
    >>> frames = np.zeros((2, 8, 8))
    >>> day1 = session([stack(frames, "dark", mcp_v=780.0)])
    >>> day2 = session([stack(frames, "dark", mcp_v=800.0)])
    >>> pairs = condition_pairs(day1, day2)
    >>> [(pair.stack, pair.name, pair.a, pair.b, pair.unlike) for pair in pairs]
    [('dark', 'mcp_v', 780.0, 800.0, True)]
    """
    return (
        *_of_cameras(a, b),
        *(pair for stack_a, stack_b in pair_stacks(a, b) for pair in _of_stacks(stack_a, stack_b)),
    )


def pair_stacks(a: Session, b: Session) -> tuple[tuple[StackEntry, StackEntry], ...]:
    """Return the stacks of two sessions that are to be compared, in the order of the first.

    Alike stacks of one label come first, then those of one kind whose known level is that of no
    other stack, then the others of one label. Flats and darks of two series of levels that differ
    in the levels alone have no partner.
    """
    partners: dict[str, StackEntry] = {}

    def pair(matches: Callable[[StackEntry, StackEntry], bool]) -> None:
        for entry in a.stacks:
            paired = {partner.label for partner in partners.values()}
            for other in b.stacks if entry.label not in partners else ():
                if other.label not in paired and matches(entry, other):
                    partners[entry.label] = other
                    break

    def of_other_steps(entry: StackEntry, other: StackEntry) -> bool:
        levels = entry.kind in ("flat", "dark") and _are_series(a, b)
        return levels and _unlike(entry, other) <= set(STEPS)

    pair(lambda entry, other: entry.label == other.label and not _unlike(entry, other))
    of_level_b = {entry.label: _of_level(entry, b) for entry in a.stacks}
    of_level_a = {entry.label: _of_level(entry, a) for entry in b.stacks}
    pair(
        lambda entry, other: (
            of_level_b[entry.label] == [other.label] and of_level_a[other.label] == [entry.label]
        )
    )
    pair(lambda entry, other: entry.label == other.label and not of_other_steps(entry, other))
    return tuple((entry, partners[entry.label]) for entry in a.stacks if entry.label in partners)


def _are_series(a: Session, b: Session) -> bool:
    """Whether both sessions have flats for a series of levels."""
    return min(len(session.of_kind("flat")) for session in (a, b)) >= LEVELS


def _of_level(entry: StackEntry, session: Session) -> list[str]:
    """Return the labels of the stacks that are alike in a level that is known."""

    def is_of_level(other: StackEntry) -> bool:
        known = [
            name
            for name in STEPS
            if None not in (getattr(entry.conditions, name), getattr(other.conditions, name))
        ]
        return (
            bool(known)
            and all(_alike(entry.conditions, other.conditions, name) for name in known)
            and not _unlike(entry, other)
        )

    return [other.label for other in session.of_kind(entry.kind) if is_of_level(other)]


def _unlike(a: StackEntry, b: StackEntry) -> set[str]:
    """Return the conditions of two stacks that are unlike."""
    return {pair.name for pair in _of_stacks(a, b) if pair.unlike}


def require_alike(a: Session, b: Session) -> None:
    """Raise BadInput if two sessions are unlike or have nothing in common: no stack, and no series
    of flats.
    """
    if differing := [pair for pair in condition_pairs(a, b) if pair.unlike]:
        first, more = differing[0], len(differing) - 1
        where = "" if first.stack is None else f" of stack {first.stack!r}"
        raise BadInput(
            f"compared sessions must be alike, got {first.name} {_format_value(first.a)} and "
            f"{_format_value(first.b)}{where}"
            + (f" and {more} more unlike conditions" if more else "")
            + "; `anyway` compares them nevertheless"
        )
    if not pair_stacks(a, b) and not any(
        _are_series(a, b) and _unlike(*flats) <= set(STEPS)
        for flats in product(a.of_kind("flat"), b.of_kind("flat"))
    ):
        raise BadInput(
            "compared sessions must have conditions or the label of a stack in common, got none; "
            "`anyway` compares the quantities of the whole session"
        )


def _format_value(value: object) -> str:
    return "unknown" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _of_cameras(a: Session, b: Session) -> Iterator[ConditionPair]:
    cameras = a.camera, b.camera
    descriptions = [
        None if camera is None else to_mapping(replace(camera, maps=None)) for camera in cameras
    ]
    if descriptions[0] != descriptions[1]:
        names = [None if camera is None else camera.name for camera in cameras]
        if names[0] == names[1]:
            names = [
                f"{name} ({which} parameters)"
                for name, which in zip(names, ("its", "other"), strict=True)
            ]
        yield ConditionPair(name="sensor", a=names[0], b=names[1], unlike=True)
    for name in ("bit_depth", "interlaced"):
        value_a, value_b = getattr(a, name), getattr(b, name)
        if value_a != value_b:
            yield ConditionPair(
                name=name, a=value_a, b=value_b, unlike=None not in (value_a, value_b)
            )


def _of_stacks(a: StackEntry, b: StackEntry) -> Iterator[ConditionPair]:
    for name in ("kind", "plane"):
        if getattr(a, name) != getattr(b, name):
            yield ConditionPair(
                name=name, a=getattr(a, name), b=getattr(b, name), stack=a.label, unlike=True
            )
    known = [
        name
        for name in LIGHT
        if None not in (getattr(a.conditions, name), getattr(b.conditions, name))
    ]
    deciding = (*GAIN_AND_TIME, *known[:1], "wavelength_nm")
    for item in fields(Conditions):
        if item.name in READINGS or _alike(a.conditions, b.conditions, item.name):
            continue
        value_a, value_b = getattr(a.conditions, item.name), getattr(b.conditions, item.name)
        unlike = item.name in deciding and None not in (value_a, value_b)
        yield ConditionPair(name=item.name, a=value_a, b=value_b, stack=a.label, unlike=unlike)


def _alike(a: Conditions, b: Conditions, name: str) -> bool:
    """Return whether two values of a condition agree within its tolerance."""
    value_a, value_b = getattr(a, name), getattr(b, name)
    if value_a == value_b or value_a is None or value_b is None or isinstance(value_a, bool):
        return value_a == value_b
    relative = RELATIVE.get(name, LIMITS.relative_setting)
    if name in ("illuminance_lux", "photons_per_px"):
        # Errors of two light meters, 95 %.
        sds = (a.illuminance_relative_sd or 0.0, b.illuminance_relative_sd or 0.0)
        relative = max(relative, 1.96 * (sds[0] ** 2 + sds[1] ** 2) ** 0.5)
    tolerance = ABSOLUTE.get(name, relative * max(abs(value_a), abs(value_b)))
    return abs(value_a - value_b) <= tolerance
