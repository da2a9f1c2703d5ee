"""Sharpening that an edge gives away: it overshoots its plateaus, or its neighbours' noise runs against each other."""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import MIN_OPPOSED, MIN_OVERSHOOT, OPPOSED_SD, OVERSHOOT_SD
from charact.mtf.mean_frame import OrientedFrame

Array = NDArray[np.float64]

# Where an edge overshoots and where its plateaus are taken, over the frequency of MTF50, and the window of a mean, px.
NEAR, FAR, WINDOW_PX = (0.35, 1.2), (2.0, 7.0), 0.5
MIN_BINS = 6
# How far sharpening sets neighbours against each other, px, and the half of all lags as far that tells both.
REACH_PX = 2
NEIGHBOURS = [
    (down, right) for down in range(REACH_PX + 1) for right in range(-REACH_PX, REACH_PX + 1) if down > 0 or right > 0
]
# Share of the step up to which a pixel is a plateau's, fewest of them, and deviations that one counts for at most.
PLATEAU, MIN_PIXELS, LARGEST_SD = 0.1, 1000, 5.0


def overshoot_of(profile: EdgeProfile, half_frequency: float) -> float:
    """Return by how much an edge overshoots its plateaus on both sides together, share of the step; 0: it does not.

    Notes
    -----
    Light is never negative, so the spread of an edge rises from plateau to plateau, and whatever passes them was made
    afterwards. On each side the highest mean of a window near the edge is compared with a straight line through the
    plateau beyond; the sum of both counts, as light that slopes lifts one as it lowers the other.
    """
    bright, dark = (_overshoot(profile, half_frequency, sign) for sign in (1.0, -1.0))
    if bright is None or dark is None:
        return 0.0
    total, error = bright[0] + dark[0], float(np.hypot(bright[1], dark[1]))
    share = total / max(abs(profile.step), 1e-300)
    return share if total > OVERSHOOT_SD * error and share > MIN_OVERSHOOT else 0.0


def _overshoot(profile: EdgeProfile, half_frequency: float, sign: float) -> tuple[float, float] | None:
    """Return the largest mean near the edge beyond the plateau of one side, and its standard error, DN."""
    away = sign * profile.distance * half_frequency
    far, near = (away > FAR[0]) & (away < FAR[1]), np.flatnonzero((away > NEAR[0]) & (away < NEAR[1]))
    if np.count_nonzero(far) < MIN_BINS or not near.size:
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


def noise_gain_of(picture: OrientedFrame, profile: EdgeProfile) -> float:
    """Return by how much sharpening has raised the noise, a factor; 1: neighbours' noise does not run against it.

    Notes
    -----
    Blur behind the pixels ties neighbours; only differences taken afterwards set them against each other, and leave
    averages over many pixels as they were: the sum C of the noise's correlation falls below 1, and the noise is
    C^(-1/2) times what it was. Each of the n pixels of a bin holds 1/n of its mean, which is taken off.
    """
    gathered, step = profile.gathered, profile.step or 1.0
    at_pixel = np.interp(gathered.distance, profile.distance, profile.value)
    level = (at_pixel - profile.dark) / step
    used = gathered.used & (np.minimum(np.abs(level), np.abs(level - 1.0)) < PLATEAU)
    sd = np.sqrt(np.maximum(profile.grain.variance(level), profile.variance_floor))
    noise = np.where(used, np.clip((picture.value - at_pixel) / sd, -LARGEST_SD, LARGEST_SD), 0.0)
    pixels = int(np.count_nonzero(used))
    if pixels < MIN_PIXELS:
        return 1.0
    # Pixels that differ from the profile by less than it knows of them show its bins, not noise.
    variance = max(float(np.sum(noise**2)) / pixels, 1.0)
    shared = [_mean_product(noise, used, down, right) for down, right in NEIGHBOURS]
    total = 2.0 * sum(shared) / variance
    taken = 2.0 * REACH_PX * float(np.mean(1.0 / profile.count))
    error = np.sqrt(2.0 * len(shared) / pixels) * np.sqrt(2.0)
    opposed = -(total + taken)
    return float(max(1.0 - opposed, 0.05) ** -0.5) if opposed > max(MIN_OPPOSED, OPPOSED_SD * error) else 1.0


def _mean_product(noise: Array, used: NDArray[np.bool_], down: int, right: int) -> float:
    """Return the mean product of pixels so many rows and columns apart."""
    rows, cols = noise.shape
    one = slice(0, rows - down), slice(max(-right, 0), cols - max(right, 0))
    other = slice(down, rows), slice(max(right, 0), cols - max(-right, 0))
    return float(np.sum(noise[one] * noise[other])) / max(int(np.count_nonzero(used[one] & used[other])), 1)
