"""The demonstration: the whole loop on the virtual bench, then truth beside measured."""

import math
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from charact.cli.benches import acquire_session, bench_folder
from charact.cli.output import print_message, progress_bar
from charact.cli.sessions import FITTED, measure_and_save
from labdata.errors import BadInput
from labdata.plan import Plan
from labdata.serialiser import from_toml
from labdata.session import Session

if TYPE_CHECKING:
    from charact.report.truth import Truth, TruthComparison

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
        from charact.cli.sessions import validate_and_save

        validation = validate_and_save(session, fitted, seed=seed, events=events)
    with _step("report", events):
        report, rows = _report(session, out, result, validation)

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
    from charact.report import compare_with_truth, write
    from labdata.session import open_session

    truth = of_bench(bench_folder(session), open_session(session))
    path = write(open_session(session), result, out / "report.html", validation=validation, truth=truth)
    return path, compare_with_truth(result, truth)


# Not the read noise: a dark frame of an intensifier scintillates, and its noise is more than that of reading.
COMPARED_QUANTITIES = ("covariance_gain", "blur_factor", "photoelectron_gain", "excess_noise_factor", "halo_diameter")
# A bar target or an edge without a direction has vertical bars.
HORIZONTAL_DEG = 0.0


def of_bench(folder: Path, session: Session) -> "Truth":
    """Return the truth of a virtual bench for the quantities of its session, by the contract's names.

    The MTF is a function of frequency and direction; gains are those at the session's plate voltage, which must be one.
    """
    from labdata.errors import BadInput
    from simulate.iiccd import true_quantities
    from simulate.virtual_bench.truth_folder import TRUTH, read_truth

    sensor = read_truth(folder / TRUTH).sensor
    voltages = {stack.conditions.mcp_v for stack in session.of_kind("flat")}
    if len(voltages) != 1:
        raise BadInput(f"truth is stated for one plate voltage, got flats at {sorted(map(str, voltages))} V")
    conditions = session.of_kind("flat")[0].conditions
    at_level = partial(_at_level, sensor)
    found = true_quantities.true_quantities(sensor, conditions)
    return {
        **{name: found[name] for name in COMPARED_QUANTITIES},
        "mtf": lambda frequency, angle: true_quantities.true_mtf(
            sensor, frequency, HORIZONTAL_DEG if angle is None else angle
        ),
        "mtf50": at_level(0.5),
        "mtf10": at_level(0.1),
    }


def _at_level(sensor, level: float):
    from simulate.iiccd import true_quantities

    return lambda _, angle: true_quantities.true_crossing_frequency(
        sensor, level, HORIZONTAL_DEG if angle is None else angle
    )


def lines(rows: Sequence["TruthComparison"]) -> Iterator[str]:
    """The table for a terminal."""
    yield f"\n{'quantity':44} {'stack, or method':18} {'truth':>10} {'measured':>26} {'z':>6}  status"
    for row in rows:
        m = row.measurement
        name = m.quantity if m.frequency_cy_per_px is None else f"{m.quantity} at {m.frequency_cy_per_px:.3g} cy/px"
        name += "" if m.orientation_deg is None else f" along {m.orientation_deg:.3g} deg"
        unit = "" if m.unit == "1" else f" {m.unit}"
        measured = f"{row.value_text}{unit}"
        yield f"{name:44} {m.stack or m.method:18} {row.truth_text:>10} {measured:>26} {row.z:6.2f}  {m.status}"
