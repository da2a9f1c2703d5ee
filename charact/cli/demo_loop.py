"""The demonstration: the whole loop on the virtual bench, then truth beside measured."""

import math
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import resources
from pathlib import Path

from charact.cli.benches import acquire_session, bench_folder
from charact.cli.output import print_message
from charact.cli.progress import progress_bar
from charact.cli.sessions import FITTED, measure_and_save
from labdata.errors import BadInput
from labdata.plan import Plan
from labdata.serialiser import from_toml

# Chance of a session whose numbers are all told right to have one so far off that it counts as wrong.
CHANCE = 1e-3
QUICK_FRAMES = 10
MADE_HERE = "demo.txt"


def demonstrate(out: Path, *, quick: bool, seed: int | None, events: bool) -> bool:
    """Run the loop into a folder; return whether every number agrees with the truth and the validation held."""
    seed = time.time_ns() % 2**31 if seed is None else seed
    session = out / "session"
    _make_room(out, session, seed)
    print_message(f"seed {seed} (repeat with --seed {seed}); everything goes to {out}", events=events)
    left_out: list[str] = []
    with _step("acquire", events), progress_bar(events=events) as progress:
        acquire_session(demo_plan(seed, quick=quick), session, resume=False, progress=progress, tell=left_out.append)
    for sentence in left_out:
        print_message(sentence, events=events)
    with _step("measure", events):
        result = measure_and_save(session, quick=quick, seed=seed, events=events)
    with _step("fit", events):
        fitted = _fit_and_save(session, result, seed, events)
    with _step("simulate and validate", events):
        from charact.cli.validate import validate_and_save

        validation = validate_and_save(session, fitted, seed=seed, events=events)
    with _step("report", events):
        report, rows = _report(session, out, result, validation)
    from charact.cli.truth_comparison import lines

    print("\n".join(lines(rows)))
    told = [row for row in rows if row.measurement.status == "ok"]
    largest = largest_z(len(told))
    within = all(abs(row.z) <= largest for row in told)
    print(f"\nvalidation: {'passed' if validation.passed else 'FAILED'}")
    verdict = "yes" if within else "NO"
    print(f"truth within {largest:.2f} standard errors of all {len(told)} numbers that are ok: {verdict}")
    print(f"report: {report}")
    return within and validation.passed


def largest_z(numbers: int) -> float:
    """Return how many standard errors off the worst of so many right numbers is by chance no oftener than `CHANCE`."""
    from scipy.special import ndtri

    return float(-ndtri(0.5 * -math.expm1(math.log1p(-CHANCE) / max(numbers, 1))))


def demo_plan(seed: int, *, quick: bool) -> Plan:
    """The shipped plan with a seed; the quick one takes fewer frames."""
    with resources.as_file(resources.files("charact.cli") / "plans" / "demo.toml") as path:
        plan = replace(from_toml(path, Plan), seed=seed)
    if not quick:
        return plan
    return replace(plan, steps=tuple(replace(step, frames=min(step.frames, QUICK_FRAMES)) for step in plan.steps))


def _make_room(out: Path, session: Path, seed: int) -> None:
    """Clear an earlier demonstration, and nothing else."""
    marker = out / MADE_HERE
    if session.exists() and not marker.is_file():
        raise BadInput(
            f"{session} must not exist or must be of an earlier demonstration, got a folder without {marker}"
        )
    for old in (session, bench_folder(session)):
        if old.exists():
            shutil.rmtree(old)
    out.mkdir(parents=True, exist_ok=True)
    marker.write_text(f"This folder is made by charact demo (seed {seed}) and cleared by the next one.\n")


@contextmanager
def _step(name: str, events: bool) -> Iterator[None]:
    start = time.monotonic()
    yield
    print_message(f"{name}: {time.monotonic() - start:.1f} s", events=events)


def _fit_and_save(session: Path, result, seed: int, events: bool) -> Path:
    from charact.fit import fit_sensor
    from labdata.sensors import save_sensor
    from labdata.session import open_session

    with progress_bar(events=events) as progress:
        sensor = fit_sensor(open_session(session), result, seed=seed, progress=progress)
    save_sensor(sensor, session / FITTED)
    return session / FITTED


def _report(session: Path, out: Path, result, validation):
    """Write the report with the bench's truth in it: opened only now, when nothing is measured any more."""
    from charact.cli.truth_comparison import of_bench
    from charact.report import compare_with_truth, write
    from labdata.session import open_session

    truth = of_bench(bench_folder(session), open_session(session))
    path = write(open_session(session), result, out / "report.html", validation=validation, truth=truth)
    return path, compare_with_truth(result, truth)
