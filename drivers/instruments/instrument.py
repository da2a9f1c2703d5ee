"""An instrument of the bench: what every driver can do, and the model that makes its line and its driver."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.port import Port, SerialPort
from labdata.instrument_config import Role


class Instrument(ABC):
    """Driver of one instrument; one thread at a time uses it, and the safe action.

    Parameters
    ----------
    line
        Line to the instrument.
    """

    def __init__(self, line: InstrumentLine) -> None:
        self.line = line

    @abstractmethod
    def identify(self) -> str:
        """Return who answers, and clear old errors; another instrument than expected is InstrumentReplyError."""

    @abstractmethod
    def look(self) -> None:
        """Look whether all is as it was set; what is wrong is a BenchError. Before anything was set: a sign of life."""

    def _identity(self, question: str, form: str, kinds: str) -> str:
        """Ask who answers; an answer not of a form is InstrumentReplyError."""
        identity = self.line.ask(question)
        if not re.fullmatch(form, identity):
            raise self.line.reply_error(f"be {kinds}", repr(identity[:80]))
        return identity


@dataclass(frozen=True, kw_only=True)
class InstrumentModel:
    """One model of instrument.

    Parameters
    ----------
    name
        What a plan calls it, such as "dg645".
    role
        What it is for; its driver has the public methods of the shipped one, and of `Gate` or `Supply`.
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
        """Open a serial port and return the line to the instrument; a port not to be had is InstrumentDisconnected.

        With `exclusive` False the port opens although another program has locked it, for the safe action only.
        """
        return self.line(self.open_port(port, exclusive=exclusive), address)

    def open_port(self, port: str, *, exclusive: bool = True) -> SerialPort:
        """Open a serial port as the instrument needs it."""
        handshake = self.hardware_handshake
        return SerialPort(port, name=self.title, baud=self.baud, hardware_handshake=handshake, exclusive=exclusive)
