"""A virtual Prologix GPIB-USB adapter: lines that begin with ++ are its own, all else goes to the
current address.
"""

from collections.abc import Iterator
from pathlib import Path

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instrument import BusInstrument

VERSION = "Prologix GPIB-USB Controller version 6.107"
UNRECOGNIZED = b"Unrecognized command\r\n"
ENDINGS = (b"\r\n", b"\r", b"\n", b"")
BUS_S = 1e-3


class _Unrecognized(Exception):
    """Unknown ++ command."""


class PrologixAdapter:
    """GPIB-USB adapter with factory settings (controller, read after write, address 0) before an
    instrument with a GPIB address.
    """

    def __init__(self, address: int, instrument: BusInstrument) -> None:
        self.instrument, self._instrument_address = instrument, address
        self._address = 0
        self._settings = {
            "mode": 1,
            "auto": 1,
            "eoi": 1,
            "eos": 0,
            "eot_enable": 0,
            "eot_char": 10,
            "savecfg": 1,
            "read_tmo_ms": 500,
        }
        self._line, self._escaped, self._plus = bytearray(), False, 0

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes from the USB side; return answers, each with the time it takes, s."""
        return [
            answer
            for line, is_command in self._lines(data)
            for answer in (self._own(line) if is_command else self._pass(line))
        ]

    def _lines(self, data: bytes) -> Iterator[tuple[bytes, bool]]:
        """Yield complete lines, unescaped, and whether each is a ++ command."""
        for byte in data:
            if self._escaped:
                self._line.append(byte)
                self._escaped = False
            elif byte == 27:  # escape
                self._escaped = True
            elif byte in b"\r\n":
                if self._line:
                    yield bytes(self._line), self._plus >= 2
                self._line, self._plus = bytearray(), 0
            elif byte == ord("+"):  # unescaped: a mark of the adapter's own line, else thrown away
                self._plus += not self._line
            else:
                self._line.append(byte)

    def _pass(self, line: bytes) -> list[tuple[float, bytes]]:
        if not self._settings["mode"] or not self._is_addressed:
            return []
        self.instrument.listen(
            line + ENDINGS[self._settings["eos"]], end=bool(self._settings["eoi"])
        )
        return self._read() if self._settings["auto"] else []

    def _read(self) -> list[tuple[float, bytes]]:
        answer = self.instrument.talk() if self._is_addressed else b""
        if not answer:
            return []
        mark = bytes([self._settings["eot_char"]]) if self._settings["eot_enable"] else b""
        return [(BUS_S, answer + mark)]

    @property
    def _is_addressed(self) -> bool:
        return self._address == self._instrument_address

    def _own(self, line: bytes) -> list[tuple[float, bytes]]:
        name, *arguments = line.decode("ascii", "replace").lower().split()
        try:
            answer = self._obey(name, arguments)
        except (_Unrecognized, ValueError):
            return [(BUS_S, UNRECOGNIZED)]
        if isinstance(answer, str):
            return [(BUS_S, answer.encode() + b"\r\n")]
        return answer

    def _obey(self, name: str, arguments: list[str]) -> str | list[tuple[float, bytes]]:
        if name in self._settings:
            return self._setting(name, arguments)
        if name == "read":
            return self._read()
        if name == "addr":
            return self._set_address(arguments)
        if name == "ver":
            return VERSION
        if name == "clr":
            if self._is_addressed:
                self.instrument.clear()
            return []
        if name in ("ifc", "loc", "llo", "rst", "trg"):
            return []
        raise _Unrecognized

    def _setting(self, name: str, arguments: list[str]) -> str | list[tuple[float, bytes]]:
        if not arguments:
            return str(self._settings[name])
        lowest, highest = {"eos": (0, 3), "eot_char": (0, 255), "read_tmo_ms": (1, 3000)}.get(
            name, (0, 1)
        )
        self._settings[name] = _whole(arguments, lowest, highest)
        return []

    def _set_address(self, arguments: list[str]) -> str | list[tuple[float, bytes]]:
        if not arguments:
            return str(self._address)
        if len(arguments) == 2 and not 96 <= int(arguments[1]) <= 126:
            raise _Unrecognized
        self._address = _whole(arguments[:1], 0, 30)
        return []

    def advance(self, now_s: float, faults: Faults) -> None:
        """Advance the instrument to a time, s."""
        self.instrument.advance(now_s, faults)

    def power_cycle(self) -> None:
        """Power cycle the instrument; the adapter is powered by the computer."""
        self.instrument.power_cycle()

    def publish(self, folder: Path) -> None:
        """Publish the outputs of the instrument."""
        self.instrument.publish(folder)


def _whole(arguments: list[str], lowest: int, highest: int) -> int:
    (text,) = arguments
    value = int(text)
    if not lowest <= value <= highest:
        raise _Unrecognized
    return value
