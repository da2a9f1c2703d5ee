"""Halo at an illuminated edge, fitted to the strips of all stacks."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from charact.bloom import transfer
from charact.bloom.extent_measurements import provenance
from charact.bloom.lit_edge_profile import DARK_PX, LitEdgeLine, Strips, edge_line, strips_of
from charact.method import Context, register
from charact.posterior import importance_sample, laplace
from labdata.errors import BadInput
from labdata.measurement import Measurement, Posterior, Result, make_refusal, measurement_from_draws
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]

NAMES = ("halo_diameter", "elastic_share", "halo_fraction", "edge_offset", "core_spread")
GAUSSIAN = len(NAMES)
LEAST_DIAMETER_PX = 12.0
# Slightly beyond 0..1, since a bound at 0 would bias the diameter of a halo without rim.
ELASTIC_SHARE = (-0.15, 1.15)
SPREAD_PX2 = (0.05, 25.0)
Core = Literal["gaussian", "tube", "moffat"]
# Core parameters besides the Gaussian: name, unit, bounds, start, and mean and standard deviation of a prior (image
# tubes in general; a Moffat wing (1 + r^2/a^2)^-b).
BESIDES: dict[Core, tuple[tuple[str, str, tuple[float, float], float, tuple[float, float] | None], ...]] = {
    "gaussian": (),
    "tube": (
        ("core_frequency", "cy/px", (0.03, 2.0), 0.4, (0.4, 0.3)),
        ("core_exponent", "1", (0.7, 2.5), 1.3, (1.3, 0.3)),
    ),
    "moffat": (
        ("wing_share", "1", (0.0, 0.7), 0.1, None),
        ("wing_radius", "px", (0.7, 12.0), 3.0, None),
        ("wing_exponent", "1", (1.2, 4.0), 2.0, None),
    ),
}


def nodes() -> tuple[Array, Array]:
    """Frequencies, cy/px, and weights of the profile integrals, valid to 160 px from the edge."""
    return transfer.quadrature(0.75, 280)


@dataclass(frozen=True, kw_only=True)
class EdgeHaloLikelihood:
    """Likelihood of the whitened strips of all stacks of one edge.

    `strips`: strips of every stack; `width_px`: width of the illuminated area, column pitches; inf for a half plane;
    `walls`: bounds of the parameters common to all cores, shape (parameter, 2); `white`: whitening matrix of each
    stack's used strips; `waves`: sine and cosine of every frequency at the strips of each stack, shape (frequency,
    strip); `core`: core family; `halo`: whether there is a halo.
    """

    strips: tuple[Strips, ...]
    width_px: float
    walls: Array
    white: tuple[Array, ...]
    waves: tuple[tuple[Array, Array], ...]
    core: Core = "gaussian"
    halo: bool = True

    @property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([*self.walls, *(bounds for _, _, bounds, _, _ in BESIDES[self.core])])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return (*NAMES, *(name for name, *_ in BESIDES[self.core]))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return (*("px", "1", "1", "px", "px2"), *(unit for _, unit, *_ in BESIDES[self.core]))

    def log_probability(self, points: Array) -> Array:
        """Log-posterior with the optimum signal and background of every stack, shape (point,)."""
        inside = np.all((points >= self.bounds[:, 0]) & (points <= self.bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, self.bounds.mean(axis=1))
        total = -0.5 * (self._prior_residuals(safe) ** 2).sum(axis=1)
        for one, strips in enumerate(self.strips):
            chi2, amplitudes = self.fit_level(one, safe)
            total = total - 0.5 * (chi2 + self._short(strips, amplitudes) ** 2)
        return np.where(inside, total, -np.inf)

    def residuals(self, points: Array) -> Array:
        """Normalised residuals, those of the prior last, shape (point, number)."""
        out = [self._prior_residuals(points)]
        for one, strips in enumerate(self.strips):
            _, amplitudes = self.fit_level(one, points)
            model = amplitudes[:, :1] * self.shape(one, points)[:, strips.used] + amplitudes[:, 1:]
            out += [(strips.mean_dn[strips.used] - model) @ self.white[one].T, self._short(strips, amplitudes)[:, None]]
        return np.concatenate(out, axis=1)

    def _short(self, strips: Strips, amplitudes: Array) -> Array:
        """Normalised shortfall of a clipped side below full scale."""
        short = np.maximum(strips.least_light_dn - amplitudes[:, 0], 0.0)
        return short / max(0.03 * strips.least_light_dn, 1e-9)

    def _prior_residuals(self, points: Array) -> Array:
        known = [(place, *prior) for place, (*_, prior) in enumerate(BESIDES[self.core], GAUSSIAN) if prior]
        return np.array([(points[:, place] - mean) / sd for place, mean, sd in known]).reshape(-1, len(points)).T

    def fit_level(self, one: int, points: Array) -> tuple[Array, Array]:
        """Chi squared of one stack, shape (point,), and its signal and background, (point, 2)."""
        strips = self.strips[one]
        shape = self.shape(one, points)[:, strips.used]
        data = self.white[one] @ strips.mean_dn[strips.used]
        light = shape @ self.white[one].T
        flat = self.white[one].sum(axis=1)
        aa, ab, bb = (light**2).sum(axis=1), light @ flat, float(flat @ flat)
        ad, bd = light @ data, float(flat @ data)
        determinant = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb)
        level, ground = (bb * ad - ab * bd) / determinant, (aa * bd - ab * ad) / determinant
        chi2 = float(data @ data) - level * ad - ground * bd
        return chi2, np.stack([level, ground], axis=1)

    def shape(self, one: int, points: Array) -> Array:
        """Profile across an edge of unit signal, shape (point, strip)."""
        diameter, elastic, fraction, offset, _ = points[:, :GAUSSIAN].T
        frequency = nodes()[0]
        blur = self._core(points) * np.sinc(frequency)
        if self.halo:
            halo = transfer.disc(frequency, diameter, transfer.backscatter_profile(elastic))
            blur = blur * (1.0 - fraction[:, None] + fraction[:, None] * halo)
        near = self._step(one, blur, offset)
        if not np.isfinite(self.width_px):
            return near
        return near - self._step(one, blur, -self.width_px - offset)

    def _core(self, points: Array) -> Array:
        """Transfer function of the core, shape (point, frequency)."""
        frequency, spread = nodes()[0], points[:, GAUSSIAN - 1]
        core = transfer.gaussian(frequency, spread)
        if self.core == "tube":
            return core * transfer.tube(frequency, *points[:, GAUSSIAN:].T)
        if self.core == "gaussian":
            return core
        share, radius, power = points[:, GAUSSIAN:].T
        return core * (1.0 - share[:, None]) + share[:, None] * transfer.moffat(frequency, radius, power)

    def _step(self, one: int, blur: Array, at: Array) -> Array:
        """Step response at given offsets: 1/2 - integral of T sin(2 pi f (x - x0)) / pi f."""
        sine, cosine = self.waves[one]
        frequency, weight = nodes()
        turn = 2.0 * np.pi * frequency * at[:, None]
        return 0.5 - (blur * weight * np.cos(turn) / (np.pi * frequency)) @ sine + (
            blur * weight * np.sin(turn) / (np.pi * frequency)
        ) @ cosine  # fmt: skip


def problem_of(
    strips: tuple[Strips, ...], *, width_px: float, room_px: float, offset_px: tuple[float, float]
) -> EdgeHaloLikelihood:
    """Whiten strips and set the bounds, for a Gaussian core with halo."""
    white, waves = [], []
    for one in strips:
        above = one.mean_dn[one.used] - np.median(one.mean_dn[one.used][-8:])
        # A model of straight edges has a relative error of 0.4 % of the signal above background.
        covariance = one.covariance() + np.diag((0.004 * above) ** 2)
        white.append(np.linalg.inv(np.linalg.cholesky(covariance)))
        turn = 2.0 * np.pi * np.outer(nodes()[0], one.distance_px)
        waves.append((np.sin(turn), np.cos(turn)))
    widest = max(2.0 * room_px, LEAST_DIAMETER_PX + 4.0)
    walls = [[LEAST_DIAMETER_PX, widest], ELASTIC_SHARE, [0.0, 0.6], offset_px, SPREAD_PX2]
    return EdgeHaloLikelihood(
        strips=strips, width_px=width_px, walls=np.array(walls), white=tuple(white), waves=tuple(waves)
    )


@dataclass(frozen=True, kw_only=True)
class EdgeHaloOptimum:
    """Best fit: point, (parameter,), covariance, (parameter, parameter), and log-probability."""

    point: Array
    covariance: Array
    log_probability: float


def optimise_edge_halo(problem: EdgeHaloLikelihood, *, diameter_px: float | None = None) -> EdgeHaloOptimum:
    """Return the best fit from several start diameters, since the disc edge causes many local optima.

    `diameter_px` fixes the diameter.
    """
    low, high = problem.bounds[0]
    offset = 0.5 * problem.bounds[3].sum()
    diameters = np.linspace(low + 2, high - 2, 24) if problem.halo else np.array([0.5 * (low + high)])
    if diameter_px is not None:
        diameters = np.array([diameter_px])
    starts = np.array([[d, w, 0.1, offset, s] for d in diameters for w in (0.3, 0.8) for s in (1.0, 3.0)])
    besides = [first for *_, first, _ in BESIDES[problem.core]]
    points = np.concatenate([starts, np.tile(besides, (len(starts), 1))], axis=1)
    order = np.argsort(problem.log_probability(points))[::-1]
    free = np.ones(points.shape[1], bool)
    free[0] = problem.halo and diameter_px is None
    free[1:3] = problem.halo
    return max((_optimise_from(problem, points[one], free) for one in order[:2]), key=lambda peak: peak.log_probability)


def _optimise_from(problem: EdgeHaloLikelihood, start: Array, free: NDArray[np.bool_]) -> EdgeHaloOptimum:
    """Optimise the free parameters by least squares; covariance from the Jacobian."""
    from scipy.optimize import least_squares

    def all_parameters(points: Array) -> Array:
        out = np.broadcast_to(start, (len(points), len(start))).copy()
        out[:, free] = points
        return out

    low, high = problem.bounds[free].T
    step = 1e-4 * (high - low)

    def slopes(point: Array) -> Array:
        # Inside the bounds on either side.
        sign = np.where(point + step > high, -1.0, 1.0)
        left = problem.residuals(all_parameters(np.concatenate([point[None], point + np.diag(sign * step)])))
        return ((left[1:] - left[0]) / (sign * step)[:, None]).T

    first = np.clip(start[free], low + step, high - step)
    found = least_squares(lambda point: problem.residuals(all_parameters(point[None]))[0], first, jac=slopes,  # pyright: ignore[reportArgumentType]
                          bounds=(low, high), x_scale=high - low, max_nfev=40)  # fmt: skip
    point = all_parameters(found.x[None])[0]
    covariance = np.zeros((len(start), len(start)))
    covariance[np.ix_(free, free)] = np.linalg.pinv(found.jac.T @ found.jac + np.diag(((high - low) / 2.0) ** -2.0))
    return EdgeHaloOptimum(
        point=point, covariance=covariance, log_probability=float(problem.log_probability(point[None])[0])
    )


METHOD = "lit-edge"
QUANTITIES = (("halo_diameter", "px"), ("halo_fraction", "1"))
# Maximum halo radius over the distance to the border.
WHOLE = 0.85
LEAST_STRIPS = 24


@register(
    "lit-edge",
    METHOD,
    quantities=("halo_diameter", "halo_fraction"),
    scope="A straight edge of a bright area, four times as long as the halo radius, next to a dark area; "
    "preferably with one unclipped stack.",
)
def measure_lit_edge(session: Session, *, context: Context) -> Result:
    """Measure diameter and fraction of the halo from the edges of a session.

    Parameters
    ----------
    session
        Session with stacks of kind "edge", all of one target at several illuminances; preferably with darks.
    context
        Seed and settings.

    Notes
    -----
    An unclipped stack locates the edge and gives the signal of the illuminated side; brighter ones show the halo. With
    clipped stacks alone the edge position is free in the fit, the diameter less certain, and the halo fraction unknown.
    """
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    measurements, evidence = _measure(session, context, fields)
    return Result(measurements=tuple(measurements), evidence=evidence)


def _measure(
    session: Session, context: Context, fields: dict[str, Any]
) -> tuple[list[Measurement], dict[str, dict[str, Any]]]:
    levels = _levels(session, context)
    if isinstance(levels, str):
        return _refuse_all(levels, fields), {}
    line, strips = levels
    if min(int(one.used.sum()) for one in strips) < LEAST_STRIPS:
        return _refuse_all(f"fewer than {LEAST_STRIPS} px next to the edge are unclipped", fields), {}
    found = _select_model(strips, line)
    evidence = {"lit-edge": _evidence(found, strips)}
    reason = _refusal_reason(found, line)
    if reason:
        return _refuse_all(reason, fields), evidence
    context.progress("posterior of the halo next to an edge", 0.7)
    posterior = _posterior(found.problem, found.peak, context)
    diameter, fraction = _average_models(found, posterior, context)
    if diameter.std() > 0.1 * float(np.median(diameter)):
        return _refuse_all(
            "the halo diameter is uncertain by more than 10 %: a fainter, unclipped stack would locate the edge",
            fields,
        ), evidence
    flags = tuple(flag for flag in posterior.flags if flag != "prior-bound") + _misfit(found)
    flags += ("window-too-small",) if float(np.median(diameter)) > 2 * WHOLE * _room(line) else ()
    notes = ("the row pitch is unknown: pixels are assumed square",) if context.sensor is None else ()
    notes += () if session.of_kind("dark") else ("the black level is estimated from the darkest pixels",)
    common = {"flags": flags, "notes": notes, "posterior": posterior, **fields}
    out = [measurement_from_draws("halo_diameter", "px", diameter, **common)]
    if all(one.cut for one in strips):
        out.append(
            make_refusal(
                "halo_fraction", "1", "every stack is clipped: the signal of the bright side is unknown", **fields
            )
        )
    else:
        out.append(measurement_from_draws("halo_fraction", "1", fraction, **common))
    return out, evidence


def _refuse_all(reason: str, fields: dict[str, Any]) -> list[Measurement]:
    return [make_refusal(quantity, unit, reason, **fields) for quantity, unit in QUANTITIES]


def _levels(session: Session, context: Context) -> tuple[LitEdgeLine, tuple[Strips, ...]] | str:
    """The edge, located in the best stack, and the strips of every stack."""
    entries = session.of_kind("edge")
    if not entries:
        raise BadInput("the halo of an edge needs stacks of kind edge")
    order = sorted(entries, key=lambda entry: entry.conditions.illuminance_lux or 0.0)
    first = order[-1].target.region
    frames = [_frame(entry, session, context) for entry in order if entry.target.region == first]
    kept = [one for one in frames if np.percentile(one[0], 99.0) - one[2] > 0.03 * (one[3] - one[2])]
    if not kept:
        return "no stack exceeds its dark frames by 3 % of full scale"
    # The brightest unclipped stack locates the edge best, else the faintest one.
    whole = [one for one in kept if np.percentile(one[0], 99.0) < one[2] + 0.75 * (one[3] - one[2])]
    image, _, dark, full = whole[-1] if whole else kept[0]
    low, high = np.percentile(image, (2.0, 98.0))
    level = 0.5 * (float(low) + float(high)) if whole else dark + 0.5 * (full - dark)
    line = edge_line(image, level, context.pitch_ratio)
    if isinstance(line, str):
        return line
    strips = tuple(
        strips_of(image, line, label=label, dark_dn=dark, full_dn=full, pitch_ratio=context.pitch_ratio)
        for image, label, dark, full in kept
    )
    return line, strips


def _frame(entry: StackEntry, session: Session, context: Context) -> tuple[Array, str, float, float]:
    """Mean frame, label, dark level and full scale of a stack."""
    stack = entry.read()
    full = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    dark, image = session.dark_like(entry.conditions), stack.data.mean(axis=0, dtype=np.float64)
    if dark is not None:
        level = dark.read().mean_dn
    else:
        level = stack.black_level_dn if stack.black_level_dn is not None else float(np.percentile(image, 2.0))
    return image, entry.label, level, float(stack.data.max() if full is None else full)


@dataclass(frozen=True, kw_only=True)
class _Found:
    """Best fit with a halo, and its gain in the information criterion over the best fit without."""

    problem: EdgeHaloLikelihood
    peak: EdgeHaloOptimum
    gain: float
    rivals: tuple[tuple[float, EdgeHaloLikelihood, EdgeHaloOptimum], ...]


def _select_model(strips: tuple[Strips, ...], line: LitEdgeLine) -> _Found:
    """Fit all cores with and without a halo; select by the Bayesian information criterion."""
    offset = (-10.0, 1.0) if all(one.cut for one in strips) else (-1.5, 1.5)
    number = float(np.log(sum(one.used.sum() for one in strips)))
    plain = problem_of(strips, width_px=line.width_px, room_px=_room(line), offset_px=offset)
    fits: dict[bool, list[tuple[float, EdgeHaloLikelihood, EdgeHaloOptimum]]] = {True: [], False: []}
    for halo in (True, False):
        for core in BESIDES:
            problem = replace(plain, core=core, halo=halo)
            peak = optimise_edge_halo(problem)
            free = len(peak.point) - (0 if halo else 3)
            fits[halo].append((free * number - 2.0 * peak.log_probability, problem, peak))
    (bic, problem, peak), without = min(fits[True], key=lambda one: one[0]), min(fits[False], key=lambda one: one[0])
    rivals = tuple((value - bic, of, other) for value, of, other in fits[True] if value < bic + 10.0)
    return _Found(problem=problem, peak=peak, gain=without[0] - bic, rivals=rivals)


def _room(line: LitEdgeLine) -> float:
    return float(min(line.room_px, DARK_PX))


def _refusal_reason(found: _Found, line: LitEdgeLine) -> str:
    """Refusal reason, or an empty string."""
    if found.gain < 20.0:
        return "the profile next to the edge is that of a core alone: no halo is visible"
    problem, diameter = found.problem, found.peak.point[0]
    for factor in (0.75, 1.3):
        off = float(np.clip(factor * diameter, *problem.bounds[0]))
        if off in problem.bounds[0]:
            continue
        if found.peak.log_probability - optimise_edge_halo(problem, diameter_px=off).log_probability < 6.0:
            return "the profile next to the edge falls off smoothly, without the end of a halo"
    if diameter > 2 * _room(line):
        return f"the halo extends to the border of the frame, {_room(line):.0f} px from the edge"
    if 0.5 * diameter > line.ends_px:
        return f"the edge is too short: its ends are {line.ends_px:.0f} px from the measured part, the halo is wider"
    return ""


def _posterior(problem: EdgeHaloLikelihood, peak: EdgeHaloOptimum, context: Context) -> Posterior:
    arguments: dict[str, Any] = {
        "names": problem.names, "units": problem.units, "start": peak.point, "covariance": peak.covariance,
        "seed": context.seed, "bounds": problem.bounds,
    }  # fmt: skip
    return (laplace if context.quick else importance_sample)(problem.log_probability, **arguments)


def _average_models(found: _Found, best: Posterior, context: Context) -> tuple[Array, Array]:
    """Draws of the halo's diameter and fraction, averaged over cores by weight, shape (draw,)."""
    weight = np.exp([-0.5 * over for over, _, _ in found.rivals])
    count = np.rint(len(best.draws) * weight / weight.sum()).astype(int)
    parts = [
        (best if peak is found.peak else _posterior(problem, peak, context)).draws[:number]
        for number, (_, problem, peak) in zip(count, found.rivals, strict=True)
    ]
    return tuple(np.concatenate([part[:, column] for part in parts]) for column in (0, 2))  # pyright: ignore[reportReturnType]


