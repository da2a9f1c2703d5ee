"""The verb `safe`: gate shut and high voltage off, with nothing but the serial ports."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message


def add_to(app: typer.Typer) -> None:
    """Add the verb to the command."""
    app.command()(safe)


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
        from drivers.bench.safe_state import make_bench_safe
        from drivers.bench.setup import last_bench, with_present_ports

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
