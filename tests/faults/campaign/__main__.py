"""`make fault-campaign`: faults and kills at random moments of running plans; the tally is printed and kept.

Every session is struck a few times in a row and then resumed undisturbed, which must complete its plan.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from labdata.plan import Plan
from labdata.sensors import save_sensor
from labdata.session import open_session
from tests.faults.campaign.client import Client
from tests.faults.campaign.kinds import KILL, KINDS, PATIENT_S, draw_fault
from tests.faults.campaign.plan import FRAMES, small_plan
from tests.faults.campaign.rig import CampaignRig
from tests.faults.campaign.tally import table
from tests.faults.campaign.trial import Outcome, frames_broken, try_fault

WITHIN_S = 1.0
MOST_IN_A_ROW = 4
EARLIEST_S, LATEST_S = -0.5, 2.2  # from the opening to about the end of the plan
COMPLETE_S = 90.0
WARM_UPS = 4
TALLY = "## Tally"


def main() -> int:
    """Run a campaign and print its tally; exit code 1 if a promise was broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=120.0, help="stop drawing new faults after this time")
    parser.add_argument("--keep", type=Path, help="file for the tally, Markdown")
    parser.add_argument("--trials", type=Path, help="file for every trial, one JSON object a line")
    asked = parser.parse_args()
    loads = [os.getloadavg()[0]]
    with tempfile.TemporaryDirectory() as folder:
        outcomes, completed, failed = campaign(
            Path(folder), faults=asked.faults, kills=asked.kills, seed=asked.seed, minutes=asked.minutes,
            trials=asked.trials, after_each=lambda: loads.append(os.getloadavg()[0]),
        )  # fmt: skip
    text = (
        f"{table(outcomes)}\n\nSeed {asked.seed}: {len(outcomes)} trials; {completed} of {completed + failed} sessions "
        "were completed by the run that was left undisturbed. "
        f"The machine: {os.cpu_count()} cores, {min(loads):.1f} to {max(loads):.1f} processes at work or waiting for "
        f"one, {np.median(loads):.1f} in the median.\n"
    )
    print(text)
    for outcome in outcomes:
        for sentence in outcome.broken:
            print(f"BROKEN {outcome.kind}: {sentence}")
    if asked.keep:
        _keep_tally(asked.keep, text)
    return 1 if failed or any(outcome.broken for outcome in outcomes) else 0


def campaign(
    folder: Path,
    *,
    faults: int,
    kills: int,
    seed: int,
    minutes: float = 120.0,
    trials: Path | None = None,
    after_each: Callable[[], object] = lambda: None,
) -> tuple[list[Outcome], int, int]:
    """Strike as often as asked; return the outcomes, and how many sessions were completed and not completed.

    Parameters
    ----------
    folder
        An empty folder.
    faults, kills
        How many faults of the kinds of `KINDS`, in turn, and how many kills of the client.
    seed
        Seed of the specimen, the order, the moments and the strength of the faults.
    minutes
        No further fault strikes after this time, min.
    trials
        File to which every outcome is appended.
    after_each
        Called after every trial.
    """
    rng = np.random.default_rng(seed)
    left = _order(faults, kills, rng)
    outcomes: list[Outcome] = []
    completed = failed = 0
    until_s = time.monotonic() + 60.0 * minutes
    with CampaignRig(folder, seed) as rig:
        save_sensor(rig.sensor, folder / "sensor.toml")
        plan = small_plan(folder / "sensor.toml", seed)
        _warm_up(rig, plan, folder / "warm")
        for number, kinds in enumerate(_in_rows(left, rng)):
            session = folder / f"session-{number}"
            for place, kind in enumerate(kinds):
                after_s = float(rng.uniform(EARLIEST_S, LATEST_S))
                outcome = try_fault(rig, plan, session, draw_fault(kind, rng), after_s=after_s, within_s=WITHIN_S)
                if outcome is None:
                    left += kinds[place:]  # complete before it struck: the next session's turn
                    break
                outcomes.append(outcome)
                _keep(outcome, after_s, trials)
                after_each()
            if not (broken := _undisturbed(rig, plan, session)):
                completed += 1
            else:
                failed += 1
                print(f"BROKEN session after {kinds}: {broken}", flush=True)
            if time.monotonic() > until_s:
                break
    return outcomes, completed, failed


def _warm_up(rig: CampaignRig, plan: Plan, session: Path) -> None:
    """Run the plan until it completes: where the simulator is compiled first, a frame takes half a minute."""
    wrong: list[str] = []
    for _ in range(WARM_UPS):
        if not (wrong := _undisturbed(rig, plan, session, silence_s=COMPLETE_S)):
            return
    raise RuntimeError(f"a run without faults must complete, got {wrong}")


def _order(faults: int, kills: int, rng: np.random.Generator) -> list[str]:
    """All kinds in turn and the kills between them, shuffled."""
    kinds = [KINDS[number % len(KINDS)] for number in range(faults)] + [KILL] * kills
    return [str(kind) for kind in rng.permutation(kinds)]


def _in_rows(kinds: list[str], rng: np.random.Generator) -> Iterator[list[str]]:
    """Faults that strike the same session one after the other."""
    while kinds:
        count = int(rng.integers(1, MOST_IN_A_ROW + 1))
        row, kinds[:] = kinds[:count], kinds[count:]
        yield row


def _undisturbed(rig: CampaignRig, plan: Plan, session: Path, *, silence_s: float = PATIENT_S) -> list[str]:
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


def _keep_tally(page: Path, text: str) -> None:
    """Put the tally under its heading; what stands before it is kept."""
    before = page.read_text().split(TALLY)[0] if page.exists() else ""
    page.write_text(f"{before}{TALLY}\n\n{text}")


def _keep(outcome: Outcome, after_s: float, trials: Path | None) -> None:
    line = json.dumps({"after_s": round(after_s, 3), **asdict(outcome)})
    print(line, flush=True)
    if trials is not None:
        with trials.open("a") as file:
            file.write(line + "\n")


if __name__ == "__main__":
    sys.exit(main())
