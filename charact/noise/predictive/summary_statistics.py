"""Summary statistics of frames that are not fitted: distribution of values, rows and columns, flicker, patches."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import PREDICTIVE

Array = NDArray[np.float64]

# Side of binned squares, px: finer detail depends on the blur beyond the fitted frequencies.
SIDE_PX = 4


@dataclass(frozen=True, kw_only=True)
class SummaryStatistic:
    """A summary statistic of frames.

    Parameters
    ----------
    words
        Description.
    harmless
        Tolerated deviation.
    upwards
        Whether only an excess counts.
    """

    words: str
    harmless: float
    upwards: bool = False


STATISTICS: dict[str, SummaryStatistic] = {
    "variance": SummaryStatistic(words=f"logarithm of the variance of {SIDE_PX} x {SIDE_PX} px", harmless=0.06),
    "beside": SummaryStatistic(words="correlation of neighbouring squares of a row", harmless=0.03),
    "below": SummaryStatistic(words="correlation of neighbouring squares of a column", harmless=0.03),
    "skewness": SummaryStatistic(words="skewness of the squares", harmless=0.06),
    "tail": SummaryStatistic(
        words="height of the highest 0.1 % of the squares over their standard deviation", harmless=0.15
    ),
    "patches": SummaryStatistic(
        words="logarithm of the scatter of the variance over the image", harmless=0.4, upwards=True
    ),
    "rows": SummaryStatistic(words="logarithm of the variance of row means", harmless=0.3, upwards=True),
    "columns": SummaryStatistic(words="logarithm of the variance of column means", harmless=0.3, upwards=True),
    "flicker": SummaryStatistic(words="logarithm of the variance of frame means", harmless=0.5, upwards=True),
    "successive": SummaryStatistic(words="correlation of successive exposures", harmless=0.04),
}


def summary_statistics(frames: Array) -> dict[str, float]:
    """Return the summary statistics of exposures of one parity.

    Parameters
    ----------
    frames
        Pixels, shape (exposure, row, col), DN; rows and columns in multiples of `SIDE_PX`.
    """
    count, rows, cols = frames.shape
    squares = frames.reshape(count, rows // SIDE_PX, SIDE_PX, cols // SIDE_PX, SIDE_PX).mean(axis=(2, 4))
    change = squares - squares.mean(axis=0)
    whole = change.mean(axis=(1, 2))
    change -= whole[:, None, None]
    power = max(float(np.mean(change**2)), 1e-30)
    found = {
        "variance": np.log(power),
        "beside": np.mean(change[:, :, 1:] * change[:, :, :-1]) / power,
        "below": np.mean(change[:, 1:] * change[:, :-1]) / power,
        "skewness": np.mean(change**3) / power**1.5,
        "tail": np.quantile(change, PREDICTIVE.tail_quantile) / np.sqrt(power),
        "patches": _log_variance(_patches(change**2) / power),
        "rows": _log_variance(change.mean(axis=2)),
        "columns": _log_variance(change.mean(axis=1)),
    }
    if count >= PREDICTIVE.min_exposures:
        found["flicker"] = _log_variance(whole)
        found["successive"] = np.mean(change[1:] * change[:-1]) / power
    return {name: float(value) for name, value in found.items()}


def _patches(square: Array) -> Array:
    """Return means over patches and exposures."""
    rows, cols = (length // PREDICTIVE.patch for length in square.shape[1:])
    cut = square[:, : rows * PREDICTIVE.patch, : cols * PREDICTIVE.patch].mean(axis=0)
    return cut.reshape(rows, PREDICTIVE.patch, cols, PREDICTIVE.patch).mean(axis=(1, 3))


def _log_variance(values: Array) -> float:
    return float(np.log(max(float(np.var(values)), 1e-30)))
