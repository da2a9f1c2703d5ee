"""Programs of faults over emulated instruments are judged as they are, and shrink."""

import os
import time
from dataclasses import replace

import pytest

from benchmarks.studies.faults.inventing import trial
from benchmarks.studies.faults.inventing.__main__ import attempt, program_of
from benchmarks.studies.faults.inventing.faults import Fault, smaller

KILLED = Fault(kind="killed", who="client", at_s=0.9, for_s=0.1)


@pytest.mark.wires
def test_a_run_without_faults_completes():
    verdict = attempt((), 0)
    assert (verdict.broken, verdict.ended) == ((), "all frames are stored")


@pytest.mark.wires
def test_a_tube_is_safe_in_time_after_faults_and_a_judge_without_patience_sees_it_on(monkeypatch):
    away = Fault(kind="unplugged", who="supply", at_s=0.8, for_s=1.0)
    verdict = attempt((away, KILLED), 0)
    assert verdict.broken == () and 0.0 < verdict.hot_s["supply"] < trial.LIMIT_S
    monkeypatch.setattr(trial, "LIMIT_S", -trial.SLACK_S)
    assert "supply on for" in " ".join(attempt((away, KILLED), 0).broken)


@pytest.mark.wires
def test_a_supply_that_answers_nonsense_keeps_nobody_from_the_gate():
    garbled = Fault(kind="garbled answers", who="supply", at_s=0.1, for_s=3.5, value=1)
    by_hand = Fault(kind="panel", who="gate", at_s=0.8, for_s=0.1, value="LOFF 1,2")
    verdict = attempt((garbled, by_hand), 0)
    assert verdict.broken == () and 0.0 < verdict.hot_s["gate"] < 1.0


@pytest.mark.wires
def test_swapped_ports_are_told_apart_in_time_on_a_busy_machine():
    # A client that stood still is taken for a busy machine, and limits grow by 2.5 s.
    stopped = Fault(kind="stopped", who="client", at_s=-0.46, for_s=0.665)
    swapped = Fault(kind="swapped", who="gate", at_s=1.132, for_s=1.224, value=1)
    assert attempt((stopped, swapped), 0).broken == ()


@pytest.mark.wires
def test_a_disk_whose_every_sync_takes_half_a_second_ends_no_run(monkeypatch):
    sync, steps = os.fsync, tuple(replace(step, frames=9) for step in trial.PLAN.steps)
    monkeypatch.setattr(trial, "PLAN", replace(trial.PLAN, steps=steps))
    monkeypatch.setattr(os, "fsync", lambda file: (time.sleep(0.5), sync(file)))
    assert attempt((), 0).ended == "all frames are stored"


@pytest.mark.wires
def test_two_dead_processes_leave_nobody_to_act():
    both = (KILLED, Fault(kind="killed", who="server", at_s=0.9, for_s=0.1))
    assert attempt(both, 0).beyond_software


def test_a_program_is_the_same_again_and_every_smaller_one_is_smaller():
    assert program_of(3, 7) == program_of(3, 7) != program_of(3, 8)
    program = (KILLED, Fault(kind="silent", who="gate", at_s=0.2, for_s=0.8, value=1))
    sizes = [(len(each), sum(fault.for_s for fault in each)) for each in smaller(program)]
    assert sizes == [(1, 0.8), (1, 0.1), (2, 0.5)]
