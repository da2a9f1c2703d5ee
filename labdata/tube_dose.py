"""What a tube has been through: charge through its screen and hours at gain, with how well they are known."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from labdata.errors import BadInput

if TYPE_CHECKING:
    from labdata.sensor import Sensor

WARN_AT = 0.8
"""Share of a tube's life from which on it is warned of."""

S_PER_H = 3600.0
C_PER_NC = 1e-9


@dataclass(frozen=True, kw_only=True)
class Dose:
    """What a tube went through.

    Parameters
    ----------
    screen_c_per_cm2
        Charge through the brightest large area of the screen, C/cm2.
    point_c_per_cm2
        Charge through the images of pinholes, as if they all fell on one place, C/cm2.
    hours_at_gain
        Time with high voltage across the plate, h.
    log_sd
        Standard uncertainty of the logarithm of both charges: photocathode and plate are known only so well.
    """

    screen_c_per_cm2: float = 0.0
    point_c_per_cm2: float = 0.0
    hours_at_gain: float = 0.0
    log_sd: float = 0.0

    def __post_init__(self) -> None:
        for name in ("screen_c_per_cm2", "point_c_per_cm2", "hours_at_gain", "log_sd"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise BadInput(f"{name} must be finite and not negative, got {getattr(self, name)}")

    @property
    def charge_c_per_cm2(self) -> float:
        """Charge through the place of the screen that had most, C/cm2."""
        return self.screen_c_per_cm2 + self.point_c_per_cm2

    @property
    def factor95(self) -> float:
        """Factor by which the charge may be more or less, with 95 % probability."""
        return math.exp(1.96 * self.log_sd)


def total_dose(doses: Iterable[Dose]) -> Dose:
    """Return all doses together; their uncertainty is one and the same tube's, so it does not average out."""
    doses = tuple(doses)
    charge = sum(one.charge_c_per_cm2 for one in doses)
    weighted = sum(one.charge_c_per_cm2 * one.log_sd for one in doses)
    return Dose(
        screen_c_per_cm2=sum(one.screen_c_per_cm2 for one in doses),
        point_c_per_cm2=sum(one.point_c_per_cm2 for one in doses),
        hours_at_gain=sum(one.hours_at_gain for one in doses),
        log_sd=weighted / charge if charge else max((one.log_sd for one in doses), default=0.0),
    )


def dose_of(*, delivered_na_per_cm2: float, lit_s: float, at_gain_s: float, point: bool, log_sd: float) -> Dose:
    """Return the dose of a time under one current density.

    Parameters
    ----------
    delivered_na_per_cm2
        Current density that reaches the screen, nA/cm2.
    lit_s
        For how long, s.
    at_gain_s
        Time with high voltage on, s.
    point
        Whether only a pinhole's image was lit.
    log_sd
        Standard uncertainty of the logarithm of the current.
    """
    charge = delivered_na_per_cm2 * C_PER_NC * lit_s
    return Dose(
        screen_c_per_cm2=0.0 if point else charge,
        point_c_per_cm2=charge if point else 0.0,
        hours_at_gain=at_gain_s / S_PER_H,
        log_sd=log_sd,
    )


def warnings(dose: Dose, sensor: "Sensor | None") -> tuple[str, ...]:
    """Return one sentence for each part of a tube's life that is nearly or wholly used up."""
    from labdata.limits import TubeLimits

    limits = TubeLimits() if sensor is None else sensor.limits
    told = [
        _life_warning("screen charge", dose.charge_c_per_cm2, float(limits.screen_charge_c_per_cm2), "C/cm2"),
        None if sensor is None else _life_warning("time at gain", dose.hours_at_gain, float(sensor.tube.life_h), "h"),
    ]
    return tuple(one for one in told if one)


def _life_warning(what: str, amount: float, life: float, unit: str) -> str | None:
    if amount < WARN_AT * life:
        return None
    return f"The tube's {what} is {amount:.3g} {unit}, {amount / life:.0%} of the {life:g} {unit} expected of its life."
