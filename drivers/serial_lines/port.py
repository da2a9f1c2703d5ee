"""The only place with serial bytes: a port that may be late, full, held by another program, or gone."""

import contextlib
import termios
from typing import Protocol

import serial

from drivers.errors import InstrumentDisconnected, InstrumentTimeout

ANSWER_S = 0.4
"""Time that an answer may take, s; the bound on everything that must happen within a second."""

SLICE_S = 0.02
_PORT_ERRORS = (serial.SerialException, OSError, termios.error)


class Port(Protocol):
    """Where bytes go out and come in."""

    def send(self, data: bytes) -> None:
        """Send bytes."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """Bytes that came, waiting at most `timeout_s` for the first; empty if none did."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


class SerialPort:
    """A serial port that nobody else can open meanwhile.

    Parameters
    ----------
    port
        Path of the device.
    name
        Name of the instrument, for sentences.
    baud
        Rate, baud.
    hardware_handshake
        RTS/CTS.

    Raises
    ------
    InstrumentDisconnected
        If the port cannot be opened or goes away; pyserial says so by three kinds of exception.
    """

    def __init__(self, port: str, *, name: str, baud: int = 9600, hardware_handshake: bool = False) -> None:
        self._path, self._name = port, name
        try:
            self._serial = serial.Serial(
                port, baud, timeout=SLICE_S, write_timeout=ANSWER_S, rtscts=hardware_handshake, exclusive=True
            )
        except (*_PORT_ERRORS, ValueError) as error:
            raise InstrumentDisconnected(
                f"the port {port} of the {name} must be free to open, got: {_why_not_open(error)}", instrument=name
            ) from None

    def send(self, data: bytes) -> None:
        """Send bytes; a line that takes none within the answer time is silent."""
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise InstrumentTimeout(
                f"the {self._name} must take a command within {ANSWER_S:g} s, got no room on {self._path}",
                instrument=self._name,
            ) from None
        except _PORT_ERRORS as error:
            raise self._lost(error) from None

    def receive(self, timeout_s: float) -> bytes:
        """Bytes that came, waiting at most `timeout_s` for the first."""
        try:
            self._serial.timeout = timeout_s
            first = self._serial.read(1)
            return first + self._serial.read(self._serial.in_waiting) if first else b""
        except _PORT_ERRORS as error:
            raise self._lost(error) from None

    def close(self) -> None:
        """Let go of the port, even one that is gone."""
        with contextlib.suppress(*_PORT_ERRORS):
            self._serial.close()

    def _lost(self, error: BaseException) -> InstrumentDisconnected:
        return InstrumentDisconnected(
            f"the {self._name} must stay on {self._path}, got: {error}", instrument=self._name
        )


def _why_not_open(error: BaseException) -> str:
    if "exclusively lock" in str(error):
        return (
            "another program holds it (the watchdog of a run that just ended follows the voltage down for some seconds)"
        )
    return str(error)
