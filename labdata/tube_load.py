"""How much current light draws from a tube's microchannel plate, and how well that is known."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from labdata.parameter import Parameter

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
