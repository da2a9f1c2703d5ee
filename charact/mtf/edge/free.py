"""The model-free method for edges: a line spread of any shape, as smooth as the data ask for, and no parametric tail.

The line spread in front of the pixel is a Gaussian process: smooth over a length, confined to a width and more or less
symmetric, all of which the data choose by their evidence. The profile is linear in it, so that everything is in closed
form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.blur_models.one_dimensional import BlurModel
from charact.mtf.edge import checks as edge_checks
from charact.mtf.edge.fit.model_fit import BlurModelFitter
from charact.mtf.edge.nonlinearity import (
    NO_CURVATURE_ESTIMATE,
    contrast,
    edge_ln_bayes_factor_nonlinear,
    nonlinearity_bias,
    remove_nonlinearity,
)
from charact.mtf.edge.pixels.prepare_edge import EdgeRefusal, PreparedEdge, blur_refusal, edge_refusal, prepare_edge
from charact.mtf.edge.pixels.profile import EVEN_PER_PX, UNEVEN_PER_PX, EdgeProfile, with_shading
from charact.mtf.edge.result import EdgeFitOutput, edge_refusals, edge_result, window_normalisation_note
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.known_transfer import KnownTransfer, known_transfer
from charact.mtf.mean_frame import Region
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Result

Array = NDArray[np.float64]

# Widths over which the line spread is confined, px, and lengths over which it is smooth, shares of the width.
WIDTHS_PX = 0.5 * 1.4 ** np.arange(12)
SMOOTHNESS = (0.5, 0.8, 1.2)
# Envelopes: 1/(1 + (d/a)^2), and one that falls exponentially.
TAILS = ("short", "long")
# Size of the odd part of a line spread, fraction of the even part.
ASYMMETRY = (0.03, 0.3)


@dataclass(frozen=True, kw_only=True)
class LineSpreadSetting:
    """The line spread under one width and one smoothness.

    Parameters
    ----------
    width_px, tail, smooth_px
        The envelope's width and kind, and the length over which the line spread is smooth.
    log_evidence
        ln of the marginal likelihood, up to a constant.
    mean, root
        Line spread at the places and a root of its covariance, DN per px.
    model
        Profile at the bins, DN.
    amplitude
        Step, level and slopes, DN and DN per px.
    chi2, used_freedom
        Chi squared of the mean, and the parameters that the data fixed.
    """

    width_px: float
    tail: str
    smooth_px: float
    log_evidence: float
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
    normal_equations: _NormalEquations


def _evidence(tried: _Evaluation) -> float:
    return tried.log_evidence


def _widths_around(width_px: float) -> Array:
    """Return the widths around one of those tried, px."""
    near = int(np.argmin(np.abs(WIDTHS_PX - width_px)))
    return np.asarray(WIDTHS_PX[max(near - 1, 0) : near + 2], float)


class LineSpreads:
    """Line spreads of one profile.

    Parameters
    ----------
    profile
        The measured profile.
    known
        Aperture and video filter behind the line spread.
    slopes_sd_per_px
        Priors of the illumination's slopes, share of the step per px, each as likely as the others.
    shift_px
        Where the edge is.
    """

    def __init__(
        self, profile: EdgeProfile, known: KnownTransfer, slopes_sd_per_px: Sequence[float], shift_px: float
    ) -> None:
        self._profile = profile
        self.places = _places(float(profile.gathered.half_width_px))
        self._scale = max(abs(profile.step), 1e-300)
        root = np.linalg.inv(np.linalg.cholesky(profile.covariance))
        levels = self._levels = profile.levels
        weights = _edge_of_line(self.places, profile.distance - shift_px, profile.spread_px, known)
        data, design = root @ profile.value, root @ np.concatenate([weights, levels], axis=1)
        size = self.places.size
        self._weights, self._root, self._data = weights, root, data
        self._lines, self._white_levels = design[:, :size], design[:, size:]
        self.free = len(data) - 1
        flat = self._white_levels[:, :1] / np.linalg.norm(self._white_levels[:, 0])
        self.power = float(data @ data - (flat[:, 0] @ data) ** 2)
        self.settings = self._weight_settings(slopes_sd_per_px)

    def _weight_settings(self, slopes_sd_per_px: Sequence[float]) -> list[LineSpreadSetting]:
        """Return the settings that count, the most probable first."""
        # The width first, for either kind of tail; then all that goes with widths around the best.
        tops = [self._best_widths(self._project_levels(slope)) for slope in slopes_sd_per_px]
        best = max(one.log_evidence for of_slope in tops for one in of_slope)
        tried = [
            self._evaluate(top.normal_equations, float(width), top.tail, smoothness, asymmetry)
            for of_slope in tops
            for top in of_slope
            if top.log_evidence > best - THRESHOLDS.competitive_setting
            for width in _widths_around(max(of_slope, key=_evidence).width_px)
            for smoothness in SMOOTHNESS
            for asymmetry in ASYMMETRY
        ]
        evidence = np.array([one.log_evidence for one in tried])
        share = np.exp(evidence - evidence.max())
        share /= share.sum()
        self.shares = np.sort(share[share > THRESHOLDS.min_setting_weight])[::-1]
        return [self._finished(tried[i]) for i in np.argsort(-share) if share[i] > THRESHOLDS.min_setting_weight]

    def _best_widths(self, levelled: "_NormalEquations") -> list["_Evaluation"]:
        """Return the most probable setting of either kind of tail, all of one smoothness and symmetry."""
        return [
            max(
                (self._evaluate(levelled, float(w), tail, SMOOTHNESS[1], ASYMMETRY[0]) for w in WIDTHS_PX),
                key=_evidence,
            )
            for tail in TAILS
        ]

    def _project_levels(self, slope_sd_per_px: float) -> "_NormalEquations":
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
        self, levelled: "_NormalEquations", width: float, tail: str, smoothness: float, asymmetry: float
    ) -> "_Evaluation":
        """Return evidence, setting and posterior factors of one width, tail, smoothness and symmetry."""
        even, odd = _prior_root(self.places.tobytes(), width, tail, width * smoothness)
        prior = np.concatenate([even, asymmetry * odd], axis=1) * self._scale
        values, vectors = np.linalg.eigh(prior.T @ levelled.left @ prior)
        values = np.maximum(values, 0.0)
        along = vectors.T @ (prior.T @ levelled.right)
        chi2 = levelled.power - float(np.sum(along**2 / (1.0 + values)))
        return _Evaluation(
            log_evidence=levelled.log_evidence - 0.5 * chi2 - 0.5 * float(np.sum(np.log1p(values))),
            width_px=width,
            tail=tail,
            smooth_px=width * smoothness,
            basis=prior @ vectors,
            values=values,
            along=along,
            normal_equations=levelled,
        )

    def _finished(self, tried: "_Evaluation") -> LineSpreadSetting:
        """Return the line spread of a setting."""
        onto = tried.normal_equations.onto
        mean = np.asarray(tried.basis @ (tried.along / (1.0 + tried.values)), float)
        levels = onto[:, -1] - onto[:, :-1] @ mean
        model = self._weights @ mean + self._levels @ levels
        step = float(np.sum(mean * _cells(self.places)))
        residual = self._data - self._root @ model
        return LineSpreadSetting(
            width_px=tried.width_px,
            tail=tried.tail,
            smooth_px=tried.smooth_px,
            log_evidence=tried.log_evidence,
            mean=mean,
            root=tried.basis / np.sqrt(1.0 + tried.values),
            model=model,
            amplitude=np.concatenate([[step], levels]),
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
        """Return the curvature of the camera response that explains asymmetric line spreads, with its error.

        Parameters
        ----------
        draws
            Line spreads, shape (draw, place).

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


