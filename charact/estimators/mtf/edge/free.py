"""Edge method without a blur model: a line spread of any shape, as smooth as the data require.

The line spread in front of the pixel is a Gaussian process: smooth over a length, confined to a
width and more or less symmetric, all chosen by evidence. The profile is linear in it, so everything
is in closed form.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from operator import attrgetter

import numpy as np

from charact.estimators.mtf.edge.checks import FittedProfile
from charact.estimators.mtf.edge.pixels.prepare_edge import PreparedEdge, fit_refusal
from charact.estimators.mtf.edge.pixels.profile import (
    EVEN_PER_PX,
    UNEVEN_PER_PX,
    EdgeProfile,
    with_shading,
)
from charact.estimators.mtf.edge.result import (
    edge_result_of_fit,
    measure_by_fit,
    refuse_edge,
    window_normalisation_note,
)
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.known_transfer import KnownTransfer, known_transfer
from charact.estimators.mtf.mean_frame import Region
from charact.inference.gauss_newton import (
    Linearisation,
    least_squares,
    linearise_residual,
    weigh_by_evidence,
)
from charact.method import Context, register
from labdata import Array, FrameStack, Posterior, Result

METHOD = "edge-free"
_evidence = attrgetter("log_evidence")
# Priors of the illumination's slopes: a gradient looks like a long tail, and both are weighted by
# evidence.
SLOPES_PER_PX = (EVEN_PER_PX, UNEVEN_PER_PX)
# Widths over which the line spread is confined, px, and lengths over which it is smooth, fractions
# of the width.
WIDTHS_PX = 0.5 * 1.4 ** np.arange(12)
SMOOTHNESS = (0.5, 0.8, 1.2)
# Envelopes 1/(1 + (d/a)^2), and one that falls exponentially.
TAILS = ("short", "long")
# Size of the odd part of a line spread, fraction of the even part.
ASYMMETRY = (0.03, 0.3)


@register("edge", METHOD)
def edge_free(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge without a model of the point spread.

    Parameters and results are those of `charact.estimators.mtf.edge.parametric.edge_parametric`.

    Notes
    -----
    Prior covariance of the line spread at distances d and d': s^2 w(d) w(d') exp(-(d - d')^2 / (2
    l^2)) with the envelope w(d) = 1/(1 + (d/a)^2) or exp(-sqrt(1 + (d/a)^2)), its odd part smaller
    by a factor; envelope, a, l and factor on a grid by marginal likelihood, in even light and in
    light that slopes, s by the step. Regularisation by evidence: MacKay, Neural Computation 4,
    1992, 415. Light beyond the region is taken to lie anywhere between none and 1.4 times what the
    outer half of the region holds.
    """
    return measure_by_fit(METHOD, _fit, stack, region, context)


def _fit(edge: PreparedEdge, context: Context) -> Result:
    """Fit an edge, first as if its plateaus were even, then with the shading that is left over, if
    any.
    """
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    shift_px = edge_position_px(edge.profile)
    spreads = LineSpreads(edge.profile, known, shift_px)
    profile = with_shading(edge.profile, edge.profile.value - spreads.best_profile()[0])
    if profile.shading_sd > 0:
        spreads = LineSpreads(profile, known, shift_px)
    edge, best, (model, amplitude, chi2) = (
        replace(edge, profile=profile),
        spreads.settings[0],
        spreads.best_profile(),
    )
    posterior = spreads.posterior(context.seed)
    mtf = partial(_mtf, nodes=spreads.nodes, draws=posterior.draws, known=known, seed=context.seed)
    half = np.argmax(mtf(np.linspace(0.005, 1.5, 300)).mean(axis=0) < 0.5) * 0.005 + 0.005
    refused = fit_refusal(edge, chi2, spreads.power, spreads.free, float(half))
    if refused:
        return refuse_edge(METHOD, refused, context.seed)
    return edge_result_of_fit(
        METHOD,
        edge,
        FittedProfile(
            model=model, amplitude=amplitude, chi2=chi2, free=spreads.free - best.used_freedom
        ),
        spreads.response_curvature(posterior.draws),
        posterior,
        mtf,
        context,
        settings={
            "width_px": round(best.width_px, 3),
            "tail": best.tail,
            "smooth_over_px": round(best.smooth_px, 3),
        },
        notes=(window_normalisation_note(profile),),
        doubt=lambda frequency: np.hypot(known.doubt(frequency), ACCURACY.line_spread_doubt),
    )


