"""Demonstration: the complete loop on the virtual bench, then a comparison with the truth."""

import math
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from charact.cli.benches import acquire_session
from charact.cli.output import print_message, progress_bar
from charact.cli.outputs import FITTED, is_taken, remove_session, require_free, why_kept
from charact.cli.sessions import fit_and_save, measure_folder, validate_and_save
from drivers.acquisition.acquire import bench_folder
from drivers.acquisition.plans import load_plan
from labdata import BadInput, Plan, Session, open_session

if TYPE_CHECKING:
    from charact.reporting.truth import Truth, TruthComparison

# Probability that a correct session has a z-score beyond the limit.
CHANCE = 1e-3
# How many times faster than real ones the virtual instruments move: the high voltage rises at 50
# V/s to 800 V.
QUICK_TIME_SCALE = 20.0
# Frames of a stack, and the stacks that a quick demonstration does without.
QUICK_FRAMES = 10
NOT_QUICK = ("flat-1", "flat-4", "bars-0.08", "point-1", "point-3", "point-6", "point-8")
MARKER_FILE = "demo.txt"


def demonstrate(out: Path, *, quick: bool, seed: int | None, force: bool, events: bool) -> bool:
    """Run the loop into a folder; return whether all values agree with the truth, no statistic of
    the validation differs beyond its tolerance and its controls hold.
    """
    seed = time.time_ns() % 2**31 if seed is None else seed
    session = out / "session"
    _make_room(out, session, seed, force=force)
    print_message(f"seed {seed} (repeat with --seed {seed}); output folder: {out}", events=events)
    left_out: list[str] = []
    plan = demo_plan(seed, quick=quick)
    if quick:
        stacks, all_stacks = (len(known.steps) for known in (plan, demo_plan(seed, quick=False)))
        sentence = f"quick: {stacks} of the {all_stacks} stacks, of {QUICK_FRAMES} frames or fewer"
        print_message(sentence, events=events)
    with _step("acquire", events), progress_bar(events=events) as progress:
        acquire_session(
            plan,
            session,
            resume=False,
            progress=progress,
            tell=left_out.append,
            time_scale=QUICK_TIME_SCALE if quick else 1.0,
        )
    for sentence in left_out:
        print_message(sentence, events=events)
    with _step("measure", events):
        result = measure_folder(session, quick=quick, seed=seed, events=events, save=True)
    with _step("fit", events):
        fit_and_save(session, result, session / FITTED, seed=seed, events=events)
    with _step("simulate and validate", events):
        validation = validate_and_save(session, quick=quick, seed=seed, events=events)
    with _step("report", events):
        from charact.reporting.session_page import write
        from charact.reporting.truth import compare_with_truth

        # The truth of the bench is read only after all measurements.
        measured = open_session(session)
        truth = bench_truth(bench_folder(session), measured)
        report = write(measured, result, out / "report.html", validation=validation, truth=truth)
        rows = compare_with_truth(result, truth)

    print("\n".join(lines(rows)))
    trusted = [row for row in rows if row.measurement.status == "ok"]
    largest = max_z(len(trusted))
    agrees = all(abs(row.z) <= largest for row in trusted)
    print(f"\nvalidation: {validation.verdict}")
    verdict = "yes" if agrees else "NO"
    print(
        f"truth within {largest:.2f} standard errors of all {len(trusted)} values with status ok: "
        f"{verdict}"
    )
    print(f"report: {report}")
    return agrees and validation.passed


def max_z(numbers: int) -> float:
    """Return the |z| that the largest of `numbers` correct values exceeds with probability
    `CHANCE`.
    """
    from scipy.special import ndtri

    return float(-ndtri(0.5 * -math.expm1(math.log1p(-CHANCE) / max(numbers, 1))))


def demo_plan(seed: int, *, quick: bool) -> Plan:
    """Return the shipped plan with a seed; `quick`: with fewer stacks and frames, and a bench
    without wires and processes.
    """
    plan = replace(load_plan("demo"), seed=seed)
    if not quick:
        return plan
    steps = tuple(
        replace(step, frames=min(step.frames, QUICK_FRAMES))
        for step in plan.steps
        if step.label not in NOT_QUICK
    )
    return replace(plan, steps=steps, wires=replace(plan.wires, bench="in-process"))


def _make_room(out: Path, session: Path, seed: int, *, force: bool) -> None:
    """Raise BadInput if there is an earlier demonstration, or with `force` delete its session and
    bench.
    """
    marker = out / MARKER_FILE
    exists = is_taken(session, "plan") or (out.exists() and not out.is_dir())
    require_free(
        out,
        force=force,
        taken=exists,
        kept=lambda: (
            why_kept(session, "plan") if marker.is_file() else f"something without {MARKER_FILE}"
        ),
    )
    if force:
        remove_session(session, "plan")
    if marker.is_file() and bench_folder(session).is_dir():
        shutil.rmtree(bench_folder(session))
    out.mkdir(parents=True, exist_ok=True)
    marker.write_text(
        f"Written by charact demo (seed {seed}); charact demo --force replaces its session and "
        f"report.\n"
    )


@contextmanager
def _step(name: str, events: bool) -> Iterator[None]:
    start = time.monotonic()
    yield
    print_message(f"{name}: {time.monotonic() - start:.1f} s", events=events)


def bench_truth(folder: Path, session: Session) -> "Truth":
    """Return the truth of a virtual bench by quantity name.

    The MTF is a function of frequency and direction; gains are those at the MCP voltage of the
    flats.
    """
    from simulate.camera.true_quantities import true_crossing_frequency, true_mtf, true_quantities
    from simulate.virtual_bench.true_sensor import TRUTH, read_truth

    sensor = read_truth(folder / TRUTH).sensor
    voltages = {stack.conditions.mcp_v for stack in session.of_kind("flat")}
    if len(voltages) != 1:
        raise BadInput(
            f"the truth needs flats at one MCP voltage, got flats at {sorted(map(str, voltages))} V"
        )
    quantities = true_quantities(sensor, session.of_kind("flat")[0].conditions)

    def at_level(level: float) -> Callable[..., float]:
        return lambda _, angle: true_crossing_frequency(sensor, level, angle or 0.0)

    # Without the read noise: dark frames of an intensifier also have scintillation noise.
    compared = (
        "covariance_gain",
        "blur_factor",
        "photoelectron_gain",
        "excess_noise_factor",
        "halo_diameter",
    )
    return {
        **{name: quantities[name] for name in compared},
        # Targets that state no direction are vertical bars.
        "mtf": lambda frequency, angle: true_mtf(sensor, frequency, angle or 0.0),
        "mtf50": at_level(0.5),
        "mtf10": at_level(0.1),
    }


def lines(rows: Sequence["TruthComparison"]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield (
        f"\n{'quantity':44} {'stack, or method':18} {'truth':>10} {'measured':>26} {'z':>6}  status"
    )
    for row in rows:
        m = row.measurement
        name = (
            m.quantity
            if m.frequency_cy_per_px is None
            else f"{m.quantity} at {m.frequency_cy_per_px:.3g} cy/px"
        )
        name += "" if m.orientation_deg is None else f" along {m.orientation_deg:.3g} deg"
        unit = "" if m.unit == "1" else f" {m.unit}"
        measured = f"{row.value_text}{unit}"
        yield (
            f"{name:44} {m.stack or m.method:18} {row.truth_text:>10} {measured:>26} "
            f"{row.z:6.2f}  {m.status}"
        )
