"""A bench before a camera on a real GigE Vision wire."""

from dataclasses import replace

import pytest

from drivers.cameras.aravis.camera import AravisCamera
from labdata import load_sensor
from simulate.virtual_bench import aravis_library
from simulate.virtual_bench.outputs import GATE_FILE, VOLTAGE_FILE, GateOutput, publish
from simulate.virtual_bench.true_sensor import TRUTH, load_or_draw_truth

MARKS = [
    pytest.mark.wires,
    pytest.mark.aravis,
    pytest.mark.skipif(
        not aravis_library.is_available(), reason="the Aravis library is not on this machine"
    ),
]
OPEN = GateOutput(gate_open=True, gate_ns=1.6e7, gate_hz=60 / 1.001)
PATIENCE_S = 20.0  # drawing shares the machine with other tests


def wired_bench(folder, *, rows, columns, seed=3):
    """A bench whose gate is open and whose plate has its voltage, without instruments that could
    move them.
    """
    sensor = load_sensor("pulnix-ag5745ef3")
    small = replace(sensor, ccd=replace(sensor.ccd, rows=rows, columns=columns))
    wires = folder / "wires"
    wires.mkdir(parents=True)
    load_or_draw_truth(folder / TRUTH, small, seed)
    publish(wires, GATE_FILE, vars(OPEN))
    publish(wires, VOLTAGE_FILE, {"mcp_v": 750.0})
    return folder, wires


def opened(process, **options):
    return AravisCamera(process.identifier, **{"silence_s": PATIENCE_S, **options})


def taken(camera, frames, discard=0):
    with camera.capture(frames=frames, discard=discard) as capture:
        stack = list(capture)
    return stack, capture.lost_frames
