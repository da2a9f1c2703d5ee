"""One trial: a fault at a random moment of a running plan, and what became of frames, tube and log."""

import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.acquisition.acquire import LOG
from labdata.errors import BadInput
from labdata.event_log import read_events
from labdata.plan import Plan
from labdata.session import MANIFEST, open_session
from tests.faults.campaign.client import Client
from tests.faults.campaign.kinds import Fault
from tests.faults.campaign.rig import DANGEROUS_V, CampaignRig

LOOK_S = 0.004
OPEN_S = 20.0
END_S = 30.0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a trial showed.

    Parameters
    ----------
    kind
        Kind of the fault.
    endured
        The run went on to its end all the same.
    live
        Whether gate or high voltage were on when the fault struck.
    gate_s, off_s
        Seconds from the fault, or from the frames that it kept from coming, until the gate was shut on its wire and
        the high voltage ordered off; None where that was not asked for: nothing was on, the run endured, or the
        instrument could not hear.
    broken
        Each promise that was broken, in words.
    """

    kind: str
    endured: bool
    live: bool
    gate_s: float | None
    off_s: float | None
    broken: tuple[str, ...]


def try_fault(
    rig: CampaignRig, plan: Plan, session: Path, fault: Fault, *, after_s: float, within_s: float
) -> Outcome | None:
    """Run a plan, or go on with it, and have a fault strike at a moment; None if the run had ended before.

    Parameters
    ----------
    rig, plan, session
        The bench, the plan and its session.
    fault
        What goes wrong.
    after_s
        When: seconds after the first step began, or, negative, before that, while bench and camera are opened.
    within_s
        Time promised to gate and high voltage, s.
    """
    client = Client(rig, plan, session, silence_s=fault.silence_s)
    if after_s >= 0.0:
        client.await_steps(OPEN_S)
    if client.wait(abs(after_s)) is not None:
        rig.await_free()
        return None
    struck = _Struck(rig, client, fault)
    gate_s = struck.watch()
    fault.heal(rig, client)
    code = client.wait(END_S)
    rig.await_free()
    if code is None:
        client.signal(signal.SIGKILL)
        client.wait(END_S)
    off_s = rig.ordered_off_s(struck.at_s)
    if fault.shows_in_frames:
        unseen_s = client.frames_due_s(struck.at_s) - struck.at_s
        gate_s, off_s = gate_s - unseen_s, None if off_s is None else off_s - unseen_s
    left_on = tuple(_left_on(rig, fault))
    fault.repair(rig)
    rig.switch_off_what_is_on()
    endured = code == 0
    timed = fault.ends_runs and not endured
    gate_must_shut = struck.gate_was_open or (fault.shows_in_frames and gate_s > 0.0)
    gate_s = max(gate_s, 0.0) if gate_must_shut and fault.gate_hears and timed else None
    must_be_ordered = struck.voltage_was_on and fault.supply_hears and timed
    off_s = (np.inf if off_s is None else off_s) if must_be_ordered else None
    return Outcome(
        kind=fault.kind,
        endured=endured,
        live=struck.gate_was_open or struck.voltage_was_on,
        gate_s=gate_s,
        off_s=off_s,
        broken=(
            *left_on,
            *_broken(client, session, fault, code, gate_s, off_s, within_s),
        ),
    )


def _left_on(rig: CampaignRig, fault: Fault) -> Iterator[str]:
    """What is still on when the last process that guarded the tube has ended, though it could hear."""
    left = rig.outputs()
    if left.gate_open and fault.gate_hears:
        yield "the gate was left open"
    if left.mcp_v > DANGEROUS_V and fault.supply_hears:
        yield f"{left.mcp_v:.0f} V were left on"


class _Struck:
    """The moment of the fault, and the state of the tube then."""

    def __init__(self, rig: CampaignRig, client: Client, fault: Fault) -> None:
        self._rig, self._client, self._fault = rig, client, fault
        before = rig.outputs()
        self.gate_was_open, self.voltage_was_on = before.gate_open, before.mcp_v > DANGEROUS_V
        self.at_s = time.monotonic()
        fault.strike(rig, client)

    def watch(self) -> float:
        """Watch the gate as long as the fault lasts, at least a second; when it was last seen open, s after it."""
        last_open_s = 0.0
        until_s = self.at_s + max(self._fault.hold_s, 1.2)
        while (now_s := time.monotonic()) < until_s:
            if self._rig.outputs().gate_open:
                last_open_s = now_s - self.at_s
            time.sleep(LOOK_S)
        return last_open_s


def _broken(
    client: Client,
    session: Path,
    fault: Fault,
    code: int | None,
    gate_s: float | None,
    off_s: float | None,
    within_s: float,
) -> Iterator[str]:
    """Each promise that was broken, in words."""
    if code is None:
        yield f"the client did not end within {END_S:g} s"
    if code == 3 or any(line.startswith("Traceback") for line in client.told()):
        yield f"the client ended in a traceback: {client.told()[-1:]}"
    if gate_s is not None and gate_s > within_s:
        yield f"the gate was open for {gate_s:.2f} s"
    if off_s is not None and off_s > within_s:
        yield f"the high voltage was ordered off after {off_s:.2f} s"
    yield from frames_broken(session, client.acknowledged())
    yield from _log_broken(session, client, fault, code)


def frames_broken(session: Path, acknowledged: dict[str, int]) -> Iterator[str]:
    """What is wrong with the frames that were acknowledged; reading compares each with its digest."""
    if not (session / MANIFEST).exists() or not any(acknowledged.values()):
        return
    stacks = {entry.label: entry for entry in open_session(session).stacks}
    for label, count in acknowledged.items():
        if not count:
            continue
        try:
            frames = stacks[label].read().data
        except (KeyError, BadInput) as error:
            yield f"acknowledged frames of {label} are lost or torn: {error}"
            continue
        if len(frames) < count:
            yield f"{count} frames of {label} were acknowledged, {len(frames)} are there"
        if len({frame.tobytes() for frame in frames}) < len(frames):
            yield f"a frame of {label} is there twice"


def _log_broken(session: Path, client: Client, fault: Fault, code: int | None) -> Iterator[str]:
    """What the session's log does not tell."""
    if not (session / LOG).exists():
        return
    told = read_events(session / LOG)
    begins = [number for number, each in enumerate(told) if each["event"] == "run begins"]
    run = told[begins[-1] :] if begins else []
    ended = [each for each in run if each["event"] == "run ends"]
    if code is not None and code >= 0:
        if not ended:
            yield "the log does not tell how the run ended"
        elif ended[0]["whole"] != (code == 0):
            yield "the log tells another end than the client"
        elif code == 1 and not ended[0]["reason"]:
            yield "the log gives no reason"
    elif ended and fault.client_lives:
        yield "the log tells the end of a run that was killed"
