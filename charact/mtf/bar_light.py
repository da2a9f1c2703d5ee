"""The light around a bar target of an unknown camera: what its tails carry away, and what comes from elsewhere."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.mtf import transfer as forms
from charact.mtf.bar_amplitudes import Amplitudes
from charact.mtf.bar_target import BarTarget, amplitude

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Forms exp(-(f/fc)^n) through the measured MTF, and their prior: n = 2 is a Gaussian, tubes lie near 1.2.
EXPONENTS = np.array([1.0, 1.15, 1.3, 1.5, 1.7, 2.0])
EXPONENT_PRIOR = (1.6, 0.6)
# Shells around the bars whose levels tell the forms apart, px, and the share by which no form is exact.
SHELLS_PX = (3.0, 5.0, 7.0, 10.0, 14.0, 20.0, 30.0, 45.0, 70.0)
FORM_ERROR = 0.2
NEGLIGIBLE = 5e-4
# Frames are cut to this margin about the bars before they are modelled, px, and continue empty for as much.
WIDEST_PX = 70
# Light elsewhere: over this share of the target's height, and this many deviations of the smoothed ground.
OTHER_SHARE, OTHER_SD, OTHER_SMOOTHING_PX, OTHER_REACH_PX = 0.04, 6.0, 2.0, 8


@dataclass(frozen=True, kw_only=True)
class Ground:
    """The pixels that show a target's pedestal.

    Parameters
    ----------
    beyond
        Pixels beyond the window without light of anything else, shape (row, col).
    crowded
        Whether other light stands so near that its blur reaches into the window.
    """

    beyond: Mask
    crowded: bool


def ground_of(mean: Array, target: BarTarget, margin_px: float) -> Ground:
    """Return the ground of a target in a mean frame (row, col): what is not the window and not another object."""
    from scipy.ndimage import binary_dilation, gaussian_filter

    shape = (mean.shape[0], mean.shape[1])
    outside = ~target.box(shape, margin_px)
    smooth = np.asarray(gaussian_filter(mean, OTHER_SMOOTHING_PX))
    level = float(np.median(smooth[outside]))
    spread = 1.4826 * float(np.median(np.abs(smooth[outside] - level)))
    height = float(smooth[target.box(shape, 0.0)].max()) - level
    other = outside & (np.abs(smooth - level) > max(OTHER_SD * spread, OTHER_SHARE * height))
    other = np.asarray(binary_dilation(other, iterations=OTHER_REACH_PX), bool) & outside
    crowded = bool((other & target.box(shape, margin_px + OTHER_REACH_PX)).any())
    beyond = outside & ~other
    # Where hardly any ground is left the objects are the ground.
    return Ground(beyond=beyond if beyond.sum() > 0.25 * outside.sum() else outside, crowded=crowded)


def modelled(target: BarTarget, shape: tuple[int, int], mtf: float, exponent: float) -> Array:
    """Return the picture of a target of unit light under the form exp(-(f/fc)^n) through an MTF at its frequency.

    Notes
    -----
    The spectrum of N bars times the transfer, sampled coarsely: fine structure does not matter for the light around.
    """
    from scipy.fft import irfft2, next_fast_len

    rows, cols = (next_fast_len(size + WIDEST_PX, True) or size for size in shape)
    fx, fy = np.fft.rfftfreq(cols)[None, :], np.fft.fftfreq(rows)[:, None]
    x, y = fx, fy / target.pitch_ratio
    cosine, sine = np.cos(target.angle_rad), np.sin(target.angle_rad)
    across, along = x * cosine + y * sine, y * cosine - x * sine
    pixel = float(forms.aperture(np.array([target.frequency]), target.angle_rad)[0])
    core = np.log(np.clip(mtf / pixel, 0.02, 0.995)) * (np.hypot(x, y) / target.frequency) ** exponent
    places = (np.arange(target.bars) - (target.bars - 1) / 2) / target.frequency
    comb = np.mean([np.cos(2 * np.pi * place * across) for place in places], axis=0)
    bars = comb * np.sinc(0.5 * across / target.frequency) * np.sinc(target.length_px * along)
    phase = np.exp(-2j * np.pi * (fx * target.col + fy * target.row))
    spectrum = bars * np.exp(core) * np.sinc(fx) * np.sinc(fy) * phase
    return np.asarray(irfft2(spectrum, (rows, cols)))[: shape[0], : shape[1]]


def lost_light(data: NDArray, target: BarTarget, window: Mask, beyond: Mask, found: Amplitudes) -> tuple[float, float]:
    """Return the share of the light that is not in the window over its pedestal, and its standard deviation.

    Parameters
    ----------
    data
        Frames, shape (frame, row, col).
    window, beyond
        Pixels that are summed, and those whose mean is the pedestal: what the tails carry there is lost twice.

    Notes
    -----
    The forms that go through the measured MTF differ in their tails. They are weighed by the levels of shells around
    the bars, and the share lost is the mean over them; a quarter of it, as no form is exact, is its least error.
    """
    part = _near(target, data.shape[1:])
    frames, window, beyond = data[(slice(None), *part)], window[part], beyond[part]
    moved = _moved(target, part)
    mtf = np.pi / 2 * found.fundamental / found.light
    pictures = [modelled(moved, (window.shape[0], window.shape[1]), mtf, float(n)) for n in EXPONENTS]
    kept = np.array([image[window].sum() - image[beyond].mean() * np.count_nonzero(window) for image in pictures])
    shells = _shells(moved, window | beyond)
    level = np.array([[frame[shell].mean(dtype=np.float64) for shell in shells] for frame in frames])
    shape = np.array([[image[shell].mean() for shell in shells] for image in pictures]) * found.light / kept[:, None]
    weight = _weights(level, shape, [int(np.count_nonzero(shell)) for shell in shells], frames)
    lost = 1.0 - kept
    middle = float(weight @ lost)
    if middle < NEGLIGIBLE:
        return 0.0, 0.0
    return middle, float(np.hypot(np.sqrt(weight @ (lost - middle) ** 2), 0.25 * middle))


def _near(target: BarTarget, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the part of a frame within `WIDEST_PX` of the target."""
    reach = 0.5 * np.hypot(target.width_px, target.length_px) + WIDEST_PX
    row, col = target.row, target.col
    down = reach / target.pitch_ratio
    return (
        slice(max(int(row - down), 0), min(int(row + down) + 1, shape[0])),
        slice(max(int(col - reach), 0), min(int(col + reach) + 1, shape[1])),
    )


