"""Location of bars that cross a complete region, whose ends are not visible."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from charact.estimators.mtf.bars.bar_image_model import BarShape, table_of
from charact.estimators.mtf.bars.target import (
    BarTarget,
    blank_target,
    detect_bars,
    ground_level,
    refine_target,
    vertex_shift,
)
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.transfer.cores import ON_BARS
from labdata import Array, Mask

# Trial directions around the grid's axes.
TILTS_DEG = np.arange(-12.0, 12.1, 1.0)
TYPICAL = {
    "log_attenuation": -0.4,
    "form": ON_BARS[0],
    "form_one": ON_BARS[0].first.start,
    "form_two": 0.0,
    "departure": 0.0,
}


# Trial frequencies over that of the spectral peak.
FREQUENCIES = np.linspace(0.92, 1.08, 9)


def spans_region(image: Array, *, bars: int, frequency: float) -> bool:
    """Return whether a patch of light as wide as the bars meets two opposite borders of a
    region.
    """
    from scipy.ndimage import uniform_filter1d

    for picture in (image, image.T):
        depth = max(picture.shape[0] // 8, 2)
        width = int(min(bars / frequency, 0.6 * picture.shape[1])) or 1
        centre = (picture.shape[0] - depth) // 2
        bands = [
            picture[top : top + depth].mean(axis=0) for top in (0, centre, picture.shape[0] - depth)
        ]
        height = [float(np.ptp(uniform_filter1d(band, width))) for band in bands]
        if min(height[0], height[2]) > LIMITS.min_end_light * height[1]:
            return True
    return False


def strip_of(image: Array, *, bars: int, frequency: float, pitch_ratio: float) -> BarTarget | None:
    """Return the target that crosses a region along either axis, or None.

    `image`: mean frame, shape (row, col).

    Notes
    -----
    The mean profile along each trial direction is correlated with that of the bars under a typical
    blur.
    """
    centre = ((image.shape[0] - 1) / 2.0, (image.shape[1] - 1) / 2.0)
    blank = replace(blank_target(bars, frequency, pitch_ratio), row=centre[0], col=centre[1])
    template = _template(blank)
    matches = [
        _best(image, replace(blank, angle_rad=float(np.deg2rad(axis + tilt))), template)
        for axis in (0.0, 90.0)
        for tilt in TILTS_DEG
        if image.shape[int(axis == 0.0)] * (1.0 if axis == 0.0 else pitch_ratio) > blank.width_px
    ]
    match, target = max(matches, key=lambda scored: scored[0], default=(0.0, None))
    return target if match > LIMITS.min_strip_match_sd else None


def _best(image: Array, target: BarTarget, template: Array) -> tuple[float, BarTarget]:
    """Return the match of the profile along one direction in standard uncertainties, and the target
    there.
    """
    across, _ = target.coordinates(image.shape)
    first = float(np.floor(across.min()))
    position = ((across - first) / ACCURACY.profile_bin_px).astype(np.intp).ravel()
    count = np.bincount(position)
    values = (image - np.median(image)).ravel()
    profile = np.bincount(position, values)
    filled = count > 0
    mean = profile[filled].sum() / count.sum()
    profile = np.where(filled, profile - mean * count, 0.0)
    if template.size >= profile.size:
        return 0.0, target
    # Least squares of the template at each shift, with a free mean.
    weight = np.correlate(count.astype(float), np.ones(template.size), "valid")
    cross = np.correlate(profile, template, "valid")
    template_sum = np.correlate(count.astype(float), template, "valid")
    square = np.correlate(count.astype(float), template**2, "valid")
    inner = np.correlate(profile, np.ones(template.size), "valid")
    power = np.maximum(square - template_sum**2 / np.maximum(weight, 1.0), 1e-9)
    signed = cross - template_sum * inner / np.maximum(weight, 1.0)
    gain = signed**2 / power
    best = int(np.argmax(gain))
    spread = float(np.sum(values**2) / values.size - (values.mean()) ** 2)
    centre = first + (best + template.size / 2.0) * ACCURACY.profile_bin_px
    shifted = replace(
        target,
        sign=1 if signed[best] > 0 else -1,
        col=target.col + centre * np.cos(target.angle_rad),
        row=target.row + centre * np.sin(target.angle_rad) / target.pitch_ratio,
    )
    unexplained = max(spread * values.size - float(gain[best]), 1e-9)
    return float(np.sqrt(gain[best] / (unexplained / values.size))), shifted


def _template(target: BarTarget) -> Array:
    """Return the profile of the bars under a typical blur, at bin centres."""
    half = target.width_px / 2.0 + 0.75 / target.frequency
    shape = BarShape(
        bars=target.bars,
        frequency=target.frequency,
        length_px=np.inf,
        reference=target.frequency,
        angle_rad=0.0,
        **TYPICAL,
    )
    positions = (np.arange(int(2 * half / ACCURACY.profile_bin_px)) + 0.5) * ACCURACY.profile_bin_px
    positions = positions - positions.mean()
    return table_of(shape, half, 1.0).at(positions, positions)[0]


@dataclass(frozen=True, kw_only=True)
class LocatedBars:
    """Located bars, and whether they cross the region from border to border."""

    target: BarTarget
    through: bool


def bars_in(
    image: Array, *, bars: int | None, frequency: float | None, pitch_ratio: float
) -> LocatedBars | None:
    """Return the bars in a region; None where there are none.

    `image`: mean frame, shape (row, col); `bars`, `frequency`: their number and cycles per column
    pitch, where stated.

    Notes
    -----
    The strongest spectral peaks are tried in turn. The bars lie where the image, demodulated at the
    peak, keeps half of its amplitude. Their profile is fitted with N blurred bars on a constant
    background, with free N, frequency, blur, centre and sign. Of the waves that explain about as
    much of it the strongest is chosen: the others are side lobes.
    """
    looked: list[tuple[float, LocatedBars]] = []
    for wave, angle_rad in _waves(image, frequency, pitch_ratio):
        blank = BarTarget(
            bars=bars or 0,
            frequency=wave,
            angle_rad=angle_rad,
            row=0.0,
            col=0.0,
            pitch_ratio=pitch_ratio,
            length_px=0.0,
            sign=1,
        )
        patch = _patch(image, blank)
        counted = _count_bars(image, patch, blank, bars)
        if counted is not None:
            looked.append(
                (
                    counted[0],
                    LocatedBars(target=counted[1], through=_runs_through(patch, angle_rad)),
                )
            )
    best_explained = max((explained for explained, _ in looked), default=0.0)
    return next(
        (
            located
            for explained, located in looked
            if explained > max(LIMITS.min_explained, LIMITS.min_relative_explained * best_explained)
        ),
        None,
    )


def _waves(
    image: Array, frequency: float | None, pitch_ratio: float
) -> Iterator[tuple[float, float]]:
    """Yield frequency and direction of the highest peaks of an image's spectrum, weighted by
    frequency.

    The weight suppresses the light of the complete patch.
    """
    from scipy.fft import next_fast_len, rfft2
    from scipy.ndimage import maximum_filter

    size = tuple(int(next_fast_len(2 * side, True) or 0) for side in image.shape)
    fy, fx = np.fft.fftfreq(size[0])[:, None] / pitch_ratio, np.fft.rfftfreq(size[1])[None, :]
    radius = np.hypot(fx, fy)
    height = np.abs(np.asarray(rfft2(image - ground_level(image), s=size))) * radius
    height[radius < 1.5 / np.hypot(*image.shape)] = 0.0
    if frequency is not None:
        height[np.abs(radius / frequency - 1.0) > LIMITS.max_frequency_offset] = 0.0
    height[size[0] // 2 + 1 :, 0] = 0.0
    top = (height == maximum_filter(height, 5)) & (height > 0.0)
    rows, cols = np.nonzero(top)
    for position in np.argsort(-height[rows, cols])[:8]:
        row, col = int(rows[position]), int(cols[position])
        down = (row + vertex_shift(height[:, col], row) + size[0] / 2) % size[0] - size[0] / 2
        right = col + vertex_shift(height[row], col)
        wave = np.array([right / size[1], down / size[0] / pitch_ratio])
        yield float(frequency or np.hypot(*wave)), float(np.arctan2(wave[1], wave[0]))


def _patch(image: Array, wave: BarTarget) -> Mask:
    """Return the pixels around the maximum of a wave that keep half of its amplitude, shape (row,
    col).
    """
    from scipy.ndimage import gaussian_filter, label

    across, _ = wave.coordinates(image.shape)
    turned = (image - ground_level(image)) * np.exp(-2j * np.pi * wave.frequency * across)
    width = ACCURACY.smoothing_periods / wave.frequency
    sigma = (width / wave.pitch_ratio, width)

    def smooth(part: Array) -> Array:
        return np.asarray(gaussian_filter(part, sigma, mode="constant"))

    amplitude = np.hypot(smooth(np.real(turned)), smooth(np.imag(turned))) / smooth(
        np.ones(image.shape)
    )
    parts = np.zeros(image.shape, np.int32)
    label(amplitude > LIMITS.patch_level * amplitude.max(), output=parts)
    return parts == parts.flat[int(np.argmax(amplitude))]


def _runs_through(patch: Mask, angle_rad: float) -> bool:
    """Return whether a patch reaches the borders at both ends of its bars."""
    ends = patch if abs(np.cos(angle_rad)) > abs(np.sin(angle_rad)) else patch.T
    return bool(ends[0].any() and ends[-1].any())


def _count_bars(
    image: Array, patch: Mask, wave: BarTarget, bars: int | None
) -> tuple[float, BarTarget] | None:
    """Return the fraction of a patch's profile explained by N blurred bars, and the best target."""
    across, along = wave.coordinates(image.shape)
    centre = (
        0.5 * (across[patch].min() + across[patch].max()),
        0.5 * (along[patch].min() + along[patch].max()),
    )
    width, length = np.ptp(across[patch]), np.ptp(along[patch])
    on_group = (np.abs(across - centre[0]) < 0.5 * width + 1.2 / wave.frequency) & (
        np.abs(along - centre[1]) < max(0.4 * length, 1.0)
    )
    step = max(1.0 / (12.0 * wave.frequency), 0.5)
    index = np.floor((across[on_group] - across[on_group].min()) / step).astype(np.intp)
    count = np.bincount(index)
    filled = count > 0
    position = (
        np.bincount(index, across[on_group])[filled] / count[filled] - centre[0]
    ) * wave.frequency
    value = np.bincount(index, image[on_group])[filled] / count[filled]
    guess = round(width * wave.frequency)
    numbers = (
        [bars]
        if bars
        else [
            n
            for n in range(guess - ACCURACY.count_range, guess + ACCURACY.count_range + 1)
            if n > 1
        ]
    )
    if position.size < 8 or not numbers or numbers[0] > LIMITS.max_bars:
        return None
    on_bars = np.abs(position) < 0.5 * width * wave.frequency
    phase = float(
        np.angle(
            np.sum(
                (value - value[on_bars].mean())[on_bars] * np.exp(2j * np.pi * position[on_bars])
            )
        )
    )
    explained, number, ratio, shift, sign = max(
        (_match_profile(position, value, number, phase / (2.0 * np.pi)) for number in numbers),
        key=lambda scored: scored[0],
    )
    needed_periods = 0.5 * number / ratio + LIMITS.min_background_periods
    if position[0] > shift - needed_periods or position[-1] < shift + needed_periods:
        return None
    x = centre[0] + shift / wave.frequency
    cosine, sine = np.cos(wave.angle_rad), np.sin(wave.angle_rad)
    target = replace(
        wave,
        bars=number,
        frequency=wave.frequency * ratio,
        row=float(x * sine + centre[1] * cosine) / wave.pitch_ratio,
        col=float(x * cosine - centre[1] * sine),
        length_px=float(length),
        sign=sign,
    )
    return explained, target


