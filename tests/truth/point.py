"""Point sources of exactly known MTF: photoelectrons that land where the blur takes them, each a
pulse of light.

Nothing is fitted or transformed: places are drawn from the law whose characteristic function is the
MTF (Gaussian, or the stable law of exp(-(f/fc)^n)), and pulses are integrated over square pixels in
closed form.
"""

from dataclasses import dataclass, replace

import numpy as np

from labdata import BadInput
from tests.truth.blur import Array, TrueBlur
from tests.truth.camera_effects import PulsedTarget

SPARED_PX = 12.0


def landing_places(blur: TrueBlur, count: int, rng: np.random.Generator) -> Array:
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


def _disc(diameter_px: float, count: int, rng: np.random.Generator) -> Array:
    """Draw places evenly over a disc, px, shape (count, 2)."""
    radius, turn = 0.5 * diameter_px * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return radius[:, None] * np.stack([np.sin(turn), np.cos(turn)], axis=1)


@dataclass(frozen=True, kw_only=True)
class PointScene(PulsedTarget):
    """A point source as a camera would digitise it, with one knob for each way in which point
    methods break. `gradient` is that of the background; the MTF is that along the rows.

    Parameters
    ----------
    pulse_px
        Standard deviation of a photoelectron's Gaussian pulse, px; 0: an ordinary camera.
    photoelectrons
        Mean number of a frame.
    peak_dn
        Height of the brightest pixel over the background, DN.
    background
        Photoelectrons of a pixel and frame without the source.
    row_px, col_px
        Where the source stands off the middle of the frame, px.
    neighbour_px, neighbour_share
        Distance of another source along the rows, px, and its light; infinite: none.
    pinhole_px
        Diameter of the source, px; its own transfer is not the camera's.
    """

    photoelectrons: float = 3000.0
    peak_dn: float = 150.0
    background: float = 0.02
    rows: int = 96
    cols: int = 96
    frames: int = 8
    angle_deg: float = 0.0
    row_px: float = 0.0
    col_px: float = 0.0
    neighbour_px: float = np.inf
    neighbour_share: float = 0.5
    pinhole_px: float = 0.0

    @property
    def gain_dn(self) -> float:
        """Light of a photoelectron's pulse, DN px^2, at which the brightest pixel stands at
        `peak_dn`.
        """
        # Light over the peak's height is the inverse of the MTF's integral over both frequencies.
        f = (np.arange(600) + 0.5) / 400
        peak = float(np.sum(2 * np.pi * f * self.mtf(f)) / 400)
        return self.peak_dn / (max(self.photoelectrons, 1.0) * peak)

    def _light(self, rng: np.random.Generator) -> Array:
        jitter = (
            self.jitter_px * rng.standard_normal(self.frames)
            if self.jitter_px
            else np.zeros(self.frames)
        )
        return np.stack(
            [self._frame(number, float(jitter[number]), rng) for number in range(self.frames)]
        )

    def _frame(self, number: int, jitter_px: float, rng: np.random.Generator) -> Array:
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

    def _photoelectron_positions(self, mean: float, rng: np.random.Generator) -> Array:
        """Places of one source's photoelectrons about its middle."""
        count = int(rng.poisson(mean))
        disc = _disc(self.pinhole_px, count, rng)
        return landing_places(self.blur, count, rng) + disc

    def _background(self, rng: np.random.Generator) -> Array:
        """Places of the photoelectrons that no source sent."""
        tilt = abs(self.gradient)
        count = int(rng.poisson(self.background * self.rows * self.cols * (1 + tilt)))
        row, col, chance = rng.random((3, count)) * [[self.rows], [self.cols], [1 + tilt]]
        keep = chance < 1 + self.gradient * (col / self.cols) if self.gradient else chance < 1
        return np.stack([row, col], axis=1)[keep] - 0.5

    def _pulses(self, landings: Array, heights: Array) -> Array:
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


def _pixel_fractions(size: int, centre: Array, sigma_px: float) -> Array:
    """Share of Gaussians in each pixel of a line, shape (gaussian, pixel)."""
    from scipy.special import erf

    borders = np.arange(size + 1) - 0.5
    return 0.5 * np.diff(erf((borders - centre[:, None]) / (sigma_px * np.sqrt(2.0))), axis=1)


def _heights(count: int, spread: float, rng: np.random.Generator) -> Array:
    """Pulse heights of mean 1 and a relative variance."""
    return np.ones(count) if spread <= 0 else rng.standard_gamma(1 / spread, count) * spread