def edge_position_px(profile: EdgeProfile) -> float:
    """Return the distance at which a smooth step fits a profile best, px.

    Notes
    -----
    level + slopes + step tanh((d - shift) / width), weighted by the noise of the bins; level and
    slopes of the light and step are linear and follow.
    """
    weight = 1.0 / np.sqrt(np.diag(profile.covariance))
    value, limit = profile.value * weight, ACCURACY.max_shift_px

    def linearise(point: Array) -> Linearisation:
        scaled = (profile.distance - point[0]) / np.exp(point[1])
        rise = np.tanh(scaled)
        linear = np.concatenate([rise[None], profile.levels.T]) * weight
        amplitude = np.linalg.lstsq(linear.T, value, rcond=None)[0]
        slope = -amplitude[0] * weight * (1.0 - rise**2)
        residual = value - amplitude @ linear
        jacobian = np.stack([slope / np.exp(point[1]), slope * scaled, *linear])
        return linearise_residual(residual, jacobian)

    optima = [
        least_squares(linearise, [0.0, ln_width], [[-limit, limit], [-3.0, 4.0]], iterations=12)
        for ln_width in (0.0, 1.6)
    ]
    return float(min(optima, key=lambda optimum: optimum.at.cost).point[0])


# Lines and data with levels and slopes projected out under one prior of the slopes: matrix, right
# side and power of the normal equations, what lines and data put into levels, and ln of what
# marginalising these adds to the evidence.
_NormalEquations = tuple[Array, Array, float, Array, float]


@dataclass(frozen=True, kw_only=True)
class LineSpreadSetting:
    """The line spread under one width and one smoothness.

    Parameters
    ----------
    log_evidence
        ln of its evidence.
    width_px, tail, smooth_px
        The envelope's width and kind, and the length over which the line spread is smooth.
    mean, root
        Line spread at the places and a root of its covariance, DN per px.
    levels
        Level and slopes of the light, DN and DN per px.
    used_freedom
        Number of parameters that the data determine.
    equations
        Where it comes from.
    """

    log_evidence: float
    width_px: float
    tail: str
    smooth_px: float
    mean: Array
    root: Array
    levels: Array
    used_freedom: int
    equations: _NormalEquations


