"""Edge of a halo: a step in the light of the rings, under any smooth curve.

    L(r) = S(r) + sum_j [m_j fall(r; R) + n_j rise(r; R) + q_j rim(r; R) + o_j ring(r; R)] * G(s_j)

about the radius R of the edge: inside R, fall is 2 - r^2/R^2 and rise r^2/R^2, whose sum is a disc,
rim 1/sqrt(1 - r^2/R^2) (electrons scattered back without loss), ring 1 within some px of R; G(s) is
a Gaussian with the pixel's aperture, about as wide as the core. Blurs are mixtures of Gaussians, so
that weights from 0 on allow every blur of such a width (non-negative least squares, Lawson and
Hanson 1974).

S is core, wing, glare and background: far from the core Chebyshev polynomials of the distance from
the edge; about the core c + sum_k w_k exp(-r^2 / 2 s_k^2) with w_k >= 0, which is every Gaussian,
exponential and Moffat curve (Bernstein 1928) and has no edge. The rings of a clear pupil add
cos(2 pi f r) / r^3 and its sine.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from charact.estimators.bloom.series.halo_models import FREQUENCIES, onto_nodes, pixel_of
from charact.estimators.bloom.series.likelihood import RingSeries
from charact.estimators.bloom.thresholds import RIM
from charact.transfer import spreads
from charact.transfer.tables import disc
from labdata import Array

# Standard deviations of the blurs over that of the core, and where that is unknown, px.
BLURS, UNKNOWN_BLURS_PX = np.geomspace(0.7, 2.0, 5), np.geomspace(0.6, 4.0, 7)
# Widths of rings that with discs are rims of any other kind, px.
RIM_PX = np.arange(2.0, 10.0)
# Standard deviations of the Gaussians whose mixture is a smooth curve about the core, px.
SMOOTH_PX = np.geomspace(0.5, 25.0, 20)
# Half width of the window, px and fraction of the radius; one that ends nearer than `CORE_PX` to
# the source is about the core. Rings next to the edge do not count as inside or outside.
HALF_WINDOW_PX, LEAST_HALF_PX, OUTSIDE_PX, HALF_WINDOW = 10.0, 5.0, 8.0, 0.5
CORE_PX, ON_EDGE_PX = 6.0, 1.0
# Degrees of the smooth curve, and how many terms more it has without a step; a term needs some
# rings.
DEGREES, ALONE, RINGS_PER_TERM = (2, 3, 4, 5), 3, 4
# Degrees with discs alone, with the rim of a tube, and with any rim.
MODELS = [(degree, kinds) for degree in DEGREES for kinds in (2, 3, 3 + len(RIM_PX))]
# Distance from the most significant radius within which the edge is sought, and the least radius,
# px and standard deviations of the core.
SEARCH_PX, LEAST_RADIUS_PX, LEAST_RADIUS = 3.0, 5.0, 3.5
# Frequencies of a core's rings, cy/px, the rings where they show, px, and the degree of the curve
# besides them.
RINGING, RINGING_PX, RINGING_DEGREE = np.arange(0.27, 0.7, 0.004), (3.0, 35.0), 8


@dataclass(frozen=True, kw_only=True)
class Rim:
    """Edge of a halo in a series of rings.

    `significance`: by how much a step is more likely than a smooth curve alone, standard errors;
    `radius_px`, `probability`: radii of the edge and their probabilities, shape (radius,);
    `blur_px`, `core_px`: standard deviation of the blur of the edge, and of the core, px, NaN where
    every stack clips it; `stack_diameters`: diameter, its standard error and significance of each
    stack, shape (3, level), NaN without a window.
    """

    significance: float
    radius_px: Array
    probability: Array
    blur_px: float
    core_px: float
    stack_diameters: Array

    @property
    def diameter_px(self) -> float:
        """Mean diameter, px."""
        return 2.0 * float(self.probability @ self.radius_px)

    def why_no_edge(self) -> str | None:
        """Why there is no halo with an edge; None where there is one."""
        if self.significance < RIM.least_sd:
            return (
                f"no halo with an edge: the clearest step of the rings, {self.diameter_px:.0f} px "
                f"wide, stands {self.significance:.1f} standard errors above a smooth curve, fewer "
                f"than {RIM.least_sd:g}"
            )
        if self.blur_px > np.fmin(RIM.soft_px, RIM.soft_cores * self.core_px):
            return (
                f"no halo with an edge: the light falls to half of its step at a diameter of "
                f"{self.diameter_px:.1f} px, over a width (standard deviation) of "
                f"{self.blur_px:.1f} px or more"
            )
        return None

    def draws(self, count: int, seed: int) -> Array:
        """Return diameters spread as their probability, px, shape (draw,)."""
        at, rng = (np.arange(count) + 0.5) / count, np.random.default_rng([seed, 5])
        radii = np.interp(at, np.cumsum(self.probability), self.radius_px)
        return 2.0 * (rng.permutation(radii) + RIM.error_px * rng.standard_normal(count))


@dataclass(frozen=True, kw_only=True)
class EdgeShapes:
    """What the light of a series may be about an edge.

    `series`: ring means of all stacks; `pitch_ratio`: row pitch over column pitch; `core_px`:
    standard deviation of the core, px, NaN where it is unknown; `ringing`: frequency of its rings,
    cy/px, 0 without.
    """

    series: RingSeries
    pitch_ratio: float
    core_px: float
    ringing: float

    @cached_property
    def blurs_px(self) -> Array:
        """Standard deviations of the blurs of an edge, px."""
        return BLURS * self.core_px if np.isfinite(self.core_px) else UNKNOWN_BLURS_PX

    @cached_property
    def smooth(self) -> Array:
        """Gaussians about the source, their highest 1, at the nodes, shape (node, width)."""
        blurs = spreads.gaussian(FREQUENCIES, SMOOTH_PX**2) * pixel_of(self.pitch_ratio)
        return (blurs @ onto_nodes(self.series.node_px)).T * SMOOTH_PX**2

    def steps(self, radius_px: Array) -> Array:
        """Light at the nodes of edges at some radii: falling and rising discs, rims and rings, of
        each blur, shape (radius, kind x blur, node).
        """
        u = 2.0 * np.pi * radius_px[:, None] * FREQUENCIES
        (flat, slope), area = disc(u), np.pi * radius_px[:, None] ** 2
        # Sonine: the transform of 1 - x^2 is 8 J2(u)/u^2, and the slope of the disc's is -2
        # J2(u)/u.
        bulge = -2.0 * slope / np.maximum(u, 1e-9)
        inner_px = np.maximum(radius_px[:, None] - RIM_PX[:, None, None], 0.0)
        rings = area * flat - np.pi * inner_px**2 * disc(2.0 * np.pi * inner_px * FREQUENCIES)[0]
        discs = area * (flat + bulge), area * (flat - bulge), area * np.sinc(u / np.pi)
        blurs = spreads.gaussian(FREQUENCIES, self.blurs_px**2) * pixel_of(self.pitch_ratio)
        steps = np.stack([*discs, *rings], axis=1)[:, :, None] * blurs
        return steps.reshape(len(u), -1, FREQUENCIES.size) @ onto_nodes(self.series.node_px)

    def window(self, level: int, middle_px: float) -> "RimWindow | None":
        """Return the rings of a stack about a radius; None where too few are left on either
        side.
        """
        series = self.series
        inside_px = min(HALF_WINDOW_PX, max(LEAST_HALF_PX, HALF_WINDOW * middle_px))
        outside_px = max(inside_px, min(OUTSIDE_PX, middle_px))
        away = series.radius_px - middle_px
        usable = series.usable[level] & (away >= -inside_px) & (away <= outside_px)
        about_core = middle_px - inside_px < CORE_PX
        inner, outer = (np.sum(usable & (way * away > ON_EDGE_PX)) for way in (-1, 1))
        if inner < RIM.rings_per_side - about_core or outer < RIM.rings_per_side:
            return None
        data, radius_px = series.data[level, usable], series.radius_px[usable]
        whitener = whitener_of(series, level, usable, np.interp(-2.5, away[usable], data))
        averages = whitener @ series.averages[level, usable]
        position = (2.0 * away[usable] + inside_px - outside_px) / (inside_px + outside_px)
        degree = 0 if about_core else len(data) // RINGS_PER_TERM
        terms = np.polynomial.chebyshev.chebvander(position, degree + ALONE * (not about_core))
        rings = ring_terms(np.array([self.ringing] if self.ringing else []), radius_px)
        return RimWindow(
            data=whitener @ data,
            averages=averages,
            terms=whitener @ terms,
            degree=degree,
            rings=whitener @ np.concatenate([np.zeros((len(data), 0)), *rings], axis=1),
            smooth=averages @ self.smooth[:, : None if about_core else 0],
        )


def whitener_of(
    series: RingSeries, level: int, usable: NDArray[np.bool_], height_dn: float
) -> Array:
    """Return what makes the errors of usable rings independent and of unit variance: noise, and the
    error of pixels and centre, in proportion to their light and to that of a height, DN.
    """
    data, covariance = series.data[level, usable], series.own_covariance[level][usable][:, usable]
    light = np.hypot(data - data.min(), height_dn - data.min())
    floor = np.diag((RIM.model_error * light) ** 2)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance + floor)), np.float64)


def ring_terms(frequency: Array, radius_px: Array) -> Array:
    """Cosine and sine of a core's rings, shape (frequency, ring, 2)."""
    turn = 2.0 * np.pi * frequency[:, None] * radius_px
    return np.stack([np.cos(turn), np.sin(turn)], axis=-1) / radius_px[:, None] ** 3


