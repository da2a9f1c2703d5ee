"""A sensor parameter: a number that knows how well it is known and where it comes from."""

from dataclasses import dataclass
from typing import Literal

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
        if (self.low is None) != (self.high is None):
            raise BadInput(f"low and high must be given together, got {self.low} and {self.high}")
        if self.low is not None and self.high is not None and not self.low <= self.value <= self.high:
            raise BadInput(
                f"a value must lie between its low and high, got {self.value:g} for {self.low:g}..{self.high:g}"
            )

    def __float__(self) -> float:
        return float(self.value)
