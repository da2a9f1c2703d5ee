"""Nothing of ours imports from the folder in which a user works, whatever lies there."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from labdata import load_sensor
from simulate.virtual_bench import aravis_library
from simulate.virtual_bench.camera import CameraProcess
from simulate.virtual_bench.process import VirtualInstruments
from simulate.virtual_bench.true_sensor import TRUTH, load_or_draw_truth

CHARACT = Path(sys.executable).with_name("charact")
NAMES = (
    "serial",
    "json",
    "numpy",
    "socket",
    "pickle",
    "struct",
    "multiprocessing",
    "simulate",
    "labdata",
    "charact",
)
FOCUS = """
import charact.cli
import charact.cli.application
from charact.live.focus import FocusReader
from charact.method import Context

def run():
    with FocusReader(Context()) as reader:
        print(reader._executor.submit(len, "four").result())

charact.cli.application.run = run
if __name__ == "__main__":
    charact.cli.main()
"""


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """The working folder: every module that is imported from it leaves a mark."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text(
            f"open({str(folder / 'executed')!r}, 'a').write({name!r})\n"
        )
    monkeypatch.chdir(folder)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    yield folder
    executed = folder / "executed"
    assert not executed.exists(), f"executed: {executed.read_text()}"


def test_the_trap_works(hostile):
    subprocess.run([sys.executable, "-c", "import json"], check=True)
    assert (hostile / "executed").read_text() == "json"
    (hostile / "executed").unlink()


def test_the_command_line(hostile):
    done = subprocess.run([CHARACT, "methods"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_the_process_that_reads_the_focus(hostile, tmp_path):
    (script := tmp_path / "bin" / "charact").parent.mkdir()
    script.write_text(FOCUS)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.stdout == "4\n", done.stderr


@pytest.mark.wires
def test_virtual_instruments(hostile, tmp_path):
    with VirtualInstruments(tmp_path / "wires") as instruments:
        assert os.path.exists(instruments.gate_port)


@pytest.mark.wires
@pytest.mark.aravis
@pytest.mark.skipif(
    not aravis_library.is_available(), reason="the Aravis library is not on this machine"
)
def test_the_virtual_camera(hostile, tmp_path):
    sensor = load_sensor("pulnix-ag5745ef3")
    folder, wires = tmp_path / "bench", tmp_path / "bench" / "wires"
    wires.mkdir(parents=True)
    load_or_draw_truth(
        folder / TRUTH, replace(sensor, ccd=replace(sensor.ccd, rows=24, columns=36)), 3
    )
    with CameraProcess(folder, wires) as process:
        assert process.identifier
