"""The serial half of the virtual bench: both instruments started as processes, stopped on leaving."""

import os
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from labdata.errors import BadInput

START_S = 10.0
STOP_S = 3.0
INSTRUMENTS = ("delay_generator", "high_voltage")


class VirtualInstruments:
    """Delay generator and high-voltage supply of one virtual bench, each a process of its own.

    They live in sessions of their own, so that Ctrl-C at the terminal does not unplug them, and outlive a killed
    bench until their lines have been quiet for some seconds, so that a watchdog can still reach them.

    Parameters
    ----------
    folder
        Folder of the bench: links to the ports, published outputs, faults. Made if absent.
    supply_address
        GPIB address of the supply behind its adapter.
    time_scale
        How much faster than life the supply's output moves, dimensionless.
    """

    def __init__(self, folder: Path, *, supply_address: int = 14, time_scale: float = 1.0) -> None:
        self.folder = Path(folder).absolute()
        self._options = ["--address", str(supply_address), "--time-scale", str(time_scale)]
        self._processes: dict[str, subprocess.Popen] = {}

    @property
    def gate_port(self) -> str:
        """Serial port of the delay generator."""
        return str(self.folder / "delay_generator")

    @property
    def supply_port(self) -> str:
        """Serial port of the adapter in front of the supply."""
        return str(self.folder / "high_voltage")

    def __enter__(self) -> "VirtualInstruments":
        self.folder.mkdir(parents=True, exist_ok=True)
        for leftover in self.folder.glob("*.json"):
            leftover.unlink()
        try:
            for instrument in INSTRUMENTS:
                self._processes[instrument] = self._start(instrument)
            self._await_ports()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def unplug(self, instrument: str) -> None:
        """Kill an instrument's process at once: its port goes, its outputs stay as they are."""
        self._processes[instrument].kill()
        self._processes[instrument].wait()

    def plug_in(self, instrument: str) -> None:
        """Start an instrument again that was unplugged: switched on anew, as after a power cycle."""
        self._processes[instrument] = self._start(instrument)
        self._await_ports()

    def stop(self) -> None:
        """Switch both off."""
        for process in self._processes.values():
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes.clear()

    def _start(self, instrument: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "simulate.rig", instrument, "--folder", str(self.folder)]
        command += ["--parent", str(os.getpid()), *self._options]
        with self._complaints(instrument).open("wb") as complaints:
            return subprocess.Popen(
                command, start_new_session=True, stdin=subprocess.DEVNULL, stdout=complaints, stderr=complaints
            )

    def _complaints(self, instrument: str) -> Path:
        return self.folder / f"{instrument}.stderr"

    def _await_ports(self) -> None:
        deadline_s = time.monotonic() + START_S
        outputs = ("gate.output.json", "high_voltage.output.json")
        while not all((self.folder / name).exists() for name in outputs):
            for instrument, process in self._processes.items():
                if process.poll() is not None:
                    said = self._complaints(instrument).read_text().strip().splitlines()[-1:]
                    raise BadInput(f"the virtual {instrument} must start, got exit {process.returncode}: {said}")
            if time.monotonic() > deadline_s:
                raise BadInput(f"the virtual instruments must start within {START_S:g} s in {self.folder}")
            time.sleep(0.01)
