"""Outputs that exist: refused before any work with the next free name, or replaced by --force."""

import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import count
from pathlib import Path
from typing import Annotated, Literal

import typer

from labdata.errors import BadInput

Force = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Replace what this verb wrote there before, results included; keep other files.",
    ),
]
Maker = Literal["plan", "simulation", "import"]
MADE_BY = {"plan": "acquired", "simulation": "simulated", "import": "of frames made elsewhere"}
FITTED = "fitted.toml"
# What charact writes into the folder of a session: about it, and with its frames.
REPORTS = ("report.html", "report.pdf", FITTED)
FILES_OF_A_VIEW = ("sensor.toml", "economy.json", "light.json", "truth.npz", "radiance.png")
OF_A_RIG = ("truth-*.npz", "truth/*.npz", "light/*.json", "economy/*.json")


def next_free(path: Path) -> Path:
    """Return the path with the first free number after its name: demo-2 for demo, sheet-3.xml for
    sheet-2.xml.
    """
    path = path if path.name not in ("", "..") else path.resolve()
    suffix = "" if path.is_dir() else path.suffix
    name = path.name.removesuffix(suffix)
    base, number = (name[:-2], int(name[-1])) if re.search(r".-[1-9]$", name) else (name, 1)
    return next(
        free
        for n in count(number + 1)
        if not (free := path.with_name(f"{base}-{n}{suffix}")).exists()
    )


def require_free(
    out: Path,
    *,
    force: bool,
    taken: bool | None = None,
    kept: Callable[[], str | None] = lambda: None,
    further: str = "",
) -> None:
    """Raise BadInput if an output exists, with the next free name, unless `force` may replace it.

    `taken`: whether it exists, of a folder that may hold other files (None: whether the path
    exists); `kept`: returns what the output is that must not be replaced, or None; `further`: what
    else can be done.
    """
    if not (out.exists() if taken is None else taken):
        return
    if not force:
        raise BadInput(
            f"an output must be new, got {out}, which exists: {next_free(out)} is free, --force "
            f"replaces {out}{further}"
        )
    if (what := kept()) is not None:
        raise BadInput(
            f"--force replaces only what this verb wrote, {out} is {what}: {next_free(out)} is free"
        )


def why_other_kind(path: Path, *beginnings: bytes) -> str | None:
    """Return what a path is unless it is a file with one of these beginnings; else None."""
    if not path.is_file():
        return "a folder"
    with path.open("rb") as file:
        start = file.read(100).lstrip().lower()
    return (
        None
        if start.startswith(tuple(beginning.lower() for beginning in beginnings))
        else "a file of another kind"
    )


def require_free_session(
    out: Path, maker: Maker, *, force: bool, sources: Iterable[Path] = ()
) -> None:
    """Raise BadInput if a folder holds a session that may not be replaced; `sources`: files that
    the verb reads.
    """
    further = f", --resume continues {out}" if maker == "plan" else ""
    kept = partial(why_kept, out, maker, sources)
    require_free(out, force=force, taken=is_taken(out, maker), kept=kept, further=further)


def is_taken(folder: Path, maker: Maker) -> bool:
    """Whether a folder holds a session, or the plan of one to be acquired; a file is in the way of
    all.
    """
    names = ("session.toml", *(("plan.toml",) if maker == "plan" else ()))
    return (folder.exists() and not folder.is_dir()) or any(
        (folder / name).exists() for name in names
    )


def why_kept(folder: Path, maker: Maker, sources: Iterable[Path] = ()) -> str | None:
    """Return what a folder is that `maker` must not replace, or None."""
    from labdata import MANIFEST, SessionFile, from_toml
    from labdata.session_writer import FRAMES, SessionWriter
    from labdata.store.journal import is_ours

    if not folder.is_dir():
        return "a file"
    # An import replaces the manifest alone: its frames may be in its folder.
    for source in () if maker == "import" else sources:
        if source.is_file() and source.resolve().is_relative_to(folder.resolve()):
            return f"the folder of its input {source.name}"
    acquired = all((folder / name).is_file() for name in ("plan.toml", "log.jsonl"))
    if not (folder / MANIFEST).is_file():
        return None if acquired else "a folder with a plan.toml that was not run"
    frames = [stack.frames for stack in from_toml(folder / MANIFEST, SessionFile).stack]
    acquired_here = all(
        isinstance(f, str) and Path(f).parent == Path(FRAMES) and is_ours(folder / f)
        for f in frames
    )
    made_by: Maker = "import" if not acquired_here else "plan" if acquired else "simulation"
    if made_by != maker:
        return f"a session {MADE_BY[made_by]}"
    if acquired_here:
        try:
            SessionWriter.resume(folder).close()
        except BadInput:
            return "a session that is being written"
    return None


def remove_session(folder: Path, maker: Maker) -> None:
    """Delete a session that charact acquired or simulated, if there is one, and its results; keep
    other files.
    """
    from labdata.session import MANIFEST
    from labdata.session_writer import FRAMES, SessionWriter
    from labdata.store.journal import is_ours

    if not is_taken(folder, maker):
        return
    with SessionWriter.resume(folder) if (folder / MANIFEST).is_file() else nullcontext():
        remove_results(folder)
        _delete(folder, (MANIFEST, "plan.toml", "log.jsonl", *FILES_OF_A_VIEW, *OF_A_RIG))
        for array in filter(is_ours, (folder / FRAMES).glob("*.zarr")):
            shutil.rmtree(array)


def remove_results(folder: Path) -> None:
    """Delete results, validation, check and report of a session, which another session would
    inherit.
    """
    from charact.comparison.limits import CHECKED
    from charact.validation.validation_result import NUMBERS, PICTURES
    from labdata.result_io import DRAWS, RESULTS

    _delete(folder, (RESULTS, DRAWS.format("*"), NUMBERS, PICTURES, CHECKED, *REPORTS))


def _delete(folder: Path, patterns: Iterable[str]) -> None:
    for pattern in patterns:
        for file in folder.glob(pattern):
            file.unlink()


@contextmanager
def manifest_to_replace(folder: Path) -> Iterator[None]:
    """Take the manifest of a session away, and put it back if the block fails; if not, delete the
    results.
    """
    from labdata.session import MANIFEST

    if not (folder / MANIFEST).exists():
        yield
        return
    aside = (folder / MANIFEST).rename(folder / f".{MANIFEST}.replaced")
    try:
        yield
    except BaseException:
        aside.rename(folder / MANIFEST)
        raise
    aside.unlink()
    remove_results(folder)
