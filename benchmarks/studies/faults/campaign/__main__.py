"""`make study NAME=fault-campaign`: each fault strikes running plans at random moments; what became
of each makes a docs page.
"""

import argparse
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.campaign.kinds import KINDS, draw_fault
from benchmarks.studies.faults.campaign.page import Row, page
from benchmarks.studies.faults.campaign.rig import CampaignRig
from benchmarks.studies.faults.campaign.trial import Outcome, resume, try_fault, warm_up
from labdata import BadInput

EARLIEST_S = -0.5
STRIKES_A_SESSION = 5
MOST_MISSED = 3

Tell = Callable[[Outcome], object]


def main() -> int:
    """Run a campaign and print its page; exit code 1 if a promise was broken."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.faults.campaign", description=__doc__
    )
    parser.add_argument("--strikes", type=int, default=5, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="begin no further kind after this time"
    )
    parser.add_argument(
        "--kinds", default="", help="only kinds in which this regular expression is found"
    )
    parser.add_argument("--keep", type=Path, help="page for the result, Markdown")
    parser.add_argument("--trials", type=Path, help="file for every strike, one JSON object a line")
    parser.add_argument(
        "--rows",
        type=Path,
        help="file for every kind, one JSON object a line; those that stand in it are not struck "
        "again, so that a campaign can be run in pieces",
    )
    asked = parser.parse_args()
    kinds = [kind for kind in KINDS if re.search(asked.kinds, kind)]
    if not kinds:
        raise BadInput(f"kinds must be found in one of {', '.join(KINDS)}, got {asked.kinds!r}")
    loads: list[float] = []

    def tell(outcome: Outcome) -> None:
        loads.append(os.getloadavg()[0])
        line = json.dumps({"load": loads[-1], **asdict(outcome)})
        print(line, flush=True)
        if asked.trials is not None:
            with asked.trials.open("a") as file:
                file.write(line + "\n")

    struck = read_rows(asked.rows) if asked.rows is not None and asked.rows.exists() else {}
    missing = [kind for kind in kinds if kind not in struck]
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as name, CampaignRig(Path(name), asked.seed) as rig:
        if missing:
            warm_up(rig, Path(name) / "warm")
        for number, kind in enumerate(missing):
            kind_began_s = time.monotonic()
            if kind_began_s > began_s + 60.0 * asked.minutes:
                print(f"not struck for want of time: {', '.join(missing[number:])}", flush=True)
                break
            loads.clear()
            # The draws of a kind do not depend on those struck before.
            rng = np.random.default_rng([asked.seed, list(KINDS).index(kind)])
            row = strike(rig, Path(name), kind, asked.strikes, rng, tell=tell)
            minutes = (time.monotonic() - kind_began_s) / 60.0
            struck[kind] = Struck(row=row, minutes=minutes, loads=tuple(loads))
            if asked.rows is not None:
                with asked.rows.open("a") as file:
                    file.write(json.dumps(asdict(struck[kind])) + "\n")
    rows = [struck[kind].row for kind in kinds if kind in struck]
    all_loads = [load for each in struck.values() for load in each.loads]
    text = page(
        rows,
        f"Seed {asked.seed}, {asked.strikes} strikes of each kind, "
        f"{sum(each.minutes for each in struck.values()):.0f} min. The machine: {os.cpu_count()} "
        f"cores, {np.median(all_loads):.1f} processes at work or waiting for one in the median, "
        f"{max(all_loads):.1f} at most.",
    )
    print(text)
    for row in rows:
        for sentence in row.broken:
            print(f"BROKEN {row.kind}: {sentence}")
    if asked.keep:
        asked.keep.write_text(text)
    return 1 if len(rows) < len(kinds) or any(row.broken for row in rows) else 0


@dataclass(frozen=True, kw_only=True)
class Struck:
    """A kind that was struck: its row, how long that took, and the load at each strike."""

    row: Row
    minutes: float
    loads: tuple[float, ...]


def read_rows(path: Path) -> dict[str, Struck]:
    """Return the kinds that stand in a file of rows."""
    struck = {}
    for line in path.read_text().splitlines():
        known = json.loads(line)
        row = known["row"]
        outcomes = tuple(
            Outcome(**(each | {"broken": tuple(each["broken"])})) for each in row["outcomes"]
        )
        struck[row["kind"]] = Struck(
            row=Row(kind=row["kind"], outcomes=outcomes, resumed=tuple(map(tuple, row["resumed"]))),
            minutes=known["minutes"],
            loads=tuple(known["loads"]),
        )
    return struck


def strike(
    rig: CampaignRig,
    folder: Path,
    kind: str,
    strikes: int,
    rng: np.random.Generator,
    *,
    tell: Tell = lambda outcome: None,
) -> Row:
    """Strike sessions with faults of one kind, and resume each session undisturbed, which must
    complete it.

    Every fifth strike falls at any moment, the opening included, the others with the tube in the
    state for the fault.

    Parameters
    ----------
    rig
        The bench.
    folder
        Where the sessions go.
    kind, strikes
        Kind of the fault, and how often it strikes.
    rng
        Draws the moments and the strength of the faults.
    tell
        Called after every strike.
    """
    outcomes: list[Outcome] = []
    resumed: list[list[str]] = []
    while len(outcomes) < strikes:
        session = folder / f"{re.sub('[^a-z0-9]+', '-', kind.lower())}-{len(resumed)}"
        fault = draw_fault(kind, rng)
        plan = fault.plan(rig.plan())
        for _ in range(min(STRIKES_A_SESSION, strikes - len(outcomes))):
            at_any_moment = len(outcomes) % 5 == 4 and fault.latest_s and not fault.prompts
            earliest_s = EARLIEST_S if at_any_moment else 0.0
            after_s = float(rng.uniform(earliest_s, fault.latest_s))
            outcome = try_fault(rig, plan, session, kind, fault, after_s=after_s)
            if outcome is None:
                break  # complete before it struck
            outcomes.append(outcome)
            tell(outcome)
            if outcome.endured:
                break
            fault = draw_fault(kind, rng)
        resumed.append(resume(rig, plan, session))
        if len(resumed) > len(outcomes) + MOST_MISSED:
            raise RuntimeError(
                f"{kind} must strike runs, got {len(resumed)} that ended before: {resumed[-1]}"
            )
    return Row(kind=kind, outcomes=tuple(outcomes), resumed=tuple(map(tuple, resumed)))


if __name__ == "__main__":
    sys.exit(main())
