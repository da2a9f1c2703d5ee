"""Where methods fail: every axis swept past the breaking point, with errors, refusals, flags and
silent failures.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

import charact
from benchmarks.studies.chart import write_json
from benchmarks.studies.harness import (
    CaseResult,
    MethodSummary,
    Progress,
    attempt,
    axes_of,
    summary,
)
from benchmarks.studies.registry import Study, argument_parser, methods_of, studies_of
from charact.method import Context, Method, choose
from tests.truth.cases.case import Case


@dataclass(frozen=True, kw_only=True)
class Stability:
    """A map of where the methods of one quantity hold and fail.

    `quantity`, `seed`, `chains`: what was measured, the seed of the cases, and whether the methods
    ran their Markov chains; `rows`: every method on every case; `files`: what was written: the rows
    as JSON and the map.
    """

    quantity: str
    seed: int
    chains: bool
    rows: tuple[CaseResult, ...]
    files: tuple[Path, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods."""
        return tuple(dict.fromkeys(row.method for row in self.rows))

    @property
    def silent(self) -> tuple[CaseResult, ...]:
        """The silent failures."""
        return tuple(row for row in self.rows if row.silent)

    def overall(self, method: str) -> tuple[MethodSummary, MethodSummary | None]:
        """Summary of all cases of a method, and of those inside the scope."""
        in_scope = [row for row in self.rows if row.in_scope and row.method == method]
        return summary(self.rows, method), summary(in_scope, method) if in_scope else None

    def text(self) -> str:
        """For each method and axis: verdicts by position, then the silent failures one by one."""
        lines = [
            (
                f"{self.quantity}: o ok, s suspect, r refused, C crashed, X silent failure; "
                "[inside the scope]"
            )
        ]
        for method in self.methods:
            every, in_scope = self.overall(method)
            scope = (
                f", {in_scope.ok_fraction:.0%} of {in_scope.cases} in scope ok" if in_scope else ""
            )
            lines.append(
                f"{method}: {every.cases} cases, {every.silent} silent, {every.crashed} crashed, "
                f"{every.missed_fraction:.0%} of ok intervals miss{scope}"
            )
            method_rows = [row for row in self.rows if row.method == method]
            lines += [
                f"  {axis:<28}{self._verdicts(method, axis)}" for axis in axes_of(method_rows)
            ]
        return "\n".join([*lines, *(_sentence(row) for row in self.silent)])

    def _verdicts(self, method: str, axis: str) -> str:
        """One letter for each draw, positions apart."""
        axis_rows = [row for row in self.rows if row.method == method and row.axis == axis]
        cells = []
        for position in dict.fromkeys(row.position for row in axis_rows):
            at = [row for row in axis_rows if row.position == position]
            letters = "".join(
                "C" if r.status == "crashed" else "X" if r.silent else r.status[0] for r in at
            )
            cells.append(
                f"{position:g}:[{letters}]" if at[0].in_scope else f"{position:g}:{letters}"
            )
        return "  ".join(cells)


def _sentence(row: CaseResult) -> str:
    truth = "nothing to measure" if row.truth is None else f"truth {row.truth:.4g}"
    return (
        f"SILENT {row.method} at {row.case} (seed {row.seed}): {row.value:.4g} [{row.low95:.4g}, "
        f"{row.high95:.4g}] ok, {truth}"
    )


def _attempt_all(case: Case, methods: tuple[Method, ...], chains: bool) -> list[CaseResult]:
    """Put one case to every method of its kind."""
    return [
        attempt(method, case, Context(quick=not chains))
        for method in methods
        if method.kind == case.kind
    ]


def _attempt_named(
    case: Case, names: tuple[tuple[str, str], ...], chains: bool
) -> list[CaseResult]:
    """Put one case to registered methods in a process of its own, which finds them by name."""
    return _attempt_all(case, tuple(choose(kind, name) for kind, name in names), chains)


