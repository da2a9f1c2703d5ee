"""The verb `acquire`: a plan becomes a session, on real or virtual instruments."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message
from charact.cli.progress import progress_bar


def add_to(app: typer.Typer) -> None:
    """Add the verb to the command."""
    app.command()(acquire)


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
        from charact.cli.benches import acquire_session
        from charact.cli.plan_files import load_plan
        from labdata.serialiser import from_toml
        from simulate.virtual_bench.rehearsal import FaultScript

        session = acquire_session(
            load_plan(plan),
            out,
            resume=resume,
            progress=progress,
            tell=lambda sentence: print_message(sentence, events=events),
            rehearse=None if rehearse is None else from_toml(rehearse, FaultScript),
        )
        print(f"{out}: {len(session.stacks)} stacks\nNext: charact measure {out}")
