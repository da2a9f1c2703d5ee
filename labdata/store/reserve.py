"""Room kept free on the disk of a session, so that on a full disk it can still be said what was lost."""

import os
from pathlib import Path

RESERVE_BYTES = 1 << 20


class Reserve:
    """A file that holds room for a last manifest and a last line of the log.

    Parameters
    ----------
    folder
        The session's folder.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".reserve"
        with open(self._path, "wb") as file:
            file.write(b"\0" * RESERVE_BYTES)
            file.flush()
            os.fsync(file.fileno())

    def release(self) -> None:
        """Give the room back."""
        self._path.unlink(missing_ok=True)
