"""Bar targets and strips across long bars, of exactly known MTF.

The spectrum of the finite target is multiplied by the transfer and sampled with its aliases; a
strip is interpolated in a finely tabulated profile.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from labdata import BadInput, FrameStack
from tests.truth.blur import Array, TrueBlur
from tests.truth.camera_effects import TargetScene, boost, correlate_noise

# The pattern repeats after this many pixels, and spectra this many sampling frequencies away still
# fold back.
PERIOD_PX = 320
ALIASES = 3
# Length of the tabulated profile and its step, px; highest frequency of its spectrum, cycles per
# pixel.
PROFILE_PX, STEP_PX, HIGHEST = 4096, 1 / 32, 3


@lru_cache(maxsize=16)
def _bars_image(
    blur: TrueBlur,
    bars: int,
    frequency_cy_per_px: float,
    angle_deg: float,
    row_px: float,
    col_px: float,
) -> Array:
    """Blurred bars sampled at whole pixels, 1 on a wide bar, shape (PERIOD_PX, PERIOD_PX), centred
    on its middle.

    Notes
    -----
    Spectrum of N bars of width w = 1/(2f) and length 7 w: w sinc(u w) sin(pi N u / f) / sin(pi u /
    f) across them times 7 w sinc(7 w v) along. A sampled picture's spectrum is the sum of its
    copies at whole cycles a pixel.
    """
    from scipy.fft import irfft2

    rows, cols = np.fft.fftfreq(PERIOD_PX)[:, None], np.fft.rfftfreq(PERIOD_PX)[None, :]
    spectrum = np.zeros((rows.size, cols.size), complex)
    for up in range(-ALIASES, ALIASES + 1):
        for right in range(-ALIASES, ALIASES + 1):
            fy, fx = rows + up, cols + right
            shift = np.exp(-2j * np.pi * (fy * row_px + fx * col_px))
            spectrum += (
                spectrum_of_bars(bars, frequency_cy_per_px, angle_deg, fx, fy)
                * blur.transfer(fx, fy)
                * shift
            )
    return np.fft.fftshift(np.asarray(irfft2(spectrum, (PERIOD_PX, PERIOD_PX))))


def spectrum_of_bars(bars: int, frequency: float, angle_deg: float, fx: Array, fy: Array) -> Array:
    """Spectrum of the bars themselves, px^2."""
    angle, width = np.deg2rad(angle_deg), 0.5 / frequency
    across, along = fx * np.cos(angle) + fy * np.sin(angle), fy * np.cos(angle) - fx * np.sin(angle)
    centres = (np.arange(bars) - (bars - 1) / 2) / frequency
    comb = sum(np.cos(2 * np.pi * centre * across) for centre in centres)
    return width * np.sinc(width * across) * comb * 7 * width * np.sinc(7 * width * along)


@dataclass(frozen=True, kw_only=True)
class BarScene(TargetScene):
    """A bar target; the step of its noise is that of a wide bar."""

    # bars, frequency_cy_per_px: number of bars, and their frequency across them
    bars: int = 4
    frequency_cy_per_px: float = 0.12
    rows: int = 160
    cols: int = 180
    frames: int = 8
    angle_deg: float = 4.0
    # row_px, col_px: where the target's middle stands off the middle of the frame, px
    row_px: float = 0.0
    col_px: float = 0.0
    # pedestal_dn, level_dn: ground, and what a wide bar adds to it, DN
    pedestal_dn: float = 15.0
    level_dn: float = 150.0
    snr: float = 20.0
    # Gap between the target and another of three quarters of its frequency along the bars, px;
    # infinite: none
    neighbour_px: float = np.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        if max(self.rows, self.cols) > PERIOD_PX:
            raise BadInput(
                f"rows and cols must be at most {PERIOD_PX}, got {self.rows} x {self.cols}"
            )

    @property
    def levels_dn(self) -> tuple[float, float]:
        """Levels of the ground and of a wide bar, DN, black level included."""
        return self.pedestal_dn, self.pedestal_dn + self.level_dn

    @property
    def truth_mtf(self) -> float:
        """MTF at the bars' frequency across them, pixel included, dimensionless."""
        plain = self.blur.mtf(self.frequency_cy_per_px, self.angle_deg)
        return float(plain * boost(self.frequency_cy_per_px, self.sharpening))

    def _target(self, along_px: float, frequency: float, motion_px: float) -> Array:
        """Light of one target from 0 to about 1, moved along its bars, shape (row, col)."""
        angle = np.deg2rad(self.angle_deg)
        row = self.row_px + along_px * np.cos(angle) - 0.5 * ((self.rows + 1) % 2)
        col = self.col_px - along_px * np.sin(angle) + motion_px - 0.5 * ((self.cols + 1) % 2)
        image = _bars_image(
            self.blur, self.bars, frequency, round(self.angle_deg, 9), round(row, 9), round(col, 9)
        )
        first_row, first_col = (
            PERIOD_PX // 2 - (self.rows - self.rows % 2) // 2,
            PERIOD_PX // 2 - (self.cols - self.cols % 2) // 2,
        )
        return image[first_row : first_row + self.rows, first_col : first_col + self.cols]

    def _light(self, motion_px: float) -> Array:
        light = self._target(0.0, self.frequency_cy_per_px, motion_px)
        if np.isfinite(self.neighbour_px):
            other = 0.75 * self.frequency_cy_per_px
            distance_px = self.neighbour_px + 1.75 / self.frequency_cy_per_px + 1.75 / other
            light = light + self._target(distance_px, other, motion_px)
        return light

    def light(self, moved_px: float = 0.0) -> Array:
        """Noiseless light signal over black, DN of a straight response, shape (row, col).

        `moved_px`: horizontal displacement of the target, px.
        """
        light = self._light(moved_px)
        if self.motion_px:
            odd = (np.arange(self.rows) % 2 == 1)[:, None]
            light = np.where(odd, self._light(moved_px + self.motion_px), light)
        position = (np.arange(self.cols) + 0.5) / self.cols
        light = (self.pedestal_dn - self.black_dn + self.level_dn * light) * (
            1 + self.gradient * position
        )
        if self.clip_share > 0:
            room = self.full_scale_dn - self.black_dn
            light = (
                light
                * room
                / (self.pedestal_dn - self.black_dn + (1 - self.clip_share) * self.level_dn)
            )
        return light


