"""Shift of one band against another, with its interval.

It is measured on the logarithm of gradient magnitudes, which two bands have in common where their
contrasts are unlike or opposed, else by the mutual information of grey levels. Failure to register
is a value with its reason.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import stdtrit

from charact.fusion.thresholds import FUSION, REGISTRATION
from labdata import Array, Mask

Picture = NDArray[np.float32]
Pair = tuple[float, float]
Reason = Literal["no-structure", "too-few-pixels", "not-found", "beyond-limit"]

ECC_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-5)


@dataclass(frozen=True, kw_only=True)
class Residual:
    """Shift of the moving picture against the fixed one: fixed(x, y) corresponds to moving(x + dx,
    y + dy).
    """

    shift_px: Pair = (np.nan, np.nan)  # dx, dy
    sd_px: Pair = (np.nan, np.nan)  # standard errors by a jackknife over tiles
    tiles: int = 0
    significance: float = 0.0  # similarity over its standard error, dimensionless
    method: Literal["ecc", "mutual-information", "none"] = "none"
    reason: Reason | None = None  # why the pair is not in register

    @property
    def magnitude_px(self) -> float:
        """Length of the shift, px."""
        return float(np.hypot(*self.shift_px))

    @property
    def least_px(self) -> float:
        """Distance of the 95 % intervals from 0, px: a shift that is surely there."""
        return float(np.hypot(*(np.clip(0.0, *ends) for ends in self.interval_px(0.95))))

    @property
    def status(self) -> Literal["ok", "suspect", "refused"]:
        """Whether the pair is in register: suspect where 95 % intervals reach beyond half a
        pixel.
        """
        if self.reason is not None:
            return "refused"
        corner = max(
            np.hypot(x, y) for x in self.interval_px(0.95)[0] for y in self.interval_px(0.95)[1]
        )
        return "ok" if corner <= REGISTRATION.suspect_px else "suspect"

    def interval_px(self, level: float) -> tuple[Pair, Pair]:
        """Return the intervals of dx and dy of a coverage (0.68 or 0.95), px; Student's t over the
        tiles.
        """
        width = float(stdtrit(max(self.tiles - 1, 1), 0.5 + 0.5 * level))
        ends = [
            (shift - width * sd, shift + width * sd)
            for shift, sd in zip(self.shift_px, self.sd_px, strict=True)
        ]
        return ends[0], ends[1]


def residual_shift(fixed: Picture, moving: Picture, trusted: Mask | None = None) -> Residual:
    """Return the shift between two pictures of one size, with its standard errors.

    `fixed`, `moving`: pictures in any unit, shape (row, col), NaN marks pixels without data;
    `trusted`: pixels that count, None: all.

    Notes
    -----
    The feature is log(1 + g / mean g), g the gradient magnitude of Gaussian derivatives of 1.5 px.
    The best whole-pixel correlation starts `cv2.findTransformECC` (Evangelidis and Psarakis, IEEE
    PAMI 30, 2008). Where that does not converge, or its optimum is not significant, mutual
    information of 32 equally filled grey levels is used (Viola and Wells 1997). A parabola through
    nine shifts about the optimum gives the estimate; leaving out each tile of 32 px in turn gives
    the standard errors and the significance of the similarity.
    """
    mask = np.isfinite(fixed) & np.isfinite(moving) & (True if trusted is None else trusted)
    known = cv2.erode(mask.astype(np.uint8), np.ones((13, 13), np.uint8), borderValue=0).astype(
        bool
    )
    features = [_feature(picture, mask, known) for picture in (fixed, moving)]
    core = known.copy()
    reach = REGISTRATION.reach_px
    core[:reach] = core[-reach:] = core[:, :reach] = core[:, -reach:] = False
    tiles = _tile_numbers(core)
    if tiles.max(initial=-1) + 1 < REGISTRATION.least_tiles:
        return Residual(reason="too-few-pixels")
    if any(np.ptp(feature[core]) < 1e-6 for feature in features):
        return Residual(reason="no-structure")
    found = _by_correlation(features[0], features[1], core, tiles)
    if found is None:
        found = _by_information(_levels(fixed, mask), _levels(moving, mask), tiles)
    return Residual(reason="not-found") if found is None else _judged(found)


def _judged(residual: Residual) -> Residual:
    """Refuse a residual whose shift, or half the 95 % interval of whose shift, is beyond the
    limit.
    """
    widths = [0.5 * (high - low) for low, high in residual.interval_px(0.95)]
    beyond = max(residual.magnitude_px, *widths) > FUSION.refused_shift_px
    return replace(residual, reason="beyond-limit" if beyond else None)


def _feature(picture: Picture, mask: Mask, known: Mask) -> Picture:
    """Return the logarithm of the gradient magnitude, its mean where not known; 0 where a picture
    is constant.
    """
    if not known.any():
        return np.zeros_like(picture)
    smooth = _smooth(picture, mask, REGISTRATION.gradient_sigma_px)
    gradient = cv2.magnitude(
        cv2.Scharr(smooth, cv2.CV_32F, 1, 0), cv2.Scharr(smooth, cv2.CV_32F, 0, 1)
    )
    mean = float(gradient[known].mean())
    if not mean > 1e-4 * abs(
        float(np.median(picture[mask]))
    ):  # rounding of float32 leaves gradients of 1e-6 of the level in a constant picture
        return np.zeros_like(picture)
    feature = np.log1p(gradient / np.float32(mean))
    return np.where(known, feature, feature[known].mean())


def _smooth(picture: Picture, mask: Mask, sigma_px: float) -> Picture:
    """Return a picture blurred by a Gaussian, the median in place of pixels without data."""
    whole = np.where(mask, picture, np.float32(np.median(picture[mask])))
    return np.asarray(cv2.GaussianBlur(whole, (0, 0), sigma_px), np.float32)


def _tile_numbers(core: Mask) -> NDArray[np.intp]:
    """Return the number of the tile of each pixel that counts, -1 elsewhere; tiles less than a
    quarter full are out.
    """
    rows, columns = np.indices(core.shape) // REGISTRATION.tile_px
    number = rows * (columns.max() + 1) + columns
    full = np.bincount(number[core], minlength=number.max() + 1) >= REGISTRATION.tile_px**2 // 4
    return np.where(core & full[number], (np.cumsum(full) - 1)[number], -1)


def _by_correlation(
    fixed: Picture, moving: Picture, core: Mask, tiles: NDArray[np.intp]
) -> Residual | None:
    """Return the shift of the greatest correlation of features; None where there is none."""
    inner = slice(REGISTRATION.reach_px, -REGISTRATION.reach_px)
    weight = core[inner, inner].astype(np.float32)
    surface = cv2.matchTemplate(moving, fixed[inner, inner], cv2.TM_CCOEFF_NORMED, mask=weight)
    row, column = np.unravel_index(
        np.argmax(np.where(np.isfinite(surface), surface, -1.0)), surface.shape
    )
    warp = np.array(
        [[1.0, 0.0, column - REGISTRATION.reach_px], [0.0, 1.0, row - REGISTRATION.reach_px]],
        np.float32,
    )
    try:
        _, warp = cv2.findTransformECC(
            fixed, moving, warp, cv2.MOTION_TRANSLATION, ECC_STOP, core.astype(np.uint8), 1
        )
    except cv2.error:  # it raises where it does not converge
        return None
    own = tiles >= 0
    count = tiles.max() + 1

    def similarity(shift: Pair) -> Array:
        """Return the correlation without each tile, and last of all tiles, shape (tile + 1,)."""
        a, b = fixed[own].astype(np.float64), _shifted(moving, shift)[own].astype(np.float64)
        terms = (np.ones_like(a), a, b, a * a, b * b, a * b)
        sums = np.stack([np.bincount(tiles[own], values, count) for values in terms])
        n, a, b, aa, bb, ab = np.append(
            sums.sum(axis=1, keepdims=True) - sums, sums.sum(axis=1, keepdims=True), axis=1
        )
        return (n * ab - a * b) / np.sqrt((n * aa - a * a) * (n * bb - b * b))

    return _optimum(similarity, (float(warp[0, 2]), float(warp[1, 2])), "ecc")


def _levels(picture: Picture, mask: Mask) -> Picture:
    """Return a picture, smoothed by 1.5 px, as ranks in 0..32."""
    smooth = _smooth(picture, mask, 1.5)
    edges = np.quantile(smooth[mask], np.linspace(0.0, 1.0, REGISTRATION.bins + 1))
    return np.interp(smooth, edges, np.arange(REGISTRATION.bins + 1.0)).astype(np.float32)


def _by_information(fixed: Picture, moving: Picture, tiles: NDArray[np.intp]) -> Residual | None:
    """Return the shift of the greatest mutual information of grey levels; None where there is
    none.
    """
    own = tiles >= 0
    count = tiles.max() + 1
    first = fixed[own].astype(np.intp).clip(0, REGISTRATION.bins - 1) * REGISTRATION.bins

    def joint(shift: Pair) -> NDArray[np.intp]:
        return first + _shifted(moving, shift)[own].astype(np.intp).clip(0, REGISTRATION.bins - 1)

    def similarity(shift: Pair) -> Array:
        """Return the information without each tile, and last of all tiles, nats, shape (tile +
        1,).
        """
        sums = np.bincount(
            tiles[own] * REGISTRATION.bins**2 + joint(shift), minlength=count * REGISTRATION.bins**2
        ).reshape(count, REGISTRATION.bins, REGISTRATION.bins)
        return _information(np.append(sums.sum(axis=0) - sums, sums.sum(axis=0)[None], axis=0))

    reach = range(-REGISTRATION.reach_px, REGISTRATION.reach_px + 1, 2)
    grid = [(float(x), float(y)) for y in reach for x in reach]
    whole = [
        np.bincount(joint(shift), minlength=REGISTRATION.bins**2).reshape(
            1, REGISTRATION.bins, REGISTRATION.bins
        )
        for shift in grid
    ]
    best = grid[int(np.argmax(_information(np.concatenate(whole))))]
    return _optimum(similarity, best, "mutual-information")


def _information(counts: NDArray[np.intp]) -> Array:
    """Return the mutual information of joint histograms smoothed by one bin, nats, shape (..., bin,
    bin) -> (...).
    """
    smooth = gaussian_filter(counts.astype(np.float64), (0.0, 1.0, 1.0)) + 1e-9
    p = smooth / smooth.sum(axis=(-2, -1), keepdims=True)
    return np.sum(
        p * np.log(p / (p.sum(axis=-1, keepdims=True) * p.sum(axis=-2, keepdims=True))),
        axis=(-2, -1),
    )


def _shifted(moving: Picture, shift: Pair) -> Picture:
    """Return moving(x + dx, y + dy)."""
    warp = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(
        moving, warp, moving.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(moved, moving.dtype)


def _optimum(
    similarity, start: Pair, method: Literal["ecc", "mutual-information"]
) -> Residual | None:
    """Return the optimum of a similarity near a start, with the jackknife over tiles; None if not
    significant.
    """
    y, x = (np.mgrid[-1:2, -1:2] * REGISTRATION.step_px).reshape(2, 9)
    parabola = np.linalg.pinv(np.stack([np.ones(9), x, y, x * x, x * y, y * y], axis=1))
    centre = np.array(start)
    for _ in range(8):
        values = np.array(
            [similarity((centre[0] + dx, centre[1] + dy)) for dx, dy in zip(x, y, strict=True)]
        )
        _, bx, by, cxx, cxy, cyy = parabola @ values
        determinant = 4.0 * cxx * cyy - cxy**2
        if not (np.isfinite(values).all() and (determinant > 0.0).all() and (cxx < 0.0).all()):
            return None
        peaks = np.stack([cxy * by - 2.0 * cyy * bx, cxy * bx - 2.0 * cxx * by]) / determinant
        move = np.clip(peaks[:, -1], -2.0 * REGISTRATION.step_px, 2.0 * REGISTRATION.step_px)
        centre += move
        if np.abs(move).max() < 0.25 * REGISTRATION.step_px:
            break
    else:
        return None
    if np.abs(centre).max() > REGISTRATION.reach_px - 1.0:
        return None
    tiles = values.shape[1] - 1
    inflation = (tiles - 1.0) / np.sqrt(tiles)
    sd = inflation * np.std(peaks[:, :-1], axis=1)
    significance = float(values[4, -1] / (inflation * np.std(values[4, :-1]) + 1e-12))
    if significance < REGISTRATION.significant:
        return None
    return Residual(
        shift_px=(float(centre[0]), float(centre[1])),
        sd_px=(float(sd[0]), float(sd[1])),
        tiles=tiles,
        significance=significance,
        method=method,
    )
