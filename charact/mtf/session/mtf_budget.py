"""Stage budget: which stage of the camera costs how much of the MTF, from curves along rows and columns together.

Curves in both directions, and the one after the gain, weigh the stages against each other. What they cannot tell apart
is said: a stage known no better than before, and groups of which only the product is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from charact.mtf.session.stage_transfers import PARAMETERS, STAGES, Direction, StageModel
from charact.mtf.session.thresholds import ACCURACY, THRESHOLDS
from charact.posterior import find_maximum, laplace, sample
from labdata.errors import BadInput
from labdata.measurement import Posterior
from labdata.sensor import Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MeasuredCurve:
    """A measured MTF along one direction.

    Parameters
    ----------
    direction
        "horizontal" (along rows) or "vertical".
    after_gain
        Whether it holds what comes after the gain only, as that of the noise of flats.
    frequency_cy_per_px
        Frequencies, cycles per column pitch or, vertically, per row pitch, shape (f,).
    value
        MTF, shape (f,).
    covariance
        Its covariance, shape (f, f).
    """

    direction: Direction
    after_gain: bool = False
    frequency_cy_per_px: Array
    value: Array
    covariance: Array

    def __post_init__(self) -> None:
        size = len(self.frequency_cy_per_px)
        if self.direction not in ("horizontal", "vertical"):
            raise BadInput(f"a direction must be horizontal or vertical, got {self.direction!r}")
        if np.shape(self.value) != (size,) or np.shape(self.covariance) != (size, size):
            raise BadInput(f"a curve of {size} frequencies must have as many values and a covariance of that size")

    @classmethod
    def of_draws(
        cls, direction: Direction, frequency_cy_per_px: Array, draws: Array, *, after_gain: bool = False
    ) -> "MeasuredCurve":
        """Return the curve of posterior draws, shape (draw, frequency)."""
        return cls(
            direction=direction, after_gain=after_gain, frequency_cy_per_px=np.asarray(frequency_cy_per_px, float),
            value=np.mean(draws, axis=0), covariance=np.atleast_2d(np.cov(draws.T)),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CurvesWithCovariance:
    """Curves whose errors go together, as those of one fit along rows and along columns.

    Parameters
    ----------
    curves
        The curves.
    covariance
        Covariance of all their values, one curve after the other, shape (n, n). It may fill few directions only.
    """

    curves: tuple[MeasuredCurve, ...]
    covariance: Array

    def __post_init__(self) -> None:
        size = sum(len(curve.value) for curve in self.curves)
        if np.shape(self.covariance) != (size, size):
            raise BadInput(
                f"curves of {size} values together must have a covariance of that size, got {np.shape(self.covariance)}"
            )

    @classmethod
    def of_one(cls, curve: MeasuredCurve) -> "CurvesWithCovariance":
        """Return a curve alone."""
        return cls(curves=(curve,), covariance=curve.covariance)

    @property
    def value(self) -> Array:
        """Values of all curves, shape (n,)."""
        return np.concatenate([curve.value for curve in self.curves])


@dataclass(frozen=True, kw_only=True)
class MtfBudget:
    """What the curves say of the stages.

    Parameters
    ----------
    posterior
        Draws of the parameters.
    identified
        Stages that the curves tell beyond what the description said.
    products
        Groups of the others of which only the product is identified.
    known
        Stages that have nothing to fit: the pixel, and a video that a digital camera has not.
    statement
        The same in sentences.
    chance
        Probability of residuals as large, were the model right.
    """

    posterior: Posterior
    identified: tuple[str, ...]
    products: tuple[tuple[str, ...], ...]
    known: tuple[str, ...]
    statement: tuple[str, ...]
    chance: float
    camera: StageModel = field(repr=False)

    def mtf(self, stage: str, frequency_cy_per_px: Array, direction: Direction) -> Array:
        """Return draws of one stage's MTF, shape (draw, frequency), frequencies per pitch of the direction."""
        return self.product((stage,), frequency_cy_per_px, direction)

    def product(self, stages: Sequence[str], frequency_cy_per_px: Array, direction: Direction) -> Array:
        """Return draws of the product of stages, shape (draw, frequency), frequencies per pitch of the direction."""
        if unknown := [stage for stage in stages if stage not in STAGES]:
            raise BadInput(f"a stage must be one of {', '.join(STAGES)}, got {unknown[0]!r}")
        logs = self.camera.log_stages(self.posterior.draws, np.asarray(frequency_cy_per_px, float), direction)
        return np.exp(np.sum(logs[[STAGES.index(stage) for stage in stages]], axis=0))

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that the curves were taken to hold."""
        return self.camera.stages


def fit_mtf_budget(
    curves: Sequence[MeasuredCurve | CurvesWithCovariance],
    sensor: Sensor,
    *,
    interlaced: bool,
    seed: int,
    quick: bool = False,
    halo: bool = False,
) -> MtfBudget:
    """Fit the stages of a camera to its measured curves.

    Parameters
    ----------
    curves
        Curves of the whole camera, best along rows and columns, and those after the gain; such whose errors go together
        as one.
    sensor
        Description: pitches and pixel, and ranges of the stages as priors.
    interlaced
        Whether a row of a frame sums two rows of the chip.
    seed, quick
        Seed of the draws; without a Markov chain.
    halo
        Whether the curves are normalised to all light, so that the halo of the cathode's gap lowers them.

    Raises
    ------
    BadInput
        If there is no curve.

    Notes
    -----
    The stages are those of `StageModel`, with the description's ranges as normal priors; errors of the curves are
    normal. A curve after the gain lacks the lens, the halo and the tube's share before it.
    """
    if not curves:
        raise BadInput("a stage budget must have at least one measured curve, got none")
    measured = [one if isinstance(one, CurvesWithCovariance) else CurvesWithCovariance.of_one(one) for one in curves]
    camera = StageModel.of(sensor, interlaced=interlaced, halo=halo)
    whitened = [(one, _whitener(one.covariance)) for one in measured]
    bounds = camera.bounds

    def chi2(theta: Array) -> Array:
        off = [
            (np.concatenate([_predict(camera, theta, curve) for curve in one.curves], axis=1) - one.value) @ root
            for one, root in whitened
        ]
        return np.sum([np.sum(each**2, axis=1) for each in off], axis=0)

    def log_probability(theta: Array) -> Array:
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], theta, camera.mean)
        prior = np.sum(((safe - camera.mean) / camera.sd) ** 2, axis=1)
        return np.where(inside, -0.5 * (chi2(safe) + prior), -np.inf)

    point, covariance = find_maximum(log_probability, camera.mean, bounds)
    posterior = (laplace if quick else sample)(
        log_probability, names=camera.names, units=tuple(PARAMETERS[name][0] for name in camera.names),
        start=point, covariance=covariance, seed=seed, bounds=bounds,
    )  # fmt: skip
    from scipy.stats import chi2 as chi_squared

    rank = sum(root.shape[1] for _, root in whitened)
    chance = float(chi_squared.sf(float(chi2(point[None])[0]), rank))
    prior = np.random.default_rng([seed, 1]).normal(camera.mean, camera.sd, (ACCURACY.prior_draws, len(camera.mean)))
    prior = np.clip(prior, bounds[:, 0] + 1e-6, bounds[:, 1])
    identified, products, known = _identify_stages(
        camera, posterior.draws, prior, [c for one in measured for c in one.curves]
    )
    return MtfBudget(
        posterior=posterior, identified=identified, products=products, known=known, chance=chance, camera=camera,
        statement=_sentences(camera.stages, identified, products, known, chance),
    )  # fmt: skip


def _predict(camera: StageModel, theta: Array, curve: MeasuredCurve) -> Array:
    """Return the MTF of a curve, shape (n, frequency)."""
    return camera.mtf(theta, curve.frequency_cy_per_px, curve.direction, after_gain=curve.after_gain)


def _whitener(covariance: Array) -> Array:
    """Return the matrix that makes a curve's errors white, along directions that they fill."""
    value, vector = np.linalg.eigh(np.asarray(covariance, float))
    # A curve of a few parameters has errors in as few directions; the others say nothing but the form it was given.
    kept = value > 1e-6 * value.max()
    return vector[:, kept] / np.sqrt(value[kept])


