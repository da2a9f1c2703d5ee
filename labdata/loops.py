"""Compiled loops are kept on disk until any source of their part of the package changes.

Numba looks at the file of a loop alone. What a loop calls is compiled into it, often from other files: it would go on
computing what they said before. The locators that can be named to it are those of 0.68.1 and later.
"""

import os
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("labdata", "drivers", "simulate", "charact")
LOCATORS = ",".join(f"labdata.loops_kept.{name}" for name in ("Provided", "Beside", "OfTheUser"))


def keep_loops() -> None:
    """Have numba keep compiled loops by the sources of their part of the package; other packages' as ever."""
    os.environ.setdefault("NUMBA_CACHE_LOCATOR_CLASSES", f"{LOCATORS},IPythonCacheLocator,ZipCacheLocator")
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_LOCATOR_CLASSES = os.environ["NUMBA_CACHE_LOCATOR_CLASSES"]


def stamp_of(file: Path) -> str | None:
    """Return what changes with any source of a file's part, such as simulate/radiance; None for other packages."""
    inside = file.resolve().parts[len(ROOT.parts) :] if file.resolve().is_relative_to(ROOT) else ()
    return _stamp(ROOT.joinpath(*inside[:2])) if len(inside) > 2 and inside[0] in PACKAGES else None


@cache
def _stamp(part: Path) -> str:
    stamp = sha256()
    for source in sorted(part.rglob("*.py")):
        stamp.update(str(source.relative_to(part)).encode() + b"\0" + sha256(source.read_bytes()).digest())
    return stamp.hexdigest()
