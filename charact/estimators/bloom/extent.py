"""Bloom extent: area around a source at or above a signal threshold, by a contour fitted to the
adjacent pixels.
"""

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.source_view import (
    SECTORS,
    Polar,
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
# Signal over full scale above which rings are affected by clipping.
CUT_SHARE = 0.85
DIRECTIONS = np.linspace(-np.pi, np.pi, 72, endpoint=False)


@dataclass(frozen=True, kw_only=True)
class Contour:
    """Closed contour around a source.

    `radius`: radius in each of `DIRECTIONS`, column pitches, shape (direction,); `area`, `area_sd`:
    area inside and its standard error, square column pitches; `slope`: fall of the signal at the
    contour, DN per column pitch; `oval`, `oval_sd`: second harmonic of the squared
    radius over its mean, cosine and sine, and its standard error; dimensionless.
    """

    radius: Array
    area: float
    area_sd: float
    slope: float
    oval: tuple[float, float]
    oval_sd: float

    def inside(self, polar: Polar) -> NDArray[np.bool_]:
        """Pixels inside the contour, shape (row, col)."""
        angle = np.arctan2(polar.dy, polar.dx)
        return polar.radius <= np.interp(angle, DIRECTIONS, self.radius, period=2 * np.pi)

    def shift(self) -> tuple[float, float]:
        """Offset of the centre of the contour from the assumed one, rows and columns, column
        pitches.
        """
        down, along = (
            2.0 * float((self.radius * wave(DIRECTIONS)).mean()) for wave in (np.sin, np.cos)
        )
        return down, along


def fit_contour(
    view: SourceView, level: float, radius: float, sectors: NDArray[np.bool_], *, width: float = 1.0
) -> Contour | None:
    """Fit the contour at a threshold near a radius; None where the pixels there do not cross it.

    `view`: mean frame around the source, whose rings select the pixels near the threshold; `level`:
    threshold above dark, DN; `radius`: start radius, column pitches; `sectors`: sectors used;
    `width`: fraction of the usual annulus that is fitted.
    """
    polar, profile, noise, top = view.polar, view.profile, view.noise, view.top
    base = _surroundings(profile, level, radius)
    # Close to full scale the rings are clipped on one side and locate the threshold less well.
    nearest = 1.5 if width >= 1.0 and level > CUT_SHARE * top else 0.75
    pixels = _near(polar, profile, (level, base), radius, sectors, (width, nearest))
    value, x, y = view.signal[pixels], polar.dx[pixels] / radius, polar.dy[pixels] / radius
    start = np.interp(polar.radius[pixels], *profile)
    clear = start < top - 2.0 * float(view.mean_sd(top))
    bends = (clear & (x**2 + y**2 < 1.0)).sum() > 10
    terms = _terms(radius, len(value), bends=bends, round_only=not sectors.all())
    basis = _basis(x, y, terms)
    if len(value) < basis.shape[1] + 1:
        return None
    beta, threshold_height = np.zeros(basis.shape[1]), level - base
    linear = np.log(
        np.clip(start - base, 0.05 * threshold_height, 20.0 * threshold_height) / threshold_height
    )
    if clear.sum() > 2 * basis.shape[1]:
        # Clipped pixels are extrapolated from the others, since clipping resembles a plateau.
        lever = np.exp(linear[clear])[:, None]
        linear = (
            basis
            @ np.linalg.lstsq(lever * basis[clear], lever[:, 0] * linear[clear], rcond=None)[0]
        )
    weight, pixel_scores, working, normal = (
        np.ones(len(value)),
        np.ones(len(value)),
        linear,
        np.eye(len(beta)),
    )
    for _ in range(4):
        mean = threshold_height * np.exp(np.clip(linear, -4.0, 4.0))
        expected, unclipped_fraction = mean_with_clipping(base + mean, noise, top)
        lever = unclipped_fraction * mean
        variance = view.mean_sd(base + mean) ** 2
        weight = lever**2 / (variance + (0.05 * mean) ** 2)
        working = linear + (value - expected) * lever / np.maximum(
            lever**2, 1e-3 * threshold_height**2
        )
        weighted, pixel_scores = (
            basis * weight[:, None],
            weight**2 * variance / np.maximum(lever**2, 1e-3 * threshold_height**2),
        )
        normal = np.asarray(np.linalg.pinv(weighted.T @ basis, hermitian=True), np.float64)
        beta = normal @ (weighted.T @ working)
        linear = basis @ beta
    scores = basis * (weight * (working - linear))[:, None]
    # Noise correlated over an area is correlated along a line by its square root; scatter gives a
    # second estimate.
    noisy = (
        np.sqrt(noise.correlation_factor)
        * normal
        @ (basis * pixel_scores[:, None]).T
        @ basis
        @ normal
    )
    # Up to a radius of 2 px the contour is so short that its noise is that of an area.
    analytic = noise.correlation_factor * normal if radius <= 2.0 else noisy
    covariance = 0.5 * (normal @ _scatter(scores, noise.correlation_factor) @ normal + analytic)
    return _solve_contour(beta, covariance, radius, terms, threshold_height)


def _surroundings(profile: tuple[Array, Array], level: float, radius: float) -> float:
    """Signal just outside the contour, DN above dark: halo or background."""
    outer_ring = (profile[0] > radius) & (profile[0] < radius + 4.0)
    return float(np.clip(0.97 * profile[1][outer_ring].min(initial=level), 0.0, 0.8 * level))


def _near(
    polar: Polar,
    profile: tuple[Array, Array],
    levels: tuple[float, float],
    radius: float,
    sectors: NDArray[np.bool_],
    widths: tuple[float, float],
) -> NDArray[np.bool_]:
    """Pixels with a ring near the radius and a signal near the threshold."""
    (level, base), (width, nearest) = levels, widths
    radial_offset = np.abs(polar.radius - radius)
    pixels = (radial_offset < max(width * 2.0, width * 0.08 * radius, nearest)) & sectors[
        polar.sector
    ]
    ring_height = np.interp(polar.radius[pixels], *profile) - base
    logs = np.log(np.maximum(ring_height, 1e-3 * level) / (level - base))
    pixels[pixels] = (np.abs(logs) < width * 1.2) | (radial_offset[pixels] < nearest)
    return pixels


def _terms(radius: float, pixels: int, *, bends: bool, round_only: bool) -> tuple[str, ...]:
    """Select the terms that the pixels near a contour of this radius can determine."""
    if radius <= 2.0 or pixels < 20:
        return FEW if pixels >= 8 else FEW[:2]
    return FEW + (("tt",) if bends else ()) + (() if round_only else ("xx-yy", "2xy"))


FEW = ("1", "t", "x", "y")


def _basis(x: Array, y: Array, terms: tuple[str, ...]) -> Array:
    """Terms in the relative squared distance, (r/r0)^2 - 1, and in the direction, shape (..,
    term).
    """
    t = x**2 + y**2 - 1.0
    known = {
        "1": np.ones_like(x),
        "t": t,
        "x": x,
        "y": y,
        "tt": t**2,
        "xx-yy": x**2 - y**2,
        "2xy": 2 * x * y,
    }
    return np.stack([known[term] for term in terms], axis=-1)


def _scatter(scores: Array, correlation_factor: float) -> Array:
    """Covariance of the sum of scores of pixels with correlated noise."""
    spare = max(len(scores) - min(scores.shape[1], len(scores) - 1), 1)
    return scores.T @ scores * correlation_factor * len(scores) / spare


def _solve_contour(
    beta: Array, covariance: Array, radius: float, terms: tuple[str, ...], height_dn: float
) -> Contour | None:
    """Solve for the contour radius in every direction, and propagate the covariance of the
    coefficients; the threshold lies `height_dn` above the surroundings.
    """
    t = np.zeros(len(DIRECTIONS))
    bend = float(beta[terms.index("tt")]) if "tt" in terms else 0.0
    for _ in range(5):
        rows, fall = _along(t, terms), beta[1] + 2.0 * t * bend
        if not np.all(fall < -1e-3):
            return None
        t = np.clip(t - rows @ beta / fall, -0.75, 1.5)
    rows, fall = _along(t, terms), beta[1] + 2.0 * t * bend
    squared = radius**2 * (1.0 + t)
    shifts = -rows / fall[:, None] * radius**2
    mean = float(squared.mean())
    waves = [2.0 * wave(2 * DIRECTIONS) / mean for wave in (np.cos, np.sin)]
    toward = [
        np.pi * shifts.mean(axis=0),
        *((shifts * wave[:, None]).mean(axis=0) for wave in waves),
    ]
    sds = [float(np.sqrt(max(gradient @ covariance @ gradient, 0.0))) for gradient in toward]
    oval = (float((squared * waves[0]).mean()), float((squared * waves[1]).mean()))
    # Neglected higher harmonics may reach 5 % of the second.
    return Contour(
        radius=np.sqrt(squared),
        area=np.pi * mean,
        area_sd=float(np.hypot(sds[0], 0.05 * np.hypot(*oval) * np.pi * mean)),
        slope=float(-2.0 * np.mean(fall) / radius) * height_dn,
        oval=oval,
        oval_sd=float(np.hypot(sds[1], sds[2]) / np.sqrt(2.0)),
    )


def _along(t: Array, terms: tuple[str, ...]) -> Array:
    """Terms in every direction at squared distances t, shape (direction, term)."""
    radius = np.sqrt(np.maximum(1.0 + t, 0.05))
    return _basis(radius * np.cos(DIRECTIONS), radius * np.sin(DIRECTIONS), terms)


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
