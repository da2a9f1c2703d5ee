"""The gradient method for edges: slopes of light along the edge's normal, gathered by distance, make the line spread.

Each cell of 2 x 2 pixels gives its own slope. The blur is seen through a window of a few periods, so that plateaus
bring little noise, and normalised to the light of the whole region, so that what lies outside the window counts.
"""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.curve import crossing_frequency
from charact.mtf.edge.conventional import ConventionalMethod, MtfEstimate, mean_by_cell, measure_conventionally
from charact.mtf.edge.pixels.line import EdgeLine
from charact.mtf.mean_frame import OrientedFrame, Region
from labdata.frames import FrameStack
from labdata.measurement import Result

Array = NDArray[np.float64]

METHOD = "edge-gradient"
# Cells of the line spread per pixel, and samples of its transform: one a 128th of a cycle per pixel.
OVERSAMPLING = 8
SAMPLES = 128 * OVERSAMPLING
# Half the window that all light is counted in, px; half that of the blur in periods of MTF50, and its least, px.
WIDEST_PX, PERIODS, NARROWEST_PX = 64.0, 2.5, 8.0
# Share of the window without a taper.
FLAT = 0.25
# Up to here the differences pass enough to be divided by it.
HIGHEST_CY_PER_PX = 0.9


@register(
    "edge",
    METHOD,
    quantities=("mtf50", "mtf10", "mtf", "edge_angle"),
    scope=(
        "Straight edges tilted 3 to 15 degrees, 60 rows and more, step over 20 standard deviations of the noise, even "
        "light. Normalises to the light inside the region; uneven light and noise bias it, and a curved response "
        "mostly unseen (a gamma of 0.45 to 2.2: up to 16 %)."
    ),
)
def edge_gradient(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge from the gradients of the pixels around it.

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
    The gradient of each cell of 2 x 2 pixels is projected on the normal of the fitted line, its sign kept so that
    noise averages out, and gathered by the cell's distance from the line; the modulus of its windowed transform is
    divided by what differences and bins pass. Below the first frequency or two that the window resolves, light far
    from the edge is missing: the curve is too low there by its share. Source: F. van den Bergh, "Robust edge-spread
    function construction methods ...", J. Opt. Soc. Am. A 36 (2019) 1126 for the family; slopes of single cells in
    place of a smoothed profile, and the normalisation, are this one's. Intervals as those of `edge-slanted`.
    """
    return measure_conventionally(ESTIMATOR, stack, region, context)


def _estimate(picture: OrientedFrame, line: EdgeLine) -> MtfEstimate:
    rows, cols = picture.value.shape
    angle = line.angle_rad(picture.pitch_ratio)
    slope_of_light = _along_normal(picture.value, angle, picture.pitch_ratio)
    # Cells lie between the pixels: the mean distance of the four.
    across = line.across((rows, cols)) * np.cos(angle)
    distance = 0.25 * (across[1:, 1:] + across[1:, :-1] + across[:-1, 1:] + across[:-1, :-1])
    seen = min(line.position, cols - 1 - line.position) * np.cos(angle) - 1.0
    widest = float(np.clip(seen, 3.0, WIDEST_PX))
    size = round(widest * OVERSAMPLING)
    cell = np.floor(distance * OVERSAMPLING).astype(np.int64) + size
    spread = mean_by_cell(cell, slope_of_light, 2 * size)
    frequency = np.arange(SAMPLES // OVERSAMPLING) / SAMPLES * OVERSAMPLING
    frequency = frequency[frequency < HIGHEST_CY_PER_PX]
    passed = _transfer_of_differences(frequency, angle, picture.pitch_ratio)
    wide = _transform(spread, widest)[:, : frequency.size] / passed
    light = wide[:, :1]
    half = crossing_frequency(frequency, wide[:1] / light[:1], 0.5)[0]
    narrow = float(np.clip(PERIODS / half, min(NARROWEST_PX, widest), widest)) if np.isfinite(half) else widest
    response = _transform(spread, narrow)[:, : frequency.size] / passed / light
    response[:, 0] = 1.0
    return MtfEstimate(frequency=frequency, value=response[0], parts=response[1:])


def _along_normal(value: Array, angle_rad: float, pitch_ratio: float) -> Array:
    """Return the slope of light along the normal in each cell of 2 x 2 pixels, shape (row - 1, col - 1), DN per px."""
    right, down = np.diff(value, axis=1), np.diff(value, axis=0)
    right, down = 0.5 * (right[1:] + right[:-1]), 0.5 * (down[:, 1:] + down[:, :-1])
    return np.cos(angle_rad) * right - np.sin(angle_rad) * down / pitch_ratio


def _transfer_of_differences(frequency: Array, angle_rad: float, pitch_ratio: float) -> Array:
    """Return the share of a wave along the normal that the differences and the cells of the line spread pass.

    Differences over one pixel, averaged over the two of a cell: 2i sin(pi f) of each axis' own share of the phase,
    times the other's cosine, over the true 2 pi i f.
    """
    across, along = np.cos(angle_rad), np.sin(angle_rad)
    right, down = np.pi * frequency * across, np.pi * frequency * along * pitch_ratio
    differences = across * np.sin(right) * np.cos(down) + along / pitch_ratio * np.sin(down) * np.cos(right)
    slopes = np.concatenate([[1.0], differences[1:] / (np.pi * frequency[1:])])
    return slopes * np.sinc(frequency / OVERSAMPLING)


def _transform(spread: Array, half_px: float) -> Array:
    """Return the modulus of the transforms of line spreads (spread, cell) in a window tapered on both sides."""
    size = spread.shape[1]
    distance = np.abs((np.arange(size) - 0.5 * (size - 1)) / OVERSAMPLING) / half_px
    taper = np.clip((distance - FLAT) / (1.0 - FLAT), 0.0, 1.0)
    return np.abs(np.fft.rfft(spread * 0.5 * (1.0 + np.cos(np.pi * taper)), SAMPLES, axis=1))


ESTIMATOR = ConventionalMethod(
    name=METHOD,
    estimate=_estimate,
    bias_sd=0.007,
    min_snr=8.0,
    settings={"oversampling": OVERSAMPLING, "widest_px": WIDEST_PX, "periods": PERIODS},
)
