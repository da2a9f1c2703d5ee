"""The drivers say exactly what the manuals ask for: each test is the list of exchanges on the
line.
"""

import pytest

from drivers.errors import InstrumentRejected, InstrumentReplyError, InstrumentTripped
from drivers.instruments.delay_generator import DelayGenerator
from drivers.instruments.high_voltage import HighVoltage
from drivers.serial_lines.line import InstrumentLine


class Exchanges(InstrumentLine):
    """A line that knows what must be said, in order, and what is answered (None: nothing)."""

    def __init__(self, *expected: tuple[str, str | None], name: str = "instrument") -> None:
        super().__init__(None, name=name)  # type: ignore[arg-type]
        self._expected = list(expected)

    def write(self, command: str) -> None:
        self._next(command, None)

    def _order(self, command: str) -> None:
        self.write(command)

    def _get_into_step(self) -> None:
        pass

    def _exchange(self, question: str) -> str:
        answer = self._next(question, "an answer")
        assert answer is not None, f"{question} is answered by nothing"
        return answer

    def close(self) -> None:
        pass

    def _next(self, said: str, kind: str | None) -> str | None:
        assert self._expected, f"nothing more must be said, got {said!r}"
        must, answer = self._expected.pop(0)
        assert said == must
        assert (answer is None) == (kind is None), said
        return answer

    def __enter__(self) -> "Exchanges":
        return self

    def __exit__(self, kind, error, trace) -> None:
        if kind is None:
            assert not self._expected, f"still to be said: {self._expected}"


def sets(*commands: str) -> list[tuple[str, str | None]]:
    """Each command, and the error queue asked after it."""
    return [exchange for command in commands for exchange in ((command, None), ("LERR?", "0"))]


SHUT = [
    ("TSRC 5", None),
    ("LPOL 1,1", None),
    ("LOFF 1,0", None),
    ("LERR?", "0"),
    ("TSRC?", "5"),
    ("LPOL? 1", "1"),
    ("LOFF? 1", "+0.00"),
]
OTHER_EDGES = [f"DLAY {edge},0,0" for edge in range(4, 10)]
PROGRAM = sets(
    *OTHER_EDGES,
    "BURM 0",
    "PRES 0,1",
    "PRES 1,1",
    "HOLD 0.000000000000",
    "ADVT 0",
    "INHB 0",
    "LAMP 1,4",
    "TRAT 60.000000",
    "DLAY 2,0,0.000000000000",
    "DLAY 3,2,0.016000000000",
)
READ_BACK = [
    ("BURM?", "0"),
    ("PRES? 0", "1"),
    ("PRES? 1", "1"),
    ("HOLD?", "+0.000000000000"),
    ("ADVT?", "0"),
    ("INHB?", "0"),
    ("TRAT?", "+60.000000"),
    ("LAMP? 1", "+4.00"),
    ("DLAY? 2", "0,+0.000000000000"),
    ("DLAY? 3", "2,+0.016000000000"),
]
TRIGGER = [("INSR?", "0"), *sets("TSRC 0"), ("TSRC?", "0")]


def test_the_gate_is_shut_by_removing_triggers_first():
    with Exchanges(*SHUT) as line:
        DelayGenerator(line).shut()


def test_the_gate_is_programmed_while_shut_and_read_back_before_it_opens():
    with Exchanges(*SHUT, *PROGRAM, *READ_BACK, *TRIGGER, ("INSR?", "5")) as line:
        assert DelayGenerator(line).open(width_ns=1.6e7, rate_hz=60.0) == pytest.approx(1.6e7)


OPEN = [
    ("LPOL? 1", "1"),
    ("LOFF? 1", "+0.00"),
    *READ_BACK,
    ("TSRC?", "0"),
]


