"""Blooming in the CCD: charge beyond the full well goes down the drain, and what the drain leaves along the column."""

import numpy as np
from numpy.typing import NDArray


def apply_column_blooming(
    charge_e: NDArray[np.floating], full_well_e: float, antibloom_ratio: float
) -> tuple[NDArray[np.float64], float]:
    """Let the charge of one field overflow.

    Parameters
    ----------
    charge_e
        Charge of every pixel of a field, shape (row, col), e-.
    full_well_e
        Charge a pixel holds, e-.
    antibloom_ratio
        Overexposure that the drain of a pixel carries off, in full wells; 1 is no drain.

    Returns
    -------
    charge, drained
        Charge after overflow, shape (row, col), and all charge that left by the drains and the ends of the columns, e-.
        Together they are the charge that came in.

    Notes
    -----
    A pixel takes up to antibloom_ratio full wells: one stays, the rest drains. What is beyond goes half to the pixel
    above and half to the one below until every pixel is satisfied. The order of such steps does not matter
    (Diaconis and Fulton, Rend. Sem. Mat. Torino 49, 95, 1991).
    """
    limit = full_well_e * max(antibloom_ratio, 1.0)
    settled = np.asarray(charge_e, np.float64).copy()
    total = settled.sum()
    for col in np.flatnonzero((settled > limit).any(axis=0)):
        from simulate.iiccd.blooming_solver import spread_excess_charge

        settled[:, col] = spread_excess_charge(settled[:, col], limit)
    settled = np.minimum(settled, full_well_e)
    return settled, float(total - settled.sum())
