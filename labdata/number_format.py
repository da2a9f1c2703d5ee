"""Number format: values rounded to their uncertainty."""

import math
from typing import TYPE_CHECKING

from labdata.quantity import QUANTITIES

if TYPE_CHECKING:
    from labdata.measurement import Interval, Measurement

MINUS = "−"
SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def round_to_spread(value: float, spread: float | None = None) -> str:
    """Return a number with two digits of its standard uncertainty, or four significant digits if
    that is unknown.

    An uncertainty of None, 0 or not finite is unknown.
    """
    exponent, digits = _format(value, spread)
    return _with_power(_mantissa(value, exponent, digits), exponent)


def _format(value: float, spread: float | None) -> tuple[int, int]:
    """Return the power of ten to factor out (0: none) and the digits after the point, for a value
    and uncertainty.
    """
    if not math.isfinite(value):
        return 0, 0
    known = spread is not None and math.isfinite(spread) and spread > 0
    last = _exponent(spread) - 1 if known and spread else _exponent(value) - 3
    first = max(_exponent(value), last)
    if first < -4 or first > 5 or last > 0:
        return first, max(first - last, 0)
    return 0, max(-last, 0)


def _exponent(value: float) -> int:
    """Return the decimal exponent of a number; 0 for zero."""
    return math.floor(math.log10(abs(value))) if value else 0


def _mantissa(value: float, exponent: int, digits: int) -> str:
    """Return a number divided by a power of ten, as text."""
    if math.isnan(value):
        return "not a number"
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    return f"{value / 10.0**exponent:.{digits}f}".replace("-", MINUS)


def _with_power(text: str, exponent: int) -> str:
    """Return the text with a power of ten."""
    return text if exponent == 0 else f"{text} × 10{str(exponent).translate(SUPERSCRIPTS)}"


def spread_of(measurement: "Measurement") -> float | None:
    """Return the standard uncertainty: half the 68 % interval, else a quarter of the 95 %
    interval.
    """
    for interval, scale in ((measurement.interval68, 2.0), (measurement.interval95, 4.0)):
        if interval is not None:
            return (interval[1] - interval[0]) / scale
    return None


def quantity_title(m: "Measurement") -> str:
    """Return the title of a quantity with its frequency, if any."""
    title = QUANTITIES[m.quantity].title
    return (
        title
        if m.frequency_cy_per_px is None
        else title.replace("the stated frequency", f"{m.frequency_cy_per_px:.4g} cy/px")
    )


def value_text(measurement: "Measurement") -> str:
    """Return the value of a measurement as text; an em dash if refused."""
    return (
        "—"
        if measurement.value is None
        else round_to_spread(measurement.value, spread_of(measurement))
    )


def interval_text(measurement: "Measurement", interval: "Interval | None") -> str:
    """Return the limits of an interval with the digits of the value; "unknown" without interval."""
    if measurement.value is None or interval is None:
        return "—" if measurement.value is None else "unknown"
    exponent, digits = _format(measurement.value, spread_of(measurement))
    ends = " … ".join(_mantissa(end, exponent, digits) for end in interval)
    return _with_power(f"({ends})" if exponent else ends, exponent)


def plus_minus(measurement: "Measurement") -> str:
    """Return the value ± its 95 % interval as text."""
    if measurement.value is None or measurement.interval95 is None:
        return value_text(measurement)
    low, high = measurement.interval95
    if low == high:  # exact: a count, or a limit of the pixels
        is_integer = float(measurement.value).is_integer()
        return f"{measurement.value:.0f}" if is_integer else round_to_spread(measurement.value)
    exponent, digits = _format(measurement.value, spread_of(measurement))
    numbers = (measurement.value, high - measurement.value, measurement.value - low)
    value, up, down = (_mantissa(number, exponent, digits) for number in numbers)
    text = f"{value} ± {up}" if up == down else f"{value} +{up} {MINUS}{down}"
    return _with_power(f"({text})" if exponent else text, exponent)


def plus_minus_of(value: float, low: float, high: float) -> str:
    """Return a value ± the arms of its interval as text."""
    spread = (high - low) / 4.0
    up, down = (round_to_spread(arm, spread) for arm in (high - value, value - low))
    text = round_to_spread(value, spread)
    return f"{text} ± {up}" if up == down else f"{text} +{up} {MINUS}{down}"


def short_text(value: object) -> str:
    """Return a setting or condition as short text."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "unknown"}[value]
    if isinstance(value, float):
        mantissa, _, power = f"{value:.5g}".partition("e")
        return _with_power(mantissa.replace("-", MINUS), int(power or 0))
    if isinstance(value, (list, tuple)):
        return ", ".join(short_text(item) for item in value)
    return str(value)