@dataclass(frozen=True, kw_only=True)
class Transfers:
    """MTFs of drawn line spreads, shape (draw, place), at places, px, seen through the known part of the transfer."""

    places: Array
    draws: Array
    known: KnownTransfer
    seed: int

    def mtf(self, frequency: Array) -> Array:
        """Return the MTF at frequencies, shape (f,) -> (draw, f), normalised to all the light."""
        weighted = self.draws * _cells(self.places)
        # Between places the line spread runs straight, which is a factor sinc^2 where they are evenly spaced.
        phase = 2.0 * np.pi * np.outer(self.places, frequency)
        smooth = np.sinc(np.outer(_cells(self.places), frequency)) ** 2
        real, imaginary = weighted @ (np.cos(phase) * smooth), weighted @ (np.sin(phase) * smooth)
        total = weighted.sum(axis=1)
        outer = weighted[:, np.abs(self.places) > 0.5 * self.places[-1]].sum(axis=1)
        beyond = np.random.default_rng(self.seed).uniform(0.0, ACCURACY.max_light_beyond, len(total)) * np.maximum(
            outer / total, 0.0
        )
        return np.hypot(real, imaginary) / (np.abs(total) * (1.0 + beyond))[:, None] * np.abs(self.known(frequency))


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

    The known transfer is symmetric but for a video filter; here its kernel is sampled at a tenth of a pixel.
    """
    at, kernel = _kernel(known)
    gone = np.add.outer(distance, -at)
    plain = _integral(places, gone.ravel()).reshape(*gone.shape, places.size)
    weights = np.tensordot(kernel, plain, axes=(0, 1))
    # The mean over a bin: half its variance times the second derivative, by differences of a tenth of a pixel.
    little = 0.1
    sides = [
        np.tensordot(kernel, _integral(places, (gone + sign * little).ravel()).reshape(plain.shape), axes=(0, 1))
        for sign in (1, -1)
    ]
    return weights + 0.5 * (spread_px[:, None] / little) ** 2 * (sides[0] + sides[1] - 2.0 * weights)


def _kernel(known: KnownTransfer) -> tuple[Array, Array]:
    """Return distances and weights of the known transfer's line spread, sampled."""
    step, size = 0.1, 512
    frequency = np.fft.rfftfreq(size, step)
    # The cell's own transform taken in makes the samples the exact shares of cells.
    line = np.fft.fftshift(np.fft.irfft(np.conj(known(np.maximum(frequency, 1e-9))) * np.sinc(frequency * step), size))
    at = np.asarray((np.arange(size) - size // 2) * step, float)
    kept = np.abs(at) < (12.0 if known.video else 1.2)
    return at[kept], line[kept] / line[kept].sum()


def _integral(places: Array, distance: Array) -> Array:
    """Return the map (distance, place) from a piecewise straight line spread to its integral up to each distance."""
    gaps = np.diff(places)
    gone = np.clip((distance[:, None] - places[:-1]) / gaps, 0.0, 1.0)
    weights = np.zeros((distance.size, places.size))
    weights[:, 1:] += gaps * 0.5 * gone**2
    weights[:, :-1] += gaps * (gone - 0.5 * gone**2)
    return weights


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


METHOD = "edge-free"
# An illumination gradient looks like a long tail: both are weighted by evidence.
SLOPES_PER_PX = (EVEN_PER_PX, UNEVEN_PER_PX)


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
    """Measure the MTF across an edge without a form of the point spread.

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
    envelope w(d) = 1/(1 + (d/a)^2) or exp(-sqrt(1 + (d/a)^2)), its odd part made smaller by a factor; envelope, a, l
    and factor on a grid by marginal likelihood, in even light and in light that slopes, s by the step. Regularised line
    spread with the regularisation chosen by evidence (MacKay, Neural Computation 4, 1992, 415). Light beyond the region
    is taken to lie anywhere between none and twice what the outer half of the region holds.
    """
    edge = prepare_edge(stack, region, context, fields_apart=True)
    if isinstance(edge, EdgeRefusal):
        return edge_refusals(METHOD, edge.reason, edge.where, context)
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    edge, spreads = _fit_edge(edge, known)
    best = spreads.settings[0]
    reason = edge_refusal(best.chi2, spreads.power, spreads.free)
    if reason:
        return edge_refusals(METHOD, reason, edge.where, context)
    posterior = spreads.posterior(context.seed)
    transfers = Transfers(places=spreads.places, draws=posterior.draws, known=known, seed=context.seed)
    half = np.argmax(transfers.mtf(np.linspace(0.005, 1.5, 300)).mean(axis=0) < 0.5) * 0.005 + 0.005
    reason = blur_refusal(edge.profile, float(half))
    if reason:
        return edge_refusals(METHOD, reason, edge.where, context)
    odds = edge_ln_bayes_factor_nonlinear(edge, context)
    lifted = nonlinearity_bias(NO_CURVATURE_ESTIMATE, contrast(edge.profile), odds, context.seed, len(posterior.draws))
    outcome = EdgeFitOutput(
        method=METHOD,
        edge=edge,
        fitted=edge_checks.FittedProfile(
            model=best.model, amplitude=best.amplitude, chi2=best.chi2, free=spreads.free - best.used_freedom
        ),
        response=spreads.response_curvature(posterior.draws),
        posterior=posterior,
        mtf=remove_nonlinearity(transfers.mtf, lifted),
        settings={"width_px": round(best.width_px, 3), "tail": best.tail, "smooth_over_px": round(best.smooth_px, 3)},
        notes=(window_normalisation_note(edge.profile),),
        doubt=known.doubt,
    )
    return edge_result(outcome, context)


def _fit_edge(edge: PreparedEdge, known: KnownTransfer) -> tuple[PreparedEdge, LineSpreads]:
    """Fit an edge, first as if its plateaus were even, then with the shading that is left over, if any."""
    profile = edge.profile
    fitter = BlurModelFitter(profile, known)
    family = BlurModel(core="gaussian")
    shift_px = float(fitter.fit(family, np.array([0.0, np.log(fitter.guess())]), EVEN_PER_PX).point[0])
    spreads = LineSpreads(profile, known, SLOPES_PER_PX, shift_px)
    shaded = with_shading(profile, profile.value - spreads.settings[0].model)
    if shaded.shading_sd > 0:
        spreads = LineSpreads(shaded, known, SLOPES_PER_PX, shift_px)
    return replace(edge, profile=shaded), spreads
