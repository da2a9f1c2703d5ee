"""How far light is followed."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

# More lamps than this are not all asked at places that an eye does not see: one is drawn.
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
    """How far light is followed.

    Parameters
    ----------
    bounces
        Reflections by other objects on the way from a source to the surface that the eye sees; what would need more is
        left out, so that the picture is never too bright.
    hidden_sky
        Whether objects hide the sky from surfaces; without, and without bounces, nothing is gathered.
    air_between
        Whether air weakens light between lamps and the surfaces that the eye sees.
    left_out
        Names of lamps and discs without influence.
    roulette_from
        From this bounce on a path goes on with a chance only, and counts for more; None: never.
    """

    bounces: int = 1
    hidden_sky: bool = True
    air_between: bool = True
    left_out: frozenset[str] = frozenset()
    roulette_from: int | None = None

    @property
    def gathers(self) -> bool:
        """Whether anything is gathered at all."""
        return self.hidden_sky or self.bounces > 0

    def kept(self, lights: tuple[Light, ...]) -> tuple[Light, ...]:
        """Return the lights that have influence."""
        return tuple(light for light in lights if light.name not in self.left_out)


# Does the same to several things, and gives the results in their order.
Run = Callable[[Callable[[Any], Any], list[Any]], Iterator[Any]]


def one_by_one(do: Callable[[Any], Any], things: list[Any]) -> Iterator[Any]:
    """Do them here, one after the other."""
    return map(do, things)


@contextmanager
def workers(threads: int) -> Iterator[Run]:
    """Give a way to do jobs in so many threads; they end with the block."""
    if threads < 2:
        yield one_by_one
        return
    pool = ThreadPoolExecutor(threads, thread_name_prefix="light")
    try:
        yield pool.map
    finally:
        pool.shutdown(cancel_futures=True)
