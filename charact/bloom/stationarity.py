"""Whether the frames of a stack could be exchanged: a source that moves, a tail behind it, a level that runs off."""

import numpy as np
from numpy.typing import NDArray

from charact.bloom.over_time import FrameSeries

Array = NDArray[np.float64]

# Chance of taking noise for a trend, and the least travel (px) and change of level (share) over a stack that do harm.
CHANCE = 1e-4
LEAST_TRAVEL_PX, LEAST_CHANGE = 0.3, 0.05
LEAST_FRAMES = 3


def travel_px(watched: FrameSeries) -> float:
    """How far the source moves from the first frame to the last, px; 0 where that is not told from noise."""
    row, col = watched.centre_px.T
    return float(np.hypot(_trend(row, LEAST_TRAVEL_PX), _trend(col, LEAST_TRAVEL_PX)))


def relative_drift(watched: FrameSeries) -> float:
    """Share by which light or background change steadily through the stack; 0 where that is not told from noise."""
    background = watched.background_by_frame_dn
    level = abs(float(background.mean()))
    dim = _trend(background, LEAST_CHANGE * max(level, 1.0)) / max(level, 1.0)
    return max(dim, _trend(watched.light_by_frame, LEAST_CHANGE))


def _trend(values: Array, least: float) -> float:
    """Change of the straight line through successive values from end to end if it is seen and no less than harms."""
    from scipy.stats import t

    count = len(values)
    if count < LEAST_FRAMES or not np.isfinite(values).all():
        return 0.0
    place = np.arange(count) - 0.5 * (count - 1)
    slope = float(place @ values / (place @ place))
    rest = values - values.mean() - slope * place
    error = np.sqrt(max(float(rest @ rest), 1e-12) / (count - 2) / (place @ place))
    run = abs(slope) * (count - 1)
    seen = 2.0 * float(t.sf(abs(slope) / error, count - 2)) < CHANCE
    return run if seen and run > least else 0.0
