"""What holds for every high-voltage supply: when the output counts as discharged, and which voltages can be asked."""

from labdata.errors import BadInput

FALL_S = 15.0
"""Time within which an output must have discharged after off, s."""

DISCHARGED_V = 10.0
"""Voltage at the output that counts as none, V."""

_ROUNDING = 1e-6


def check_voltage(volts: float, *, lowest_v: float, highest_v: float, step_v: float) -> None:
    """Refuse a voltage that a supply cannot hold.

    Parameters
    ----------
    volts
        Voltage asked, V.
    lowest_v, highest_v
        What the supply can put out, V.
    step_v
        Its resolution, V.

    Raises
    ------
    BadInput
        If the voltage lies outside, or between two steps, where the supply would round it in silence.
    """
    if not volts >= lowest_v:
        raise BadInput(f"mcp_v must be 0 (off) or at least {lowest_v:g}, got {volts:g}")
    if volts > highest_v:
        raise BadInput(f"mcp_v must not exceed the supply's {highest_v:g}, got {volts:g}")
    if abs(volts / step_v - round(volts / step_v)) > _ROUNDING:
        raise BadInput(f"mcp_v must be a multiple of the supply's {step_v:g} V, got {volts:.10g}")