def _moved(target: BarTarget, part: tuple[slice, slice]) -> BarTarget:
    return replace(target, row=target.row - part[0].start, col=target.col - part[1].start)


def _shells(target: BarTarget, used: Mask) -> list[Mask]:
    """Return the pixels of each shell around the bars that has enough of them."""
    across, along = target.coordinates((used.shape[0], used.shape[1]))
    away = np.maximum(np.abs(across) - target.width_px / 2, np.abs(along) - target.length_px / 2)
    shells = [used & (away >= low) & (away < high) for low, high in pairwise(SHELLS_PX)]
    return [shell for shell in shells if np.count_nonzero(shell) > 40]


def _weights(level: Array, shape: Array, pixels: list[int], frames: NDArray) -> Array:
    """Return the probability of each form, shape (form,), from levels (frame, shell) and forms (form, shell)."""
    mean, sd = EXPONENT_PRIOR
    log_weight = -0.5 * ((EXPONENTS - mean) / sd) ** 2
    if len(pixels) > 2:
        own = (
            level.std(axis=0, ddof=1) / np.sqrt(len(level)) if len(level) >= 4 else 3.0 * frames.std() / np.sqrt(pixels)
        )
        for number, one in enumerate(shape):
            variance = np.maximum(own, 1e-3) ** 2 + (FORM_ERROR * one) ** 2
            left = level.mean(axis=0) - one
            left = left - np.sum(left / variance) / np.sum(1.0 / variance)
            log_weight[number] -= 0.5 * float(np.sum(left**2 / variance + np.log(variance)))
    weight = np.exp(log_weight - log_weight.max())
    return weight / weight.sum()


def second_harmonic(mean: Array, target: BarTarget, window: Mask, pedestal: float, found: Amplitudes) -> float:
    """Return the picture's spectrum at twice the bars' frequency in their phase, over the fundamental.

    Bars as wide as their gaps have no light there (sinc 1 = 0), whatever the blur; a curved response makes some. Where
    the fundamental's alias lies as near as the spectrum of so few bars is wide, nothing can be said: 0.
    """
    direction = max(abs(np.cos(target.angle_rad)), abs(np.sin(target.angle_rad)))
    if abs(1.0 - 3.0 * target.frequency * direction) < 2.0 * target.frequency / target.bars:
        return 0.0
    double = amplitude(mean - pedestal, target, 2.0 * target.frequency, window)
    return float(np.real(double * np.exp(-2j * found.phase_rad)) / found.fundamental)
