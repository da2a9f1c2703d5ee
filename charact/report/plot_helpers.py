"""Lines and points with their intervals: what most figures of evidence are made of."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.report.style import subsample

MOST_DOTS = 160


def first_array(data: Mapping[str, Any], *names: str) -> NDArray[np.float64]:
    """The first list that goes by one of the names; a KeyError names them where there is none."""
    for name in names:
        if data.get(name) is not None:
            return np.asarray(data[name], float)
    raise KeyError(" or ".join(names))


def has_all(data: Mapping[str, Any], *names: str) -> bool:
    """Whether all names hold something."""
    return all(data.get(name) is not None and np.size(data[name]) > 0 for name in names)


def plot_line(axes: Any, x: ArrayLike, y: ArrayLike, **options: Any) -> None:
    """Draw a line of at most 300 points."""
    axes.plot(*subsample(x, y), **options)


def plot_points(axes: Any, x: ArrayLike, y: ArrayLike, sd: ArrayLike | None = None, **options: Any) -> None:
    """Draw points with arms of one standard error."""
    options = {"markersize": 2.8, "linestyle": "", "marker": "o", **options}
    if sd is None:
        axes.plot(*subsample(x, y, most=MOST_DOTS), **options)
        return
    horizontal, vertical, arm = subsample(x, y, sd, most=MOST_DOTS)
    axes.errorbar(horizontal, vertical, yerr=np.abs(arm), elinewidth=0.8, **options)
