"""The virtual delay generator, high-voltage supply and GPIB adapter answer as their manuals say."""

import math

import pytest

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instruments.delay_generator import DelayGenerator
from simulate.virtual_bench.instruments.high_voltage import HighVoltageSupply
from simulate.virtual_bench.prologix import PrologixAdapter

# The virtual DG645 behaves as the maker's manual says: refusals, error queue, registers, rounding,
# triggers.


def told(instrument: DelayGenerator, text: str) -> list[str]:
    """Answers to a line, terminators checked and taken off."""
    answers = [answer for _, answer in instrument.receive(text.encode() + b"\n")]
    assert all(answer.endswith(b"\r\n") for answer in answers)
    return [answer[:-2].decode() for answer in answers]


@pytest.fixture
def dg645():
    instrument = DelayGenerator()
    told(instrument, "*CLS")
    return instrument


@pytest.mark.parametrize("spelling", ["DLAY?2", "DLAY? 2", "dlay? 2", " Dlay?   2 ", "DLAY? 2\r"])
def test_case_and_blanks_do_not_matter(dg645, spelling):
    assert told(dg645, spelling) == ["0,+0.000000000000"]


# Lines in their order, each with its answers
EXCHANGES: dict[str, dict[str, list[str]]] = {
    "a set answers nothing and semicolons separate": {
        "TSRC0;TRAT 59.94;DLAY 2,0,1e-3": [],
        "TSRC?;TRAT?;DLAY?2": ["0", "+59.940000", "0,+0.001000000000"],
    },
    "clear empties queue and registers": {
        "TSRC 9;nonsense": [],
        "*CLS;LERR?;*ESR?;INSR?": ["0", "0", "0"],
    },
    "reading the event register clears it": {
        "TSRC 9;nonsense": [],
        "*ESR?;*ESR?": ["48", "0"],
    },
    "the status byte sums up what is enabled": {
        "TSRC 9;*STB?": ["0"],
        "*ESE 16;*SRE 32;*STB?": ["96"],
        "*STB? 5": [],  # single bits cannot be asked
        "LERR?;LERR?": ["10", "115"],
    },
    "a reset brings the maker's settings back": {
        "DLAY 2,0,3e-6;TSRC 0;LAMP 1,4;*RST": [],
        "DLAY?2;TSRC?;TRAT?;LAMP?1": ["0,+0.000000000000", "5", "+1000.000000", "+2.50"],
    },
}


@pytest.mark.parametrize("law", EXCHANGES)
def test_the_generator_answers_as_its_manual_says(dg645, law):
    for line, answers in EXCHANGES[law].items():
        assert told(dg645, line) == answers, line


def test_power_on_is_in_the_event_register():
    assert told(DelayGenerator(), "*ESR?;*ESR?") == ["128", "0"]


def test_a_line_may_arrive_in_pieces(dg645):
    assert dg645.receive(b"*ID") == []
    assert dg645.receive(b"N") == []
    ((_, answer),) = dg645.receive(b"?\r\n")
    assert answer.startswith(b"Stanford Research Systems,DG645,")


@pytest.mark.parametrize(
    ("asked_s", "kept"),
    [
        ("1.2e-12", "+0.000000000000"),
        ("7.4e-12", "+0.000000000005"),
        ("7.6e-12", "+0.000000000010"),
        ("1999.999999999995", "+1999.999999999995"),
    ],
)
def test_delays_round_to_5_picoseconds(dg645, asked_s, kept):
    told(dg645, f"DLAY 3,0,{asked_s}")
    assert told(dg645, "DLAY?3") == [f"0,{kept}"]


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("DLAY 2,0,2000", 12),
        ("DLAY 2,0,-1e-9", 12),
        ("DLAY 0,2,1e-9", 10),
        ("DLAY 1,0,1e-9", 10),
        ("DLAY 2,1,1e-9", 13),
        ("DLAY 2,2,1e-9", 13),
        ("DLAY 2,3,1e-9", 13),  # B follows A already
        ("LAMP 1,5.01", 10),
        ("LAMP 1,0.4", 10),
        ("LOFF 5,0", 10),
        ("LPOL 1,2", 10),
        ("TSRC 7", 10),
        ("TLVL 3.6", 10),
        ("TRAT 1e8", 10),
        ("TSRC 0;*TRG", 11),
        ("what", 111),
        ("what is this", 111),
        ("!!", 110),
        ("*TRG?", 112),
        ("LERR 3", 113),
        ("DLAY 2,,1", 114),
        ("TSRC 1,2", 115),
        ("DLAY 2,0", 116),
        ("TRAT fast", 118),
        ("TRAT inf", 118),
        ("TSRC 1.5", 120),
    ],
)
def test_what_cannot_be_is_refused_with_its_code_and_the_old_value_stays(dg645, command, code):
    told(dg645, "DLAY 3,2,1e-6")
    before = told(dg645, "DLAY?2;DLAY?3;LAMP?1;LOFF?4;LPOL?1;TLVL?;TRAT?")
    assert told(dg645, command) == []
    assert told(dg645, "LERR?;LERR?") == [str(code), "0"]
    assert told(dg645, "DLAY?2;DLAY?3;LAMP?1;LOFF?4;LPOL?1;TLVL?;TRAT?") == before


def test_the_error_queue_holds_20_and_then_says_254(dg645):
    for _ in range(30):
        told(dg645, "TSRC 9")
    codes = [told(dg645, "LERR?")[0] for _ in range(21)]
    assert codes == ["10"] * 19 + ["254", "0"]


