"""Functions of many draws that keep their last result."""

import operator
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

from charact.observables import Values
from labdata import Array


def of_last_values(function: Callable[..., Array]) -> Callable[..., Array]:
    """Return a function of values that keeps its last result for each of its other arguments:
    several observations ask it of the same draws.
    """
    last: dict[tuple[Any, ...], tuple[tuple[Array, ...], Array]] = {}

    @wraps(function)
    def kept(values: Values, *arguments: Any) -> Array:
        needed = tuple(values.values())
        known, result = last.get(arguments, ((), np.empty(0)))
        if len(known) != len(needed) or not all(map(operator.is_, known, needed)):
            result = function(values, *arguments)
            last[arguments] = needed, result
        return result

    return kept
