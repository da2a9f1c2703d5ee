"""What `auto` owes to the tolerance it was given: a method that meets it, or a word where a result does not."""

from collections.abc import Mapping
from typing import Any

from labdata.measurement import Measurement


def meets(row: Mapping[str, Any], within_percent: float) -> bool:
    """Tell whether a method's row in a chart meets a tolerance on its errors.

    What must meet it is the upper limit of the errors' 95th percentile; tables made before there was one have the
    percentile alone.
    """
    return row.get("error_limit_percent", row["error_percent"]) <= within_percent


def reach_percent(value: float, interval95: tuple[float, float]) -> float:
    """Return how far a 95 % interval reaches from its value, on the side where it reaches further, percent."""
    return 100.0 * max(value - interval95[0], interval95[1] - value) / abs(value)


def beyond_note(measurement: Measurement, within_percent: float) -> str | None:
    """Return the sentence for a number that may be off by more than was asked for; None where it may not."""
    if not measurement.value or measurement.interval95 is None:
        return None
    reach = reach_percent(measurement.value, measurement.interval95)
    if reach <= within_percent:
        return None
    return f"95 % interval reaches {reach:.2g} % from the value, more than --within {within_percent:g} %."
