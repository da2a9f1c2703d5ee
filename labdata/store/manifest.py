"""The manifest of a session while it is taken: saved whole at every change, at the cost of what changed."""

from dataclasses import dataclass, replace
from pathlib import Path

from labdata.border import to_toml
from labdata.durable import write_durably
from labdata.form import SessionForm, StackForm
from labdata.session import MANIFEST


class ManifestWriter:
    """Saves the manifest of one session.

    Parameters
    ----------
    folder
        The session's folder.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / MANIFEST
        self._written: dict[StackForm, str] = {}

    def save(self, form: SessionForm) -> None:
        """Save the manifest; when this returns it survives a kill and a power cut."""
        # A sweep of hundreds of stacks is saved at every one of them: those that did not change are not worded anew.
        texts = {entry: self._written.get(entry) or _text(entry) for entry in form.stack}
        header = to_toml(replace(form, stack=()))
        write_durably(self._path, "\n".join((header, *texts.values())).encode())
        self._written = texts


@dataclass(frozen=True)
class _OneStack:
    """The part of a session file that is one stack's."""

    stack: tuple[StackForm, ...]


def _text(entry: StackForm) -> str:
    text = to_toml(_OneStack((entry, _LONG)))
    return text[: text.rindex("[[stack]]")]


# TOML's writer puts short tables on one line, which cannot be joined with others; beside a long one it does not.
_LONG = StackForm(label="x" * 200, kind="dark", frames="")
