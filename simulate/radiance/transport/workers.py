"""Parts of a picture in several threads: rays and most of the arithmetic hold no interpreter's lock."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

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
