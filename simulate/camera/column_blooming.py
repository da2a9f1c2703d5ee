"""Column blooming: charge beyond the full well drains, and the remainder spreads along its
column.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray


def apply_column_blooming(
    charge_e: NDArray[np.floating], full_well_e: float, antibloom_ratio: float
) -> tuple[NDArray[np.float64], float]:
    """Apply column blooming to the charge of one field, shape (row, col), e-.

    Parameters
    ----------
    charge_e, full_well_e
        Charge of every pixel, and what a pixel holds, e-.
    antibloom_ratio
        Overexposure that the drain of a pixel carries off, in full wells; 1 is no drain.

    Returns
    -------
    charge, drained
        Charge after overflow, shape (row, col), and all charge that left by the drains and the ends
        of the columns, e-. Together they are the charge that came in.

    Notes
    -----
    A pixel takes up to antibloom_ratio full wells: one stays, the rest drains. What is beyond goes
    half to the pixel above and half to the one below until every pixel is satisfied. The order of
    such steps does not matter (Diaconis and Fulton, Rend. Sem. Mat. Torino 49, 95, 1991).
    """
    limit = full_well_e * max(antibloom_ratio, 1.0)
    settled = np.asarray(charge_e, np.float64).copy()
    total = settled.sum()
    for col in np.flatnonzero((settled > limit).any(axis=0)):
        settled[:, col] = spread_excess_charge(settled[:, col], limit)
    settled = np.minimum(settled, full_well_e)
    return settled, float(total - settled.sum())


def spread_excess_charge(column_e: NDArray[np.float64], limit_e: float) -> NDArray[np.float64]:
    """Spread each excess half up and half down until no pixel exceeds the limit; charge leaves only
    at the ends.

    Notes
    -----
    Half up and half down is a walk: what a run of full pixels sheds arrives at its two ends in
    inverse proportion to the distance (gambler's ruin; Feller, An Introduction to Probability
    Theory, 3rd ed., XIV.2). Which pixels end up full follows from one pass along the column with a
    stack, as for a convex hull: a pixel that would then hold too much joins the run on either side
    of it. The ends of the column are pixels that take everything.
    """
    return _solve_column(np.ascontiguousarray(column_e, np.float64), float(limit_e))


@njit(cache=True)
def _solve_column(column, limit):
    count = column.size
    # Pixels that are not full so far, -1 and count the drains at the ends; of the full run below
    # each of them, the excess and its first moment about pixel 0.
    kept = np.empty(count + 2, np.int64)
    excess = np.zeros(count + 2)
    moment = np.zeros(count + 2)
    kept[0] = -1
    top = 0
    for row in range(count + 1):
        run_excess, run_moment = 0.0, 0.0
        while top > 0:
            last, before = kept[top], kept[top - 1]
            from_below = (moment[top] - excess[top] * before) / (last - before)
            from_above = (run_excess * row - run_moment) / (row - last)
            own = column[last] - limit
            if own + from_below + from_above <= 0.0:
                break
            run_excess += excess[top] + own
            run_moment += moment[top] + own * last
            top -= 1
        top += 1
        kept[top], excess[top], moment[top] = row, run_excess, run_moment
    settled = column.copy()
    for place in range(1, top + 1):
        before, last = kept[place - 1], kept[place]
        if last - before == 1:
            continue
        settled[before + 1 : last] = limit
        upward = (moment[place] - excess[place] * before) / (last - before)
        if last < count:
            settled[last] += upward
        if before >= 0:
            settled[before] += excess[place] - upward
    return settled
