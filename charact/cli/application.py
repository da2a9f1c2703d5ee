"""The command `charact`; each verb imports its packages only when it runs."""

import os
import signal
import sys
from typing import TYPE_CHECKING, Annotated, cast

import typer

from charact import __version__
from charact.cli import (
    acquire,
    compare,
    files,
    fuse,
    live,
    mtf,
    options,
    reference,
    sessions,
    simulate,
)
from charact.cli.output import SPELT_OUT

if TYPE_CHECKING:
    from io import TextIOWrapper

app = typer.Typer(
    name="charact",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(requested: bool) -> None:
    if requested:
        print(f"charact {__version__}")
        raise typer.Exit()


@app.callback()
def charact(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Characterize, simulate and validate image-intensified cameras, with a posterior for every
    value.

    First steps: charact demo; charact mtf edge my-edge.tif; charact measure my-session
    """


app.add_typer(mtf.app, name="mtf")
app.add_typer(files.import_app, name="import")
app.add_typer(fuse.app, name="fuse")
for verb in (
    acquire.demo,
    simulate.simulate,
    simulate.temperatures,
    acquire.plan,
    acquire.acquire,
    acquire.safe,
    live.live,
    live.focus,
    live.watch,
    reference.doctor,
    reference.conform,
    sessions.noise,
    sessions.bloom,
    sessions.measure,
    sessions.fit,
    sessions.validate,
    sessions.report,
    files.view,
    files.convert,
    compare.compare,
    compare.check,
    compare.expose,
    reference.chart,
    reference.stability,
    reference.methods,
    reference.schema,
):
    app.command()(verb)
for group in (app, mtf.app, files.import_app, fuse.app):
    for command in group.registered_commands:
        assert command.callback is not None
        command.callback = options.verb()(command.callback)


def run() -> None:
    """Run the command; an interrupt exits with code 130 and a message."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if sys.stdout is None:  # closed by the caller: the next file opened would get its descriptor
        print("charact: stdout must be open, got it closed", file=sys.stderr or None)
        sys.exit(1)
    for stream in filter(None, (sys.stdout, sys.stderr)):
        cast("TextIOWrapper", stream).reconfigure(errors=SPELT_OUT)
    try:
        app()
    except KeyboardInterrupt:
        print("charact: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        _flush()


def _flush() -> None:
    """Flush stdout; exit with code 1 and a message if it fails."""
    try:
        sys.stdout.flush()
    except OSError as error:
        # Python would write to stdout again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            print(f"charact: stdout must be writable, got: {error.strerror}", file=sys.stderr)
        sys.exit(1)
