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
    known_model = known.get(name)
    if known_model is None or known_model.role != role:
        names = sorted(candidate.name for candidate in known.values() if candidate.role == role)
        raise BadInput(f"the {role} must be one of {', '.join(names)}, got {name!r}")
    return known_model


def model_of(reached: InstrumentConnection) -> InstrumentModel:
    """Return the model of an instrument of the bench; an unknown one, or one of another role, is
    BadInput.
    """
    return model(reached.model, reached.role)


def lines_on(ports: Mapping[Role, Port], wires: InstrumentConfig) -> dict[Role, InstrumentLine]:
    """Return lines to the instruments of a bench on open ports, by role."""
    return {
        connection.role: model_of(connection).line(ports[connection.role], connection.address)
        for connection in wires.instruments
    }
