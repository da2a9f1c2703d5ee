"""Observations of the fit: measured numbers with covariance and predicted quantity; likely causes
of a misfit.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from charact.estimators.noise.findings import (
    AUTOMATIC,
    CURVED,
    LAGGING,
    PROCESSING,
    SPREAD,
    UNSTEADY,
    Cause,
)
from charact.fitting.prior import values_of_description
from charact.fitting.stack_levels import SessionStacks
from charact.observables import GivenOthers, Observable, Ridge, Values, observables
from charact.verdict import Finding
from labdata import Array, Camera, Conditions, Measurement, Result


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Measured numbers with Gaussian errors and their predicted values."""

    name: str  # name of the quantity, for messages
    value: Array  # measured numbers, shape (k,)
    covariance: Array  # covariance of their errors, model error included, shape (k, k)
    predict: Callable[[Values], Array]  # from values of shape (n,) each, shape (n, k)
    is_bound: bool = False  # whether a prediction beyond the value agrees
    parameters: tuple[str, ...]  # paths of the sensor parameters that it depends on
    # the product that it determines far better than any of its parameters
    ridge: Ridge | None = None
    given_others: GivenOthers | None = None  # the parameter that it shows given the others

    def residuals(self, values: Values) -> Array:
        """Return predicted less measured numbers, whitened, shape (n, k)."""
        residuals = self.predict(values) - self.value
        if self.is_bound:
            residuals = np.minimum(residuals, 0.0)
        return residuals @ self._whitening

    def chi_squared(self, values: Values) -> Array:
        """Return each draw's chi squared, shape (n,)."""
        return np.sum(self.residuals(values) ** 2, axis=1)

    def scale_errors(self, factor: float) -> "Observation":
        """Return the same numbers with all errors larger by a factor."""
        return replace(self, covariance=self.covariance * factor**2)

    @cached_property
    def _whitening(self) -> Array:
        """Root of the inverse covariance: residuals times it are independent and of unit
        variance.
        """
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)).T, np.float64)


def observations_of(stacks: SessionStacks) -> tuple[Observation, ...]:
    """Return the observations of every statistic that stacks show and parameters explain."""
    fitted = [
        statistic for statistic in observables() if statistic.tube in (None, stacks.camera.has_tube)
    ]
    observed: dict[str, list[Observation]] = {}
    # Those that stand in for others come after them.
    for statistic in sorted(fitted, key=lambda statistic: bool(statistic.unless)):
        if not any(observed.get(name) for name in statistic.unless):
            observed[statistic.name] = list(_observed(statistic, stacks))
    return tuple(part for statistic in fitted for part in observed.pop(statistic.name, ()))


def _observed(statistic: Observable[Any], stacks: SessionStacks) -> Iterator[Observation]:
    for case in statistic.cases(stacks):
        estimates, shown = case.estimates, case.of
        observed = Observation(
            name=case.label or statistic.name,
            value=estimates.value,
            covariance=estimates.covariance + statistic.model_covariance(estimates, shown),
            predict=lambda values, shown=shown: statistic.predict(values, shown),
            is_bound=statistic.is_bound,
            parameters=statistic.parameters(shown),
            ridge=statistic.ridge(shown),
            given_others=statistic.given_others,
        )
        if not statistic.moved_by or _is_moved(observed, stacks.camera, statistic.moved_by):
            yield observed


def _is_moved(observed: Observation, camera: Camera, paths: tuple[str, ...]) -> bool:
    """Whether any of the parameters moves a prediction by a standard error or more over its prior
    range.
    """
    known, values = camera.parameters(), values_of_description(camera)
    nominal = replace(observed, value=observed.predict(values)[0])
    shifted = (
        nominal.chi_squared({**values, path: np.array([float(end)])})[0]
        for path in paths
        if path in known
        for end in (known[path].low, known[path].high)
        if end is not None
    )
    return max(shifted, default=0.0) > 1.0


# Flags of a measurement that point to a stage of the camera or bench which the fit does not model.
# Others are of the target, the number of frames or the method.
CAUSES = {
    "agc": AUTOMATIC,
    "nonlinear": CURVED,
    "gamma": CURVED,
    "processed": PROCESSING,
    "correlated-noise": SPREAD,
    "drift": UNSTEADY,
    "flicker": UNSTEADY,
}
# What an observation that no parameters explain may come from, by its name.
CAUSES_OF_MISFIT = {
    "levels": CURVED,
    "photon-transfer": CURVED,
    "noise": Cause(
        stage=(
            f"{CURVED.stage}, or sharpening, interpolation or averaging of frames in camera or "
            f"grabber"
        ),
        remedy="raw frames of a gamma of 1, of the linear range only",
    ),
    "image lag": LAGGING,
    "covariance of neighbours in a row": SPREAD,
    "offsets of rows": SPREAD,
}


def has_automatic_gain(conditions: Conditions) -> bool:
    """Whether the gain of a stack is unknown, as a control of the camera or tube set it."""
    return bool(conditions.automatic_gain or conditions.brightness_control)


def findings_of(result: Result) -> tuple[Finding, ...]:
    """Return one finding for each flag of the measurements.

    The fit leaves measurements with most of these flags out, but not the levels and the noise of
    the same frames. Flags of the whole session, which are of its flats, count before those of
    single targets. The noise spectrum is left out: ions change its shape from level to level as a
    bend would.
    """
    measurements = [
        m for m in result.measurements if m.status != "refused" and m.method != "noise-spectrum"
    ]
    session_findings = _findings_among([m for m in measurements if m.stack is None])
    return session_findings or _findings_among(measurements)


def _findings_among(measurements: list[Measurement]) -> tuple[Finding, ...]:
    findings = []
    for flag, cause in CAUSES.items():
        flagged = [m for m in measurements if flag in m.flags]
        if flagged:
            notes = dict.fromkeys(
                n.partition(": ")[2] for m in flagged for n in m.notes if n.startswith(f"{flag}: ")
            )
            evidence = next(iter(notes), f"flag of {flagged[0].quantity}").partition(
                "; what settles it"
            )[0]
            findings.append(cause.finding(flag, evidence))
    return tuple(findings)


def misfit_finding(parts: dict[str, float], numbers: int, factor: float) -> Finding:
    """Return the finding of a misfit: the observation with most of it, and its likely cause.

    Parameters
    ----------
    parts
        Chi-squared of each observation by its name.
    numbers
        Number of observed numbers.
    factor
        Factor by which all errors are multiplied.
    """
    worst = max(parts, key=lambda name: parts[name])
    cause = CAUSES_OF_MISFIT.get(worst)
    effect = (
        f"chi-squared {sum(parts.values()):.0f} for {numbers} numbers, {parts[worst]:.0f} of it "
        f"from {worst.replace('-', ' ')}; all errors were multiplied by {factor:.1f}"
    )
    return Finding(
        flag="model-misfit",
        effect=effect if cause is None else f"{effect}; it may come from {cause.stage}",
        remedy="a description that fits the camera" if cause is None else cause.remedy,
    )
