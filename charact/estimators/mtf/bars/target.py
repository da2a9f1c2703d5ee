"""Geometry of a bar target: position, direction, length, frequency, window."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.estimators.mtf.known_transfer import halo_diameters_px
from charact.method import Context
from charact.transfer.extended import halo
from charact.transfer.stages import image_tube
from labdata.camera.description import has_tube
from labdata.camera.parameters import Parameter

Array = NDArray[np.float64]

DIRECTIONS_DEG = np.arange(0.0, 180.0, 10.0)
RAYLEIGH_TENTH = float(np.sqrt(-2.0 * np.log(0.9)))


@dataclass(frozen=True, kw_only=True)
class BarTarget:
    """Bars in an image, in column pitches; rows are scaled by the pitch ratio."""

    bars: int  # Number of bars
    frequency: float  # Cycles per column pitch
    angle_rad: float  # Direction across the bars, from the row direction
    # row, col: centre, px
    row: float
    col: float
    pitch_ratio: float  # Row pitch over column pitch
    length_px: float  # Length of the bars, column pitches
    sign: int = 1  # 1: brighter than the background, -1: darker

    @property
    def width_px(self) -> float:
        """Extent across the bars, column pitches."""
        return self.bars / self.frequency

    def coordinates(self, shape: tuple[int, ...]) -> tuple[Array, Array]:
        """Return the distance of every pixel from the centre, across and along the bars, column
        pitches.
        """
        return self.coordinates_of(np.arange(shape[0])[:, None], np.arange(shape[1])[None, :])

    def coordinates_of(self, row: NDArray, col: NDArray) -> tuple[Array, Array]:
        """Return the same of pixels at rows and columns."""
        x, y = col - self.col, (row - self.row) * self.pitch_ratio
        cosine, sine = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return x * cosine + y * sine, y * cosine - x * sine

    def box(self, shape: tuple[int, ...], margin_px: float) -> NDArray[np.bool_]:
        """Return the pixels on the target or within a margin of it."""
        across, along = self.coordinates(shape)
        return (np.abs(across) < self.width_px / 2 + margin_px) & (
            np.abs(along) < self.length_px / 2 + margin_px
        )


def blank_target(bars: int, frequency: float, pitch_ratio: float) -> BarTarget:
    """Return bars of the standard length at the first pixel, upright."""
    return BarTarget(
        bars=bars,
        frequency=frequency,
        angle_rad=0.0,
        row=0.0,
        col=0.0,
        pitch_ratio=pitch_ratio,
        length_px=LIMITS.length_over_width / (2.0 * frequency),
    )


def ground_level(image: Array) -> float:
    """Return the median level of a region's border, which a complete target does not reach."""
    return float(
        np.median(
            np.concatenate(
                [image[:2].ravel(), image[-2:].ravel(), image[:, :2].ravel(), image[:, -2:].ravel()]
            )
        )
    )


def core_margin_px(frequency: float) -> float:
    """Return the margin around bars that contains most of their light."""
    return 0.5 / frequency + 2.0


def amplitude(
    image: Array, target: BarTarget, frequency: float, window: NDArray[np.bool_]
) -> complex:
    """Return the Fourier sum of the window's pixels at a frequency across the bars."""
    across, _ = target.coordinates_of(*np.nonzero(window))
    return complex(np.sum(image[window] * np.exp(-2j * np.pi * frequency * across)))


def detect_bars(
    image: Array, *, bars: int, frequency: float, pitch_ratio: float
) -> BarTarget | None:
    """Return the target with the largest response to a matched filter, or None below the noise.

    `image`: mean frame, shape (row, col).
    """
    from scipy.fft import next_fast_len, rfft2

    blank = blank_target(bars, frequency, pitch_ratio)
    kernel_half_px = int(np.ceil(0.5 * np.hypot(blank.width_px, blank.length_px))) + 1
    rows, cols = (next_fast_len(side + 2 * kernel_half_px, True) or side for side in image.shape)
    size = (rows, cols)
    spectrum = np.asarray(rfft2(image - ground_level(image), s=size))
    best: tuple[float, BarTarget] | None = None
    quiet = np.inf
    for degrees in DIRECTIONS_DEG:
        turned = replace(blank, angle_rad=float(np.deg2rad(degrees)))
        response = _response(spectrum, size, turned, kernel_half_px, image.shape)
        row, col = np.unravel_index(int(np.argmax(response)), response.shape)
        height = float(response[row, col])
        # Where a large target gives no response there is only noise: a low quantile of a Rayleigh
        # distribution.
        quiet = min(quiet, float(np.quantile(response, 0.1)) / RAYLEIGH_TENTH)
        if best is None or height > best[0]:
            best = (height, replace(turned, row=float(row), col=float(col)))
    if (
        best is None
        or not best[0] > LIMITS.min_filter_response * quiet + 1e-9 * np.abs(image).max()
    ):
        return None
    return refine_target(image, best[1])


