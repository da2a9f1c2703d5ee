"""Strips of N long bars in closed form: their exact spectrum, a transfer and the pixel, summed as a
cosine series.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from labdata import FrameStack

Core = Callable[[NDArray], NDArray]

PERIOD_PX = 4096
STEP_PX = 1 / 32
PEDESTAL_DN, STEP_DN = 400.0, 1000.0


def gaussian(sigma_px: float) -> Core:
    """Transfer of a Gaussian blur."""
    return lambda f: np.exp(-2.0 * (np.pi * f * sigma_px) ** 2)


def tube(corner: float, exponent: float) -> Core:
    """Transfer exp(-(f/fc)^n) of a tube."""
    return lambda f: np.exp(-((f / corner) ** exponent))


def mtf_of(core: Core, frequency: float, angle_deg: float) -> float:
    """MTF across the bars with the square pixel's two sincs."""
    angle = np.deg2rad(angle_deg)
    pixel = np.sinc(frequency * np.cos(angle)) * np.sinc(frequency * np.sin(angle))
    return float(core(np.array([frequency]))[0] * pixel)


def strip(
    core: Core,
    frequency: float,
    angle_deg: float,
    phase_px: float,
    *,
    bars: int = 4,
    rows: int = 20,
    ground_px: int = 16,
) -> NDArray[np.float64]:
    """Rows across N bars that run through them, sampled at whole pixels, 1 on a wide bar, shape
    (row, col).

    O(v) = w sinc(v w) sin(pi N v P) / sin(pi v P), w = P/2; the pixel's sincs make each sample its
    pixel's mean.
    """
    cols = int(np.ceil(bars / frequency)) + 2 * ground_px
    v = np.arange(3 * PERIOD_PX) / PERIOD_PX
    angle, width = np.deg2rad(angle_deg), 0.5 / frequency
    with np.errstate(invalid="ignore", divide="ignore"):
        comb = np.sin(np.pi * bars * v / frequency) / np.sin(np.pi * v / frequency)
    # The limit at whole multiples of f is N, with a sign where N is even.
    order = np.rint(v / frequency)
    limit = np.abs(v / frequency - order) < 1e-9
    comb = np.where(limit, bars * (-1.0) ** (order * (bars - 1)), comb)
    pixel = np.sinc(v * np.cos(angle)) * np.sinc(v * np.sin(angle))
    spectrum = np.zeros(int(PERIOD_PX / STEP_PX) // 2 + 1)
    spectrum[: v.size] = width * np.sinc(v * width) * comb * core(v) * pixel
    profile = np.fft.fftshift(np.fft.irfft(spectrum)) / STEP_PX
    row, col = np.mgrid[:rows, :cols]
    across = (col - (cols - 1) / 2 - phase_px) * np.cos(angle) + (row - (rows - 1) / 2) * np.sin(
        angle
    )
    return np.interp(across, (np.arange(profile.size) - profile.size // 2) * STEP_PX, profile)


def frames_of(
    image: NDArray,
    rng: np.random.Generator,
    *,
    snr: float = 10.0,
    blur_px: float = 0.0,
    frames: int = 1,
) -> FrameStack:
    """Frames of an image with noise of STEP_DN / snr a pixel, white or blurred behind the gain."""
    from scipy.ndimage import gaussian_filter

    pad = 16
    noise = rng.standard_normal((frames, image.shape[0] + 2 * pad, image.shape[1] + 2 * pad))
    if blur_px:
        noise = gaussian_filter(noise, (0, blur_px, blur_px))
        noise /= _gain(blur_px)
    noise = noise[:, pad:-pad, pad:-pad]
    data = np.clip(np.rint(PEDESTAL_DN + STEP_DN * (image + noise / snr)), 0, 4095)
    return FrameStack(data=data.astype(np.uint16), full_scale_dn=4095.0)


def _gain(blur_px: float) -> float:
    """Standard deviation of white noise after a blur: the root of the sum of its squared
    weights.
    """
    from scipy.ndimage import gaussian_filter

    spike = np.zeros((65, 65))
    spike[32, 32] = 1.0
    return float(np.sqrt((gaussian_filter(spike, blur_px) ** 2).sum()))
