"""Plan files: one dataclass for each TOML table, and sweeps of settings."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from labdata.calibration import GainTable, LampCalibration
from labdata.conditions import Conditions, conditions_of, flat_conditions, own_keys
from labdata.errors import BadInput
from labdata.limits import Override
from labdata.plan import Plan, PlanHead, SaturationSearch, Step, StopCriterion
from labdata.serialiser import from_mapping, from_toml, read_toml, to_toml
from labdata.target import Kind, Target

Order = Literal["as-written", "boustrophedon", "randomised"]
Numbers = float | tuple[float, ...]

_SHORT = {
    "mcp_v": "{:g}V",
    "luminous_gain": "gain{:g}",
    "gate_ns": "{:g}ns",
    "exposure_s": "{:g}s",
    "camera_gain_db": "{:g}dB",
    "filter_density": "nd{:g}",
    "illuminance_lux": "{:g}lux",
}
# Settings that can be swept; the outermost is the slowest and stresses the tube most
AXES = "target", *_SHORT
MOST_STEPS = 20_000  # Largest number of steps of a plan; more are an error of input


@dataclass(frozen=True, kw_only=True)
class SweepRecord:
    """One [[sweep]] of a plan file: every combination of the settings that are lists, nested in the
    order of `AXES`.
    """

    kind: Kind  #: Kind of target
    frames: int  #: Number of frames per stack
    #: Prefix of every label; the varied values and the number of the repeat follow. Default: the
    #: kind
    label: str | None = None
    target: Target | tuple[Target, ...] = field(default_factory=Target)  #: The target, or several
    mcp_v: Numbers | None = None  #: Voltage across the MCP, V; one or several
    #: Luminous gain, lm/lm, converted to volts by the gain table of the plan or its sensor; one or
    #: several
    luminous_gain: Numbers | None = None
    gate_ns: Numbers | None = None  #: Gate, ns; one or several
    exposure_s: Numbers | None = None  #: Exposure, s; one or several
    camera_gain_db: Numbers | None = None  #: Camera gain, dB; one or several
    #: Optical density of the neutral filter in front of the lamp; one or several
    filter_density: Numbers | None = None
    illuminance_lux: Numbers | None = None  #: Light, lux; one or several
    illuminance_relative_sd: float | None = None  #: Relative standard uncertainty of the light
    repeats: int = 1  #: Number of passes through the sweep
    #: "as-written": order of the lists, the last axis fastest. "boustrophedon": every inner list
    #: alternately forwards and backwards, so that no setting jumps. "randomised": every repeat
    #: shuffled separately
    order: Order = "as-written"
    seed: int = 0  #: Seed of the shuffle
    #: Number of stacks between darks, with one before the first and one after the last stack, at
    #: the settings of the adjacent stack; 0: no darks
    dark_every: int = 0
    dark_frames: int | None = None  #: Frames per dark; None: as many as per stack
    #: Criterion to stop each stack but the darks before it has all its frames; None: no criterion
    until: StopCriterion | None = None
    #: Fraction of a frame's pixels that may be saturated in each stack but the darks
    saturated_fraction: float | None = None

    def __post_init__(self) -> None:
        name = self.label or self.kind
        if not 1 <= self.repeats <= MOST_STEPS:
            raise BadInput(
                f"repeats must lie between 1 and {MOST_STEPS}, got {self.repeats} in the sweep "
                f"{name!r}"
            )
        if self.dark_every < 0 or (self.dark_every and self.kind == "dark"):
            raise BadInput(
                f"dark_every must be 0, or positive in a sweep with light, got {self.dark_every} "
                f"in {name!r}"
            )
        if self.seed < 0:
            raise BadInput(f"a seed must not be negative, got {self.seed} in the sweep {name!r}")
        if empty := [axis for axis in AXES if getattr(self, axis) == ()]:
            raise BadInput(
                f"a list must hold a value, got none for {empty[0]} in the sweep {name!r}"
            )
        if self.count > MOST_STEPS:
            raise BadInput(
                f"a sweep must have at most {MOST_STEPS} steps, got {self.count} in {name!r}"
            )

    @property
    def count(self) -> int:
        """Stacks of the sweep, darks between them not counted."""
        sizes = [len(_as_tuple(getattr(self, axis))) for axis in AXES]
        return self.repeats * int(np.prod(sizes, dtype=object))

    def steps(self) -> tuple[Step, ...]:
        """Return the steps, in order."""
        return tuple(
            self._with_darks(
                [step for repeat in range(self.repeats) for step in self._pass(repeat)]
            )
        )

    def _pass(self, repeat: int) -> Iterator[Step]:
        points = list(self._points(snake=self.order == "boustrophedon"))
        if self.order == "boustrophedon" and repeat % 2:
            points.reverse()
        if self.order == "randomised":
            order = np.random.default_rng([self.seed, repeat]).permutation(len(points))
            points = [points[index] for index in order]
        for point in points:
            yield self._step(point, repeat)

    def _points(self, *, snake: bool) -> Iterator[dict[str, int]]:
        """Indices into the lists, axis by axis."""
        sizes = [len(_as_tuple(getattr(self, axis))) for axis in AXES]
        for indices in itertools.product(*map(range, sizes)):
            yield dict(zip(AXES, _snake_order(indices, sizes) if snake else indices, strict=True))

    def _step(self, point: dict[str, int], repeat: int) -> Step:
        values = {axis: _as_tuple(getattr(self, axis))[index] for axis, index in point.items()}
        target = values.pop("target")
        return Step(
            label=self._label(point, values, repeat),
            kind=self.kind,
            frames=self.frames,
            conditions=Conditions(**values, illuminance_relative_sd=self.illuminance_relative_sd),
            target=target,
            until=self.until,
            saturated_fraction=self.saturated_fraction,
        )

    def _label(self, point: dict[str, int], values: dict[str, Any], repeat: int) -> str:
        parts = [self.label or self.kind]
        if len(_as_tuple(self.target)) > 1:
            parts.append(f"target{point['target'] + 1}")
        parts += [
            text.format(values[axis])
            for axis, text in _SHORT.items()
            if len(_as_tuple(getattr(self, axis))) > 1
        ]
        if self.repeats > 1:
            parts.append(f"r{repeat + 1}")
        return "-".join(parts)

    def _with_darks(self, lit: list[Step]) -> Iterator[Step]:
        if not self.dark_every:
            yield from lit
            return
        numbers = itertools.count(1)
        yield self._dark(lit[0], next(numbers))
        for lit_steps, step in enumerate(lit, 1):
            yield step
            if lit_steps % self.dark_every == 0 or lit_steps == len(lit):
                yield self._dark(step, next(numbers))

    def _dark(self, neighbour: Step, number: int) -> Step:
        """Return a dark at the settings of an adjacent stack."""
        without = {"illuminance_lux": 0.0, "illuminance_relative_sd": None, "filter_density": None}
        return Step(
            label=f"{self.label or self.kind}-dark{number}",
            kind="dark",
            frames=self.dark_frames or self.frames,
            conditions=replace(neighbour.conditions, **without),
        )


def _snake_order(indices: tuple[int, ...], sizes: list[int]) -> list[int]:
    """Return indices in boustrophedon order: each list runs backwards on every other pass."""
    turned, passes = [], 0
    for index, size in zip(indices, sizes, strict=True):
        turned.append(size - 1 - index if passes % 2 else index)
        passes = passes * size + index
    return turned


def _as_tuple(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


@dataclass(frozen=True, kw_only=True)
class StepRecord(Conditions):
    """One [[step]] of a plan file; the requested conditions are keys of the same table."""

    label: str  #: Label of the stack to acquire, unique in the plan
    kind: Kind  #: Kind of target
    frames: int  #: Number of frames to acquire; with `until`, the largest number
    target: Target = field(default_factory=Target)  #: The target, with the keys of its kind
    until: StopCriterion | None = None  #: Criterion to stop before all frames are acquired
    #: A search for the light that saturates; it starts at the step's own light
    search: SaturationSearch | None = None
    saturated_fraction: float | None = None  #: Fraction of a frame's pixels that may be saturated

    def step(self) -> Step:
        """Return the step that this table describes."""
        return Step(conditions=conditions_of(self), **own_keys(self, StepRecord))


@dataclass(frozen=True, kw_only=True)
class PlanFile(PlanHead):
    """A plan file."""

    override: tuple[Override, ...] = ()  #: Overridden limits of the tube, with reasons
    #: Gain calibration of the tube, needed for steps with a luminous gain, or the path of its TOML
    #: file
    gain_table: GainTable | str | None = None
    #: Calibration of the light source and its filters, or the path of its TOML file
    lamp: LampCalibration | str | None = None
    step: tuple[StepRecord, ...] = ()  #: The stacks to acquire, in order
    sweep: tuple[
        SweepRecord, ...
    ] = ()  #: Series of stacks, acquired after the single steps, in order

    def built(self) -> Plan:
        """Return the plan that this file describes."""
        if (steps := len(self.step) + sum(sweep.count for sweep in self.sweep)) > MOST_STEPS:
            raise BadInput(f"a plan must have at most {MOST_STEPS} steps, got {steps}")
        return Plan(
            **self.head,
            overrides=self.override,
            gain_table=self._read("gain_table", GainTable),
            lamp=self._read("lamp", LampCalibration),
            steps=(
                *(step.step() for step in self.step),
                *(step for sweep in self.sweep for step in sweep.steps()),
            ),
        )

    @classmethod
    def from_plan(cls, plan: Plan) -> "PlanFile":
        """Return the file form of a plan."""
        steps = (
            StepRecord(**flat_conditions(step.conditions), **own_keys(step, StepRecord))
            for step in plan.steps
        )
        return cls(
            **plan.head,
            override=plan.overrides,
            gain_table=plan.gain_table,
            lamp=plan.lamp,
            step=tuple(steps),
        )

    def _read(self, key: str, type_: type) -> Any:
        """Return a calibration given in the plan, or read the file that it names."""
        stated = getattr(self, key)
        return from_toml(stated, type_) if isinstance(stated, str) else stated


def read_plan(path: str | Path) -> Plan:
    """Read a plan file; a file that is missing or no TOML, an unknown key or an invalid value is
    BadInput.
    """
    return plan_of(read_toml(path), where=Path(path).name)


def plan_of(mapping: Mapping[str, Any], where: str = "") -> Plan:
    """Return the plan of a mapping of TOML values; `where` names its file in messages."""
    record = from_mapping(mapping, PlanFile, where)
    try:
        return record.built()
    except BadInput as error:
        raise BadInput(f"{error}, in {where}" if where else str(error)) from None


def plan_toml(plan: Plan) -> str:
    """Return a plan as TOML that `read_plan` reads."""
    return to_toml(PlanFile.from_plan(plan))
