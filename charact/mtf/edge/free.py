"""Edge method without a blur model: a line spread of any shape, as smooth as the data require.

The line spread in front of the pixel is a Gaussian process: smooth over a length, confined to a width and more or less
symmetric, all chosen by evidence. The profile is linear in it, so everything is in closed form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.blur_models.one_dimensional import BlurModel
from charact.mtf.edge.checks import FittedProfile
from charact.mtf.edge.fit.model_fit import EdgeFitter
from charact.mtf.edge.nonlinearity import (
    NO_CURVATURE_ESTIMATE,
    contrast,
    edge_ln_bayes_factor_nonlinear,
    nonlinearity_bias,
    remove_nonlinearity,
)
from charact.mtf.edge.pixels.prepare_edge import EdgeRefusal, PreparedEdge, fit_refusal
from charact.mtf.edge.pixels.profile import EVEN_PER_PX, UNEVEN_PER_PX, EdgeProfile, with_shading
from charact.mtf.edge.result import EdgeFitOutput, measure_by_fit, window_normalisation_note
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.known_transfer import KnownTransfer
from charact.mtf.mean_frame import Region
from charact.posterior.least_squares import weigh_by_evidence
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Result

Array = NDArray[np.float64]

METHOD = "edge-free"
# Priors of the illumination's slopes: a gradient looks like a long tail, and both are weighted by evidence.
SLOPES_PER_PX = (EVEN_PER_PX, UNEVEN_PER_PX)
# Widths over which the line spread is confined, px, and lengths over which it is smooth, fractions of the width.
WIDTHS_PX = 0.5 * 1.4 ** np.arange(12)
SMOOTHNESS = (0.5, 0.8, 1.2)
# Envelopes 1/(1 + (d/a)^2), and one that falls exponentially.
TAILS = ("short", "long")
# Size of the odd part of a line spread, fraction of the even part.
ASYMMETRY = (0.03, 0.3)


@register(
    "edge",
    METHOD,
    quantities=("mtf50", "mtf10", "mtf", "edge_angle"),
    scope=(
        "Straight edges tilted 1 to 45 degrees in any direction, step over 5 standard deviations of the pixel noise, "
        "60 rows and more, a line spread of any smooth shape that ends inside the region. Normalises to the light "
        "inside the region: what tails and halo carry beyond it is not seen. Noise costs it up to half as much again "
        "as a method that knows the form."
    ),
)
def edge_free(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge without a model of the point spread.

    Parameters
    ----------
    stack
        Frames of one edge; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge and its plateaus; None: the whole frame.
    context
        Seed and camera.

    Returns
    -------
    Result
        `mtf50`, `mtf10`, `mtf` at pinned frequencies and `edge_angle`, the curve "mtf", and the profile as evidence.

    Notes
    -----
    Prior covariance of the line spread at distances d and d': s^2 w(d) w(d') exp(-(d - d')^2 / (2 l^2)) with the
    envelope w(d) = 1/(1 + (d/a)^2) or exp(-sqrt(1 + (d/a)^2)), its odd part smaller by a factor; envelope, a, l and
    factor on a grid by marginal likelihood, in even light and in light that slopes, s by the step. Regularisation by
    evidence: MacKay, Neural Computation 4, 1992, 415. Light beyond the region is taken to lie anywhere between none and
    twice what the outer half of the region holds.
    """
    return measure_by_fit(METHOD, _fit, stack, region, context)


def _fit(edge: PreparedEdge, known: KnownTransfer, context: Context) -> EdgeFitOutput | EdgeRefusal:
    """Fit an edge, first as if its plateaus were even, then with the shading that is left over, if any."""
    profile = edge.profile
    fitter = EdgeFitter(profile, known)
    start = np.array([0.0, np.log(fitter.guess())])
    shift_px = float(fitter.fit(BlurModel(core="gaussian"), start, EVEN_PER_PX).point[0])
    spreads = LineSpreads(profile, known, SLOPES_PER_PX, shift_px)
    profile = with_shading(profile, profile.value - spreads.settings[0].model)
    if profile.shading_sd > 0:
        spreads = LineSpreads(profile, known, SLOPES_PER_PX, shift_px)
    edge, best = replace(edge, profile=profile), spreads.settings[0]
    posterior = spreads.posterior(context.seed)
    transfers = Transfers(places=spreads.places, draws=posterior.draws, known=known, seed=context.seed)
    half = np.argmax(transfers.mtf(np.linspace(0.005, 1.5, 300)).mean(axis=0) < 0.5) * 0.005 + 0.005
    refused = fit_refusal(edge, best.chi2, spreads.power, spreads.free, float(half))
    if refused:
        return refused
    odds = edge_ln_bayes_factor_nonlinear(edge, context)
    bias = nonlinearity_bias(NO_CURVATURE_ESTIMATE, contrast(profile), odds, context.seed, len(posterior.draws))
    return EdgeFitOutput(
        method=METHOD,
        edge=edge,
        fitted=FittedProfile(
            model=best.model, amplitude=best.amplitude, chi2=best.chi2, free=spreads.free - best.used_freedom
        ),
        response=spreads.response_curvature(posterior.draws),
        posterior=posterior,
        mtf=remove_nonlinearity(transfers.mtf, bias),
        settings={"width_px": round(best.width_px, 3), "tail": best.tail, "smooth_over_px": round(best.smooth_px, 3)},
        notes=(window_normalisation_note(profile),),
        doubt=known.doubt,
    )


