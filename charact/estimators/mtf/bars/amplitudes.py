"""Sums over a bar target: background, light, fundamental and second harmonic, with their noise."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.bars.target import BarTarget, amplitude
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.frames.robust import robust_sd
from charact.frames.stack import Stack
from labdata import Array, Mask
from labdata.camera.description import has_tube


@dataclass(frozen=True, kw_only=True)
class Amplitudes:
    """Light and fundamental of a target."""

    light: float  # Sum of the window's pixels above the pedestal, or below it for dark bars, DN
    fundamental: float  # Fourier sum at the bar frequency in the phase of the bars, DN
    covariance: Array  # Covariance of (light, fundamental), DN2, shape (2, 2)
    freedom: float  # Degrees of freedom of the covariance
    phase_rad: float  # Phase of the fundamental
    # Largest modulus at the two zeros adjacent to the fundamental, over the fundamental
    zeros: float
    # Modulus half way to the lower zero, over that expected from the fundamental; more bars give
    # less
    flank: float
    # fields_apart_px, fields_apart_sd_px: displacement of the bars in odd rows from those in even
    # rows, and its standard uncertainty, px across the bars
    fields_apart_px: float
    fields_apart_sd_px: float
    frame_correlation: float  # Variance factor of the mean by image lag

    @property
    def signal_to_noise(self) -> float:
        """The fundamental in standard uncertainties."""
        return self.fundamental / max(
            float(np.sqrt(self.covariance[1, 1])), 1e-12 * abs(self.light) + 1e-30
        )


def amplitudes_of(
    stack: Stack, target: BarTarget, window: NDArray[np.bool_], background: NDArray[np.bool_]
) -> Amplitudes:
    """Return the sums over frames of a target above the mean of the pixels beyond the window.

    Notes
    -----
    Sums over complete bars and their blur are projections along the bars: the fundamental is O(f)
    H(f) and the light O(0) H(0) (projection-slice theorem). The scatter between frames includes
    every correlation between pixels. With too few frames, slabs along the bars replace them.
    """
    data, mean = stack.data, stack.mean_frame_dn
    across, _ = target.coordinates(mean.shape)
    wave = np.exp(-2j * np.pi * target.frequency * across[window])
    odd = (np.nonzero(window)[0] % 2).astype(bool)
    sums = [
        _frame_sums(target.sign * frame.astype(float), window, background, wave, odd)
        for frame in data
    ]
    light, halves = (
        np.array([frame_sum[0] for frame_sum in sums]),
        np.array([frame_sum[1] for frame_sum in sums]),
    )
    fundamental = halves.sum(axis=1)
    phase = float(np.angle(fundamental.mean()))
    turned = np.real(fundamental * np.exp(-1j * phase))
    lag = _image_lag_factor(stack, window)
    if len(data) >= 4:
        covariance, freedom = _frame_covariance(light, turned, lag)
    else:
        covariance, freedom = _slab_covariance(mean, target, window, background, phase)
    zeros = [
        abs(_amplitude(mean, target, window, background, order))
        for order in (target.bars - 1, target.bars + 1)
    ]
    field_offset_px, field_offset_sd_px = _field_offset(
        halves, target, float(np.sqrt(covariance[1, 1]))
    )
    return Amplitudes(
        light=float(light.mean()),
        fundamental=float(turned.mean()),
        covariance=np.atleast_2d(covariance) + 1e-18 * np.eye(2) * light.mean() ** 2,
        freedom=freedom,
        phase_rad=phase,
        zeros=max(zeros) / max(abs(turned.mean()), 1e-30),
        flank=abs(_amplitude(mean, target, window, background, target.bars - 0.5))
        * target.bars
        * np.sin(0.5 * np.pi / target.bars)
        / max(abs(turned.mean()), 1e-30),
        fields_apart_px=field_offset_px,
        fields_apart_sd_px=field_offset_sd_px,
        frame_correlation=lag,
    )


def _image_lag_factor(stack: Stack, window: NDArray[np.bool_]) -> float:
    """Return the variance factor of the mean of sums by image lag.

    A pixel contains light of the frame before, a sum also light of the field before; the decay
    gives the ratio.
    """
    data_factor = frame_correlation(stack.data, window)
    if not has_tube(stack.camera):
        return data_factor
    memory = stack.image_lag
    factor = data_factor if len(stack) >= ACCURACY.min_lag_frames else memory.widening
    return max(factor * memory.widening_of_sums / memory.widening, 1.0)


def _frame_covariance(light: NDArray, turned: NDArray, lag: float) -> tuple[NDArray, float]:
    """Return the covariance of the means of light and fundamental over frames, and its degrees of
    freedom.

    Two means with the covariance S of n frames have a Student's t of n - 2 degrees of freedom and
    shape S (n - 1)/(n - 2) (Hotelling). Frames with a correlation r of neighbours, as the lag
    implies, count as (1 - r^2)/(1 + r^2) each.
    """
    count = len(light)
    neighbours = (lag - 1.0) / (lag + 1.0)
    freedom = max((count - 2.0) * (1.0 - neighbours**2) / (1.0 + neighbours**2), 1.0)
    return np.cov(light, turned) * lag / count * (count - 1.0) / (count - 2.0), freedom


def _frame_sums(
    frame: NDArray, window, background, wave: NDArray, odd: NDArray
) -> tuple[float, NDArray]:
    """Return light and the fundamental of even and odd rows of one frame above its pedestal."""
    values = frame[window] - frame[background].mean()
    terms = values * wave
    return float(values.sum()), np.array([terms[~odd].sum(), terms[odd].sum()])


def _amplitude(mean: Array, target: BarTarget, window, background, order: float) -> complex:
    return amplitude(
        mean - mean[background].mean(), target, target.frequency * order / target.bars, window
    )


def _field_offset(halves: NDArray, target: BarTarget, sd: float) -> tuple[float, float]:
    """Return the displacement of the bars between the two fields, and its standard uncertainty,
    px.
    """
    even_sum, odd_sum = halves.mean(axis=0)
    if min(abs(even_sum), abs(odd_sum)) == 0:
        return 0.0, np.inf
    radian_px = 1.0 / (2.0 * np.pi * target.frequency)
    # Each field holds half of the fundamental's noise.
    error = (
        np.sqrt(2.0)
        * (sd / np.sqrt(2.0))
        * np.hypot(1.0 / abs(even_sum), 1.0 / abs(odd_sum))
        / np.sqrt(2.0)
    )
    return float(np.angle(odd_sum * np.conj(even_sum)) * radian_px), float(error * radian_px)


def frame_correlation(data: NDArray, window: NDArray[np.bool_]) -> float:
    """Return the variance of the mean over that of independent frames of the same scatter, at least
    1.

    Notes
    -----
    Half mean squared differences of frames k apart are v_k = g_0 - g_k, g the autocovariance, taken
    as zero from lag 4. All pixels of the window contribute, so that a dozen frames suffice.
    """
    count = len(data)
    if count < ACCURACY.min_lag_frames:
        return 1.0
    pixels = data[:, window].astype(np.float32)
    halves = [
        0.5 * float(np.mean((pixels[lag:] - pixels[:-lag]) ** 2)) for lag in range(1, count - 1)
    ]
    total = float(np.mean(halves[3:]))
    if not total > 0:
        return 1.0
    tail = [max(1.0 - half / total, 0.0) for half in halves[:3]]
    inflation = 1.0 + 2.0 * sum((1.0 - (k + 1) / count) * r for k, r in enumerate(tail))
    seen_fraction = 1.0 - (inflation - 1.0) / (count - 1.0)
    return max(inflation / max(seen_fraction, 0.2), 1.0)


def _slab_covariance(
    mean: Array,
    target: BarTarget,
    window: NDArray[np.bool_],
    background: NDArray[np.bool_],
    phase: float,
) -> tuple[Array, float]:
    """Return the covariance from differences of adjacent slabs along the bars, and its degrees of
    freedom.

    The differences include the fall of the light at the bars' ends, which makes the uncertainty
    conservative.
    """
    across, along = target.coordinates(mean.shape)
    values = mean - mean[background].mean()
    half = target.length_px / 2
    edges = np.linspace(-half, half, max(int(target.length_px / 4.0), 2) + 1)
    terms = np.real(values * np.exp(-2j * np.pi * target.frequency * across - 1j * phase))
    slabs = [window & (along >= low) & (along < high) for low, high in pairwise(edges)]
    sums = np.array([[values[slab].sum(), terms[slab].sum()] for slab in slabs])
    jumps = np.diff(sums, axis=0)
    background_sd = float(values[background].std()) * np.sqrt(np.count_nonzero(window))
    covariance = len(slabs) * (jumps.T @ jumps) / (2.0 * len(jumps)) + np.diag(
        [background_sd**2, 0.5 * background_sd**2]
    )
    return covariance, float(max(len(jumps), 2))


def target_background(mean: Array, target: BarTarget, margin_px: float) -> tuple[Mask, bool]:
    """Return the pixels that show a target's pedestal, and whether the blur of other light reaches
    into the window.

    `mean`: mean frame, shape (row, col). The pixels lie beyond the window, without other objects.
    """
    from scipy.ndimage import binary_dilation, gaussian_filter

    shape = mean.shape
    surroundings = ~target.box(shape, margin_px)
    smooth = np.asarray(gaussian_filter(mean, 2.0))
    level = float(np.median(smooth[surroundings]))
    spread = robust_sd(smooth[surroundings], level)
    height = float(np.abs(smooth[target.box(shape, 0.0)] - level).max())
    other = surroundings & (
        np.abs(smooth - level) > max(LIMITS.max_other_sd * spread, LIMITS.max_other_light * height)
    )
    other = (
        np.asarray(binary_dilation(other, iterations=ACCURACY.other_margin_px), bool) & surroundings
    )
    crowded = bool((other & target.box(shape, margin_px + ACCURACY.other_margin_px)).any())
    background = surroundings & ~other
    # If hardly any background remains, the objects are the background.
    return background if background.sum() > 0.25 * surroundings.sum() else surroundings, crowded


def second_harmonic(
    mean: Array, target: BarTarget, window: Mask, pedestal: float, amplitudes: Amplitudes
) -> float:
    """Return the image's spectrum at twice the bar frequency in the phase of the bars, over the
    fundamental.

    Bars as wide as their gaps have no such component, whatever the blur; a nonlinear response adds
    one. Returns 0 where the alias of the fundamental overlaps.
    """
    direction = max(abs(np.cos(target.angle_rad)), abs(np.sin(target.angle_rad)))
    if abs(1.0 - 3.0 * target.frequency * direction) < 2.0 * target.frequency / target.bars:
        return 0.0
    double = amplitude(mean - pedestal, target, 2.0 * target.frequency, window)
    return float(np.real(double * np.exp(-2j * amplitudes.phase_rad)) / amplitudes.fundamental)