class LineSpreads:
    """Line spreads of one profile.

    Parameters
    ----------
    profile
        The measured profile.
    known
        Aperture and video filter behind the line spread.
    shift_px
        Position of the edge.

    Attributes
    ----------
    settings, weights
        Settings that count, the most probable first, and their weights.
    free, power
        Degrees of freedom, and chi squared of a level alone.
    """

    def __init__(self, profile: EdgeProfile, known: KnownTransfer, shift_px: float) -> None:
        self._profile = profile
        self.nodes = _places(float(profile.gathered.half_width_px))
        self._root = np.linalg.inv(np.linalg.cholesky(profile.covariance))
        self._weights = _edge_of_line(
            self.nodes, profile.distance - shift_px, profile.spread_px, known
        )
        self._data = data = self._root @ profile.value
        design = self._root @ np.concatenate([self._weights, profile.levels], axis=1)
        lines, levels = np.split(design, [self.nodes.size], axis=1)
        self.free = len(data) - 1
        flat = levels[:, 0] / np.linalg.norm(levels[:, 0])
        self.power = float(data @ data - (flat @ data) ** 2)
        # The width first, for either kind of tail; then all that goes with widths around the best.
        tops = []
        for slope_sd_per_px in SLOPES_PER_PX:
            equations = self._project_levels(lines, levels, slope_sd_per_px)
            of_tails = [
                [self._evaluate(equations, w, tail, SMOOTHNESS[1], ASYMMETRY[0]) for w in WIDTHS_PX]
                for tail in TAILS
            ]
            tops.append([max(of_widths, key=_evidence) for of_widths in of_tails])
        min_evidence = (
            max(setting.log_evidence for of_slope in tops for setting in of_slope)
            - THRESHOLDS.competitive_setting
        )
        tried = []
        for of_slope in tops:
            nearest = int(np.argmin(np.abs(WIDTHS_PX - max(of_slope, key=_evidence).width_px)))
            widths = WIDTHS_PX[max(nearest - 1, 0) : nearest + 2]
            for top in of_slope:
                if top.log_evidence > min_evidence:
                    tried += [
                        self._evaluate(top.equations, *point)
                        for point in product(widths, [top.tail], SMOOTHNESS, ASYMMETRY)
                    ]
        weights = weigh_by_evidence(
            [setting.log_evidence for setting in tried], min_weight=THRESHOLDS.min_setting_weight
        )
        self.weights = np.array([weight for _, weight in weights])
        self.settings = [tried[index] for index, _ in weights]

    def _project_levels(
        self, lines: Array, levels: Array, slope_sd_per_px: float
    ) -> _NormalEquations:
        """Return lines and data with levels and slopes projected out, once for all settings."""
        data, prior = self._data, self._profile.slopes_sd(slope_sd_per_px) ** -2.0
        outer = levels.T @ levels + np.diag([0.0, *prior])
        onto = np.asarray(
            np.linalg.solve(outer, levels.T @ np.concatenate([lines, data[:, None]], axis=1)), float
        )
        return (
            lines.T @ lines - (lines.T @ levels) @ onto[:, :-1],
            lines.T @ data - (lines.T @ levels) @ onto[:, -1],
            float(data @ data - (data @ levels) @ onto[:, -1]),
            onto,
            0.5 * float(np.sum(np.log(prior)) - np.linalg.slogdet(outer)[1]),
        )

    def _evaluate(
        self,
        equations: _NormalEquations,
        width: float,
        tail: str,
        smoothness: float,
        asymmetry: float,
    ) -> LineSpreadSetting:
        """Return the line spread of one width, tail, smoothness and symmetry with its evidence."""
        normal, right, power, onto, log_evidence = equations
        even_root, odd = _prior_root(
            self.nodes.tobytes(), float(width), tail, float(width) * smoothness
        )
        prior = np.concatenate([even_root, asymmetry * odd], axis=1) * max(
            abs(self._profile.step), 1e-300
        )
        values, vectors = np.linalg.eigh(prior.T @ normal @ prior)
        values = np.maximum(values, 0.0)
        along, basis = vectors.T @ (prior.T @ right), prior @ vectors
        chi2 = power - float(np.sum(along**2 / (1.0 + values)))
        mean = np.asarray(basis @ (along / (1.0 + values)), float)
        return LineSpreadSetting(
            log_evidence=log_evidence - 0.5 * chi2 - 0.5 * float(np.sum(np.log1p(values))),
            width_px=float(width),
            tail=tail,
            smooth_px=float(width) * smoothness,
            mean=mean,
            root=basis / np.sqrt(1.0 + values),
            levels=onto[:, -1] - onto[:, :-1] @ mean,
            used_freedom=round(float(np.sum(values / (1.0 + values)))),
            equations=equations,
        )

    def best_profile(self) -> tuple[Array, Array, float]:
        """Return profile, DN, step, level and slopes, and chi squared of the most probable
        setting.
        """
        best = self.settings[0]
        model = self._weights @ best.mean + self._profile.levels @ best.levels
        residual = self._data - self._root @ model
        amplitude = np.concatenate([[float(np.sum(best.mean * _cells(self.nodes)))], best.levels])
        return model, amplitude, float(residual @ residual)

    def posterior(self, seed: int) -> Posterior:
        """Return draws of the line spread, each setting in proportion to its evidence."""
        rng = np.random.default_rng(seed)
        counts = np.maximum(
            np.round(ACCURACY.line_spread_draws * self.weights / self.weights.sum()).astype(int), 1
        )
        drawn = [
            setting.mean + rng.standard_normal((count, setting.root.shape[1])) @ setting.root.T
            for setting, count in zip(self.settings, counts, strict=True)
        ]
        names = tuple(f"line_spread_{node:+.2f}_px" for node in self.nodes)
        return Posterior(
            names=names,
            units=("DN/px",) * len(names),
            draws=np.concatenate(drawn),
            sampler="laplace",
            seed=seed,
        )

    def response_curvature(self, draws: Array) -> tuple[float, float]:
        """Return the curvature of the response that explains asymmetric line spreads (draw, place),
        and its scatter.

        Notes
        -----
        Under a response u + c u (1 - u) of the edge spread u an even line spread l becomes l (1 + c
        (1 - 2 u)), and a shift d adds -d l': both are odd.
        """
        cells, mean = _cells(self.nodes), draws.mean(axis=0)
        even_part = 0.5 * (mean + mean[::-1])
        even_part = even_part / float(even_part @ cells)
        rise = np.cumsum(even_part * cells) - 0.5 * even_part * cells
        design = np.stack(
            [even_part * (1.0 - 2.0 * rise), np.gradient(even_part, self.nodes)]
        ) * np.sqrt(cells)
        odd = 0.5 * (draws - draws[:, ::-1]) / (draws @ cells)[:, None] * np.sqrt(cells)
        curvature = np.linalg.lstsq(design.T, odd.T, rcond=None)[0][0]
        return float(curvature.mean()), float(max(curvature.std(), 1e-9))


