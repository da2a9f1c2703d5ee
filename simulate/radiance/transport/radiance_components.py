"""Light at places, by what it comes from."""

import numpy as np
from numpy.typing import NDArray


class RadianceComponents:
    """Light at places (place, band), in parts by name, or all in one where nobody asks.

    Parameters
    ----------
    shape
        Places and bands.
    split
        Whether parts are kept apart.
    """

    def __init__(self, shape: tuple[int, int], *, split: bool = False) -> None:
        self.shape, self.split = shape, split
        self.found: dict[str, NDArray[np.float32]] = {}

    def add(self, name: str, which: NDArray[np.int64], light: NDArray[np.float32]) -> None:
        """Add light to a part at some places, each named once."""
        if not len(which):
            return
        key = name if self.split else ""
        if key not in self.found:
            self.found[key] = np.zeros(self.shape, np.float32)
        if len(which) == self.shape[0]:
            self.found[key] += light
        else:
            self.found[key][which] += light

    def total(self) -> NDArray[np.float32]:
        """Return all parts together."""
        return sum(self.found.values(), start=np.zeros(self.shape, np.float32))


def bounce_order(name: str) -> tuple[int, str]:
    """Return how often the light of a part (`leaving.leaving`) was reflected elsewhere, and what it comes from."""
    if not name.startswith("bounce "):
        return 0, name
    order, source = name.removeprefix("bounce ").split(" of ", 1)
    return int(order), source


def sum_by_point(
    light: NDArray[np.float32], which: NDArray[np.int64], rows: NDArray[np.int64], rays: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Add up the light of some rays at their points, which come one after the other: rows of points and light."""
    owner = which // rays
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    if len(first) == len(which):
        return rows[owner], light
    return rows[owner[first]], np.add.reduceat(light, first, axis=0)
