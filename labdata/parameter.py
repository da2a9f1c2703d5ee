"""A sensor parameter: a number that knows how well it is known and where it comes from."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from labdata.errors import BadInput

# sheet: the maker's data sheet. default: typical of the type, not of this specimen. derived: computed from others.
# fitted: identified by a session's data. prior: asked of the data, which did not identify it.
Standing = Literal["sheet", "default", "derived", "fitted", "prior"]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of a sensor description; its unit is in the name of the field that holds it.

    Parameters
    ----------
    value
        Best value.
    low, high
        Bounds that hold it with 95 % probability; both None where the number is exact by construction.
    standing
        How it is known, see `Standing`.
    source
        Where it comes from, in words.
    """

    value: float
    low: float | None = None
    high: float | None = None
    standing: Standing = "default"
    source: str = ""

    def __post_init__(self) -> None:
        for name in ("value", "low", "high"):
            number = getattr(self, name)
            if number is not None and not math.isfinite(number):
                raise BadInput(f"a parameter's {name} must be a finite number, got {number:g}")
        if (self.low is None) != (self.high is None):
            raise BadInput(f"low and high must be given together, got {self.low} and {self.high}")
        if self.low is not None and self.high is not None and not self.low <= self.value <= self.high:
            raise BadInput(
                f"a value must lie between its low and high, got {self.value:g} for {self.low:g}..{self.high:g}"
            )

    def __float__(self) -> float:
        return float(self.value)

    def scaled(self, factor: float, words: str = "") -> "Parameter":
        """Return the parameter times a positive factor, derived, with words added to its source."""
        ends = None if self.low is None or self.high is None else (self.low * factor, self.high * factor)
        return Parameter(
            value=self.value * factor,
            low=ends[0] if ends else None,
            high=ends[1] if ends else None,
            standing="derived",
            source=self.source + words,
        )

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        # The reference must name the whole: a reference to the bare table would let only the first field of a kind
        # be written as a number.
        table: Any = dict(handler.resolve_ref_schema(handler(source)))
        reference = table.pop("ref", None)
        return core_schema.no_info_before_validator_function(_of_number, table, ref=reference)


def _of_number(given: Any) -> Any:
    """Return the table that a bare number in a file stands for."""
    bare = isinstance(given, int | float) and not isinstance(given, bool)
    return {"value": given} if bare else given
