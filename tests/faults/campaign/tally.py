"""The tally of a campaign: how often each kind struck, how fast the tube was safe, and what was broken."""

from collections.abc import Sequence

from tests.faults.campaign.trial import Outcome

HEAD = "| fault | trials | tube on | run endured it | gate shut, worst | off ordered, worst | promises broken |"
RULE = "|---|---:|---:|---:|---:|---:|---:|"


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the tally as a table of Markdown, a row for each kind and one for all."""
    kinds = sorted({outcome.kind for outcome in outcomes})
    rows = [_row(kind, [each for each in outcomes if each.kind == kind]) for kind in kinds]
    return "\n".join((HEAD, RULE, *rows, _row("all", outcomes)))


def _row(name: str, outcomes: Sequence[Outcome]) -> str:
    cells = (
        name,
        str(len(outcomes)),
        str(sum(each.live for each in outcomes)),
        str(sum(each.endured for each in outcomes)),
        _worst([each.gate_s for each in outcomes]),
        _worst([each.off_s for each in outcomes]),
        str(sum(bool(each.broken) for each in outcomes)),
    )
    return f"| {' | '.join(cells)} |"


def _worst(seconds: Sequence[float | None]) -> str:
    known = [each for each in seconds if each is not None]
    return f"{max(known):.2f} s of {len(known)}" if known else "-"
