"""How sessions and plans are written in a file: conditions lie flat in the table of their stack or step."""

from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

from labdata.adaptive import SaturationSearch, StopCriterion
from labdata.capture import LostFrames
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.gain_table import GainTable
from labdata.lamp_calibration import LampCalibration
from labdata.limits import Override
from labdata.plan import Plan, PlanHead, Step
from labdata.serialiser import from_toml
from labdata.session import Kind
from labdata.sweep import MOST_STEPS, SweepRecord
from labdata.target import Target

T = TypeVar("T")


def conditions_of(form: Conditions) -> Conditions:
    """Return the conditions alone of a table that holds them flat."""
    return Conditions(**_flat(form))


def _flat(conditions: Conditions) -> dict[str, Any]:
    return {item.name: getattr(conditions, item.name) for item in fields(Conditions)}


@dataclass(frozen=True, kw_only=True)
class StackRecord(Conditions):
    """One [[stack]] of a session file; its conditions stand flat beside the other keys.

    Parameters
    ----------
    label
        Name of the stack, unique in the session.
    kind
        What it shows.
    frames
        File or files of the frames, or a Zarr array, relative to the session's folder.
    axis
        Number (from 0) or name of the axis of the files that counts frames; by default the first.
    plane
        Plane to read of colour pictures, mosaics and files of more axes.
    asked
        Conditions asked of the instruments, where they differ from those in force.
    target
        What stood before the camera.
    finished
        False while the stack is being taken, or where its taking was broken off.
    lost_frames
        Number of the frames that the camera numbered and that are not in the record.
    lost
        Which ones they are and why, where that is known.
    doubt
        Why its frames may not show what it says, such as a bench that was made safe while they were taken.
    notes
        Remarks.
    """

    label: str
    kind: Kind
    frames: str | tuple[str, ...]
    axis: str | None = None
    plane: str | None = None
    asked: Conditions | None = None
    target: Target = field(default_factory=Target)
    finished: bool | None = None
    lost_frames: int | None = None
    lost: tuple[LostFrames, ...] = ()
    doubt: str | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SessionFile:
    """A session file, session.toml.

    Parameters
    ----------
    name
        Name of the session.
    sensor
        Name of a shipped sensor description, or the path of one relative to the session's folder.
    bit_depth
        Bits of the digitiser: full scale is 2^bits - 1.
    interlaced
        Whether the two fields of a frame were exposed one after the other.
    notes
        Remarks.
    stack
        The stacks.
    """

    name: str
    sensor: str | None = None
    bit_depth: int | None = None
    interlaced: bool | None = None
    notes: tuple[str, ...] = ()
    stack: tuple[StackRecord, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StepRecord(Conditions):
    """One [[step]] of a plan file; the conditions that it asks for stand flat beside the other keys.

    Parameters
    ----------
    label
        Label of the stack to take, unique in the plan.
    kind
        What is put before the camera.
    frames
        Number of frames to take; with `until`, at most.
    target
        The target, as its kind needs.
    until
        When to stop before all frames are taken.
    search
        A search for the light that saturates, beginning at the step's own.
    saturated_fraction
        Fraction of a frame's pixels that may be saturated.
    """

    label: str
    kind: Kind
    frames: int
    target: Target = field(default_factory=Target)
    until: StopCriterion | None = None
    search: SaturationSearch | None = None
    saturated_fraction: float | None = None

    def step(self) -> Step:
        """Return the step that this table describes."""
        return Step(
            label=self.label,
            kind=self.kind,
            frames=self.frames,
            conditions=conditions_of(self),
            target=self.target,
            until=self.until,
            search=self.search,
            saturated_fraction=self.saturated_fraction,
        )


@dataclass(frozen=True, kw_only=True)
class PlanFile(PlanHead):
    """A plan file.

    Parameters
    ----------
    override
        Limits of the tube that are set aside, with reasons.
    gain_table
        Calibration of the tube, by which steps may ask for a luminous gain, or the TOML file that holds it.
    lamp
        Calibration of the light source and of the filters before it, or the TOML file that holds it.
    step
        The stacks to take, in order.
    sweep
        Series of stacks, taken after the single steps, in order.
    """

    override: tuple[Override, ...] = ()
    gain_table: GainTable | str | None = None
    lamp: LampCalibration | str | None = None
    step: tuple[StepRecord, ...] = ()
    sweep: tuple[SweepRecord, ...] = ()

    def built(self) -> Plan:
        """Return the plan that this file describes."""
        if (steps := len(self.step) + sum(sweep.count for sweep in self.sweep)) > MOST_STEPS:
            raise BadInput(f"a plan must have at most {MOST_STEPS} steps, got {steps}")
        return Plan(
            **self.head,
            overrides=self.override,
            gain_table=_read(self.gain_table, GainTable),
            lamp=_read(self.lamp, LampCalibration),
            steps=(*(step.step() for step in self.step), *(step for sweep in self.sweep for step in sweep.steps())),
        )

    @classmethod
    def written(cls, plan: Plan) -> "PlanFile":
        """Return the file form of a plan."""
        return cls(
            **plan.head,
            override=plan.overrides,
            gain_table=plan.gain_table,
            lamp=plan.lamp,
            step=tuple(_step_form(step) for step in plan.steps),
        )


def _read(given: T | str | None, type_: type[T]) -> T | None:
    """Return a calibration that stands in the plan, or read the file that it names."""
    return from_toml(given, type_) if isinstance(given, str) else given


def _step_form(step: Step) -> StepRecord:
    return StepRecord(
        label=step.label,
        kind=step.kind,
        frames=step.frames,
        target=step.target,
        until=step.until,
        search=step.search,
        saturated_fraction=step.saturated_fraction,
        **_flat(step.conditions),
    )


def stack_record(conditions: Conditions, **keys: Any) -> StackRecord:
    """Return the table of a stack from its conditions and its other keys."""
    return StackRecord(**_flat(conditions), **keys)


FORMS: dict[type, Any] = {Plan: PlanFile}
