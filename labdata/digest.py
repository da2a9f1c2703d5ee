"""What ties a number to its frames: the SHA-256 of a file, or of all that lies in a folder."""

import hashlib
from pathlib import Path


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content, or of a folder's: of the names and digests of its files, in order.

    Notes
    -----
    A folder's is that of the lines that `sha256sum` prints for its files, sorted by name and named from the folder on.
    """
    if not path.is_dir():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    files = sorted((part.relative_to(path).as_posix(), part) for part in path.rglob("*") if part.is_file())
    lines = "".join(f"{sha256_of(part)}  {name}\n" for name, part in files)
    return hashlib.sha256(lines.encode()).hexdigest()
