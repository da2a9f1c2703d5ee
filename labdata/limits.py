"""What a tube may never be asked: limits of the sensor description, tightened or openly overridden by a plan."""

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

from labdata.camera_description import Parameter, must_be_a_share, must_be_positive
from labdata.errors import BadInput

if TYPE_CHECKING:
    from labdata.sensor import Sensor


NA_PER_UA = 1e3
CM2_PER_M2 = 1e4
_SIDES_95 = 2 * 1.96


@dataclass(frozen=True, kw_only=True)
class TubeLoad:
    """Photocathode and plate as far as their current goes.

    Parameters
    ----------
    luminous_sensitivity_ua_per_lm
        Of the photocathode at 2856 K, uA/lm.
    electron_gain
        Electrons out of the plate per photoelectron, at reference_v.
    reference_v
        Voltage at which that gain is stated, V.
    gain_exponent
        m of G = G0 (V / V0)^m.
    saturated_na_per_cm2
        Current density at which the plate's gain has fallen to half, nA/cm2.
    ebi_lux
        Light that would draw the tube's dark current, lux.
    relative_sd
        Standard uncertainty of the current at reference_v, as that of its logarithm.
    exponent_sd
        Standard uncertainty of the exponent.
    """

    luminous_sensitivity_ua_per_lm: float
    electron_gain: float
    reference_v: float
    gain_exponent: float
    saturated_na_per_cm2: float
    ebi_lux: float = 0.0
    relative_sd: float
    exponent_sd: float = 0.0

    @classmethod
    def of(cls, sensor: "Sensor") -> "TubeLoad":
        """Return the load that a sensor's description tells."""
        cathode, plate = sensor.photocathode, sensor.microchannel_plate
        return cls(
            luminous_sensitivity_ua_per_lm=float(cathode.luminous_sensitivity_ua_per_lm),
            electron_gain=float(plate.electron_gain),
            reference_v=float(plate.reference_v),
            gain_exponent=float(plate.gain_exponent),
            saturated_na_per_cm2=float(plate.saturation_fraction) * float(plate.strip_current_ua_per_cm2) * NA_PER_UA,
            ebi_lux=float(cathode.ebi_lm_per_cm2) * CM2_PER_M2,
            relative_sd=math.hypot(_log_sd(cathode.luminous_sensitivity_ua_per_lm), _log_sd(plate.electron_gain)),
            exponent_sd=_sd(plate.gain_exponent),
        )

    def gain(self, mcp_v: float) -> float:
        """Electrons out of the plate per photoelectron at a voltage, V; no gain without voltage."""
        return self.electron_gain * (max(mcp_v, 0.0) / self.reference_v) ** self.gain_exponent

    def anode_na_per_cm2(self, illuminance_lux: float, mcp_v: float, duty: float) -> float:
        """Current density that light asks of the plate, nA/cm2.

        Parameters
        ----------
        illuminance_lux
            On the photocathode, lux.
        mcp_v
            Voltage across the plate, V.
        duty
            Share of the time that the gate is open.

        Notes
        -----
        j = E S G d with E the illuminance, S the luminous sensitivity, G the plate's gain, d the duty; a plate that
        saturates gives less, see `screen_na_per_cm2`.
        """
        cathode_ua_per_cm2 = illuminance_lux * self.luminous_sensitivity_ua_per_lm / CM2_PER_M2
        return cathode_ua_per_cm2 * NA_PER_UA * self.gain(mcp_v) * duty

    def screen_na_per_cm2(self, illuminance_lux: float, mcp_v: float, duty: float) -> float:
        """Current density that reaches the screen, nA/cm2, the dark current counted and saturation allowed for.

        Notes
        -----
        j / (1 + j / j_s) while the gate is open, the gain falling to half at j_s.
        """
        open_now = self.anode_na_per_cm2(illuminance_lux + self.ebi_lux, mcp_v, 1.0)
        return duty * open_now / (1.0 + open_now / self.saturated_na_per_cm2)

    def log_sd(self, mcp_v: float) -> float:
        """Standard uncertainty of the logarithm of the current at a voltage, V."""
        if not mcp_v > 0.0:
            return self.relative_sd
        return math.hypot(self.relative_sd, self.exponent_sd * (math.log(mcp_v) - math.log(self.reference_v)))