def _response(
    spectrum: NDArray, size: tuple[int, int], target: BarTarget, kernel_half_px: int, shape: tuple
) -> Array:
    """Return the modulus of the filter's response at each pixel; complete cycles give none to
    constant light.
    """
    from scipy.fft import irfft2, rfft2

    centred = replace(target, row=float(kernel_half_px), col=float(kernel_half_px))
    across, along = centred.coordinates((2 * kernel_half_px + 1, 2 * kernel_half_px + 1))
    box = (np.abs(across) < target.width_px / 2) & (np.abs(along) < target.length_px / 2)
    wave = np.where(box, np.exp(2j * np.pi * target.frequency * across), 0.0)
    wave[box] -= wave[box].mean()
    parts = (
        np.asarray(irfft2(spectrum * rfft2(part, s=size), s=size))
        for part in (np.real(wave), np.imag(wave))
    )
    real, imaginary = (
        part[kernel_half_px : kernel_half_px + shape[0], kernel_half_px : kernel_half_px + shape[1]]
        for part in parts
    )
    return np.sqrt(real**2 + imaginary**2)


def refine_target(image: Array, target: BarTarget) -> BarTarget:
    """Refine centre, direction (maximum fundamental) and length of a target, twice."""
    for step_deg in (2.0, 0.5):
        target = _centre_on_light(image, target)
        window = target.box(image.shape, core_margin_px(target.frequency))
        level = ground_level(image)
        angles = target.angle_rad + np.deg2rad(step_deg * np.arange(-6, 7))
        tried = [replace(target, angle_rad=float(angle)) for angle in angles]
        height = [abs(amplitude(image - level, trial, trial.frequency, window)) for trial in tried]
        target = _fit_length(image, replace(target, angle_rad=_vertex(angles, np.array(height))))
    return _centre_on_light(image, target)


def _centre_on_light(image: Array, target: BarTarget) -> BarTarget:
    """Move the centre to the centroid of the light on the target."""
    window = target.box(image.shape, core_margin_px(target.frequency))
    light = np.where(window, image - ground_level(image), 0.0)
    total = light.sum()
    if total == 0.0:
        return target
    target = replace(target, sign=1 if total > 0 else -1)
    row = float(np.sum(light * np.arange(image.shape[0])[:, None]) / total)
    col = float(np.sum(light * np.arange(image.shape[1])[None, :]) / total)
    limit = 0.5 * max(target.width_px, target.length_px)
    if abs(row - target.row) * target.pitch_ratio > limit or abs(col - target.col) > limit:
        return target
    return replace(target, row=row, col=col)


def _fit_length(image: Array, target: BarTarget) -> BarTarget:
    """Return the target with the length of the stretch along the bars that matches its fundamental
    best.

    In white noise the squared sum over a stretch divided by its length is its likelihood; the
    standard length is kept unless another is clearly likelier.
    """
    across, along = target.coordinates(image.shape)
    on_bars = np.abs(across) < 0.5 * target.width_px
    wave = (image - ground_level(image))[on_bars] * np.exp(
        -2j * np.pi * target.frequency * across[on_bars]
    )
    position = np.floor(along[on_bars]).astype(np.intp)
    first = int(position.min())
    sums = np.bincount(position - first, wave.real) + 1j * np.bincount(position - first, wave.imag)
    running_sum = np.concatenate([[0.0], np.cumsum(sums)])
    lengths = np.unique(
        np.round(np.geomspace(max(1.0 / target.frequency, 3.0), sums.size, 60)).astype(np.intp)
    )
    matches = [
        np.abs(running_sum[length:] - running_sum[:-length]) ** 2 / length for length in lengths
    ]
    gain = np.array([float(match.max()) for match in matches])
    typical = int(np.argmin(np.abs(lengths - LIMITS.length_over_width / (2.0 * target.frequency))))
    best = typical if gain[typical] > LIMITS.min_length_match * gain.max() else int(np.argmax(gain))
    length = (
        LIMITS.length_over_width / (2.0 * target.frequency)
        if best == typical
        else float(lengths[best])
    )
    centre = first + int(np.argmax(matches[best])) + 0.5 * lengths[best]
    return replace(
        target,
        length_px=length,
        row=target.row + centre * float(np.cos(target.angle_rad)) / target.pitch_ratio,
        col=target.col - centre * float(np.sin(target.angle_rad)),
    )


