"""The plain method for edges: the fourfold oversampled estimator of ISO 12233, with intervals from blocks of rows.

It follows the well-known recipe: a straight line through each row's edge, all pixels binned to quarter pixels by their
distance from it, derivative, window, Fourier transform.
"""

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf import edge_checks, line
from charact.mtf.curve import FINE, PINNED, REPORTED, falls_to
from charact.mtf.edge_find import NoEdge, find_edge
from charact.mtf.geometry import orientation_deg
from charact.mtf.picture import Picture
from charact.mtf.region import Region
from labdata.frames import FrameStack
from labdata.measurement import Curve, Measurement, Provenance, Result, from_sd, refused

Array = NDArray[np.float64]

METHOD = "edge-slanted"
OVERSAMPLING = 4
BLOCKS = 10
WIDEST_PX = 64.0
# Bias from differences, bins and windows over the scope, relative: measured against closed forms.
OWN_ERROR = 0.012
LEAST_ROWS = 20
# Step over pixel noise below which the estimator is known to lose the edge or to be biased by noise.
LEAST_SNR = 8.0


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
    Intervals are jackknifed over ten blocks of rows, which keeps the correlation of neighbouring rows. Source:
    ISO 12233 annex on e-SFR; P. D. Burns, PICS 2000, 135.
    """
    began = time.perf_counter()
    edge = find_edge(stack, region, context)
    common = {"method": METHOD, "region": edge.where, "provenance": Provenance(version=charact.__version__)}
    if isinstance(edge, NoEdge):
        return _nothing(edge.reason, common, began)
    picture, rows, profile, used = edge.picture, edge.rows, edge.profile, edge.used
    if picture.value.shape[0] < LEAST_ROWS or picture.value.shape[1] < 16:
        return _nothing("the plain edge estimator needs 20 rows across 16 px", common, began)
    noise = np.sqrt(max(profile.grain.dark_variance, profile.grain.bright_variance))
    if profile.step < 3.0 * noise / np.sqrt(len(profile.distance)) or rows.line.strength < 60.0:
        return _nothing("no target: no edge stands clear of the noise", common, began)
    if profile.step < 3.0 * noise:
        return _nothing("the plain edge estimator needs a step of 3 standard deviations of the noise", common, began)
    frequency, sfr, parts = _sfr(*_narrowed(picture, rows.line))
    half = falls_to(frequency, sfr[None], 0.5)[0]
    flags = [
        *edge_checks.picture_flags(used.data, context.full_scale_dn or used.full_scale_dn),
        *edge_checks.line_flags(picture, rows),
        *edge_checks.noise_flags(profile, picture, used.black_level_dn),
        *(("low-signal",) if profile.step < LEAST_SNR * noise else ()),
        *(("defects",) if profile.defects else ()),
        *edge.flags,
        *_plain_flags(profile, half),
    ]
    common |= {"orientation_deg": orientation_deg(picture, profile.angle_rad), "flags": tuple(flags)}
    common["notes"] = (*edge.notes, "Normalised to the light inside the region.")
    measurements = _measurements(frequency, sfr, parts, profile, rows, picture, common)
    seconds = time.perf_counter() - began
    return Result(
        measurements=tuple(m.with_(seconds=seconds) for m in measurements),
        curves={"mtf": _curve(frequency, sfr, parts)},
        evidence={
            "edge-spread": {
                "figure": "edge-spread",
                "distance_px": profile.distance.tolist(),
                "value_dn": profile.value.tolist(),
                "sd_dn": np.sqrt(np.diag(profile.covariance)).tolist(),
                "step_dn": profile.step,
            }
        },
    )


def _narrowed(picture: Picture, edge: line.Line) -> tuple[Picture, line.Line]:
    """Return the picture cut to `WIDEST_PX` on both sides of the edge: beyond, a wider window brings only noise."""
    rows, cols = picture.value.shape
    ends = edge.position + edge.slope * np.array([-0.5, 0.5]) * (rows - 1)
    low = int(np.floor(max(ends.min() - WIDEST_PX, 0.0)))
    high = int(np.ceil(min(ends.max() + WIDEST_PX + 1.0, float(cols))))
    part = replace(picture, value=picture.value[:, low:high], row_index=picture.row_index[:, low:high])
    return part, replace(edge, position=edge.position - low)


def _hamming(distance: NDArray, half_width: float) -> Array:
    return np.where(np.abs(distance) <= half_width, 0.54 + 0.46 * np.cos(np.pi * distance / half_width), 0.0)


def _sfr(picture: Picture, edge: line.Line) -> tuple[Array, Array, Array]:
    """Return frequencies along the normal, the response of all rows, and that with each block of rows left out."""
    rows, cols = picture.value.shape
    across = edge.across((rows, cols)) + edge.position
    cell = np.floor(across * OVERSAMPLING).astype(np.int64)
    size = cols * OVERSAMPLING
    inside = (cell >= 0) & (cell < size)
    block = np.broadcast_to((np.arange(rows) * BLOCKS // rows)[:, None], (rows, cols))
    index = (block * size + np.clip(cell, 0, size - 1))[inside]
    sums = np.bincount(index, weights=picture.value[inside], minlength=BLOCKS * size).reshape(BLOCKS, size)
    counts = np.bincount(index, minlength=BLOCKS * size).reshape(BLOCKS, size).astype(float)
    total = np.concatenate([sums.sum(0)[None], sums.sum(0) - sums])
    number = np.concatenate([counts.sum(0)[None], counts.sum(0) - counts])
    response = np.stack([_response(t, n) for t, n in zip(total, number, strict=True)])
    angle = edge.angle_rad(picture.pitch_ratio)
    frequency = np.arange(response.shape[1]) / cols / np.cos(angle)
    return frequency, response[0], response[1:]


def _response(total: Array, number: Array) -> Array:
    """Return the modulus of the transform of one oversampled edge's derivative, corrected for the difference taken."""
    filled = number > 0
    place = np.arange(total.size)
    edge = np.interp(place, place[filled], total[filled] / number[filled])
    spread = np.zeros_like(edge)
    spread[1:-1] = 0.5 * (edge[2:] - edge[:-2])
    spread[0], spread[-1] = spread[1], spread[-2]
    centre = float(np.sum(place * spread) / np.sum(spread)) if np.sum(spread) > 0 else total.size / 2
    if not 0.1 * total.size < centre < 0.9 * total.size:
        centre = float(np.argmax(spread))
    shifted = np.roll(spread, round(total.size / 2 - centre))
    windowed = shifted * _hamming(place - (total.size - 1) / 2, 0.5 * total.size)
    modulus = np.abs(np.fft.rfft(windowed))[: total.size // OVERSAMPLING + 1]
    frequency = np.arange(modulus.size) * OVERSAMPLING / total.size / OVERSAMPLING
    # A difference over two quarter pixels is itself a filter, sinc(f / 2) at four samples a pixel.
    return modulus / modulus[0] / np.sinc(2.0 * frequency)


def _jackknife(parts: Array) -> Array:
    """Return the standard error from leave-one-block-out values (block, ...)."""
    count = len(parts)
    return np.sqrt((count - 1) / count * np.sum((parts - parts.mean(axis=0)) ** 2, axis=0))


def _plain_flags(profile, half: float) -> tuple[str, ...]:
    """Return flags of what this estimator, unlike the forward one, cannot allow for."""
    flags = []
    if not np.isfinite(half) or profile.gathered.half_width_px < 2.5 / half:
        flags.append("window-too-small")
    for side in (profile.distance < -8, profile.distance > 8):
        if np.count_nonzero(side) < 8:
            continue
        slope, _ = np.polyfit(profile.distance[side], profile.value[side], 1, w=np.sqrt(profile.count[side]))
        if abs(slope) * np.ptp(profile.distance[side]) > 0.025 * profile.step:
            flags.append("gradient")
    return tuple(flags)


def _measurements(frequency, sfr, parts, profile, rows, picture, common) -> list[Measurement]:
    found = []
    for quantity, level in (("mtf50", 0.5), ("mtf10", 0.1)):
        value = falls_to(frequency, sfr[None], level)[0]
        each = falls_to(frequency, parts, level)
        if not np.isfinite(value) or not np.isfinite(each).all() or value > FINE[-1]:
            found.append(
                refused(quantity, "cy/px", f"the response does not fall to {level:g} within 1 cy/px", **common)
            )
        else:
            found.append(from_sd(quantity, "cy/px", float(value), _spread(each, frequency), **common))
    for pinned in PINNED:
        each = np.array([np.interp(pinned, frequency, part) for part in parts])
        sd = float(_jackknife(each))
        value = float(np.interp(pinned, frequency, sfr))
        found.append(from_sd("mtf", "1", value, sd, frequency_cy_per_px=pinned, **common))
    rows_used = np.flatnonzero(np.isfinite(rows.offset))
    spread = rows.offset_sd / np.sqrt(np.sum((rows_used - rows_used.mean()) ** 2)) / picture.pitch_ratio
    found.append(
        from_sd("edge_angle", "deg", abs(float(np.rad2deg(profile.angle_rad))), float(np.rad2deg(spread)), **common)
    )
    return found


def _spread(each: Array, frequency: Array) -> float:
    """Return the error of a crossing: the jackknife's, a share of a frequency step, and the estimator's own bias."""
    own = OWN_ERROR * float(np.mean(each))
    return float(np.sqrt((1.2 * _jackknife(each)) ** 2 + (0.1 * (frequency[1] - frequency[0])) ** 2 + own**2))


def _curve(frequency: Array, sfr: Array, parts: Array) -> Curve:
    at = REPORTED
    value = np.interp(at, frequency, sfr)
    sd = _jackknife(np.array([np.interp(at, frequency, part) for part in parts]))
    return Curve(
        frequency_cy_per_px=at,
        value=value,
        interval68=np.stack([value - 0.994458 * sd, value + 0.994458 * sd]),
        interval95=np.stack([value - 1.959964 * sd, value + 1.959964 * sd]),
    )


def _nothing(reason: str, common: dict, began: float) -> Result:
    flags = ("no-target",) if reason.startswith("no target") else ("low-signal",)
    units = {"mtf50": "cy/px", "mtf10": "cy/px", "edge_angle": "deg"}
    seconds = time.perf_counter() - began
    return Result(
        measurements=tuple(
            refused(q, unit, reason, flags=flags, seconds=seconds, **common) for q, unit in units.items()
        )
    )
