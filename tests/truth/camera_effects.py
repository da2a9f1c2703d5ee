"""Effects of a camera on its pictures: response, noise of the light correlated behind the gain,
read noise, sharpening, stuck pixels, whole codes.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from labdata import BadInput, FrameStack
from tests.truth.blur import Array, TrueBlur, level_crossing

# Standard deviation of the Gaussian whose blurred copy is taken off, px.
MASK_PX = 2.0


def boost(frequency_cy_per_px: Array | float, amount: float) -> Array | float:
    """Return what sharpening makes of the MTF at a frequency in any direction, cycles per pixel, as
    a factor.
    """
    return 1.0 + amount * (
        1.0 - np.exp(-2.0 * (np.pi * np.asarray(frequency_cy_per_px) * MASK_PX) ** 2)
    )


def correlate_noise(white: Array, sigma_px: float) -> Array:
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


@dataclass(frozen=True, kw_only=True)
class RecordedTarget:
    """A target and the camera that records it, with one knob for each way in which methods break
    whatever the target and its light.

    Parameters
    ----------
    blur
        The blur whose MTF is the truth.
    rows, cols, frames
        Size of the stack.
    angle_deg
        Direction across the target's lines from the row direction, degrees: 0 is a vertical line.
    gradient
        Illumination at the right border over that at the left, minus 1.
    motion_px
        Horizontal displacement of odd rows, exposed in the later field, px.
    jitter_px
        Standard deviation of a horizontal displacement that each frame has for itself, px.
    gamma
        Exponent of the response, on a scale from black to full scale.
    hot_share
        Share of pixels stuck at full scale.
    sharpening
        Share by which the camera raises fine detail.
    floor_dn
        Lowest code: what is darker sits on it, DN.
    black_dn, full_scale_dn
        Codes at no light and at the top, DN.
    """

    blur: TrueBlur = field(default_factory=TrueBlur)
    rows: int = 100
    cols: int = 100
    frames: int = 1
    angle_deg: float = 5.0
    gradient: float = 0.0
    motion_px: float = 0.0
    jitter_px: float = 0.0
    gamma: float = 1.0
    hot_share: float = 0.0
    sharpening: float = 0.0
    floor_dn: float = 0.0
    black_dn: float = 12.0
    full_scale_dn: float = 255.0

    def _response(self, light: Array) -> Array:
        """What the camera makes of light: DN, black included."""
        room = self.full_scale_dn - self.black_dn
        return self.black_dn + room * np.sign(light) * np.abs(light / room) ** self.gamma

    def _digitised(self, signal: Array, rng: np.random.Generator) -> FrameStack:
        """Whole codes of a signal (frame, row, col), DN, sharpened, some pixels stuck at full
        scale.
        """
        from scipy.ndimage import gaussian_filter

        stuck = rng.random(signal.shape[1:]) < self.hot_share
        if self.sharpening:
            lost = signal - gaussian_filter(signal, MASK_PX, axes=(-2, -1), mode="nearest")
            signal = signal + self.sharpening * lost
        codes = np.rint(np.where(stuck, self.full_scale_dn, signal))
        return FrameStack(
            data=np.clip(codes, self.floor_dn, self.full_scale_dn).astype(
                np.uint8 if self.full_scale_dn < 256 else np.uint16
            ),
            full_scale_dn=self.full_scale_dn,
            black_level_dn=self.black_dn,
        )


@dataclass(frozen=True, kw_only=True)
class TargetScene(RecordedTarget, ABC):
    """A target before an ordinary camera, whose noise grows with the signal.

    Parameters
    ----------
    snr
        Step over the standard deviation of the noise half way up, dimensionless. Infinite: no
        noise.
    shot_share
        Share of the variance half way up that grows with the signal; the rest is white read noise.
    noise_blur_px
        Standard deviation of the Gaussian that correlates the signal's noise after the gain, px; 0
        is white.
    clip_share
        Share of the step that lies above full scale.
    """

    snr: float = 50.0
    shot_share: float = 0.8
    noise_blur_px: float = 0.0
    clip_share: float = 0.0
    black_dn: float = 10.0

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
        return self._digitised(drawn + read, rng)


@dataclass(frozen=True, kw_only=True)
class PulsedTarget(RecordedTarget, ABC):
    """A target whose light is pulses of photoelectrons; `blur` is the one before the gain.

    Parameters
    ----------
    pulse_px
        Standard deviation of a photoelectron's Gaussian pulse, the blur behind the gain, px.
    photoelectrons
        Mean number, of what the target says.
    gain_spread
        Relative variance of the pulses' heights: 1 is exponential, 0 has none.
    read_dn, row_noise_dn
        Standard deviations of white read noise and of an offset that each row of each frame has for
        itself, DN.
    drift_px
        Displacement along the rows from the first frame to the last, px.
    """

    pulse_px: float = 0.6
    photoelectrons: float = 1.0
    gain_spread: float = 0.6
    read_dn: float = 1.0
    row_noise_dn: float = 0.0
    drift_px: float = 0.0

    def __post_init__(self) -> None:
        if self.photoelectrons < 0 or self.pulse_px < 0:
            raise BadInput(
                f"photoelectrons and pulse_px must not be negative, got {self.photoelectrons:g} "
                f"and {self.pulse_px:g}"
            )

    def mtf(self, frequency_cy_per_px: Array | float) -> Array:
        """MTF across the lines of the camera at rest, pixel and sharpening included."""
        pulse = np.exp(-2 * (np.pi * np.asarray(frequency_cy_per_px, float) * self.pulse_px) ** 2)
        boosted = boost(frequency_cy_per_px, self.sharpening)
        return self.blur.mtf(frequency_cy_per_px, self.angle_deg) * pulse * boosted

    @property
    def truth_mtf50(self) -> float:
        """MTF50 across the lines of the camera at rest, cycles per pixel."""
        return level_crossing(self.mtf, 0.5)

    @abstractmethod
    def _light(self, rng: np.random.Generator) -> Array:
        """Light of the frames over black, DN, shape (frame, row, col)."""

    def frames_drawn(self, rng: np.random.Generator) -> FrameStack:
        """Draw the stack: Poisson pulses of random height, response, read noise, digitised."""
        signal = self._response(np.maximum(self._light(rng), 0.0))
        signal += self.read_dn * rng.standard_normal(signal.shape)
        if self.row_noise_dn:
            signal += self.row_noise_dn * rng.standard_normal((*signal.shape[:2], 1))
        return self._digitised(signal, rng)
