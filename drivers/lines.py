"""How the shipped instruments are reached over a port: a line of their own, or behind a GPIB adapter."""

from drivers.errors import BenchError
from drivers.line import ADAPTER_ANSWER, FramedLine, OwnedLine, Port
from drivers.prologix import PrologixLine

GATE_NAME, SUPPLY_NAME = "delay generator", "high-voltage supply"


def gate_line(port: Port) -> OwnedLine:
    """Line to the delay generator on a port."""
    return FramedLine(port, name=GATE_NAME)


def supply_line(port: Port, *, address: int) -> OwnedLine:
    """Line to the supply behind an adapter on a port."""
    return bus_line(port, name=SUPPLY_NAME, address=address)


def bus_line(port: Port, *, name: str, address: int) -> OwnedLine:
    """Line to an instrument behind a GPIB adapter on a port, which is let go if the adapter does not answer."""
    adapter = FramedLine(port, name=name, answer_end=b"\n", known=ADAPTER_ANSWER)
    try:
        return PrologixLine(adapter, address=address)
    except BenchError:
        adapter.close()
        raise