@dataclass(frozen=True, kw_only=True)
class LineSpreadSetting:
    """The line spread under one width and one smoothness.

    Parameters
    ----------
    width_px, tail, smooth_px
        The envelope's width and kind, and the length over which the line spread is smooth.
    mean, root
        Line spread at the places and a root of its covariance, DN per px.
    model, amplitude
        Profile at the bins, DN; step, level and slopes, DN and DN per px.
    chi2, used_freedom
        Chi squared of the mean, and the number of parameters that the data determine.
    """

    width_px: float
    tail: str
    smooth_px: float
    mean: Array
    root: Array
    model: Array
    amplitude: Array
    chi2: float
    used_freedom: int


@dataclass(frozen=True, kw_only=True)
class _NormalEquations:
    """Normal equations of the line spread with levels and slopes projected out, under one prior of the slopes.

    Besides what line spreads and data put into levels and slopes, shape (level, place + 1), and ln of what
    marginalising these adds to the evidence.
    """

    left: Array
    right: Array
    power: float
    onto: Array
    log_evidence: float


@dataclass(frozen=True, kw_only=True)
class _Evaluation:
    """A setting with the factors of its posterior."""

    log_evidence: float
    width_px: float
    tail: str
    smooth_px: float
    basis: Array
    values: Array
    along: Array
    equations: _NormalEquations


