"""Products of neighbouring pixels of all flats and darks, pooled as noise spectra are; errors from scatter of tiles."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.gain.series import Series
from charact.noise.gain.summary import Lag, Summary, pooling
from charact.noise.stack.fields import exposures, fluctuations, runs_of
from charact.noise.stack.parts import loaded_frames
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]

# From fluctuations (exposure, row, col), DN, to their products summed over exposures, shape (tile, product), DN^2.
Products = Callable[[NDArray[np.float32]], Array]


def pooled(
    session: Session, series: Series, summary: Summary, products: Products, *, context: Context
) -> tuple[Array, Array]:
    """Return mean products per DN of signal above the dark's, shape (product,), DN, and their covariance, DN^2."""
    chosen, weight = pooling(series)
    flats, darks = ([levels[i].label for i in chosen] for levels in (series.flats, series.darks))
    share: dict[str, float] = {}
    for flat, dark, one in zip(flats, darks, weight, strict=True):
        share[flat] = share.get(flat, 0.0) + one
        share[dark] = share.get(dark, 0.0) - one
    taken = _taken(summary.lag, 2 if context.interlaced else 1)
    found = {label: _of_stack(session.stack(label), products, taken, context) for label in share}
    value = np.sum([share[label] * found[label][0] for label in share], axis=0)
    return value, np.sum([share[label] ** 2 * found[label][1] for label in share], axis=0)


def _taken(lag: Lag, fields: int) -> float:
    """Exposures' worth of noise that goes with the mean of those of the same rows: more where they share light."""
    if not lag.seen:
        return 1.0
    return 1.0 + 2.0 * float(lag.correlation[lag.lag % fields == 0].sum())


def _of_stack(entry: StackEntry, products: Products, taken: float, context: Context) -> tuple[Array, Array]:
    """Mean over tiles, runs and independent exposures, and its covariance from the scatter of the tiles."""
    stack = loaded_frames(entry)
    total, known = 0.0, 0.0
    for first, last in runs_of(stack):
        shots = exposures(stack, first, last, interlaced=context.interlaced)
        total = total + products(fluctuations(shots))
        known += len(shots.time) - taken * len(np.unique(shots.parity))
    tile = np.asarray(total) / known
    return tile.mean(axis=0), np.atleast_2d(np.cov(tile, rowvar=False)) / len(tile)
