"""The virtual DG645 behaves as the maker's manual says: refusals, error queue, registers, rounding,
triggers.
"""

import math

import pytest

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instruments.delay_generator import DelayGenerator


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
    "settings can be saved and recalled": {
        "DLAY 2,0,3e-6;TSRC 0;*SAV 4;*RST": [],
        "DLAY?2;TSRC?": ["0,+0.000000000000", "5"],
        "*RCL 4;DLAY?2;TSRC?": ["0,+0.000003000000", "0"],
        "*RCL 0;TSRC?;TRAT?;LAMP?1": ["5", "+1000.000000", "+2.50"],
    },
    "an edge can be stepped and linked": {
        "SSDL 2,1e-9;SPDL 2,1;SPDL 2,1;SPDL 2,0;LINK 4,2": [],
        "DLAY?2;LINK?4": ["0,+0.000000001000", "2"],
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
        ("*RCL 5", 14),
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


def test_terminators_can_be_chosen(dg645):
    dg645.receive(b"XTRM 10,0,0\n")
    assert dg645.receive(b"TSRC?\n")[0][1] == b"5\n"


def test_an_overrun_throws_the_line_away(dg645):
    dg645.receive(b"A" * 400)
    dg645.receive(b"\n")
    assert told(dg645, "LERR?") == ["171"]


def test_a_factory_instrument_keeps_the_gate_shut():
    assert not DelayGenerator().gate().gate_open


def test_the_gate_opens_from_a_to_b_at_each_trigger(dg645):
    told(dg645, "DLAY 2,0,1e-6;DLAY 3,2,1.6e-2;TRAT 59.94;LAMP 1,4;TSRC 0")
    gate = dg645.gate()
    assert (gate.gate_open, gate.gate_hz) == (True, 59.94)
    assert gate.gate_ns == pytest.approx(1.6e7, abs=1e-3)


def test_triggers_during_a_cycle_are_lost_and_told(dg645):
    told(dg645, "DLAY 3,2,1.6e-2;TRAT 100;LAMP 1,4;TSRC 0")
    dg645.advance(0.0, Faults())
    assert int(told(dg645, "INSR?")[0]) & 2
    assert dg645.gate().gate_hz == 50  # every second trigger is used
    told(dg645, "TRAT 60;INSR?")
    dg645.advance(1.0, Faults())
    assert not int(told(dg645, "INSR?")[0]) & 2


def test_without_triggers_or_level_the_gate_stays_shut(dg645):
    told(dg645, "DLAY 3,2,1e-6;LAMP 1,4")
    for source in (3, 4, 5):
        told(dg645, f"TSRC {source}")
        assert not dg645.gate().gate_open
    told(dg645, "TSRC 0;LAMP 1,1")
    assert not dg645.gate().gate_open


def test_a_wrong_polarity_makes_idle_open(dg645):
    told(dg645, "LAMP 1,4;LPOL 1,0")
    assert dg645.gate().gate_open
    assert math.isinf(dg645.gate().gate_ns)


def test_a_burst_makes_several_pulses_a_trigger(dg645):
    told(dg645, "DLAY 3,2,1e-6;LAMP 1,4;TRAT 60;TSRC 0;BURC 4;BURP 1e-4;BURM 1")
    assert dg645.gate().gate_hz == 240
