"""Ends of the scale that frames reach: one definition for every method.

The ceiling F is the lowest of full scale, where it is stated, of full wells, whose pixels are as
quiet in time as those without light (`full_wells`), and of the highest code, where a
plateau of touching pixels of one frame, or a pixel in several frames, holds it. Noise has single
highest values; m of them have one code by chance with the probability p = (2 sqrt(pi) s)^(1 - m), s
the noise in codes (the density at 0 of the difference of two normal values). A plateau is shown
where p is small and few values are close below it, at any code: full scale of a digitiser, white of
video (235), a sensor's own ceiling.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.frames.thresholds import CLIPPING, STACK
from labdata.importers.full_scale import ends_at
from labdata.importers.thresholds import LEAST_PIXELS


def ceiling_of(data: NDArray, full_scale_dn: float | None) -> float | None:
    """Return the lower one of full scale and of a ceiling that a plateau shows, DN; None: unknown.

    Parameters
    ----------
    data
        Pixel values, shape (frame, row, col), DN.
    full_scale_dn
        Stated full scale, DN; None: unknown, and a plateau at the highest code of a digitiser
        needs no noise near it.
    """
    shown = _shown_ceiling(data, needs_noise=full_scale_dn is not None)
    return min((end for end in (full_scale_dn, shown) if end is not None), default=None)


def full_wells(data: NDArray) -> float | None:
    """Return the level of pixels whose wells are full, DN; None where none are seen.

    Notes
    -----
    A full well has no shot noise: in time its pixel is as quiet as one without light, while those
    of half as much light are noisy. Pixels are chosen by the first frame, and their variances are
    those of the others.
    """
    count, first = CLIPPING.well_pixels, data[0].ravel()
    low, high = float(first.min()), float(first.max())
    sample = np.abs(first[:: 1 + first.size // CLIPPING.sample] - 0.5 * (low + high))
    # Noise of a flat has most values half way between its ends.
    if len(data) < CLIPPING.well_frames or np.median(sample) <= 0.25 * (high - low):
        return None
    groups = []
    for level in (0.5 * (low + high), low, high):
        near = np.flatnonzero(np.abs(first - level) < 0.35 * (high - low))[: CLIPPING.sample]
        if near.size < count:
            return None
        near = near[np.argsort(np.abs(first[near] - level))[:count]]
        groups.append(data[1:].reshape(len(data) - 1, -1)[:, near])
    middle, dark, bright = (float(np.median(pixels.var(axis=0, dtype=float))) for pixels in groups)
    quiet = CLIPPING.quiet_ratio * max(dark, 1.0 / 12.0)
    if bright > quiet or middle < CLIPPING.noisy_ratio * quiet:
        return None
    # Among the brightest some may be full in few frames.
    return float(np.quantile(groups[2], CLIPPING.partly_full)) - 2.0 * quiet**0.5


def _shown_ceiling(data: NDArray, *, needs_noise: bool) -> float | None:
    """Return the ceiling that whole codes show by a plateau, DN; None if they show none."""
    highest = data.max()
    full = data == highest
    touching = int(np.count_nonzero(full[:, 1:] & full[:, :-1]))
    touching += int(np.count_nonzero(full[..., 1:] & full[..., :-1]))
    pixels, count = np.count_nonzero(full.any(axis=0)), np.count_nonzero(full)
    if not (touching or count > pixels) or not np.all(data[0] == np.rint(data[0])):
        return None
    if touching and not needs_noise and ends_at(int(highest), LEAST_PIXELS):
        return float(highest)
    # Touching pairs of a frame, or the pixels of a plateau less one; and the frames of a pixel.
    pairs = touching / np.count_nonzero(full.any(axis=(1, 2))) + count / pixels - 1.0
    noise = _noise_below(data[0], 0.5 * (float(highest) + float(data.min())))
    if noise < CLIPPING.least_noise_codes:
        return None
    chance = (2.0 * np.sqrt(np.pi) * noise) ** -pairs
    # Noise of an even plateau has more values just below its highest one.
    close = np.count_nonzero(data >= highest - 2.0 * noise) - count
    is_plateau = chance < CLIPPING.max_plateau_chance and count > close
    return float(highest) if is_plateau else None


def is_cut(
    mean: NDArray[np.float64], brightest: NDArray, black_dn: float, full_dn: float
) -> NDArray[np.bool_]:
    """Return the groups of pixels, such as rings, whose mean full scale may lower.

    `mean`, `brightest`: mean and largest value of each group, shape (group,), DN.
    """
    linear_dn = black_dn + CLIPPING.linear_fraction * (full_dn - black_dn)
    return (mean > linear_dn) | (brightest > CLIPPING.near_full_fraction * full_dn)


def is_clipped(data: NDArray, full_scale_dn: float | None) -> bool:
    """Return whether pixels pile up at an end of the scale.

    Parameters
    ----------
    data
        Pixel values, shape (frame, ..., col), DN.
    full_scale_dn
        Full scale, DN; None: unknown, and the highest value may be full scale.

    Notes
    -----
    Noise spreads over several grey values, of which the outermost are the rarest. A pile-up is an
    extreme value that many pixels have and that is several times as frequent as the adjacent value.
    A bright plateau of a single value is clipped if the darker side shows noise. Data without
    noise, such as rendered or averaged frames, are not clipped for having a flat plateau. Clipped
    pixels alternate between the extreme value and values several steps away; where they do, the
    extreme value may be as rare as the adjacent one.
    """
    # Without a pile-up the histogram of all values is not needed.
    extremes = np.count_nonzero(data == data.max()), np.count_nonzero(data == data.min())
    if not max(extremes) > CLIPPING.pile_up_fraction * data.size:
        return False
    if data.dtype.kind == "u" and data.dtype.itemsize <= 2:
        counts = np.bincount(data.ravel())
        values = np.flatnonzero(counts)
        counts = counts[values]
    else:
        values, counts = np.unique(data, return_counts=True)
    if values.size < 3:
        return data.size > 64
    fraction, middle = counts / data.size, 0.5 * (float(values[0]) + float(values[-1]))
    least_noise = CLIPPING.min_relative_noise * float(values[-1] - values[0])
    clipped = full_scale_dn is not None and bool(
        values[-1] >= full_scale_dn and fraction[-1] > CLIPPING.pile_up_fraction
    )
    noise, step = _noise_below(data[0], middle), float(np.diff(values).min())
    noisy = noise > least_noise and values.size > 12
    top = (
        fraction[-1] > 2 * CLIPPING.pile_up_fraction
        and counts[-1] > CLIPPING.pile_up_ratio * counts[-2]
    )
    # Normal noise in the middle of a step leaves this fraction at one value.
    at_one_value = math.erf(step / (2.0 * math.sqrt(2.0) * noise)) if noise > 0.0 else 1.0
    plateau_fraction = max(CLIPPING.plateau_fraction, 0.5 * (1.0 + at_one_value))
    bottom = (
        fraction[0] > 2 * CLIPPING.pile_up_fraction
        and counts[0] > CLIPPING.pile_up_ratio * counts[1]
    )
    brighter = np.count_nonzero(data > middle)
    clipped |= bool(
        top
        and noisy
        and noise >= CLIPPING.least_noise_codes * step
        and counts[-1] > plateau_fraction * brighter
    )
    # Black clips at zero or at the floor of the video range; a quiet plateau above either is not
    # clipped.
    if bottom and values[0] in CLIPPING.video_floors_dn and values.size > 12:
        clipped |= _noise_below(-np.asarray(data[0], np.float64), -middle) > least_noise
    clipped |= bool(top and not bottom and noisy and fraction[-2] > 1e-4)
    return clipped or any(_cuts_noise(data, values, counts, end=end) for end in (0, -1))


def _noise_below(frame: NDArray, level: float) -> float:
    """Return the noise of the pixels below a level, DN, from differences of neighbours along rows.

    From the median of their sizes; where most are 0, from the covariance of successive ones: that
    of white noise is -sigma^2, that on the slopes of a picture without noise is positive.
    """
    frame = np.asarray(frame, np.float64)
    is_dark = frame <= level
    difference = np.diff(frame, axis=-1)
    sizes = np.abs(difference[is_dark[..., 1:] & is_dark[..., :-1]])
    if not sizes.size:
        return 0.0
    middle, largest = np.quantile(sizes, (0.5, CLIPPING.ordinary_differences))
    if middle > 0.0:
        return 1.05 * float(middle)
    ordinary = np.clip(difference, -largest, largest)
    are_dark = is_dark[..., 2:] & is_dark[..., 1:-1] & is_dark[..., :-2]
    products = (ordinary[..., 1:] * ordinary[..., :-1])[are_dark]
    return float(np.sqrt(max(-products.mean(), 0.0))) if products.size else 0.0


def _cuts_noise(data: NDArray, values: NDArray, counts: NDArray, *, end: int) -> bool:
    """Return whether noise is clipped at the lowest (end 0) or highest (end -1) value.

    Noise moves a pixel of the pile several steps from one frame to the next, or in a single frame
    between two neighbours that stay.
    """
    inwards = values[::-1] if end else values
    piled_up, adjacent = counts[[-1, -2]] if end else counts[:2]
    min_count = max(
        CLIPPING.min_pile_pixels,
        2 * CLIPPING.pile_up_fraction * data.size,
        CLIPPING.noisy_pile_up_ratio * adjacent,
    )
    if piled_up < min_count or values.size <= 12:
        return False
    piled = data == inwards[0]
    is_far = (
        data <= inwards[CLIPPING.clipped_steps] if end else data >= inwards[CLIPPING.clipped_steps]
    )
    if len(data) > 1:
        crossing = np.count_nonzero(piled[:-1] & is_far[1:])
        staying = np.count_nonzero(piled[:-1] & piled[1:])
    else:
        crossing = np.count_nonzero(piled[..., :-2] & is_far[..., 1:-1] & piled[..., 2:])
        staying = np.count_nonzero(piled[..., :-1] & piled[..., 1:])
    return bool(
        crossing > max(CLIPPING.min_pile_pixels, CLIPPING.min_crossing * piled_up)
        and staying > max(CLIPPING.min_pile_pixels, CLIPPING.min_staying * piled_up)
    )


def is_clipped_at_black(codes: NDArray) -> bool:
    """Return whether the noise is clipped at the lowest grey value.

    `codes`: values around a source, any shape.

    Notes
    -----
    The upper half of a normal distribution predicts the lower one: the fraction above a grey value
    gives z(fraction) standard deviations. Three grey values, including the lowest, must agree on
    the standard deviation; the predicted fraction below the lowest must not be missing. Quiet
    pixels, and pulses on quiet pixels, are not normal and do not count.
    """
    from scipy.special import ndtr, ndtri

    code, number = np.unique(codes, return_counts=True)
    number_above = codes.size - np.cumsum(number)
    median_index = int(np.argmax(number_above <= 0.5 * number_above[0]))
    upper_index = max(int(np.argmax(number_above <= 0.05 * number_above[0])), median_index + 1)
    if median_index == 0 or upper_index >= code.size or number_above[upper_index] < 20:
        return False
    at, z = (
        code[[0, median_index, upper_index]].astype(float),
        ndtri(1.0 - number_above[[0, median_index, upper_index]] / codes.size),
    )
    lower, upper = np.diff(at) / np.diff(z)
    missing = float(ndtr(z[0] - float(np.diff(code).min()) / lower))
    return bool(
        missing > CLIPPING.max_clipped_noise
        and max(lower / upper, upper / lower) < CLIPPING.max_sd_ratio
    )


@dataclass(frozen=True, kw_only=True)
class ClippedCounts:
    """Number of values at 0 DN and at full scale."""

    # values, frames: counted values and frames
    values: int
    frames: int
    # low, full: values at 0 DN, and at or above full scale if stated
    low: int
    full: int
    # largest, largest_count: the largest value and its count
    largest: float
    largest_count: int
    # next_largest, next_count: the next largest value and its count; 0 if the largest is rare
    next_largest: float
    next_count: int

    @property
    def low_fraction(self) -> float:
        """Fraction of values at 0 DN."""
        return self.low / self.values

    @property
    def high_fraction(self) -> float:
        """Fraction at full scale, or at the largest value if values accumulate there.

        A smooth distribution falls towards its largest value; grey values need not be consecutive
        integers.
        """
        likely = self.next_count + STACK.accumulated_sd * np.sqrt(self.next_count)
        piled = (
            self.next_count
            and self.largest_count >= max(STACK.accumulated * self.frames, 2 * STACK.accumulated)
            and self.largest_count >= likely
        )
        shown = float(self.largest).is_integer() and ends_at(int(self.largest), self.largest_count)
        return max(self.full, self.largest_count if piled or shown else 0) / self.values


def count_clipped(data: NDArray, full_scale_dn: float | None) -> ClippedCounts:
    """Count the clipped values of frames."""
    flat = data.reshape(-1)
    largest, largest_count, next_largest, next_count = _top(flat)
    full = 0
    if full_scale_dn is not None and largest >= full_scale_dn:
        full = (
            largest_count
            if largest == full_scale_dn
            else int(np.count_nonzero(flat >= full_scale_dn))
        )
    # With negative values, 0 is not the lower limit.
    low = int(np.count_nonzero(flat == 0)) if flat.min() == 0 else 0
    return ClippedCounts(
        values=flat.size,
        frames=len(data),
        low=low,
        full=full,
        largest=float(largest),
        largest_count=int(largest_count),
        next_largest=float(next_largest),
        next_count=int(next_count),
    )


def sum_counts(parts: list[ClippedCounts]) -> ClippedCounts:
    """Return the sum of the counts."""
    counts: dict[float, int] = {}
    for value, count in [(p.largest, p.largest_count) for p in parts] + [
        (p.next_largest, p.next_count) for p in parts
    ]:
        counts[value] = counts.get(value, 0) + count
    first, *lower = sorted(counts, reverse=True)
    second = lower[0] if lower else first
    return ClippedCounts(
        values=sum(p.values for p in parts),
        frames=sum(p.frames for p in parts),
        low=sum(p.low for p in parts),
        full=sum(p.full for p in parts),
        largest=first,
        largest_count=counts[first],
        next_largest=second,
        next_count=counts[second] if lower else 0,
    )


def _top(flat: NDArray) -> tuple[float, int, float, int]:
    """Return the largest value and its count, and if it is frequent the next largest."""
    largest = flat.max()
    largest_count = int(np.count_nonzero(flat == largest))
    less = flat[flat < largest] if largest_count >= 2 * STACK.accumulated else flat[:0]
    if not less.size:
        return largest, largest_count, largest, 0
    following = less.max()
    return largest, largest_count, following, int(np.count_nonzero(less == following))
