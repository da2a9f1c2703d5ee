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


def test_high_voltage_comes_up_off():
    bus = Bus()
    assert bus.ask("VOUT?") == 0
    assert not int(bus.ask("*STB? 7"))
    bus.tell("VSET 800")
    bus.wait(1)
    assert bus.ask("VOUT?") == 0


def test_the_set_value_is_read_at_once_and_the_output_lags(bus):
    bus.tell("VSET 800;HVON")
    bus.wait(0.1)
    assert bus.ask("VSET?") == 800
    assert 100 < bus.ask("VOUT?") < 250
    assert int(bus.ask("*STB?")) & 1 == 0
    bus.wait(1)
    assert bus.ask("VOUT?") == 800
    assert int(bus.ask("*STB?")) & 1


def test_full_scale_takes_3_s_up_and_6_s_to_a_hundredth_down(bus):
    bus.tell("VSET 5000;HVON")
    bus.wait(2.9)
    assert bus.ask("VOUT?") < 5000
    bus.wait(0.2)
    assert bus.ask("VOUT?") == 5000
    bus.tell("HVOF")
    bus.wait(6.0)
    assert bus.ask("VOUT?") == pytest.approx(50, abs=1)


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


def test_a_trip_switches_off_at_once_and_latches_until_the_byte_is_read(bus):
    bus.tell("VSET 800;HVON")
    bus.wait(1)
    bus.wait(0.02, SHORTED)
    assert bus.supply.output_v < 800
    bus.wait(1)
    assert int(bus.ask("*STB?")) & 0b10000100 == 0b100  # current trip, high voltage off
    assert int(bus.ask("*STB?")) & 0b100 == 0  # reading was destructive


def test_reading_one_bit_leaves_the_other_latches(bus):
    bus.tell("VSET 800;HVON")
    bus.wait(1)
    bus.wait(0.02, SHORTED)
    assert bus.ask("*STB? 1") == 0
    assert bus.ask("*STB? 2") == 1
    assert bus.ask("*STB? 2") == 0


def test_clear_status_unlatches_but_does_not_clear_the_trip(bus):
    bus.tell("VSET 800;HVON")
    bus.wait(0.02, SHORTED)
    bus.tell("*CLS")
    assert not int(bus.ask("*STB?")) & 4
    bus.tell("HVON")
    assert int(bus.ask("*ESR?")) == EXE
    assert bus.ask("*STB? 7") == 0
    bus.tell("TCLR;HVON")
    assert bus.ask("*STB? 7") == 1


def test_a_load_beyond_the_trip_current_trips(bus):
    bus.tell("ITRP 4e-6;VSET 800;HVON")
    bus.wait(1)
    assert int(bus.ask("*STB?")) & 4
    assert bus.ask("VOUT?") < 500


def test_a_load_beyond_the_current_limit_holds_the_voltage_down(bus):
    bus.tell("ILIM 4e-6;VSET 800;HVON")
    bus.wait(2)
    assert bus.ask("VOUT?") == 400
    assert int(bus.ask("*STB?")) & 8


def test_the_load_draws_the_strip_current(bus):
    bus.tell("VSET 800;HVON")
    bus.wait(1)
    assert bus.ask("IOUT?") == pytest.approx(8e-6)


def test_an_answer_not_taken_is_lost_to_the_next_message(bus):
    bus.tell("VSET?")
    assert bus.ask("VLIM?") == 5000
    assert int(bus.ask("*ESR?")) == QYE


def test_talking_with_nothing_asked_is_silence_and_a_query_error(bus):
    assert bus.supply.talk() == b""
    assert int(bus.ask("*ESR?")) == QYE


def test_several_questions_in_a_message_are_answered_together(bus):
    bus.tell("VSET?;VLIM?")
    assert bus.supply.talk() == b"0;5000\n"