def _identify_stages(
    camera: StageModel, draws: Array, prior: Array, curves: Sequence[MeasuredCurve]
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...]]:
    """Return the identified stages, the groups identified as products, and stages without parameters."""
    here, before = (_ln_stages_at_mtf50(camera, theta, curves) for theta in (draws, prior))
    sd, prior_sd = here.std(axis=1), before.std(axis=1)
    there = [i for i in range(len(STAGES)) if STAGES[i] in camera.stages]
    known = [i for i in there if prior_sd[i] < 1e-9]
    alone = [i for i in there if i not in known and sd[i] < THRESHOLDS.identified * prior_sd[i]]
    left = [i for i in there if i not in known and i not in alone]
    products = []
    for size in range(2, len(left) + 1):
        for group in combinations(left, size):
            members = list(group)
            if any(set(found) & set(members) for found in products):
                continue
            together = here[members].sum(axis=0).std()
            if together < THRESHOLDS.product * np.sqrt(np.sum(sd[members] ** 2)):
                products.append(members)
    return (
        tuple(STAGES[i] for i in alone),
        tuple(tuple(STAGES[i] for i in group) for group in products),
        tuple(STAGES[i] for i in known),
    )


def _ln_stages_at_mtf50(camera: StageModel, theta: Array, curves: Sequence[MeasuredCurve]) -> Array:
    """Return ln of the MTF of each stage along rows, where the sharpest measured curve is one half, (stage, draw)."""
    across = [curve for curve in curves if curve.direction == "horizontal"] or list(curves)
    half = max(float(np.interp(0.5, curve.value[::-1], curve.frequency_cy_per_px[::-1])) for curve in across)
    return camera.log_stages(theta, np.array([half]), across[0].direction)[:, :, 0]


def _sentences(
    stages: tuple[str, ...],
    identified: tuple[str, ...],
    products: tuple[tuple[str, ...], ...],
    known: tuple[str, ...],
    chance: float,
) -> tuple[str, ...]:
    grouped = {stage for group in products for stage in group}
    rest = [stage for stage in stages if stage not in (*identified, *known, *grouped)]
    out = [f"identified by the curves: {', '.join(identified) or 'none'}"]
    out += [f"only the product of {' and '.join(group)} is identified" for group in products]
    if rest:
        out.append(f"no better known than from the description: {', '.join(rest)}")
    if known:
        out.append(f"taken as known: {', '.join(known)}")
    if chance < THRESHOLDS.budget_p_value:
        out.append(f"the stages do not describe the curves (chance {chance:.2g})")
    return tuple(out)
