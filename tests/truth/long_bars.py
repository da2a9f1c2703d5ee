"""Strips of N long bars and their noise, in the words of the bars' own tests."""

import numpy as np
from numpy.typing import NDArray

from labdata import FrameStack
from tests.truth.bars import StripScene
from tests.truth.blur import TrueBlur
from tests.truth.camera_effects import correlate_noise

PEDESTAL_DN, STEP_DN = 400.0, 1000.0


def gaussian(sigma_px: float) -> TrueBlur:
    """Return a Gaussian blur."""
    return TrueBlur(sigma_px=sigma_px)


def tube(corner: float, exponent: float) -> TrueBlur:
    """Return the blur exp(-(f/fc)^n) of a tube."""
    return TrueBlur(form="exponential", frequency_cy_per_px=corner, exponent=exponent)


def mtf_of(blur: TrueBlur, frequency: float, angle_deg: float) -> float:
    """MTF across the bars, pixel included."""
    return float(blur.mtf(frequency, angle_deg))


def strip(
    blur: TrueBlur,
    frequency: float,
    angle_deg: float,
    phase_px: float,
    *,
    ground_px: int = 16,
    **scene: int,
) -> NDArray[np.float64]:
    """Rows across N bars that run through them, sampled at whole pixels, 1 on a wide bar, shape
    (row, col).
    """
    return StripScene(
        blur=blur,
        frequency_cy_per_px=frequency,
        angle_deg=angle_deg,
        phase_px=phase_px,
        reach_px=ground_px,
        **scene,
    ).light()


def frames_of(
    image: NDArray,
    rng: np.random.Generator,
    *,
    snr: float = 10.0,
    blur_px: float = 0.0,
    frames: int = 1,
) -> FrameStack:
    """Frames of an image with noise of STEP_DN / snr a pixel, white or blurred behind the gain."""
    noise = correlate_noise(rng.standard_normal((frames, *image.shape)), blur_px)
    data = np.clip(np.rint(PEDESTAL_DN + STEP_DN * (image + noise / snr)), 0, 4095)
    return FrameStack(data=data.astype(np.uint16), full_scale_dn=4095.0)
