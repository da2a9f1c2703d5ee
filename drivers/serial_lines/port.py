"""Serial ports with bounded waits."""

import contextlib
import fcntl
import math
import os
import select
import termios
import time
from collections.abc import Callable
from typing import Protocol

import serial
from serial.tools import list_ports

from drivers.errors import InstrumentDisconnected, InstrumentTimeout

ANSWER_S = 0.4  # Time limit of a reply, s; keeps every reaction within one second

SLICE_S = 0.02
_OPENING_ERRORS = (serial.SerialException, OSError, termios.error, ValueError)


class Port(Protocol):
    """Byte stream to an instrument."""

    def send(self, data: bytes) -> None:
        """Send bytes."""

    def receive(self, timeout_s: float) -> bytes:
        """Return received bytes, waiting at most `timeout_s` for the first; empty if there are
        none.
        """
        ...

    def reopen(self, path: str | None = None) -> None:
        """Reopen a lost port, or another path in its place; InstrumentDisconnected if it is
        missing.
        """

    def fileno(self) -> int:
        """File descriptor of the open port, or -1."""
        ...

    def close(self) -> None:
        """Close the port."""


class _DescriptorPort:
    """Bytes over the file descriptor of a serial port; `poll` bounds each wait without a further
    descriptor.
    """

    def __init__(self, descriptor: int, *, name: str, location: str) -> None:
        self._descriptor, self._name, self._place = descriptor, name, location

    def fileno(self) -> int:
        return self._descriptor

    def send(self, data: bytes) -> None:
        """Send bytes; a line that accepts none within the time limit is InstrumentTimeout."""
        deadline_s = time.monotonic() + ANSWER_S
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                if not self._is_ready(select.POLLOUT, deadline_s - time.monotonic()):
                    rule = f"take a command within {ANSWER_S:g} s"
                    raise InstrumentTimeout.of(
                        self._name, rule, f"no room on {self._place}"
                    ) from None
            except OSError as error:
                raise self._disconnection(error) from None

    def receive(self, timeout_s: float) -> bytes:
        if not self._is_ready(select.POLLIN, timeout_s):
            return b""
        try:
            if data := os.read(self._descriptor, 4096):
                return data
        except OSError as error:
            raise self._disconnection(error) from None
        raise self._disconnection("no data: it is unplugged, or another program reads it")

    def close(self) -> None:
        """Close the port, even one that is gone."""
        descriptor, self._descriptor = self._descriptor, -1
        with contextlib.suppress(OSError):
            os.close(descriptor)

    def _is_ready(self, event: int, timeout_s: float) -> bool:
        if self._descriptor < 0:
            raise self._disconnection("a closed port")
        waiting = select.poll()
        waiting.register(self._descriptor, event)
        return timeout_s >= 0 and bool(waiting.poll(math.ceil(1e3 * timeout_s)))

    def _disconnection(self, error: object) -> InstrumentDisconnected:
        return InstrumentDisconnected.of(self._name, f"stay on {self._place}", error)


class SerialPort(_DescriptorPort):
    """A serial port of the instrument `name`, with a lock against other programs.

    `exclusive` False opens the port despite a lock of another program, for the safe action only. A
    port that cannot be opened or goes away is InstrumentDisconnected.
    """

    def __init__(
        self,
        port: str,
        *,
        name: str,
        baud: int = 9600,
        hardware_handshake: bool = False,
        exclusive: bool = True,
    ) -> None:
        super().__init__(-1, name=name, location=port)
        self.path = port
        self._settings = {
            "baudrate": baud,
            "rtscts": hardware_handshake,
            "exclusive": exclusive or None,
        }
        self._open(port)
        adapters = usb_ports()
        adapter = adapters.get(os.path.realpath(port))
        # Some makers give all adapters the same serial number, which then identifies none.
        self._usb = adapter if sum(other == adapter for other in adapters.values()) == 1 else None

    def reopen(self, path: str | None = None) -> None:
        """Reopen the port, at the present path of its USB serial number, if it has one, or at
        another path.

        The lock belongs to the open file, of which another process may hold a copy: to close the
        descriptor alone would not free it.
        """
        with contextlib.suppress(*_OPENING_ERRORS):
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)
        self.close()
        if path is not None or self._usb is None:
            self._open(path or self.path)
            return
        paths = [path for path, adapter in usb_ports().items() if adapter == self._usb]
        if not paths:
            raise self._not_open(self.path, f"no adapter with the USB serial number {self._usb[0]}")
        self._open(paths[0])

    def close(self) -> None:
        """Close the port, even one that is gone."""
        with contextlib.suppress(*_OPENING_ERRORS):
            self._serial.close()
        self._descriptor = -1

    def _open(self, path: str) -> None:
        try:
            self._serial = serial.Serial(path, **self._settings)
        except _OPENING_ERRORS as error:
            raise self._not_open(path, error) from None
        self._descriptor, self._place = self._serial.fileno(), path

    def _not_open(self, path: str, error: object) -> InstrumentDisconnected:
        if "exclusively lock" in str(error):
            error = (
                "another program has locked it (a run that just ended follows the voltage "
                "down for some seconds)"
            )
        sentence = f"the port {path} of the {self._name} must be free to open, got {error}"
        return InstrumentDisconnected(sentence, instrument=self._name)


class LaterPort(_DescriptorPort):
    """A serial port that `reopen` opens by its path, or by another, and that is closed before.

    It may begin with an inherited `descriptor`, opened and configured by another process.
    """

    def __init__(
        self,
        open_port: Callable[[str], SerialPort] | None,
        *,
        name: str,
        path: str | None,
        descriptor: int = -1,
    ) -> None:
        location = path if descriptor < 0 else f"the inherited descriptor {descriptor}"
        super().__init__(descriptor, name=name, location=str(location))
        self.path, self._open_port = path, open_port
        self._opened: SerialPort | None = None
        if descriptor >= 0:
            os.set_blocking(descriptor, False)

    def close(self) -> None:
        """Close the port, even one that is gone."""
        if self._opened is None:
            return super().close()
        # By its own object, which would else close the next port of the same number when it ends
        self._opened.close()
        self._descriptor = -1

    def reopen(self, path: str | None = None) -> None:
        """Open the port, or another path in its place; InstrumentDisconnected if it is missing, or
        its path is unknown.
        """
        if self._open_port is None or self.path is None:
            raise self._disconnection("no path to open it by")
        self.close()
        self._opened = self._open_port(path or self.path)
        self._descriptor = self._opened.fileno()


def usb_ports() -> dict[str, tuple[str, str]]:
    """Return serial number and interface of each USB adapter, by device path."""
    try:
        return {
            adapter.device: (adapter.serial_number, (adapter.location or "").partition(":")[2])
            for adapter in list_ports.comports()
            if adapter.serial_number
        }
    except (
        OSError,
        TypeError,
        ValueError,
    ):  # pyserial fails on a device removed during the listing
        return {}