def _misfit(found: _Found) -> tuple[str, ...]:
    from scipy.stats import chi2

    problem, point = found.problem, found.peak.point
    total = sum(float(problem.fit_level(one, point[None])[0][0]) for one in range(len(problem.strips)))
    freedom = sum(int(one.used.sum()) - 2 for one in problem.strips) - len(point)
    return ("model-misfit",) if chi2.sf(total, max(freedom, 1)) < 1e-4 else ()


def _evidence(found: _Found, strips: tuple[Strips, ...]) -> dict[str, Any]:
    """Strips of every stack with the model."""
    point, problem = found.peak.point[None], found.problem
    model = []
    for one in range(len(strips)):
        light, ground = problem.fit_level(one, point)[1][0]
        model.append((light * problem.shape(one, point)[0] + ground).tolist())
    return {
        "figure": "lit-edge",
        "label": [one.label for one in strips],
        "distance_px": [one.distance_px.tolist() for one in strips],
        "mean_dn": [one.mean_dn.tolist() for one in strips],
        "sd_dn": [one.sd_dn.tolist() for one in strips],
        "used": [one.used.tolist() for one in strips],
        "model_dn": model,
        "edge_px": float(found.peak.point[3]),
        "halo_diameter_px": float(found.peak.point[0]),
        "bic_gain_of_halo": found.gain,
    }
