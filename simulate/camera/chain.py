"""Chain of camera stages: slots, what a stage is, and each stage's own random generator."""

import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from labdata import BadInput, Conditions
from simulate.camera.stage_image import StageImage


class Slot(StrEnum):
    """Place of a stage in the chain, in the order of the light; its random numbers follow from the
    value.
    """

    OPTICS = "optics"
    PHOTOCATHODE = "photocathode"
    GAP = "gap"
    FIBRES = "taper distortion and fibre shear"
    MCP = "microchannel plate"
    PHOSPHOR = "phosphor"
    TAPER = "taper"
    SILICON = "silicon"
    PIXELS = "pixels"
    DECAY = "phosphor decay"
    SCAN = "scan"
    CCD = "ccd"
    REGISTER = "register"
    VIDEO = "video"


class Stage:
    """One physical stage: a frozen dataclass of its parameters, made by `of` from its section of a
    description.

    A stage without noise draws its mean. `effects` holds, for each effect that it may neglect, the
    values of its parameters without it; `bounds` bounds their influence on a frame.
    """

    slot: ClassVar[str]
    section: ClassVar[str]  # of the description; a camera without it lacks the stage
    effects: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    takes: str
    emits: str
    quantity: str  # what an image behind the stage shows, with its unit

    def __init_subclass__(
        cls, *, slot: str, section: str = "", takes: str = "", emits: str = "", quantity: str = ""
    ) -> None:
        cls.slot, cls.section = slot, section
        if takes:
            cls.takes, cls.emits = takes, emits
        if quantity:
            cls.quantity = quantity

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        """Return the stage of a camera under conditions."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        """Name of the stage."""
        return str(self.slot)

    def mean(self, light: Any) -> StageImage:
        """Return the mean image behind the stage; a lens takes the scene's radiance."""
        raise NotImplementedError

    def draw(self, light: Any, rng: np.random.Generator) -> StageImage:
        """Return one random image behind the stage."""
        return self.mean(light)

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of each optional effect, at most; see
        `effect_bounds.NoiseBudget`.
        """
        return {}

    def without(self, names: frozenset[str]) -> Self:
        """Return the stage without the effects of these names."""
        neutral_values = {
            key: value
            for name in names & self.effects.keys()
            for key, value in self.effects[name].items()
        }
        return replace(self, **neutral_values) if neutral_values else self  # pyright: ignore[reportArgumentType, reportCallIssue]


def stages_with_section(kinds: Iterable[type[Stage]], description: Any) -> tuple[type[Stage], ...]:
    """Return the kinds of stages whose section a description has."""
    return tuple(kind for kind in kinds if getattr(description, kind.section) is not None)


def values_of(kind: Any, section: Any, **values: Any) -> Any:
    """Return a dataclass whose fields have the values of a section's parameters of the same name,
    or others.
    """
    section_values = {
        item.name: float(value)
        if hasattr(value, "__float__") and not isinstance(value, int)
        else value
        for item in fields(kind)
        if item.name not in values and (value := getattr(section, item.name, None)) is not None
    }
    return kind(**section_values, **values)


@dataclass(frozen=True)
class Chain:
    """Stages in the order of the light.

    Raises
    ------
    BadInput
        If two neighbours do not fit or two stages share a slot.
    """

    stages: tuple[Stage, ...]  # each takes what the one before it emits; no slot is taken twice

    def __post_init__(self) -> None:
        if not self.stages:
            raise BadInput("a chain must have at least one stage, got none")
        for previous, next_stage in zip(self.stages, self.stages[1:], strict=False):
            if previous.emits != next_stage.takes:
                raise BadInput(
                    f"a stage must take what the one before it emits: {next_stage.name} takes "
                    f"{next_stage.takes}, but {previous.name} emits {previous.emits}"
                )
        names = [stage.name for stage in self.stages]
        if repeated := {name for name in names if names.count(name) > 1}:
            raise BadInput(
                f"the stages of a chain must have names of their own, got {sorted(repeated)} twice"
            )

    def __getitem__(self, slot: str) -> Any:
        """Return the stage in a slot."""
        return self.stages[self._index(slot)]

    def _index(self, slot: str) -> int:
        slots = [stage.slot for stage in self.stages]
        if slot not in slots:
            raise BadInput(
                f"a stage must be one of {[str(name) for name in slots]}, got {str(slot)!r}"
            )
        return slots.index(slot)

    def between(self, first: str, last: str) -> "Chain":
        """Return the chain from one slot to another, both included."""
        return Chain(self.stages[self._index(first) : self._index(last) + 1])

    def without(self, slot: str) -> "Chain":
        """Return the chain with one stage left out; refused where its neighbours then do not
        fit.
        """
        return Chain(tuple(stage for stage in self.stages if stage.slot != slot))

    def replacing(self, *stages: Stage) -> "Chain":
        """Return the chain with other stages in their slots."""
        replacements = {stage.slot: stage for stage in stages}
        return Chain(tuple(replacements.get(stage.slot, stage) for stage in self.stages))

    def mean(self, light: Any) -> StageImage:
        """Return the noiseless image behind the last stage."""
        for stage in self.stages:
            light = stage.mean(light)
        return light

    def draw(self, light: Any, rng: np.random.Generator) -> StageImage:
        """Return one random image behind the last stage.

        Every stage draws from a generator that follows from `rng` and its own slot: to change, add
        or remove one stage leaves the random numbers of all others as they were.
        """
        for image in self.steps(light, rng):
            light = image
        return light

    def steps(self, light: Any, rng: np.random.Generator) -> Iterator[StageImage]:
        """Yield the random image behind each stage; the random numbers are those of `draw`."""
        entropy = int(rng.integers(2**63))
        for stage in self.stages:
            child = np.random.SeedSequence(entropy, spawn_key=(zlib.crc32(stage.name.encode()),))
            light = stage.draw(light, np.random.Generator(np.random.PCG64(child)))
            yield light
