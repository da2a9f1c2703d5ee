"""The virtual PS350 slews, trips, latches and refuses as the maker's manual says."""

import pytest

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instruments.high_voltage import HighVoltageSupply

HEALTHY, SHORTED = Faults(), Faults(tripped=True)
EXE, CME, QYE = 16, 32, 4


class Bus:
    """A supply with its clock in our hand."""

    def __init__(self) -> None:
        self.supply, self.now_s = HighVoltageSupply(), 0.0
        self.supply.advance(0.0, HEALTHY)
        self.tell("*CLS")

    def tell(self, message: str) -> None:
        self.supply.listen(message.encode(), end=True)

    def ask(self, message: str) -> float:
        self.tell(message)
        answer = self.supply.talk()
        assert answer.endswith(b"\n")
        return float(answer)

    def wait(self, seconds: float, faults: Faults = HEALTHY) -> None:
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self.supply.advance(self.now_s, faults)


@pytest.fixture
def bus():
    return Bus()


def near(value: float, error: float):
    return pytest.approx(value, abs=error)


ON = "VSET 800;HVON"
# What happens in order: a command, a time in seconds, a short circuit, or a question and its answer
STORIES = {
    "high voltage comes up off": (("VOUT?", 0), ("*STB? 7", 0), "VSET 800", 1, ("VOUT?", 0)),
    "the set value is read at once and the output lags": (
        *(ON, 0.1, ("VSET?", 800), ("VOUT?", near(175, 75)), ("*STB? 0", 0)),
        *(1, ("VOUT?", 800), ("*STB? 0", 1)),
    ),
    "full scale takes 3 s up and 6 s to a hundredth down": (
        *("VSET 5000;HVON", 2.9, ("VOUT?", near(4900, 99)), 0.2, ("VOUT?", 5000)),
        *("HVOF", 6, ("VOUT?", near(50, 1))),
    ),
    "a trip switches off at once and latches until the byte is read": (
        *(ON, 1, SHORTED, ("VOUT?", near(700, 99)), 1, ("*STB?", 0b100), ("*STB?", near(1, 1))),
    ),
    "reading one bit leaves the other latches": (
        *(ON, 1, SHORTED, ("*STB? 1", 0), ("*STB? 2", 1), ("*STB? 2", 0)),
    ),
    "clear status unlatches but does not clear the trip": (
        *(ON, SHORTED, "*CLS", ("*STB? 2", 0), "HVON", ("*ESR?", EXE), ("*STB? 7", 0)),
        *("TCLR;HVON", ("*STB? 7", 1)),
    ),
    "a load beyond the trip current trips": (
        *("ITRP 4e-6", ON, 1, ("*STB? 2", 1), ("VOUT?", near(250, 249))),
    ),
    "a load beyond the current limit holds the voltage down": (
        *("ILIM 4e-6", ON, 2, ("VOUT?", 400), ("*STB? 3", 1)),
    ),
    "the load draws the strip current": (ON, 1, ("IOUT?", near(8e-6, 1e-12))),
    "an answer not taken is lost to the next message": (
        *("VSET?", ("VLIM?", 5000), ("*ESR?", QYE)),
    ),
}


@pytest.mark.parametrize("story", STORIES)
def test_the_supply_does_as_its_manual_says(bus, story):
    for event in STORIES[story]:
        if isinstance(event, str):
            bus.tell(event)
        elif isinstance(event, tuple):
            assert bus.ask(event[0]) == event[1], event
        else:
            bus.wait(*((0.02, event) if event is SHORTED else (event,)))


@pytest.mark.parametrize(
    ("command", "bit"),
    [
        ("VSET 901", EXE),
        ("VSET 30", EXE),
        ("VSET -100", EXE),
        ("VLIM 5001", EXE),
        ("VLIM 500", EXE),
        ("ILIM 0.006", EXE),
        ("VSET", CME),
        ("VSET high", CME),
        ("VSET nan", CME),
        ("HVON 1", CME),
        ("VOUT 3", CME),
        ("PING", CME),
    ],
)
def test_what_cannot_be_is_refused_not_clamped(bus, command, bit):
    bus.tell("VLIM 900;VSET 600")
    before = [bus.ask(question) for question in ("VSET?", "VLIM?", "ILIM?")]
    bus.tell(command)
    assert int(bus.ask("*ESR?")) == bit
    assert [bus.ask(question) for question in ("VSET?", "VLIM?", "ILIM?")] == before


def test_talking_with_nothing_asked_is_silence_and_a_query_error(bus):
    assert bus.supply.talk() == b""
    assert int(bus.ask("*ESR?")) == QYE


def test_several_questions_in_a_message_are_answered_together(bus):
    bus.tell("VSET?;VLIM?")
    assert bus.supply.talk() == b"0;5000\n"
