"""Tolerance of `auto`: which methods meet it, and a note on results that do not."""

from collections.abc import Mapping
from typing import Any

from labdata.measurement import Measurement


def meets(row: Mapping[str, Any], within_percent: float) -> bool:
    """Return whether a method's row in a chart meets a tolerance.

    The upper confidence limit of the 95th error percentile must meet it; older tables contain the percentile alone.
    """
    return row.get("error_limit_percent", row["error_percent"]) <= within_percent


def reach_percent(value: float, interval95: tuple[float, float]) -> float:
    """Return the longer arm of a 95 % interval relative to its value, percent."""
    return 100.0 * max(value - interval95[0], interval95[1] - value) / abs(value)


def beyond_note(measurement: Measurement, within_percent: float) -> str | None:
    """Return the note on an interval wider than the tolerance; None if it is not wider."""
    if not measurement.value or measurement.interval95 is None:
        return None
    reach = reach_percent(measurement.value, measurement.interval95)
    if reach <= within_percent:
        return None
    return f"95 % interval extends {reach:.2g} % from the value, beyond the tolerance --within {within_percent:g} %."