def _match_profile(
    position: Array, value: Array, bars: int, peak: float
) -> tuple[float, int, float, float, int]:
    """Return the explained fraction of a profile, and number, frequency, centre and sign of the
    bars.

    `position`: positions across the bars in periods of the wave, shape (point,); `peak`: position
    of a maximum of the wave, periods: centre of a bar or a gap.
    """
    from scipy.special import ndtr

    background = np.linalg.qr(np.stack([np.ones_like(position), position], axis=1))[0]
    residual = value - background @ (background.T @ value)
    middles = peak + 0.5 * np.arange(-3, 4)
    ratio, centre, blur = (
        axis_grid.ravel()
        for axis_grid in np.meshgrid(FREQUENCIES, middles, ACCURACY.trial_blurs, indexing="ij")
    )
    bars_at = np.arange(bars) - 0.5 * (bars - 1)
    phase = (position - centre[:, None]) * ratio[:, None]
    shape = np.zeros(phase.shape)
    for at in bars_at:
        shape += ndtr((phase - at + 0.25) / blur[:, None]) - ndtr(
            (phase - at - 0.25) / blur[:, None]
        )
    shape -= (shape @ background) @ background.T
    inner, power = shape @ residual, np.maximum(np.sum(shape**2, axis=1), 1e-9)
    gain = inner**2 / power
    best = int(np.argmax(gain))
    total = max(float(residual @ residual), 1e-300)
    grid = gain.reshape(FREQUENCIES.size, -1)[:, best % (middles.size * len(ACCURACY.trial_blurs))]
    row = best // (middles.size * len(ACCURACY.trial_blurs))
    finer = vertex_shift(grid, row) if 0 < row < FREQUENCIES.size - 1 else 0.0
    fitted_ratio = float(ratio[best] + finer * (FREQUENCIES[1] - FREQUENCIES[0]))
    return (
        float(gain[best]) / total,
        bars,
        fitted_ratio,
        float(centre[best]),
        1 if inner[best] > 0 else -1,
    )


def target_in(
    image: Array, *, bars: int | None, frequency: float | None, pitch_ratio: float
) -> LocatedBars | None:
    """Return the target of a region, unstated properties measured; None where there is none.

    `image`: mean frame, shape (row, col); `bars`, `frequency`: their number and cycles per column
    pitch, or None.
    """
    if bars is None or frequency is None:
        located = bars_in(image, bars=bars, frequency=frequency, pitch_ratio=pitch_ratio)
        if located is None or located.through:
            return located
        return replace(located, target=refine_target(image, located.target))
    if spans_region(image, bars=bars, frequency=frequency):
        target = strip_of(image, bars=bars, frequency=frequency, pitch_ratio=pitch_ratio)
        if target is not None:
            return LocatedBars(target=target, through=True)
    target = detect_bars(image, bars=bars, frequency=frequency, pitch_ratio=pitch_ratio)
    return None if target is None else LocatedBars(target=target, through=False)
