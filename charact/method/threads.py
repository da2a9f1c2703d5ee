"""One thread of the linear algebra library while a method works: its matrices are small, and threads wait."""

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
Found = TypeVar("Found")


def with_single_blas_thread(function: Callable[Arguments, Found]) -> Callable[Arguments, Found]:
    """Return a function that leaves the linear algebra library one thread while it works, then those it had.

    Notes
    -----
    On two cores an edge takes twice as long on two threads as on one, and forty times as long beside other work.
    """

    @wraps(function)
    def alone(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Found:
        with _libraries().limit(limits=1):
            return function(*args, **kwargs)

    return alone


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """Return the linear algebra libraries of this process: NumPy's, and SciPy's, which compiled functions call."""
    import scipy.linalg  # noqa: F401  # loads its own

    return ThreadpoolController().select(user_api="blas")
