"""An acquisition plan: which stacks to take, at which settings, within which limits."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

from numpy.typing import NDArray

from labdata.adaptive import SaturationSearch, Until
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.gain_table import GainTable
from labdata.gating import Gating
from labdata.lamp import Lamp
from labdata.limits import Limits, LimitsInForce, Override, limits_in_force
from labdata.meters import Meters
from labdata.session import Kind
from labdata.target import Target

LONGEST_SETTLE_S = 86400.0
"""A wait longer than a day is a slip of the pen, s."""


Role = Literal["gate", "supply", "light-source", "filter-wheel", "light-meter", "thermometer"]
"""What an instrument is for."""


@dataclass(frozen=True, kw_only=True)
class Reached:
    """One serial instrument of the bench and how it is reached.

    Parameters
    ----------
    role
        What it is for.
    model
        Name of its model.
    port
        Serial port of it or of the adapter before it; None: not known.
    address
        GPIB address, where it stands behind an adapter.
    """

    role: Role
    model: str
    port: str | None
    address: int = 0


@dataclass(frozen=True, kw_only=True)
class Wires:
    """How the instruments are reached.

    Parameters
    ----------
    bench
        "virtual": the virtual bench's own processes on real wires. "in-process": its camera and serial lines inside
        this process, where Aravis cannot be had. "real": the ports below. On a virtual bench an instrument whose port
        is named, or a camera that is named, is a real one among virtual ones.
    gate, supply
        Models of the gate generator and of the high-voltage supply; other packages may bring further ones.
    gate_port, supply_port
        Serial ports of gate and supply, or of the adapters before them.
    light, wheel, light_meter, thermometer
        Models of the light source and of the filter wheel before it, of the light meter and of the thermometer; None:
        there is none, and a person sets the light.
    light_port, wheel_port, light_meter_port, thermometer_port
        Their serial ports.
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
    light: str | None = None
    light_port: str | None = None
    wheel: str | None = None
    wheel_port: str | None = None
    light_meter: str | None = None
    light_meter_port: str | None = None
    thermometer: str | None = None
    thermometer_port: str | None = None
    camera: str | None = None

    def __post_init__(self) -> None:
        if self.wheel is not None and self.light is None:
            raise BadInput(f"a filter wheel must stand before a light source, got the wheel {self.wheel!r} alone")

    @property
    def instruments(self) -> tuple[Reached, ...]:
        """Every serial instrument that stands at the bench; gate and supply always do."""
        optional: dict[Role, tuple[str | None, str | None]] = {
            "light-source": (self.light, self.light_port),
            "filter-wheel": (self.wheel, self.wheel_port),
            "light-meter": (self.light_meter, self.light_meter_port),
            "thermometer": (self.thermometer, self.thermometer_port),
        }
        return (
            Reached(role="gate", model=self.gate, port=self.gate_port, address=self.gate_address),
            Reached(role="supply", model=self.supply, port=self.supply_port, address=self.supply_address),
            *(Reached(role=role, model=model, port=port) for role, (model, port) in optional.items() if model),
        )

    def with_ports(self, ports: Mapping[Role, str | None]) -> "Wires":
        """Return the same wires with instruments at other ports, by their role."""
        return replace(self, **{PORT_KEYS[role]: port for role, port in ports.items()})


PORT_KEYS: dict[Role, str] = {
    "gate": "gate_port",
    "supply": "supply_port",
    "light-source": "light_port",
    "filter-wheel": "wheel_port",
    "light-meter": "light_meter_port",
    "thermometer": "thermometer_port",
}
"""Keys of the ports, by role."""


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
class Settle:
    """How long to wait after a change, before frames are taken.

    Parameters
    ----------
    after_gain_s
        After the plate's voltage was changed and verified, s.
    after_light_s
        After light, filter, gate or target were changed, s.
    """

    after_gain_s: float = 0.0
    after_light_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("after_gain_s", "after_light_s"):
            if not 0.0 <= getattr(self, name) <= LONGEST_SETTLE_S:
                raise BadInput(f"{name} must lie between 0 and {LONGEST_SETTLE_S:g}, got {getattr(self, name):g}")

    def wait_s(self, before: Conditions | None, now: Conditions) -> float:
        """Time to wait between settings, s; `before` None: nothing was set yet."""
        gain_moved = before is None or (before.mcp_v or 0.0) != (now.mcp_v or 0.0)
        return max(self.after_gain_s if gain_moved else 0.0, self.after_light_s)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """An acquisition plan.

    Parameters
    ----------
    name
        Name of the plan and of the session that it makes.
    sensor
        Name of a shipped sensor description, or the path of one.
    tube
        Name of the tube, such as its serial number, under which its dose is kept over sessions.
    seed
        Seed of the virtual bench.
    scene
        Lab scene of the virtual bench.
    wires
        How the instruments are reached.
    limits
        What the plan may never exceed, where that is tighter than the tube's limits.
    overrides
        Limits of the tube that are set aside, with reasons.
    settle
        How long to wait after a change.
    gain_table
        Calibration of the tube, by which steps may ask for a luminous gain; None: that of the sensor, if it has one.
    lamp
        Calibration of the light source and of the filters before it; a plan whose wires name a light source has one.
    meters
        How the meters beside the tube are read.
    gating
        What triggers the gate, and so whether it keeps step with the camera's fields.
    steps
        The stacks to take, in order.
    """

    name: str
    sensor: str | None = None
    tube: str | None = None
    seed: int = 0
    scene: str | None = None
    wires: Wires = field(default_factory=Wires)
    limits: Limits = field(default_factory=Limits)
    overrides: tuple[Override, ...] = ()
    settle: Settle = field(default_factory=Settle)
    gain_table: GainTable | None = None
    lamp: Lamp | None = None
    meters: Meters = field(default_factory=Meters)
    gating: Gating = field(default_factory=Gating)
    steps: tuple[Step, ...]

    def __post_init__(self) -> None:
        labels = [step.label for step in self.steps]
        if not labels:
            raise BadInput("a plan must have at least one step, got none")
        self._check_meters()
        if (self.lamp is None) != (self.wires.light is None):
            there = "none" if self.lamp is None else "one"
            raise BadInput(f"a plan must have a lamp where its wires name a light, got {there} for {self.wires.light}")
        if len(set(labels)) != len(labels):
            raise BadInput(f"every step's label must be its own, got {labels}")
        # Where a sensor is named, its own limits are known to whoever has read it; see drivers.acquisition.plan_check.
        if self.sensor is None:
            known = limits_in_force(self.limits, None, self.overrides)
            for step in self.steps:
                _check_against(known, step.brightest)

    def _check_meters(self) -> None:
        for needed, role, model in (
            (self.meters.light_needed, "light_meter", self.wires.light_meter),
            (self.meters.temperature_needed, "thermometer", self.wires.thermometer),
        ):
            if needed and model is None:
                raise BadInput(f"a {role} that a plan needs must be named in its wires, got none")


def _check_against(limits: LimitsInForce, step: Step) -> None:
    """Refuse a step that asks for more than is allowed, in a BadInput that names setting and limit."""
    bounds = {
        "mcp_v": limits.mcp_v,
        "illuminance_lux": limits.largest_lux(point=step.kind == "point"),
        "gate_ns": limits.gate_ns,
    }
    for name, limit in bounds.items():
        asked = getattr(step.conditions, name)
        if asked is not None and asked > limit:
            raise BadInput(f"{name} of step {step.label!r} must not exceed the limit {limit:g}, got {asked:g}")


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
