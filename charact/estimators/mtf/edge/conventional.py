"""Conventional edge methods: pixels gathered by their distance from a straight line, and a windowed
transform.

They have no noise model, are normalised to the light inside their window, and their intervals are
jackknifed over blocks of rows, which keeps the correlation of neighbouring rows.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import charact
from charact.estimators.mtf.curve import FINE, LEVELS, PINNED, REPORTED, crossing_frequency
from charact.estimators.mtf.edge.checks import (
    curved_finding,
    edge_findings,
    gradient_finding,
    low_signal_finding,
    noise_below_quantisation,
    quantisation_finding,
    window_finding,
)
from charact.estimators.mtf.edge.pixels.line import EdgeLine
from charact.estimators.mtf.edge.pixels.prepare_edge import EdgeRefusal, prepare_edge
from charact.estimators.mtf.edge.result import edge_result, refuse_edge, shared_fields
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.mean_frame import OrientedFrame, Region
from charact.method import Context, register
from labdata import (
    Array,
    Curve,
    FrameStack,
    Measurement,
    Provenance,
    Result,
    make_refusal,
    measurement_from_sd,
)

# Half width of the window, px: a wider one brings only noise.
WIDEST_PX = 64.0


@dataclass(frozen=True, kw_only=True)
class MtfEstimate:
    """What an estimator makes of an edge.

    Parameters
    ----------
    frequency
        Along the normal of the edge, equally spaced from zero, shape (f,), cy per column pitch.
    values
        MTF of all rows, and with each block of rows left out, shape (1 + block, f).
    notes
        Notes on the estimate.
    half_window_px
        Half width of its window along the edge's normal, px.
    """

    frequency: Array
    values: Array
    notes: tuple[str, ...] = ()
    half_window_px: float


def measure_conventionally(
    method: str,
    estimate: Callable[[OrientedFrame, EdgeLine], MtfEstimate],
    bias_sd: float,
    settings: dict[str, float],
    stack: FrameStack,
    region: Region | None,
    context: Context,
) -> Result:
    """Find the edge of a region and estimate its MTF.

    Parameters
    ----------
    method, estimate
        The method's name, and its MTF from the upright frame and the line of its edge.
    bias_sd
        Relative bias of MTF50 over the declared scope, as a standard deviation, measured against
        closed forms.
    settings
        The estimator's numbers, for the provenance.
    stack, region, context
        As every method gets them.
    """
    edge = prepare_edge(stack, region, context)
    if isinstance(edge, EdgeRefusal):
        return refuse_edge(method, edge, None, settings)
    (rows, cols), profile = edge.picture.value.shape, edge.profile
    noise, step = max(profile.side_variances) ** 0.5, profile.step
    least_rows, least_cols, least_step = (
        THRESHOLDS.conventional_rows,
        THRESHOLDS.conventional_cols,
        THRESHOLDS.conventional_step_sd,
    )
    reason, flag = "", "low-signal"
    if rows < least_rows or cols < least_cols:
        reason = (
            f"a conventional edge method needs {least_rows} rows across {least_cols} px, got "
            f"{rows} across {cols}"
        )
    elif step < 3.0 * noise / np.sqrt(len(profile.distance)) or edge.rows.line.strength < 60.0:
        reason, flag = "no target: no edge stands clear of the noise", "no-target"
    elif step < least_step * noise:
        required = f"{least_step:g} times the pixel noise"
        reason = f"a conventional edge method needs a step of {required}, got {step / noise:.1f}"
    if reason:
        return refuse_edge(
            method, EdgeRefusal(reason=reason, where=edge.where, flag=flag), None, settings
        )
    estimated = estimate(edge.picture, edge.rows.line)
    half = float(crossing_frequency(estimated.frequency, estimated.values[:1], 0.5)[0])
    notes = (*estimated.notes, "Normalised to the light inside the region.")
    settings = {**settings, "half_window_px": round(estimated.half_window_px, 2)}
    provenance = Provenance(version=charact.__version__, settings=settings)
    shared = shared_fields(method, edge, notes, provenance)
    numbers = [
        _crossing(estimated, quantity, level, bias_sd, shared) for quantity, level in LEVELS.items()
    ]
    low, high = numbers[0].interval68 or (-np.inf, np.inf)
    relative_sd = (high - low) / (2.0 * 0.994458 * half)
    findings = list(edge_findings(edge, half, context, relative_sd, THRESHOLDS.conventional_motion))
    if edge.rows.line.bend is not None:
        bend_px = float(np.std(edge.rows.line.bend))
        findings.append(curved_finding("the edge departs from a straight line by", bend_px, ""))
    if step < THRESHOLDS.conventional_min_snr * noise:
        findings.append(low_signal_finding(profile))
    if step < THRESHOLDS.coarse_step_dn and noise_below_quantisation(edge.picture, profile):
        findings.append(quantisation_finding(profile))
    # What an estimator, unlike a fit, cannot allow for.
    if not np.isfinite(half) or profile.gathered.half_width_px < 2.5 / half:
        findings.append(window_finding(profile))
    for side in (profile.distance < -8, profile.distance > 8):
        distance, value, count = (
            part[side] for part in (profile.distance, profile.value, profile.count)
        )
        if distance.size >= 8:
            slope, _ = np.polyfit(distance, value, 1, w=np.sqrt(count))
            if abs(slope) * np.ptp(distance) > 0.025 * step:
                findings.append(gradient_finding(profile))
    at = np.concatenate([PINNED, REPORTED])
    every = np.array([np.interp(at, estimated.frequency, modulus) for modulus in estimated.values])
    value, sd = every[0], jackknife_sd(every[1:])
    numbers += [
        measurement_from_sd(
            "mtf", "1", float(value[k]), float(sd[k]), frequency_cy_per_px=f, **shared
        )
        for k, f in enumerate(PINNED)
    ]
    value, sd = value[len(PINNED) :], sd[len(PINNED) :]
    low, interval95 = (np.stack([value - k * sd, value + k * sd]) for k in (0.994458, 1.959964))
    curve = Curve(frequency_cy_per_px=REPORTED, value=value, interval68=low, interval95=interval95)
    return edge_result(edge, numbers, curve, shared, findings)


def _crossing(
    estimated: MtfEstimate, quantity: str, level: float, bias_sd: float, common: dict
) -> Measurement:
    """Return MTF50 or MTF10.

    Its standard uncertainty is the scatter of the MTF near there over its slope at large: noise
    makes an MTF without a model uneven, and where it falls steeply by chance its own crossings
    hardly scatter. They serve where too few frequencies are near.
    """
    frequency = estimated.frequency
    value, *jackknifed = crossing_frequency(frequency, estimated.values, level)
    if not np.isfinite([value, *jackknifed]).all() or value > FINE[-1]:
        return make_refusal(
            quantity, "cy/px", f"the response does not fall to {level:g} within 1 cy/px", **common
        )
    in_range = np.abs(frequency / value - 1.0) < ACCURACY.crossing_range
    if np.count_nonzero(in_range) < 3:
        scatter = float(jackknife_sd(np.array(jackknifed)))
    else:
        slope = np.polyfit(frequency[in_range], estimated.values[0, in_range], 1)[0]
        scatter = float(np.sqrt(np.mean(jackknife_sd(estimated.values[1:, in_range]) ** 2)))
        scatter /= max(-slope, ACCURACY.min_crossing_slope / value)
    # Besides, a fraction of a frequency step and the estimator's own bias.
    sd = np.sqrt(scatter**2 + (0.1 * frequency[1]) ** 2 + (bias_sd * float(value)) ** 2)
    return measurement_from_sd(quantity, "cy/px", float(value), float(sd), **common)


def jackknife_sd(parts: Array) -> Array:
    """Return the standard uncertainty from leave-one-block-out values (block, ...)."""
    count = len(parts)
    return np.sqrt((count - 1) / count * np.sum((parts - parts.mean(axis=0)) ** 2, axis=0))


def mean_by_cell(cell: NDArray[np.int64], value: Array, size: int) -> Array:
    """Return the mean of the pixels of each cell, of all rows and with each block of rows left out.

    Parameters
    ----------
    cell
        Cell of every pixel, shape (row, col); those outside 0 to `size` are left out.
    value
        Shape (row, col).
    size
        Number of cells.

    Returns
    -------
    ndarray
        Shape (1 + block, cell); empty cells are interpolated by cubic splines: at 45 degrees three
        of four are empty, and straight lines would blur the edge.
    """
    blocks = ACCURACY.jackknife_blocks
    in_band = (cell >= 0) & (cell < size)
    block = np.broadcast_to((np.arange(len(value)) * blocks // len(value))[:, None], value.shape)
    index = (block * size + cell)[in_band]
    total = np.bincount(index, weights=value[in_band], minlength=blocks * size).reshape(
        blocks, size
    )
    count = np.bincount(index, minlength=blocks * size).reshape(blocks, size)
    totals = np.concatenate([total.sum(0)[None], total.sum(0) - total])
    counts = np.concatenate([count.sum(0)[None], count.sum(0) - count])
    cells = np.arange(size)
    means = totals / np.maximum(counts, 1)
    for mean, filled in zip(means, counts > 0, strict=True):
        if not filled.all() and filled.any():
            from scipy.interpolate import CubicSpline

            between_filled = np.clip(cells[~filled], cells[filled][0], cells[filled][-1])
            mean[~filled] = CubicSpline(cells[filled], mean[filled])(between_filled)
    return means


@register("edge", "edge-slanted")
def edge_slanted(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge by the fourfold oversampled estimator of ISO 12233.

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
    SFR(f) = |sum_x L(x) w(x) exp(-2 pi i f x)| / |sum_x L(x) w(x)| / sinc(f / 2): E(x) is the mean
    of the pixels that lie in the quarter pixel x from the straight line through the rows'
    centroids, L(x) = (E(x + 1/4) - E(x - 1/4)) / 2, whose own transfer is the sinc, and w a Hamming
    window. A frame that is rotated or mirrored gives the same numbers. Source: ISO 12233 annex on
    e-SFR; P. D. Burns, PICS 2000, 135; conventions as his sfrmat3 and its published table have
    them.
    """
    settings = {"oversampling": QUARTERS, "widest_px": WIDEST_PX}
    return measure_conventionally(
        "edge-slanted", _estimate_slanted, 0.012, settings, stack, region, context
    )


