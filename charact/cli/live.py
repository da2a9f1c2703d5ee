"""The verbs `live` and `focus`: the newest frames on a page of this machine, or their meters on the terminal."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, print_message

Camera = Annotated[
    str | None,
    typer.Option("--camera", help="Aravis identifier, IP address, v4l2:/dev/video0 or replay:FOLDER#LABEL."),
]
PlanFile = Annotated[
    Path | None, typer.Option("--plan", help="Plan whose camera is shown; on a virtual bench, its first edge.")
]
Growing = Annotated[
    Path | None, typer.Option("--session", help="Session that grows while a plan runs; the camera is left alone.")
]
Bits = Annotated[int | None, typer.Option("--bits", help="Bits of the digitiser, where the pixel format hides them.")]
Host = Annotated[
    str, typer.Option("--host", help="Address to listen on. Any but the loopback needs the token that is printed.")
]
Port = Annotated[int, typer.Option("--port", help="Port of the page; 0: any free one.")]
Terminal = Annotated[bool, typer.Option("--terminal", help="Meters on the terminal instead of a page.")]


def add_to(app: typer.Typer) -> None:
    """Add the verbs to the command."""
    for verb in (live, focus):
        app.command()(verb)


def live(
    camera: Camera = None,
    plan: PlanFile = None,
    session: Growing = None,
    roi: options.Roi = None,
    bits: Bits = None,
    host: Host = "127.0.0.1",
    port: Port = 8600,
    terminal: Terminal = False,
    seed: options.Seed = 0,
) -> None:
    """Picture, meters and histogram of the newest frames, on a page of this machine.

    Only looks: no setting of camera or tube is touched. While a plan runs, look at what it stores: --session.

    Example: charact live --camera Aravis-Fake-GV01
    """
    _show("charact live", camera, plan, session, roi, bits, host, port, terminal, seed)


def focus(
    camera: Camera = None,
    plan: PlanFile = None,
    session: Growing = None,
    roi: options.Roi = None,
    bits: Bits = None,
    host: Host = "127.0.0.1",
    port: Port = 8600,
    terminal: Terminal = False,
    seed: options.Seed = 0,
) -> None:
    """The same page with the focus as its large meter: MTF50 of an edge, the best so far held.

    Example: charact focus --camera Aravis-Fake-GV01 --roi 150,250,200,200
    """
    _show("charact focus", camera, plan, session, roi, bits, host, port, terminal, seed)


def _show(
    title: str, camera: str | None, plan: Path | None, session: Path | None, roi: str | None, bits: int | None,
    host: str, port: int, terminal: bool, seed: int,
) -> None:  # fmt: skip
    with exit_on_bad_input(title, interrupted="closed"):
        from charact.cli.live_source import live_source
        from charact.live.focus_reader import FocusReader
        from charact.live.live_loop import LiveLoop
        from charact.live.server import serve
        from charact.live.terminal import watch_on_terminal

        region = options.parse_region(roi)
        with (
            live_source(camera=camera, plan=plan, session=session, bits=bits, seed=seed, tell=print_message) as source,
            FocusReader(source.context, region) as reader,
            LiveLoop(source, focus=reader, region=region) as running,
        ):
            heading = f"{title}: {source.name}"
            if terminal:
                watch_on_terminal(running, title=heading)
            else:
                serve(
                    running,
                    title=heading,
                    focus_first=title == "charact focus",
                    host=host,
                    port=port,
                    tell=lambda address: print_message(f"{address}   (Ctrl-C closes it)"),
                )
