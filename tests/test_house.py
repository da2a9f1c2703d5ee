"""The house in order: every module says its idea, and starting is quick."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

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
    heavy = "{'scipy', 'matplotlib', 'emcee', 'zarr', 'numba', 'trimesh', 'skimage', 'cv2', 'astropy', 'rawpy'}"
    code = f"import sys, charact.cli.application; print(sorted({heavy} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# Files, lines and numeric constants of each package; these numbers may only fall.
BUDGETS = {
    "labdata": (51, 7_580, 55),
    "drivers": (54, 8_120, 122),
    "simulate": (134, 25_285, 292),
    "charact": (342, 63_420, 538),
}


@pytest.mark.parametrize("package", BUDGETS)
def test_a_package_keeps_to_its_budget(package: str) -> None:
    texts = [path.read_text() for path in (ROOT / package).rglob("*.py")]
    constants = sum(_numeric_constants(ast.parse(text)) for text in texts)
    lines = sum(text.count("\n") for text in texts)
    files, most_lines, most_constants = BUDGETS[package]
    assert len(texts) <= files
    assert lines <= most_lines
    assert constants <= most_constants


def _numeric_constants(tree: ast.Module) -> int:
    """Count names in capitals at module level that are bound to a number, each of a tuple by itself."""
    count = 0
    for node in tree.body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for target in targets:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            if node.value is not None and all(isinstance(n, ast.Name) and n.id.strip("_").isupper() for n in names):
                count += _numbers(node.value)
    return count


def _numbers(node: ast.expr) -> int:
    if isinstance(node, ast.Constant):
        return int(isinstance(node.value, int | float) and not isinstance(node.value, bool))
    if isinstance(node, ast.UnaryOp):
        return _numbers(node.operand)
    if isinstance(node, ast.BinOp):
        return int(bool(_numbers(node.left) and _numbers(node.right)))
    if isinstance(node, ast.Tuple | ast.List):
        return sum(bool(_numbers(one)) for one in node.elts)
    return 0


def test_every_slow_test_is_there() -> None:
    named = (ROOT / "tests" / "slow_tests.txt").read_text().split()
    defined = "".join(path.read_text() for path in (ROOT / "tests").rglob("*.py"))
    absent = [name for name in named if f"def {name.rpartition('::')[2]}(" not in defined]
    assert not absent
