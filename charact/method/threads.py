"""Limit to one BLAS thread: the matrices are too small to benefit from more."""

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
Found = TypeVar("Found")


def with_single_blas_thread(function: Callable[Arguments, Found]) -> Callable[Arguments, Found]:
    """Return a function that runs with one BLAS thread and restores the previous number afterwards.

    Notes
    -----
    On two cores an edge takes twice as long on two threads as on one, and forty times as long when other work runs.
    """

    @wraps(function)
    def alone(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Found:
        with _libraries().limit(limits=1):
            return function(*args, **kwargs)

    return alone


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """Return the BLAS libraries of this process: NumPy's, and SciPy's, which compiled functions call."""
    import scipy.linalg  # noqa: F401  # loads its own

    return ThreadpoolController().select(user_api="blas")
