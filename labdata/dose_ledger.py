"""The dose ledger of a tube: lines of a file, each on the disk before the next, that outlive sessions and crashes."""

import fcntl
import json
import os
import time
from collections.abc import Iterator
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path

from labdata.atomic_write import ends_mid_line, sync_folder, write_whole
from labdata.errors import BadInput
from labdata.tube_dose import Dose, total_dose

FOLDER_VARIABLE = "CHARACT_TUBES"
"""Environment variable that names another folder for the ledgers."""

PATIENCE_S = 2.0
"""Longest wait for the lock of a ledger, s; an append holds it for milliseconds."""

LOOK_S = 0.02
"""Time between two tries for the lock, s."""


def ledger_of(tube: str) -> "DoseLedger":
    """Return the ledger of a tube by its name, in the user's data folder."""
    if not tube or tube.startswith(".") or set(tube) & set("/\\\0"):
        raise BadInput(f"a tube's name must be a file name without slashes or a leading dot, got {tube!r}")
    data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    folder = os.environ.get(FOLDER_VARIABLE) or Path(data) / "charact" / "tubes"
    return DoseLedger(Path(folder) / f"{tube}.jsonl")


class DoseLedger:
    """Doses of one tube.

    Parameters
    ----------
    path
        The file; made with its folder at the first dose.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def append(self, dose: Dose, **said: object) -> None:
        """Add a dose, on the disk when this returns; `said` is what a reader may want to know of it.

        Raises
        ------
        OSError
            If the disk does not take the dose, or another process locks the ledger for longer than `PATIENCE_S`.
        """
        values = {item.name: getattr(dose, item.name) for item in fields(Dose)}
        line = json.dumps({"time": datetime.now(UTC).isoformat(timespec="seconds"), **values, **said}) + "\n"
        new = not self.path.exists()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with open(self.path, "ab+", buffering=0) as file:
            _lock(file.fileno())
            # A power cut may have left half a line: it stays half, and the next begins anew.
            write_whole(file.fileno(), (b"\n" if ends_mid_line(file.fileno()) else b"") + line.encode())
            os.fsync(file.fileno())
        if new:
            sync_folder(self.path.parent)

    def total(self) -> Dose:
        """Return all doses so far together; none where there is no ledger yet."""
        return total_dose(self._doses())

    def __len__(self) -> int:
        """Number of doses so far."""
        return sum(1 for _ in self._doses())

    def _doses(self) -> Iterator[Dose]:
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            return
        except OSError as error:
            raise BadInput(f"a dose ledger must be a readable file, got {self.path}: {error.strerror}") from None
        for number, line in enumerate(data.split(b"\n"), 1):
            if line.strip() and (dose := self._dose(line, number)) is not None:
                yield dose

    def _dose(self, line: bytes, number: int) -> Dose | None:
        """Return the dose of a line; None of one that was cut off."""
        try:
            values = json.loads(line)
        except RecursionError:
            raise self._damage_error(number) from None
        except ValueError:
            if line.startswith(b"{") and not line.rstrip().endswith(b"}"):
                return None
            raise self._damage_error(number) from None
        try:
            return Dose(**{item.name: float(values[item.name]) for item in fields(Dose)})
        except (KeyError, TypeError, ValueError, OverflowError):
            raise self._damage_error(number) from None

    def _damage_error(self, number: int) -> BadInput:
        return BadInput(f"every line of a dose ledger must hold a dose, got another in line {number} of {self.path}")


def _lock(descriptor: int) -> None:
    """Lock a ledger; a lock that is not free in time is a TimeoutError.

    It is a lock of the open file, not of the process, which would end when a reader in this process closes the file.
    """
    until_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until_s:
                raise TimeoutError(f"another process has locked it for more than {PATIENCE_S:g} s") from None
            time.sleep(LOOK_S)
