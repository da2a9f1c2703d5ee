"""Whether a profile is that of so many bars, and which: their middle and their frequency."""

import numpy as np
from numpy.typing import NDArray

# Share of the profile's variance that bars must explain.
MIN_EXPLAINED = 0.85
# Periods looked at beside the bars; mean over modulation of bars with dark gaps; the ground beside them over their
# height; the first bar against the last.
BEYOND, DARK_GAPS, BACKGROUND, MAX_INEQUALITY = 0.8, 0.65, 0.4, 0.4
# Share of the profile's variance that noise may hold, and standard errors of the modulation.
MAX_NOISE, MIN_WAVE = 0.3, 5.0


def matches_bars(place: NDArray, rows: NDArray, frequency: float, bars: int) -> tuple[float, float, float] | None:
    """Return how much blurred bright bars explain, their middle and their frequency, None if they are none.

    Notes
    -----
    A group is a box over N periods on a ground with a cosine in it, dark at both its ends: the model is a constant, a
    slope, that box and that cosine. Bars of another number, an edge or a stripe leave too much unexplained.
    """
    value = rows.mean(axis=0)
    noise = float(np.mean(np.var(rows, axis=0, ddof=1))) / len(rows) * value.size
    tried = np.array(np.meshgrid(np.linspace(0.92, 1.08, 17) * frequency, np.linspace(-0.6, 0.6, 21))).reshape(2, -1)
    design = _design((place - (tried[1] / frequency)[:, None]) * tried[0][:, None], bars)
    ground = np.stack([np.ones_like(place), place * frequency], axis=1)
    design = np.concatenate([np.broadcast_to(ground, (*design.shape[:2], 2)), design], axis=2)
    normal = np.einsum("nik,nil->nkl", design, design) + 1e-9 * np.eye(4)
    right = np.einsum("nik,i->nk", design, value - value.mean())
    coefficient = np.linalg.solve(normal, right[..., None])[..., 0]
    variance = float(np.sum((value - value.mean()) ** 2))
    left = variance - np.einsum("nk,nk->n", coefficient, right)
    best = int(np.argmin(left))
    box, wave = coefficient[best, 2:]
    unexplained = float(left[best]) - min(2.0 * noise, MAX_NOISE * variance)
    if not wave > MIN_WAVE * np.sqrt(2.0 * noise) / value.size or box < DARK_GAPS * wave:
        return None
    if unexplained > (1.0 - MIN_EXPLAINED) * variance:
        return None
    centre, own = float(tried[1, best] / frequency), float(tried[0, best])
    level = value - coefficient[best, 1] * place * frequency
    explained = 1.0 - float(left[best]) / variance
    return (explained, centre, own) if _has_isolated_ends((place - centre) * own, level, bars) else None


def _has_isolated_ends(phase: NDArray, level: NDArray, bars: int) -> bool:
    """Return whether a profile over phases in periods holds so many bars: one more, or less, shows beside the last."""
    beside, ends = [], []
    for sign in (-1, 1):
        beyond = (sign * phase > 0.5 * bars + 0.15) & (sign * phase < 0.5 * bars + BEYOND)
        last = np.abs(phase - sign * 0.5 * (bars - 1)) < 0.25
        if np.count_nonzero(beyond) < 1 or np.count_nonzero(last) < 1:
            return False
        beside.append(float(level[beyond].mean()))
        ends.append(float(level[last].mean()))
    height = 0.5 * (ends[0] + ends[1]) - min(beside)
    between = float(level[np.abs(phase) < 0.5 * bars].mean())
    dark = max(beside) < min(beside) + BACKGROUND * height and max(beside) < between - 0.25 * height
    return dark and abs(ends[1] - ends[0]) < MAX_INEQUALITY * height


def _design(phase: NDArray, bars: int) -> NDArray:
    """Return the box over so many periods and the cosine in it at phases in periods, shape (..., 2)."""
    edge = np.clip((0.5 * bars - np.abs(phase)) * 4.0, -1.0, 1.0)
    box = 0.5 * (1.0 + np.sin(0.5 * np.pi * edge))
    return np.stack([box, -box * np.cos(2.0 * np.pi * (phase + 0.5 * bars))], axis=-1)
