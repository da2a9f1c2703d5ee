"""The night: its plan of gain by light, the faults that strike it, and whoever repairs the bench
and resumes.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.campaign.client import Client
from benchmarks.studies.faults.campaign.kinds import draw_fault
from benchmarks.studies.faults.campaign.rig import CampaignRig
from drivers.acquisition.acquire import LOG
from labdata import Conditions, EventLog, Override, Plan, Step, read_events

FASTER = 10.0
LOWEST_V, HIGHEST_V = 740.0, 860.0
FULL_LUX, AT_V, GAIN_EXPONENT = 6e-4, 700.0, 10.5
DIMMEST_SHARE = 0.03
FRAMES = 12
GATE_NS = 1.6e7
KINDS = (
    "garbage",
    "half lines",
    "silence",
    "no answers",
    "late answers",
    "trip of the supply",
    "power of an instrument gone",
    "power of an instrument off and on",
    "packet loss",
    "camera stalls",
    "camera gone",
    "clocks jump",
    "client stopped",
    "server killed",
    "client killed",
)
"""Faults that strike the night in turn."""

STRIKES_EVERY_S = (15.0, 60.0)
DRAWING_S = 60.0  # the simulator may be compiled first
MOST_RUNS = 400
MOST_IDLE_RUNS = 6


def night_plan(sensor: Path, *, voltages: int, lights: int, seed: int) -> Plan:
    """A dark and a ladder of lights at every voltage, up one ladder and down the next.

    The light of each ladder falls as the gain rises, so that every ladder ends at about the same
    signal.
    """
    steps: list[Step] = []
    for number, mcp_v in enumerate(np.linspace(LOWEST_V, HIGHEST_V, voltages).round()):
        ladder = (
            FULL_LUX * (mcp_v / AT_V) ** -GAIN_EXPONENT * np.geomspace(DIMMEST_SHARE, 1.0, lights)
        )
        steps.append(_step(f"dark-{mcp_v:.0f}V", "dark", mcp_v, None))
        steps += [
            _step(f"flat-{mcp_v:.0f}V-{lux:.3g}lux", "flat", mcp_v, float(lux))
            for lux in (ladder if number % 2 == 0 else ladder[::-1])
        ]
    faster = Override(
        limit="ramp_v_per_s",
        value=FASTER * 50.0,
        reason="the virtual output moves faster than life",
    )
    return Plan(
        name="night", sensor=str(sensor), seed=seed, overrides=(faster,), steps=tuple(steps)
    )


def _step(label: str, kind, mcp_v: float, lux: float | None) -> Step:
    sd = None if lux is None else 0.03
    asked = Conditions(
        mcp_v=float(mcp_v), gate_ns=GATE_NS, illuminance_lux=lux, illuminance_relative_sd=sd
    )
    return Step(label=label, kind=kind, frames=FRAMES, conditions=asked)


@dataclass(frozen=True, kw_only=True)
class Diary:
    """What happened in a night, run by run, kept in a file so that a night that is broken off can
    go on.

    Parameters
    ----------
    path
        The file, JSON lines.
    """

    path: Path

    def told(self, event: str) -> list[dict]:
        """All entries of a kind, in order."""
        return (
            [each for each in read_events(self.path) if each["event"] == event]
            if self.path.exists()
            else []
        )

    @property
    def seconds(self) -> float:
        """Time that all runs took, with the repairs between them, s."""
        return sum(each["seconds"] for each in self.told("run"))


def rehearse(rig: CampaignRig, plan: Plan, session: Path, diary: Diary, seed: int) -> None:
    """Run the plan, strike, repair and resume until it is complete; a night that was broken off
    goes on.
    """
    log = EventLog(diary.path)
    progress = [_finished(session)]
    while len(progress) < MOST_RUNS:
        # Each run has a seed of its own, so that a night that goes on does not meet the same faults
        # again.
        rng = np.random.default_rng([seed, len(diary.told("run"))])
        began_s = time.monotonic()
        rig.heal()
        client = Client(rig, plan, session, silence_s=DRAWING_S)
        while client.wait(float(rng.uniform(*STRIKES_EVERY_S))) is None:
            kind = KINDS[len(diary.told("fault")) % len(KINDS)]
            fault = draw_fault(kind, rng)
            log("fault", kind=kind)
            fault.strike(rig, client)
            client.wait(fault.lasts_s)
            fault.heal(rig, client)
            fault.repair(rig)
        client.close()
        rig.await_free()
        rig.switch_off_what_is_on()
        end = "complete" if client.exit_code() == 0 else _end_of(session)
        progress.append(_finished(session))
        log("run", seconds=round(time.monotonic() - began_s, 1), finished=progress[-1], end=end)
        log.flush()
        print(
            f"run {len(diary.told('run'))}: {progress[-1]} of {len(plan.steps)} steps; {end}",
            flush=True,
        )
        if client.exit_code() == 0:
            return
        if len(progress) > MOST_IDLE_RUNS and progress[-1] == progress[-1 - MOST_IDLE_RUNS]:
            break
    raise RuntimeError(
        f"the night must go on, got no step finished in {MOST_IDLE_RUNS} runs: {_end_of(session)}"
    )


def _finished(session: Path) -> int:
    """Steps finished so far, as the session's log tells it."""
    if not (session / LOG).exists():
        return 0
    return sum(each["event"] == "step finished" for each in read_events(session / LOG))


def _end_of(session: Path) -> str:
    """How the last run ended, as the session's log tells it."""
    if not (session / LOG).exists():
        return "ended before its session began"
    last = read_events(session / LOG)[-1]
    return (
        last.get("reason", "complete")
        if last["event"] == "run ends"
        else f"killed after {last['event']!r}"
    )
