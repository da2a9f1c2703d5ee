"""The verbs `acquire`, `demo` and `safe`, which run a real or virtual bench."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli.options import Events
from charact.cli.output import exit_on_bad_input, print_message, progress_bar
from charact.cli.outputs import Force, require_free_session
from labdata.settings import Resume, Setting


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
        from labdata.errors import BadInput
        from labdata.serialiser import from_toml
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
    quick: Annotated[bool, Setting("Reduced run: fewer frames, no Markov chains.")] = False,
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
        from drivers.bench.safe_state import make_bench_safe
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
