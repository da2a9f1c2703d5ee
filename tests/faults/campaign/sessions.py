"""Sessions that are struck a few times in a row and then resumed undisturbed, which must complete their plan."""

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from labdata.plan import Plan
from labdata.session import open_session
from tests.faults.campaign.client import Client
from tests.faults.campaign.kinds import KILL, KINDS, PATIENT_S, draw_fault
from tests.faults.campaign.plan import FRAMES
from tests.faults.campaign.rig import CampaignRig
from tests.faults.campaign.trial import Outcome, frames_broken, try_fault

WITHIN_S = 1.0
MOST_IN_A_ROW = 4
EARLIEST_S, LATEST_S = -0.5, 2.2  # from the opening to about the end of the plan
COMPLETE_S = 90.0
WARM_UPS = 4


def campaign(
    rig: CampaignRig,
    plan: Plan,
    folder: Path,
    kinds: list[str],
    rng: np.random.Generator,
    *,
    minutes: float = 120.0,
    tell: Callable[[Outcome, float], object] = lambda outcome, after_s: None,
) -> tuple[list[Outcome], int, int]:
    """Strike with one kind after the other; return the outcomes, and how many sessions were completed and were not.

    Parameters
    ----------
    rig, plan
        The bench and what is taken there.
    folder
        Where the sessions go.
    kinds
        Kinds of faults in order.
    rng
        Draws the moments and the strength of the faults, and how many strike one session.
    minutes
        No further session is begun after this time, min.
    tell
        Called after every trial, with when the fault struck, s.
    """
    left, outcomes = list(kinds), []
    completed = failed = 0
    until_s = time.monotonic() + 60.0 * minutes
    for number, row in enumerate(_in_rows(left, rng)):
        session = folder / f"session-{number}"
        session.parent.mkdir(exist_ok=True)
        for place, kind in enumerate(row):
            after_s = float(rng.uniform(EARLIEST_S, LATEST_S))
            outcome = try_fault(rig, plan, session, draw_fault(kind, rng), after_s=after_s, within_s=WITHIN_S)
            if outcome is None:
                left += row[place:]  # complete before it struck: the next session's turn
                break
            outcomes.append(outcome)
            tell(outcome, after_s)
        if not (broken := undisturbed(rig, plan, session)):
            completed += 1
        else:
            failed += 1
            print(f"BROKEN session after {row}: {broken}", flush=True)
        if time.monotonic() > until_s:
            break
    return outcomes, completed, failed


def warm_up(rig: CampaignRig, plan: Plan, session: Path) -> None:
    """Run the plan until it completes: where the simulator is compiled first, a frame takes half a minute."""
    wrong: list[str] = []
    for _ in range(WARM_UPS):
        if not (wrong := undisturbed(rig, plan, session, silence_s=COMPLETE_S)):
            return
    raise RuntimeError(f"a run without faults must complete, got {wrong}")


def order(faults: int, kills: int, rng: np.random.Generator) -> list[str]:
    """All kinds in turn and the kills between them, shuffled."""
    kinds = [KINDS[number % len(KINDS)] for number in range(faults)] + [KILL] * kills
    return [str(kind) for kind in rng.permutation(kinds)]


def _in_rows(kinds: list[str], rng: np.random.Generator) -> Iterator[list[str]]:
    """Faults that strike the same session one after the other."""
    while kinds:
        count = int(rng.integers(1, MOST_IN_A_ROW + 1))
        row, kinds[:] = kinds[:count], kinds[count:]
        yield row


def undisturbed(rig: CampaignRig, plan: Plan, session: Path, *, silence_s: float = PATIENT_S) -> list[str]:
    """Resume a session without a fault; what is wrong with it then."""
    rig.heal()
    client = Client(rig, plan, session, silence_s=silence_s)
    code = client.wait(COMPLETE_S)
    if code is None:
        client.signal(signal.SIGKILL)
        client.wait(COMPLETE_S)
    rig.await_free()
    if code != 0:
        return [f"the resumed run ended with {code}: {client.told()[-1:]}"]
    stacks = {entry.label: entry for entry in open_session(session).stacks}
    wrong = [
        f"{step.label} holds other than {FRAMES} frames or is not finished"
        for step in plan.steps
        if step.label not in stacks or not stacks[step.label].finished or len(stacks[step.label].read()) != FRAMES
    ]
    return wrong + list(frames_broken(session, dict.fromkeys(stacks, FRAMES)))
