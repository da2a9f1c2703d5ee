"""What compression, interpolation, filters by rank and tables of codes leave in even areas.

Every test compares the noise with that of a camera, whose pixels are independent or share their
noise smoothly, the same at every place.
"""

from collections.abc import Iterator
from math import erf, exp, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.curve import CurveFinding, stretched
from charact.estimators.mtf.noise_spectrum.thresholds import PROCESSED
from charact.frames.rounding import QUANTISATION_DN2
from labdata import Array

BLOCK_PX = 8  # Blocks of JPEG (ISO/IEC 10918-1)


def processing_findings(
    codes: NDArray, expected: Array, areas: NDArray[np.integer]
) -> Iterator[CurveFinding]:
    """Yield what the even areas of one frame say of processing behind the digitiser.

    Parameters
    ----------
    codes
        The frame as read, shape (row, col), DN.
    expected
        Its mean signal, shape (row, col), DN.
    areas
        Which pixels are even, 1 on the dark and 2 on the bright side, else 0, shape (row, col).

    Notes
    -----
    JPEG quantises blocks of eight pixels: squared differences of neighbours are larger at one of
    eight places. Interpolation to twice the samples makes them alternate. Smoothed noise has less
    than half the squared differences of independent pixels; a median of nine pixels, besides, is
    often the same pixel as its neighbour's: more differences are 0 than the P0 of rounded normal
    noise of the differences' standard deviation. Noise of rare pulses, as behind a tube, has more
    that are 0 and more that are one code, P1: P0 is raised as they are, on each side alone. With
    g(x) = E|u - x| of the normal u, P0 = g(1) - g(0) and P1 = g(2) - 2 g(1) + g(0). A table from
    codes to codes leaves gaps on the side that it steepens.
    """
    values = np.unique(codes)
    step = float(np.diff(values).min()) if values.size > 1 else 1.0
    if _has_gaps_on_one_side(codes, areas, step):
        yield CurveFinding(flag="gamma", effect="codes are left out on one side: a curved response")
    blocks, parities, squares, equals, excess = [], [], [], [], []
    for axis in (0, 1):
        ahead, behind = (
            np.moveaxis(np.stack([codes - expected, codes, areas]), 1 + axis, 1)[:, part]
            for part in (slice(1, None), slice(None, -1))
        )
        even = (ahead[2] > 0) & (ahead[2] == behind[2])
        if np.count_nonzero(even) < PROCESSED.min_pairs:
            return
        square, place = ((ahead[0] - behind[0]) ** 2)[even], np.nonzero(even)[0]
        blocks.append(_variation(square, place % BLOCK_PX))
        parities.append(_variation(square, place % 2))
        squares.append(float(square.mean()) / step**2)
        apart = np.abs(ahead[1] - behind[1])[even] / step
        equals.append(float(np.mean(apart == 0.0)))
        excess += [
            _excess_of_equals(square[side] / step**2, apart[side])
            for side in (ahead[2][even] == area for area in (1, 2))
            if np.count_nonzero(side) > PROCESSED.min_pairs // 4
        ]
    difference = float(np.mean(squares)) - 2.0 * QUANTISATION_DN2
    variance = float(np.var((codes - expected)[areas > 0])) / step**2 - QUANTISATION_DN2
    if max(blocks) > PROCESSED.block_ratio:
        yield CurveFinding(
            flag="processed", effect="noise in blocks of 8 pixels: lossy compression (JPEG)"
        )
    elif difference < 2.0 * PROCESSED.smoothed_ratio * variance and difference > 0.0:
        if min(parities) > PROCESSED.parity_ratio:
            effect = "interpolated to twice the samples: frequencies are those of the file's pixels"
            undo = stretched(PROCESSED.interpolation_bias)
            yield CurveFinding(flag="processed", effect=effect, undo=undo)
        elif min(excess, default=0.0) > PROCESSED.equal_neighbours:
            effect = (
                f"{100.0 * float(np.mean(equals)):.0f} % of neighbours are equal, at least "
                f"{100.0 * min(excess):.0f} % more than noise makes: a median or another filter by "
                "rank"
            )
            undo = stretched(PROCESSED.rank_bias)
            yield CurveFinding(flag="processed", effect=effect, undo=undo)


def _excess_of_equals(square: Array, apart: Array) -> float:
    """Return the share of equal neighbours above that of rounded noise; squared differences of the
    signal and differences of the codes, in steps.
    """
    sd = sqrt(max(float(square.mean()) - 2.0 * QUANTISATION_DN2, PROCESSED.least_square))
    at_zero, at_one, at_two = (_mean_distance(x, sd) for x in (0.0, 1.0, 2.0))
    wider = float(np.mean(apart == 1.0)) / max(at_two - 2.0 * at_one + at_zero, 1e-9)
    return float(np.mean(apart == 0.0)) - (at_one - at_zero) * max(wider, 1.0)


def _mean_distance(x: float, sd: float) -> float:
    """Return the mean distance from x of a normal number of mean 0."""
    return sd * sqrt(2.0 / pi) * exp(-0.5 * (x / sd) ** 2) + x * erf(x / (sd * sqrt(2.0)))


def _variation(square: Array, place: NDArray[np.integer]) -> float:
    """Return the largest mean of places over that of all others."""
    count = np.maximum(np.bincount(place), 1)
    means = np.bincount(place, square) / count
    largest = int(np.argmax(means))
    return float(means[largest] / max(np.delete(means, largest).mean(), 1e-300))


def _has_gaps_on_one_side(codes: NDArray, areas: NDArray[np.integer], step: float) -> bool:
    """Return whether codes between frequent ones are left out on one side and on the other none."""
    gaps = []
    for side in (1, 2):
        on_side = codes[areas == side]
        if not on_side.size or np.ptp(on_side) / step > PROCESSED.max_codes:
            return False
        count = np.bincount(np.rint((on_side - on_side.min()) / step).astype(np.int64))
        common = np.minimum(count[:-2], count[2:]) >= PROCESSED.common_code
        gaps.append(int(np.count_nonzero(common & (count[1:-1] == 0))))
    return min(gaps) == 0 and max(gaps) >= PROCESSED.min_gaps
