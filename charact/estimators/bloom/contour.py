"""Contour of a source at a signal threshold, fitted to the pixels next to it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.source_view import Polar, SourceView, mean_with_clipping
from labdata import Array

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
