"""`make fault-campaign`: faults and kills at random moments of running plans; the tally is printed and kept."""

import argparse
import json
import os
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from labdata.sensors import save_sensor
from tests.faults.campaign.plan import small_plan
from tests.faults.campaign.rig import CampaignRig
from tests.faults.campaign.sessions import campaign, order, warm_up
from tests.faults.campaign.tally import table
from tests.faults.campaign.trial import Outcome

TALLY = "## Tally"


def main() -> int:
    """Run a campaign and print its tally; exit code 1 if a promise was broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=120.0, help="begin no session after this time")
    parser.add_argument("--keep", type=Path, help="file for the tally, Markdown")
    parser.add_argument("--trials", type=Path, help="file for every trial, one JSON object a line")
    asked = parser.parse_args()
    rng, loads = np.random.default_rng(asked.seed), [os.getloadavg()[0]]

    def tell(outcome: Outcome, after_s: float) -> None:
        loads.append(os.getloadavg()[0])
        _tell(outcome, after_s, loads[-1], asked.trials)

    with tempfile.TemporaryDirectory() as name, CampaignRig(Path(name), asked.seed) as rig:
        save_sensor(rig.sensor, Path(name) / "sensor.toml")
        plan = small_plan(Path(name) / "sensor.toml", asked.seed)
        warm_up(rig, plan, Path(name) / "warm")
        kinds = order(asked.faults, asked.kills, rng)
        outcomes, completed, failed = campaign(
            rig, plan, Path(name) / "struck", kinds, rng, minutes=asked.minutes, tell=tell
        )
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


def _keep_tally(page: Path, text: str) -> None:
    """Put the tally under its heading; what stands before it is kept."""
    before = page.read_text().split(TALLY)[0] if page.exists() else ""
    page.write_text(f"{before}{TALLY}\n\n{text}")


def _tell(outcome: Outcome, after_s: float, load: float, trials: Path | None) -> None:
    line = json.dumps({"after_s": round(after_s, 3), "load": load, **asdict(outcome)})
    print(line, flush=True)
    if trials is not None:
        with trials.open("a") as file:
            file.write(line + "\n")


if __name__ == "__main__":
    sys.exit(main())
