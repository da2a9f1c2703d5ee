"""Acquisition plan: steps, settings, adaptive steps and calibrated gain."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

from numpy.typing import NDArray

from labdata.calibration import GainTable, LampCalibration
from labdata.camera.description import Camera
from labdata.capture import PIXEL_BITS
from labdata.conditions import Conditions
from labdata.errors import BadInput, check, check_range
from labdata.gating import Gating
from labdata.instrument_config import InstrumentConfig, Meters
from labdata.limits import Limits, LimitsInForce, Override, limits_in_force
from labdata.target import Kind, Target


@dataclass(frozen=True, kw_only=True)
class FrameFormat:
    """Frame format requested for all steps; None: as in the sensor description."""

    rows: int | None = None  #: Size of the image, px; by default the full sensor
    columns: int | None = None  #: Size of the image, px; by default the full sensor
    first_row: int | None = None  #: First row and column of the image on the sensor, px
    first_column: int | None = None  #: First row and column of the image on the sensor, px
    #: Such as "Mono12" or "Mono12p"; by default "Mono8" or "Mono16"
    pixel_format: str | None = None
    #: "off": free-running; else the camera's name of the trigger source, such as "Line1"
    trigger: str | None = None

    def __post_init__(self) -> None:
        check(
            self,
            of=" of a picture",
            one_or_more="rows columns",
            not_negative="first_row first_column",
        )
        if self.pixel_format is not None and self.pixel_format not in PIXEL_BITS:
            raise BadInput(
                f"pixel_format must be one of {', '.join(PIXEL_BITS)}, got {self.pixel_format!r}"
            )


@dataclass(frozen=True, kw_only=True)
class StopCriterion:
    """Criterion by which a step stops before it has all its frames."""

    #: Largest half-width of the 95 % interval of the stack's mean at which the step stops, DN
    mean_within_dn: float
    least_frames: int = 8  #: Smallest number of frames

    def __post_init__(self) -> None:
        check(self, positive="mean_within_dn")
        if self.least_frames < 4:
            raise BadInput(f"least_frames must be at least 4, got {self.least_frames}")


@dataclass(frozen=True, kw_only=True)
class SaturationSearch:
    """Search for the light that saturates a stack: doubling, then bisection of the logarithm."""

    most_illuminance_lux: float  #: Upper limit of the light, lux
    #: Largest gap between the highest unsaturated and the lowest saturated light at the end, %
    within_percent: float = 10.0

    def __post_init__(self) -> None:
        check(self, positive="most_illuminance_lux within_percent")

    def next_lux(self, begin_lux: float, seen: Sequence[tuple[float, bool]]) -> float | None:
        """Return the light to try next, lux, after levels and whether each saturated; None when the
        search is over.
        """
        dark = max((lux for lux, saturated in seen if not saturated), default=None)
        bright = min((lux for lux, saturated in seen if saturated), default=None)
        if not seen:
            return begin_lux
        if bright is None:
            return (
                None
                if dark == self.most_illuminance_lux
                else min(2.0 * (dark or 0.0), self.most_illuminance_lux)
            )
        if dark is None:
            # No lamp can be set further below its first light.
            return bright / 2.0 if bright > begin_lux / 1024.0 else None
        return (
            None
            if bright <= dark * (1.0 + self.within_percent / 100.0)
            else math.sqrt(dark * bright)
        )

    def verdict(self, seen: Sequence[tuple[float, bool]]) -> str:
        """Return the result in one sentence."""
        dark = [lux for lux, saturated in seen if not saturated]
        bright = [lux for lux, saturated in seen if saturated]
        after = f"after {len(seen)} levels"
        if not bright:
            return f"no level up to {max(dark):.4g} lux saturates, {after}"
        if not dark:
            return f"every level down to {min(bright):.4g} lux saturates, {after}"
        return f"saturation begins between {max(dark):.4g} and {min(bright):.4g} lux, {after}"

    def most_levels(self, begin_lux: float) -> int:
        """Return the largest number of levels of a search whose first level does not saturate."""
        doublings = max(0, math.ceil(math.log2(self.most_illuminance_lux / begin_lux)))
        return (
            1
            + doublings
            + max(0, math.ceil(math.log2(math.log(2.0) / math.log1p(self.within_percent / 100.0))))
        )


@dataclass(frozen=True, kw_only=True)
class Step:
    """One stack to acquire."""

    label: str  #: Name of the stack, and kind of target
    kind: Kind  #: Name of the stack, and kind of target
    frames: int  #: Frames to acquire; with `until`, the largest number
    conditions: Conditions  #: Set-points of the instruments
    target: Target = field(default_factory=Target)  #: Target in front of the camera
    #: Criterion to stop before all frames are acquired; None: no criterion
    until: StopCriterion | None = None
    #: Search for the light that saturates, one stack per level; None: a single stack
    search: SaturationSearch | None = None
    #: Fraction of a frame's pixels that may be saturated; 0.05 more forces the safe state and ends
    #: the run. None: 0, for a point 0.3, for a search 1
    saturated_fraction: float | None = None

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise BadInput(
                f"a step must take at least one frame, got {self.frames} in {self.label!r}"
            )
        if self.until is not None and self.until.least_frames > self.frames:
            raise BadInput(
                "least_frames must not exceed the frames of its step, got "
                f"{self.until.least_frames} of {self.frames} in {self.label!r}"
            )
        check_range(self, 0.0, 1.0, "saturated_fraction", of=f" in {self.label!r}")
        if self.search is not None:
            self._check_search(self.search)

    def _check_search(self, search: SaturationSearch) -> None:
        begin_lux = self.conditions.illuminance_lux
        if self.kind != "flat":
            raise BadInput(
                f"a search for saturation must be on a flat, got a {self.kind} in {self.label!r}"
            )
        if not begin_lux or begin_lux > search.most_illuminance_lux:
            raise BadInput(
                "a search for saturation must begin with light up to "
                f"{search.most_illuminance_lux:g} lux, got {begin_lux} in {self.label!r}"
            )

    @property
    def brightest(self) -> "Step":
        """The step at its largest illuminance, for the check of limits."""
        if self.search is None:
            return self
        return self.level(self.search.most_illuminance_lux, self.label)

    @property
    def most_frames(self) -> int:
        """Largest number of frames."""
        if self.search is None:
            return self.frames
        return self.frames * self.search.most_levels(self.conditions.illuminance_lux or 0.0)

    def level(self, illuminance_lux: float, label: str) -> "Step":
        """Return one level of a search: a stack at one illuminance."""
        conditions = replace(self.conditions, illuminance_lux=illuminance_lux)
        return replace(
            self,
            label=label,
            conditions=conditions,
            search=None,
            saturated_fraction=self.max_saturated_fraction,
        )

    @property
    def max_saturated_fraction(self) -> float:
        """Fraction of a frame's pixels that may be saturated."""
        if self.saturated_fraction is not None:
            return self.saturated_fraction
        # Fraction of pixels that a bright point, its halo and streaks may saturate; room light
        # saturates all pixels
        return 1.0 if self.search is not None else 0.3 if self.kind == "point" else 0.0


