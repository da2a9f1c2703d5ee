"""Bloom extent: area around a source at or above a signal threshold, by a contour fitted to the
adjacent pixels.
"""

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from charact.estimators.bloom.contour import CUT_SHARE, Contour, fit_contour
from charact.estimators.bloom.source_view import (
    SECTORS,
    SourceView,
    mean_with_clipping,
)
from labdata import Array, Mask

DRAWS = 200
# A single contour is fitted if the 95 % range of crossings is narrower than this, px and fraction
# of the radius.
ONE_CONTOUR = (3.0, 0.1)
# Radius below which sectors are narrow, so that one pixel is significant, px.
NARROW_PX = 4.0
NORMAL = np.asarray([NormalDist().inv_cdf((n + 0.5) / DRAWS) for n in range(DRAWS)])


@dataclass(frozen=True, kw_only=True)
class Extent:
    """Region around a source at or above a threshold.

    `level_dn`: threshold, DN; `area`: square column pitches; `draws`: equal-area diameters, column
    pitches, shape (draw,); `region`: its pixels, shape (row, col); `contour`: contour of its round
    part; None where noise prevents a fit; `touches_border`: whether it extends to the border of the
    frame; `pulled`: whether some sectors extend beyond a round source.
    """

    level_dn: float
    area: float
    draws: Array
    region: Mask
    contour: Contour | None
    touches_border: bool
    pulled: bool

    @property
    def diameter_px(self) -> float:
        """Equal-area diameter, column pitches."""
        return float(2.0 * np.sqrt(self.area / np.pi))


def extent_at(
    view: SourceView, level_dn: float, *, level_sd: float = 0.0, seed: int = 0
) -> Extent | None:
    """Return the region around the source at or above a threshold; None where the source stays
    below it.

    `view`: mean frame around the source; `level_dn`, `level_sd`: threshold and its standard error,
    DN; `seed`: seed of the draws. Rings are averages over hundreds of pixels. A threshold within
    their noise (halo plateaus) has several possible crossings, which the draws cover.
    """
    level = level_dn - view.dark_dn
    visible = float(mean_with_clipping(np.array([level]), view.noise, view.top)[0][0])
    peak = float(view.signal[view.polar.radius < 1.5].max(initial=-np.inf))
    radius, profile = view.profile
    # A ring counts if 30 % of it lie inside the frame.
    usable = int(np.argmin(np.append(view.rings.inside_fraction, 0.0) > 0.3))
    if peak < visible or visible <= 0:
        return None
    first = _crossings(radius[:usable], profile[None, :usable], visible)[0]
    sectors = ~_find_pulled_sectors(view, visible, first)
    if sectors.sum() < SECTORS // 3 or np.isinf(first):
        return _extent_from_pixels(view, level_dn, visible)
    rng = np.random.default_rng(seed)
    sd = view.noise.sd(profile)
    sd = sd * np.clip((view.top - profile) / sd, 0.0, 1.0) / np.sqrt(view.frames)
    means = view.rings.draws(sd, DRAWS, rng, sectors)[:, :usable]
    shift = level_sd * rng.standard_normal(DRAWS)
    crossings = _crossings(radius[:usable], means, visible + shift[:, None])
    middle = float(np.median(crossings))
    # Draws without a crossing are infinite, which interpolation does not support.
    low, high = np.quantile(crossings, [0.025, 0.975], method="nearest")
    contour = None
    if high - low < max(ONE_CONTOUR[0], ONE_CONTOUR[1] * middle):
        contour = _refine_contour(view, level, max(middle, 0.7), sectors)
    if contour is None:
        return (
            _extent_from_crossings(view, level_dn, crossings)
            if sectors.all()
            else _extent_from_pixels(view, level_dn, visible)
        )
    return _extent_from_contour(view, level_dn, visible, contour, sectors, level_sd)