def stability(
    quantity: str,
    *,
    seed: int = 0,
    out: str | Path | None = None,
    progress: Progress = lambda sentence, fraction: None,
    quick: bool = False,
    chains: bool = False,
    repeats: int | None = None,
    axes: tuple[str, ...] | None = None,
    methods: tuple[Method, ...] | None = None,
    workers: int | None = None,
) -> Stability:
    """Sweep the axes of a quantity past the breaking point and map what every method does.

    Parameters
    ----------
    quantity
        A name of `benchmarks.studies.registry.STUDIES`.
    seed
        Seed of the cases.
    out
        Folder for `stability-QUANTITY.json` and a map `stability-QUANTITY-KIND.svg` of each kind of
        target; None: nothing is written.
    progress
        Called with a sentence and the share done.
    quick
        A first look: one draw at both ends of every axis.
    chains
        Intervals by Markov chains: what a user gets without --quick, and several times slower.
    repeats
        Draws at each position; None: as the study says.
    axes
        The axes to sweep; None: all.
    methods
        The methods; None: all that are registered for the quantity.
    workers
        Processes that share the cases; None: two for registered methods, one for methods given
        here.

    Raises
    ------
    BadInput
        If no study of the quantity exists.
    """
    workers = workers or (2 if methods is None else 1)
    studies = studies_of(quantity)
    methods = methods_of(quantity) if methods is None else methods
    cases = [
        case
        for study in studies
        if any(method.kind == study.kind for method in methods)
        for case in _cases(study, seed, repeats or (1 if quick else study.repeats), axes)
    ]
    cases = ends(cases) if quick else cases
    rows: list[CaseResult] = []
    for number, case_rows in enumerate(_measure_cases(cases, methods, chains, workers)):
        progress(cases[number].name, (number + 1) / len(cases))
        rows += case_rows
    result = Stability(quantity=quantity, seed=seed, chains=chains, rows=tuple(rows))
    return result if out is None else replace(result, files=_write_files(result, Path(out)))


def _cases(study: Study, seed: int, repeats: int, axes: tuple[str, ...] | None) -> tuple[Case, ...]:
    """Cases of one kind of target along those of the axes that it has."""
    study_axes = study.axes if axes is None else tuple(axis for axis in axes if axis in study.axes)
    return study.stability_cases(seed, repeats, study_axes) if study_axes else ()


def ends(cases: Sequence[Case]) -> tuple[Case, ...]:
    """The cases at the first and the last position of every axis."""
    of_axis: dict[tuple[str, str], list[Case]] = {}
    for case in cases:
        of_axis.setdefault((case.kind, case.axis), []).append(case)
    return tuple(
        c
        for axis_cases in of_axis.values()
        for c in axis_cases
        if c.position in (axis_cases[0].position, axis_cases[-1].position)
    )


def _measure_cases(cases: Sequence[Case], methods: tuple[Method, ...], chains: bool, workers: int):
    """Rows of each case in order, drawn in this process or shared out."""
    if workers == 1:
        yield from map(_attempt_all, cases, repeat(methods), repeat(chains))
        return
    with one_thread_each(), ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        names = tuple((method.kind, method.name) for method in methods)
        yield from pool.map(_attempt_named, cases, repeat(names), repeat(chains), chunksize=2)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let processes started meanwhile run their linear algebra on one thread each: together they
    fill the machine.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _write_files(result: Stability, out: Path) -> tuple[Path, ...]:
    from benchmarks.studies.figures import plot_stability

    data = {
        "quantity": result.quantity,
        "methods": [asdict(result.overall(method)[0]) for method in result.methods],
        "silent": [row.as_json() for row in result.silent],
        "flags": {
            method: Counter(f for r in result.rows if r.method == method for f in r.flags)
            for method in result.methods
        },
        "rows": [row.as_json() for row in result.rows],
        "provenance": {
            "charact": charact.__version__,
            "seed": result.seed,
            "chains": result.chains,
        },
    }
    written = write_json(out / f"stability-{result.quantity}.json", data)
    kinds = dict.fromkeys(row.kind for row in result.rows)
    return written, *(
        plot_stability(
            result.quantity, result.rows, kind, out / f"stability-{result.quantity}-{kind}.svg"
        )
        for kind in kinds
    )


def main() -> None:
    """Sweep the methods of a quantity past their breaking points and write table and maps."""
    from charact.cli.output import progress_bar

    arguments = vars(argument_parser("stability", __doc__ or "").parse_args())
    with progress_bar() as progress:
        print(stability(arguments.pop("quantity"), progress=progress, **arguments).text())


if __name__ == "__main__":
    main()
