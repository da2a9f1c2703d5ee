"""Effects of a camera on its pictures: response, noise of the light correlated behind the gain,
read noise, sharpening, stuck pixels, whole codes.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, FrameStack
from tests.truth.blur import TrueBlur

Array = NDArray[np.floating]

# Standard deviation of the Gaussian whose blurred copy is taken off, px.
MASK_PX = 2.0


def sharpen_images(pictures: Array, amount: float) -> Array:
    """Return pictures with so much of what a blurred copy lacks added, shape (..., row, col)."""
    if amount == 0.0:
        return pictures
    from scipy.ndimage import gaussian_filter

    return pictures + amount * (
        pictures - gaussian_filter(pictures, MASK_PX, axes=(-2, -1), mode="nearest")
    )


def boost(frequency_cy_per_px: Array | float, amount: float) -> Array | float:
    """Return what sharpening makes of the MTF at a frequency in any direction, cycles per pixel, as
    a factor.
    """
    return 1.0 + amount * (
        1.0 - np.exp(-2.0 * (np.pi * np.asarray(frequency_cy_per_px) * MASK_PX) ** 2)
    )


def correlate_noise(white: NDArray[np.floating], sigma_px: float) -> NDArray[np.floating]:
    """Blur white noise (frame, row, col) with a Gaussian of unit sum of squares.

    `sigma_px`: standard deviation of the Gaussian, px; 0 leaves the noise white.
    """
    if sigma_px <= 0:
        return white
    from scipy.ndimage import convolve1d

    radius_px = int(np.ceil(4 * sigma_px))
    kernel = np.exp(-0.5 * (np.arange(-radius_px, radius_px + 1) / sigma_px) ** 2)
    kernel = kernel / np.sqrt(np.sum(kernel**2))
    return convolve1d(convolve1d(white, kernel, axis=1, mode="wrap"), kernel, axis=2, mode="wrap")


def digitised(
    signal: Array, stuck: NDArray[np.bool_], *, black_dn: float, full_scale_dn: float, floor_dn=0.0
) -> FrameStack:
    """Return whole codes of a signal, DN, some pixels stuck at full scale."""
    codes = np.clip(
        np.rint(np.where(stuck, full_scale_dn, signal)), floor_dn, full_scale_dn
    ).astype(np.uint8 if full_scale_dn < 256 else np.uint16)
    return FrameStack(data=codes, full_scale_dn=full_scale_dn, black_level_dn=black_dn)


@dataclass(frozen=True, kw_only=True)
class TargetScene(ABC):
    """A target as a camera would digitise it, with one knob for each way in which methods break
    whatever the target.

    Parameters
    ----------
    blur
        The blur whose MTF is the truth.
    rows, cols, frames
        Size of the stack.
    angle_deg
        Direction across the target's lines from the row direction, degrees.
    snr
        Step over the standard deviation of the noise half way up, dimensionless. Infinite: no
        noise.
    shot_share
        Share of the variance half way up that grows with the signal; the rest is white read noise.
    noise_blur_px
        Standard deviation of the Gaussian that correlates the signal's noise after the gain, px; 0
        is white.
    gamma
        Exponent of the response, on a scale from black to full scale.
    gradient
        Illumination at the right border over that at the left, minus 1.
    motion_px
        Horizontal displacement of odd rows, exposed in the later field, px.
    jitter_px
        Standard deviation of a horizontal displacement that each frame has for itself, px.
    clip_share
        Share of the step that lies above full scale.
    floor_dn
        Lowest code: what is darker sits on it, DN.
    hot_share
        Share of pixels stuck at full scale.
    sharpening
        Share by which the camera raises fine detail.
    black_dn, full_scale_dn
        Codes at no light and at the top, DN.
    """

    blur: TrueBlur = field(default_factory=TrueBlur)
    rows: int = 100
    cols: int = 100
    frames: int = 1
    angle_deg: float = 5.0
    snr: float = 50.0
    shot_share: float = 0.8
    noise_blur_px: float = 0.0
    gamma: float = 1.0
    gradient: float = 0.0
    motion_px: float = 0.0
    jitter_px: float = 0.0
    clip_share: float = 0.0
    floor_dn: float = 0.0
    hot_share: float = 0.0
    sharpening: float = 0.0
    black_dn: float = 10.0
    full_scale_dn: float = 255.0

    def __post_init__(self) -> None:
        if not self.snr > 0:
            raise BadInput(f"snr must be positive, got {self.snr:g}")

    @property
    @abstractmethod
    def levels_dn(self) -> tuple[float, float]:
        """Levels of the dark and the bright side, DN, black level included."""

    @abstractmethod
    def light(self, moved_px: float = 0.0) -> Array:
        """Noiseless light signal over black, DN of a straight response, shape (row, col).

        `moved_px`: horizontal displacement of the target, px.
        """

    def mean(self) -> Array:
        """Noiseless frame before clipping and digitising, DN, shape (row, col)."""
        return self._response(self.light())

    def _response(self, light: Array) -> Array:
        """What the camera makes of light: DN, black included."""
        room = self.full_scale_dn - self.black_dn
        return self.black_dn + room * np.sign(light) * np.abs(light / room) ** self.gamma

    def _frames_light(self, rng: np.random.Generator) -> Array:
        """Light of every frame, or of all of them where nothing moves."""
        if not self.jitter_px:
            return self.light()
        offsets_px = self.jitter_px * rng.standard_normal(self.frames)
        return np.stack([self.light(offset_px) for offset_px in offsets_px])

    def frames_drawn(self, rng: np.random.Generator) -> FrameStack:
        """Draw the stack: noise of the light correlated after the gain, the response, white read
        noise, digitised.

        The noise is sqrt(v_s(mean)) w blurred by a kernel h of unit sum of squares, plus white
        noise: variance v_s + v_r, covariance v_s R_h. The signal's part of the variance is
        proportional to the light; the response bends light and its noise alike.
        """
        light = self._frames_light(rng)
        dark_dn, bright_dn = self.levels_dn
        sd = (bright_dn - dark_dn) / self.snr if np.isfinite(self.snr) else 0.0
        half_way = (bright_dn + dark_dn) / 2 - self.black_dn
        shot = np.sqrt(self.shot_share * sd**2 * np.maximum(light, 0) / half_way)
        shape = (self.frames, self.rows, self.cols)
        drawn = self._response(
            light + correlate_noise(shot * rng.standard_normal(shape), self.noise_blur_px)
        )
        read = np.sqrt(1 - self.shot_share) * sd * rng.standard_normal(shape)
        return digitised(
            sharpen_images(drawn + read, self.sharpening),
            rng.random(shape[1:]) < self.hot_share,
            black_dn=self.black_dn,
            full_scale_dn=self.full_scale_dn,
            floor_dn=self.floor_dn,
        )
