"""Whether `auto` keeps its word: the methods that it picks from the chart, on cases that the chart
never saw.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.studies.chart import write_json
from benchmarks.studies.harness import CaseResult, run
from benchmarks.studies.registry import methods_of, studies_of
from charact.method import Context, choose
from charact.method.registry import reach_percent

TABLE = Path(__file__).with_name("tables") / "held_back.json"
TOLERANCES_PERCENT = (1.0, 2.0, 5.0, 10.0, 20.0)
# The charts' own cases are drawn with seed 0.
SEED = 1001
# Cases of each kind of target.
CASES = {"mtf50": 200, "mtf": 100, "covariance_gain": 60}


@dataclass(frozen=True, kw_only=True)
class ChoiceCheck:
    """How often the choice for one tolerance was right.

    Parameters
    ----------
    kind, within_percent
        Kind of target, and the tolerance on the error.
    method
        What `auto` picked.
    cases, right
        Held-back cases, and how many of them it measured within the tolerance; a refusal is not
        right.
    told
        Cases off by more that said so: flagged, refused, or with the note that `auto` writes where
        the 95 % interval reaches further than the tolerance. Right or told is what `auto` promises.
    """

    kind: str
    within_percent: float
    method: str
    cases: int
    right: int
    told: int


def check_held_out_choices(
    quantity: str,
    *,
    cases: int,
    seed: int = SEED,
    tolerances: Sequence[float] = TOLERANCES_PERCENT,
    kinds: Sequence[str] | None = None,
) -> list[ChoiceCheck]:
    """Put what `auto` picks for each tolerance to cases inside the scope that no chart was drawn
    from.

    Parameters
    ----------
    quantity
        A name of `benchmarks.studies.registry.STUDIES`.
    cases
        Cases of each kind of target.
    seed
        Seed of the cases.
    tolerances
        Tolerances on the error, %.
    kinds
        Kinds of target; None: all that the quantity has.
    """
    found, registered = [], methods_of(quantity)
    for study in studies_of(quantity):
        if study.kind not in (kinds or {method.kind for method in registered}):
            continue
        drawn = study.chart_cases(seed, cases)
        picked = {within: choose(study.kind, within_percent=within) for within in tolerances}
        rows = run(dict.fromkeys(picked.values()), drawn, context=Context(quick=True))
        for within, method in picked.items():
            own = [row for row in rows if row.method == method.name]
            right = [row.error_percent is not None and row.error_percent <= within for row in own]
            found.append(
                ChoiceCheck(
                    kind=study.kind,
                    within_percent=within,
                    method=method.name,
                    cases=len(own),
                    right=sum(right),
                    told=sum(
                        _said(row, within) for row, good in zip(own, right, strict=True) if not good
                    ),
                )
            )
    return found


def _said(row: CaseResult, within_percent: float) -> bool:
    """Tell whether a case's verdict or interval says that it may be off by more than a
    tolerance.
    """
    if row.status != "ok" or row.value is None or row.low95 is None or row.high95 is None:
        return row.status != "ok"
    return reach_percent(row.value, (row.low95, row.high95)) > within_percent


def main() -> None:
    """Run the study for the quantities asked for, print it and write their part of the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.held_out_cases", description=__doc__
    )
    parser.add_argument(
        "quantities", nargs="*", default=list(CASES), help=f"of {', '.join(CASES)}; all"
    )
    asked = parser.parse_args()
    rows: dict[str, Any] = {
        quantity: [asdict(one) for one in check_held_out_choices(quantity, cases=CASES[quantity])]
        for quantity in asked.quantities
    }
    kept = json.loads(TABLE.read_text()) if TABLE.is_file() else {}
    write_json(TABLE, {**kept, "seed": SEED, "quick": True, **rows})
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
