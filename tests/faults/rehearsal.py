"""`make rehearsal`: a night compressed: 500 steps of gain by light with faults on, then measured beside the truth.

The virtual bench is on real wires, its high voltage moves ten times faster than life, and every so many steps a fault
strikes; whoever watches over the night repairs the bench and resumes. The session that comes out is measured by
`charact measure --quick`, and each number whose truth is known stands beside it.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np

from charact.measuring import measure
from charact.report.truth import Beside, beside_truth
from drivers.acquisition.acquire import LOG
from labdata.conditions import Conditions
from labdata.event_log import events
from labdata.limits import Override
from labdata.measurement import Result
from labdata.plan import Plan, Step
from labdata.sensor import Sensor
from labdata.sensors import save_sensor
from labdata.session import Session, open_session
from simulate.iiccd import truth
from tests.faults.campaign.client import Client
from tests.faults.campaign.kinds import KILL, KINDS, draw_fault
from tests.faults.campaign.rig import CampaignRig

ROWS, COLUMNS = 123, 192
FASTER = 10.0
LOWEST_V, HIGHEST_V = 740.0, 860.0
FULL_LUX, AT_V, GAIN_EXPONENT = 6e-4, 700.0, 10.5
DIMMEST_SHARE = 0.03
FRAMES = 12
GATE_NS = 1.6e7
STRIKES_EVERY_S = (8.0, 30.0)
DRAWING_S = 60.0  # the simulator may be compiled first
MOST_RUNS = 400
MOST_IDLE_RUNS = 6
JUDGED = ("covariance_gain", "blur_factor")


def main() -> int:
    """Rehearse, measure and print; exit code 1 if the plan was not completed or an ok interval misses by far."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--voltages", type=int, default=20)
    parser.add_argument("--lights", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with CampaignRig(folder, asked.seed, rows=ROWS, columns=COLUMNS, time_scale=FASTER) as rig:
            save_sensor(rig.sensor, folder / "sensor.toml")
            plan = night_plan(folder / "sensor.toml", asked.voltages, asked.lights, asked.seed)
            began_s = time.monotonic()
            runs, struck = rehearsed(rig, plan, folder / "night", asked.seed)
            taken_s, specimen = time.monotonic() - began_s, rig.truth.sensor
        session = open_session(folder / "night")
        _tell_night(session, plan, runs, struck, taken_s)
        began_s = time.monotonic()
        result = measure(session, quick=True, seed=asked.seed)
        rows = beside(result, session, specimen)
        _tell_measured(result, rows, time.monotonic() - began_s)
    whole = len(session.stacks) == len(plan.steps) and all(entry.finished for entry in session.stacks)
    return 0 if whole and all(abs(row.z) < 4.5 for row in rows if row.measurement.status == "ok") else 1


def night_plan(sensor: Path, voltages: int, lights: int, seed: int) -> Plan:
    """A dark and a ladder of lights at every voltage, up one ladder and down the next.

    The light of each ladder falls as the gain rises, so that every ladder ends at about the same signal.
    """
    steps: list[Step] = []
    for number, mcp_v in enumerate(np.linspace(LOWEST_V, HIGHEST_V, voltages).round()):
        ladder = FULL_LUX * (mcp_v / AT_V) ** -GAIN_EXPONENT * np.geomspace(DIMMEST_SHARE, 1.0, lights)
        steps.append(_step(f"dark-{mcp_v:.0f}V", "dark", mcp_v, None))
        steps += [
            _step(f"flat-{mcp_v:.0f}V-{lux:.3g}lux", "flat", mcp_v, float(lux))
            for lux in (ladder if number % 2 == 0 else ladder[::-1])
        ]
    faster = Override(limit="ramp_v_per_s", value=FASTER * 50.0, reason="the virtual output moves faster than life")
    return Plan(name="night", sensor=str(sensor), seed=seed, overrides=(faster,), steps=tuple(steps))


def _step(label: str, kind, mcp_v: float, lux: float | None) -> Step:
    sd = None if lux is None else 0.03
    asked = Conditions(mcp_v=float(mcp_v), gate_ns=GATE_NS, illuminance_lux=lux, illuminance_relative_sd=sd)
    return Step(label=label, kind=kind, frames=FRAMES, conditions=asked)


def rehearsed(rig: CampaignRig, plan: Plan, session: Path, seed: int) -> tuple[int, Counter[str]]:
    """Run the plan, strike, repair and resume until it is complete; return the runs and what struck."""
    rng, progress = np.random.default_rng(seed), [0]
    struck: Counter[str] = Counter()
    kinds = (*KINDS, KILL)
    for run in range(1, MOST_RUNS):
        rig.heal()
        client = Client(rig, plan, session, silence_s=DRAWING_S)
        while client.wait(float(rng.uniform(*STRIKES_EVERY_S))) is None:
            fault = draw_fault(kinds[sum(struck.values()) % len(kinds)], rng)
            struck[fault.kind] += 1
            fault.strike(rig, client)
            client.wait(fault.hold_s)
            fault.heal(rig, client)
            fault.repair(rig)
        rig.await_free()
        if client.exit_code() == 0:
            return run, struck
        print(f"run {run}: {_end_of(session)}", flush=True)
        progress.append(_finished(session))
        if len(progress) > MOST_IDLE_RUNS and progress[-1] == progress[-1 - MOST_IDLE_RUNS]:
            break
    raise RuntimeError(f"the night must go on, got no step finished in {MOST_IDLE_RUNS} runs: {_end_of(session)}")


def _finished(session: Path) -> int:
    """Steps finished so far, as the session's log tells it."""
    if not (session / LOG).exists():
        return 0
    return sum(each["event"] == "step finished" for each in events(session / LOG))


def _end_of(session: Path) -> str:
    """How the last run ended, as the session's log tells it."""
    if not (session / LOG).exists():
        return "ended before its session began"
    last = events(session / LOG)[-1]
    how = last.get("reason", "complete") if last["event"] == "run ends" else f"killed after {last['event']!r}"
    return f"{_finished(session)} steps finished; {how}"


def beside(result: Result, session: Session, specimen: Sensor) -> tuple[Beside, ...]:
    """Every number with a truth beside it; those of a setting beside the truth at that setting."""
    main = _main_voltage(result, session)

    @cache
    def known(mcp_v: float | None) -> dict[str, float]:
        return truth.quantities(specimen, Conditions(mcp_v=mcp_v, gate_ns=GATE_NS))

    rows: list[Beside] = []
    for m in (m for name in JUDGED for m in result.find(name)):
        found = known(main if m.stack is None else session.stack(m.stack).conditions.mcp_v)
        rows += beside_truth(Result(measurements=(m,)), {m.quantity: found[m.quantity]})
    return tuple(rows)


def _main_voltage(result: Result, session: Session) -> float | None:
    """The voltage at which the session's own gain was measured: the one that no setting of the sweep has."""
    swept = {session.stack(m.stack).conditions.mcp_v for m in result.find("covariance_gain") if m.stack is not None}
    left = {entry.conditions.mcp_v for entry in session.of_kind("flat")} - swept
    return next(iter(left)) if len(left) == 1 else None


def _tell_night(session: Session, plan: Plan, runs: int, struck: Counter[str], taken_s: float) -> None:
    told = events(session.folder / LOG)
    spent_ms = [each["overhead_ms"] for each in told if each["event"] == "step finished"]
    done = sum(entry.finished for entry in session.stacks)
    lost = sum(entry.lost_frames for entry in session.stacks)
    print(
        f"{done} of {len(plan.steps)} steps in {taken_s / 60.0:.1f} min and {runs} runs; {lost} frames lost, numbered"
    )
    print(f"faults: {', '.join(f'{kind} {count}' for kind, count in sorted(struck.items()))}")
    print(f"overhead of a step: median {np.median(spent_ms):.1f} ms")


def _tell_measured(result: Result, rows: tuple[Beside, ...], seconds: float) -> None:
    print(f"measured in {seconds:.0f} s: {len(result.measurements)} quantities, {len(rows)} with a truth beside them")
    for row in rows:
        m = row.measurement
        where = f"{m.quantity:16} {m.stack or '':24} truth {row.truth_text:>9}"
        print(f"  {where}  {row.measured_text:>24}  z {row.z:5.2f}  {m.status} {' '.join(m.flags)}")
    ok = [row for row in rows if row.measurement.status == "ok"]
    for name, some in (("ok", ok), ("all", list(rows))):
        if some:
            inside, worst = sum(abs(row.z) <= 1.96 for row in some), max(abs(row.z) for row in some)
            print(f"{name}: {inside} of {len(some)} intervals of 95 % hold the truth, worst z {worst:.1f}")


if __name__ == "__main__":
    sys.exit(main())
