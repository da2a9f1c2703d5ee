"""The house in order: the tree of files is true, every module says its idea, and starting is quick."""

import importlib.util
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def tree():
    spec = importlib.util.spec_from_file_location("tree", ROOT / "docs" / "tree.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tree_of_files_is_true() -> None:
    assert (ROOT / "docs" / "files.md").read_text() == tree().page(), "run make docs"


def test_every_module_says_its_idea() -> None:
    silent = [
        path
        for room in ("labdata", "drivers", "simulate", "charact")
        for path in (ROOT / room).rglob("*.py")
        if path.read_text().strip() and not tree().first_sentence(path)
    ]
    assert not silent


def test_nothing_heavy_is_imported_before_a_verb_runs() -> None:
    heavy = "{'scipy', 'matplotlib', 'emcee', 'zarr', 'numba', 'trimesh', 'skimage', 'cv2', 'astropy', 'rawpy'}"
    code = f"import sys, charact.cli.application; print(sorted({heavy} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