@dataclass(frozen=True, kw_only=True)
class RimWindow:
    """Rings of one stack about an edge, whitened.

    `data`, `averages`: ring means, and the matrix from nodes to them; `terms`: those of the smooth
    curve, shape (ring, term), of which those up to `degree` stand under a step; `rings`: terms of
    the core's rings, shape (ring, 2 or 0); `smooth`: Gaussians of a smooth curve about the core,
    shape (ring, width), none elsewhere.
    """

    data: Array
    averages: Array
    terms: Array
    degree: int
    rings: Array
    smooth: Array

    def curve(self, degree: int) -> Array:
        """Terms under a step, shape (ring, term)."""
        return np.column_stack([self.terms[:, : min(degree, self.degree) + 1], self.rings])

    def fit(self, free: Array, shapes: Array) -> tuple[float, Array]:
        """Chi squared with free terms and shapes of weights from 0 on, and these weights."""
        from scipy.optimize import nnls

        basis, _ = np.linalg.qr(free)
        design = np.column_stack([shapes, self.smooth, self.data])
        norm = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        design = design / norm
        design -= basis @ (basis.T @ design)
        if design.shape[1] == 1:
            return float(design[:, 0] @ design[:, 0]) * norm[0] ** 2, np.zeros(0)
        weight, residual = nnls(design[:, :-1], design[:, -1], maxiter=30 * len(norm))
        return (residual * norm[-1]) ** 2, (weight / norm[:-1])[: shapes.shape[1]]

    def chi2_alone(self) -> float:
        """Chi squared of a smooth curve without a step."""
        degree = min(DEGREES[1], self.degree) + self.terms.shape[1] - 1 - self.degree
        free = np.column_stack([self.terms[:, : degree + 1], self.rings])
        return self.fit(free, self.data[:, None][:, :0])[0]

    def chi2(self, steps: Array, degree: int) -> tuple[Array, Array]:
        """Chi squared with steps, shape (radius, step, node), at each radius, and their weights at
        the best.
        """
        fits = [self.fit(self.curve(degree), self.averages @ light.T) for light in steps]
        chi2 = np.array([fit[0] for fit in fits])
        return chi2, fits[int(np.argmin(chi2))][1]

    def freedom(self, degree: int) -> float:
        """Degrees of freedom besides curve, and height, slope, blur and radius of the step."""
        terms = self.curve(degree).shape[1] + 4.0 + 3.0 * bool(self.smooth.size)
        return max(len(self.data) - terms, 1.0)


