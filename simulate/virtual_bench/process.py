"""Virtual serial instruments as processes."""

import os
import subprocess
import sys
import time
from pathlib import Path

from labdata.errors import BadInput
from simulate.virtual_bench.instrument import virtual_model

START_S = 10.0
STOP_S = 3.0


def end_processes(*processes: subprocess.Popen) -> None:
    """Ask processes to end, and kill those that do not in time."""
    for process in processes:
        process.terminate()
    for process in processes:
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class VirtualInstruments:
    """The serial instruments of one virtual bench, each a process of its own.

    They live in sessions of their own, so that Ctrl-C at the terminal does not unplug them, and
    outlive a killed bench until their lines have been quiet for some seconds, so that a bench
    server can still reach them. The folder holds links to the ports, published outputs and faults.
    """

    def __init__(
        self,
        folder: Path,
        *,
        models: tuple[str, ...] = ("dg645", "ps350"),
        gate_address: int = 15,
        supply_address: int = 14,
        time_scale: float = 1.0,
    ) -> None:
        self.folder = Path(folder).absolute()
        self._models = {virtual_model(name).bench_name: name for name in models}
        self._addresses = {"delay_generator": gate_address, "high_voltage": supply_address}
        self._time_scale = time_scale
        self._processes: dict[str, subprocess.Popen] = {}

    @property
    def gate_port(self) -> str:
        """Serial port of the delay generator."""
        return self.port("delay_generator")

    @property
    def supply_port(self) -> str:
        """Serial port of the adapter in front of the supply."""
        return self.port("high_voltage")

    def port(self, bench_name: str) -> str:
        """Serial port of the instrument at a place of the bench."""
        return str(self.folder / bench_name)

    def __enter__(self) -> "VirtualInstruments":
        self.folder.mkdir(parents=True, exist_ok=True)
        for leftover in self.folder.glob("*.json"):
            leftover.unlink()
        try:
            for instrument in self._models:
                self._processes[instrument] = self._start(instrument)
            self.await_ports()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def unplug(self, instrument: str) -> None:
        """Kill an instrument's process at once: its port goes, its outputs stay as they are."""
        self._processes[instrument].kill()
        self._processes[instrument].wait()

    def plug_in(self, instrument: str) -> None:
        """Start an instrument again that was unplugged, as after a power cycle; its port is there
        on return.
        """
        self.switch_on(instrument)
        self.await_ports()

    def switch_on(self, instrument: str) -> None:
        """Start an instrument again that was unplugged, and do not wait for its port."""
        self._ready(instrument).unlink(missing_ok=True)  # the word of the one before is not its own
        self._processes[instrument] = self._start(instrument)

    def await_ports(self) -> None:
        """Wait until every instrument that is plugged in has its port."""
        deadline_s = time.monotonic() + START_S
        while not all(map(Path.exists, map(self._ready, self._models))):
            for instrument, process in self._processes.items():
                if process.poll() is not None:
                    last_line = self._complaints(instrument).read_text().strip().splitlines()[-1:]
                    raise BadInput(
                        f"the virtual {instrument} must start, got exit {process.returncode}: "
                        f"{last_line}"
                    )
            if time.monotonic() > deadline_s:
                raise BadInput(
                    f"the virtual instruments must start within {START_S:g} s in {self.folder}"
                )
            time.sleep(0.01)

    def stop(self) -> None:
        """Switch them off."""
        end_processes(*self._processes.values())
        self._processes.clear()

    def _start(self, instrument: str) -> subprocess.Popen:
        command = [
            sys.executable,
            "-P",
            "-m",
            "simulate.virtual_bench",
            self._models[instrument],
            "--folder",
            str(self.folder),
        ]
        command += [
            "--parent",
            str(os.getpid()),
            "--address",
            str(self._addresses.get(instrument, 0)),
        ]
        command += ["--time-scale", str(self._time_scale)]
        with self._complaints(instrument).open("wb") as complaints:
            return subprocess.Popen(
                command,
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=complaints,
                stderr=complaints,
            )

    def _complaints(self, instrument: str) -> Path:
        return self.folder / f"{instrument}.stderr"

    def _ready(self, instrument: str) -> Path:
        return self.folder / f"{instrument}.ready.json"
