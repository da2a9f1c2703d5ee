"""The models of instruments that can stand at the bench: the shipped ones, and those that other packages bring.

A package brings one with a Python entry point of the group `charact.instruments` whose value is a `InstrumentModel`:

    [project.entry-points."charact.instruments"]
    my-supply = "my_package:MY_SUPPLY"
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

from drivers.instruments.delay_generator import DelayGenerator
from drivers.instruments.dg535 import Dg535
from drivers.instruments.filter_wheel import FilterWheel
from drivers.instruments.high_voltage import HighVoltage
from drivers.instruments.iseg import Iseg
from drivers.instruments.light_source import LightSource
from drivers.instruments.power_meter import PowerMeter
from drivers.instruments.thermometer import Thermometer
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.line_factory import (
    GATE_NAME,
    LIGHT_NAME,
    METER_NAME,
    SUPPLY_NAME,
    THERMOMETER_NAME,
    WHEEL_NAME,
    bus_line,
    gate_line,
    iseg_line,
    light_line,
    meter_line,
    supply_line,
    thermometer_line,
    wheel_line,
)
from drivers.serial_lines.port import Port, SerialPort
from labdata.errors import BadInput
from labdata.wires import Reached, Role, Wires

GROUP = "charact.instruments"


@dataclass(frozen=True, kw_only=True)
class InstrumentModel:
    """One model of instrument.

    Parameters
    ----------
    name
        What a plan calls it, such as "dg645".
    role
        What it is for; its driver keeps the protocol of that role (see `drivers.roles`).
    title
        What sentences call it, such as "delay generator".
    line
        Makes a line on a port; the second argument is the address on a bus, for those that have one.
    driver
        Makes the driver that speaks on a line.
    baud
        Rate of the serial port, baud.
    hardware_handshake
        RTS/CTS.
    """

    name: str
    role: Role
    title: str
    line: Callable[[Port, int], InstrumentLine]
    driver: Callable[[InstrumentLine], Any]
    baud: int = 9600
    hardware_handshake: bool = False

    def open_line(self, port: str, address: int = 0, *, exclusive: bool = True) -> InstrumentLine:
        """Open a serial port and return the line to the instrument; one not to be had is InstrumentDisconnected."""
        opened = SerialPort(
            port, name=self.title, baud=self.baud, hardware_handshake=self.hardware_handshake, exclusive=exclusive
        )
        return self.line(opened, address)


SHIPPED = (
    InstrumentModel(
        name="dg645",
        role="gate",
        title=GATE_NAME,
        line=lambda port, address: gate_line(port),
        driver=DelayGenerator,
        hardware_handshake=True,
    ),
    InstrumentModel(
        name="ps350",
        role="supply",
        title=SUPPLY_NAME,
        line=lambda port, address: supply_line(port, address=address),
        driver=HighVoltage,
    ),
    InstrumentModel(
        name="dg535",
        role="gate",
        title=GATE_NAME,
        line=lambda port, address: bus_line(port, name=GATE_NAME, address=address),
        driver=Dg535,
    ),
    InstrumentModel(
        name="iseg", role="supply", title=SUPPLY_NAME, line=lambda port, address: iseg_line(port), driver=Iseg
    ),
    InstrumentModel(
        name="fw102c",
        role="filter-wheel",
        title=WHEEL_NAME,
        line=lambda port, address: wheel_line(port),
        driver=FilterWheel,
        baud=115200,
    ),
    InstrumentModel(
        name="dc2100",
        role="light-source",
        title=LIGHT_NAME,
        line=lambda port, address: light_line(port),
        driver=LightSource,
        baud=115200,
    ),
    InstrumentModel(
        name="pm101",
        role="light-meter",
        title=METER_NAME,
        line=lambda port, address: meter_line(port),
        driver=PowerMeter,
        baud=115200,
    ),
    InstrumentModel(
        name="ctc100",
        role="thermometer",
        title=THERMOMETER_NAME,
        line=lambda port, address: thermometer_line(port),
        driver=Thermometer,
    ),
)


def models() -> dict[str, InstrumentModel]:
    """Every model that is known here, by name; a shipped one cannot be replaced.

    Raises
    ------
    BadInput
        If an entry point does not load, is no model, or takes a name that is taken.
    """
    known = {model.name: model for model in SHIPPED}
    for point in entry_points(group=GROUP):
        known[point.name] = _brought(point, known)
    return known


def model(name: str, role: Role) -> InstrumentModel:
    """Return a model by its name; one that is unknown, or has another role, is BadInput."""
    known = models()
    found = known.get(name)
    if found is None or found.role != role:
        names = sorted(each.name for each in known.values() if each.role == role)
        raise BadInput(f"the {role} must be one of {', '.join(names)}, got {name!r}")
    return found


def model_of(reached: Reached) -> InstrumentModel:
    """Return the model of an instrument of the bench; one that is unknown, or has another role, is BadInput."""
    return model(reached.model, reached.role)


def lines_on(ports: Mapping[Role, Port], wires: Wires) -> dict[Role, InstrumentLine]:
    """Return lines to the instruments of a bench whose ports are open already, by their role."""
    return {one.role: model_of(one).line(ports[one.role], one.address) for one in wires.instruments}


def _brought(point: Any, known: dict[str, InstrumentModel]) -> InstrumentModel:
    try:
        brought = point.load()
    except Exception as error:
        raise BadInput(f"the instrument {point.name!r} of {point.value} must load, got: {error}") from error
    if not isinstance(brought, InstrumentModel) or brought.name != point.name:
        raise BadInput(f"the entry point {point.name!r} must be a InstrumentModel of that name, got {brought!r}")
    if point.name in known:
        raise BadInput(f"the instrument {point.name!r} of {point.value} must have a name of its own, got a taken one")
    return brought
