"""Parameters of a camera description, each with range, basis and source, and their draws."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from labdata.errors import BadInput, check

# sheet: data sheet. default: typical of the type, not of this device. derived: computed from
# others.
# fitted: identified by a session's data. prior: fitted, but not identified by the data.
# not-converged: requested of a fit whose chains did not converge.
Standing = Literal["sheet", "default", "derived", "fitted", "prior", "not-converged"]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of a sensor description; its unit is in the name of the field that holds it."""

    value: float  #: Best value
    low: float | None = None  #: 95 % bounds; both None where the number is exact by construction
    high: float | None = None  #: 95 % bounds; both None where the number is exact by construction
    standing: Standing = "default"  #: Basis of the value, see `Standing`
    source: str = ""  #: Source, as text

    def __post_init__(self) -> None:
        check(self, of=" of a parameter", finite="value low high")
        if (self.low is None) != (self.high is None):
            raise BadInput(f"low and high must be given together, got {self.low} and {self.high}")
        if (
            self.low is not None
            and self.high is not None
            and not self.low <= self.value <= self.high
        ):
            raise BadInput(
                f"a value must lie between its low and high, got {self.value:g} for "
                f"{self.low:g}..{self.high:g}"
            )

    def __float__(self) -> float:
        return float(self.value)

    def times(self, factor: float, words: str = "") -> "Parameter":
        """Return the parameter times a positive factor, derived, with words added to its source."""
        return Parameter(
            value=self.value * factor,
            low=None if self.low is None else self.low * factor,
            high=None if self.high is None else self.high * factor,
            standing="derived",
            source=self.source + words,
        )

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        # The reference must name this validator: one to the bare table would accept a plain number
        # only in the first field of its kind.
        table: Any = dict(handler.resolve_ref_schema(handler(source)))
        reference = table.pop("ref", None)
        return core_schema.no_info_before_validator_function(_of_number, table, ref=reference)


def _of_number(stated: Any) -> Any:
    """Return the table of an exact parameter given as a bare number."""
    bare = isinstance(stated, int | float) and not isinstance(stated, bool)
    return {"value": stated} if bare else stated


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Joint posterior draws of the fitted parameters, by path such as "tube.post_gain_share"."""

    names: tuple[str, ...] = ()  #: Paths of the parameters
    values: tuple[
        tuple[float, ...], ...
    ] = ()  #: Draws, one tuple per draw in the order of the names

    def __post_init__(self) -> None:
        if any(len(row) != len(self.names) for row in self.values):
            raise BadInput(f"every draw must hold {len(self.names)} numbers, one for each name")

    def without_phosphor(self, factors: dict[str, float]) -> "Draws":
        """Return the draws with some columns multiplied and those of the screen left out."""
        columns = [i for i, name in enumerate(self.names) if not name.startswith("phosphor.")]
        scale = [factors.get(self.names[i], 1.0) for i in columns]
        return Draws(
            names=tuple(self.names[i] for i in columns),
            values=tuple(
                tuple(row[i] * by for i, by in zip(columns, scale, strict=True))
                for row in self.values
            ),
        )


def must_be_an_efficiency_table(
    wavelength_nm: tuple[float, ...], efficiency: tuple[float, ...]
) -> None:
    """Require an efficiency table to rise in wavelength and to stay within 0 to 1."""
    if len(wavelength_nm) != len(efficiency) or len(wavelength_nm) < 2:
        raise BadInput(
            f"an efficiency table must have two wavelengths or more and as many efficiencies, "
            f"got {len(wavelength_nm)} and {len(efficiency)}"
        )
    if any(after <= before for before, after in pairwise(wavelength_nm)):
        raise BadInput(
            f"the wavelengths of an efficiency table must rise, got {list(wavelength_nm)}"
        )
    if not all(0.0 <= fraction <= 1.0 for fraction in efficiency) or not max(efficiency) > 0.0:
        raise BadInput(
            f"efficiencies must lie between 0 and 1 and not all be 0, got {list(efficiency)}"
        )
