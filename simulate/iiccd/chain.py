"""Chain of camera stages: checks that neighbours fit and gives each stage its own random generator."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from labdata.errors import BadInput
from simulate.iiccd.stage_image import StageImage


@runtime_checkable
class Stage(Protocol):
    """One physical stage of the camera."""

    @property
    def name(self) -> str:
        """The stage's name; its random numbers follow from it."""
        ...

    @property
    def takes(self) -> str:
        """The quantity it takes."""
        ...

    @property
    def emits(self) -> str:
        """The quantity it emits."""
        ...

    def mean(self, light: Any) -> StageImage:
        """Return the mean image behind the stage; a lens takes the scene's radiance."""
        ...

    def draw(self, light: Any, rng: np.random.Generator) -> StageImage:
        """Return one random image behind the stage."""
        ...


@dataclass(frozen=True)
class Chain:
    """Stages in the order of the light.

    Parameters
    ----------
    stages
        Each takes what the one before it emits; names are unique.

    Raises
    ------
    BadInput
        If two neighbours do not fit or two stages share a name.
    """

    stages: tuple[Stage, ...]

    def __post_init__(self) -> None:
        if not self.stages:
            raise BadInput("a chain must have at least one stage, got none")
        for before, after in zip(self.stages, self.stages[1:], strict=False):
            if before.emits != after.takes:
                raise BadInput(
                    f"a stage must take what the one before it emits: {after.name} takes {after.takes}, "
                    f"but {before.name} emits {before.emits}"
                )
        names = [stage.name for stage in self.stages]
        if repeated := {name for name in names if names.count(name) > 1}:
            raise BadInput(f"the stages of a chain must have names of their own, got {sorted(repeated)} twice")

    def between(self, first: str, last: str) -> "Chain":
        """Return the chain from one named stage to another, both included."""
        names = [stage.name for stage in self.stages]
        if first not in names or last not in names:
            raise BadInput(f"a stage must be one of {names}, got {first!r} and {last!r}")
        return Chain(self.stages[names.index(first) : names.index(last) + 1])

    def without(self, name: str) -> "Chain":
        """Return the chain with one stage left out; refused where its neighbours then do not fit."""
        return Chain(tuple(stage for stage in self.stages if stage.name != name))

    def mean(self, light: Any) -> StageImage:
        """Return the noiseless image behind the last stage."""
        for stage in self.stages:
            light = stage.mean(light)
        return light

    def draw(self, light: Any, rng: np.random.Generator) -> StageImage:
        """Return one random image behind the last stage.

        Every stage draws from a generator that follows from `rng` and its own name: to change, add or remove one
        stage leaves the random numbers of all others as they were.
        """
        for after in self.steps(light, rng):
            light = after
        return light

    def steps(self, light: Any, rng: np.random.Generator) -> Iterator[StageImage]:
        """Yield the random image behind each stage; the random numbers are those of `draw`."""
        entropy = int(rng.integers(2**63))
        for stage in self.stages:
            child = np.random.SeedSequence(entropy, spawn_key=(zlib.crc32(stage.name.encode()),))
            light = stage.draw(light, np.random.Generator(np.random.PCG64(child)))
            yield light
