"""Limits of a tube from its sensor description, tightened or overridden by a plan."""

import math
from dataclasses import dataclass, fields

from labdata.camera.description import Camera
from labdata.camera.parameters import Parameter
from labdata.camera.tube import TubeLimits
from labdata.errors import BadInput, check

NA_PER_UA = 1e3
CM2_PER_M2 = 1e4
_SIDES_95 = 2 * 1.96


@dataclass(frozen=True, kw_only=True)
class TubeLoad:
    """Current through photocathode and MCP."""

    #: Luminous sensitivity of the photocathode at 2856 K, uA/lm
    luminous_sensitivity_ua_per_lm: float
    electron_gain: float  #: Electron gain of the MCP at reference_v
    reference_v: float  #: Voltage of that gain, V
    gain_exponent: float  #: m of G = G0 (V / V0)^m
    saturated_na_per_cm2: float  #: Output current density at which the MCP gain has halved, nA/cm2
    ebi_lux: float = 0.0  #: Equivalent background illumination, lux
    relative_sd: float  #: Standard uncertainty of the logarithm of the current at reference_v
    exponent_sd: float = 0.0  #: Standard uncertainty of the exponent

    @classmethod
    def of(cls, sensor: Camera) -> "TubeLoad":
        """Return the load model of a sensor description."""
        cathode, plate = sensor.photocathode, sensor.microchannel_plate
        return cls(
            luminous_sensitivity_ua_per_lm=float(cathode.luminous_sensitivity_ua_per_lm),
            electron_gain=float(plate.electron_gain),
            reference_v=float(plate.reference_v),
            gain_exponent=float(plate.gain_exponent),
            saturated_na_per_cm2=float(plate.saturation_fraction)
            * float(plate.strip_current_ua_per_cm2)
            * NA_PER_UA,
            ebi_lux=float(cathode.ebi_lm_per_cm2) * CM2_PER_M2,
            relative_sd=math.hypot(
                _log_sd(cathode.luminous_sensitivity_ua_per_lm), _log_sd(plate.electron_gain)
            ),
            exponent_sd=_sd(plate.gain_exponent),
        )

    def gain(self, mcp_v: float) -> float:
        """Return the electron gain of the MCP at a voltage, V; 0 without voltage."""
        return self.electron_gain * (max(mcp_v, 0.0) / self.reference_v) ** self.gain_exponent

    def anode_na_per_cm2(self, illuminance_lux: float, mcp_v: float, duty: float) -> float:
        """Return the MCP output current density j = E S G d without saturation, nA/cm2.

        E is the illuminance on the photocathode, lux, S the luminous sensitivity, G the electron
        gain at `mcp_v` and d the fraction of the time that the gate is open.
        """
        cathode_ua_per_cm2 = illuminance_lux * self.luminous_sensitivity_ua_per_lm / CM2_PER_M2
        return cathode_ua_per_cm2 * NA_PER_UA * self.gain(mcp_v) * duty

    def screen_na_per_cm2(self, illuminance_lux: float, mcp_v: float, duty: float) -> float:
        """Return the current density at the phosphor, nA/cm2: j / (1 + j / j_s) with dark current
        at an open gate.
        """
        open_now = self.anode_na_per_cm2(illuminance_lux + self.ebi_lux, mcp_v, 1.0)
        return duty * open_now / (1.0 + open_now / self.saturated_na_per_cm2)

    def log_sd(self, mcp_v: float) -> float:
        """Return the standard uncertainty of the logarithm of the current at a voltage, V."""
        if not mcp_v > 0.0:
            return self.relative_sd
        return math.hypot(
            self.relative_sd, self.exponent_sd * (math.log(mcp_v) - math.log(self.reference_v))
        )


def _log_sd(parameter: Parameter) -> float:
    if parameter.low is None or parameter.high is None or parameter.low <= 0.0:
        return 0.0
    return math.log(parameter.high / parameter.low) / _SIDES_95


def _sd(parameter: Parameter) -> float:
    if parameter.low is None or parameter.high is None:
        return 0.0
    return (parameter.high - parameter.low) / _SIDES_95


