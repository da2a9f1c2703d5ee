"""Bands of a fusion: frames with their noise law and blooming, and their display values with noise
and holes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.bloom_map import BloomMap
from charact.frames.noise_law import NoiseLaw
from charact.fusion.noise_law import estimate_noise
from charact.fusion.pyramid import NoiseGains, fill_holes, level_count, noise_gains, reduce_image
from charact.fusion.thresholds import FUSION
from labdata.errors import BadInput

Image = NDArray[Any]  # float32
Mask = NDArray[np.bool_]
# Lowest and highest value of a band that are shown as 0 and 1.
Span = tuple[float, float]
# Means of 4 x 4 px from which a span is taken; percentiles of 8,000 are known within a tenth of
# their distance to the ends.
SPAN_SAMPLES = 8000


@dataclass(frozen=True, kw_only=True)
class Band:
    """One frame of a fusion.

    `image`: frame above dark, shape (row, col), DN, or K of a thermal imager; `noise`: noise law of
    the camera, None: estimated from the frame, and flagged; `clip`: full scale above dark, in the
    unit of the image, None: nothing is clipped; `bloom`: bloom map of the frame, subtracted by the
    methods that know blooming; `no_data`: pixels that another camera does not see, such as occluded
    ones, shape (row, col); `flags`, `notes`: reasons to distrust the frame, and remarks. An image
    that is not a finite two-dimensional array is BadInput.
    """

    name: str
    image: NDArray
    noise: NoiseLaw | None = None
    clip: float | None = None
    bloom: BloomMap | None = None
    no_data: Mask | None = None
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        image = np.asarray(self.image, np.float32)
        if image.ndim != 2 or min(image.shape) < 16:
            raise BadInput(
                f"the band {self.name!r} must have 16 rows and columns or more, got shape "
                f"{image.shape}"
            )
        if not np.isfinite(image.sum()):
            bad = int(np.count_nonzero(~np.isfinite(image)))
            raise BadInput(
                f"every pixel must be finite, got {bad} that are NaN or infinite in the band "
                f"{self.name!r}"
            )
        for what, given in (
            ("bloom map", self.bloom and self.bloom.fraction),
            ("no_data", self.no_data),
        ):
            if given is not None and given.shape != image.shape:
                raise BadInput(
                    f"the {what} of band {self.name!r} must have its shape {image.shape}, got "
                    f"{given.shape}"
                )
        object.__setattr__(self, "image", image)


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A band as it is fused: display values, noise power, and pixels without information.

    `value`: display values, shape (row, col), 0 and 1 at the ends of `span`, holes filled;
    `clipped`, `hole`: pixels of lamps at full scale, and all pixels whose value is filled, shape
    (row, col), None: none; `restored`: whether blooming was subtracted. Maps of noise have the rows
    and columns of `FUSION.map_level` for all finer levels.
    """

    band: Band
    value: Image
    span: Span
    levels: int
    clipped: Mask | None = None
    hole: Mask | None = None
    restored: bool = False

    @cached_property
    def law(self) -> NoiseLaw:
        """Noise law of the camera, estimated from the frame if unknown."""
        known = self.band.noise is not None and self.band.noise.is_known
        return self.band.noise if known and self.band.noise else estimate_noise(self.band.image)

    @cached_property
    def gains(self) -> tuple[NoiseGains, NoiseGains]:
        """Variances of the noise of the light and of the noise without it."""
        return noise_gains(self.law.blur_px, self.levels), noise_gains(
            self.law.read_blur_px, self.levels
        )

    @cached_property
    def powers(self) -> tuple["list[Image] | None", float]:
        """Noise power of the light from `FUSION.map_level` on (None: none), and without light,
        display units squared.

        The mean is the total light, blooming included, since subtraction leaves its noise.
        """
        scale = (self.span[1] - self.span[0]) ** 2
        dark = float(self.law.read_dn) ** 2 / scale
        if self.law.gain_dn == 0.0:
            return None, dark
        means = reduce_image(self.band.image, self.levels)[FUSION.map_level :]
        return [
            np.maximum(mean, np.float32(0.0)) * np.float32(self.law.gain_dn / scale)
            for mean in means
        ], dark

    def variance(self, level: int) -> Image | np.float32:
        """Return the variance of the coefficients of a level (the last one: base), display units
        squared.
        """
        shot, read = self.gains
        return self._variance(
            max(level - FUSION.map_level, 0), shot.detail[level], read.detail[level]
        )

    def _variance(self, at: int, shot: float, read: float) -> Image | np.float32:
        light, dark = self.powers
        flat = np.float32(dark * read)
        return flat if light is None else light[at] * np.float32(shot) + flat

    @cached_property
    def known(self) -> "list[Image] | None":
        """Share of known pixels in the kernel from `FUSION.map_level` on, squared; None: all are
        known.
        """
        if self.hole is None:
            return None
        shares = reduce_image((~self.hole).astype(np.float32), self.levels)[FUSION.map_level :]
        return [share * share for share in shares]

    @cached_property
    def pixel_variance(self) -> Image | np.float32:
        """Variance of a pixel's noise, display units squared, at `FUSION.map_level`."""
        shot, read = self.gains
        return self._variance(0, shot.pixel, read.pixel)

    @cached_property
    def bloom_sd(self) -> Image | None:
        """Standard deviation of the subtracted blooming b, common to a halo, display units, at
        `FUSION.map_level`.

        The amplitude of a halo has the relative deviation of its fit, and one by the structure of
        the ground around the lamp, s, which is not larger than the halo: s b/sqrt(s^2 + b^2), b
        over its median, the blooming of the ground.
        """
        if not self.restored or self.band.bloom is None:
            return None
        bloom = self.band.bloom
        lights = [source.light_dn_px for source in bloom.sources if source.has_known_signal]
        spread = max((float(np.std(light) / np.mean(light)) for light in lights), default=0.0)
        amount = np.asarray(bloom.blooming_dn, np.float32)
        lost = np.isnan(amount) if self.hole is None else np.isnan(amount) | self.hole
        amount = fill_holes(amount, lost) if lost.any() else amount
        small = cv2.resize(
            np.maximum(amount, np.float32(0.0)), self.map_shape[::-1], interpolation=cv2.INTER_AREA
        )
        small *= np.float32(1.0 / (self.span[1] - self.span[0]))
        blocks = cv2.resize(self.value, (8, 8), interpolation=cv2.INTER_AREA)
        ground = np.float32(FUSION.halo_ground_sd * blocks.std() + 1e-9)
        lamps = np.maximum(small - np.median(small), np.float32(0.0))
        return np.hypot(small * np.float32(spread), ground * lamps / np.hypot(ground, lamps))

    @property
    def map_shape(self) -> tuple[int, int]:
        """Rows and columns of `FUSION.map_level`."""
        rows, cols = (-(-size // 2**FUSION.map_level) for size in self.value.shape)
        return rows, cols


def display_plane(
    band: Band, *, bloom: bool, span: Span | None = None, min_max: bool = False
) -> Plane:
    """Return a band in display units.

    `bloom`: whether blooming is subtracted and clipped lamps are masked and filled; `span`: values
    shown as 0 and 1, of the band's unit, None: of the frame, with `min_max` its least and highest
    pixel, else `trusted_span`.
    """
    image, clipped, hole = band.image, None, band.no_data
    if bloom and band.clip is not None:
        clipped = lamp_pixels(image >= np.float32(FUSION.clip_share * band.clip))
    restored = bloom and band.bloom is not None
    if restored:
        assert band.bloom is not None
        image, lost = subtract_bloom(image, band.bloom)
        if lost is not None:
            clipped = lost if clipped is None else clipped | lost
    if clipped is not None:
        hole = clipped if hole is None else hole | clipped
    if hole is not None and hole.any():
        image = fill_holes(image, hole)
    else:
        hole = None
    if span is None:
        full = (
            hole
            if bloom
            else None
            if band.clip is None
            else band.image >= FUSION.clip_share * band.clip
        )
        span = cv2.minMaxLoc(image)[:2] if min_max else trusted_span(image, full)
    low, high = span
    if not high > low:
        raise BadInput(
            f"the span of band {band.name!r} must be wider than 0, got {low:g} to {high:g}"
        )
    value = cv2.addWeighted(image, 1.0 / (high - low), image, 0.0, -low / (high - low))
    return Plane(
        band=band,
        value=value,
        span=(low, high),
        levels=level_count(image.shape),
        clipped=clipped,
        hole=hole,
        restored=restored,
    )


def lamp_pixels(clipped: Mask) -> Mask | None:
    """Return the clipped regions of lamps with a border of 2 px; None without lamps.

    Single clipped pixels at the top of a halo are noise, not lamps: they keep their value.
    """
    if np.count_nonzero(clipped) < FUSION.lamp_px:
        return None
    seen = clipped.view(np.uint8)
    left, top, width, height = cv2.boundingRect(seen)
    part = np.s_[top : top + height, left : left + width]
    _, labels, stats, _ = cv2.connectedComponentsWithStats(seen[part], connectivity=8)
    lamps = np.zeros(clipped.shape, np.uint8)
    for number, (x, y, cols, rows, area) in enumerate(stats[1:], start=1):
        if area >= FUSION.lamp_px:
            own = np.s_[y : y + rows, x : x + cols]
            lamps[part][own] |= labels[own] == number
    if not lamps.any():
        return None
    side = 2 * FUSION.border_px + 1
    return cv2.dilate(lamps, np.ones((side, side), np.uint8)).view(bool)


def subtract_bloom(image: Image, bloom: BloomMap) -> tuple[Image, Mask | None]:
    """Return a frame without its blooming, and pixels that cannot be restored (None: none).

    Where a pixel has no signal its blooming is interpolated; where a source of unknown light may
    have put it, the pixel cannot be restored.
    """
    amount = np.asarray(bloom.blooming_dn, np.float32)
    unknown = np.isnan(amount)
    lost = None
    if unknown.any():
        amount = fill_holes(amount, unknown)
        if any(not source.has_known_signal for source in bloom.sources):
            # Most of the neighbourhood is unknown: not single pixels without signal.
            share = cv2.blur(unknown.astype(np.float32), (15, 15))
            lost = (share > 0.8) & (cv2.blur(image, (15, 15)) > np.median(image))
    return cv2.subtract(image, amount), lost


def trusted_span(image: Image, hole: Mask | None) -> Span:
    """Return the 1st and 99th percentile of means over 4 x 4 px outside a hole."""
    rows, cols = (size // 4 for size in image.shape)
    whole = np.s_[: 4 * rows, : 4 * cols]
    small = cv2.resize(image[whole], (cols, rows), interpolation=cv2.INTER_AREA)
    if hole is not None and hole.any():
        kept = (
            cv2.resize(hole[whole].astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
            == 0
        )
        small = small[kept] if np.count_nonzero(kept) > 0.02 * kept.size else small
    sample = small.ravel()[:: max(1, small.size // SPAN_SAMPLES)]
    ends = [
        round(percent / 100.0 * (sample.size - 1))
        for percent in (FUSION.low_percent, FUSION.high_percent)
    ]
    low, high = np.partition(sample, ends)[ends]
    return float(low), float(high)


def display_planes(
    bands: Sequence[Band],
    *,
    bloom: bool,
    spans: Mapping[str, Span] | None = None,
    min_max: bool = False,
) -> tuple[Plane, ...]:
    """Return two bands or more, of one shape and different names, in display units.

    `spans`: fixed spans by the name of the band, see `display_plane`.
    """
    if len(bands) < 2:
        raise BadInput(f"a fusion needs two bands or more, got {len(bands)}")
    if len({band.name for band in bands}) < len(bands):
        raise BadInput(
            f"bands must have different names, got {', '.join(band.name for band in bands)}"
        )
    if len({band.image.shape for band in bands}) > 1:
        sizes = ", ".join("{} {} x {}".format(band.name, *band.image.shape) for band in bands)
        raise BadInput(
            f"bands must have the same rows and columns, got {sizes}: register them to one grid "
            "first"
        )
    spans = spans or {}
    if unknown := spans.keys() - {band.name for band in bands}:
        raise BadInput(
            f"a span must be of one of the bands {', '.join(b.name for b in bands)}, got "
            f"{sorted(unknown)}"
        )
    return tuple(
        display_plane(band, bloom=bloom, span=spans.get(band.name), min_max=min_max)
        for band in bands
    )