QUARTERS = 4


def _estimate_slanted(picture: OrientedFrame, line: EdgeLine) -> MtfEstimate:
    # Turned so that the edge moves to the right: bins lie as the first row has them, and a rotated
    # frame gives the same numbers.
    value, slope = (
        (picture.value, line.slope) if line.slope >= 0 else (picture.value[::-1], -line.slope)
    )
    rows, cols = value.shape
    half_width_px = 0.5 * slope * (rows - 1) + WIDEST_PX
    low, high = (
        int(max(np.floor(line.position - half_width_px), 0)),
        int(min(np.ceil(line.position + half_width_px) + 1, cols)),
    )
    value, cols = value[:, low:high], high - low
    first_px = line.position - low - 0.5 * slope * (rows - 1)
    # The line through the centroids of the rows' differences to the next pixel, in a Hamming window
    # as wide as the frame: at first about its middle, then about the line found so.
    difference = np.diff(value, axis=1)
    difference = np.concatenate([difference, difference[:, -1:]], axis=1)
    row, col = np.arange(rows), np.arange(cols)
    along, first = 0.0, 0.5 * (cols - 1)
    for _ in range(2):
        centre = (first + along * row)[:, None]
        weighted = difference * _hamming(col - centre, np.maximum(centre, cols - 1 - centre))
        light = weighted.sum(axis=1)
        if not np.all(light > 0):
            along, first = np.inf, 0.0
            break
        along, first = np.polyfit(row, weighted @ col / light + 0.5, 1).tolist()
    notes = ()
    if abs(along - slope) * rows > 1.0 / QUARTERS:
        # Off by more than one bin: lost in noise, or in uneven light.
        along, first = slope, first_px
        notes = (
            (
                "The rows' centroids stray from the edge: the line fitted to all pixels was taken "
                "in their place."
            ),
        )
    # A whole number of pixels crossed along the edge; all rows where it crosses none.
    cycles = np.floor(rows * along)
    value = value[: rows if cycles < 1 else min(rows, round(cycles / along))]
    rows, cols = value.shape
    across = (np.arange(cols) - along * np.arange(rows)[:, None]) * QUARTERS
    # As many quarter pixels as the frame is wide, about its middle row.
    start = round(-0.5 * QUARTERS * along * (rows - 1)) - QUARTERS // 2
    edges = mean_by_cell(np.floor(across).astype(np.int64) - start, value, cols * QUARTERS)
    # Derivative over two bins, centred, in a Hamming window.
    size = cols * QUARTERS
    spread = np.empty_like(edges)
    spread[:, 1:-1] = 0.5 * (edges[:, 2:] - edges[:, :-2])
    spread[:, 0], spread[:, -1] = spread[:, 1], spread[:, -2]
    centred = np.roll(spread, round(0.5 * size - (first * QUARTERS - start)), axis=1)
    window = _hamming(np.arange(size) - 0.5 * (size - 1), 0.5 * (size - 1))
    modulus = np.abs(np.fft.rfft(centred * window, axis=1))[:, : size // QUARTERS + 2]
    # The difference over two bins is itself a filter, sinc(f / 2) at four bins a pixel.
    values = modulus / modulus[:, :1] / np.sinc(2.0 * np.arange(modulus.shape[1]) / size)
    width_px = cols * float(np.cos(np.arctan(along / picture.pitch_ratio)))
    frequency = np.arange(modulus.shape[1]) / width_px
    return MtfEstimate(
        frequency=frequency, values=values, notes=notes, half_window_px=0.5 * width_px
    )


def _hamming(distance: NDArray, half_width: NDArray | float) -> Array:
    return np.where(
        np.abs(distance) <= half_width, 0.54 + 0.46 * np.cos(np.pi * distance / half_width), 0.0
    )


@register("edge", "edge-gradient")
def edge_gradient(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge from the gradients of the pixels around it.

    Parameters are those of `edge_slanted`.

    Notes
    -----
    MTF(f) = |sum_x L(x) w(x) exp(-2 pi i f x)| / |sum_x L(x)| / (D(f) sinc(f / 8)): L(x) is the
    mean over cells of 2 x 2 pixels, an eighth of a pixel x from the fitted line, of the gradient
    along its normal, its sign kept so that noise averages out; D is what differences between pixels
    pass, the sinc what eighths do, w a tapered window. The blur is seen through a window of a few
    periods, so that plateaus bring little noise, and normalised to the light of the whole region;
    below the first frequencies that the window resolves the curve is too low by the light outside.
    Source: F. van den Bergh, J. Opt. Soc. Am. A 36 (2019) 1126 for the family of methods.
    """
    settings = {"oversampling": EIGHTHS, "widest_px": WIDEST_PX, "periods": PERIODS}
    return measure_conventionally(
        "edge-gradient", _gradient_estimate, 0.007, settings, stack, region, context
    )


# Cells of the line spread per pixel; half the window of the blur in periods of MTF50, and its
# least, px.
EIGHTHS, PERIODS, NARROWEST_PX = 8, 2.5, 8.0


def _gradient_estimate(picture: OrientedFrame, line: EdgeLine) -> MtfEstimate:
    value, ratio = picture.value, picture.pitch_ratio
    angle = line.angle_rad(ratio)
    cosine, sine = np.cos(angle), np.sin(angle)
    right, down = np.diff(value, axis=1), np.diff(value, axis=0)
    right, down = 0.5 * (right[1:] + right[:-1]), 0.5 * (down[:, 1:] + down[:, :-1])
    slope = cosine * right - sine * down / ratio
    # Cells lie between the pixels: the mean distance of the four.
    across = line.across(value.shape) * cosine
    distance = 0.25 * (across[1:, 1:] + across[1:, :-1] + across[:-1, 1:] + across[:-1, :-1])
    plateau_px = min(line.position, value.shape[1] - 1 - line.position) * cosine - 1.0
    widest = float(np.clip(plateau_px, 3.0, WIDEST_PX))
    size, samples = round(widest * EIGHTHS), 128 * EIGHTHS
    spread = mean_by_cell(np.floor(distance * EIGHTHS).astype(np.int64) + size, slope, 2 * size)
    frequency = np.arange(samples // EIGHTHS) / samples * EIGHTHS
    frequency = frequency[frequency < 0.9]
    # What differences over one pixel, averaged over the two of a cell, and the cells pass of a wave
    # along the normal: 2i sin(pi f) of each axis' share of the phase, times the other's cosine,
    # over the true 2 pi i f.
    phase_right, phase_down = np.pi * frequency * cosine, np.pi * frequency * sine * ratio
    differences = cosine * np.sin(phase_right) * np.cos(phase_down)
    differences += sine / ratio * np.sin(phase_down) * np.cos(phase_right)
    passed = np.concatenate([[1.0], differences[1:] / (np.pi * frequency[1:])]) * np.sinc(
        frequency / EIGHTHS
    )

    def transform(half_px: float) -> Array:
        """Return the modulus of the transforms in a window whose outer three quarters are
        tapered.
        """
        relative = np.abs((np.arange(2 * size) - 0.5 * (2 * size - 1)) / EIGHTHS) / half_px
        taper = 0.5 * (1.0 + np.cos(np.pi * np.clip((relative - 0.25) / 0.75, 0.0, 1.0)))
        return np.abs(np.fft.rfft(spread * taper, samples, axis=1))[:, : frequency.size] / passed

    widest_modulus = transform(widest)
    light = widest_modulus[:, :1]
    half = crossing_frequency(frequency, widest_modulus[:1] / light[:1], 0.5)[0]
    narrow = (
        float(np.clip(PERIODS / half, min(NARROWEST_PX, widest), widest))
        if np.isfinite(half)
        else widest
    )
    values = transform(narrow) / light
    values[:, 0] = 1.0
    return MtfEstimate(frequency=frequency, values=values, half_window_px=narrow)