# Sensitive photocathode and high MCP gain, for an unknown tube
CAUTIOUS_LOAD = TubeLoad(
    luminous_sensitivity_ua_per_lm=2700.0,
    electron_gain=1000.0,
    reference_v=800.0,
    gain_exponent=12.0,
    saturated_na_per_cm2=200.0,
    relative_sd=1.0,
    exponent_sd=1.0,
)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a plan, named as in `TubeLimits`; None: the tube's limit, which a plan can only
    tighten.
    """

    mcp_v: float | None = None
    ramp_v_per_s: float | None = None
    gate_ns: float | None = None
    gate_duty: float | None = None
    illuminance_lux: float | None = None
    point_illuminance_lux: float | None = None
    anode_na_per_cm2: float | None = None
    point_anode_na_per_cm2: float | None = None

    def __post_init__(self) -> None:
        check(self, of=" of the limits", positive=LIMITS)


@dataclass(frozen=True, kw_only=True)
class Override:
    """A limit of the tube that a plan overrides, with its reason; kept in the session and printed
    in its report.
    """

    limit: str  #: Name of the limit, see `TubeLimits`
    value: float  #: Value in force instead, in the unit of the name
    reason: str  #: Reason, as text

    def __post_init__(self) -> None:
        if self.limit not in LIMITS:
            raise BadInput(f"an override must name one of {', '.join(LIMITS)}, got {self.limit!r}")
        if not self.value > 0:
            raise BadInput(f"an override must be positive, got {self.value:g} for {self.limit}")
        if not self.reason.strip():
            raise BadInput(f"an override must say its reason, got none for {self.limit}")


@dataclass(frozen=True, kw_only=True)
class LimitsInForce:
    """Limits in force, as numbers, named as in `TubeLimits`."""

    mcp_v: float
    ramp_v_per_s: float
    gate_ns: float
    gate_duty: float
    illuminance_lux: float
    point_illuminance_lux: float
    anode_na_per_cm2: float
    point_anode_na_per_cm2: float
    load: TubeLoad
    overridden: tuple[str, ...] = ()
    known: bool = True

    def largest_lux(self, *, point: bool) -> float:
        """Largest illuminance allowed at any gain, lux."""
        return self.point_illuminance_lux if point else self.illuminance_lux

    def largest_anode_na_per_cm2(self, *, point: bool) -> float:
        """Largest MCP output current density allowed, nA/cm2."""
        return self.point_anode_na_per_cm2 if point else self.anode_na_per_cm2


OVERRIDDEN = "The tube's limit"  # First words of the sentence on an overridden limit
# Names of the limits that a plan can tighten or override
LIMITS = tuple(item.name for item in fields(Limits))


def limits_in_force(
    asked: Limits = Limits(), sensor: Camera | None = None, overrides: tuple[Override, ...] = ()
) -> LimitsInForce:
    """Return the limits in force: those of the tube, tightened or overridden by the plan.

    Parameters
    ----------
    asked
        Limits of the plan. Without a sensor description they are not compared with the tube's.
    sensor
        Sensor description; None: unknown, and the cautious defaults apply where the plan has no
        limit.
    overrides
        Limits of the tube that the plan overrides; any other plan above the tube's limit is
        BadInput.
    """
    if len({override.limit for override in overrides}) < len(overrides):
        raise BadInput(
            f"a limit can be overridden once, got {[override.limit for override in overrides]}"
        )
    tube = TubeLimits() if sensor is None else sensor.limits
    instead = {override.limit: override for override in overrides}
    values = {
        name: _in_force(name, getattr(asked, name), tube, instead, known=sensor is not None)
        for name in LIMITS
    }
    load = CAUTIOUS_LOAD if sensor is None else TubeLoad.of(sensor)
    limits_of_tube = {override.limit: getattr(tube, override.limit) for override in overrides}
    overridden = tuple(
        f"{OVERRIDDEN} {name} of {limit.value:g} ({limit.source}) was overridden to "
        f"{instead[name].value:g}: {instead[name].reason}."
        for name, limit in limits_of_tube.items()
    )
    return LimitsInForce(**values, load=load, overridden=overridden, known=sensor is not None)


def _in_force(
    name: str, asked: float | None, tube: TubeLimits, instead: dict[str, Override], *, known: bool
) -> float:
    if name in instead:
        return min(instead[name].value, asked or instead[name].value)
    limit = getattr(tube, name)
    if asked is None:
        return float(limit)
    if known and asked > float(limit):
        raise BadInput(
            f"limits.{name} must not exceed the tube's {float(limit):g} ({limit.source}), "
            f"got {asked:g}; an [[override]] with a reason sets it aside"
        )
    return asked
