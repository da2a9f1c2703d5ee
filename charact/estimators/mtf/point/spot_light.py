r"""Light of a spot pixel by pixel, its wings by a power law, and the Fourier transform of both.

.. math:: M(f) = \frac{|\sum_{r<R} v\,e^{-2\pi i f x} + t\,W(f)|}{\sum_{r<R} v + t},
          \qquad W(f) = \int_R^\infty \frac{R}{r^2} J_0(2\pi f r)\,dr

v: pixels above the background b; t: light beyond R, of which the mean falls as r^-3. That is the
asymptote of every pupil with an edge (Lommel) and of a Lorentzian; steeper wings hold less. No form
of the blur is assumed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.point.parametric_noise import measure_surroundings_noise
from charact.estimators.mtf.point.source import DetectedSource
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS, SOURCES, WINGS
from charact.frames.noise_law import NoiseLaw
from charact.frames.robust import median, robust_sd
from labdata import Array, Mask

# Frequencies of the transform, cycles per column pitch.
FREQUENCY = np.linspace(0.0, 0.5, 251)


class Transform(NamedTuple):
    """MTF of a spot along one direction at `FREQUENCY`, pixel aperture included."""

    modulus: Array  # Shape (frequency,)
    # Change of the modulus by each independent error of one standard deviation, shape (frequency,
    # error)
    errors: Array

    @property
    def sd(self) -> Array:
        """Standard uncertainty, shape (frequency,)."""
        return np.linalg.norm(self.errors, axis=1)

    def draws(self, rng: np.random.Generator, count: int) -> Array:
        """Return curves drawn from the normal distribution of the errors, shape (draw,
        frequency).
        """
        return np.abs(
            self.modulus + rng.standard_normal((count, self.errors.shape[1])) @ self.errors.T
        )


@dataclass(frozen=True, kw_only=True)
class SpotLight:
    """Pixels of a spot and of its background."""

    frames: NDArray  # All pixels, shape (frame, row, col), DN
    # x, y: position of every pixel from the centre of light, column pitches, shape (row, col)
    x: Array
    y: Array
    radius_px: float  # R
    background: Mask  # Pixels that the background and the wings are fitted to, shape (row, col)
    dark: NoiseLaw  # Noise without light
    # Light of another source may be among the pixels: a second blob next to the spot
    has_neighbours: bool
    is_cut: bool  # Whether the border of the frame is nearer than R
    by_frames: bool  # Whether the scatter of the frames gives the uncertainty
    # Variance of a frame's light over that light, DN; None: from the pixels
    light_gain_dn: float | None = None

    @cached_property
    def mean(self) -> Array:
        """Mean frame, shape (row, col), DN."""
        return self.frames.mean(axis=0, dtype=np.float64)

    @cached_property
    def disc(self) -> Mask:
        """Pixels within R, shape (row, col)."""
        return np.hypot(self.x, self.y) < self.radius_px

    @cached_property
    def extent_px(self) -> float:
        """Square root of the light over its peak, px: 1.8 radii of a disc."""
        level = median(self.mean[self.background])
        light = max(float((self.mean[self.disc] - level).sum()), 1e-9)
        return float(np.sqrt(light * self.pixel_area / max(float(self.mean.max()) - level, 1e-9)))

    @cached_property
    def pixel_area(self) -> float:
        """Area of a pixel, squared column pitches."""
        rows = self.y[:, 0]
        return float(rows[1] - rows[0])

    @cached_property
    def _surroundings(self) -> tuple[Array, Array]:
        """Return level, two slopes and t at their optimum, and their covariance.

        The prior of t is normal about half of the light of a diffraction spot's wings.
        """
        columns = self._columns(self.background)
        radius = np.hypot(self.x, self.y)[self.background]
        wing = self.pixel_area * self.radius_px / (2.0 * np.pi * np.maximum(radius, 1e-9) ** 3)
        design = np.concatenate([columns, wing[:, None]], axis=1)
        values, frames = self.mean[self.background], len(self.frames)
        level = median(values)
        light = max(float((self.mean[self.disc] - level).sum()), 1e-9)
        # A wide core reaches further: MTF50 is near the inverse of its width.
        expected = min(WINGS.at_width * self.extent_px / self.radius_px, WINGS.max_fraction) * light
        variance = self.dark.variance(0.0) * self.dark.correlation_factor / frames
        variance = max(variance, robust_sd(values - level) ** 2 * self.dark.correlation_factor)
        # Quantisation shifts all quiet pixels alike.
        variance += values.size * self.rounding_dn**2
        normal = design.T @ design / variance
        normal[3, 3] += expected**-2.0
        right = design.T @ values / variance + np.array([0.0, 0.0, 0.0, expected**-1.0])
        covariance: Array = np.asarray(np.linalg.inv(normal), np.float64)
        return covariance @ right, covariance

    def _columns(self, pixels: Mask) -> Array:
        """Return level and slopes at pixels, shape (pixel, 3)."""
        return np.stack([np.ones(np.count_nonzero(pixels)), self.x[pixels], self.y[pixels]], axis=1)

    @cached_property
    def light(self) -> tuple[float, float]:
        """Light of the spot, its wings included, and that of the wings, DN px^2."""
        level, _ = self._surroundings
        inner = (self.mean[self.disc] - self._columns(self.disc) @ level[:3]).sum()
        return float(inner + level[3]), float(level[3])

    @property
    def rounding_dn(self) -> float:
        """Largest shift of quiet pixels by quantisation, DN: the first term of the sawtooth's
        series.
        """
        if self.frames.dtype.kind not in "ui":
            return 0.0
        return float(np.exp(-2.0 * np.pi**2 * self.dark.variance(0.0)) / np.pi)

    @property
    def light_sd(self) -> float:
        """Standard uncertainty of the light within R by noise, DN px^2."""
        level, covariance = self._surroundings
        columns = self._columns(self.disc)
        values = self.mean[self.disc] - columns @ level[:3]
        by_level = columns.sum(axis=0)
        of_level = by_level @ covariance[:3, :3] @ by_level
        return float(np.sqrt(np.sum(self.pixel_sd(values) ** 2) + of_level))

    @property
    def level(self) -> Array:
        """Background of every pixel, shape (row, col), DN."""
        every = np.ones(self.x.shape, bool)
        return (self._columns(every) @ self._surroundings[0][:3]).reshape(self.x.shape)

    @cached_property
    def gain_dn(self) -> float:
        """Variance of a frame's light over that light, DN, from frame differences, or the pixels'
        scatter about their neighbours in one frame.
        """
        if self.light_gain_dn is not None:
            return self.light_gain_dn
        level, _ = self._surroundings
        lit = self.disc & (self.mean - level[0] > WINGS.lit * (self.mean.max() - level[0]))
        light = max(float((self.mean - level[0])[lit].sum()), 1e-9)
        if len(self.frames) > 1:
            variance = self.frames[:, lit].var(axis=0, ddof=1, dtype=np.float64)
            return max(float((variance - self.dark.variance(0.0)).sum()) / light, 0.0)
        from scipy.ndimage import convolve

        line = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 70.0**0.5
        scatter = convolve(self.mean, np.outer(line, line), mode="nearest")[lit] ** 2
        over = max(float((scatter - self.dark.variance(0.0)).sum()) / light, 0.0)
        # What the kernel leaves of a sharp spot is no noise, and few pixels may show none.
        least, most = WINGS.read_e
        return float(np.clip(over, self.dark.sd(0.0) / most, self.dark.sd(0.0) / least))

    def transform(self, vertical: bool) -> Transform:
        """Return the MTF along rows, or along columns."""
        disc, (level, covariance) = self.disc, self._surroundings
        along = (self.y if vertical else self.x)[disc]
        values = self.mean[disc] - self._columns(disc) @ level[:3]
        wave = np.exp(-2j * np.pi * FREQUENCY[:, None] * along)
        wings = wing_transform(FREQUENCY * self.radius_px)
        complex_sum = wave @ values + level[3] * wings
        turn = np.exp(-1j * np.angle(complex_sum))
        turned, total = (turn[:, None] * wave).real, self.light[0]
        modulus = np.abs(complex_sum) / total
        rise = (turned - modulus[:, None]) / total
        by_level = np.concatenate(
            [
                -rise @ self._columns(disc),
                ((turn.real * wings - modulus) / total)[:, None],
            ],
            axis=1,
        )
        t_sd = WINGS.relative_sd * abs(level[3])
        # Light that the sampling folds back, of a transfer whose logarithm falls ever faster: at
        # most M(1/2)^2 / M(f), of the envelope of a transfer with lobes.
        end = modulus[WINGS.end_cy_per_px <= FREQUENCY].max()
        folded = np.minimum(end**2 / np.maximum(modulus, 1e-12), end)
        errors = [
            rise * self.pixel_sd(values),
            folded[:, None],
            by_level @ np.linalg.cholesky(covariance),
            t_sd * by_level[:, 3:],
        ]
        if self.by_frames:
            count = len(self.frames)
            deviations = self.frames[:, disc] - self.mean[disc]
            # Student's t of so many frames has this variance.
            lag = ACCURACY.lag_factor if self.dark.correlation.size > 1 else 1.0
            scale = (count - 1.0) / max(count - 3.0, 1.0) / (count * (count - 1.0))
            errors[0] = rise @ deviations.T * np.sqrt(scale) * lag
        spread = Transform(modulus, np.concatenate(errors, axis=1))
        # The modulus of a sum with noise is larger than that of the sum.
        plain = np.sqrt(np.maximum(modulus**2 - np.where(modulus < 0.5, spread.sd**2, 0.0), 0.0))
        return spread._replace(modulus=plain)

    def pixel_sd(self, light: Array) -> Array:
        """Return standard deviations of the mean frame's pixels, shape (pixel,), DN."""
        law = NoiseLaw(gain_dn=self.gain_dn, read_dn=self.dark.read_dn)
        variance = law.variance(light) * self.dark.correlation_factor
        return np.sqrt(variance / len(self.frames))