@pytest.mark.parametrize("place", range(len(OPEN)))
def test_each_setting_of_an_open_gate_is_compared_at_every_look(place):
    question, answer = OPEN[place]
    changed = answer.replace("0", "3", 1) if "0" in answer else "0"
    looks = [*OPEN, *OPEN[:place], (question, changed)]
    with Exchanges(
        *SHUT, *PROGRAM, *READ_BACK, *TRIGGER, ("INSR?", "5"), *looks, name="gate"
    ) as line:
        gate = DelayGenerator(line)
        gate.open(width_ns=1.6e7, rate_hz=60.0)
        gate.look()
        with pytest.raises(InstrumentRejected) as change:
            gate.look()
    assert f"at {answer}, got {changed}: somebody changed it at the panel" in str(change.value)


def test_a_gate_that_nobody_set_shows_a_sign_of_life_and_one_that_was_shut_must_stay_shut():
    with Exchanges(("TSRC?", "0"), *SHUT, *SHUT[4:], ("TSRC?", "1"), name="gate") as line:
        gate = DelayGenerator(line)
        gate.look()
        gate.shut()
        gate.look()
        with pytest.raises(
            InstrumentRejected, match="the gate must keep its trigger source at 5, got 1: somebody"
        ):
            gate.look()


def test_a_setting_that_is_half_done_is_compared_with_nothing():
    refused = [*SHUT, ("DLAY 4,0,0", None), ("LERR?", "12")]
    with Exchanges(*refused, ("LPOL? 1", "1"), ("LOFF? 1", "+0.00"), name="gate") as line:
        gate = DelayGenerator(line)
        with pytest.raises(InstrumentRejected, match="illegal delay"):
            gate.open(width_ns=1.6e7, rate_hz=60.0)
        gate.look()  # the trigger source was about to change


def test_lost_triggers_shut_the_gate_again():
    with (
        Exchanges(
            *SHUT, *PROGRAM, *READ_BACK, *TRIGGER, ("INSR?", "7"), *SHUT, name="delay generator"
        ) as line,
        pytest.raises(InstrumentRejected, match="must use every trigger, got some lost at 60 Hz"),
    ):
        DelayGenerator(line).open(width_ns=1.6e7, rate_hz=60.0)


def test_a_width_read_back_otherwise_never_opens_the_gate():
    back = [*READ_BACK[:-1], ("DLAY? 3", "2,+0.015000000000")]
    with (
        Exchanges(*SHUT, *PROGRAM, *back) as line,
        pytest.raises(
            InstrumentRejected,
            match=r"must keep a gate width of 1.6e[+]07 ns, got 1.5e[+]07 ns back",
        ),
    ):
        DelayGenerator(line).open(width_ns=1.6e7, rate_hz=60.0)


def test_a_refused_command_is_told_with_its_meaning():
    with (
        Exchanges(
            ("TSRC 5", None), ("LPOL 1,1", None), ("LOFF 1,0", None), ("LERR?", "171")
        ) as line,
        pytest.raises(InstrumentRejected, match="error 171: overrun") as refusal,
    ):
        DelayGenerator(line).shut()
    assert refusal.value.code == 171


def done(*commands: str) -> list[tuple[str, str | None]]:
    """Each command, and the event status asked after it."""
    return [exchange for command in commands for exchange in ((command, None), ("*ESR?", "0"))]


ON, OFF = ("*STB?", "128"), ("*STB?", "0")


def test_the_supply_is_off_and_limited_before_anything_else():
    with Exchanges(
        *done("HVOF"), ("*STB?", "0"), *done("VSET 50", "VLIM 900"), ("VLIM?", "900")
    ) as line:
        HighVoltage(line).prepare(limit_v=900)


def test_a_limit_read_back_higher_is_refused():
    with (
        Exchanges(
            *done("HVOF"), ("*STB?", "0"), *done("VSET 50", "VLIM 900"), ("VLIM?", "5000")
        ) as line,
        pytest.raises(InstrumentRejected, match="must keep a limit of 900 V, got 5000 V back"),
    ):
        HighVoltage(line).prepare(limit_v=900)


def test_the_voltage_rises_in_small_steps_and_is_verified_at_the_output():
    steps = [said for volts in (100, 150, 180) for said in (ON, *done(f"VSET {volts}"))]
    settling = [*(("VOUT?", volts) for volts in ("150", "170", "180", "180")), ON]
    with Exchanges(("VSET?", "50"), *steps, *settling) as line:
        assert HighVoltage(line).raise_to(180, rate_v_per_s=1000) == 180


