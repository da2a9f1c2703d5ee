"""How the shipped instruments are reached over a port: a line of their own, or behind a GPIB adapter."""

from drivers.instruments.light_source import KNOWN
from drivers.instruments.thermometer import KNOWN as KNOWN_THERMOMETER
from drivers.serial_lines.iseg_line import IsegLine
from drivers.serial_lines.line import FramedLine, InstrumentLine
from drivers.serial_lines.port import Port
from drivers.serial_lines.prologix import PrologixLine
from drivers.serial_lines.prompt_line import PromptLine

GATE_NAME, SUPPLY_NAME, WHEEL_NAME, LIGHT_NAME, METER_NAME, THERMOMETER_NAME = (
    "delay generator",
    "high-voltage supply",
    "filter wheel",
    "light source",
    "light meter",
    "thermometer",
)


def gate_line(port: Port) -> InstrumentLine:
    """Line to the delay generator on a port."""
    return FramedLine(port, name=GATE_NAME)


def supply_line(port: Port, *, address: int) -> InstrumentLine:
    """Line to the supply behind an adapter on a port."""
    return bus_line(port, name=SUPPLY_NAME, address=address)


def bus_line(port: Port, *, name: str, address: int) -> InstrumentLine:
    """Line to an instrument behind a GPIB adapter on a port."""
    return PrologixLine(port, name=name, address=address)


def iseg_line(port: Port) -> InstrumentLine:
    """Line to an iseg supply on a port."""
    return IsegLine(port, name=SUPPLY_NAME)


def wheel_line(port: Port) -> InstrumentLine:
    """Line to the filter wheel on a port."""
    return PromptLine(port, name=WHEEL_NAME)


def light_line(port: Port) -> InstrumentLine:
    """Line to the light source on a port."""
    return FramedLine(port, name=LIGHT_NAME, command_end=b"\r\n", known=KNOWN)


def meter_line(port: Port) -> InstrumentLine:
    """Line to the light meter on a port."""
    return FramedLine(port, name=METER_NAME, answer_end=b"\n")


def thermometer_line(port: Port) -> InstrumentLine:
    """Line to the thermometer on a port."""
    return FramedLine(port, name=THERMOMETER_NAME, command_end=b"\r\n", known=KNOWN_THERMOMETER)
