"""`make study NAME=rehearsal`: a night compressed: 500 steps of gain by light with faults on, then
measured beside the truth.

The virtual bench is on real wires, its high voltage moves ten times faster than life, and every so
many seconds a fault strikes; whoever watches over the night repairs the bench and resumes. The
session that comes out is measured as `charact measure` does, and each number whose truth is known
stands beside it. Broken off and called again with the same folder, the night goes on.
"""

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.campaign.rig import CampaignRig
from benchmarks.studies.faults.rehearsal.judged import allowed, beside, by_quantity, missing
from benchmarks.studies.faults.rehearsal.night import FASTER, FRAMES, Diary, night_plan, rehearse
from charact.reporting import TruthComparison
from charact.session_measurement import measure
from drivers.acquisition.acquire import LOG
from labdata import Plan, Result, Session, open_session, read_events

ROWS, COLUMNS = 123, 192
RESULT = "## Result"


def main() -> int:
    """Rehearse, measure and print; exit code 1 if the plan was not completed or intervals miss too
    often.
    """
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.faults.rehearsal", description=__doc__
    )
    parser.add_argument("--voltages", type=int, default=20)
    parser.add_argument("--lights", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("build/rehearsal"),
        help="of the night, kept and gone on with",
    )
    parser.add_argument("--quick", action="store_true", help="measure without a Markov chain")
    parser.add_argument("--keep", type=Path, help="page for the result, Markdown")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    folder, diary = asked.folder.resolve(), Diary(path=asked.folder / "diary.jsonl")
    with CampaignRig(folder, asked.seed, rows=ROWS, columns=COLUMNS, time_scale=FASTER) as rig:
        plan = night_plan(
            folder / "sensor.toml", voltages=asked.voltages, lights=asked.lights, seed=asked.seed
        )
        if not any(run["end"] == "complete" for run in diary.told("run")):
            rehearse(rig, plan, folder / "night", diary, asked.seed)
        specimen = rig.truth.sensor
    session = open_session(folder / "night")
    began_s = time.monotonic()
    result = measure(session, quick=asked.quick, seed=asked.seed)
    measured_s = time.monotonic() - began_s
    rows = beside(result, session, specimen)
    text = "\n".join(
        (*_night(session, plan, diary), *_measured(result, rows, measured_s, quick=asked.quick))
    )
    print("\n".join(_each(rows)))
    print(text)
    if asked.keep:
        _keep(asked.keep, text)
    whole = len(session.stacks) == len(plan.steps) and all(
        entry.finished for entry in session.stacks
    )
    return 0 if whole and missing(rows) <= allowed(len(rows)) else 1


def _night(session: Session, plan: Plan, diary: Diary) -> Iterator[str]:
    """What became of the plan."""
    spent_ms = [
        each["overhead_ms"]
        for each in read_events(session.folder / LOG)
        if each["event"] == "step finished"
    ]
    struck = Counter(each["kind"] for each in diary.told("fault"))
    done = sum(entry.finished for entry in session.stacks)
    lost = sum(entry.lost_frames for entry in session.stacks)
    noted = sum(bool(entry.notes) for entry in session.stacks)
    yield (
        f"{done} of {len(plan.steps)} steps of {FRAMES} frames, {ROWS} x {COLUMNS} px, in "
        f"{diary.seconds / 60.0:.0f} min and {len(diary.told('run'))} runs; {lost} frames lost, "
        f"all with number and reason; {noted} stacks were broken off and filled up or taken anew, "
        "and say so."
    )
    yield ""
    yield (
        "Faults that struck: "
        f"{', '.join(f'{kind} {count}' for kind, count in sorted(struck.items()))}."
    )
    middle_ms, high_ms = np.quantile(spent_ms, [0.5, 0.95])
    yield f"Our own time in a step: {middle_ms:.1f} ms in the median, {high_ms:.1f} ms at 95 %."
    yield ""


def _measured(
    result: Result, rows: Sequence[TruthComparison], seconds: float, *, quick: bool
) -> Iterator[str]:
    """What was measured of it."""
    yield (
        f"`charact measure{' --quick' if quick else ''}` took {seconds:.0f} s, on "
        f"{os.cpu_count()} cores with {os.getloadavg()[1]:.1f} processes at work or waiting for "
        f"one: {len(result.measurements)} quantities, {len(rows)} of them with a truth beside "
        "them."
    )
    yield ""
    yield from by_quantity(rows)


def _each(rows: Sequence[TruthComparison]) -> Iterator[str]:
    """Every number beside its truth."""
    for row in rows:
        m = row.measurement
        where = f"{m.quantity:20} {m.stack or '':24} truth {row.truth_text:>9}"
        yield f"{where}  {row.value_text:>24}  z {row.z:5.2f}  {m.status} {' '.join(m.flags)}"


def _keep(page: Path, text: str) -> None:
    """Put the result under its heading; what stands before it is kept."""
    before = page.read_text().split(RESULT)[0] if page.exists() else ""
    page.write_text(f"{before}{RESULT}\n\n{text}\n")


if __name__ == "__main__":
    sys.exit(main())
