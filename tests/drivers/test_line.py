"""Whole lines over a port that may be late, partial, full, or gone."""

import gc
import os
import resource
import threading
import time
import tty

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from drivers.errors import (
    BenchError,
    BenchStopped,
    InstrumentDisconnected,
    InstrumentReplyError,
    InstrumentTimeout,
)
from drivers.instruments import high_voltage, iseg
from drivers.instruments.filter_wheel import PromptLine
from drivers.instruments.iseg import IsegLine
from drivers.serial_lines.line import FramedLine, PrologixLine
from drivers.serial_lines.port import LaterPort, SerialPort
from simulate.virtual_bench.in_process import InProcessPort
from simulate.virtual_bench.instruments.high_voltage import HighVoltageSupply
from simulate.virtual_bench.instruments.iseg import IsegSupply
from simulate.virtual_bench.prologix import PrologixAdapter
from simulate.virtual_bench.pseudo_terminal import PseudoTerminal

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

    def reopen(self, path: str | None = None) -> None:
        self._due.clear()

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
        InstrumentTimeout,
        match=r"delay generator must answer TRAT\? within 0.15 s, got only b'\+59.9'",
    ):
        line.ask("TRAT?")


def test_even_an_answer_that_comes_during_resynchronisation_is_not_mistaken(line, port):
    port.answers[b"TSRC?\n"] = [(ANSWER_S + 0.08, b"5\r\n")]
    port.answers[b"LERR?\n"] = [(0.0, b"0\r\n")]
    port.answers[b"*IDN?\n"] = [(0.05, KNOWN)]
    with pytest.raises(InstrumentTimeout):
        line.ask("TSRC?")
    assert line.ask("LERR?") == "0"
    assert port.sent == [b"*IDN?\n", b"TSRC?\n", b"*IDN?\n", b"LERR?\n"]


def test_an_answer_due_to_whoever_held_the_port_before_is_not_taken_for_ones_own(line, port):
    port.answers |= {
        b"LERR?\n": [(0.08, b"0\r\n")],
        b"*IDN?\n": [(0.09, KNOWN)],
        b"TSRC?\n": [(0.09, b"5\r\n")],
    }
    port.send(b"LERR?\n")
    assert line.ask("TSRC?") == "5"


def in_a_thread(action):
    """Run an action in a thread and return what it ended in, with the thread."""
    ended: list[object] = []

    def run() -> None:
        try:
            ended.append(action())
        except BenchError as error:
            ended.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread, ended


def test_a_wait_of_another_thread_ends_at_once_when_the_line_is_taken_over(port):
    line = FramedLine(port, name="delay generator", answer_s=30.0)
    line.ask("*IDN?")
    waiting, ended = in_a_thread(lambda: line.ask("TSRC?"))
    while b"TSRC?\n" not in port.sent:
        time.sleep(0.001)
    line.take_over()
    waiting.join(1.0)
    assert isinstance(ended[0], BenchStopped)


class HeldPort(ScriptedPort):
    """A port that keeps each sending of other threads until a test lets it go."""

    def __init__(self) -> None:
        super().__init__()
        self.entered, self.go = threading.Event(), threading.Event()

    def send(self, data: bytes) -> None:
        if threading.current_thread() is not threading.main_thread() and not self.entered.is_set():
            self.entered.set()
            self.go.wait(5.0)
        super().send(data)


@pytest.mark.parametrize(
    ("kind", "first"),
    [
        (lambda port: FramedLine(port, name="gate"), [b"VOUT?\n"]),
        (lambda port: PrologixLine(port, name="supply", address=14), [b"VOUT?\n++read eoi\n"]),
        (lambda port: IsegLine(port, name="supply"), [b"VOUT?\r\n"]),
        (lambda port: PromptLine(port, name="wheel"), [b"VOUT?\r"]),
    ],
)
def test_nothing_of_another_thread_follows_the_first_order_of_the_safe_action(kind, first):
    port = HeldPort()
    line = kind(port)
    line._in_step = True

    def ramp() -> None:
        while True:
            line.ask("VOUT?")

    ramping, ended = in_a_thread(ramp)
    assert port.entered.wait(5.0)
    line.take_over()

    def order() -> None:
        with line.safing():
            line.order("HVOF")

    ordering, _ = in_a_thread(order)
    # the order waits for the exchange, which is past its check and has still to send
    ordering.join(0.1)
    port.go.set()
    ordering.join(5.0)
    ramping.join(5.0)
    assert isinstance(ended[0], BenchStopped)
    assert port.sent[:-1] == first
    assert b"HVOF" in port.sent[-1]


class ListenedPort(InProcessPort):
    """A port to a virtual instrument that notes what is sent."""

    def __init__(self, instrument) -> None:
        super().__init__(instrument)
        self.sent: list[bytes] = []

    def send(self, data: bytes) -> None:
        self.sent.append(data)
        super().send(data)


