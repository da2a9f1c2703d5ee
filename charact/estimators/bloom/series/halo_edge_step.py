"""Rim of a halo: a step in the light of the rings, under any smooth curve.

    L(r) = sum_k c_k T_k(z) + a kink(r; R) + sum_j [p_j disc(r; R) + q_j rim(r; R)] * G(s_j)

within some px of the radius R of the edge, z the distance from its middle over the half width of
that window: the T_k, Chebyshev polynomials, are core, wing, glare and background; disc is 1 inside
R, rim 1/sqrt(1 - r^2/R^2) (electrons scattered back without loss), kink 1 - r^2/R^2; G(s) is a
Gaussian with the pixel's aperture. Blurs are mixtures of Gaussians, so that p_j, q_j >= 0 allow
every blur that is narrow against the window (non-negative least squares, Lawson and Hanson 1974).
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from charact.estimators.bloom.series.halo_models import FREQUENCIES, onto_nodes, pixel_of
from charact.estimators.bloom.series.likelihood import RingSeries
from charact.estimators.bloom.thresholds import RIM
from charact.transfer import spreads
from charact.transfer.tables import disc
from labdata import Array

# Standard deviations of the blurs, px.
BLURS_PX = np.geomspace(0.5, 5.0, 14)
# Widths of rings that with discs are rims of any other kind, px.
RIM_PX = np.array([3.0, 6.0])
# Blur of the kink, whose own hardly shows, px.
KINK_BLUR_PX = np.array([1.2])
# Half width of the window, px and fraction of the radius; rings next to the edge do not count as
# inside or outside.
HALF_WINDOW_PX, HALF_WINDOW, ON_EDGE_PX = 10.0, 0.5, 1.5
# Degrees of the smooth curve, and that of the curve without a step, which has as many terms.
DEGREES, DEGREE_ALONE = (2, 3, 4, 5), 6
# Degrees with discs alone, with the rim of a tube, and with any rim.
MODELS = [(degree, parts) for degree in DEGREES for parts in (1, 2, 2 + len(RIM_PX))]
# Distance from the most significant radius within which the edge is sought, px.
SEARCH_PX = 3.0


@dataclass(frozen=True, kw_only=True)
class Rim:
    """Edge of a halo in a series of rings.

    `significance`: by how much a step is more likely than a smooth curve alone, standard errors;
    `radius_px`, `probability`: radii of the edge and their probabilities, shape (radius,);
    `blur_px`: standard deviation of the blur of the edge, px; `stack_diameters`: diameter, its
    standard error and significance of each stack, shape (3, level), NaN without a window.
    """

    significance: float
    radius_px: Array
    probability: Array
    blur_px: float
    stack_diameters: Array

    @property
    def diameter_px(self) -> float:
        """Mean diameter, px."""
        return 2.0 * float(self.probability @ self.radius_px)

    def why_no_edge(self, core_px: float) -> str | None:
        """Why there is no halo with an edge, next to the blur of the core, px; None where there is
        one.
        """
        if self.significance < RIM.least_sd:
            return (
                f"no halo with an edge: the clearest step of the rings, {self.diameter_px:.0f} px "
                f"wide, stands {self.significance:.1f} standard errors above a smooth curve, fewer "
                f"than {RIM.least_sd:g}"
            )
        if self.blur_px > max(RIM.soft_px, RIM.soft_cores * core_px):
            return (
                f"no halo with an edge: the light falls to half of its step at a diameter of "
                f"{self.diameter_px:.1f} px, over a width (standard deviation) of "
                f"{self.blur_px:.1f} px"
            )
        return None

    def draws(self, count: int, seed: int) -> Array:
        """Return diameters spread as their probability, px, shape (draw,)."""
        at = (np.arange(count) + 0.5) / count
        radii = np.interp(at, np.cumsum(self.probability), self.radius_px)
        return 2.0 * np.random.default_rng([seed, 5]).permutation(radii)


Parts = tuple[Array, Array]


def parts_of(radius_px: Array, series: RingSeries, pitch_ratio: float) -> Parts:
    """Light at the nodes of edges at some radii: discs, then rims, of each blur, shape (radius, 2
    blur, node), and the kink, shape (radius, node).
    """
    u = 2.0 * np.pi * radius_px[:, None] * FREQUENCIES
    (flat, slope), area = disc(u), np.pi * radius_px[:, None] ** 2
    inner_px = np.maximum(radius_px[:, None] - RIM_PX[:, None, None], 0.0)
    rings = area * flat - np.pi * inner_px**2 * disc(2.0 * np.pi * inner_px * FREQUENCIES)[0]
    bare = np.stack([area * flat, area * np.sinc(u / np.pi), *rings], axis=1)[:, :, None]
    blurs = spreads.gaussian(FREQUENCIES, BLURS_PX**2) * pixel_of(pitch_ratio)
    steps = (bare * blurs).reshape(len(u), -1, FREQUENCIES.size)
    # Sonine: the transform of 1 - x^2 is 8 J2(u)/u^2, and the slope of the disc's is -2 J2(u)/u.
    kink = -2.0 * area * slope / u * spreads.gaussian(FREQUENCIES, KINK_BLUR_PX**2)
    nodes = onto_nodes(series.node_px)
    return steps @ nodes, kink * pixel_of(pitch_ratio) @ nodes


@dataclass(frozen=True, kw_only=True)
class RimWindow:
    """Rings of one stack about an edge.

    `position`: distance from the middle over the half width, shape (ring,); `whitener`; `data`,
    `averages`: ring means, and the matrix from nodes to them, whitened.
    """

    position: Array
    whitener: Array
    data: Array
    averages: Array

    def smooth(self, degree: int) -> Array:
        """Whitened terms of the smooth curve, shape (ring, term)."""
        return self.whitener @ np.polynomial.chebyshev.chebvander(self.position, degree)

    def chi2_alone(self) -> float:
        """Chi squared of a smooth curve without a step."""
        free, _ = np.linalg.qr(self.smooth(DEGREE_ALONE))
        return float(np.sum((self.data - free @ (free.T @ self.data)) ** 2))

    def chi2(self, parts: Parts, degree: int, blurs: int) -> tuple[Array, float]:
        """Chi squared with one of the first steps at each radius, and the blur of the best,
        px.
        """
        from scipy.optimize import nnls

        smooth, chi2, blur_px = self.smooth(degree), [], []
        for steps, kink in zip(*parts, strict=True):
            free, _ = np.linalg.qr(np.column_stack([smooth, self.averages @ kink]))
            design = np.column_stack([self.averages @ steps[:blurs].T, self.data])
            design -= free @ (free.T @ design)
            weight, residual = nnls(design[:, :-1], design[:, -1])
            chi2.append(residual**2)
            by_blur = weight.reshape(-1, len(BLURS_PX)).sum(axis=0)
            # That of the steepest slope: slopes of steps are in proportion to their 1/s.
            blur_px.append(by_blur.sum() / max(by_blur @ BLURS_PX**-1.0, 1e-300))
        return np.array(chi2), blur_px[int(np.argmin(chi2))]

    def freedom(self, degree: int) -> float:
        """Degrees of freedom besides curve, kink, and height, blur and radius of the step."""
        return max(len(self.data) - degree - 5.0, 1.0)


def window_of(series: RingSeries, level: int, middle_px: float) -> RimWindow | None:
    """Return the rings of a stack about a radius; None where too few are left on either side."""
    half_px, away = min(HALF_WINDOW_PX, HALF_WINDOW * middle_px), series.radius_px - middle_px
    usable = series.usable[level] & (np.abs(away) <= half_px)
    if min(np.sum(usable & (way * away > ON_EDGE_PX)) for way in (-1, 1)) < RIM.rings_per_side:
        return None
    data, covariance = series.data[level, usable], series.own_covariance[level][usable][:, usable]
    floor = (RIM.model_error * np.ptp(data)) ** 2
    whitener = np.linalg.inv(np.linalg.cholesky(covariance + floor * np.eye(len(data))))
    return RimWindow(
        position=away[usable] / half_px,
        whitener=whitener,
        data=whitener @ data,
        averages=whitener @ series.averages[level, usable],
    )


def rim_of(series: RingSeries, *, pitch_ratio: float, has_tube: bool) -> Rim | None:
    """Find the edge of a halo; None where no rings are left to look for it.

    `series`: ring means of all stacks; `pitch_ratio`: row pitch over column pitch; `has_tube`:
    whether the electrons of a tube may give the halo a rim; elsewhere the rim costs as much as its
    improbability.

    Notes
    -----
    Degrees of the curve, with and without a rim, are averaged with weights exp(-chi^2 / 2 - terms);
    chi^2 of a stack is divided by that of its best model per degree of freedom, and where the
    stacks disagree the radii spread by the root of their chi^2 (Birge 1932).
    """
    levels = range(len(series.labels))
    rim_cost = {1: 0.0, 2: 0.0 if has_tube else RIM.cost, 2 + len(RIM_PX): RIM.cost_of_any}
    scan_px = np.arange(SEARCH_PX + KINK_BLUR_PX[0], series.radius_px[-1] - SEARCH_PX)
    steps, kinks = parts_of(scan_px, series, pitch_ratio)
    gains = np.full((len(scan_px), len(levels)), np.nan)
    for at, middle_px in enumerate(scan_px):
        for level in levels:
            window = window_of(series, level, middle_px)
            if window is not None:
                parts = steps[at, None], kinks[at, None]
                of_step = float(window.chi2(parts, DEGREES[1], steps.shape[1])[0][0])
                scale = max(of_step / window.freedom(DEGREES[1]), 1.0)
                gains[at, level] = max(window.chi2_alone() - of_step, 0.0) / scale
    if np.isnan(gains).all():
        return None
    middle = int(np.argmax(np.nansum(gains, axis=1)))
    windows = {
        level: window
        for level in levels
        if (window := window_of(series, level, scan_px[middle])) is not None
    }
    centre_px, reach_px = scan_px[middle], SEARCH_PX
    for _ in range(2):
        radii = np.linspace(centre_px - reach_px, centre_px + reach_px, 31)
        fine = np.linspace(radii[0], radii[-1], 601)
        parts = parts_of(radii, series, pitch_ratio)
        fits = [
            [window.chi2(parts, degree, rims * len(BLURS_PX)) for window in windows.values()]
            for degree, rims in MODELS
        ]
        chi2 = np.array([[CubicSpline(radii, coarse)(fine) for coarse, _ in fit] for fit in fits])
        freedom = [[window.freedom(degree) for window in windows.values()] for degree, _ in MODELS]
        chi2 /= np.maximum((chi2.min(axis=2) / freedom).min(axis=0), 1.0)[:, None]
        cost = [2.0 * degree * len(windows) + rim_cost[rims] for degree, rims in MODELS]
        ln = -0.5 * (chi2.sum(axis=1) + np.array(cost)[:, None])
        probability = np.exp(ln - ln.max()).sum(axis=0)
        centre_px, sd_px = moments(fine, probability)
        best = int(np.argmax(ln.max(axis=1)))
        clear = gains[middle, list(windows)] > RIM.least_sd**2
        apart_px = float(np.ptp(fine[chi2[best, clear].argmin(axis=1)])) if clear.any() else 0.0
        reach_px = min(6.0 * float(sd_px) + 0.1 + apart_px, SEARCH_PX)
    alone = np.exp(-0.5 * (chi2[best] - chi2[best].min(axis=1, keepdims=True)))
    mean, sd = moments(fine, alone)
    sd = np.hypot(sd, RIM.error_px)
    apart = float(np.sum(((mean - np.average(mean, weights=sd**-2.0)) / sd) ** 2))
    wider = np.sqrt(max(apart / max(len(mean) - 1, 1), 1.0))
    stacks = np.full((3, len(levels)), np.nan)
    stacks[:, list(windows)] = 2.0 * mean, 2.0 * sd, np.sqrt(gains[middle, list(windows)])
    return Rim(
        significance=float(np.sqrt(np.nansum(gains[middle]))),
        radius_px=centre_px + wider * (fine - centre_px),
        probability=probability / probability.sum(),
        blur_px=float(fits[best][int(np.nanargmax(gains[middle, list(windows)]))][1]),
        stack_diameters=stacks,
    )


def moments(radius_px: Array, probability: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of radii by their probabilities, shape (.., radius)."""
    weight = probability / probability.sum(axis=-1, keepdims=True)
    mean = weight @ radius_px
    return mean, np.sqrt(np.maximum(weight @ radius_px**2 - mean**2, 0.0))
