"""The verb `acquire`: a plan becomes a session, on real or virtual instruments."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message, progress_bar


def acquire(
    plan: Annotated[Path, typer.Argument(help="Acquisition plan, TOML, or the name of a shipped one.")],
    out: Annotated[Path, typer.Argument(help="Folder of the session.")],
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a broken run; finished steps stay.")] = False,
    rehearse: Annotated[
        Path | None, typer.Option(metavar="FAULTS.toml", help="Let faults strike the virtual bench meanwhile.")
    ] = None,
    events: options.Events = False,
) -> None:
    """Run an acquisition plan on real or virtual instruments into a session.

    The first Ctrl-C finishes the step, shuts the gate and saves; the second shuts the gate now. SIGUSR1 pauses after
    the step, with gate shut and light out, and the next one goes on. OUT/log.jsonl tells what happened.

    Example: charact acquire plan.toml day1; kill -USR1 PID; charact acquire plan.toml day1 --resume

    \b
    Faults that rehearse a night; --resume goes on with those that have not struck yet:
      [[fault]]
      instrument = "high_voltage"  # or delay_generator, light_source, filter_wheel, camera, ...
      kind = "garbage"             # half lines, silence, no answers, late answers, unplugged, power cycle, trip,
                                   # packet loss, stalled camera, clock jump
      at_step = "flat-700V"        # without it at_s counts from the beginning of the run
      at_s = 0.5
      for_s = 2.0
    """
    interrupted = f"interrupted; the frames so far are kept: charact acquire {plan} {out} --resume"
    with (
        exit_on_bad_input(str(plan), events=events, interrupted=interrupted),
        progress_bar(events=events) as progress,
    ):
        from charact.cli.benches import acquire_session, load_plan
        from labdata.serialiser import from_toml
        from simulate.virtual_bench.fault_script import FaultScript

        session = acquire_session(
            load_plan(plan),
            out,
            resume=resume,
            progress=progress,
            tell=lambda sentence: print_message(sentence, events=events),
            rehearse=None if rehearse is None else from_toml(rehearse, FaultScript),
        )
        print(f"{out}: {len(session.stacks)} stacks\nNext: charact measure {out}")


def demo(
    out: Annotated[Path, typer.Argument(help="Folder for the session, the fitted sensor and the report.")] = Path(
        "demo"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="Fewer frames and no Markov chains.")] = False,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the specimen and of all noise; else from the clock.", min=0)
    ] = None,
    events: options.Events = False,
) -> None:
    """The whole loop on the virtual bench: acquire, characterize, fit, simulate, validate, report.

    Example: charact demo
    """
    with exit_on_bad_input(str(out), events=events):
        from charact.cli.demo_loop import demonstrate

        if not demonstrate(out, quick=quick, seed=seed, events=events):
            raise typer.Exit(1)


def safe(
    plan: Annotated[
        Path | None, typer.Argument(help="Plan whose bench is meant; without it, the last real bench of this machine.")
    ] = None,
    events: options.Events = False,
) -> None:
    """Shut the gate, switch the high voltage off and put the lamp out, without camera or session.

    It works while another program holds the ports, and waits 15 s for a port that is gone. Exit 0: all was verified.

    Example: charact safe plan.toml
    """
    with exit_on_bad_input(str(plan or "the last bench"), events=events):
        from charact.cli.benches import load_plan
        from drivers.bench.last_bench import last_bench, with_present_ports
        from drivers.bench.safe_state import make_bench_safe

        wires = last_bench() if plan is None else with_present_ports(load_plan(plan).wires)
        if not any(one.port for one in wires.instruments):
            print("This bench has no serial ports: nothing of it is on between runs.")
            return

        report = make_bench_safe(wires, lambda step, **details: None)
        print(f"The tube: {report.last_words()}.")
        for failure in report.failures:
            print_message(f"charact: {failure}", events=events)
        if not report.whole:
            raise typer.Exit(1)