@pytest.mark.parametrize(
    ("module", "virtual", "order"),
    [
        (high_voltage, lambda: PrologixAdapter(14, HighVoltageSupply()), b"++addr 14\nHVOF\n"),
        (iseg, IsegSupply, b"\r\nG1\r\n"),
    ],
)
def test_a_ramp_ends_where_the_safe_action_takes_over_and_the_output_falls(module, virtual, order):
    port = ListenedPort(virtual())
    line = module.MODEL.line(port, 14)
    supply = module.MODEL.driver(line)
    supply.identify()
    supply.prepare(limit_v=900.0)
    supply.switch_on()
    ramping, ended = in_a_thread(lambda: supply.raise_to(800.0, rate_v_per_s=100.0))
    while port.far_end().output_v < 60.0:
        time.sleep(0.01)
    line.take_over()
    with line.safing():
        for command in supply.off_commands:
            line.order(command)
        ramping.join(5.0)
        assert isinstance(ended[0], BenchStopped)
        assert port.sent[-1] == order
        assert supply.read_voltage_v() < 120.0
    line.release()
    supply.order_off()
    supply.look()


ADAPTER = b"".join(
    f"++{setting}\n".encode()
    for setting in ("savecfg 0", "auto 0", "mode 1", "eoi 1", "eos 2", "read_tmo_ms 200", "addr 14")
)


@pytest.fixture
def adapter(port):
    port.answers |= {b"++ver\n": [(0.0, b"version 6\r\n")], b"++addr\n": [(0.0, b"14\r\n")]}
    port.answers[b"VOUT?\n++read eoi\n"] = [(0.0, b"800\n")]
    return PrologixLine(port, name="supply", address=14, answer_s=ANSWER_S)


def test_the_adapter_is_set_up_at_the_first_question_and_never_talks_by_itself(adapter, port):
    assert port.sent == []
    assert (adapter.ask("VOUT?"), adapter.ask("VOUT?")) == ("800", "800")
    adapter.write("VSET 1+2")
    assert port.sent == [
        b"++ver\n",
        ADAPTER,
        b"++addr\n",
        *2 * [b"VOUT?\n++read eoi\n"],
        b"VSET 1\x1b+2\n",
    ]


def test_an_order_on_a_fresh_line_goes_out_to_its_address_before_anything_else(adapter, port):
    adapter.order("HVOF")
    assert port.sent == [b"++addr 14\nHVOF\n"]
    adapter.write("VSET 50")
    assert port.sent[1:] == [ADAPTER, b"VSET 50\n"]


def test_an_adapter_that_keeps_another_address_is_no_adapter_of_ours(adapter, port):
    port.answers[b"++addr\n"] = [(0.0, b"9\r\n")]
    with pytest.raises(InstrumentReplyError, match="must keep the address 14, got '9'"):
        adapter.ask("VOUT?")


def test_after_reopening_the_adapter_is_set_up_again(adapter, port):
    adapter.ask("VOUT?")
    adapter.reopen()
    port.sent.clear()
    assert adapter.ask("VOUT?") == "800"
    assert port.sent == [b"++ver\n", ADAPTER, b"++addr\n", b"VOUT?\n++read eoi\n"]
    adapter.reopen()
    port.sent.clear()
    adapter.write("VSET 50")
    assert port.sent == [ADAPTER, b"VSET 50\n"]


@pytest.fixture
def terminal():
    master, slave = os.openpty()
    tty.setraw(slave)
    ends = [master, slave]
    yield ends
    for end in ends:
        os.close(end)


def test_a_port_that_does_not_exist_is_lost():
    with pytest.raises(
        InstrumentDisconnected,
        match="the port /dev/no-such-port of the supply must be free to open",
    ):
        SerialPort("/dev/no-such-port", name="supply")


def test_a_port_held_by_another_is_lost(terminal):
    path = os.ttyname(terminal[1])
    first = SerialPort(path, name="supply")
    with pytest.raises(InstrumentDisconnected, match="must be free to open"):
        SerialPort(path, name="supply")
    first.close()


def test_a_port_whose_copy_another_process_holds_opens_again(terminal):
    port = SerialPort(os.ttyname(terminal[1]), name="supply")
    copy = os.dup(port.fileno())
    port.reopen()
    port.send(b"HVOF\n")
    assert os.read(terminal[0], 64) == b"HVOF\n"
    with pytest.raises(InstrumentDisconnected, match="must be free to open"):
        SerialPort(os.ttyname(terminal[1]), name="supply")
    port.close()
    os.close(copy)


def test_a_line_that_takes_no_more_bytes_is_silent(terminal):
    port = SerialPort(os.ttyname(terminal[1]), name="supply")
    with pytest.raises(InstrumentTimeout, match="must take a command within"):
        for _ in range(100):
            port.send(b"x" * 4096)
    port.close()


