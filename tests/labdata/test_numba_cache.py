"""Compiled loops that are kept on disk forget what another file said before it changed."""

import os
import subprocess
import sys
from pathlib import Path

import labdata.numba_cache

INNER = "import numba\n\n\n@numba.njit(cache=True)\ndef inner(x):\n    return {} * x\n"
OUTER = """import numba

from simulate.part.inner import inner


@numba.njit(cache=True)
def outer(x):
    return inner(x) + 0.5
"""


def said(root: Path) -> list[str]:
    """What a fresh process computes, and how many loops it took from disk."""
    ask = (
        "from labdata.numba_cache import keep_loops; keep_loops(); from simulate.part.outer "
        "import outer;print(outer(1.0), sum(outer.stats.cache_hits.values()))"
    )
    settings = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA")}
    settings["PYTHONPATH"] = str(root)
    done = subprocess.run(
        [sys.executable, "-c", ask], env=settings, cwd=root, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_a_loop_forgets_what_another_file_said_before(tmp_path):
    home, part = Path(labdata.numba_cache.__file__).parent, tmp_path / "simulate" / "part"
    for package in (tmp_path / "labdata", part.parent, part):
        package.mkdir()
        (package / "__init__.py").write_text("")
    for name in ("numba_cache.py", "numba_cache_locators.py"):
        (tmp_path / "labdata" / name).write_text((home / name).read_text())
    (part / "outer.py").write_text(OUTER)
    (part / "inner.py").write_text(INNER.format(2.0))
    assert said(tmp_path) == ["2.5", "0"]
    assert said(tmp_path) == ["2.5", "1"]
    (part / "inner.py").write_text(INNER.format(3.0))
    assert said(tmp_path) == ["3.5", "0"]
    (part / "inner.py").touch()
    assert said(tmp_path) == ["3.5", "1"]


def test_loops_of_other_packages_are_left_to_numba():
    assert labdata.numba_cache.stamp_of(Path(os.__file__)) is None
    assert labdata.numba_cache.stamp_of(
        labdata.numba_cache.ROOT / "simulate" / "radiance" / "geometry" / "embree.py"
    )