@dataclass(frozen=True, kw_only=True)
class SettleTimes:
    """Settle times after a change of settings."""

    after_gain_s: float = 0.0  #: Time after the MCP voltage was changed and verified, s
    after_light_s: float = 0.0  #: Time after a change of light, filter, gate or target, s

    def __post_init__(self) -> None:
        check_range(self, 0.0, 86400.0, "after_gain_s", "after_light_s")  # one day

    def wait_s(self, before: Conditions | None, now: Conditions) -> float:
        """Return the settle time between two settings, s; `before` None: nothing was set yet."""
        gain_moved = before is None or (before.mcp_v or 0.0) != (now.mcp_v or 0.0)
        return max(self.after_gain_s if gain_moved else 0.0, self.after_light_s)


@dataclass(frozen=True, kw_only=True)
class PlanHead:
    """Keys common to a plan and its file record."""

    name: str  #: Name of the plan and of its session
    sensor: str | None = None  #: Name of a shipped sensor description, or path of one
    tube: str | None = None  #: Name of the tube, such as its serial number; names its dose ledger
    seed: int = 0  #: Seed of the virtual bench
    scene: str | None = None  #: Lab scene of the virtual bench
    #: Models and ports of the instruments
    wires: InstrumentConfig = field(default_factory=InstrumentConfig)
    #: Limits of the plan, where tighter than those of the tube
    limits: Limits = field(default_factory=Limits)
    settle: SettleTimes = field(default_factory=SettleTimes)  #: Settle times after a change
    meters: Meters = field(default_factory=Meters)  #: Use of the auxiliary meters
    #: Trigger of the gate, and its synchronisation with the camera's fields
    gating: Gating = field(default_factory=Gating)
    #: Frame format of all steps, where not the full sensor in 8 or 16 bits
    picture: FrameFormat = field(default_factory=FrameFormat)

    @property
    def head(self) -> dict[str, Any]:
        """Values of these keys by name."""
        return {item.name: getattr(self, item.name) for item in fields(PlanHead)}


