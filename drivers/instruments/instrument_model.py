"""One model of instrument: what it is for, how its port is set, and what makes its line and its driver."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.port import Port, SerialPort
from labdata.wires import Role


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
        """Open a serial port and return the line to the instrument; a port not to be had is InstrumentDisconnected.

        With `exclusive` False the port opens although another program has locked it, for the safe action only.
        """
        opened = SerialPort(
            port,
            name=self.title,
            baud=self.baud,
            hardware_handshake=self.hardware_handshake,
            exclusive=exclusive,
        )
        return self.line(opened, address)