def test_an_overrun_throws_the_line_away(dg645):
    dg645.receive(b"A" * 400)
    dg645.receive(b"\n")
    assert told(dg645, "LERR?") == ["171"]


# Commands behind a reset, the width of the opening, ns, and its rate, Hz; 0 keeps the gate shut.
GATES: dict[str, tuple[str, float, float]] = {
    "a factory instrument keeps it shut": ("", 0.0, 0.0),
    "from A to B at each trigger": (
        "DLAY 2,0,1e-6;DLAY 3,2,1.6e-2;TRAT 59.94;LAMP 1,4;TSRC 0",
        *(1.6e7, 59.94),
    ),
    **{
        f"shut without triggers, source {source}": (
            f"DLAY 3,2,1e-6;LAMP 1,4;TSRC {source}",
            0.0,
            0.0,
        )
        for source in (3, 4, 5)
    },
    "shut without a level": ("DLAY 3,2,1e-6;LAMP 1,1;TSRC 0", 0.0, 0.0),
    "a wrong polarity makes idle open": ("LAMP 1,4;LPOL 1,0", math.inf, 0.0),
    "a burst makes several pulses a trigger": (
        "DLAY 3,2,1e-6;LAMP 1,4;TRAT 60;TSRC 0;BURC 4;BURP 1e-4;BURM 1",
        *(1e3, 240.0),
    ),
}


@pytest.mark.parametrize("law", GATES)
def test_the_gate_is_as_its_edges_level_and_triggers_say(dg645, law):
    commands, width_ns, rate_hz = GATES[law]
    told(dg645, commands)
    gate = dg645.gate()
    assert (gate.gate_open, gate.gate_hz) == (width_ns > 0.0, rate_hz)
    assert gate.gate_ns == pytest.approx(width_ns, abs=1e-3)


def test_triggers_during_a_cycle_are_lost_and_told(dg645):
    told(dg645, "DLAY 3,2,1.6e-2;TRAT 100;LAMP 1,4;TSRC 0")
    dg645.advance(0.0, Faults())
    assert int(told(dg645, "INSR?")[0]) & 2
    assert dg645.gate().gate_hz == 50  # every second trigger is used
    told(dg645, "TRAT 60;INSR?")
    dg645.advance(1.0, Faults())
    assert not int(told(dg645, "INSR?")[0]) & 2


# The virtual PS350 slews, trips, latches and refuses as the maker's manual says.


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


# The virtual adapter behaves as the Prologix manual says.


@pytest.fixture
def adapter():
    adapter = PrologixAdapter(14, HighVoltageSupply())
    said(adapter, b"++auto 0\n++eoi 1\n++eos 2\n++addr 14\n*CLS\n")
    return adapter


def said(adapter, data: bytes) -> bytes:
    return b"".join(answer for _, answer in adapter.receive(data))


# What is said in order, each with what comes back.
DIALOGUES: dict[str, dict[bytes, bytes]] = {
    "lines end with either terminator": {
        b"++addr\r": b"14\r\n",
        b"++addr\n": b"14\r\n",
        b"++addr\r\n": b"14\r\n",
    },
    "an answer comes only when read": {b"VSET?\n": b"", b"++read eoi\n": b"0\n"},
    "auto reads after every write and makes sets query errors": {
        b"++auto 1\n": b"",
        b"VSET?\n": b"0\n",
        b"VSET 100\n": b"",
        b"*ESR?\n": b"4\n",
    },
    "nobody at the address is silence": {b"++addr 9\n*IDN?\n++read eoi\n": b""},
    "unknown commands and values are told": {
        line + b"\n": b"Unrecognized command\r\n"
        for line in (
            *(b"++what", b"++addr 31", b"++addr x"),
            *(b"++eos 4", b"++read_tmo_ms 0", b"++mode 2"),
        )
    },
    "settings read back": {
        b"++read_tmo_ms 250\n++savecfg 0\n": b"",
        b"++read_tmo_ms\n++eos\n++eoi\n++mode\n++auto\n++savecfg\n": (
            b"250\r\n2\r\n1\r\n1\r\n0\r\n0\r\n"
        ),
        b"++ver\n": b"Prologix GPIB-USB Controller version 6.107\r\n",
    },
    "an unescaped plus is thrown away and an escaped one kept": {
        b"VSET 1\x1b+2\n": b"",  # no number
        b"*ESR?\n++read eoi\n": b"32\n",
        b"VSET 1+00;VSET?\n++read eoi\n": b"100\n",
        b"VSET 2e\x1b+2;VSET?\n++read eoi\n": b"200\n",
    },
    "without terminator or EOI the instrument waits for more": {
        b"++eoi 0\n++eos 3\nVSET?\n": b"",
        b"++read eoi\n": b"",
        b"++clr\n++eoi 1\n": b"",
        b"VSET?\n++read eoi\n": b"0\n",
    },
    "a mark can follow the end of an answer": {
        b"++eot_char 13\n++eot_enable 1\n": b"",
        b"VSET?\n++read eoi\n": b"0\n\r",
    },
}


@pytest.mark.parametrize("law", DIALOGUES)
def test_the_adapter_answers_as_its_manual_says(adapter, law):
    for data, answer in DIALOGUES[law].items():
        assert said(adapter, data) == answer, data
