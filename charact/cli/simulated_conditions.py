"""Settings of a simulated camera as conditions of a session: gain in lm/lm, volts or counts; gate, temperature."""

import math
from typing import Any

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.limits import TubeLimits
from labdata.sensor import Sensor
from labdata.solid_state import SolidStateCamera

# Options that speak of a tube, by the name of their condition.
_OF_A_TUBE = {
    "mcp_v": "--mcp-v",
    "gain_control": "--gain-control",
    "gate_ns": "--gate-ns",
    "brightness_control": "--brightness-control",
}


def conditions_of(camera: Sensor | SolidStateCamera, *, gain: float | None = None, **asked: Any) -> Conditions:
    """Return the conditions that options ask for, with what they leave open at its nominal value.

    Parameters
    ----------
    camera
        The description.
    gain
        Luminous gain of the tube, lm/lm, or multiplication of an electron-multiplying register.
    asked
        Conditions by name, None where the option was not given.

    Raises
    ------
    BadInput
        If an option does not suit the camera or another option.
    """
    given = {name: value for name, value in asked.items() if value is not None}
    if gain is not None and not (math.isfinite(gain) and gain > 0.0):
        raise BadInput(f"--gain must be positive, got {gain:g}")
    exposure_s = 1.0 / float(camera.video.field_rate_hz)
    if given.get("automatic_gain") and not camera.video.automatic_gain:
        raise BadInput(f"--automatic-gain needs a camera that has it, got {camera.name!r}")
    if isinstance(camera, SolidStateCamera):
        return Conditions(exposure_s=exposure_s, em_gain=_em_gain(camera, gain), **_without_tube(camera, given))
    if len(ways := [name for name in ("mcp_v", "gain_control") if name in given] + ["gain"] * (gain is not None)) > 1:
        raise BadInput(f"the gain must be set once, got {' and '.join('--' + way.replace('_', '-') for way in ways)}")
    nominal = {"gate_ns": exposure_s * 1e9, **({} if ways else {"mcp_v": voltage_of(camera, None)})}
    set_by_gain = {} if gain is None else {"mcp_v": voltage_of(camera, gain)}
    return Conditions(exposure_s=exposure_s, **{**nominal, **set_by_gain, **given})


def beyond_limit(camera: Sensor | SolidStateCamera, conditions: Conditions) -> tuple[str, ...]:
    """Say where the plate is asked for more than its description allows: no harm in a simulation, but on the bench."""
    asked = conditions.mcp_v
    if isinstance(camera, SolidStateCamera) or asked is None:
        return ()
    limit = camera.limits.mcp_v
    if limit == TubeLimits().mcp_v or asked <= float(limit):
        return ()
    return (f"mcp_v of {asked:.4g} exceeds the limit {float(limit):g} of {camera.name!r}: its bench would refuse it",)


def voltage_of(sensor: Sensor, luminous_gain: float | None) -> float:
    """Return the plate's voltage for a luminous gain, V = V0 (G/G0)^(1/m); the reference voltage without one."""
    plate = sensor.microchannel_plate
    if luminous_gain is None:
        return float(plate.reference_v)
    if not float(plate.gain_exponent) > 0.0:
        raise BadInput(f"--gain needs a tube whose gain follows its voltage, got the exponent 0 in {sensor.name!r}")
    return float(plate.reference_v) * (luminous_gain / float(sensor.tube.luminous_gain)) ** (
        1.0 / float(plate.gain_exponent)
    )


def _em_gain(camera: SolidStateCamera, gain: float | None) -> float:
    most = float(camera.register.em_gain)
    if gain is not None and not 1.0 <= gain <= most:
        raise BadInput(f"--gain of {camera.name!r} must lie between 1 and {most:g}, got {gain:g}")
    return most if gain is None else gain


def _without_tube(camera: SolidStateCamera, given: dict[str, Any]) -> dict[str, Any]:
    if unfit := [option for name, option in _OF_A_TUBE.items() if name in given]:
        raise BadInput(f"{unfit[0]} needs a camera with a tube, got {camera.name!r}")
    return given
