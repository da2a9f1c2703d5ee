"""Point sources of exactly known MTF: photoelectrons that land where the blur takes them, each a
pulse of light.

Nothing is fitted or transformed: places are drawn from the law whose characteristic function is the
MTF (Gaussian, or the stable law of exp(-(f/fc)^n)), and pulses are integrated over square pixels in
closed form.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, FrameStack
from tests.truth.blur import TrueBlur, level_crossing
from tests.truth.camera_effects import boost, digitised, sharpen_images

SPARED_PX = 12.0


def landing_places(blur: TrueBlur, count: int, rng: np.random.Generator) -> NDArray[np.floating]:
    """Draw where a point's photoelectrons land, px, shape (count, 2).

    Notes
    -----
    What the halo takes lands evenly over its disc besides. exp(-(f/fc)^n) is the characteristic
    function of an isotropic stable law of index n: a normal vector times the root of a positive
    stable variable of index n/2, drawn as Kanter did (Ann. Probab. 3, 697, 1975).
    """
    if blur.halo_share:
        strays = (rng.random(count) < blur.halo_share)[:, None]
        return landing_places(replace(blur, halo_share=0.0), count, rng) + strays * _disc(
            blur.halo_px, count, rng
        )
    normal = rng.standard_normal((count, 2))
    if blur.form == "gaussian":
        return blur.sigma_px * normal
    index = blur.exponent / 2
    if not 0 < index < 1:
        raise BadInput(f"the exponent of the blur must lie in (0, 2), got {blur.exponent:g}")
    turn, wait = np.pi * rng.random(count), rng.standard_exponential(count)
    kanter = (
        np.sin(index * turn) ** index * np.sin((1 - index) * turn) ** (1 - index) / np.sin(turn)
    )
    positive = (kanter ** (1 / (1 - index)) / wait) ** ((1 - index) / index)
    # E exp(i k.x) = E exp(-k^2 s^2 S / 2) = exp(-(k^2 s^2 / 2)^index), k = 2 pi f.
    scale = np.sqrt(2.0) / (2 * np.pi * blur.frequency_cy_per_px)
    return scale * np.sqrt(positive)[:, None] * normal


def _disc(diameter_px: float, count: int, rng: np.random.Generator) -> NDArray[np.floating]:
    """Draw places evenly over a disc, px, shape (count, 2)."""
    radius, turn = 0.5 * diameter_px * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return radius[:, None] * np.stack([np.sin(turn), np.cos(turn)], axis=1)


@dataclass(frozen=True, kw_only=True)
class PointScene:
    """A point source as a camera would digitise it, with one knob for each way in which point
    methods break.
    """

    blur: TrueBlur = field(default_factory=TrueBlur)  # The blur before the gain
    # Standard deviation of a photoelectron's Gaussian pulse, the blur behind the gain, px; 0: an
    # ordinary camera
    pulse_px: float = 0.6
    photoelectrons: float = 3000.0  # Mean number of a frame
    peak_dn: float = 150.0  # Height of the brightest pixel over the background, DN
    background: float = 0.02  # Photoelectrons of a pixel and frame without the source
    # rows, cols, frames: size of the stack
    rows: int = 96
    cols: int = 96
    frames: int = 8
    # row_px, col_px: where the source stands off the middle of the frame, px
    row_px: float = 0.0
    col_px: float = 0.0
    read_dn: float = 1.0  # Standard deviation of white read noise, DN
    # Relative variance of the pulses' heights: 1 is exponential, 0 has none
    gain_spread: float = 0.6
    gamma: float = 1.0  # Exponent of the response, on a scale from black to full scale
    gradient: float = 0.0  # Background at the right border over that at the left, minus 1
    motion_px: float = 0.0  # Horizontal displacement of odd rows, exposed in the later field, px
    # drift_px, jitter_px: horizontal displacement from the first frame to the last, and standard
    # deviation of one that each frame has for itself, px
    drift_px: float = 0.0
    jitter_px: float = 0.0
    # neighbour_px, neighbour_share: distance of another source along the rows, px, and its light;
    # infinite: none
    neighbour_px: float = np.inf
    neighbour_share: float = 0.5
    pinhole_px: float = 0.0  # Diameter of the source, px
    hot_share: float = 0.0  # Share of pixels stuck at full scale
    # Share by which the camera raises fine detail, see `tests.truth.camera_effects`
    sharpening: float = 0.0
    # black_dn, full_scale_dn: codes at no light and at the top, DN
    black_dn: float = 12.0
    full_scale_dn: float = 255.0

    def __post_init__(self) -> None:
        if self.photoelectrons < 0 or self.pulse_px < 0:
            raise BadInput(
                f"photoelectrons and pulse_px must not be negative, got {self.photoelectrons:g} "
                f"and {self.pulse_px:g}"
            )

    def mtf(self, frequency_cy_per_px: NDArray[np.floating] | float) -> NDArray[np.floating]:
        """MTF along the rows, pixel included; a pinhole's own transfer is not the camera's."""
        pulse = np.exp(-2 * (np.pi * np.asarray(frequency_cy_per_px, float) * self.pulse_px) ** 2)
        return (
            self.blur.mtf(frequency_cy_per_px, 0.0)
            * pulse
            * boost(frequency_cy_per_px, self.sharpening)
        )

    @property
    def truth_mtf50(self) -> float:
        """MTF50 along the rows, cycles per pixel."""
        return level_crossing(self.mtf, 0.5)

    @property
    def gain_dn(self) -> float:
        """Light of a photoelectron's pulse, DN px^2, at which the brightest pixel stands at
        `peak_dn`.
        """
        # Light over the peak's height is the inverse of the MTF's integral over both frequencies.
        f = (np.arange(600) + 0.5) / 400
        peak = float(np.sum(2 * np.pi * f * self.mtf(f)) / 400)
        return self.peak_dn / (max(self.photoelectrons, 1.0) * peak)

    def frames_drawn(self, rng: np.random.Generator) -> FrameStack:
        """Draw the stack: Poisson photoelectrons, pulses of random height, read noise, digitised
        and clipped.
        """
        jitter = (
            self.jitter_px * rng.standard_normal(self.frames)
            if self.jitter_px
            else np.zeros(self.frames)
        )
        light = np.stack(
            [self._frame(number, float(jitter[number]), rng) for number in range(self.frames)]
        )
        room = self.full_scale_dn - self.black_dn
        signal = self.black_dn + room * np.maximum(light / room, 0) ** self.gamma
        signal = sharpen_images(
            signal + self.read_dn * rng.standard_normal(signal.shape), self.sharpening
        )
        stuck = rng.random((self.rows, self.cols)) < self.hot_share
        return digitised(signal, stuck, black_dn=self.black_dn, full_scale_dn=self.full_scale_dn)

    def _frame(
        self, number: int, jitter_px: float, rng: np.random.Generator
    ) -> NDArray[np.floating]:
        """Light of one frame over black, DN."""
        displaced = self.drift_px * (number / max(self.frames - 1, 1) - 0.5) + jitter_px
        centre = np.array(
            [(self.rows - 1) / 2 + self.row_px, (self.cols - 1) / 2 + self.col_px + displaced]
        )
        spots = [centre + self._photoelectron_positions(self.photoelectrons, rng)]
        if np.isfinite(self.neighbour_px):
            other = centre + np.array([0.0, self.neighbour_px])
            spots.append(
                other
                + self._photoelectron_positions(self.photoelectrons * self.neighbour_share, rng)
            )
        spots.append(self._background(rng))
        landings = np.concatenate(spots)
        heights = self.gain_dn * _heights(len(landings), self.gain_spread, rng)
        if not self.motion_px:
            return self._pulses(landings, heights)
        odd, displaced = (
            (np.arange(self.rows) % 2 == 1)[:, None],
            landings + np.array([0.0, self.motion_px]),
        )
        return np.where(odd, self._pulses(displaced, heights), self._pulses(landings, heights))

    def _photoelectron_positions(
        self, mean: float, rng: np.random.Generator
    ) -> NDArray[np.floating]:
        """Places of one source's photoelectrons about its middle."""
        count = int(rng.poisson(mean))
        disc = _disc(self.pinhole_px, count, rng)
        return landing_places(self.blur, count, rng) + disc

    def _background(self, rng: np.random.Generator) -> NDArray[np.floating]:
        """Places of the photoelectrons that no source sent."""
        tilt = abs(self.gradient)
        count = int(rng.poisson(self.background * self.rows * self.cols * (1 + tilt)))
        row, col, chance = rng.random((3, count)) * [[self.rows], [self.cols], [1 + tilt]]
        keep = chance < 1 + self.gradient * (col / self.cols) if self.gradient else chance < 1
        return np.stack([row, col], axis=1)[keep] - 0.5

    def _pulses(
        self, landings: NDArray[np.floating], heights: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """Pixels of pulses at places (pulse, 2), each integrated over square pixels."""
        on_frame = np.all(
            (landings > -SPARED_PX) & (landings < np.array([self.rows, self.cols]) + SPARED_PX),
            axis=1,
        )
        landings, heights = landings[on_frame], heights[on_frame]
        if self.pulse_px == 0:
            borders = [np.arange(size + 1) - 0.5 for size in (self.rows, self.cols)]
            return np.histogram2d(*landings.T, bins=borders, weights=heights)[0]
        down, along = (
            _pixel_fractions(size, landings[:, axis], self.pulse_px)
            for axis, size in enumerate((self.rows, self.cols))
        )
        return (down * heights[:, None]).T @ along


def _pixel_fractions(
    size: int, centre: NDArray[np.floating], sigma_px: float
) -> NDArray[np.floating]:
    """Share of Gaussians in each pixel of a line, shape (gaussian, pixel)."""
    from scipy.special import erf

    borders = np.arange(size + 1) - 0.5
    return 0.5 * np.diff(erf((borders - centre[:, None]) / (sigma_px * np.sqrt(2.0))), axis=1)


def _heights(count: int, spread: float, rng: np.random.Generator) -> NDArray[np.floating]:
    """Pulse heights of mean 1 and a relative variance."""
    return np.ones(count) if spread <= 0 else rng.standard_gamma(1 / spread, count) * spread