@lru_cache(maxsize=64)
def _profile(blur: TrueBlur, bars: int, frequency: float, angle_deg: float) -> Array:
    """Blurred profile across the bars, 1 on a wide bar, every `STEP_PX`, centred."""
    v = np.arange(HIGHEST * PROFILE_PX) / PROFILE_PX
    width = 0.5 / frequency
    centres = (np.arange(bars) - (bars - 1) / 2) / frequency
    comb = sum(np.cos(2 * np.pi * centre * v) for centre in centres)
    spectrum = np.zeros(int(PROFILE_PX / STEP_PX) // 2 + 1)
    spectrum[: v.size] = width * np.sinc(v * width) * comb * blur.mtf(v, angle_deg)
    return np.fft.fftshift(np.fft.irfft(spectrum)) / STEP_PX


@dataclass(frozen=True, kw_only=True)
class StripScene:
    """Some rows across bars that run through them, as a camera would digitise them."""

    blur: TrueBlur = field(default_factory=TrueBlur)  # The blur whose MTF is the truth
    # bars, frequency_cy_per_px: number of bars, and their frequency across them
    bars: int = 4
    frequency_cy_per_px: float = 0.12
    # rows, reach_px, frames: rows, ground on either side of the bars, and frames
    rows: int = 20
    reach_px: int = 16
    frames: int = 1
    # angle_deg, phase_px: tilt of the bars from the columns, degrees, and where their middle lies,
    # px
    angle_deg: float = 4.0
    phase_px: float = 0.0
    turned: bool = False  # Whether rows and columns are exchanged: horizontal bars
    # Step of a wide bar over the standard deviation of one pixel's noise, dimensionless
    snr: float = 10.0
    # Gaussian blur of the noise behind the gain, px; the noise of a pixel stays what it is
    noise_blur_px: float = 0.0
    noise_sign: int = 1  # 1, or -1: the same draw with its noise upside down
    # pedestal_dn, level_dn, full_scale_dn: ground, step, and highest code, DN
    pedestal_dn: float = 400.0
    level_dn: float = 1000.0
    full_scale_dn: float = 4095.0

    @property
    def truth_mtf(self) -> float:
        """MTF at the bars' frequency across them, pixel included, dimensionless."""
        return float(self.blur.mtf(self.frequency_cy_per_px, self.angle_deg))

    def light(self) -> Array:
        """Noiseless picture, 1 on a wide bar, shape (row, col) before it is turned."""
        cols = int(np.ceil(self.bars / self.frequency_cy_per_px)) + 2 * self.reach_px
        row, col = np.mgrid[: self.rows, :cols]
        angle = np.deg2rad(self.angle_deg)
        across = (col - (cols - 1) / 2 - self.phase_px) * np.cos(angle) + (
            row - (self.rows - 1) / 2
        ) * np.sin(angle)
        profile = _profile(self.blur, self.bars, self.frequency_cy_per_px, self.angle_deg)
        return np.interp(across, (np.arange(profile.size) - profile.size // 2) * STEP_PX, profile)

    def frames_drawn(self, rng: np.random.Generator) -> FrameStack:
        """Draw the stack: the picture, noise, whole codes."""
        light = self.light()
        noise = correlate_noise(
            rng.standard_normal((self.frames, *light.shape)), self.noise_blur_px
        )
        drawn = self.pedestal_dn + self.level_dn * (light + self.noise_sign * noise / self.snr)
        codes = np.clip(np.rint(drawn), 0, self.full_scale_dn).astype(np.uint16)
        if self.turned:
            codes = np.ascontiguousarray(np.swapaxes(codes, 1, 2))
        return FrameStack(data=codes, full_scale_dn=self.full_scale_dn)
