"""Virtual bench: a random device, its instruments and its camera, each on a real wire."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Self

from labdata import BadInput, Camera, LampCalibration
from labdata.instrument_config import InstrumentConfig, InstrumentConnection, Role
from simulate.virtual_bench import aravis_library
from simulate.virtual_bench.camera import CameraProcess
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.in_process import InProcessCamera, InProcessInstruments
from simulate.virtual_bench.instrument import virtual_model
from simulate.virtual_bench.outputs import (
    Outputs,
    VirtualOperator,
    read_outputs,
    read_placement,
    read_room_light_lux,
)
from simulate.virtual_bench.process import VirtualInstruments
from simulate.virtual_bench.true_sensor import TRUTH, BenchTruth, load_or_draw_truth, read_truth

# drawing one frame may take long on a busy machine; a dead camera's port is noticed at once
SILENCE_S = 15.0


class VirtualBench:
    """A virtual bench, running within its `with` block.

    Parameters
    ----------
    folder
        Folder of the bench, apart from every session; made where it is missing, gone on with where
        it is not.
    sensor, seed
        Description from whose ranges the device is drawn, and seed of the device and of every
        frame.
    wires
        Which instruments stand at the bench, and where they live. "virtual": camera and instruments
        are processes on real wires, save those whose port is named, which are real; where Aravis
        cannot be had, the camera's wire is left out and said to be. "in-process": everything inside
        this process; `inside` then holds the instruments.
    lamp
        Calibration of the light source that the wires name; what the lamp truly makes is drawn
        within it.
    time_scale
        How much faster than life high voltage and filter wheel move, dimensionless.
    say
        Called with a sentence on what is omitted or awaited.
    """

    silence_s = SILENCE_S  # Longest time that a frame of the virtual camera may take, s

    def __init__(
        self,
        folder: str | Path,
        sensor: Camera,
        seed: int,
        *,
        wires: InstrumentConfig | None = None,
        lamp: LampCalibration | None = None,
        time_scale: float = 1.0,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self.folder = Path(folder).resolve()
        self.truth_folder = self.folder / TRUTH
        # Folder where the instruments publish what they put out
        self.wires_folder = _next_wires_folder(self.folder)
        wires = InstrumentConfig() if wires is None else wires
        if wires.bench == "real":
            raise BadInput(
                "a virtual bench must be virtual or in-process, got the wires of a real one"
            )
        named = [connection for connection in wires.instruments if connection.port]
        if wires.bench == "in-process" and named:
            raise BadInput(
                f"a bench inside a process must have no serial ports, got {named[0].port} for a "
                "real one"
            )
        self._time_scale, self._asked, self._lamp = time_scale, wires, lamp
        self._sensor, self._seed, self._say = sensor, seed, say
        self.operator = VirtualOperator(self.folder)
        self.left_out: tuple[str, ...] = ()
        self.real: tuple[str, ...] = ()
        self.inside: InProcessInstruments | None = None
        self._instruments: VirtualInstruments | None = None
        self.camera: CameraProcess | None = None

    def __enter__(self) -> Self:
        self.wires_folder.mkdir(parents=True, exist_ok=True)
        load_or_draw_truth(self.truth_folder, self._sensor, self._seed, self._lamp)
        self.operator.darken()
        with ExitStack() as running:
            self._start_instruments(running)
            if self._camera_has_a_wire():
                self.camera = running.enter_context(
                    CameraProcess(self.folder, self.wires_folder, say=self._say)
                )
            self._running = running.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._running.close()

    @property
    def wires(self) -> InstrumentConfig:
        """How the instruments are reached."""
        ports: dict[Role, str | None] = {
            connection.role: self._port(connection) for connection in self._asked.instruments
        }
        reached = self._asked.with_ports(ports)
        return replace(reached, camera=self.camera.identifier) if self.camera else reached

    @property
    def instruments(self) -> VirtualInstruments:
        """The serial instruments' processes, to be unplugged and plugged in."""
        if self._instruments is None:
            raise BadInput(
                "instruments inside this process cannot be unplugged, got an in-process bench"
            )
        return self._instruments

    def in_process_camera(self) -> InProcessCamera:
        """Return the camera without its wire."""
        return InProcessCamera(self.folder, self.outputs)

    def outputs(self) -> Outputs:
        """Return the present outputs of the instruments."""
        if self.inside is None:
            return read_outputs(self.wires_folder)
        return replace(self.inside.outputs(), room_light_lux=read_room_light_lux(self.wires_folder))

    def provoke(self, instrument: str, faults: Faults) -> None:
        """Inject faults into a virtual instrument, the camera or the surroundings; BadInput for a
        real instrument.
        """
        virtual_connections = [
            connection for connection in self._asked.instruments if not connection.port
        ]
        virtual: dict[str, Role] = {
            virtual_model(connection.model).bench_name: connection.role
            for connection in virtual_connections
        }
        if instrument in virtual and self.inside is not None:
            self.inside.ports[virtual[instrument]].faults = faults
        elif instrument in (*virtual, "surroundings") or (
            instrument == "camera" and self.camera is not None
        ):
            inject_faults(self.wires_folder, instrument, faults)
        else:
            raise BadInput(
                f"a fault must strike an instrument on the wires of this bench, got {instrument}"
            )

    def truth(self) -> BenchTruth:
        """Return the true state of the bench, for comparison after a measurement."""
        return read_truth(self.truth_folder)

    def _start_instruments(self, running: ExitStack) -> None:
        if self._asked.bench == "in-process":
            self.inside = InProcessInstruments(self._asked, time_scale=self._time_scale)
            if "light-meter" in self.inside.ports:
                self.inside.ports["light-meter"].far_end().connect_light(self._illuminance_lux)
            return
        real = [connection for connection in self._asked.instruments if connection.port]
        self.real = tuple(
            f"the {connection.role} is a real {connection.model} at {connection.port}"
            for connection in real
        )
        for sentence in self.real:
            self._say(
                f"Of this virtual bench {sentence}; the virtual tube feels nothing of what it does."
            )
        instruments = VirtualInstruments(
            self.wires_folder,
            models=tuple(
                connection.model for connection in self._asked.instruments if not connection.port
            ),
            gate_address=self._asked.gate_address,
            supply_address=self._asked.supply_address,
            time_scale=self._time_scale,
        )
        self._instruments = running.enter_context(instruments)

    def _illuminance_lux(self) -> float:
        return self.truth().illuminance_lux(read_placement(self.folder), self.outputs())

    def _port(self, connection: InstrumentConnection) -> str | None:
        """Port of a real instrument, or of one that stands at this bench; none inside a process."""
        if connection.port or self._instruments is None:
            return connection.port
        return self._instruments.port(virtual_model(connection.model).bench_name)

    def _camera_has_a_wire(self) -> bool:
        if self._asked.bench == "in-process":
            self.left_out = (
                "All wires were left out, as asked: camera and instruments live inside this "
                "process, and no other process makes the tube safe.",
            )
        elif not aravis_library.is_available():
            self.left_out = (
                "The camera's GigE Vision wire was left out: the Aravis library is not on this "
                "machine (Debian: apt-get install libaravis-0.8-0), so the camera lives inside "
                "this process.",
            )
        for sentence in self.left_out:
            self._say(sentence)
        return not self.left_out


def _next_wires_folder(folder: Path) -> Path:
    """Return an unused folder for the wires of this run: instruments of a killed run may still use
    theirs.
    """
    runs = (int(path.suffix[1:]) for path in folder.glob("wires.*") if path.suffix[1:].isdigit())
    return folder / f"wires.{max(runs, default=0) + 1}"