def contour_at(view: SourceView, level: float) -> tuple[Contour, bool] | None:
    """Return the contour at a threshold above dark, DN, and whether it covers all sectors; None
    without a contour.
    """
    visible = float(mean_with_clipping(np.array([level]), view.noise, view.top)[0][0])
    first = _crossings(view.profile[0], view.profile[1][None], visible)[0]
    if np.isinf(first):
        return None
    sectors = ~_find_pulled_sectors(view, visible, first)
    if sectors.sum() < SECTORS // 3:
        return None
    contour = fit_contour(view, level, max(first, 0.7), sectors)
    return None if contour is None else (contour, bool(sectors.all()))


def _crossings(radius: Array, means: Array, level: Array | float) -> Array:
    """Radius where each profile first falls below a threshold, shape (draw,); inf where it never
    does.
    """
    level = np.broadcast_to(np.asarray(level, float).reshape(-1, 1), (len(means), 1))
    is_below = means < level
    never = ~is_below.any(axis=1)
    last = np.argmax(is_below, axis=1)
    rows, inner = np.arange(len(means)), np.maximum(last - 1, 0)
    logs = [
        np.log(np.maximum(means[rows, at], 1e-3) / level[:, 0].clip(1e-3)) for at in (inner, last)
    ]
    step_fraction = np.clip(logs[0] / np.maximum(logs[0] - logs[1], 1e-9), 0.0, 1.0)
    out = radius[inner] + step_fraction * (radius[last] - radius[inner])
    return np.where(never, np.inf, np.where(last == 0, 0.7 * radius[0], out))


def _component(view: SourceView, region: Mask) -> Mask:
    """The connected part of a mask that contains the source."""
    from scipy import ndimage

    labels = np.asarray(ndimage.label(region)[0])  # pyright: ignore[reportIndexIssue]
    source_labels = labels[(view.polar.radius < 2.5) & region]
    return (
        labels == np.bincount(source_labels).argmax()
        if len(source_labels)
        else np.zeros_like(region)
    )


def _find_pulled_sectors(view: SourceView, visible: float, first: float) -> Mask:
    """Find the sectors in which the region extends clearly beyond its rings, shape (sector,)."""
    if np.isinf(first):
        return np.zeros(SECTORS, bool)
    clear_level = visible + 2.0 * float(view.mean_sd(visible))
    picture = view.smooth if first > NARROW_PX else view.signal
    region = _component(view, picture >= min(clear_level, 0.5 * (visible + view.top)))
    margin = max(min(2.0, 0.4 * first), 0.1 * first, 1.0)
    pixels = np.bincount(
        view.polar.sector[region & (view.polar.radius > first + margin)], minlength=SECTORS
    )
    pulled = (pixels >= (3 if first > NARROW_PX else 1)) | _along_columns(
        view, visible, first + margin
    )
    # A streak extends into the adjacent sectors.
    return pulled | (np.roll(pulled, 1) & (pixels > 0)) | (np.roll(pulled, -1) & (pixels > 0))


def _along_columns(view: SourceView, visible: float, outer_radius: float) -> Mask:
    """Sectors with columns near the source that are mostly above the threshold, shape (sector,)."""
    out = np.zeros(SECTORS, bool)
    for col in np.flatnonzero(np.abs(view.polar.dx[0]) < 6.0):
        for side in (-1.0, 1.0):
            rows = (side * view.polar.dy[:, col] > 0) & (view.polar.radius[:, col] > outer_radius)
            if rows.any() and np.median(view.signal[rows, col]) >= visible:
                out[view.polar.sector[rows, col]] = True
    return out


def _refine_contour(view: SourceView, level: float, radius: float, sectors: Mask) -> Contour | None:
    """Fit the contour at the rings' crossing, then again at the radius of the fit."""
    contour, width = None, 1.0
    for _ in range(4):
        fitted = fit_contour(view, level, radius, sectors, width=width)
        if fitted is None:
            return contour
        again = float(np.sqrt(fitted.area / np.pi))
        # If the radius is known to 0.04 px, half the annulus suffices and suits a polynomial
        # better.
        narrow = width == 1.0 and fitted.area_sd / (2.0 * np.pi * again) < 0.04
        if width < 1.0 and contour is not None:
            # A quarter of the difference between the two annuli is a systematic uncertainty.
            area_difference = 0.25 * abs(fitted.area - contour.area)
            fitted = replace(fitted, area_sd=float(np.hypot(fitted.area_sd, area_difference)))
        settled = abs(again - radius) < 0.05 and not narrow
        contour, radius, width = fitted, again, 0.5 if narrow else width
        if settled or (width < 1.0 and not narrow):
            break
    return contour