def wing_transform(phase: Array) -> Array:
    """Return W at f R, shape (f,): 1 at 0."""
    from scipy.special import j0

    # u = R / r maps the wings to (0, 1]; nodes are dense enough for f R of 30.
    node, weight = np.polynomial.legendre.leggauss(96)
    u, weight = 0.5 * (node + 1.0), 0.5 * weight
    near = j0(2.0 * np.pi * phase[:, None] / u) @ weight
    return np.where(phase > 0.0, near, 1.0)


def light_of_spot(
    frames: NDArray, source: DetectedSource, pitch_ratio: float, *, has_tube: bool
) -> SpotLight | None:
    """Return the light of a detected source in frames (frame, row, col); None where the spot leaves
    no background.
    """
    from scipy import ndimage

    mean = frames.mean(axis=0, dtype=np.float64)
    smooth = ndimage.gaussian_filter(mean, WINGS.smoothing_px)
    level = float(np.quantile(smooth, WINGS.background_quantile))
    lower = smooth[smooth <= level]
    # The lower half of the background shows its scatter, whatever light is in the frame.
    spread = robust_sd(np.concatenate([lower, 2.0 * level - lower]), level)
    height = float(smooth[source.row, source.col]) - level
    noise_floor = WINGS.min_height_sd * spread
    core, _ = _blob(smooth, level + max(noise_floor, WINGS.core_height * height), source)
    weight = np.where(core, smooth - level, 0.0)
    rows, cols = np.indices(mean.shape)
    row, col = (float((weight * at).sum() / weight.sum()) for at in (rows, cols))
    x, y = cols - col, (rows - row) * pitch_ratio
    distance = np.hypot(x, y)
    blob, others = _blob(smooth, level + max(noise_floor, WINGS.min_height * height), source)
    to_border_px = min(-float(x[0, 0]), float(x[0, -1]), -float(y[0, 0]), float(y[-1, 0])) + 0.5
    core_px, blob_px = (
        WINGS.margin * float(distance[part].max()) + WINGS.margin_px for part in (core, blob)
    )
    radius_px = max(min(blob_px, WINGS.max_radius * to_border_px), core_px)
    bright = others & (smooth - level > LIMITS.min_other_height * height)
    joined = [
        distance[at] < radius_px and _is_apart(smooth - level, at, source)
        for at in source.neighbours
    ]
    ring = (distance >= radius_px) & (distance < 3.0 * radius_px + 10.0)
    grown = ndimage.binary_dilation(others & (distance >= radius_px), iterations=2)
    ring &= ~np.asarray(grown, bool)
    if np.count_nonzero(ring) < LIMITS.min_background_pixels:
        return None
    count = len(frames)
    return SpotLight(
        frames=frames,
        x=x,
        y=y,
        radius_px=radius_px,
        background=ring,
        dark=measure_surroundings_noise(frames, round(row), round(col), spot=~ring),
        has_neighbours=bool(bright[distance < radius_px].any()) or any(joined),
        is_cut=to_border_px < core_px,
        by_frames=count >= (LIMITS.min_transform_frames if has_tube else WINGS.min_frames),
    )


def _is_apart(light: Array, at: tuple[int, int], source: DetectedSource) -> bool:
    """Return whether a detected neighbour is another source, though its light joins this one: as
    bright as one of two, and not in one piece with it above half its height, as peaks of a ring
    are.
    """
    is_bright = light[at] > SOURCES.min_ratio * light[source.row, source.col]
    return bool(is_bright) and not _blob(light, 0.5 * light[at], source)[0][at]


def _blob(smooth: Array, threshold: float, source: DetectedSource) -> tuple[Mask, Mask]:
    """Return the connected pixels above a threshold that hold the source, and the other ones."""
    from scipy import ndimage

    labels = np.zeros(smooth.shape, np.int64)
    ndimage.label(smooth > threshold, output=labels)
    blob = labels == max(int(labels[source.row, source.col]), 1)
    blob[source.row, source.col] = True
    return blob, (labels > 0) & ~blob
