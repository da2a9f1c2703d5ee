"""The virtual camera without its wire keeps a run alive while a frame is drawn."""

import time
from dataclasses import replace

import numpy as np
import pytest

from labdata import InstrumentConfig, load_sensor
from simulate.virtual_bench.bench import VirtualBench
from simulate.virtual_bench.in_process import InProcessCamera
from simulate.virtual_bench.outputs import Outputs
from simulate.virtual_bench.tube import Scene, VirtualTube
from tests.drivers.camera_laws import Bench, WaitingLaws


class TestInProcess(WaitingLaws):
    @pytest.fixture
    def laws(self, tmp_path, monkeypatch):
        sensor = load_sensor("pulnix-ag5745ef3")
        small = replace(sensor, ccd=replace(sensor.ccd, rows=24, columns=36))
        expose = VirtualTube.expose

        def slow() -> InProcessCamera:
            def expose_slowly(tube: VirtualTube, scene: Scene) -> np.ndarray:
                time.sleep(0.7)
                return expose(tube, scene)

            monkeypatch.setattr(VirtualTube, "expose", expose_slowly)
            return camera()

        def camera() -> InProcessCamera:
            shut = Outputs(mcp_v=0.0, gate_open=False, gate_ns=0.0, gate_hz=0.0)
            return InProcessCamera(tmp_path.resolve(), lambda: shut)

        def quick() -> InProcessCamera:
            monkeypatch.setattr(VirtualTube, "expose", expose)
            return camera()

        with VirtualBench(tmp_path, small, 3, wires=InstrumentConfig(bench="in-process")):
            yield Bench(open=quick, quiet=slow, is_whole=lambda frame: frame.pixels.any())