def core_px_of(series: RingSeries) -> float:
    """Standard deviation of a Gaussian with the half width of the core, pixel and ring taken off,
    px; NaN where every stack clips it.
    """
    whole = ~series.cut[:, :3].any(axis=1)
    light = series.light[int(np.argmax(np.where(whole, series.data[:, 0], -np.inf)))]
    outer = int(np.argmax(light < 0.5 * light[0]))
    if not whole.any() or outer == 0:
        return np.nan
    half_px = np.interp(
        -0.5 * light[0], -light[[outer - 1, outer]], series.radius_px[outer - 1 : outer + 1]
    )
    return float(np.sqrt(max(half_px**2 / (2.0 * np.log(2.0)) - 1.0 / 6.0, 0.25)))


def ringing_of(series: RingSeries) -> float:
    """Frequency of the rings of the core, cy/px, as behind a clear pupil; 0 where none stand out
    from all others.
    """
    gain, (first_px, last_px) = np.zeros(len(RINGING)), RINGING_PX
    for level in range(len(series.labels)):
        usable = series.usable[level] & (
            np.abs(series.radius_px - 0.5 * (first_px + last_px)) < 0.5 * (last_px - first_px)
        )
        radius_px = series.radius_px[usable]
        if len(radius_px) < 2 * (RINGING_DEGREE + 1):
            continue
        whitener = whitener_of(series, level, usable, float(series.data[level, usable].min()))
        position = np.linspace(-1.0, 1.0, len(radius_px))
        smooth = np.polynomial.chebyshev.chebvander(position, RINGING_DEGREE)
        wings = radius_px[:, None] ** -np.array([3.0, 4.0, 6.0])
        basis, _ = np.linalg.qr(whitener @ np.column_stack([smooth, wings]))
        residual = whitener @ series.data[level, usable]
        residual -= basis @ (basis.T @ residual)
        terms = whitener @ ring_terms(RINGING, radius_px)
        pairs, _ = np.linalg.qr(terms - basis @ (basis.T @ terms))
        fall = np.sum((residual @ pairs) ** 2, axis=-1)
        freedom = len(residual) - basis.shape[1]
        gain += fall / np.maximum((residual @ residual - fall) / freedom, 1.0)
    best = int(np.argmax(gain))
    stands_out = gain[best] > max(RIM.ringing_gain, RIM.ringing_ratio * float(np.median(gain)))
    return float(RINGING[best]) if stands_out and 2 < best < len(gain) - 3 else 0.0


