"""Likely causes of a validation that fails: named changes of camera or frames, compared by the
likelihood of all measured numbers.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.findings import Cause
from charact.observables import Numbers
from charact.validation.ensemble import Ensemble
from charact.validation.faults import KNOWN, Fault
from charact.validation.frames import MatchedStacks
from charact.validation.thresholds import CAUSES
from charact.verdict import Finding

Array = NDArray[np.float64]
Groups = Mapping[str, Numbers]
# Stacks of a fault in words, where they are not one.
STACKS = {"all": "all stacks", "lit": "all lit stacks", "flats": "the flats"}


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """A named change of camera or frames, of free size.

    Parameters
    ----------
    name, cause, flag
        What it is, the stage with what settles it, and a key of `labdata.flags.FLAGS`.
    stacks
        The stacks that have it, in words.
    numbers_at
        Returns the numbers of the first simulated set, changed by a size.
    size, power
        Size that is simulated first; the numbers follow its power, 0: it has no other size.
    two_sided, least_size, largest_size
        Whether it may be negative, from what size on, and up to what amount.
    scale, unit
        Size in the unit that is shown over that of `size`.
    """

    name: str
    cause: Cause
    flag: str
    stacks: str
    numbers_at: Callable[[float], Groups]
    size: float = 1.0
    power: int = 1
    two_sided: bool = False
    least_size: float = -np.inf
    largest_size: float = np.inf
    scale: float = 1.0
    unit: str = ""


def alternatives_of(
    frames: Mapping[str, NDArray],
    chosen: MatchedStacks,
    numbers_of: Callable[[Mapping[str, NDArray]], Groups],
    full_dn: float,
) -> Iterator[Alternative]:
    """Yield the faults of stacks that a session has, put into the frames of the first set."""
    for fault in KNOWN:
        for stacks in fault.stacks:
            labels = fault.labels(chosen, stacks)
            if not labels:
                continue

            def numbers_at(size: float, fault: Fault = fault, stacks: str = stacks) -> Groups:
                return numbers_of(fault.put_into(frames, chosen, stacks, full_dn, size))

            scale, unit = 1.0, fault.unit
            if unit == "sd":
                # Stacks of unlike noise have no size in DN in common.
                noise_dn = float(frames[labels[0]].std(axis=0).mean())
                scale, unit = (noise_dn, "DN") if len(labels) == 1 else (100.0, "% of the noise")
            yield Alternative(
                name=fault.name,
                cause=fault.cause,
                flag=fault.flag,
                stacks=STACKS.get(stacks, labels[0]),
                numbers_at=numbers_at,
                size=fault.size,
                power=fault.power if fault.unit else 0,
                two_sided=fault.two_sided,
                # No light is below 0, and no signal more than lost.
                largest_size=100.0 if fault.unit == "%" else np.inf,
                scale=scale,
                unit=unit,
            )


@dataclass(frozen=True, kw_only=True)
class LikelyCause:
    """A named change that explains most of how measured numbers deviate from simulated ones.

    `size` is in `unit`, or 1 with none; `explained`: share of the excess of chi-squared that it
    explains; `probability`: among all alternatives, each as likely before.
    """

    name: str
    stacks: str
    stage: str
    remedy: str
    flag: str
    size: float
    unit: str
    explained: float
    probability: float

    @property
    def finding(self) -> Finding:
        """The finding with the size in words."""
        of_size = f" of {float(f'{self.size:.2g}'):g} {self.unit}" if self.unit else ""
        return Finding(
            flag=self.flag,
            effect=(
                f"{self.name}{of_size} in {self.stacks} explains {100.0 * self.explained:.0f} % of "
                f"the deviations: {self.stage}"
            ),
            remedy=self.remedy,
        )


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """An alternative of a size: chi-squared that is left, logarithm of the likelihood, and the
    factor by which its shift agrees best.
    """

    alternative: Alternative
    size: float
    factor: float
    chi_squared: float
    log_likelihood: float

    @property
    def agreeing_size(self) -> float:
        """Size at which the shift would agree as it stands."""
        step = abs(self.factor) ** (1.0 / self.alternative.power)
        size = float(np.copysign(self.size * step, self.size * self.factor))
        return max(size, self.alternative.least_size)

    @property
    def is_possible(self) -> bool:
        """Whether a change can have that size."""
        alternative = self.alternative
        return not alternative.power or abs(self.agreeing_size) <= alternative.largest_size

    @property
    def next_size(self) -> float:
        """Size to simulate next: a large step would leave the range of the frames."""
        size, simulated = self.agreeing_size, abs(self.size)
        low, high = simulated / CAUSES.largest_step, simulated * CAUSES.largest_step
        return float(np.copysign(np.clip(abs(size), low, high), size))


class CauseTest:
    """Likelihood of measured numbers under named changes of the simulated ones.

    Parameters
    ----------
    ensembles
        Numbers of the simulated sets by group: labels and ensemble.
    plain
        Numbers of the first set without a change.
    measured
        Measured numbers.

    Notes
    -----
    Numbers y of n simulated sets have the mean m and the covariance C, of halved correlations. A
    change of factor a shifts them by a s. The likelihood is that of Student's distribution of
    n - 1 degrees,

    .. math:: (1 + r^T C_a^{-1} r / (n - 1))^{-(n - 1 + k) / 2} |C_a|^{-1/2}, r = y - m - a s

    as C is estimated (Anderson, An Introduction to Multivariate Statistical Analysis, 7.7), where
    C_a has the variances (e a s)^2 besides: no fault is the simulated one exactly. The factor is
    that of least squares by C: numbers that show a size best would weigh as little as any by C_a.
    """

    def __init__(
        self,
        ensembles: Mapping[str, tuple[tuple[str, ...], Ensemble]],
        plain: Groups,
        measured: Groups,
    ) -> None:
        self._keys = [(name, label) for name, (labels, _) in ensembles.items() for label in labels]
        values, least_sd = (
            np.concatenate(
                [getattr(ensemble, field) for _, ensemble in ensembles.values()], axis=-1
            )
            for field in ("values", "least_sd")
        )
        known = np.isfinite(self._vector(measured)) & np.isfinite(self._vector(plain))
        self._known = np.flatnonzero(known)
        ensemble = Ensemble(values=values[:, known], least_sd=least_sd[known], seed=0)
        self._sets = len(values)
        self._covariance = ensemble.covariance * (1.0 + 1.0 / self._sets)
        self._root = np.linalg.cholesky(self._covariance)
        self._plain = self._vector(plain)[known]
        self._gap = self._vector(measured)[known] - ensemble.values.mean(axis=0)
        self.chi_squared = float(np.sum(_whitened(self._root, self._gap) ** 2))
        self._usual = float(np.median([_left_out(ensemble, i) for i in range(self._sets)]))

    def _vector(self, groups: Groups) -> Array:
        return np.array([groups.get(name, {}).get(label, np.nan) for name, label in self._keys])

    def fit(self, alternative: Alternative, size: float) -> _Fit:
        """Return how well a change of a size, whose shift may be scaled, agrees with the measured
        numbers.
        """
        shift = np.nan_to_num(self._vector(alternative.numbers_at(size))[self._known] - self._plain)
        factor, root = 1.0, self._root
        if alternative.power:
            gap, direction = _whitened(root, self._gap, shift).T
            factor = float(direction @ gap / max(float(direction @ direction), 1e-300))
        if not alternative.two_sided:
            factor = max(factor, 0.0)
        variance = (CAUSES.shift_error * factor * shift) ** 2
        root = np.linalg.cholesky(self._covariance + np.diag(variance))
        gap, degrees = self._gap - factor * shift, self._sets - 1.0
        deviation = float(np.sum(_whitened(root, gap) ** 2)) / degrees
        return _Fit(
            alternative=alternative,
            size=size,
            factor=factor,
            chi_squared=deviation * degrees,
            log_likelihood=float(
                -0.5 * (degrees + gap.size) * np.log1p(deviation) - np.log(np.diag(root)).sum()
            ),
        )

    def explained(self, fit: _Fit) -> float:
        """Return the share that a fit explains of the excess of chi-squared over the usual."""
        excess = self.chi_squared - self._usual
        return 1.0 - max(fit.chi_squared - self._usual, 0.0) / max(excess, 1e-9)


def _left_out(ensemble: Ensemble, index: int) -> float:
    """Return chi-squared of a set by the other ones."""
    others = replace(ensemble, values=np.delete(ensemble.values, index, axis=0))
    covariance = others.covariance * (1.0 + 1.0 / len(others.values))
    gap = ensemble.values[index] - others.values.mean(axis=0)
    return float(np.sum(_whitened(np.linalg.cholesky(covariance), gap) ** 2))


def _whitened(root: NDArray[np.floating], *gaps: Array) -> Array:
    """Return gaps as columns in standard deviations of independent numbers, by the root of a
    covariance.
    """
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(root, np.stack(gaps, axis=1), lower=True))


def likely_causes(test: CauseTest, alternatives: Iterable[Alternative]) -> tuple[LikelyCause, ...]:
    """Return the alternatives that explain most of the deviations of the measured numbers, the
    likeliest first; empty where none does.

    The likeliest are simulated again at the size that agrees best, as numbers are linear in a size
    over a short range only.
    """
    fits = _sorted([test.fit(alternative, alternative.size) for alternative in alternatives])
    for _ in range(CAUSES.refinements):
        refined = [
            test.fit(fit.alternative, fit.next_size)
            if fit.alternative.power and fit.factor
            else fit
            for fit in fits[: CAUSES.refined]
        ]
        fits = _sorted(
            [
                max(pair, key=lambda fit: fit.log_likelihood)
                for pair in zip(fits, refined, strict=False)
            ]
            + fits[CAUSES.refined :]
        )
    fits = [fit for fit in fits if fit.is_possible]
    if not fits:
        return ()
    weights = np.exp([fit.log_likelihood - fits[0].log_likelihood for fit in fits])
    return tuple(
        _cause(fit, test.explained(fit), float(weight / weights.sum()))
        for fit, weight in zip(fits, weights, strict=True)
        if test.explained(fit) > CAUSES.explained and weight > CAUSES.least_odds
    )


def _sorted(fits: Sequence[_Fit]) -> list[_Fit]:
    return sorted(fits, key=lambda fit: -fit.log_likelihood)


def _cause(fit: _Fit, explained: float, probability: float) -> LikelyCause:
    alternative = fit.alternative
    return LikelyCause(
        name=alternative.name,
        stacks=alternative.stacks,
        stage=alternative.cause.stage,
        remedy=alternative.cause.remedy,
        flag=alternative.flag,
        size=fit.agreeing_size * alternative.scale if alternative.power else 1.0,
        unit=alternative.unit,
        explained=explained,
        probability=probability,
    )
