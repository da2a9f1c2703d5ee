"""Scores of a fused picture against the truth of its scene: restoration, detection, rims of halos,
artefacts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from charact.fusion.bands import Mask, lamp_pixels
from charact.fusion.fused import Fused
from charact.fusion.scores import CONTROL_NOISE_DN, SOBEL_X, Score, sigmoid
from charact.fusion.thresholds import FUSION, TRUTH
from labdata import Array, BadInput, make_measurement
from labdata.file_io import require_regular


@dataclass(frozen=True, kw_only=True)
class FusionTruth:
    """What the cameras would see of a scene without noise and without the light of lamps.

    `bands`: frames without noise and blooming, the visible one first, any units, shape (band, row,
    col); `zones`: masks (row, col) by the name of a zone, "dark" among them, see `find_zones`;
    `objects`: number of the object that a pixel shows, 0: none, shape (row, col); `halos`: row, col
    and radius of each halo, px, shape (halo, 3).
    """

    bands: Array
    zones: Mapping[str, Mask]
    objects: NDArray[np.integer]
    halos: Array = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        shapes = {
            self.bands.shape[1:],
            self.objects.shape,
            *(mask.shape for mask in self.zones.values()),
        }
        if self.bands.ndim != 3 or len(shapes) > 1:
            raise BadInput(
                f"bands, zones and objects of a fusion truth must have one size, got "
                f"{sorted(shapes)}"
            )
        if not np.any(self.zones.get("dark", False)):
            raise BadInput(
                f"a fusion truth needs pixels of the zone 'dark', got zones {', '.join(self.zones)}"
            )

    @cached_property
    def display(self) -> Array:
        """Bands between their 1st and 99th percentile, shape (band, row, col)."""
        low, high = np.percentile(
            self.bands, (FUSION.low_percent, FUSION.high_percent), axis=(1, 2), keepdims=True
        )
        return (self.bands - low) / np.maximum(high - low, 1e-12)

    @cached_property
    def picture(self) -> Array:
        """Mean of the bands in display units, shape (row, col)."""
        return self.display.mean(axis=0)

    def cropped(self, region: tuple[int, int, int, int] | None) -> "FusionTruth":
        """Return the truth cut to ROW, COL, HEIGHT, WIDTH if it is larger; None: as it is."""
        if region is None or self.objects.shape == region[2:]:
            return self
        row, col, height, width = region
        cut = np.s_[row : row + height, col : col + width]
        return FusionTruth(
            bands=self.bands[(slice(None), *cut)],
            zones={name: mask[cut] for name, mask in self.zones.items()},
            objects=self.objects[cut],
            halos=self.halos - (row, col, 0),
        )

    def save(self, path: Path) -> None:
        """Write a compressed .npz of `bands`, `objects`, `halos`, and `zone_NAME` for every
        zone.
        """
        zones: dict[str, Any] = {f"zone_{name}": mask for name, mask in self.zones.items()}
        np.savez_compressed(path, bands=self.bands, objects=self.objects, halos=self.halos, **zones)

    @classmethod
    def load(cls, path: Path) -> "FusionTruth":
        """Read what `save` has written; anything else is BadInput."""
        require_regular(path, "the truth")
        try:
            with np.load(path) as file:
                zones = {
                    name[5:]: file[name].astype(bool)
                    for name in file.files
                    if name.startswith("zone_")
                }
                bands, objects, halos = (file[name] for name in ("bands", "objects", "halos"))
        except (OSError, ValueError, KeyError) as error:
            needed = "truth must be an .npz with bands, objects, halos and zones"
            raise BadInput(f"{needed}, got {path}: {error}") from None
        return cls(
            bands=np.asarray(bands, float),
            zones=zones,
            objects=objects,
            halos=np.asarray(halos, float),
        )


def find_zones(ground: Array, blooming: Array, clip: float) -> dict[str, Mask]:
    """Return the dark, halo and core zones of a visible frame.

    `ground`, `blooming`: mean light of the scene and of lamps with their halos, above dark, shape
    (row, col); `clip`: full scale above dark, in the same unit.
    """
    core = lamp_pixels(ground + blooming >= FUSION.clip_share * clip)
    core = np.zeros(ground.shape, bool) if core is None else core
    level = float(np.median(ground))
    return {
        "dark": (blooming < TRUTH.dark_share * level) & ~core,
        "halo": (blooming > TRUTH.halo_share * level) & ~core,
        "core": core,
    }


def with_restoration_errors(fused: Fused, rows: Sequence[Score]) -> Fused:
    """Return a fused picture with `fusion_error`, percent, in each zone of its scores `rows`."""
    method, errors = fused.measurements[0].method, "restoration_error_"
    added = [
        make_measurement(
            "fusion_error",
            "%",
            100.0 * row.value,
            None,
            None,
            method=method,
            stack=row.quantity.removeprefix(errors),
        )
        for row in rows
        if row.quantity.startswith(errors) and row.value is not None
    ]
    return replace(fused, measurements=(*fused.measurements, *added))


def truth_scores(
    fused: NDArray,
    truth: FusionTruth,
    bands: NDArray,
    *,
    rng: np.random.Generator,
    absent: tuple[NDArray, NDArray] | None = None,
) -> tuple[Score, ...]:
    r"""Return scores of a fused picture against the truth, with the controls of
    `charact.fusion.scores.score`.

    Parameters
    ----------
    fused
        Fused picture, ([frame,] row, col[, 3]); codes of 8 bits or display units 0 to 1.
    truth
        The scene without noise and blooming.
    bands
        The frames that were fused, shape ([frame,] band, row, col); the first band is the copy
        control.
    rng
        Generator of the noise control.
    absent
        `fused` and `bands` of the same scene without its objects, for detection; None: no rows of
        detection.

    Returns
    -------
    tuple of Score
        `restoration_error_ZONE`, `rim_step` (None without halos or objects), `artefact_share`; with
        `absent` for each object N `detectability_N` (d') and `efficiency_N`, and `efficiency` of
        all. Smaller is better for all but detection.

    Raises
    ------
    BadInput
        If pictures, bands and truth differ in size, or detection has too few frames.

    Notes
    -----
    - Restoration error: rms(a F + b - F*)/sd(F*) in a zone, F* the mean of the true bands in
      display units; a (of each colour) and b are fitted in the dark to pictures smoothed by 2 px;
      mean over frames.
    - Rim step: mean of the ring of 5 px inside a halo's rim less that of the ring outside in a F +
      b - F*, median over 24 sectors, largest over halos, over the median contrast of objects in F*.
    - Efficiency: d'^2 of `detectability2` of the fused picture over that of all bands before
      fusion. No fusion exceeds 1 but for the error of few frames: about 0.05 of 40.
    """
    pictures, frames = _planes(fused), np.atleast_3d(bands)
    frames = frames[None] if frames.ndim == 3 else frames
    for what, shape in (("fused picture", pictures.shape[2:]), ("bands", frames.shape[2:])):
        if shape != truth.picture.shape:
            raise BadInput(
                f"the {what} must have the size of the truth {truth.picture.shape}, got {shape}"
            )
    full = 255.0 if np.asarray(fused).dtype == np.uint8 else 1.0

    def noisy(planes: Array) -> Array:
        noise = rng.standard_normal((len(planes), 1, *planes.shape[2:]))
        return planes + CONTROL_NOISE_DN / 255.0 * full * noise

    columns = [
        _restoration(column_pictures, truth, scale)
        for column_pictures, scale in (
            (pictures, full),
            (noisy(pictures), full),
            (frames[:, :1], None),
        )
    ]
    if absent is not None:
        without, raw = _planes(absent[0]), np.asarray(absent[1], float)
        bound = _detection(frames, raw, truth)
        pairs = (pictures, without), (noisy(pictures), noisy(without)), (frames[:, :1], raw[:, :1])
        for column, pair in zip(columns, pairs, strict=True):
            detected = _detection(*pair, truth)
            for number, value in detected.items():
                column[f"detectability_{number}"] = float(np.sqrt(max(value, 0.0)))
                column[f"efficiency_{number}"] = (
                    value / bound[number] if bound[number] > 0.0 else None
                )
            column["efficiency"] = sum(detected.values()) / max(sum(bound.values()), 1e-12)
    return tuple(Score(name, "1", *(column[name] for column in columns)) for name in columns[0])


def _planes(fused: NDArray) -> Array:
    """Return pictures as (frame, plane, row, col)."""
    picture = np.asarray(fused, float)
    if picture.shape[-1] == 3:
        return np.moveaxis(picture if picture.ndim == 4 else picture[None], -1, 1)
    return picture[:, None] if picture.ndim == 3 else picture[None, None]


def _restoration(
    pictures: Array, truth: FusionTruth, full: float | None
) -> dict[str, float | None]:
    """Return restoration errors, rim step and artefact share; `full`: value shown as 1 (None: as
    fitted).
    """
    fitted = np.stack([fit_to_truth(planes, truth) for planes in pictures])
    error = fitted - truth.picture
    errors = [restoration_errors(picture_error, truth) for picture_error in error]
    scores: dict[str, float | None] = {
        f"restoration_error_{zone}": float(
            np.mean([error_of_zone[zone] for error_of_zone in errors])
        )
        if zone in errors[0]
        else None
        for zone in truth.zones
    }
    scores["rim_step"] = rim_step_of(error.mean(axis=0), truth)
    shown = fitted[:, None] if full is None else pictures / full
    codes = np.clip(255.0 * truth.display, 0.0, 255.0)
    shares = [
        artefact_share(codes[0], codes[1], np.clip(255.0 * picture, 0.0, 255.0))
        for picture in shown.mean(axis=1)
    ]
    scores["artefact_share"] = float(np.mean(shares))
    return scores


def restoration_errors(error: Array, truth: FusionTruth) -> dict[str, float]:
    """Return the rms of what a fitted picture differs from the truth over its spread, by the zones
    that have pixels.
    """
    zones = {zone: mask for zone, mask in truth.zones.items() if mask.any()}
    return {
        zone: float(np.sqrt(np.mean(error[mask] ** 2)) / truth.picture.std())
        for zone, mask in zones.items()
    }


def fit_to_truth(planes: Array, truth: FusionTruth) -> Array:
    """Return a F + b with the gain of each plane and the offset fitted to the truth in the dark,
    smoothed by 2 px.
    """
    dark = truth.zones["dark"]
    smooth = [
        cv2.GaussianBlur(np.asarray(plane, np.float64), (0, 0), 2.0)[dark]
        for plane in (*planes, truth.picture)
    ]
    columns = np.stack([*smooth[:-1], np.ones_like(smooth[0])], axis=1)
    *gains, offset = np.linalg.lstsq(columns, smooth[-1], rcond=1e-6)[0]
    return np.tensordot(gains, planes, axes=1) + offset


def rim_step_of(error: Array, truth: FusionTruth) -> float | None:
    """Return the largest step left at the rim of a halo over the contrast of an object; None where
    there is none.
    """
    contrasts = []
    for number in _numbers(truth):
        mask = (truth.objects == number).astype(np.uint8)
        object_grown, ground_grown = (
            cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * r + 1,) * 2))
            for r in TRUTH.ground_px
        )
        contrasts.append(
            abs(
                truth.picture[mask > 0].mean()
                - truth.picture[(ground_grown > 0) & (object_grown == 0)].mean()
            )
        )
    usable = np.logical_or.reduce([mask for zone, mask in truth.zones.items() if zone != "core"])
    rows, cols = np.indices(error.shape)
    steps, sectors, width = [], TRUTH.sectors, TRUTH.rim_px
    for row, col, radius in truth.halos:
        distance = np.hypot(rows - row, cols - col) - radius
        sector = ((np.arctan2(rows - row, cols - col) / (2.0 * np.pi) + 0.5) * sectors).astype(
            int
        ) % sectors
        sides = [
            usable & (distance >= -width) & (distance < 0.0),
            usable & (distance >= 0.0) & (distance < width),
        ]
        counts = [np.bincount(sector[side], None, sectors) for side in sides]
        inner_mean, outer_mean = (
            np.bincount(sector[side], error[side], sectors) / np.maximum(count, 1)
            for side, count in zip(sides, counts, strict=True)
        )
        if (filled := np.minimum(*counts) > width).any():
            steps.append(abs(float(np.median((inner_mean - outer_mean)[filled]))))
    return max(steps) / float(np.median(contrasts)) if steps and contrasts else None


def artefact_share(visible: Array, thermal: Array, fused: Array) -> float:
    """Return Nabf: share of gradients of the fused plane that neither band has, 0 to 1; planes in
    codes 0 to 255.

    Notes
    -----
    Where the fused gradient g (Sobel over 8, mirrored border) exceeds those of both bands, sum of
    (1 - Q_b) w_b over the sum of all w_b, w_b = g_b^1.5 (0.001 where g_b < 2), Q_b the root of the
    product of two sigmoids: of g_b/g, and of 2/pi | |difference of orientation| - pi/2 |.
    """
    strength, angle = _slope(fused)
    total, weight, added = np.zeros_like(strength), 0.0, np.ones(strength.shape, bool)
    for band in (visible, thermal):
        band_strength, band_angle = _slope(band)
        ratio = np.minimum(band_strength, strength) / np.maximum(
            np.maximum(band_strength, strength), 1e-12
        )
        alignment = np.abs(np.abs(band_angle - angle) - np.pi / 2.0) * 2.0 / np.pi
        preserved = np.sqrt(
            sigmoid(ratio, *TRUTH.artefact_strength)
            * sigmoid(alignment, *TRUTH.artefact_orientation)
        )
        band_weight = np.where(
            band_strength >= TRUTH.artefact_least, band_strength**1.5, TRUTH.artefact_weak
        )
        total += (1.0 - preserved) * band_weight
        weight += float(band_weight.sum())
        added &= strength > band_strength
    return float(total[added].sum()) / weight


def _slope(plane: Array) -> tuple[Array, Array]:
    x, y = (
        np.asarray(cv2.filter2D(plane, -1, kernel / 8.0), float) for kernel in (SOBEL_X, SOBEL_X.T)
    )
    return np.hypot(x, y), np.where(
        x == 0.0, np.pi / 2.0, np.arctan(y / np.where(x == 0.0, 1.0, x))
    )


def _numbers(truth: FusionTruth) -> list[int]:
    return [int(number) for number in np.unique(truth.objects) if number > 0]


def _detection(present: Array, absent: Array, truth: FusionTruth) -> dict[int, float]:
    """Return d'^2 of each object in pictures (frame, plane, row, col) with and without objects."""
    d2_of_object = {}
    for number in _numbers(truth):
        mask = truth.objects == number
        row, col = (round(index.mean()) for index in np.nonzero(mask))
        reach_px = TRUTH.window_px
        window = np.s_[
            max(0, row - reach_px) : row + reach_px + 1, max(0, col - reach_px) : col + reach_px + 1
        ]
        templates = object_channels(mask[window])
        outputs = [
            np.einsum("krc,fprc->fpk", templates, frames[(..., *window)])
            for frames in (present, absent)
        ]
        d2_of_object[number] = detectability2(
            *(output.reshape(len(output), -1) for output in outputs)
        )
    return d2_of_object


def object_channels(mask: Mask) -> Array:
    """Return six templates of an object, shape (6, row, col): blurred mask, outline, four
    Laguerre-Gauss functions.
    """
    soft = mask.astype(float)
    rows, cols = np.indices(mask.shape)
    weight = soft / soft.sum()
    away2 = (rows - (rows * weight).sum()) ** 2 + (cols - (cols * weight).sum()) ** 2
    x = 2.0 * np.pi * away2 / TRUTH.channel_px**2
    polynomials = (np.ones_like(x), 1 - x, 1 - 2 * x + x**2 / 2, 1 - 3 * x + 1.5 * x**2 - x**3 / 6)
    blurred, more_blurred = (
        np.asarray(cv2.GaussianBlur(soft, (0, 0), sigma), np.float64) for sigma in (1.0, 2.5)
    )
    return np.stack(
        [
            blurred,
            blurred - more_blurred,
            *(np.exp(-x / 2.0) * polynomial for polynomial in polynomials),
        ]
    )


def detectability2(present: Array, absent: Array) -> float:
    """Return the Hotelling d'^2 of channel outputs with and without an object, shapes (frame,
    channel).

    Notes
    -----
    d'^2 = difference' C^-1 difference of mean outputs, C the pooled covariance of n + m frames,
    without bias of few frames: (n + m - p - 3)/(n + m - 2) d'^2 - p (1/n + 1/m), p the rank of C
    (H. H. Barrett, K. J. Myers, Foundations of Image Science, 2004, ch. 14). Channels that depend
    on others, as a colour that is a mixture of two, count once.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> round(detectability2(rng.normal(2.0, 1.0, (500, 1)), rng.normal(0.0, 1.0, (500, 1))))
    4
    """
    n, m = len(present), len(absent)
    scatter = [
        (len(outputs) - 1) * np.atleast_2d(np.cov(outputs.T)) for outputs in (present, absent)
    ]
    covariance = sum(scatter) / max(n + m - 2, 1)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    independent = values > 1e-9 * values[-1]
    p = int(independent.sum())
    if n + m <= p + 3:
        needed = f"more than {p + 3} frames with and without objects"
        raise BadInput(f"detection with {p} channels needs {needed}, got {n + m}")
    difference = vectors.T[independent] @ ((present.mean(axis=0) - absent.mean(axis=0)) / scale)
    raw = float(np.sum(difference**2 / values[independent]))
    return raw * (n + m - p - 3) / (n + m - 2) - p * (1.0 / n + 1.0 / m)
