"""The page of the campaign: a row for each kind of fault, and what no software can know."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.studies.faults.campaign.trial import Outcome

INTRODUCTION = """# Injected faults

`make study NAME=fault-campaign` runs a plan of a dark and a flat on the virtual bench, with camera
and instruments on real wires, and strikes each fault at random moments; this page is what it
printed. Times are taken from the outputs of the virtual instruments: until the gate was last seen
open, and until the voltage was last seen not falling; median and worst. They count from the fault,
with these exceptions: for a camera that stalls or is gone, from the first frames asked for after
it; for room light, from the first frame with more than 5 % of its pixels at their ceiling; for a
port that comes back, from its return; for a log, ledger or terminal that blocks, from the last
frame that came; where a signal or a kill follows, from that. A run that endures a fault which
passes is not timed. *Frames* are those acknowledged before the run ended, and those of them found
whole afterwards, by SHA-256. *Resume* counts the sessions that an undisturbed run completed, with
each frame of the flat showing the light of the others.
"""

HEAD = (
    "| fault | strikes | endured | gate ms | voltage ms | limit ms | how the run ended | "
    "frames | resume |"
)
RULE = "|---|---:|---:|---:|---:|---:|---|---:|---:|"

BEYOND_SOFTWARE = """## What no software can know

- **Client and bench server frozen at once, or the whole machine, as by a suspend.** Nobody is left
  to give an order. An inhibitor of suspend is held while the tube is hot, which the campaign cannot
  strike. Cure: a retriggered gate, a one-shot that shuts the gate unit unless it is triggered anew
  within a second.
- **Both processes ended at once**, as when a camera library aborts a client without memory or
  threads as the server is killed. Cure: the same relay; `charact safe` afterwards.
- **An instrument that neither hears nor obeys.** No order reaches it; the last line on the terminal
  says so. Cure: an interlock relay that breaks the supply's enable input and the gate's drive.
- **A gate that answers as if it obeyed.** What is read back is what was set. Cure: a monitor output
  of the gate unit, or the interlock relay; the high voltage goes off all the same.
- **Light while no frame is exposed and no meter is read.** Cure: a light meter on the bench, and a
  door switch in the interlock relay.
"""


@dataclass(frozen=True, kw_only=True)
class Row:
    """All strikes of one kind.

    Parameters
    ----------
    kind
        Kind of the fault.
    outcomes
        What each strike showed.
    resumed
        For each session struck, what was wrong after the undisturbed run that had to complete it.
    """

    kind: str
    outcomes: tuple[Outcome, ...]
    resumed: tuple[tuple[str, ...], ...]

    @property
    def broken(self) -> tuple[str, ...]:
        """Each promise that was broken, in words."""
        of_strikes = (sentence for outcome in self.outcomes for sentence in outcome.broken)
        return (
            *of_strikes,
            *(f"resumed: {sentence}" for wrong in self.resumed for sentence in wrong),
        )


def page(rows: Sequence[Row], circumstances: str) -> str:
    """Return the page, Markdown."""
    return "\n".join(
        (INTRODUCTION, HEAD, RULE, *map(_line, rows), "", circumstances, "", BEYOND_SOFTWARE)
    )


def _line(row: Row) -> str:
    outcomes = row.outcomes
    cells = (
        row.kind,
        str(len(outcomes)),
        str(sum(outcome.endured for outcome in outcomes)),
        _milliseconds([outcome.gate_s for outcome in outcomes]),
        _milliseconds([outcome.voltage_s for outcome in outcomes]),
        f"{1e3 * outcomes[0].limit_s:.0f}" if outcomes else "-",
        "; ".join(_sentences(outcomes)),
        (
            f"{sum(outcome.acknowledged for outcome in outcomes)} / "
            f"{sum(outcome.found for outcome in outcomes)}"
        ),
        f"{sum(not wrong for wrong in row.resumed)} of {len(row.resumed)}",
    )
    return f"| {' | '.join(cells)} |"


def _milliseconds(seconds: Sequence[float | None]) -> str:
    known = [1e3 * each for each in seconds if each is not None]
    return f"{np.median(known):.0f} / {max(known):.0f}" if known else "-"


def _sentences(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """The end that came most often, and how many others there were."""
    ends = [
        re.sub(r"/\S*/", "", outcome.sentence).replace("|", "/")
        for outcome in outcomes
        if not outcome.endured
    ]
    if not ends:
        return
    kinds = sorted(set(ends), key=lambda end: (-ends.count(end), end))
    yield kinds[0]
    if len(kinds) > 1:
        yield f"{len(kinds) - 1} more"
