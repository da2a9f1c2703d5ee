"""An acquisition plan: which stacks to take, at which settings, within which limits."""

from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

from numpy.typing import NDArray

from labdata.adaptive import SaturationSearch, Until
from labdata.conditions import Conditions
from labdata.errors import BadInput
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
    gate, supply
        Models of the gate generator and of the high-voltage supply; other packages may bring further ones.
    gate_port, supply_port
        Serial ports of gate and supply, or of the adapters before them.
    gate_address, supply_address
        GPIB addresses of those behind an adapter.
    camera
        Aravis identifier or IP address; "v4l2:/dev/video0" (with "#1": input 1 of a capture card); "replay:FOLDER" or
        "replay:FOLDER#LABEL": a recorded session or one of its stacks. None: the only camera there is, or the virtual
        bench's own.
    """

    bench: Literal["virtual", "in-process", "real"] = "virtual"
    gate: str = "dg645"
    supply: str = "ps350"
    gate_port: str | None = None
    supply_port: str | None = None
    gate_address: int = 15
    supply_address: int = 14
    camera: str | None = None


@dataclass(frozen=True, kw_only=True)
class Step:
    """One stack to take. Conditions are what is asked.

    Parameters
    ----------
    label, kind
        Name of the stack, and what it shows.
    frames
        Frames to take; with `until`, at most.
    conditions
        What is asked of the instruments.
    target
        What stands before the camera.
    until
        When to stop before all frames are taken; None: never.
    search
        Not one stack but a search for the light that saturates, each level a stack of its own; None: one stack.
    """

    label: str
    kind: Kind
    frames: int
    conditions: Conditions
    target: Target = field(default_factory=Target)
    until: Until | None = None
    search: SaturationSearch | None = None

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise BadInput(f"a step must take at least one frame, got {self.frames} in {self.label!r}")
        if self.until is not None and self.until.least_frames > self.frames:
            raise BadInput(
                f"least_frames must not exceed the frames of its step, got {self.until.least_frames} of {self.frames} "
                f"in {self.label!r}"
            )
        if self.search is not None:
            self._check_search(self.search)

    def _check_search(self, search: SaturationSearch) -> None:
        begin_lux = self.conditions.illuminance_lux
        if self.kind != "flat":
            raise BadInput(f"a search for saturation must be on a flat, got a {self.kind} in {self.label!r}")
        if not begin_lux or begin_lux > search.most_illuminance_lux:
            raise BadInput(
                f"a search for saturation must begin with light up to {search.most_illuminance_lux:g} lux, "
                f"got {begin_lux} in {self.label!r}"
            )

    @property
    def brightest(self) -> "Step":
        """The step under the most light that it may ask for; limits are checked on it."""
        if self.search is None:
            return self
        return self.level(self.search.most_illuminance_lux, self.label)

    @property
    def most_frames(self) -> int:
        """Frames that it takes at most."""
        if self.search is None:
            return self.frames
        return self.frames * self.search.most_levels(self.conditions.illuminance_lux or 0.0)

    def level(self, illuminance_lux: float, label: str) -> "Step":
        """Return one level of a search: one stack under one light."""
        conditions = replace(self.conditions, illuminance_lux=illuminance_lux)
        return replace(self, label=label, conditions=conditions, search=None)


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
            self.limits.check(step.brightest)


class Watcher(Protocol):
    """A higher room's judgement of one stack while it is taken."""

    def see(self, pixels: NDArray) -> None:
        """Look at the next frame, shape (row, col), DN."""
        ...

    def enough(self) -> str | None:
        """Return one sentence on why the step's `until` is reached, or None."""
        ...

    def saturated(self) -> bool:
        """Whether the frames so far are saturated."""
        ...

    def complaint(self) -> str | None:
        """Return one sentence on what is wrong with the stack, or None."""
        ...


class Judge(Protocol):
    """Who judges stacks while they are taken; handed in from a higher room."""

    def watch(self, step: Step, full_scale_dn: float) -> Watcher:
        """Begin to watch one stack; `full_scale_dn` is the highest code of the digitiser, DN."""
        ...