def _extent_from_contour(
    view: SourceView,
    level_dn: float,
    visible: float,
    contour: Contour,
    sectors: Mask,
    level_sd: float,
) -> Extent:
    """Area inside the contour, with pixels counted in the sectors that extend beyond it."""
    within_contour = contour.inside(view.polar)
    area, variance, region = contour.area, contour.area_sd**2, within_contour
    if not sectors.all():
        pulled = ~sectors[view.polar.sector]
        parts = _component(view, within_contour | (view.signal >= visible))
        extra = np.where(pulled & ~within_contour, parts, 0.0)
        area += float(extra.sum()) * view.polar.row_pitch
        noise = float(view.mean_sd(visible))
        open_ = (extra > 0) & (np.abs(view.signal - visible) < noise)
        variance += view.polar.row_pitch**2 * (
            0.25 * open_.sum() + (0.5 * (extra > 0).sum() ** 0.5) ** 2
        )
        region = within_contour | (extra > 0.5)
    radius = float(np.sqrt(area / np.pi))
    # Model error of a contour, px; larger where clipping hides the inner side.
    off = 0.0225 if level_dn - view.dark_dn > CUT_SHARE * view.top else 0.004
    sd = np.hypot(np.sqrt(variance), 2.0 * np.pi * radius * off)
    level_sd_px2 = 2.0 * np.pi * radius * level_sd / max(contour.slope, 1e-6)
    areas = area + float(np.hypot(sd, level_sd_px2)) * NORMAL
    return Extent(
        level_dn=level_dn,
        area=float(area),
        draws=2.0 * np.sqrt(np.maximum(areas, 0.0) / np.pi),
        region=region,
        contour=contour,
        touches_border=_touches(region),
        pulled=not sectors.all(),
    )


def _extent_from_crossings(view: SourceView, level_dn: float, crossings: Array) -> Extent:
    """Extent at a threshold within the noise of a plateau, from the crossings of the rings
    alone.
    """
    finite = np.minimum(crossings, float(view.rings.radius[-1]))
    radius = float(np.median(finite))
    return Extent(
        level_dn=level_dn,
        area=np.pi * radius**2,
        draws=2.0 * finite,
        region=view.polar.radius <= radius,
        contour=None,
        touches_border=bool(np.isinf(crossings).mean() > 0.025),
        pulled=False,
    )


def _extent_from_pixels(view: SourceView, level_dn: float, visible: float) -> Extent | None:
    """Extent of a region that is not round, or as large as the frame, by counting pixels."""
    noise = float(view.mean_sd(visible))
    # Smoothing preserves faint contours, but would blur sharp narrow streaks.
    picture = view.signal if noise < 0.12 * visible else view.smooth
    parts = _component(view, picture >= visible)
    if not parts.any():
        return None
    low, high = (float(_component(view, picture >= visible + off).sum()) for off in (noise, -noise))
    pixels, region = float(parts.sum()), parts >= 0.5
    spread = np.hypot(0.5 * (high - low), np.sqrt(pixels)) * view.polar.row_pitch
    area = pixels * view.polar.row_pitch
    areas = area + spread * NORMAL
    return Extent(
        level_dn=level_dn,
        area=area,
        draws=2.0 * np.sqrt(np.maximum(areas, 0.0) / np.pi),
        region=region,
        contour=None,
        touches_border=_touches(region),
        pulled=True,
    )


def _touches(region: Mask) -> bool:
    """Whether a region meets the border of the frame."""
    return bool(region[0].any() or region[-1].any() or region[:, 0].any() or region[:, -1].any())
