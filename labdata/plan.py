"""An acquisition plan: which stacks to take, at which settings, within which limits."""

from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

from numpy.typing import NDArray

from labdata.adaptive import SaturationSearch, StopCriterion
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frame_format import FrameFormat
from labdata.gain_table import GainTable
from labdata.gating import Gating
from labdata.instrument_config import InstrumentConfig
from labdata.lamp_calibration import LampCalibration
from labdata.limits import Limits, LimitsInForce, Override, limits_in_force
from labdata.meters import Meters
from labdata.session import Kind
from labdata.target import Target

LONGEST_SETTLE_S = 86400.0
"""A wait longer than a day is a slip of the pen, s."""

POINT_SATURATION = 0.3
"""Fraction of a frame's pixels that a bright point may saturate with its halo and streaks; room light fills it all."""


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
    saturated_fraction
        Fraction of a frame's pixels that may be saturated; with 0.05 more the tube is made safe and the run ends.
        None: 0, of a point 0.3 and of a search 1.
    """

    label: str
    kind: Kind
    frames: int
    conditions: Conditions
    target: Target = field(default_factory=Target)
    until: StopCriterion | None = None
    search: SaturationSearch | None = None
    saturated_fraction: float | None = None

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise BadInput(f"a step must take at least one frame, got {self.frames} in {self.label!r}")
        if self.until is not None and self.until.least_frames > self.frames:
            raise BadInput(
                f"least_frames must not exceed the frames of its step, got {self.until.least_frames} of {self.frames} "
                f"in {self.label!r}"
            )
        if self.saturated_fraction is not None and not 0.0 <= self.saturated_fraction <= 1.0:
            raise BadInput(
                f"saturated_fraction must lie between 0 and 1, got {self.saturated_fraction:g} in {self.label!r}"
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
        return replace(
            self, label=label, conditions=conditions, search=None, saturated_fraction=self.max_saturated_fraction
        )

    @property
    def max_saturated_fraction(self) -> float:
        """Fraction of a frame's pixels that may be saturated."""
        if self.saturated_fraction is not None:
            return self.saturated_fraction
        return 1.0 if self.search is not None else POINT_SATURATION if self.kind == "point" else 0.0


@dataclass(frozen=True, kw_only=True)
class SettleTimes:
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
class PlanHead:
    """What a plan says of itself and of its bench, in a file as in memory.

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
    settle
        How long to wait after a change.
    meters
        How the meters beside the tube are read.
    gating
        What triggers the gate, and so whether it keeps step with the camera's fields.
    picture
        What is asked of the camera for all steps, where that is not the whole sensor in 8 or 16 bits.
    """

    name: str
    sensor: str | None = None
    tube: str | None = None
    seed: int = 0
    scene: str | None = None
    wires: InstrumentConfig = field(default_factory=InstrumentConfig)
    limits: Limits = field(default_factory=Limits)
    settle: SettleTimes = field(default_factory=SettleTimes)
    meters: Meters = field(default_factory=Meters)
    gating: Gating = field(default_factory=Gating)
    picture: FrameFormat = field(default_factory=FrameFormat)

    @property
    def head(self) -> dict[str, Any]:
        """All of this by name."""
        return {item.name: getattr(self, item.name) for item in fields(PlanHead)}


@dataclass(frozen=True, kw_only=True)
class Plan(PlanHead):
    """An acquisition plan.

    Parameters
    ----------
    overrides
        Limits of the tube that are set aside, with reasons.
    gain_table
        Calibration of the tube, by which steps may ask for a luminous gain; None: that of the sensor, if it has one.
    lamp
        Calibration of the light source and of the filters before it; a plan whose wires name a light source has one.
    steps
        The stacks to take, in order.
    """

    overrides: tuple[Override, ...] = ()
    gain_table: GainTable | None = None
    lamp: LampCalibration | None = None
    steps: tuple[Step, ...]

    def __post_init__(self) -> None:
        labels = [step.label for step in self.steps]
        if not labels:
            raise BadInput("a plan must have at least one step, got none")
        if self.seed < 0:
            raise BadInput(f"a seed must not be negative, got {self.seed} in the plan {self.name!r}")
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
