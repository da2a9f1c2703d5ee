"""Measurements of a session that take part in a fit."""

from labdata import Measurement, Result

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


def admissible_measurements(
    result: Result, quantity: str, unit: str | None = None
) -> list[Measurement]:
    """Return the measurements of a quantity with status ok, or where there are none the suspect
    ones whose flags all add no bias.
    """
    admissible = [
        m
        for m in result.find(quantity)
        if m.interval68 is not None and set(m.flags) <= MILD and unit in (None, m.unit)
    ]
    return [m for m in admissible if m.status == "ok"] or admissible


def sd_of(m: Measurement) -> float:
    """Return half the 68 % interval: the standard deviation of a Gaussian one."""
    low, high = m.interval68 or (float("nan"), float("nan"))
    return (high - low) / (2.0 * 0.994458)