class LineSpreads:
    """Line spreads of one profile.

    Parameters
    ----------
    profile
        The measured profile.
    known
        Aperture and video filter behind the line spread.
    slopes_sd_per_px
        Priors of the illumination's slopes, fraction of the step per px, equally probable.
    shift_px
        Position of the edge.

    Attributes
    ----------
    settings
        Settings that count, the most probable first.
    free, power
        Degrees of freedom, and chi squared of a level alone.
    """

    def __init__(
        self, profile: EdgeProfile, known: KnownTransfer, slopes_sd_per_px: Sequence[float], shift_px: float
    ) -> None:
        self._profile = profile
        self.places = _places(float(profile.gathered.half_width_px))
        root = np.linalg.inv(np.linalg.cholesky(profile.covariance))
        weights = _edge_of_line(self.places, profile.distance - shift_px, profile.spread_px, known)
        data, design = root @ profile.value, root @ np.concatenate([weights, profile.levels], axis=1)
        self._weights, self._root, self._data = weights, root, data
        self._lines, self._white_levels = np.split(design, [self.places.size], axis=1)
        self.free = len(data) - 1
        flat = self._white_levels[:, 0] / np.linalg.norm(self._white_levels[:, 0])
        self.power = float(data @ data - (flat @ data) ** 2)
        # The width first, for either kind of tail; then all that goes with widths around the best.
        tops = [
            [
                max(
                    (self._evaluate(own, float(w), tail, SMOOTHNESS[1], ASYMMETRY[0]) for w in WIDTHS_PX), key=_evidence
                )
                for tail in TAILS
            ]
            for own in map(self._project_levels, slopes_sd_per_px)
        ]
        best = max(one.log_evidence for of_slope in tops for one in of_slope)
        tried = [
            self._evaluate(top.equations, float(width), top.tail, smoothness, asymmetry)
            for of_slope in tops
            for top in of_slope
            if top.log_evidence > best - THRESHOLDS.competitive_setting
            for width in _widths_around(max(of_slope, key=_evidence).width_px)
            for smoothness in SMOOTHNESS
            for asymmetry in ASYMMETRY
        ]
        weights = weigh_by_evidence([one.log_evidence for one in tried], least=THRESHOLDS.min_setting_weight)
        self.shares = np.array([weight for _, weight in weights])
        self.settings = [self._setting(tried[index]) for index, _ in weights]

    def _project_levels(self, slope_sd_per_px: float) -> _NormalEquations:
        """Return lines and data with levels and slopes projected out, once for all settings."""
        lines, data, levels = self._lines, self._data, self._white_levels
        prior = self._profile.slopes_sd(slope_sd_per_px) ** -2.0
        outer = levels.T @ levels + np.diag([0.0, *prior])
        onto = np.asarray(np.linalg.solve(outer, levels.T @ np.concatenate([lines, data[:, None]], axis=1)), float)
        return _NormalEquations(
            left=lines.T @ lines - (lines.T @ levels) @ onto[:, :-1],
            right=lines.T @ data - (lines.T @ levels) @ onto[:, -1],
            power=float(data @ data - (data @ levels) @ onto[:, -1]),
            onto=onto,
            log_evidence=0.5 * float(np.sum(np.log(prior)) - np.linalg.slogdet(outer)[1]),
        )

    def _evaluate(
        self, equations: _NormalEquations, width: float, tail: str, smoothness: float, asymmetry: float
    ) -> _Evaluation:
        """Return evidence and posterior factors of one width, tail, smoothness and symmetry."""
        even, odd = _prior_root(self.places.tobytes(), width, tail, width * smoothness)
        prior = np.concatenate([even, asymmetry * odd], axis=1) * max(abs(self._profile.step), 1e-300)
        values, vectors = np.linalg.eigh(prior.T @ equations.left @ prior)
        values = np.maximum(values, 0.0)
        along = vectors.T @ (prior.T @ equations.right)
        chi2 = equations.power - float(np.sum(along**2 / (1.0 + values)))
        return _Evaluation(
            log_evidence=equations.log_evidence - 0.5 * chi2 - 0.5 * float(np.sum(np.log1p(values))),
            width_px=width,
            tail=tail,
            smooth_px=width * smoothness,
            basis=prior @ vectors,
            values=values,
            along=along,
            equations=equations,
        )

    def _setting(self, tried: _Evaluation) -> LineSpreadSetting:
        """Return the line spread of a setting."""
        onto = tried.equations.onto
        mean = np.asarray(tried.basis @ (tried.along / (1.0 + tried.values)), float)
        levels = onto[:, -1] - onto[:, :-1] @ mean
        model = self._weights @ mean + self._profile.levels @ levels
        residual = self._data - self._root @ model
        return LineSpreadSetting(
            width_px=tried.width_px,
            tail=tried.tail,
            smooth_px=tried.smooth_px,
            mean=mean,
            root=tried.basis / np.sqrt(1.0 + tried.values),
            model=model,
            amplitude=np.concatenate([[float(np.sum(mean * _cells(self.places)))], levels]),
            chi2=float(residual @ residual),
            used_freedom=round(float(np.sum(tried.values / (1.0 + tried.values)))),
        )

    def posterior(self, seed: int) -> Posterior:
        """Return draws of the line spread, each setting in proportion to its evidence."""
        rng = np.random.default_rng(seed)
        counts = np.maximum(np.round(ACCURACY.line_spread_draws * self.shares / self.shares.sum()).astype(int), 1)
        drawn = [
            one.mean + rng.standard_normal((count, one.root.shape[1])) @ one.root.T
            for one, count in zip(self.settings, counts, strict=True)
        ]
        names = tuple(f"line_spread_{place:+.2f}_px" for place in self.places)
        return Posterior(
            names=names, units=("DN/px",) * len(names), draws=np.concatenate(drawn), sampler="laplace", seed=seed
        )

    def response_curvature(self, draws: Array) -> tuple[float, float]:
        """Return the curvature of the response that explains asymmetric line spreads (draw, place), and its scatter.

        Notes
        -----
        Under a response u + c u (1 - u) of the edge spread u an even line spread l becomes l (1 + c (1 - 2 u)), and a
        shift d adds -d l': both are odd.
        """
        cells, mean = _cells(self.places), draws.mean(axis=0)
        even = 0.5 * (mean + mean[::-1])
        even = even / float(even @ cells)
        rise = np.cumsum(even * cells) - 0.5 * even * cells
        design = np.stack([even * (1.0 - 2.0 * rise), np.gradient(even, self.places)]) * np.sqrt(cells)
        odd = 0.5 * (draws - draws[:, ::-1]) / (draws @ cells)[:, None] * np.sqrt(cells)
        curvature = np.linalg.lstsq(design.T, odd.T, rcond=None)[0][0]
        return float(curvature.mean()), float(max(curvature.std(), 1e-9))


def _evidence(tried: _Evaluation) -> float:
    return tried.log_evidence


def _widths_around(width_px: float) -> Array:
    """Return the widths around one of those tried, px."""
    near = int(np.argmin(np.abs(WIDTHS_PX - width_px)))
    return np.asarray(WIDTHS_PX[max(near - 1, 0) : near + 2], float)


