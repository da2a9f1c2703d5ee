"""Single events found in dark frames: maxima that stand out of the noise, told apart from their neighbours."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.events_filters import Filter
from charact.noise.events_frames import spread

Array = NDArray[np.float64]

# An event stands out by so many standard deviations of the filtered noise: chance does that once in ten million pixels.
THRESHOLD = 5.2


@dataclass(frozen=True, kw_only=True)
class Events:
    """Events that were found.

    Parameters
    ----------
    height_dn
        Output of the filter at each, shape (event,), DN.
    threshold_dn
        The lowest output that counts.
    pixels
        Pixels that were searched, over all exposures.
    again
        Share of the events with another at the same place in the next exposure of the same rows.
    """

    height_dn: Array
    threshold_dn: float
    pixels: int
    again: float


def find_events(changes: tuple[NDArray[np.float32], ...], one: Filter) -> Events:
    """Return the local maxima of filtered exposures that stand out of the noise; borders are left out."""
    from scipy.ndimage import maximum_filter

    heights, pixels, again, least = [], 0, 0, 0.0
    for change in changes:
        value = one.of(change)
        least = THRESHOLD * spread(value)
        top = (value == maximum_filter(value, size=(1, 3, 3))) & (value > least)
        above = maximum_filter(value > least, size=(1, 3, 3))
        again += int(np.count_nonzero(top[:-1] & above[1:]))
        heights.append(value[top].astype(float))
        pixels += value.size
    found = np.concatenate(heights)
    return Events(height_dn=found, threshold_dn=least, pixels=pixels, again=again / max(len(found), 1))
