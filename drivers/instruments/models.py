"""Instrument models: those in the modules of this package, and those of other packages.

A package provides a model by an entry point of the group `charact.instruments` whose value is an
`InstrumentModel`:

    [project.entry-points."charact.instruments"]
    my-supply = "my_package:MY_SUPPLY"
"""

from collections.abc import Mapping

from drivers.instruments.instrument import InstrumentModel
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.port import Port
from labdata.errors import BadInput
from labdata.instrument_config import InstrumentConfig, InstrumentConnection, Role, models_by_name

GROUP = "charact.instruments"


def models() -> dict[str, InstrumentModel]:
    """Return all known models by name; shipped ones cannot be replaced."""
    return models_by_name("drivers.instruments", InstrumentModel, GROUP)


def model(name: str, role: Role) -> InstrumentModel:
    """Return a model by name; an unknown one, or one of another role, is BadInput."""
    known = models()
    found = known.get(name)
    if found is None or found.role != role:
        names = sorted(each.name for each in known.values() if each.role == role)
        raise BadInput(f"the {role} must be one of {', '.join(names)}, got {name!r}")
    return found


def model_of(reached: InstrumentConnection) -> InstrumentModel:
    """Return the model of an instrument of the bench; an unknown one, or one of another role, is
    BadInput.
    """
    return model(reached.model, reached.role)


def lines_on(ports: Mapping[Role, Port], wires: InstrumentConfig) -> dict[Role, InstrumentLine]:
    """Return lines to the instruments of a bench on open ports, by role."""
    return {one.role: model_of(one).line(ports[one.role], one.address) for one in wires.instruments}