@dataclass(frozen=True, kw_only=True)
class Transfers:
    """MTFs of drawn line spreads, shape (draw, place), at places, px, seen through the known part of the transfer."""

    places: Array
    draws: Array
    known: KnownTransfer
    seed: int

    def mtf(self, frequency: Array) -> Array:
        """Return the MTF at frequencies, shape (f,) -> (draw, f), normalised to all the light."""
        cells = _cells(self.places)
        weighted = self.draws * cells
        # Between places the line spread runs straight, which is a factor sinc^2 where they are evenly spaced.
        phase = 2.0 * np.pi * np.outer(self.places, frequency)
        smooth = np.sinc(np.outer(cells, frequency)) ** 2
        real, imaginary = weighted @ (np.cos(phase) * smooth), weighted @ (np.sin(phase) * smooth)
        total = weighted.sum(axis=1)
        outer = weighted[:, np.abs(self.places) > 0.5 * self.places[-1]].sum(axis=1) / total
        most = np.random.default_rng(self.seed).uniform(0.0, ACCURACY.max_light_beyond, len(total))
        light = np.abs(total) * (1.0 + most * np.maximum(outer, 0.0))
        return np.hypot(real, imaginary) / light[:, None] * np.abs(self.known(frequency))


def _places(limit: float) -> Array:
    """Return places from -limit to limit, px: even near the edge, farther apart with the distance."""
    place, side = ACCURACY.node_spacing_px, []
    while place < limit:
        side.append(place)
        place += max(ACCURACY.node_spacing_px, ACCURACY.node_spacing * place)
    return np.concatenate([-np.array(side)[::-1], [0.0], side])


def _cells(places: Array) -> Array:
    """Return the length that each place stands for, px: half the way to both neighbours."""
    gaps = np.diff(places)
    return 0.5 * (np.concatenate([gaps[:1], gaps]) + np.concatenate([gaps, gaps[-1:]]))


def _edge_of_line(places: Array, distance: Array, spread_px: Array, known: KnownTransfer) -> Array:
    """Return the map (bin, place) from a piecewise straight line spread to the edge spread behind the known transfer.

    The known transfer's line spread is sampled at a tenth of a pixel.
    """
    step, size = 0.1, 512
    frequency = np.fft.rfftfreq(size, step)
    # The cell's own transform makes the samples the exact fractions of cells.
    line = np.fft.fftshift(np.fft.irfft(np.conj(known(np.maximum(frequency, 1e-9))) * np.sinc(frequency * step), size))
    at = np.asarray((np.arange(size) - size // 2) * step, float)
    kept = np.abs(at) < (12.0 if known.video else 1.2)
    kernel = line[kept] / line[kept].sum()
    gone, gaps = np.add.outer(distance, -at[kept]), np.diff(places)

    def smeared(shift_px: float) -> Array:
        """Return the integral of the line spread up to each distance, behind the kernel."""
        up_to = np.clip(((gone + shift_px)[..., None] - places[:-1]) / gaps, 0.0, 1.0)
        integral = np.zeros((*gone.shape, places.size))
        integral[..., 1:] += gaps * 0.5 * up_to**2
        integral[..., :-1] += gaps * (up_to - 0.5 * up_to**2)
        return np.asarray(np.tensordot(kernel, integral, axes=(0, 1)), float)

    # The mean over a bin: half its variance times the second derivative, by differences of a tenth of a pixel.
    middle = smeared(0.0)
    return middle + 0.5 * (spread_px[:, None] / step) ** 2 * (smeared(step) + smeared(-step) - 2.0 * middle)


@lru_cache(maxsize=128)
def _prior_root(places_bytes: bytes, width: float, tail: str, smooth: float) -> tuple[Array, Array]:
    """Return roots of the prior covariance of the even and the odd part of a line spread of unit area.

    Shapes (place, direction).
    """
    places = np.frombuffer(places_bytes)
    ratio = np.abs(places) / width
    envelope = 1.0 / (1.0 + ratio**2) if tail == "long" else np.exp(1.0 - np.sqrt(1.0 + ratio**2))
    envelope = envelope / float(envelope @ _cells(places))
    # Farther out the line spread is smooth over lengths that grow with the distance.
    length = smooth * np.sqrt(1.0 + (places / (3.0 * width)) ** 2)
    mean = 0.5 * (length[:, None] ** 2 + length**2)
    kernel = np.sqrt(length[:, None] * length / mean) * np.exp(-0.5 * (places[:, None] - places) ** 2 / mean)
    roots = []
    for sign in (1.0, -1.0):
        values, vectors = np.linalg.eigh(0.5 * (kernel + sign * kernel[:, ::-1]))
        kept = values > 1e-7 * values[-1]
        roots.append(envelope[:, None] * vectors[:, kept] * np.sqrt(values[kept]))
    return roots[0], roots[1]