def vertex_shift(values: Array, peak: int) -> float:
    """Return the vertex of the parabola through a peak and its cyclic neighbours, relative to the
    peak.
    """
    before, at, after = (float(values[(peak + step) % values.size]) for step in (-1, 0, 1))
    bend = before - 2.0 * at + after
    return float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0)) if bend < 0 else 0.0


def _vertex(x: Array, y: Array) -> float:
    """Return the vertex of the parabola through the highest point and its neighbours."""
    peak = int(np.clip(np.argmax(y), 1, len(x) - 2))
    return float(x[peak] + vertex_shift(y, peak) * (x[1] - x[0]))


def measure_frequency(image: Array, target: BarTarget, margin_px: float) -> float:
    """Return the bar frequency from the zeros of the spectrum next to the stated one.

    Notes
    -----
    The spectrum of N bars of pitch P is zero at k/(N P), k no multiple of N. The zeros adjacent to
    the fundamental give P more precisely than its broad peak, which the falling transfer shifts.
    """
    window = target.box(image.shape, margin_px)
    level = float(np.median(image[~window])) if (~window).any() else float(image.min())
    tried = target.frequency * (
        1.0 + np.linspace(-LIMITS.max_frequency_error, LIMITS.max_frequency_error, 25)
    )
    power = np.zeros(tried.size)
    for order in (target.bars - 1, target.bars + 1):
        fraction = order / target.bars
        power += [
            abs(amplitude(image - level, target, fraction * trial, window)) ** 2 for trial in tried
        ]
    return _vertex(tried, -power)


def margin_px(context: Context, frequency: float) -> float:
    """Return the margin around the bars: it includes the halo of a described camera."""
    default_px = max(12.0, 1.5 / frequency)
    if not has_tube(context.camera):
        return default_px
    return max(default_px, 0.5 * halo_diameters_px(context, transposed=False)[1] + 12.0)


def fitting_margin(target: BarTarget, shape: tuple[int, ...], wanted: float) -> tuple[float, bool]:
    """Return the widest margin up to `wanted` at which the window fits, and whether it is
    smaller.
    """
    for margin in np.linspace(wanted, 2.0, 24):
        window = target.box(shape, float(margin))
        across, along = target.coordinates(shape)
        extent = (np.abs(across).max(), np.abs(along).max())
        fits = (
            extent[0] > target.width_px / 2 + margin and extent[1] > target.length_px / 2 + margin
        )
        touches = window[0].any() or window[-1].any() or window[:, 0].any() or window[:, -1].any()
        if fits and not touches:
            return float(margin), margin < wanted - 1e-9
    return 2.0, True


def lost_fraction(context: Context, margin: float) -> tuple[float, float]:
    """Return the fraction of the light beyond the window, and its standard uncertainty.

    `context`: its sensor description; without one the fraction is taken as 0; `margin`: margin of
    the window around the bars, column pitches.

    Notes
    -----
    For a transfer M the light further off than X is 1 - (2/pi) int M(f) sin(2 pi f X)/f df; a
    window loses it on both pairs of sides. Averaged over the described ranges of the tube and its
    halo.
    """
    if not has_tube(context.camera):
        return 0.0, 0.0
    sensor = context.camera
    rng = np.random.default_rng(0)
    pitch_mm = float(sensor.ccd.pitch_x_um) * 1e-3 * float(sensor.taper.demagnification)
    corner = _draw_parameter(sensor.tube.mtf_frequency_lp_per_mm, rng) * pitch_mm
    exponent = _draw_parameter(sensor.tube.mtf_exponent, rng)
    diameter = 4.0 * _draw_parameter(sensor.photocathode.gap_mm, rng) / pitch_mm
    fraction = _draw_parameter(sensor.photocathode.halo_fraction, rng)
    elastic = _draw_parameter(sensor.photocathode.halo_elastic_share, rng)
    f = np.asarray((np.arange(16384) + 0.5) / 8192.0, dtype=np.float64)
    kernel = np.sin(2.0 * np.pi * f * margin) / f * (f[1] - f[0])
    core = image_tube(f, corner[:, None], exponent[:, None])
    ring = halo(np.pi * diameter[:, None] * f, elastic[:, None])
    transfer = core * (1.0 - fraction[:, None] + fraction[:, None] * ring)
    outside_light = 2.0 * (1.0 - 2.0 / np.pi * transfer @ kernel)
    return float(outside_light.mean()), float(
        max(outside_light.std(), 0.25 * abs(outside_light.mean()))
    )


def _draw_parameter(parameter: Parameter, rng: np.random.Generator) -> Array:
    if parameter.low is None or parameter.high is None:
        return np.full(ACCURACY.description_draws, parameter.value)
    sd = (parameter.high - parameter.low) / (2.0 * 1.959964)
    return np.clip(
        rng.normal(parameter.value, sd, ACCURACY.description_draws), parameter.low, parameter.high
    )