@dataclass(frozen=True, kw_only=True)
class Plan(PlanHead):
    """An acquisition plan."""

    overrides: tuple[Override, ...] = ()  #: Overridden limits of the tube, with reasons
    #: Gain calibration of the tube, needed for steps with a luminous gain; None: that of the
    #: sensor, if any
    gain_table: GainTable | None = None
    #: Calibration of the light source and its filters; required if the wires name a light source
    lamp: LampCalibration | None = None
    steps: tuple[Step, ...]  #: The stacks to acquire, in order

    def __post_init__(self) -> None:
        labels = [step.label for step in self.steps]
        if not labels:
            raise BadInput("a plan must have at least one step, got none")
        if self.seed < 0:
            raise BadInput(
                f"a seed must not be negative, got {self.seed} in the plan {self.name!r}"
            )
        self._check_meters()
        if (self.lamp is None) != (self.wires.light is None):
            calibrations = "none" if self.lamp is None else "one"
            raise BadInput(
                f"a plan must have a lamp where its wires name a light, got {calibrations} for "
                f"{self.wires.light}"
            )
        if len(set(labels)) != len(labels):
            raise BadInput(f"every step's label must be its own, got {labels}")
        # The limits of a named sensor are checked by drivers.acquisition.plan_check, which has read
        # the sensor.
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
    """Require the settings of a step to lie within the limits."""
    bounds = {
        "mcp_v": limits.mcp_v,
        "illuminance_lux": limits.largest_lux(point=step.kind == "point"),
        "gate_ns": limits.gate_ns,
    }
    for name, limit in bounds.items():
        asked = getattr(step.conditions, name)
        if asked is not None and asked > limit:
            raise BadInput(
                f"{name} of step {step.label!r} must not exceed the limit {limit:g}, got {asked:g}"
            )


class Watcher(Protocol):
    """Assessment of one stack during acquisition; implemented in a higher layer."""

    def see(self, pixels: NDArray) -> None:
        """Take the next frame, shape (row, col), DN."""

    def enough(self) -> str | None:
        """Return a sentence if the criterion of the step is met, else None."""
        ...

    def is_saturated(self) -> bool:
        """Whether the frames so far are saturated."""
        ...

    def complaint(self) -> str | None:
        """Return a sentence on a fault of the stack, or None."""
        ...


class Judge(Protocol):
    """Factory of watchers; passed in from a higher layer."""

    def watch(self, step: Step, full_scale_dn: float) -> Watcher:
        """Return the watcher of one stack; `full_scale_dn` is the full scale of the digitiser,
        DN.
        """
        ...


SETTABLE_V = 1.0  # Voltage step that every supply can set, V
# Settling tolerance of a supply: a read-back may exceed the end of the table by this, V
READ_V = 2.0


def gain_table_of(plan: Plan, sensor: Camera | None) -> GainTable | None:
    """Return the gain table of a plan, else that of its sensor, else None."""
    if plan.gain_table is not None:
        return plan.gain_table
    return None if sensor is None else sensor.gain_table


def in_volts(plan: Plan, sensor: Camera | None) -> Plan:
    """Return the plan with every gain in volts and, where the tube is calibrated, as luminous gain.

    Raises
    ------
    BadInput
        If a step asks for a luminous gain without a table, for volts or gain outside it, or for
        both and they differ; or if the table is of another tube.
    """
    table = gain_table_of(plan, sensor)
    if table is not None and None not in (table.tube, plan.tube) and table.tube != plan.tube:
        raise BadInput(
            f"a gain table must be of the plan's tube {plan.tube!r}, got one of {table.tube!r}"
        )
    return replace(plan, steps=tuple(_resolve_gain(step, table) for step in plan.steps))


def by_calibration(table: GainTable | None, mcp_v: float | None) -> Conditions:
    """Return the luminous gain at a read-back voltage, V; empty without a table or with the MCP
    off.
    """
    if table is None or not mcp_v or mcp_v < table.mcp_v[0] - READ_V:
        return Conditions()
    gain, relative_sd = table.gain_at(mcp_v, beyond_v=READ_V)
    return Conditions(luminous_gain=gain, luminous_gain_relative_sd=relative_sd)


def _resolve_gain(step: Step, table: GainTable | None) -> Step:
    asked = step.conditions
    if table is None:
        if asked.luminous_gain is not None:
            raise BadInput(
                f"luminous_gain must have a gain table in the plan or its sensor, got none in "
                f"step {step.label!r}"
            )
        return step
    try:
        return replace(step, conditions=_both(asked, table))
    except BadInput as error:
        raise BadInput(f"{error}, in step {step.label!r}") from None


def _both(asked: Conditions, table: GainTable) -> Conditions:
    """Return conditions with the voltage that gives the luminous gain; a given voltage must lie in
    the table.
    """
    if asked.luminous_gain is None:
        if asked.mcp_v:
            table.gain_at(asked.mcp_v)
        return asked
    volts = round(table.volts_for(asked.luminous_gain) / SETTABLE_V) * SETTABLE_V
    if asked.mcp_v is not None and asked.mcp_v != volts:
        raise BadInput(
            f"mcp_v must be left out or be what luminous_gain {asked.luminous_gain:g} needs by "
            f"the gain table, {volts:g}, got {asked.mcp_v:g}"
        )
    return replace(asked, mcp_v=volts)
