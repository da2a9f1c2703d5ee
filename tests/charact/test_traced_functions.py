"""How much of the house stands behind a command: functions and modules that are called.

A function counts once, where its own code runs outside of an import of ours: properties and nested
functions are functions; bodies of modules and classes, lambdas, comprehensions and what a decorator
does while a module is imported are not. `labdata.numba_cache*`, which numba calls as it loads
compiled loops, is left out: it depends on the machine. A module counts where one of its functions
does. Run as `python -m tests.charact.test_traced_functions COMMAND ...` this prints the numbers and
the functions of each module.
"""

import subprocess
import sys
import threading
from collections import defaultdict
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType

import numpy as np
import pytest
import tifffile
from scipy.special import erf

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = tuple(str(ROOT / name) + "/" for name in ("labdata", "drivers", "simulate", "charact"))


def is_ours(code: CodeType) -> bool:
    return code.co_filename.startswith(PACKAGES) and "numba_cache" not in code.co_filename


def is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_name == "<module>" and frame.f_code.co_filename.startswith(PACKAGES):
            return True
        frame = frame.f_back
    return False


def trace(arguments: list[str]) -> set[CodeType]:
    """Run a command and return the code of the functions that it calls."""
    called: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or code in called or not is_ours(code):
            return
        # The body of a class is no optimised code, and names of lambdas and their like are in <>.
        if code.co_flags & CO_OPTIMIZED and code.co_name[0] != "<" and not is_importing(frame):
            called.add(code)

    sys.argv = ["charact", *arguments]
    sys.setprofile(note)
    threading.setprofile(note)
    from charact.cli.application import run

    try:
        run()
    except SystemExit as end:
        assert not end.code
    sys.setprofile(None)
    return called


def counts(*arguments: str) -> tuple[int, int]:
    command = [sys.executable, "-m", "tests.charact.test_traced_functions", *arguments]
    for _ in range(2):  # the first may compile, and say so
        traced = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        if "compiling" not in traced.stderr:
            break
    functions, _, _, modules, _ = traced.stdout.rpartition("traced: ")[2].split()
    return int(functions), int(modules)


@pytest.fixture(scope="module")
def picture(tmp_path_factory) -> Path:
    """A TIFF of one edge, Gaussian blur of 1.06 px, photon noise."""
    row, col = np.mgrid[:120, :160]
    light = 1000.0 + 400.0 * erf((col - 80.0 + 0.1 * (row - 60.0)) / 1.5)
    path = tmp_path_factory.mktemp("traced") / "edge.tif"
    tifffile.imwrite(path, np.random.default_rng(1).poisson(light).astype(np.uint16))
    return path


def test_an_edge_by_the_standard_takes_few_functions(picture):
    functions, modules = counts("mtf", "edge", str(picture), "--method", "edge-slanted")
    assert functions <= 258
    assert modules <= 54


def test_a_session_of_one_edge_takes_few_functions(picture):
    session = picture.with_name("session")
    imported = ["import", "frames", str(picture), str(session), "--kind", "edge"]
    subprocess.run(
        [str(Path(sys.executable).with_name("charact")), *imported], cwd=ROOT, check=True
    )
    functions, modules = counts("measure", str(session))
    assert functions <= 476
    assert modules <= 82


if __name__ == "__main__":
    by_module = defaultdict(list)
    for traced_code in sorted(trace(sys.argv[1:]), key=lambda code: code.co_firstlineno):
        by_module[traced_code.co_filename.removeprefix(str(ROOT) + "/")].append(
            traced_code.co_qualname
        )
    for name in sorted(by_module):
        print(f"{name}: {', '.join(by_module[name])}")
    print(f"traced: {sum(map(len, by_module.values()))} functions in {len(by_module)} modules")
