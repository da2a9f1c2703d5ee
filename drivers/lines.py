"""The two lines of the bench: how each instrument is reached over a port."""

from drivers.errors import BenchError
from drivers.line import ADAPTER_ANSWER, FramedLine, OwnedLine, Port, SerialPort
from drivers.prologix import PrologixLine

GATE_NAME, SUPPLY_NAME = "delay generator", "high-voltage supply"


def open_gate_line(port: str) -> OwnedLine:
    """Line to the delay generator on a serial port."""
    return gate_line(SerialPort(port, name=GATE_NAME, hardware_handshake=True))


def open_supply_line(port: str, *, address: int) -> OwnedLine:
    """Line to the supply behind the GPIB adapter on a serial port."""
    return supply_line(SerialPort(port, name=SUPPLY_NAME), address=address)


def gate_line(port: Port) -> OwnedLine:
    """Line to the delay generator on a port."""
    return FramedLine(port, name=GATE_NAME)


def supply_line(port: Port, *, address: int) -> OwnedLine:
    """Line to the supply behind an adapter on a port, which is let go if the adapter does not answer."""
    adapter = FramedLine(port, name=SUPPLY_NAME, answer_end=b"\n", known=ADAPTER_ANSWER)
    try:
        return PrologixLine(adapter, address=address)
    except BenchError:
        adapter.close()
        raise
