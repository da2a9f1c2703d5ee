"""The house in order: every module says its idea, and starting is quick."""

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_every_module_says_its_idea() -> None:
    silent = [
        path
        for room in ("labdata", "drivers", "simulate", "charact")
        for path in (ROOT / room).rglob("*.py")
        if path.read_text().strip() and not ast.get_docstring(ast.parse(path.read_text()))
    ]
    assert not silent


def test_nothing_heavy_is_imported_before_a_verb_runs() -> None:
    heavy = (
        "{'scipy', 'matplotlib', 'emcee', 'zarr', 'numba', 'trimesh', 'skimage', 'cv2', "
        "'astropy', 'rawpy'}"
    )
    code = f"import sys, charact.cli.application; print(sorted({heavy} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_slow_test_is_there() -> None:
    named = (ROOT / "tests" / "slow_tests.txt").read_text().split()
    defined = "".join(path.read_text() for path in (ROOT / "tests").rglob("*.py"))
    absent = [name for name in named if f"def {name.rpartition('::')[2]}(" not in defined]
    assert not absent
