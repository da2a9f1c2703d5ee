"""Frame-by-frame analysis of a point stack: background, source position and signal, noise, drift
and switch-off.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.point_stack import PointStack
from charact.estimators.bloom.source_view import SECTORS, Polar, polar_of
from charact.frames.robust import robust_sd
from charact.frames.thresholds import CLIPPING
from labdata import Array, FrameStack, Mask, Measurement, make_refusal, measurement_from_draws

# Side of the tiles whose means form the background, px.
TILE_PX = 6
# Minimum motion of a source, px, and relative change of light or background, through a stack.
LEAST_TRAVEL_PX, LEAST_CHANGE = 0.3, 0.05
# Fractions of the signal at which recovery is measured, by quantity.
SHARES = {"recovery_time_10": 0.1, "recovery_time_1": 0.01}
# Frames before and after a switch-off.
LEAST_ON, LEAST_OUT = 2, 2


@dataclass(frozen=True, kw_only=True)
class FrameSeries:
    """Frame-by-frame statistics of one stack.

    `spot`: position and thresholds of the source; `time_s`: time of each frame, shape (frame,), s,
    empty if unknown; `background_dn`, `background_sd_dn`, `background_by_frame_dn`: mean far from
    the source above dark, its standard error, and that of each frame; `centre_px`: row and column
    of the centre of the bright region of each frame, shape (frame, 2), NaN without a source;
    `light_by_frame`, `light_noise`: signal of the unsaturated pixels over the mean, and its pixel
    noise, NaN without a source; `noise`: signal above dark, temporal variance and its standard
    error, shape (3, level).
    """

    spot: PointStack
    time_s: Array
    background_dn: float
    background_sd_dn: float
    background_by_frame_dn: Array
    centre_px: Array
    light_by_frame: Array
    light_noise: float
    noise: Array


def frame_series(spot: PointStack, stack: FrameStack, row_pitch: float) -> FrameSeries:
    """Analyse one stack frame by frame."""
    data = np.asarray(stack.data)
    mean = data.mean(axis=0, dtype=np.float64)
    polar = polar_of((mean.shape[0], mean.shape[1]), spot.row, spot.col, row_pitch)
    tiles = _far_tiles(mean, polar.radius, np.abs(polar.dx))
    by_frame = _tiles(data)[:, tiles].mean(axis=1) - spot.dark_dn
    level = _tiles(mean)[tiles] - spot.dark_dn
    scatter = float(by_frame.std(ddof=1)) / np.sqrt(len(by_frame)) if len(by_frame) > 1 else 0.0
    variance = data.var(axis=0, ddof=1, dtype=np.float64) if len(data) > 1 else np.zeros(mean.shape)
    light, noise = _light(data, mean, polar.radius, by_frame, tiles, spot)
    return FrameSeries(
        spot=spot,
        time_s=np.asarray(stack.time_s, np.float64),
        background_dn=float(level.mean()),
        background_sd_dn=float(np.hypot(level.std(ddof=1) / np.sqrt(level.size), scatter)),
        background_by_frame_dn=by_frame,
        centre_px=_centres(data, mean, float(np.sqrt(np.median(_tiles(variance)[tiles]))), spot),
        light_by_frame=light,
        light_noise=noise,
        noise=_noise(data, mean, variance, polar, tiles, spot),
    )


def _tiles(image: NDArray) -> Array:
    """Means of square tiles, shape (.., row, col)."""
    rows, cols = (n // TILE_PX * TILE_PX for n in image.shape[-2:])
    shape = (*image.shape[:-2], rows // TILE_PX, TILE_PX, cols // TILE_PX, TILE_PX)
    return image[..., :rows, :cols].reshape(shape).mean(axis=(-3, -1), dtype=np.float64)


def _far_tiles(mean: Array, radius: Array, along: Array) -> Mask:
    """Tiles far from the source and its columns that contain only background."""
    tile_radius, level = _tiles(radius), _tiles(mean)
    off_column = _tiles(along) > 16
    take = off_column & (
        tile_radius
        >= np.quantile(tile_radius[off_column] if off_column.any() else tile_radius, 0.6)
    )
    take = take if take.any() else tile_radius >= np.median(tile_radius)
    spread = robust_sd(level[take])
    return take & (np.abs(level - np.median(level[take])) <= 4.0 * max(spread, 1e-3))


def _centres(data: NDArray, mean: Array, noise_dn: float, spot: PointStack) -> Array:
    """Centre of the pixels brighter than half the peak, or than half of full scale, in each
    frame.
    """
    row, col = round(spot.row), round(spot.col)
    span = spot.full_scale_dn - spot.dark_dn
    source_window = mean[max(0, row - 2) : row + 3, max(0, col - 2) : col + 3]
    floor = float(np.median(mean))
    threshold = max(
        min(0.5 * (floor + float(source_window.max())), spot.dark_dn + 0.5 * span),
        floor + 5.0 * noise_dn,
    )
    # A moving source may be far from the mean contour.
    half = int(np.ceil(0.5 * spot.bloom_px)) + 24
    centres = _middles(data, threshold, 0.2 * span, row - half, col - half, 2 * half + 1)
    # A source that no frame shows near its position is switched off or elsewhere.
    return (
        centres
        if np.isfinite(centres).all()
        else _middles(data, threshold, 0.2 * span, 0, 0, max(mean.shape))
    )


def _middles(
    data: NDArray, threshold: float, height_limit: float, row: int, col: int, side: int
) -> Array:
    """Centre of the signal above a threshold inside a window of each frame; NaN where there is
    none.
    """
    first, first_col = max(0, row), max(0, col)
    weight = np.clip(
        data[:, first : row + side, first_col : col + side].astype(np.float64) - threshold,
        0.0,
        height_limit,
    )
    total = weight.sum(axis=(1, 2))
    total = np.where(total > 0, total, np.nan)
    rows = (weight.sum(axis=2) @ (first + np.arange(weight.shape[1]))) / total
    cols = (weight.sum(axis=1) @ (first_col + np.arange(weight.shape[2]))) / total
    return np.stack([rows, cols], axis=1)


def _light(
    data: NDArray, mean: Array, radius: Array, background: Array, tiles: Mask, spot: PointStack
) -> tuple[Array, float]:
    """Signal of the source's unclipped, bright pixels by frame, relative to the mean frame, and its
    noise.
    """
    over = mean - (float(background.mean()) + spot.dark_dn)
    cut = (
        data >= spot.dark_dn + CLIPPING.near_full_fraction * (spot.full_scale_dn - spot.dark_dn)
    ).any(axis=0)
    within_source = radius < max(12.0, spot.bloom_px)
    quiet = robust_sd(over[~within_source]) if (~within_source).any() else 1.0
    lit = within_source & ~cut & (over > max(5.0 * quiet, 1.0))
    if lit.sum() < 4:
        return np.full(len(data), np.nan), float("nan")
    weight = over[lit] / (over[lit] ** 2).sum()
    light = (data[:, lit] - (background + spot.dark_dn)[:, None]) @ weight
    # The temporal noise of tiles includes correlation between pixels.
    tile = float(_tiles(data)[:, tiles].var(axis=0, ddof=1).mean()) if len(data) > 1 else quiet**2
    return light, TILE_PX * float(np.sqrt(tile * (weight**2).sum()))


def _noise(
    data: NDArray,
    mean: Array,
    variance: Array,
    polar: Polar,
    tiles: Mask,
    spot: PointStack,
) -> Array:
    """Signal, temporal variance and its standard error of the background and of groups of rings,
    shape (3, level).
    """
    ring, sector = polar.ring, polar.sector
    count = np.maximum(np.bincount(ring.ravel()), 1)
    # Rings are selected by their mean, since selection by the pixel's own value would be biased.
    by_ring = np.bincount(ring.ravel(), mean.ravel()) / count - spot.dark_dn
    small = _tiles(variance)[tiles]
    floor = float(_tiles(mean)[tiles].mean()) - spot.dark_dn
    levels = [(floor, float(small.mean()), float(small.std(ddof=1)) / np.sqrt(small.size))]
    cut = data.max(axis=0) >= spot.dark_dn + CLIPPING.near_full_fraction * (
        spot.full_scale_dn - spot.dark_dn
    )
    # Where some pixels are clipped, the unclipped ones are a biased sample.
    cut = (np.bincount(ring.ravel(), cut.ravel()) > 0.02 * count)[ring] | cut
    # Blur spreads variance less far than signal, so that variance is too small near a steep edge.
    cut |= (np.abs(np.gradient(by_ring)) > 0.3 * (by_ring - floor))[ring]
    ring_height = (by_ring - floor)[ring]
    for low, high in pairwise((3.0, 6.0, 12.0, 24.0, 48.0)):
        take = (ring_height >= low) & (ring_height < high) & (polar.radius > 8.0) & ~cut
        sector_counts = np.bincount(sector[take], minlength=SECTORS)
        full = sector_counts >= 3
        if full.sum() < SECTORS // 2:
            continue
        by_sector = (
            np.bincount(sector[take], variance[take], minlength=SECTORS)[full] / sector_counts[full]
        )
        error = float(by_sector.std(ddof=1)) / np.sqrt(full.sum())
        levels.append(
            (float(mean[take].mean()) - spot.dark_dn, float(variance[take].mean()), error)
        )
    return np.array(levels).T


def drift_of(watched: FrameSeries) -> tuple[float, float]:
    """Motion of the source through a stack, px, and relative drift of its signal or the background;
    0 where none.
    """
    row, col = watched.centre_px.T
    background = watched.background_by_frame_dn
    level = max(abs(float(background.mean())), 1.0)
    dim = _trend(background, LEAST_CHANGE * level) / level
    travel = float(np.hypot(_trend(row, LEAST_TRAVEL_PX), _trend(col, LEAST_TRAVEL_PX)))
    return travel, max(dim, _trend(watched.light_by_frame, LEAST_CHANGE))


def _trend(values: Array, least_change: float) -> float:
    """Change of a straight-line fit over successive values; 0 if not significant or below the
    limit.
    """
    from scipy.special import stdtr

    count = len(values)
    if count < 3 or not np.isfinite(values).all():
        return 0.0
    frame_offset, off = np.arange(count) - 0.5 * (count - 1), values - values.mean()
    slope = float(frame_offset @ off) / float(frame_offset @ frame_offset)
    # Student's t of the slope; `scipy.stats` would take longer to import than all fits.
    error = np.sqrt(
        float(np.sum((off - slope * frame_offset) ** 2))
        / (count - 2)
        / float(frame_offset @ frame_offset)
    )
    chance, run = (
        2.0 * float(stdtr(count - 2, -abs(slope) / max(error, 1e-300))),
        abs(slope) * (count - 1),
    )
    return run if chance < 1e-4 and run > least_change else 0.0


def frames_before_switch_off(watched: FrameSeries) -> int | None:
    """Return the number of frames before the source is switched off; None where it is not."""
    light = watched.light_by_frame
    if len(light) < LEAST_ON + LEAST_OUT or not np.isfinite(light).all() or light.max() <= 0:
        return None
    on = light > 0.6 * light.max()
    count = int(np.argmin(on)) if not on.all() else len(on)
    if (
        count < LEAST_ON
        or count > len(on) - LEAST_OUT
        or on[count:].any()
        or light[-1] > 0.5 * light[:count].mean()
    ):
        return None
    # Frames at the start of the decay are excluded.
    early = light[: max(LEAST_ON, count // 2)]
    least_light = early.mean() - 4.0 * max(float(early.std(ddof=1)), 0.005 * float(early.mean()))
    while count > LEAST_ON and light[count - 1] < least_light:
        count -= 1
    return count


def recoveries(watched: tuple[FrameSeries, ...], seed: int, **fields: Any) -> list[Measurement]:
    """Return the times until 10 % and 1 % of the source signal remain, for each stack with a
    switch-off.

    Switch-off happens between two frames, which the interval includes. Between frames the decay is
    exponential. Pixels saturated by the source are excluded.
    """
    switched = [
        (series, count)
        for series in watched
        if (count := frames_before_switch_off(series)) is not None
    ]
    if not switched:
        reason = (
            "no stack shows a switch-off: the source must be on in at least two frames and "
            "off in all later ones"
        )
        return [make_refusal(name, "s", reason, refusal="missing", **fields) for name in SHARES]
    return [
        _recovery(series, count, name, seed, **fields)
        for series, count in switched
        for name in SHARES
    ]


def _recovery(watched: FrameSeries, count: int, name: str, seed: int, **fields: Any) -> Measurement:
    """Time from switch-off to a fraction of the signal."""
    common = {"stack": watched.spot.label, **fields}
    fraction, lit, times = (
        SHARES[name],
        float(watched.light_by_frame[:count].mean()),
        watched.time_s,
    )
    noise, remaining_light = watched.light_noise / lit, watched.light_by_frame[count:] / lit
    reason = ""
    if len(times) == 0:
        reason = "the times of the frames are unknown"
    elif noise > 0.35 * fraction:
        reason = (
            f"noise is {100 * noise:.2g} % of the source's light: {100 * fraction:g} % is below it"
        )
    elif remaining_light[-1] > fraction - 2.0 * noise:
        percent = 100 * max(remaining_light[-1], 0.0)
        reason = f"at the end of the stack {percent:.2g} % of the light is left"
    if reason:
        return make_refusal(name, "s", reason, **common)
    rng, draws = np.random.default_rng(seed), []
    for _ in range(2000):
        out = float(rng.uniform(times[count - 1], times[count]))
        light = np.concatenate(
            [[1.0], remaining_light + noise * rng.standard_normal(len(remaining_light))]
        )
        last = int(np.argmax(light < fraction))
        if last == 0:
            continue
        begin = out if last == 1 else times[count + last - 2]
        high, low = np.log(light[last - 1]), np.log(max(light[last], 0.1 * fraction))
        draws.append(
            begin
            + (high - np.log(fraction)) / (high - low) * (times[count + last - 1] - begin)
            - out
        )
    return measurement_from_draws(name, "s", np.array(draws), **common)
