"""Base class of the instrument drivers, and the model that makes line and driver."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.errors import InstrumentDisconnected
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.port import LaterPort, Port, SerialPort
from labdata.instrument_config import Role


class Instrument(ABC):
    """Driver of one instrument, for one thread at a time and the safe action."""

    def __init__(self, line: InstrumentLine) -> None:
        self.line = line

    @abstractmethod
    def identify(self) -> str:
        """Return the identity and clear old errors; an unexpected instrument is
        InstrumentReplyError.
        """

    @abstractmethod
    def look(self) -> None:
        """Compare the instrument with its settings; a difference is a BenchError. Without settings,
        only query it.
        """

    def _set(self, *commands: str) -> None:
        """Send settings; an error that the instrument then reports is InstrumentRejected."""
        for command in commands:
            self.line.write(command)
        code, sentence = self._error()
        if code:
            raise self.line.rejection(f"accept {'; '.join(commands)!r}", sentence, code=code)

    def _error(self) -> tuple[int, str]:
        """Return and clear the errors of the last commands: a code, 0 for none, and a sentence."""
        return 0, ""

    def _identity(self, question: str, form: str, kinds: str) -> str:
        """Query the identity; a reply of another form is InstrumentReplyError."""
        identity = self.line.ask(question)
        if not re.fullmatch(form, identity):
            raise self.line.reply_error(f"be {kinds}", repr(identity[:80]))
        return identity


@dataclass(frozen=True, kw_only=True)
class InstrumentModel:
    """One model of instrument."""

    name: str  #: Name in a plan, such as "dg645"
    #: Role; the driver has the public methods of the shipped driver of that role, and of `Gate` or
    #: `Supply`
    role: Role
    title: str  #: Name in messages, such as "delay generator"
    #: Makes a line on a port; the second argument is the address on a bus, if any
    line: Callable[[Port, int], InstrumentLine]
    driver: Callable[[InstrumentLine], Any]  #: Makes the driver on a line
    baud: int = 9600  #: Rate of the serial port, baud
    hardware_handshake: bool = False  #: RTS/CTS

    def open_line(self, port: str, address: int = 0) -> InstrumentLine:
        """Open a serial port and return the line to the instrument; InstrumentDisconnected if it
        cannot be opened.
        """
        return self.line(self.open_port(port), address)

    def later_port(self, path: str, descriptor: int = -1) -> LaterPort:
        """Return a port for the safe action, which may begin with an inherited descriptor.

        Its own path is opened despite a lock of another program, and others, at which another
        instrument of the bench may be spoken to, only where they are free.
        """

        def open_port(at: str) -> SerialPort:
            try:
                return self.open_port(at)
            except InstrumentDisconnected:
                if at != path:
                    raise
                return self.open_port(at, exclusive=False)

        return LaterPort(open_port, name=self.title, path=path, descriptor=descriptor)

    def open_port(self, port: str, *, exclusive: bool = True) -> SerialPort:
        """Open a serial port with the settings of the instrument."""
        handshake = self.hardware_handshake
        return SerialPort(
            port, name=self.title, baud=self.baud, hardware_handshake=handshake, exclusive=exclusive
        )
