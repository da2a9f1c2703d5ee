"""Stacks and sessions that lie in memory."""

from dataclasses import dataclass
from pathlib import Path

from labdata import Conditions, FrameStack, StackEntry
from labdata.session import Kind


@dataclass(frozen=True, kw_only=True)
class InMemoryStack(StackEntry):
    """A stack of a session that lies in memory rather than in a file."""

    held: FrameStack

    def read(self) -> FrameStack:
        """The frames held."""
        return self.held


def in_memory_stack(kind: Kind, label: str, frames: FrameStack, lux: float) -> InMemoryStack:
    """Return a stack at the settings of an intensified camera and some illuminance."""
    conditions = Conditions(illuminance_lux=lux, mcp_v=800.0, gate_ns=1.6e7, exposure_s=0.0167)
    return InMemoryStack(
        label=label, kind=kind, frames="", conditions=conditions, folder=Path("."), held=frames
    )
