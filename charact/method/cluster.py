"""Parallel execution on the workers of a Dask scheduler, or serially in this process."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from socket import create_connection
from typing import Any

from labdata.errors import BadInput

Spread = Callable[[Callable[..., Any], Sequence[Any]], Iterable[Any]]


@contextmanager
def parallel_map(scheduler: str | None) -> Iterator[Spread]:
    """Yield a function that maps another function over parts of the work, results in order.

    `scheduler`: address of a Dask scheduler, such as "tcp://host:8786", whose workers see the session's files under the
    same paths; None: `map` in this process. Raises BadInput if Dask is not installed, no scheduler answers, or a worker
    dies.
    """
    if scheduler is None:
        yield map
        return
    try:
        from distributed import Client, KilledWorker
        from distributed.comm.addressing import get_address_host_port
    except ImportError:
        raise BadInput("--scheduler needs Dask (pip install 'charact[dask]'), which is not installed") from None
    try:
        # A client without a scheduler prints a traceback when it is garbage-collected, so the port is tried first.
        create_connection(get_address_host_port(scheduler), timeout=10.0).close()
        client = Client(scheduler, timeout=10.0, set_as_default=False)
    except (OSError, OverflowError, ValueError, TimeoutError):
        raise BadInput(f"--scheduler must be the address of a running Dask scheduler, got {scheduler!r}") from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise BadInput(f"a Dask scheduler must have at least one worker, got none at {scheduler}")
        try:
            yield lambda function, parts: _in_order(client.map(function, parts, pure=False))
        except KilledWorker as error:
            raise BadInput(f"Dask workers must survive their part of the work, got: {error}") from None


def _in_order(futures: list[Any]) -> Iterator[Any]:
    """Yield the results of futures, each released once its result has arrived."""
    while futures:
        yield futures.pop(0).result()
