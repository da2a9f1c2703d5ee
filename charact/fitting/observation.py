"""Observations of the fit: measured numbers with covariance and predicted quantity; likely causes
of a misfit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

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
from charact.observables import Stacks, Values, observables
from charact.observables.photon_transfer import PhotonTransfer
from charact.verdict import Finding
from labdata import Array, Conditions, Measurement, Result

# Flags that add no bias; any other flag excludes a measurement from the fit.
MILD = {
    "defects",
    "drift",
    "flicker",
    "gradient",
    "low-signal",
    "not-converged",
    "prior-bound",
    "too-few-frames",
}


def is_admissible(m: Measurement) -> bool:
    """Whether a measurement is ok, or suspect only for reasons that add no bias."""
    return m.status != "refused" and m.interval68 is not None and set(m.flags) <= MILD


def admissible_measurements(
    result: Result, quantity: str, unit: str | None = None
) -> list[Measurement]:
    """Return the measurements of a quantity with status ok, or the mildly suspect ones where there
    are none.
    """
    admissible = [m for m in result.find(quantity) if is_admissible(m) and unit in (None, m.unit)]
    return [m for m in admissible if m.status == "ok"] or admissible


def sd_of(m: Measurement) -> float:
    """Return half the 68 % interval: the standard deviation of a Gaussian one."""
    low, high = m.interval68 or (float("nan"), float("nan"))
    return (high - low) / (2.0 * 0.994458)


Predict = Callable[[Values], Array]


@dataclass(frozen=True, kw_only=True)
class Ridge:
    """Surface on which a posterior is narrow: a number of many parameters that is known far better
    than any of them.

    In coordinates with the number itself in place of one parameter the surface is a plane.
    """

    carrier: str  # path of the parameter
    number: Predict  # values of shape (n,) each -> (n,)
    slope: float  # change of the number with the coordinate of the carrier, the same everywhere


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Measured numbers with Gaussian errors and their predicted values."""

    name: str  # name of the quantity, for messages
    value: Array  # measured numbers, shape (k,)
    covariance: Array  # covariance of their errors, model error included, shape (k, k)
    predict: Predict  # predictions for parameter draws: values of shape (n,) each -> (n, k)
    is_bound: bool = False  # whether a prediction beyond the value agrees
    parameters: tuple[str, ...]  # paths of the sensor parameters that it depends on
    # the product that it determines far better than any of its parameters
    ridge: "Ridge | None" = None

    def chi_squared(self, values: Values) -> Array:
        """Return each draw's chi squared, shape (n,)."""
        whitened_residuals = (self.predict(values) - self.value) @ self._whitening
        return np.sum(whitened_residuals**2, axis=1)

    def scale_errors(self, factor: float) -> "Observation":
        """Return the same numbers with all errors larger by a factor."""
        return replace(self, covariance=self.covariance * factor**2)

    @cached_property
    def _whitening(self) -> Array:
        """Root of the inverse covariance: residuals times it are independent and of unit
        variance.
        """
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)).T, np.float64)


def observations_of(stacks: Stacks) -> dict[str, Observation]:
    """Return the observation of every statistic that stacks show and parameters explain, by name.

    The photon transfer curve of a session whose gain is not admissible is left out: its flats do
    not follow the law.
    """
    gains = (("system_gain", "DN/e-"), ("covariance_gain", "DN"))
    is_lawful = any(admissible_measurements(stacks.result, *gain) for gain in gains)
    observed = {}
    for statistic in observables():
        usable = statistic.usable(stacks)
        if usable is None or (statistic.name == PhotonTransfer.name and not is_lawful):
            continue
        if parameters := statistic.parameters(usable):
            estimates = statistic.measure(usable)
            observed[statistic.name] = Observation(
                name=statistic.name,
                value=estimates.value,
                covariance=estimates.covariance + statistic.model_covariance(estimates, usable),
                predict=partial(statistic.predict, stacks=usable),
                parameters=parameters,
            )
    return observed


def scalar_observation(
    name: str,
    value: float,
    sd: float,
    predict: Callable[[Values], Array],
    parameters: tuple[str, ...],
) -> Observation:
    """Return an observation of one number; its prediction has shape (n,)."""
    return Observation(
        name=name,
        value=np.array([value]),
        covariance=np.array([[sd**2]]),
        predict=lambda values: predict(values)[:, None],
        parameters=parameters,
    )


def at_least(
    name: str,
    value: float,
    sd: float,
    predict: Callable[[Values], Array],
    parameters: tuple[str, ...],
) -> Observation:
    """Return the observation of a lower bound: a prediction above it agrees."""
    bound = scalar_observation(
        name, value, sd, lambda values: np.minimum(predict(values), value), parameters
    )
    return replace(bound, is_bound=True)


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
