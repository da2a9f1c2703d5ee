"""Integrator settings: which light paths are followed, and the threads that follow them."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

# With more lamps than this, points that the camera does not see sample one lamp at random.
ASKED_LAMPS = 2


class Named(Protocol):
    """A light with a name."""

    @property
    def name(self) -> str:
        """Its name."""
        ...


Light = TypeVar("Light", bound=Named)


@dataclass(frozen=True, kw_only=True)
class IntegratorSettings:
    """Which light paths are followed.

    Parameters
    ----------
    max_bounces
        Most reflections by other surfaces between a source and the surface that the camera sees. Longer paths are
        neglected, so that the bias is never positive.
    sky_shadowing
        Whether objects occlude the sky; without this and without bounces there is no final gather.
    path_air
        Whether air attenuates light between lamps and the surfaces that the camera sees.
    neglected
        Names of neglected lamps and discs.
    roulette_depth
        First bounce with Russian roulette; None: never.
    """

    max_bounces: int = 1
    sky_shadowing: bool = True
    path_air: bool = True
    neglected: frozenset[str] = frozenset()
    roulette_depth: int | None = None

    @property
    def gathers(self) -> bool:
        """Whether there is a final gather."""
        return self.sky_shadowing or self.max_bounces > 0

    def active_lights(self, lights: tuple[Light, ...]) -> tuple[Light, ...]:
        """Return the lights that are not neglected."""
        return tuple(light for light in lights if light.name not in self.neglected)


# Applies a function to a list of jobs, and yields the results in their order.
Run = Callable[[Callable[[Any], Any], list[Any]], Iterator[Any]]


def one_by_one(do: Callable[[Any], Any], things: list[Any]) -> Iterator[Any]:
    """Run jobs one after the other."""
    return map(do, things)


@contextmanager
def workers(threads: int) -> Iterator[Run]:
    """Yield a runner with `threads` threads, which end with the block."""
    if threads < 2:
        yield one_by_one
        return
    pool = ThreadPoolExecutor(threads, thread_name_prefix="light")
    try:
        yield pool.map
    finally:
        pool.shutdown(cancel_futures=True)