def rim_of(series: RingSeries, *, pitch_ratio: float, has_tube: bool) -> Rim | None:
    """Find the edge of a halo; None where no rings are left to look for it.

    `series`: ring means of all stacks; `pitch_ratio`: row pitch over column pitch; `has_tube`:
    whether the electrons of a tube may give the halo a rim; elsewhere the rim costs as much as its
    improbability.

    Notes
    -----
    Degrees of the curve, with and without a rim, are averaged with weights exp(-chi^2 / 2 - terms);
    chi^2 of a stack is divided by that of its best model per degree of freedom, and where the
    stacks disagree the radii spread by the error of the mean of theirs.
    """
    levels, core_px = range(len(series.labels)), core_px_of(series)
    shapes = EdgeShapes(
        series=series, pitch_ratio=pitch_ratio, core_px=core_px, ringing=ringing_of(series)
    )
    # Where no core shows how wide the edge is blurred, a rim is as likely as a wider one.
    of_tube = has_tube or np.isnan(core_px)
    costs = (0.0, 0.0, RIM.cost_in_tube) if of_tube else (0.0, RIM.cost, RIM.cost_of_any)
    rim_cost = dict(zip((2, 3, 3 + len(RIM_PX)), costs, strict=True))
    first_px = np.fmax(LEAST_RADIUS_PX, LEAST_RADIUS * core_px)
    scan_px = np.arange(first_px, series.radius_px[-1] - SEARCH_PX)
    steps = shapes.steps(scan_px)
    gains = np.full((len(scan_px), len(levels)), np.nan)
    for at, middle_px in enumerate(scan_px):
        for level in levels:
            window = shapes.window(level, middle_px)
            if window is not None:
                of_step = float(window.chi2(steps[[at]], DEGREES[1])[0][0])
                scale = max(of_step / window.freedom(DEGREES[1]), 1.0)
                scale *= RIM.about_core**2 if window.smooth.size else 1.0
                gains[at, level] = max(window.chi2_alone() - of_step, 0.0) / scale
    if np.isnan(gains).all():
        return None
    middle = outermost(np.nansum(gains, axis=1))
    windows = {
        level: window
        for level in levels
        if (window := shapes.window(level, scan_px[middle])) is not None
    }
    centre_px, reach_px = scan_px[middle], SEARCH_PX
    smooth = np.array([window.chi2_alone() for window in windows.values()])
    for _ in range(2):
        radii = np.linspace(centre_px - reach_px, centre_px + reach_px, 31)
        fine = np.linspace(radii[0], radii[-1], 601)
        steps, blurs = shapes.steps(radii), len(shapes.blurs_px)
        fits = [
            [window.chi2(steps[:, : kinds * blurs], degree) for window in windows.values()]
            for degree, kinds in MODELS
        ]
        chi2 = np.array([[PchipInterpolator(radii, at)(fine) for at, _ in fit] for fit in fits])
        freedom = [[window.freedom(degree) for window in windows.values()] for degree, _ in MODELS]
        scale = np.maximum((chi2.min(axis=2) / freedom).min(axis=0), 1.0)
        chi2 /= scale[:, None]
        cost = [(2.0 * degree + rim_cost[kinds]) * len(windows) for degree, kinds in MODELS]
        ln = -0.5 * (chi2.sum(axis=1) + np.array(cost)[:, None])
        probability = np.exp(ln - ln.max()).sum(axis=0)
        centre_px, sd_px = moments(fine, probability)
        best = int(np.argmax(ln.max(axis=1)))
        gain = np.maximum(smooth / scale - chi2[best].min(axis=1), 0.0)
        clear = gain > RIM.least_sd**2
        apart_px = float(np.ptp(fine[chi2[best, clear].argmin(axis=1)])) if clear.any() else 0.0
        reach_px = min(6.0 * float(sd_px) + 0.1 + apart_px, SEARCH_PX)
    alone = np.exp(-0.5 * (chi2[best] - chi2[best].min(axis=1, keepdims=True)))
    mean, sd = moments(fine, alone)
    sd = np.hypot(sd, RIM.error_px)
    # Student's t of few stacks has the variance of one with two degrees fewer.
    few = (len(mean) - 1) / max(len(mean) - 3, 1)
    error = between_variance(mean, sd) * np.sum(sd**-4.0) / np.sum(sd**-2.0) ** 2
    wider = np.sqrt(1.0 + few * error / sd_px**2)
    stacks = np.full((3, len(levels)), np.nan)
    stacks[:, list(windows)] = 2.0 * mean, 2.0 * sd, np.sqrt(gain)
    weight = fits[best][int(np.argmax(gain))][1]
    by_blur = weight.reshape(-1, blurs).sum(axis=0)
    return Rim(
        significance=float(np.sqrt(np.nansum(gains[middle]))),
        radius_px=centre_px + wider * (fine - centre_px),
        probability=probability / probability.sum(),
        # That of the steepest slope: slopes of steps are in proportion to their 1/s.
        blur_px=float(by_blur.sum() / max(by_blur @ shapes.blurs_px**-1.0, 1e-300)),
        core_px=core_px,
        stack_diameters=stacks,
    )


def outermost(gain: Array) -> int:
    """Index of the outermost radius of several edges, as that of a hole and that of the halo."""
    clear = gain >= max(RIM.least_sd**2, RIM.other_edge**2 * gain.max())
    peaks = clear & (gain >= np.roll(gain, 1)) & (gain >= np.roll(gain, -1))
    return int(np.flatnonzero(peaks)[-1]) if peaks.any() else int(np.argmax(gain))


def between_variance(values: Array, sd: Array) -> float:
    """Variance of values beyond their errors (DerSimonian and Laird, Control. Clin. Trials 7, 177,
    1986).
    """
    if len(values) < 2:
        return 0.0
    weight = sd**-2.0
    excess = weight @ (values - np.average(values, weights=weight)) ** 2 - (len(values) - 1)
    spare = weight.sum() - weight @ weight / weight.sum()
    return max(float(excess), 0.0) / max(float(spare), 1e-300)


def moments(radius_px: Array, probability: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of radii by their probabilities, shape (.., radius)."""
    weight = probability / probability.sum(axis=-1, keepdims=True)
    mean = weight @ radius_px
    return mean, np.sqrt(np.maximum(weight @ radius_px**2 - mean**2, 0.0))