def test_a_port_opens_again_when_its_device_is_back(tmp_path):
    terminal = PseudoTerminal(tmp_path / "supply", baud=9600)
    port = SerialPort(str(terminal.link), name="supply")
    line = FramedLine(port, name="supply")
    terminal.close()
    for _ in range(2):
        with pytest.raises(InstrumentDisconnected, match="must be free to open"):
            line.reopen()
        with pytest.raises(InstrumentDisconnected, match="must stay on"):
            line.order("HVOF")
    terminal.plug()
    line.reopen()
    line.order("HVOF")
    assert terminal.read(1.0) == b"HVOF\n"
    line.close()
    terminal.close()


def usb(device: str, number: str | None, location: str = "1-2") -> ListPortInfo:
    """Return the listing of a USB serial port."""
    found = ListPortInfo(device)
    found.serial_number, found.location = number, location
    return found


@pytest.mark.parametrize(
    ("before", "after", "moves"),
    [
        (("A1", "1-2"), ("A1", "1-4"), True),  # renumbered, in another socket
        (("A1", "1-2:1.0"), ("A1", "1-2:1.1"), False),  # the other port of the same adapter
        (("A1", "1-2"), ("A2", "1-2"), False),
        ((None, "1-2"), ("A1", "1-2"), False),
    ],
)
def test_an_adapter_with_a_serial_number_is_found_wherever_it_comes_back(
    monkeypatch, tmp_path, before, after, moves
):
    first, second = (PseudoTerminal(tmp_path / name, baud=9600) for name in ("first", "second"))
    old, new = (str(terminal.link.resolve()) for terminal in (first, second))
    listed = [usb(old, *before)]
    monkeypatch.setattr(list_ports, "comports", lambda: listed)
    port = SerialPort(str(first.link), name="supply")
    first.close()
    listed[:] = [usb(new, *after), usb("/dev/ttyS0", None)]
    if moves:
        port.reopen()
        port.send(b"HVOF\n")
        assert second.read(1.0) == b"HVOF\n"
    else:
        with pytest.raises(InstrumentDisconnected, match="must be free to open"):
            port.reopen()
    port.close()
    second.close()


def test_a_serial_number_that_several_adapters_have_names_none_of_them(monkeypatch, terminal):
    path = os.ttyname(terminal[1])
    monkeypatch.setattr(
        list_ports, "comports", lambda: [usb(path, "0001"), usb("/dev/ttyUSB9", "0001")]
    )
    port = SerialPort(path, name="supply")
    monkeypatch.setattr(list_ports, "comports", lambda: [usb("/dev/ttyUSB9", "0001")])
    port.reopen()
    port.send(b"HVOF\n")
    assert os.read(terminal[0], 64) == b"HVOF\n"
    port.close()


def test_the_safe_action_opens_a_port_that_another_program_has_locked(terminal):
    path = os.ttyname(terminal[1])
    holder = SerialPort(path, name="supply")
    port = SerialPort(path, name="supply", exclusive=False)
    port.send(b"HVOF\n")
    assert os.read(terminal[0], 64) == b"HVOF\n"
    port.close()
    holder.close()


def test_an_inherited_port_opens_again_and_again(terminal):
    path = os.ttyname(terminal[1])
    opened = SerialPort(path, name="supply")
    port = LaterPort(
        lambda path: SerialPort(path, name="supply", exclusive=False),
        name="supply",
        path=path,
        descriptor=os.dup(opened.fileno()),
    )
    opened.close()
    for _ in range(3):
        port.reopen()
        gc.collect()
        port.send(b"HVOF\n")
        assert os.read(terminal[0], 64) == b"HVOF\n"
        port.close()


def test_an_inherited_port_speaks_where_no_further_descriptor_can_be_had(terminal):
    opened = SerialPort(os.ttyname(terminal[1]), name="supply")
    port = LaterPort(None, name="supply", path=None, descriptor=os.dup(opened.fileno()))
    opened.close()
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))
    try:
        with pytest.raises(OSError, match="Too many open files"):
            os.dup(terminal[0])
        port.send(b"*IDN?\n")
        assert os.read(terminal[0], 64) == b"*IDN?\n"
        os.write(terminal[0], b"PS350\n")
        assert port.receive(1.0) == b"PS350\n"
        assert port.receive(0.01) == b""
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    with pytest.raises(InstrumentDisconnected, match="no path to open it by"):
        port.reopen()
    with pytest.raises(InstrumentTimeout, match="must take a command within"):
        for _ in range(100):
            port.send(b"x" * 4096)
    os.close(terminal.pop(0))
    with pytest.raises(
        InstrumentDisconnected, match="the supply must stay on the inherited descriptor"
    ):
        port.receive(0.1)
    port.close()
    with pytest.raises(InstrumentDisconnected):
        port.receive(0.1)
