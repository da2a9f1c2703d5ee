"""The dose of a tube adds up over sessions, outlives half-written lines, and warns of a life used
up.
"""

import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from labdata import (
    BadInput,
    Dose,
    DoseLedger,
    dose_of,
    ledger_of,
    load_sensor,
    total_dose,
    tube_dose,
)

SENSOR = load_sensor("pulnix-ag5745ef3")


def dose(charge: float = 1e-6, hours: float = 0.5, log_sd: float = 0.4) -> Dose:
    return Dose(screen_c_per_cm2=charge, hours_at_gain=hours, log_sd=log_sd)


def test_the_worked_example_of_the_tubes_life_is_met():
    """25 nA/cm2 for 1000 h are 0.09 C/cm2."""
    whole = dose_of(
        delivered_na_per_cm2=25.0, lit_s=3.6e6, at_gain_s=3.6e6, point=False, log_sd=0.0
    )
    assert whole.screen_c_per_cm2 == pytest.approx(0.09)
    assert whole.hours_at_gain == pytest.approx(1000.0)


def test_doses_add_and_their_uncertainty_does_not_average_out():
    total = total_dose([dose(1e-6), dose(3e-6)])
    assert total.screen_c_per_cm2 == pytest.approx(4e-6)
    assert total.hours_at_gain == 1.0
    assert total.factor95 == pytest.approx(math.exp(1.96 * 0.4))


def test_the_ledger_of_a_tube_goes_on_over_sessions(tmp_path, monkeypatch):
    monkeypatch.setenv(tube_dose.FOLDER_VARIABLE, str(tmp_path / "tubes"))
    ledger_of("SN 1234").append(dose(1e-6), session="monday")
    ledger_of("SN 1234").append(dose(2e-6), session="tuesday")
    assert ledger_of("SN 1234").total().screen_c_per_cm2 == pytest.approx(3e-6)
    assert ledger_of("another").total() == Dose()


@pytest.mark.parametrize("name", ["", "a/b", "..", ".hidden"])
def test_a_tubes_name_is_a_file_name(name):
    with pytest.raises(BadInput, match="a tube's name must be a file name"):
        ledger_of(name)


@pytest.fixture
def ledger(tmp_path):
    """A ledger of one dose."""
    ledger = DoseLedger(tmp_path / "tube.jsonl")
    ledger.append(dose())
    return ledger


def test_half_a_line_is_left_alone_and_the_next_dose_begins_anew(ledger):
    with open(ledger.path, "ab") as file:
        file.write(b'{"time": "2025-01-01T00:00:00+00:00", "screen_c_p')
    ledger.append(dose())
    assert len(ledger) == 2
    assert ledger.total().screen_c_per_cm2 == pytest.approx(2e-6)


@pytest.mark.parametrize(
    "line", ["[]", "7", "{}", '{"screen_c_per_cm2": -1}', "hello", '{"hours_at_gain": "x"}']
)
def test_a_line_that_is_no_dose_is_refused_with_its_number(ledger, line):
    with open(ledger.path, "a") as file:
        file.write(line + "\n")
    with pytest.raises(
        BadInput, match="every line of a dose ledger must hold a dose, got another in line 2"
    ):
        ledger.total()


def _keep_adding(path: str, told) -> None:
    ledger = DoseLedger(path)
    for count in range(1, 100_000):
        ledger.append(dose())
        told.value = count


def test_what_was_written_survives_kill_9(tmp_path):
    context = multiprocessing.get_context("fork")
    told = context.Value("i", 0)
    writer = context.Process(target=_keep_adding, args=(str(tmp_path / "tube.jsonl"), told))
    writer.start()
    until_s = time.monotonic() + 20.0
    while told.value < 5 and time.monotonic() < until_s:
        time.sleep(0.005)
    os.kill(writer.pid, signal.SIGKILL)
    writer.join(10.0)
    assert told.value >= 5
    ledger = DoseLedger(tmp_path / "tube.jsonl")
    assert told.value <= len(ledger) <= told.value + 1
    ledger.append(dose())
    assert told.value + 1 <= len(ledger) <= told.value + 2


HOLDER = (
    "import fcntl, sys; f = open(sys.argv[1], 'ab'); fcntl.flock(f, 2); print('locked', "
    "flush=True); sys.stdin.read()"
)


@contextmanager
def locked(path):
    """Another process holds the lock of a ledger."""
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdin is not None and holder.stdout is not None
    holder.stdout.readline()
    yield
    holder.communicate()


def test_a_lock_that_another_process_keeps_is_waited_for_only_so_long(ledger, monkeypatch):
    monkeypatch.setattr("labdata.tube_dose.PATIENCE_S", 0.2)
    before = ledger.path.read_bytes()
    with locked(ledger.path):
        began_s = time.monotonic()
        with pytest.raises(
            TimeoutError, match=r"^another process has locked it for more than 0\.2 s$"
        ):
            ledger.append(dose())
        assert 0.2 <= time.monotonic() - began_s < 1.0
        assert len(ledger) == 1
    assert ledger.path.read_bytes() == before
    ledger.append(dose())
    assert len(ledger) == 2


def test_a_reader_in_the_same_process_does_not_end_the_lock(ledger, monkeypatch):
    monkeypatch.setattr("labdata.tube_dose.PATIENCE_S", 0.1)
    with open(ledger.path, "ab") as file:
        tube_dose._lock(file.fileno())
        assert len(ledger) == 1
        with pytest.raises(TimeoutError):
            ledger.append(dose())


def test_an_append_reads_one_byte_of_the_ledger_however_long_it_is(ledger, monkeypatch):
    read = []
    pread = os.pread
    monkeypatch.setattr(
        os, "pread", lambda file, count, at: read.append(count) or pread(file, count, at)
    )
    monkeypatch.setattr(DoseLedger, "_doses", lambda self: pytest.fail("the ledger was read"))
    monkeypatch.setattr(
        type(ledger.path), "read_bytes", lambda self: pytest.fail("the ledger was read")
    )
    ledger.append(dose())
    assert read == [1]


def test_a_life_nearly_used_up_is_warned_of():
    assert tube_dose.warnings(dose(charge=0.2), SENSOR) == ()
    (told,) = tube_dose.warnings(dose(charge=0.25), SENSOR)
    assert (
        told == "The tube's screen charge is 0.25 C/cm2, 83% of the 0.3 C/cm2 expected of its life."
    )
    (told,) = tube_dose.warnings(dose(hours=20_000.0), SENSOR)
    assert "time at gain is 2e+04 h, 100% of the 20000 h" in told


def test_an_unknown_tube_is_warned_of_sooner():
    assert tube_dose.warnings(dose(charge=0.09), None) and not tube_dose.warnings(
        dose(charge=0.09), SENSOR
    )
