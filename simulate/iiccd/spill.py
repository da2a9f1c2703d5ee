"""Charge that spreads along one column until no pixel holds more than its limit, compiled."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


def spilled(column_e: NDArray[np.float64], limit_e: float) -> NDArray[np.float64]:
    """Return a column after every excess has gone half up, half down; charge leaves only at the ends.

    Parameters
    ----------
    column_e
        Charge, shape (row,), e-.
    limit_e
        Charge that a pixel takes, e-.
    """
    return _relaxed(np.ascontiguousarray(column_e, np.float64), float(limit_e))


@njit(cache=True)
def _relaxed(column, limit):
    """Move each pixel's excess in turn, down the column and up again; over-relaxed while the pixel stays full."""
    q = column.copy()
    moved = np.zeros(q.size)
    factor = 1.9
    tolerance = 1e-9 * limit
    for _ in range(200_000):
        largest = 0.0
        for step in range(2 * q.size):
            i = step if step < q.size else 2 * q.size - 1 - step
            # Taking back no more than was ever moved keeps the result that of plain moves in any order.
            excess = max(factor * (q[i] - limit), -moved[i])
            if excess == 0.0 or (excess < 0.0 and moved[i] == 0.0):
                continue
            moved[i] += excess
            q[i] -= excess
            if i > 0:
                q[i - 1] += 0.5 * excess
            if i < q.size - 1:
                q[i + 1] += 0.5 * excess
            largest = max(largest, abs(excess))
        if largest < tolerance:
            break
    return q
