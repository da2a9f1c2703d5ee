"""Cache of numba-compiled loops, valid until their source or any imported source changes.

Numba checks the file of a loop alone, but functions of other files are compiled into the loop. The
configurable locators need numba 0.68.1 or later.
"""

import os
import re
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("labdata", "drivers", "simulate", "charact")
IMPORT = re.compile(
    rf"^\s*from ((?:{'|'.join(PACKAGES)})[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE
)
LOCATORS = ",".join(
    f"labdata.numba_cache_locators.{name}" for name in ("Provided", "NextToSources", "OfTheUser")
)


def keep_loops() -> None:
    """Configure numba to validate cached loops by all sources that may be compiled into them."""
    os.environ.setdefault(
        "NUMBA_CACHE_LOCATOR_CLASSES", f"{LOCATORS},IPythonCacheLocator,ZipCacheLocator"
    )
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_LOCATOR_CLASSES = os.environ[
            "NUMBA_CACHE_LOCATOR_CLASSES"
        ]


def stamp_of(file: Path) -> str | None:
    """Return a digest of a file and its imports from these packages; None for files of other
    packages.
    """
    source = file.resolve()
    relative_parts = source.parts[len(ROOT.parts) :] if source.is_relative_to(ROOT) else ()
    if len(relative_parts) < 2 or relative_parts[0] not in PACKAGES:
        return None
    sources, pending = {source}, [source]
    while pending:
        new = _imports_of(pending.pop()) - sources
        sources |= new
        pending += new
    stamp = sha256()
    for path in sorted(sources):
        stamp.update(str(path.relative_to(ROOT)).encode() + b"\0" + _digest(path))
    return stamp.hexdigest()


@cache
def _digest(source: Path) -> bytes:
    return sha256(source.read_bytes()).digest()


@cache
def _imports_of(source: Path) -> frozenset[Path]:
    """Return the files of these packages that a file imports, inside functions too."""
    imported = set()
    for module, names in IMPORT.findall(source.read_text(encoding="utf-8")):
        module_path = ROOT.joinpath(*module.split("."))
        candidates = [module_path.with_suffix(".py"), module_path / "__init__.py"]
        candidates += [module_path / f"{name}.py" for name in re.findall(r"\w+", names)]
        imported.update(candidate for candidate in candidates if candidate.is_file())
    return frozenset(imported)
