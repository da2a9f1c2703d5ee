"""An acquisition plan: which stacks to take, at which settings, within which limits."""

from dataclasses import dataclass, field
from typing import Literal, Protocol

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.session import Kind
from labdata.target import Target


@dataclass(frozen=True, kw_only=True)
class Wires:
    """How the instruments are reached.

    Parameters
    ----------
    bench
        "virtual": the virtual bench's own processes on real wires. "in-process": its camera and serial lines inside
        this process, where Aravis cannot be had. "real": the ports below.
    gate_port, supply_port
        Serial ports of the delay generator and of the high-voltage supply's adapter.
    supply_address
        GPIB address of the supply behind its adapter.
    camera
        Aravis camera identifier.
    """

    bench: Literal["virtual", "in-process", "real"] = "virtual"
    gate_port: str | None = None
    supply_port: str | None = None
    supply_address: int = 14
    camera: str | None = None


@dataclass(frozen=True, kw_only=True)
class Step:
    """One stack to take. Conditions are what is asked."""

    label: str
    kind: Kind
    frames: int
    conditions: Conditions
    target: Target = field(default_factory=Target)

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise BadInput(f"a step must take at least one frame, got {self.frames} in {self.label!r}")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the plan may never exceed; checked in full before anything is switched on."""

    mcp_v: float = 900.0
    illuminance_lux: float = 1e-2
    point_illuminance_lux: float = 10.0  # inside the image of a pinhole, which is too small to strain the whole tube
    gate_ns: float = 2e7
    ramp_v_per_s: float = 50.0

    def check(self, step: Step) -> None:
        """Refuse a step that asks for more than is allowed, in a BadInput that names setting and limit."""
        light = "point_illuminance_lux" if step.kind == "point" else "illuminance_lux"
        for name, bound in (("mcp_v", "mcp_v"), ("illuminance_lux", light), ("gate_ns", "gate_ns")):
            asked, limit = getattr(step.conditions, name), getattr(self, bound)
            if asked is not None and asked > limit:
                raise BadInput(f"{name} of step {step.label!r} must not exceed the limit {limit:g}, got {asked:g}")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """An acquisition plan."""

    name: str
    sensor: str | None = None
    seed: int = 0
    scene: str | None = None
    wires: Wires = field(default_factory=Wires)
    limits: Limits = field(default_factory=Limits)
    steps: tuple[Step, ...]

    def __post_init__(self) -> None:
        labels = [step.label for step in self.steps]
        if not labels:
            raise BadInput("a plan must have at least one step, got none")
        if len(set(labels)) != len(labels):
            raise BadInput(f"every step's label must be its own, got {labels}")
        for step in self.steps:
            self.limits.check(step)


class Judge(Protocol):
    """A higher room's judgement of a stack while it is taken."""

    def complaint(self, stack: FrameStack, step: Step) -> str | None:
        """Return one sentence on what is wrong with the stack, or None."""
        ...
