"""A bare picture given where a session is expected: read for what one frame can tell, or refused in one sentence."""

from pathlib import Path
from typing import TYPE_CHECKING

from charact.cli.output import bad_input_ends, show
from charact.cli.progress import progress_bar

if TYPE_CHECKING:
    from labdata.session import Session


def is_picture(path: Path) -> bool:
    """Whether a path is a file of frames rather than a session."""
    from labdata.importers import KINDS
    from labdata.session import MANIFEST

    return path.suffix.lower() in KINDS and not (path / MANIFEST).is_file()


def must_be_a_session(path: Path) -> None:
    """Refuse a file of frames with what reads it.

    Raises
    ------
    BadInput
        If the path is one.
    """
    from labdata.errors import BadInput

    if is_picture(path):
        raise BadInput(
            f"a session must be a folder with a session.toml, got the file {path}: charact import frames {path} OUT "
            "--kind KIND makes a session of it, charact bloom and charact mtf read it as it is"
        )


def opened(path: Path) -> "Session":
    """Open a session; a file of frames in its place is refused with what reads it."""
    from labdata.session import open_session

    must_be_a_session(path)
    return open_session(path)


def bloom_of_picture(path: Path, *, method: str, within: float, quick: bool, seed: int, mapped: bool,
                     as_json: bool, events: bool) -> None:  # fmt: skip
    """Extents of a point source in a bare picture, by what one frame tells or by the method asked for."""
    with bad_input_ends(str(path), as_json=as_json, events=events):
        from charact import bloom
        from charact.bloom.frame import bare_session, measure_frame
        from charact.measuring import context_of
        from labdata.errors import BadInput

        if not path.exists():
            raise BadInput(f"the file of frames must exist, got {path}")
        if mapped:
            raise BadInput(
                f"--map needs a session, whose point sources tell the halo, got the file {path}: "
                f"charact import frames {path} OUT --kind point makes a session of it"
            )
        session = bare_session(path)
        with progress_bar(events=events) as progress:
            context = context_of(session, quick=quick, seed=seed, progress=progress)
            if method == "auto":
                result = measure_frame(session, context=context)
            else:
                result = bloom.measure(session, method=method, within_percent=within, context=context)
        further = f"charact import frames {path} mine --kind point, then charact measure mine"
        show(result, given=str(path), as_json=as_json, events=events, next_verb=further)
