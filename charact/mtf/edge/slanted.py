"""The plain method for edges: the fourfold oversampled estimator of ISO 12233, with intervals from blocks of rows.

It follows the well-known recipe: a straight line through the rows' centroids, all pixels binned to quarter pixels by
their distance from it, derivative, window, Fourier transform; conventions are those of Burns' own table of it.
"""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.edge.conventional import ConventionalMethod, MtfEstimate, mean_by_cell, measure_conventionally
from charact.mtf.edge.pixels.line import EdgeLine
from charact.mtf.mean_frame import OrientedFrame, Region
from labdata.frames import FrameStack
from labdata.measurement import Result

Array = NDArray[np.float64]

METHOD = "edge-slanted"
OVERSAMPLING = 4
# Beyond, a wider window brings only noise.
WIDEST_PX = 64.0
# A line that leaves the edge by more than one bin is lost: in noise, or to light that is not even.
MAX_LINE_ERROR_PX = 1.0 / OVERSAMPLING


@register(
    "edge",
    METHOD,
    quantities=("mtf50", "mtf10", "mtf", "edge_angle"),
    scope=(
        "Straight edges tilted 3 to 15 degrees, 60 rows and more, step over 20 standard deviations of the noise, even "
        "light. Normalises to the light inside the window; uneven light, noise, halo and short edges bias it, and a "
        "curved response mostly unseen (a gamma of 0.45 to 2.2: -7 to +17 %)."
    ),
)
def edge_slanted(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge the plain way.

    Parameters
    ----------
    stack
        Frames of one edge; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge; None: the whole frame.
    context
        Seed and camera.

    Notes
    -----
    Intervals are jackknifed over twenty blocks of rows, which keeps the correlation of neighbouring rows. A frame that
    is rotated or mirrored gives the same numbers. Source: ISO 12233 annex on e-SFR; P. D. Burns, PICS 2000, 135; his
    conventions as his sfrmat3 and its published table have them.
    """
    return measure_conventionally(ESTIMATOR, stack, region, context)


def _estimate(picture: OrientedFrame, found: EdgeLine) -> MtfEstimate:
    value, slope, place = _orient(picture, found)
    along, first = _centroid_line(value)
    notes = ()
    if abs(along - slope) * len(value) > MAX_LINE_ERROR_PX:
        along, first = slope, place
        notes = ("The rows' centroids stray from the edge: the line fitted to all pixels was taken in their place.",)
    value = value[: _complete_cycles(len(value), along)]
    rows, cols = value.shape
    across = (np.arange(cols) - along * np.arange(rows)[:, None]) * OVERSAMPLING
    # As many quarter pixels as the picture is wide, about its middle row.
    start = round(-0.5 * OVERSAMPLING * along * (rows - 1)) - OVERSAMPLING // 2
    means = mean_by_cell(np.floor(across).astype(np.int64) - start, value, cols * OVERSAMPLING)
    response = np.stack([_edge_mtf(mean, first * OVERSAMPLING - start) for mean in means])
    frequency = np.arange(response.shape[1]) / cols / np.cos(np.arctan(along / picture.pitch_ratio))
    return MtfEstimate(frequency=frequency, value=response[0], parts=response[1:], notes=notes)


def _orient(picture: OrientedFrame, found: EdgeLine) -> tuple[Array, float, float]:
    """Return the pixels around the edge so turned that it moves to the right, its slope and its place in the first row.

    The bins lie as the first row has them: turned always the same way, a rotated frame gives the same numbers, and
    Burns' frame those of his table.
    """
    value, slope = picture.value, found.slope
    if slope < 0:
        value, slope = value[::-1], -slope
    rows, cols = value.shape
    reach = 0.5 * slope * (rows - 1) + WIDEST_PX
    low, high = int(max(np.floor(found.position - reach), 0)), int(min(np.ceil(found.position + reach) + 1, cols))
    return value[:, low:high], slope, found.position - low - 0.5 * slope * (rows - 1)


def _centroid_line(value: Array) -> tuple[float, float]:
    """Return slope and place in the first row of the line through the centroids of the rows' differences.

    Differences are to the next pixel, in a Hamming window as wide as the frame: at first about its middle, then about
    the line found so.
    """
    rows, cols = value.shape
    difference = np.diff(value, axis=1)
    difference = np.concatenate([difference, difference[:, -1:]], axis=1)
    row, place = np.arange(rows), np.arange(cols)
    slope, first = 0.0, 0.5 * (cols - 1)
    for _ in range(2):
        centre = (first + slope * row)[:, None]
        weighted = difference * _hamming(place - centre, np.maximum(centre, cols - 1 - centre))
        light = weighted.sum(axis=1)
        if not np.all(light > 0):
            return np.inf, 0.0
        slope, first = np.polyfit(row, weighted @ place / light + 0.5, 1)
    return float(slope), float(first)


def _complete_cycles(rows: int, slope: float) -> int:
    """Return how many rows the edge needs to cross a whole number of pixels, all rows where it crosses none."""
    cycles = np.floor(rows * slope)
    return rows if cycles < 1 else min(rows, round(cycles / slope))


def _hamming(distance: NDArray, half_width: NDArray | float) -> Array:
    return np.where(np.abs(distance) <= half_width, 0.54 + 0.46 * np.cos(np.pi * distance / half_width), 0.0)


def _edge_mtf(edge: Array, centre: float) -> Array:
    """Return the modulus of the transform of one oversampled edge's derivative, corrected for the difference taken."""
    size = edge.size
    spread = np.zeros(size)
    spread[1:-1] = 0.5 * (edge[2:] - edge[:-2])
    spread[0], spread[-1] = spread[1], spread[-2]
    place = np.arange(size)
    windowed = np.roll(spread, round(0.5 * size - centre)) * _hamming(place - 0.5 * (size - 1), 0.5 * (size - 1))
    modulus = np.abs(np.fft.rfft(windowed))[: size // OVERSAMPLING + 2]
    # A difference over two bins is itself a filter, sinc(f / 2) at four bins a pixel.
    return modulus / modulus[0] / np.sinc(2.0 * np.arange(modulus.size) / size)


ESTIMATOR = ConventionalMethod(
    name=METHOD,
    estimate=_estimate,
    bias_sd=0.012,
    min_snr=8.0,
    settings={"oversampling": OVERSAMPLING, "widest_px": WIDEST_PX},
)
