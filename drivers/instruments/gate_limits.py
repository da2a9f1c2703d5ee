"""What holds for the pulse of every gate generator: it fits between two triggers and is no finer than a step."""

from labdata.errors import BadInput

# Rounding that changes nothing which could be measured, relative to the pulse: a field time is no multiple of 5 ps.
_UNSEEN = 1e-6


def check_pulse(width_ns: float, *, rate_hz: float, delay_ns: float, step_ns: float, dead_ns: float) -> None:
    """Refuse a pulse that a generator cannot make.

    Parameters
    ----------
    width_ns, delay_ns
        Width, and delay after the trigger, ns.
    rate_hz
        Triggers a second, Hz.
    step_ns
        Resolution of the generator, ns.
    dead_ns
        Time after the longest delay before the next trigger is taken, ns.

    Raises
    ------
    BadInput
        If the pulse is not over before the next trigger, or the generator would round width or delay by more than a
        millionth of the pulse.
    """
    longest_ns = 1e9 / rate_hz - dead_ns - delay_ns
    if not step_ns <= width_ns <= longest_ns:
        raise BadInput(
            f"gate_ns must lie between {step_ns:g} and {longest_ns:.0f} at {rate_hz:g} triggers a second, "
            f"got {width_ns:g}"
        )
    if not delay_ns >= 0.0:
        raise BadInput(f"the delay of the gate must not be negative, got {delay_ns:g} ns")
    for name, value_ns in (("gate_ns", width_ns), ("the delay of the gate, ns,", delay_ns)):
        if abs(value_ns - step_ns * round(value_ns / step_ns)) > _UNSEEN * max(width_ns, value_ns):
            raise BadInput(f"{name} must be a multiple of the generator's {step_ns:g} ns, got {value_ns:.12g}")
