"""Progress of long work: a bar on a terminal, JSON lines if asked, on a pipe only that functions are compiled."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[str, float], None]


@contextmanager
def progress_bar(*, events: bool = False) -> Iterator[Progress]:
    """Yield a function that takes a sentence and the share done (0..1); compiling is announced on stderr."""
    from charact.cli.output import print_message
    from charact.method.stopwatch import announce_compilation

    with (
        _bar(events=events) as progress,
        announce_compilation(
            lambda sentence: print_message(sentence if events else f"charact: {sentence}", events=events)
        ),
    ):
        yield progress


@contextmanager
def _bar(*, events: bool = False) -> Iterator[Progress]:
    if events:
        yield lambda sentence, share: print(
            json.dumps({"progress": round(share, 4), "message": sentence}), file=sys.stderr
        )
        return
    if not sys.stderr.isatty():
        yield lambda sentence, share: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda sentence, share: bar.update(task, description=sentence, completed=share)
