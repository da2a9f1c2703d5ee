"""The dose meter counts what may flow, writes it down when the gate is shut, and never stands in
the way.
"""

from dataclasses import replace

import pytest

from drivers.bench.meters import LONGEST_S, DoseMeter
from drivers.bench.state import TubeState
from labdata import DoseLedger, Limits, limits_in_force, load_sensor

LIMITS = limits_in_force(Limits(), load_sensor("pulnix-ag5745ef3"))
LIT = TubeState(duty=0.5, mcp_v=800.0, light_lux=1e-3)
SHUT = replace(LIT, duty=0.0)


@pytest.fixture
def ledger(tmp_path):
    return DoseLedger(tmp_path / "tubes" / "tube.jsonl")


@pytest.fixture
def meter(ledger):
    return DoseMeter(ledger, LIMITS, session="s")


def test_charge_is_current_times_time_less_what_the_plate_cannot_give(meter, ledger):
    """1 mlux on 1350 uA/lm is 135 pA/cm2, times a gain of 50 is 6.75 nA/cm2; half the time for
    4 s.
    """
    meter.watch(SHUT, 0.0)
    meter.watch(LIT, 4.0)
    meter.watch(SHUT, 5.0)
    assert meter.close(5.0) is None
    total = ledger.total()
    asked = 1e-3 * 1350e-6 * 1e-4 * 50.0
    given = asked / (1.0 + asked / (0.2 * 0.6e-6))
    assert total.screen_c_per_cm2 == pytest.approx(given * 0.5 * 4.0, rel=1e-3)
    assert total.hours_at_gain == pytest.approx(5.0 / 3600.0)
    assert 2.0 < total.factor95 < 2.6


def test_a_long_exposure_is_written_down_on_the_way(meter, ledger):
    meter.watch(SHUT, 0.0)
    for tick in range(1, 26):
        meter.watch(LIT, 1.0 * tick)
    assert meter.flush(5.0)
    assert len(ledger) == int(25.0 // LONGEST_S)


def test_light_in_a_pinhole_is_counted_apart(meter, ledger):
    meter.watch(SHUT, 0.0)
    meter.watch(replace(LIT, point=True), 4.0)
    meter.watch(SHUT, 5.0)
    meter.close(5.0)
    assert ledger.total().screen_c_per_cm2 == 0.0
    assert ledger.total().point_c_per_cm2 > 0.0


def test_what_nobody_has_read_is_not_counted(meter, ledger):
    meter.watch(TubeState(), 0.0)
    meter.watch(TubeState(), 100.0)
    meter.close(5.0)
    assert len(ledger) == 0


def test_a_disk_that_refuses_is_told_and_nothing_is_forgotten(tmp_path):
    (tmp_path / "tubes").write_text("a file where the folder should be")
    ledger = DoseLedger(tmp_path / "tubes" / "tube.jsonl")
    meter = DoseMeter(ledger, LIMITS, session="s")
    meter.watch(SHUT, 0.0)
    meter.watch(LIT, 4.0)
    meter.watch(SHUT, 5.0)
    assert meter.flush(5.0)
    assert meter.failure is not None and "dose must be written" in meter.failure
    (tmp_path / "tubes").unlink()
    assert meter.close(5.0) is None
    assert ledger.total().screen_c_per_cm2 > 0.0
