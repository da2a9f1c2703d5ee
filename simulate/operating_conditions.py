"""A described camera, and the conditions under which it is operated."""

import math
from typing import Any

from labdata import BadInput, Camera, Conditions
from labdata.camera.tube import TubeLimits

# Conditions of a tube.
_OF_A_TUBE = ("mcp_v", "gain_control", "gate_ns", "brightness_control")


def load_described_camera(sensor: str, phosphor: str | None = None) -> Camera:
    """Return the sensor description of a camera, with another phosphor if one is given."""
    from labdata import load_camera, load_phosphor

    camera = load_camera(sensor)
    if phosphor is None:
        return camera
    if not camera.has_tube:
        raise BadInput(f"phosphor needs a camera with a tube, got {camera.name!r}")
    return camera.with_phosphor(load_phosphor(phosphor))


def conditions_of(camera: Camera, *, gain: float | None = None, **options: Any) -> Conditions:
    """Return the conditions of the options that are not None; others have their nominal values.

    `gain`: luminous gain of the tube, lm/lm, or multiplication of an electron-multiplying register.
    Raises BadInput if an option does not apply to the camera or conflicts with another one.
    """
    values = {name: value for name, value in options.items() if value is not None}
    if gain is not None and not (math.isfinite(gain) and gain > 0.0):
        raise BadInput(f"gain must be positive, got {gain:g}")
    exposure_s = 1.0 / float(camera.video.field_rate_hz)
    if camera.is_thermal:
        if tube_options := [*values, *(["gain"] if gain is not None else [])]:
            raise BadInput(
                f"{tube_options[0]} needs a camera of visible light, got {camera.name!r}"
            )
        cooled = camera.cooled_array
        return Conditions(
            exposure_s=exposure_s if cooled is None else 1e-3 * float(cooled.integration_ms)
        )
    if values.get("automatic_gain") and not camera.video.automatic_gain:
        raise BadInput(f"automatic_gain needs a camera that has it, got {camera.name!r}")
    if not camera.has_tube:
        highest_gain = float(camera.register.em_gain)
        if gain is not None and not 1.0 <= gain <= highest_gain:
            raise BadInput(
                f"gain of {camera.name!r} must lie between 1 and {highest_gain:g}, got {gain:g}"
            )
        if tube_options := [name for name in _OF_A_TUBE if name in values]:
            raise BadInput(f"{tube_options[0]} needs a camera with a tube, got {camera.name!r}")
        return Conditions(
            exposure_s=exposure_s, em_gain=highest_gain if gain is None else gain, **values
        )
    gain_options = [name for name in ("mcp_v", "gain_control") if name in values]
    if len(gain_options := [*gain_options, *(["gain"] if gain is not None else [])]) > 1:
        raise BadInput(f"the gain must be set once, got {' and '.join(gain_options)}")
    nominal: dict[str, Any] = {"gate_ns": exposure_s * 1e9}
    if gain is not None or not gain_options:
        nominal["mcp_v"] = voltage_of(camera, gain)
    return Conditions(exposure_s=exposure_s, **{**nominal, **values})


def voltage_of(sensor: Camera, luminous_gain: float | None) -> float:
    """Return the MCP voltage for a luminous gain, V = V0 (G/G0)^(1/m); None: the reference
    voltage.
    """
    mcp = sensor.microchannel_plate
    if luminous_gain is None:
        return float(mcp.reference_v)
    if not (exponent := float(mcp.gain_exponent)) > 0.0:
        raise BadInput(f"gain needs a tube with a positive gain exponent, got 0 in {sensor.name!r}")
    return float(mcp.reference_v) * (luminous_gain / float(sensor.tube.luminous_gain)) ** (
        1.0 / exponent
    )


def voltage_limit_warnings(camera: Camera, conditions: Conditions) -> tuple[str, ...]:
    """Return a warning if the MCP voltage exceeds the limit of the description, which the bench
    would refuse.
    """
    mcp_v = conditions.mcp_v
    if not camera.has_tube or mcp_v is None:
        return ()
    limit = camera.limits.mcp_v
    if limit == TubeLimits().mcp_v or mcp_v <= float(limit):
        return ()
    return (
        (
            f"mcp_v of {mcp_v:.4g} exceeds the limit {float(limit):g} of {camera.name!r}: its "
            "bench would refuse it"
        ),
    )
