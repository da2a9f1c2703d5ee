"""Speed against accuracy: the methods of a quantity on the same cases, a figure and the table that
`auto` reads.
"""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import charact
from benchmarks.studies.harness import CaseResult, MethodSummary, Progress, run, summary
from benchmarks.studies.registry import argument_parser, methods_of, studies_of
from charact.method import Context, Method

TABLES = Path(charact.__file__).parent / "method" / "tables"


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Speed against accuracy of the methods of one quantity.

    `quantity`: what was measured; `seed`, `quick`: seed of the cases, and whether the methods were
    asked for quick answers; `summaries`: one for each method, the quickest first; `rows`: every
    method on every case; `files`: what was written: the rows as JSON and the figure.
    """

    quantity: str
    seed: int
    quick: bool
    summaries: tuple[MethodSummary, ...]
    rows: tuple[CaseResult, ...]
    files: tuple[Path, ...] = ()

    @property
    def table(self) -> dict[str, Any]:
        """The table that `auto` reads: one row for each method, and how to make it again."""
        return {
            "quantity": self.quantity,
            "methods": [asdict(row) for row in self.summaries],
            "error_percent_means": (
                "95th percentile of |value - truth| / truth; a refusal counts as 100"
            ),
            "error_limit_percent_means": (
                "upper 95 % confidence limit of error_percent, by order statistics"
            ),
            "seconds_means": "median over the cases of the smaller of wall and processor time",
            "provenance": {"charact": charact.__version__, "seed": self.seed, "quick": self.quick},
        }

    def text(self) -> str:
        """The summaries as a plain table."""
        head = (
            f"{'method':<20}{'error p95':>11}{'at most':>11}{'seconds':>9}"
            + f"{'cases':>7}{'ok':>6}{'silent':>8}{'missed 95 %':>13}"
        )
        lines = [
            f"{s.method:<20}{s.error_percent:>9.2f} %{s.error_limit_percent:>9.2f} "
            f"%{s.seconds:>9.3f}{s.cases:>7}{s.ok_fraction:>6.0%}{s.silent:>8}{s.missed_fraction:>13.0%}"
            for s in self.summaries
        ]
        return "\n".join([f"{self.quantity}: error against time on the same cases", head, *lines])


def chart(
    quantity: str,
    *,
    seed: int = 0,
    out: str | Path | None = None,
    progress: Progress = lambda sentence, fraction: None,
    update: bool = False,
    quick: bool = False,
    cases: int | None = None,
    methods: tuple[Method, ...] | None = None,
) -> Chart:
    """Measure error and time of every method of a quantity on the same cases of known truth, kind
    by kind.

    Parameters
    ----------
    quantity
        A name of `benchmarks.studies.registry.STUDIES`.
    seed
        Seed of the cases.
    out
        Folder for `chart-QUANTITY.json` and `.svg`; None: nothing is written there.
    progress
        Called with a sentence and the share done.
    update
        Write the table that `charact.method.choose` reads.
    quick
        A cut for a first look: few cases and quick answers.
    cases
        Number of cases of each kind of target; None: as the study says.
    methods
        The methods; None: all that are registered for the quantity.

    Raises
    ------
    BadInput
        If no study of the quantity exists.
    """
    studies = studies_of(quantity)
    methods = methods_of(quantity) if methods is None else methods
    drawn = [
        study.chart_cases(seed, cases or (study.quick_count if quick else study.chart_count))
        for study in studies
    ]
    for (
        first
    ) in drawn:  # what a method imports or compiles on its first call is not its time on a frame
        run(methods, first[:1], context=Context(quick=quick))
    drawn = [
        case
        for of_kind in drawn
        for case in of_kind
        if case.kind in {method.kind for method in methods}
    ]
    rows = run(methods, drawn, context=Context(quick=quick), progress=progress)
    summaries = sorted((summary(rows, method.name) for method in methods), key=lambda s: s.seconds)
    result = Chart(quantity=quantity, seed=seed, quick=quick, summaries=tuple(summaries), rows=rows)
    if update:
        write_json(TABLES / f"{quantity}.json", result.table)
    if out is None:
        return result
    from benchmarks.studies.figures import plot_chart

    data = {**result.table, "rows": [row.as_json() for row in rows]}
    written = write_json(Path(out) / f"chart-{quantity}.json", data)
    files = (written, plot_chart(quantity, rows, summaries, Path(out) / f"chart-{quantity}.svg"))
    return replace(result, files=files)


def write_json(path: Path, data: dict[str, Any]) -> Path:
    """Write a study's data, one row a line being too long for eyes, indented by one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")
    return path


def main() -> None:
    """Measure the methods of a quantity and write table and figure."""
    from charact.cli.output import progress_bar

    parser = argument_parser("chart", __doc__ or "")
    parser.add_argument("--update", action="store_true", help="store the table that auto reads")
    arguments = vars(parser.parse_args())
    with progress_bar() as progress:
        print(chart(arguments.pop("quantity"), progress=progress, **arguments).text())


if __name__ == "__main__":
    main()