def _mtf(frequency: Array, *, nodes: Array, draws: Array, known: KnownTransfer, seed: int) -> Array:
    """Return the MTF of line spreads (draw, place) behind the known transfer, normalised to all
    light, (draw, f).
    """
    cells = _cells(nodes)
    weighted = draws * cells
    # Between places the line spread is linear, which is a factor sinc^2 where they are evenly
    # spaced.
    phase = 2.0 * np.pi * np.outer(nodes, frequency)
    smooth = np.sinc(np.outer(cells, frequency)) ** 2
    real, imaginary = weighted @ (np.cos(phase) * smooth), weighted @ (np.sin(phase) * smooth)
    total = weighted.sum(axis=1)
    outer = weighted[:, np.abs(nodes) > 0.5 * nodes[-1]].sum(axis=1) / total
    beyond_ratio = np.random.default_rng(seed).uniform(0.0, ACCURACY.max_light_beyond, len(total))
    light = np.abs(total) * (1.0 + beyond_ratio * np.maximum(outer, 0.0))
    return np.hypot(real, imaginary) / light[:, None] * np.abs(known(frequency))


def _places(limit: float) -> Array:
    """Return places from -limit to limit, px: even near the edge, farther apart with the
    distance.
    """
    position, side = ACCURACY.node_spacing_px, []
    while position < limit:
        side.append(position)
        position += max(ACCURACY.node_spacing_px, ACCURACY.node_spacing * position)
    return np.concatenate([-np.array(side)[::-1], [0.0], side])


def _cells(nodes: Array) -> Array:
    """Return the length that each place stands for, px: half the way to both neighbours."""
    gaps = np.diff(nodes)
    return 0.5 * (np.concatenate([gaps[:1], gaps]) + np.concatenate([gaps, gaps[-1:]]))


def _edge_of_line(nodes: Array, distance: Array, spread_px: Array, known: KnownTransfer) -> Array:
    """Return the map (bin, place) from a piecewise straight line spread to the edge spread behind
    the known transfer.

    The known transfer's line spread is sampled at a tenth of a pixel.
    """
    step, size = 0.1, 512
    frequency = np.fft.rfftfreq(size, step)
    # The cell's own transform makes the samples the exact fractions of cells.
    line = np.fft.fftshift(
        np.fft.irfft(np.conj(known(np.maximum(frequency, 1e-9))) * np.sinc(frequency * step), size)
    )
    at = np.asarray((np.arange(size) - size // 2) * step, float)
    within_kernel = np.abs(at) < (12.0 if known.video else 1.2)
    kernel = line[within_kernel] / line[within_kernel].sum()
    gone, gaps = np.add.outer(distance, -at[within_kernel]), np.diff(nodes)

    def smeared(shift_px: float) -> Array:
        """Return the integral of the line spread up to each distance, behind the kernel."""
        up_to = np.clip(((gone + shift_px)[..., None] - nodes[:-1]) / gaps, 0.0, 1.0)
        integral = np.zeros((*gone.shape, nodes.size))
        integral[..., 1:] += gaps * 0.5 * up_to**2
        integral[..., :-1] += gaps * (up_to - 0.5 * up_to**2)
        return np.asarray(np.tensordot(kernel, integral, axes=(0, 1)), float)

    # The mean over a bin: half its variance times the second derivative, by differences of a tenth
    # of a pixel.
    middle = smeared(0.0)
    return middle + 0.5 * (spread_px[:, None] / step) ** 2 * (
        smeared(step) + smeared(-step) - 2.0 * middle
    )


@lru_cache(maxsize=128)
def _prior_root(places_bytes: bytes, width: float, tail: str, smooth: float) -> tuple[Array, Array]:
    """Return roots of the prior covariance of the even and the odd part of a line spread of unit
    area.

    Shapes (place, direction).
    """
    nodes = np.frombuffer(places_bytes)
    ratio = np.abs(nodes) / width
    envelope = 1.0 / (1.0 + ratio**2) if tail == "long" else np.exp(1.0 - np.sqrt(1.0 + ratio**2))
    envelope = envelope / float(envelope @ _cells(nodes))
    # Farther out the line spread is smooth over lengths that grow with the distance.
    length = smooth * np.sqrt(1.0 + (nodes / (3.0 * width)) ** 2)
    mean = 0.5 * (length[:, None] ** 2 + length**2)
    kernel = np.sqrt(length[:, None] * length / mean) * np.exp(
        -0.5 * (nodes[:, None] - nodes) ** 2 / mean
    )
    roots = []
    for sign in (1.0, -1.0):
        values, vectors = np.linalg.eigh(0.5 * (kernel + sign * kernel[:, ::-1]))
        significant = values > 1e-7 * values[-1]
        roots.append(envelope[:, None] * vectors[:, significant] * np.sqrt(values[significant]))
    return roots[0], roots[1]