def _log_sd(parameter: Parameter) -> float:
    if parameter.low is None or parameter.high is None or parameter.low <= 0.0:
        return 0.0
    return math.log(parameter.high / parameter.low) / _SIDES_95


def _sd(parameter: Parameter) -> float:
    if parameter.low is None or parameter.high is None:
        return 0.0
    return (parameter.high - parameter.low) / _SIDES_95


CAUTIOUS_LOAD = TubeLoad(
    luminous_sensitivity_ua_per_lm=2700.0,
    electron_gain=1000.0,
    reference_v=800.0,
    gain_exponent=12.0,
    saturated_na_per_cm2=200.0,
    relative_sd=1.0,
    exponent_sd=1.0,
)
"""A strong cathode and a strong plate, for a tube that nobody described."""


_UNKNOWN = "nothing is known of this tube: "


def _cautious(value: float, reason: str) -> Parameter:
    return Parameter(value=value, standing="default", source=_UNKNOWN + reason)


@dataclass(frozen=True, kw_only=True)
class TubeLimits:
    """Limits of a tube, each with its reason as the source of its parameter; the defaults suit a tube nobody described.

    Parameters
    ----------
    mcp_v
        Highest voltage across the microchannel plate, V.
    ramp_v_per_s
        Fastest rise of that voltage, V/s.
    gate_ns
        Longest opening of the gate, ns.
    gate_duty
        Largest share of the time that the gate may be open.
    illuminance_lux
        Brightest large area on the photocathode, lux, whatever the gain.
    point_illuminance_lux
        Brightest image of a pinhole on the photocathode, lux, whatever the gain.
    anode_na_per_cm2
        Largest mean current density that light may ask of the plate at the present gain and duty, nA/cm2.
    point_anode_na_per_cm2
        The same inside the image of a pinhole, whose plate gives far less than is asked.
    screen_charge_c_per_cm2
        Charge through the screen after which the cathode is expected to have aged, C/cm2; warned of, never refused.
    """

    mcp_v: Parameter = field(
        default_factory=lambda: _cautious(900.0, "a single plate works at 500 to 900 V, never above 1000 V")
    )
    ramp_v_per_s: Parameter = field(
        default_factory=lambda: _cautious(50.0, "small steps let a plate outgas; slower after storage")
    )
    gate_ns: Parameter = field(default_factory=lambda: _cautious(2e7, "one field of 50 Hz video"))
    gate_duty: Parameter = field(
        default_factory=lambda: _cautious(0.999, "a gate unit needs to recover between pulses")
    )
    illuminance_lux: Parameter = field(
        default_factory=lambda: _cautious(1e-2, "night sky with a moon; a supply protects its tube above this")
    )
    point_illuminance_lux: Parameter = field(
        default_factory=lambda: _cautious(10.0, "too small an area to strain the tube, but the cathode ages there")
    )
    anode_na_per_cm2: Parameter = field(
        default_factory=lambda: _cautious(100.0, "a tenth of a strip current of 1 uA/cm2 keeps the plate linear")
    )
    point_anode_na_per_cm2: Parameter = field(
        default_factory=lambda: _cautious(3e6, "what 10 lux ask of a gain of 1000; the plate gives its strip current")
    )
    screen_charge_c_per_cm2: Parameter = field(
        default_factory=lambda: _cautious(0.1, "uncoated plates age their cathodes within 0.1 to 1 C/cm2")
    )

    def __post_init__(self) -> None:
        must_be_positive(self, *(item.name for item in fields(self)))
        must_be_a_share(self, "gate_duty")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a plan says that it will never exceed; None: the tube's own limit. It can only be tighter than that.

    Names and units are those of `TubeLimits`.
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
        for name in LIMITS:
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise BadInput(f"the limit {name} must be positive, got {value:g}")


