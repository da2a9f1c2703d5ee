"""Sessions whose stacks lie in memory."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from labdata import Conditions, FrameStack, Kind, LoadedStackEntry, Session, StackEntry


def stack_in_memory(
    kind: Kind,
    frames: FrameStack,
    conditions: Conditions | None = None,
    *,
    label: str | None = None,
    **fields: Any,
) -> LoadedStackEntry:
    """Return a stack of a session that is in no file; its label is its kind if none is given."""
    return LoadedStackEntry(
        label=label or kind,
        kind=kind,
        frames=label or kind,
        conditions=conditions or Conditions(),
        folder=Path(),
        kept=frames,
        **fields,
    )


def tube_stack(kind: Kind, label: str, frames: FrameStack, lux: float) -> LoadedStackEntry:
    """Return a stack at the settings of an intensified camera and some illuminance."""
    conditions = Conditions(illuminance_lux=lux, mcp_v=800.0, gate_ns=1.6e7, exposure_s=0.0167)
    return stack_in_memory(kind, frames, conditions, label=label)


def session_in_memory(
    stacks: Iterable[StackEntry], *, name: str = "in memory", **fields: Any
) -> Session:
    """Return a session of stacks, without a folder."""
    return Session(folder=Path(), name=name, stacks=tuple(stacks), **fields)
