"""The verbs of a real or virtual bench: `plan`, `acquire`, `demo` and `safe`."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.cli.options import Events, Json
from charact.cli.output import exit_on_bad_input, print_message, progress_bar
from charact.cli.outputs import Force, require_free_session
from labdata.settings import Resume, Setting

if TYPE_CHECKING:
    from drivers.acquisition.plan_check import PlanReport, StepForecast
    from labdata.tube_dose import Dose

MAX_LINES = 40  # of a forecast


def acquire(
    plan: Annotated[
        Path, typer.Argument(help="Acquisition plan, TOML, or the name of a shipped one.")
    ],
    out: Annotated[Path, typer.Argument(help="Output session folder.")],
    resume: Resume = False,
    inject_faults: Annotated[
        Path | None,
        Setting("Inject the faults of FAULTS.toml into the virtual bench.", metavar="FAULTS.toml"),
    ] = None,
    force: Force = False,
    events: Events = False,
) -> None:
    """Run an acquisition plan on real or virtual instruments and store a session.

    The first Ctrl-C finishes the step, closes the gate and saves; the second closes the gate at
    once. SIGUSR1 pauses after the current step with the gate closed and the light off; a second
    SIGUSR1 resumes. Events are logged to OUT/log.jsonl.

    Example: charact acquire plan.toml day1; kill -USR1 PID; charact acquire plan.toml day1 --resume

    \b
    Faults to inject; --resume continues with those not yet injected:
      [[fault]]
      instrument = "high_voltage"  # or delay_generator, light_source, filter_wheel, camera, ...
      kind = "garbage"             # half lines, silence, no answers, late answers, unplugged,
                                   # power cycle, trip, packet loss, stalled camera, clock jump
      at_step = "flat-700V"        # default: at_s counts from the start of the run
      at_s = 0.5
      for_s = 2.0
    """
    interrupted = (
        f"interrupted; frames acquired so far are kept. Resume with: charact acquire "
        f"{plan} {out} --resume"
    )
    with (
        exit_on_bad_input(str(plan), events=events, interrupted=interrupted),
        progress_bar(events=events) as progress,
    ):
        from charact.cli.benches import acquire_session, remove_run
        from drivers.acquisition.plans import load_plan
        from labdata import BadInput, from_toml
        from simulate.virtual_bench.rehearsal import FaultScript

        if resume and force:
            raise BadInput(
                "--resume continues a session and --force replaces it: one of them must be given, "
                "got both"
            )
        loaded = load_plan(plan)
        if not resume:
            replayed = (loaded.wires.camera or "").removeprefix("replay:").partition("#")[0]
            require_free_session(
                out, "plan", force=force, sources=(plan, Path(replayed) / "session.toml")
            )
        if force:
            remove_run(loaded, out)
        session = acquire_session(
            loaded,
            out,
            resume=resume,
            progress=progress,
            tell=lambda sentence: print_message(sentence, events=events),
            inject_faults=None if inject_faults is None else from_toml(inject_faults, FaultScript),
        )
        print(f"{out}: {len(session.stacks)} stacks\nNext: charact measure {out}")


def demo(
    out: Annotated[
        Path, typer.Argument(help="Folder for the session, the fitted sensor and the report.")
    ] = Path("demo"),
    quick: Annotated[
        bool, Setting("Fewer stacks and frames, no Markov chains, a quick validation.")
    ] = False,
    seed: Annotated[
        int | None,
        Setting(
            "Random seed of the device under test and of all noise (default: from the clock).",
            minimum=0,
        ),
    ] = None,
    force: Force = False,
    events: Events = False,
) -> None:
    """Run the complete loop on the virtual bench: acquire, characterize, fit, simulate, validate,
    report.

    Example: charact demo
    """
    with exit_on_bad_input(str(out), events=events):
        from charact.cli.demo_loop import demonstrate

        if not demonstrate(out, quick=quick, seed=seed, force=force, events=events):
            raise typer.Exit(1)


def safe(
    plan: Annotated[
        Path | None,
        typer.Argument(help="Plan of the bench (default: the last real bench of this machine)."),
    ] = None,
    events: Events = False,
) -> None:
    """Close the gate and switch the high voltage and the lamp off, without camera or session.

    Works while another program uses the ports; waits 15 s for a missing port. Exit 0: the safe
    state is verified.

    Example: charact safe plan.toml
    """
    with exit_on_bad_input(str(plan or "the last bench"), events=events):
        from drivers.acquisition.plans import load_plan
        from drivers.bench.bare_ports import make_bench_safe
        from drivers.bench.setup import last_bench, with_present_ports

        wires = last_bench() if plan is None else with_present_ports(load_plan(plan).wires)
        if not any(connection.port for connection in wires.instruments):
            print("This bench has no serial ports: no instrument is on between runs.")
            return

        report = make_bench_safe(
            wires,
            lambda step, **details: None,
            lambda report: print_message(report.warning(), events=events),
        )
        print(f"The tube: {report.last_words()}.")
        for failure in report.failures:
            print_message(f"charact: {failure}", events=events)
        if not report.whole:
            raise typer.Exit(1)


def plan(
    plan: Annotated[
        Path, typer.Argument(help="Acquisition plan, TOML, or the name of a shipped one.")
    ],
    as_json: Json = False,
    every: Annotated[
        bool, typer.Option("--all", help=f"Print every step instead of the first {MAX_LINES}.")
    ] = False,
) -> None:
    """Forecast an acquisition plan: steps, time, disk space, tube dose, hottest step. Nothing is
    switched on.

    Example: charact plan gain-by-light

    \b
    A plan with a sweep:
      name = "gain by light"
      sensor = "pulnix-ag5745ef3"
      [[sweep]]
      kind = "flat"
      frames = 16
      mcp_v = [600.0, 700.0, 800.0]
      gate_ns = 1.6e7
      illuminance_lux = [2e-5, 6e-5, 2e-4]
      order = "boustrophedon"
      dark_every = 3
    """
    with exit_on_bad_input(str(plan), as_json=as_json):
        from drivers import plan_report

        report = plan_report(plan)
        if as_json:
            print(json.dumps(_document(str(plan), report), allow_nan=False))
        else:
            print("\n".join(_lines(report, every=every)))
            if sys.stdout.isatty():
                print(f"\nNext: charact acquire {plan} OUT")


def _document(given: str, report: "PlanReport") -> dict[str, Any]:
    from labdata.limits import LIMITS

    lamp, before = report.plan.lamp, report.dose_before
    return {
        "charact": __version__,
        "input": given,
        "name": report.plan.name,
        "steps": [_step_document(forecast) for forecast in report.steps],
        "gain_table": None if report.gain_table is None else report.gain_table.provenance,
        "seconds": round(report.seconds, 1),
        "bytes": report.bytes,
        "dose": _dose_document(report.dose),
        "dose_before": None if before is None else _dose_document(before),
        "lamp": None if lamp is None else lamp.provenance,
        "hottest": _step_document(report.hottest),
        "limits": {name: getattr(report.limits, name) for name in LIMITS},
        "overridden": list(report.limits.overridden),
        "tube_known": report.limits.known,
        "warnings": list(report.warnings),
    }


def _step_document(forecast: "StepForecast") -> dict[str, Any]:
    conditions, lamp = forecast.step.conditions, forecast.lamp
    return {
        "label": forecast.step.label,
        "kind": forecast.step.kind,
        "frames": forecast.step.most_frames,
        **{name: getattr(conditions, name) for name in ("mcp_v", "gate_ns", "exposure_s")},
        "luminous_gain": forecast.gain.luminous_gain,
        "luminous_gain_relative_sd": forecast.gain.luminous_gain_relative_sd,
        "illuminance_lux": forecast.step.brightest.conditions.illuminance_lux,
        "filter_density": conditions.filter_density if lamp is None else lamp.filter_density,
        "lamp_a": None if lamp is None else lamp.lamp_a,
        "seconds": round(forecast.seconds, 3),
        "anode_na_per_cm2": forecast.anode_na_per_cm2,
        "share_of_limit": forecast.share_of_limit,
    }


def _dose_document(dose: "Dose") -> dict[str, float]:
    names = ("screen_c_per_cm2", "point_c_per_cm2", "hours_at_gain", "factor95")
    return {name: getattr(dose, name) for name in names}


def _lines(report: "PlanReport", *, every: bool) -> list[str]:
    from drivers.acquisition.run_progress import duration

    count = len(report.steps) if every else MAX_LINES
    hidden = len(report.steps) - count
    plan, hottest, before, dose = report.plan, report.hottest, report.dose_before, report.dose
    limit = report.limits.largest_anode_na_per_cm2(point=hottest.step.kind == "point")
    points = f", and {dose.point_c_per_cm2:.2g} inside pinholes" if dose.point_c_per_cm2 else ""
    earlier = (
        "unknown, the plan names no tube"
        if before is None
        else (
            f"{before.charge_c_per_cm2:.2g} C/cm2, {before.hours_at_gain:.3g} h at gain of tube "
            f"{plan.tube}"
        )
    )
    known = "No sensor description: default tube limits apply, and the tube load is an estimate."
    disk = "unknown without a sensor" if report.sensor is None else f"{report.bytes / 1e6:.0f} MB"
    return [
        f"{plan.name}: {len(report.steps)} steps, nothing is switched on",
        *_table(report, count),
        *([f"... and {hidden} more; --all prints them"] if hidden > 0 else []),
        f"time: {duration(report.seconds)}",
        f"disk: {disk}",
        f"dose: {dose.screen_c_per_cm2:.2g} C/cm2 at the phosphor{points}, within a factor of "
        f"{dose.factor95:.2g} (95 %); {60 * dose.hours_at_gain:.3g} min at gain",
        f"dose before: {earlier}",
        f"hottest: {hottest.step.label}, {hottest.anode_na_per_cm2:.3g} nA/cm2 MCP output current, "
        f"{hottest.share_of_limit:.0%} of the limit {limit:g}",
        *([] if report.limits.known else [known]),
        *([report.gain_table.provenance] if report.gain_table else []),
        *([plan.lamp.provenance] if plan.lamp else []),
        *report.limits.overridden,
        *report.warnings,
    ]


def _table(report: "PlanReport", count: int) -> Iterator[str]:
    """Yield the header and one line per step, with columns for a gain table and a lamp if there
    are.
    """
    has_gain, has_lamp = report.gain_table is not None, report.plan.lamp is not None
    gain = f" {'lm/lm':>9}" if has_gain else ""
    lamp = f" {'lamp mA':>8} {'filter':>6}" if has_lamp else ""
    load = f"{'lux':>9}{lamp} {'nA/cm2':>9} {'limit':>6}"
    yield f"{'label':<32} {'kind':<6} {'frames':>6} {'V':>6}{gain} {'gate ms':>8} {load}"
    for forecast in report.steps[:count]:
        conditions, lit = forecast.step.brightest.conditions, forecast.lamp
        if has_gain:
            gain = f" {forecast.gain.luminous_gain or 0.0:>9.4g}"
        if has_lamp:
            lamp = (
                f" {'out':>8} {'':>6}"
                if lit is None
                else f" {1e3 * (lit.lamp_a or 0.0):>8g} {lit.filter_density:>6g}"
            )
        yield (
            f"{forecast.step.label:<32} {forecast.step.kind:<6} {forecast.step.most_frames:>6} "
            f"{conditions.mcp_v or 0.0:>6g}{gain} {(conditions.gate_ns or 0.0) * 1e-6:>8.4g} "
            f"{conditions.illuminance_lux or 0.0:>9.3g}{lamp} {forecast.anode_na_per_cm2:>9.3g} "
            f"{forecast.share_of_limit:>6.1%}"
        )
