"""What every camera description is: stages whose numbers are parameters, found and changed by path."""

from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import pairwise
from typing import Any, Self

from labdata.errors import BadInput
from labdata.parameter import Parameter


@dataclass(frozen=True, kw_only=True)
class Description:
    """A camera as stages of parameters, such as "optics.f_number"."""

    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its path, such as "optics.f_number"."""
        return {
            f"{stage.name}.{item.name}": value
            for stage in fields(self)
            if is_dataclass(part := getattr(self, stage.name))
            for item in fields(part)
            if isinstance(value := getattr(part, item.name), Parameter)
        }

    def with_parameters(self, changes: dict[str, Parameter]) -> Self:
        """Return a copy with parameters replaced by path."""
        if unknown := changes.keys() - self.parameters().keys():
            raise BadInput(f"a sensor parameter must be one of its stages' own, got {sorted(unknown)}")
        stages: dict[str, dict[str, Parameter]] = {}
        for path, parameter in changes.items():
            stage, name = path.split(".")
            stages.setdefault(stage, {})[name] = parameter
        return replace(self, **{stage: replace(getattr(self, stage), **named) for stage, named in stages.items()})

    def with_values(self, values: dict[str, float]) -> Self:
        """Return a copy in which parameters have other values, exact, by path."""
        known = self.parameters()
        if unknown := values.keys() - known.keys():
            raise BadInput(f"a sensor parameter must be one of its stages' own, got {sorted(unknown)}")
        return self.with_parameters(
            {path: replace(known[path], value=float(value), low=None, high=None) for path, value in values.items()}
        )


def must_be_positive(stage: Any, *names: str) -> None:
    """Refuse a stage in which a number that stands for a length, a time or a factor is not above zero."""
    for name in names:
        if not float(getattr(stage, name)) > 0.0:
            raise BadInput(f"{name} must be positive, got {float(getattr(stage, name)):g}")


def must_not_be_negative(stage: Any, *names: str) -> None:
    """Refuse a stage in which a number that may vanish is below zero."""
    for name in names:
        if not float(getattr(stage, name)) >= 0.0:
            raise BadInput(f"{name} must not be negative, got {float(getattr(stage, name)):g}")


def must_be_a_share(stage: Any, *names: str) -> None:
    """Refuse a stage in which a fraction or a probability does not lie between 0 and 1."""
    for name in names:
        if not 0.0 <= float(getattr(stage, name)) <= 1.0:
            raise BadInput(f"{name} must lie between 0 and 1, got {float(getattr(stage, name)):g}")


def must_be_a_count(stage: Any, *names: str) -> None:
    """Refuse a stage in which a number of rows, columns or stages is below one."""
    for name in names:
        if getattr(stage, name) < 1:
            raise BadInput(f"{name} must be at least 1, got {getattr(stage, name)}")


def must_be_an_efficiency_table(wavelength_nm: tuple[float, ...], efficiency: tuple[float, ...]) -> None:
    """Refuse a table of efficiency over wavelength that does not rise in wavelength or leaves 0 to 1."""
    if len(wavelength_nm) != len(efficiency) or len(wavelength_nm) < 2:
        raise BadInput(
            f"an efficiency table must have two wavelengths or more and as many efficiencies, "
            f"got {len(wavelength_nm)} and {len(efficiency)}"
        )
    if any(after <= before for before, after in pairwise(wavelength_nm)):
        raise BadInput(f"the wavelengths of an efficiency table must rise, got {list(wavelength_nm)}")
    if not all(0.0 <= one <= 1.0 for one in efficiency) or not max(efficiency) > 0.0:
        raise BadInput(f"efficiencies must lie between 0 and 1 and not all be 0, got {list(efficiency)}")