@dataclass(frozen=True, kw_only=True)
class Override:
    """A limit of the tube that a plan sets aside, and why; written into the session and printed in its report.

    Parameters
    ----------
    limit
        Name of the limit, see `TubeLimits`.
    value
        What holds instead, in the unit of the name.
    reason
        Why, in words.
    """

    limit: str
    value: float
    reason: str

    def __post_init__(self) -> None:
        if self.limit not in LIMITS:
            raise BadInput(f"an override must name one of {', '.join(LIMITS)}, got {self.limit!r}")
        if not self.value > 0:
            raise BadInput(f"an override must be positive, got {self.value:g} for {self.limit}")
        if not self.reason.strip():
            raise BadInput(f"an override must say its reason, got none for {self.limit}")


@dataclass(frozen=True, kw_only=True)
class LimitsInForce:
    """The limits that hold, each a number, and the tube that they protect.

    Parameters
    ----------
    load
        How much current light draws from the plate.
    overridden
        One sentence for each limit of the tube that a plan set aside; the session keeps them, its report prints them.
    known
        Whether a sensor described the tube.

    Names and units of the others are those of `TubeLimits`.
    """

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
        """Brightest light that is ever allowed, lux."""
        return self.point_illuminance_lux if point else self.illuminance_lux

    def largest_anode_na_per_cm2(self, *, point: bool) -> float:
        """Largest current density that may be asked of the plate, nA/cm2."""
        return self.point_anode_na_per_cm2 if point else self.anode_na_per_cm2


OVERRIDDEN = "The tube's limit"
"""How the sentence of an overridden limit begins."""

LIMITS = tuple(item.name for item in fields(Limits))
"""Names of the limits that a plan can tighten or override."""


def limits_in_force(
    asked: Limits = Limits(),
    sensor: "Sensor | None" = None,
    overrides: tuple[Override, ...] = (),
) -> LimitsInForce:
    """Return the limits that hold: the tube's, tightened by a plan, save what the plan overrides with a reason.

    Parameters
    ----------
    asked
        The plan's own limits. Where no sensor describes the tube, they stand alone.
    sensor
        Description of the camera; None: unknown, and the cautious defaults hold where the plan says nothing.
    overrides
        Limits of the tube that the plan sets aside.

    Raises
    ------
    BadInput
        If the plan's limit exceeds the tube's without an override, or one limit is overridden twice.
    """
    if len({one.limit for one in overrides}) < len(overrides):
        raise BadInput(f"a limit can be overridden once, got {[one.limit for one in overrides]}")
    tube = TubeLimits() if sensor is None else sensor.limits
    instead = {one.limit: one for one in overrides}
    values = {name: _in_force(name, getattr(asked, name), tube, instead, known=sensor is not None) for name in LIMITS}
    load = CAUTIOUS_LOAD if sensor is None else TubeLoad.of(sensor)
    overridden = tuple(_overridden(one, getattr(tube, one.limit)) for one in overrides)
    return LimitsInForce(**values, load=load, overridden=overridden, known=sensor is not None)


def _in_force(name: str, asked: float | None, tube: TubeLimits, instead: dict[str, Override], *, known: bool) -> float:
    if name in instead:
        return min(instead[name].value, asked or instead[name].value)
    own = float(getattr(tube, name))
    if asked is None:
        return own
    if known and asked > own:
        raise BadInput(
            f"limits.{name} must not exceed the tube's {own:g} ({getattr(tube, name).source}), got {asked:g}; "
            f"an [[override]] with a reason sets it aside"
        )
    return asked


def _overridden(one: Override, own: Parameter) -> str:
    return f"{OVERRIDDEN} {one.limit} of {own.value:g} ({own.source}) was overridden to {one.value:g}: {one.reason}."
