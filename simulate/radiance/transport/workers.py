"""Parts of a picture in several processes: threads would not help, as a tracer holds the interpreter's lock."""

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from numpy.typing import NDArray

from simulate.radiance.transport.picture import Job, Look

Run = Callable[[Look, list[Job]], Iterator[tuple[NDArray, NDArray]]]
# Another process takes seconds to start: below so many rays, gathering counted, it does not pay.
PAYS_FROM = 1_200_000
_look: dict[str, Look] = {}


@contextmanager
def workers(processes: int) -> Iterator[Run | None]:
    """Give a way to run jobs in so many processes where that pays; they end with the block."""
    if processes < 2:
        yield None
        return
    pools: list[ProcessPoolExecutor] = []

    def run(look: Look, jobs: list[Job]) -> Iterator[tuple[NDArray, NDArray]]:
        if sum(len(job.pixels) * job.rays for job in jobs) * (1 + look.gathered) < PAYS_FROM:
            return map(look.seen, jobs)
        context = multiprocessing.get_context("spawn")
        pools.append(ProcessPoolExecutor(processes, context, initializer=_begin, initargs=(look,)))
        return pools[-1].map(_seen, jobs)

    try:
        yield run
    finally:
        for pool in pools:
            pool.shutdown(cancel_futures=True)


def _begin(look: Look) -> None:
    _look["at hand"] = look


def _seen(job: Job) -> Any:
    return _look["at hand"].seen(job)