def test_an_output_that_does_not_follow_is_refused():
    with (
        Exchanges(
            ("VSET?", "50"), ON, *done("VSET 100"), ("VOUT?", "50"), ("VOUT?", "50"), ON
        ) as line,
        pytest.raises(InstrumentRejected, match="must put out 100 V as set, got 50 V"),
    ):
        HighVoltage(line).raise_to(100, rate_v_per_s=1000)


def test_a_trip_ends_a_ramp_at_the_next_step():
    tripped = [("VSET?", "50"), ON, *done("VSET 100"), ("*STB?", "4")]
    with Exchanges(*tripped) as line, pytest.raises(InstrumentTripped, match="on current"):
        HighVoltage(line).raise_to(800, rate_v_per_s=1000)


RAISED = [("VSET?", "50"), ON, *done("VSET 100"), ("VOUT?", "100"), ("VOUT?", "100"), ON]


@pytest.mark.parametrize(
    ("look", "error", "sentence"),
    [
        ([ON, ("VOUT?", "104")], None, ""),
        (
            [ON, ("VOUT?", "106"), ON],
            InstrumentRejected,
            "put out 100 V as set, got 106 V: somebody changed it",
        ),
        ([ON, ("VOUT?", "95"), ON], InstrumentRejected, "put out 100 V as set, got 95 V"),
        ([ON, ("VOUT?", "95"), ("*STB?", "4")], InstrumentTripped, "got a trip on current"),
        ([OFF], InstrumentTripped, "got a trip without a trip bit"),
    ],
)
def test_a_supply_that_is_on_is_compared_with_its_set_point(look, error, sentence):
    with Exchanges(*done("VSET 50"), ("HVON", None), ("*ESR?", "0"), ON, *RAISED, *look) as line:
        supply = HighVoltage(line)
        supply.switch_on()
        supply.look()  # between two voltages only a trip can be seen
        supply.raise_to(100, rate_v_per_s=1000)
        if error is None:
            supply.look()
        else:
            with pytest.raises(error, match=sentence):
                supply.look()


def test_a_supply_that_is_off_must_not_rise_or_be_on():
    falling = [
        exchange for volts in ("300", "30", "3", "7") for exchange in (OFF, ("VOUT?", volts))
    ]
    with Exchanges(("VOUT?", "700"), *done("HVOF"), *falling, OFF, ("VOUT?", "8"), ON) as line:
        supply = HighVoltage(line)
        supply.look()  # nothing was set
        supply.order_off()
        for _ in range(4):
            supply.look()
        with pytest.raises(
            InstrumentRejected, match="stay off, at 3 V or less, got 8 V: somebody switched it on"
        ):
            supply.look()
        with pytest.raises(InstrumentRejected, match="stay off, got high voltage on"):
            supply.look()


@pytest.mark.parametrize(
    ("status", "how"), [(130, "on voltage"), (4, "on current"), (0, "without a trip bit")]
)
def test_a_supply_that_switched_itself_off_is_tripped(status, how):
    with Exchanges(("*STB?", str(status))) as line, pytest.raises(InstrumentTripped, match=how):
        HighVoltage(line).check_on()


def test_a_trip_not_cleared_at_the_instrument_keeps_it_off():
    with Exchanges(*done("VSET 50"), ("HVON", None), ("*ESR?", "16")) as line:
        supply = HighVoltage(line)
        with pytest.raises(InstrumentTripped, match="find its cause"):
            supply.switch_on()
        assert not supply.is_on


def test_words_where_a_number_belongs_are_confusion():
    with (
        Exchanges(("VOUT?", "OK")) as line,
        pytest.raises(InstrumentReplyError, match=r"VOUT\? with a number, got 'OK'"),
    ):
        HighVoltage(line).read_voltage_v()


def test_a_voltage_that_is_not_finite_is_confusion():
    with Exchanges(("VOUT?", "nan")) as line, pytest.raises(InstrumentReplyError):
        HighVoltage(line).read_voltage_v()
