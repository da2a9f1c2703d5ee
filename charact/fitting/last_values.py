"""Functions of many draws that keep their last result."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

from charact.observables import Values
from labdata import Array


def of_last_values(*paths: str) -> Callable[[Callable[..., Array]], Callable[..., Array]]:
    """Return a decorator of a function of values, which keeps its last result for each of its other
    arguments: several observations ask it of the same draws.

    `paths`: parameters that the function depends on; none: all.
    """

    def decorate(function: Callable[..., Array]) -> Callable[..., Array]:
        last: dict[tuple[Any, ...], tuple[tuple[Array | None, ...], Array]] = {}

        @wraps(function)
        def kept(values: Values, *arguments: Any) -> Array:
            needed = tuple(values.get(path) for path in paths or values)
            known, result = last.get(arguments, ((), np.empty(0)))
            if len(known) != len(needed) or not all(map(_are_equal, known, needed)):
                result = function(values, *arguments)
                last[arguments] = needed, result
            return result

        return kept

    return decorate


def _are_equal(first: Array | None, second: Array | None) -> bool:
    if first is None or second is None:
        return first is second
    return first is second or np.array_equal(first, second)
