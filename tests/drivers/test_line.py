"""Whole lines over a port that may be late, partial, full, or gone."""

import os
import threading
import time
import tty

import pytest

from drivers.errors import BenchError, InstrumentDisconnected, InstrumentTimeout
from drivers.serial_lines.line import FramedLine
from drivers.serial_lines.port import SerialPort

ANSWER_S = 0.15
KNOWN = b"a,b,c,d\r\n"


class ScriptedPort:
    """A port that answers what a test lays down, each piece after a delay."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.answers: dict[bytes, list[tuple[float, bytes]]] = {b"*IDN?\n": [(0.0, KNOWN)]}
        self._due: list[tuple[float, bytes]] = []

    def send(self, data: bytes) -> None:
        self.sent.append(data)
        now_s = time.monotonic()
        self._due += [(now_s + delay_s, piece) for delay_s, piece in self.answers.get(data, [])]

    def receive(self, timeout_s: float) -> bytes:
        until_s = time.monotonic() + timeout_s
        while True:
            now_s = time.monotonic()
            here = [piece for due_s, piece in self._due if due_s <= now_s]
            self._due = [late for late in self._due if late[0] > now_s]
            if here or now_s >= until_s:
                return b"".join(here)
            time.sleep(0.002)

    def close(self) -> None:
        pass


@pytest.fixture
def port():
    return ScriptedPort()


@pytest.fixture
def line(port):
    return FramedLine(port, name="delay generator", answer_s=ANSWER_S)


def test_an_answer_comes_whole_though_its_bytes_come_in_pieces(line, port):
    port.answers[b"TSRC?\n"] = [(0.0, b"+"), (0.03, b"5\r"), (0.06, b"\n")]
    assert line.ask("TSRC?") == "+5"


def test_a_fragment_without_terminator_is_silence_and_is_named(line, port):
    port.answers[b"TRAT?\n"] = [(0.0, b"+59.9")]
    with pytest.raises(
        InstrumentTimeout, match=r"delay generator must answer TRAT\? within 0.15 s, got only b'\+59.9'"
    ):
        line.ask("TRAT?")


def test_silence_is_told_within_its_time(line):
    began_s = time.monotonic()
    with pytest.raises(InstrumentTimeout, match="got nothing"):
        line.ask("TSRC?")
    assert ANSWER_S <= time.monotonic() - began_s < ANSWER_S + 0.2


def test_a_late_answer_is_not_taken_for_the_next_one(line, port):
    port.answers[b"TSRC?\n"] = [(ANSWER_S + 0.02, b"5\r\n")]
    port.answers[b"LERR?\n"] = [(0.0, b"0\r\n")]
    with pytest.raises(InstrumentTimeout):
        line.ask("TSRC?")
    time.sleep(0.04)
    assert line.ask("LERR?") == "0"


def test_even_an_answer_that_comes_during_resynchronisation_is_not_mistaken(line, port):
    port.answers[b"TSRC?\n"] = [(ANSWER_S + 0.08, b"5\r\n")]
    port.answers[b"LERR?\n"] = [(0.0, b"0\r\n")]
    port.answers[b"*IDN?\n"] = [(0.05, KNOWN)]
    with pytest.raises(InstrumentTimeout):
        line.ask("TSRC?")
    assert line.ask("LERR?") == "0"
    assert port.sent == [b"*IDN?\n", b"TSRC?\n", b"*IDN?\n", b"LERR?\n"]


def test_an_answer_due_to_whoever_held_the_port_before_is_not_taken_for_ones_own(line, port):
    port.answers |= {b"LERR?\n": [(0.08, b"0\r\n")], b"*IDN?\n": [(0.09, KNOWN)], b"TSRC?\n": [(0.09, b"5\r\n")]}
    port.send(b"LERR?\n")
    assert line.ask("TSRC?") == "5"


def test_two_answers_at_once_are_kept_apart(line, port):
    port.answers[b"A?;B?\n"] = [(0.0, b"1\r\n2\r\n")]
    assert line.ask("A?;B?") == "1"
    assert line.ask("C?") == "2"  # the bytes that came are kept, whatever is asked next


def test_a_wait_gives_up_at_once_when_the_bench_is_made_safe(line):
    threading.Timer(0.03, line.hurry.set).start()
    began_s = time.monotonic()
    with pytest.raises(InstrumentTimeout):
        line.ask("TSRC?")
    assert time.monotonic() - began_s < 0.13


@pytest.fixture
def terminal():
    master, slave = os.openpty()
    tty.setraw(slave)
    ends = [master, slave]
    yield ends
    for end in ends:
        os.close(end)


def test_a_port_that_does_not_exist_is_lost():
    with pytest.raises(InstrumentDisconnected, match="the port /dev/no-such-port of the supply must be free to open"):
        SerialPort("/dev/no-such-port", name="supply")


def test_a_port_held_by_another_is_lost(terminal):
    path = os.ttyname(terminal[1])
    first = SerialPort(path, name="supply")
    with pytest.raises(InstrumentDisconnected, match="must be free to open"):
        SerialPort(path, name="supply")
    first.close()


def test_an_unplugged_port_is_lost_in_reading_and_in_writing(terminal):
    port = SerialPort(os.ttyname(terminal[1]), name="supply")
    for end in reversed(terminal):
        os.close(end)
    terminal.clear()
    with pytest.raises(InstrumentDisconnected, match="the supply must stay on"):
        port.receive(0.1)
    with pytest.raises(InstrumentDisconnected, match="the supply must stay on"):
        port.send(b"HVOF\n")
    port.close()


def test_a_line_that_takes_no_more_bytes_is_silent(terminal):
    port = SerialPort(os.ttyname(terminal[1]), name="supply")
    with pytest.raises(InstrumentTimeout, match="must take a command within"):
        for _ in range(100):
            port.send(b"x" * 4096)
    port.close()


def test_bytes_pass_both_ways(terminal):
    port = SerialPort(os.ttyname(terminal[1]), name="supply")
    port.send(b"*IDN?\n")
    assert os.read(terminal[0], 64) == b"*IDN?\n"
    os.write(terminal[0], b"PS350\n")
    assert port.receive(1.0) == b"PS350\n"
    assert port.receive(0.01) == b""
    port.close()


def test_every_failure_of_an_instrument_is_a_bench_error_that_names_it():
    for kind in (InstrumentTimeout, InstrumentDisconnected):
        assert issubclass(kind, BenchError)
        assert kind("a sentence", instrument="supply").instrument == "supply"
