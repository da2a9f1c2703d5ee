"""Sharpening that an edge gives away: it overshoots its plateaus, or its neighbours' noise runs against each other."""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.pixels.grain import Grain
from charact.mtf.edge.pixels.profile import Profile
from charact.mtf.edge.thresholds import LEAST_OPPOSED, LEAST_OVERSHOOT, OVERSHOOT_SD

Array = NDArray[np.float64]

# Where an edge overshoots and where its plateaus are taken, over the frequency of MTF50, and the window of a mean, px.
NEAR, FAR, WINDOW_PX = (0.35, 1.2), (2.0, 7.0), 0.5
LEAST_BINS = 6
# Lags of neighbours that sharpening sets against each other, px: kernels reach as far.
NEIGHBOURS = 4


def overshoot_of(profile: Profile, half_frequency: float) -> float:
    """Return by how much an edge overshoots its plateaus on both sides together, share of the step; 0: it does not.

    Notes
    -----
    Light is never negative, so the spread of an edge rises from plateau to plateau, and whatever passes them was made
    afterwards. On each side the highest mean of a window near the edge is compared with a straight line through the
    plateau beyond; the sum of both counts, as light that slopes lifts one as it lowers the other.
    """
    bright, dark = (_beyond_plateau(profile, half_frequency, sign) for sign in (1.0, -1.0))
    if bright is None or dark is None:
        return 0.0
    total, error = bright[0] + dark[0], float(np.hypot(bright[1], dark[1]))
    share = total / max(abs(profile.step), 1e-300)
    return share if total > OVERSHOOT_SD * error and share > LEAST_OVERSHOOT else 0.0


def _beyond_plateau(profile: Profile, half_frequency: float, sign: float) -> tuple[float, float] | None:
    """Return the largest mean near the edge beyond the plateau of one side, and its standard error, DN."""
    away = sign * profile.distance * half_frequency
    far, near = (away > FAR[0]) & (away < FAR[1]), np.flatnonzero((away > NEAR[0]) & (away < NEAR[1]))
    if np.count_nonzero(far) < LEAST_BINS or not near.size:
        return None
    line = np.stack([np.ones(np.count_nonzero(far)), profile.distance[far]]) / np.sqrt(np.diag(profile.covariance)[far])
    through = np.linalg.solve(line @ line.T, line) / np.sqrt(np.diag(profile.covariance)[far])
    weights = np.zeros((near.size, profile.distance.size))
    for row, middle in enumerate(profile.distance[near]):
        inside = near[np.abs(profile.distance[near] - middle) < WINDOW_PX]
        weights[row, inside] = 1.0 / inside.size
        weights[row, far] -= np.array([1.0, np.mean(profile.distance[inside])]) @ through
    beyond = sign * (weights @ profile.value)
    most = weights[int(np.argmax(beyond))]
    return float(beyond.max()), float(np.sqrt(most @ profile.covariance @ most))


def noise_gain_of(grain: Grain) -> float:
    """Return by how much sharpening has raised the noise, a factor; 1: neighbours' noise does not run against it.

    Blur behind the pixels ties neighbours; only differences taken afterwards set them against each other, along rows
    and along columns alike, and leave averages over many pixels as they were.
    """
    middle = tuple(size // 2 for size in grain.correlation.shape)
    if min(middle) < 1:
        return 1.0
    reach = [slice(max(one - NEIGHBOURS, 0), one + NEIGHBOURS + 1) for one in middle]
    near = grain.correlation[reach[0], reach[1]]
    along = near[len(near) // 2], near[:, near.shape[1] // 2]
    opposed = max(float(one.sum()) for one in along) < 1.0 and near.sum() < 1.0 - LEAST_OPPOSED
    return float(max(grain.covariance_over_variance, 1e-3) ** -0.5) if opposed else 1.0
