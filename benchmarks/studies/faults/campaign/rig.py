"""The bench of the campaign: a small virtual camera and instruments on real wires, which outlive
every client.
"""

import fcntl
import os
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from labdata import (
    Conditions,
    InstrumentConfig,
    Override,
    Plan,
    Step,
    load_sensor,
    read_events,
    save_sensor,
)
from simulate.virtual_bench.bench import VirtualBench
from simulate.virtual_bench.camera import CameraProcess
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.outputs import Outputs, VirtualOperator
from simulate.virtual_bench.true_sensor import BenchTruth

GATE, SUPPLY = INSTRUMENTS = ("delay_generator", "high_voltage")
FREE_S = 20.0
DANGEROUS_V = 15.0  # the server follows the voltage down to 10 V
FRAMES = 20
GATE_NS = 1.6e7
LUX = 1e-5
FAST = Override(
    limit="ramp_v_per_s", value=4000.0, reason="the virtual output moves faster than life"
)


class StoppablePipe:
    """A pipe that is read as it fills, or, stopped, is full and takes no more.

    Parameters
    ----------
    reader, writer
        Its two ends; the writer is another process's.
    """

    def __init__(self, reader: int, writer: int) -> None:
        self._reader, self.writer = reader, writer
        # A description of its own: the other process must block where the pipe is full.
        self._filler = os.open(f"/proc/self/fd/{writer}", os.O_WRONLY | os.O_NONBLOCK)
        os.set_blocking(reader, False)
        self._stopped = False

    def read(self) -> bytes:
        """Return what came since; nothing while it is stopped."""
        data = b""
        with suppress(BlockingIOError):
            while not self._stopped and (part := os.read(self._reader, 65536)):
                data += part
        return data

    def stop(self) -> None:
        """Fill it, with empty lines, and read no more."""
        self._stopped = True
        for size in (4096, 1):
            with suppress(BlockingIOError):
                while True:
                    os.write(self._filler, b"\n" * size)

    def go_on(self) -> None:
        """Read it again."""
        self._stopped = False

    def close_writer(self) -> None:
        """Let go of the end that is another process's."""
        os.close(self.writer)

    def close(self) -> None:
        """Let go of what is left."""
        os.close(self._reader)
        os.close(self._filler)


class CampaignRig:
    """A virtual bench that is broken and healed; use it in a `with` block.

    Parameters
    ----------
    folder
        Where all of it lies.
    seed
        Seed of the specimen.
    rows, columns
        Size of its picture, px.
    time_scale
        How much faster than life the high voltage moves, dimensionless.
    """

    def __init__(
        self,
        folder: Path,
        seed: int,
        *,
        rows: int = 61,
        columns: int = 84,
        time_scale: float = 20.0,
    ) -> None:
        sensor = load_sensor("pulnix-ag5745ef3")
        self.sensor = replace(sensor, ccd=replace(sensor.ccd, rows=rows, columns=columns))
        self.folder, self.ledger = folder, folder / "dose.jsonl"
        self._seed, self._told = seed, folder / "server.jsonl"
        self._bench = VirtualBench(folder / "bench", self.sensor, seed, time_scale=time_scale)
        self._camera: CameraProcess | None = None
        self._log_pipe: StoppablePipe | None = None
        self._locked: IO[bytes] | None = None

    def __enter__(self) -> Self:
        save_sensor(self.sensor, self.folder / "sensor.toml")
        self._bench.__enter__()
        self._camera = self._bench.camera
        self._told.touch()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._camera is not self._bench.camera and self._camera is not None:
            self._camera.__exit__(kind, error, trace)
        self._bench.__exit__(kind, error, trace)

    def plan(self) -> Plan:
        """Return the plan of the campaign: a dark and a flat at two gains, each two thirds of a
        second of frames.
        """
        asked = Conditions(mcp_v=650.0, gate_ns=GATE_NS)
        steps = (
            Step(label="dark", kind="dark", frames=FRAMES, conditions=asked),
            Step(
                label="flat",
                kind="flat",
                frames=FRAMES,
                conditions=replace(asked, mcp_v=720.0, illuminance_lux=LUX),
            ),
        )
        sensor = str(self.folder / "sensor.toml")
        return Plan(name="campaign", sensor=sensor, seed=self._seed, overrides=(FAST,), steps=steps)

    @property
    def wires(self) -> InstrumentConfig:
        """How a client reaches the instruments."""
        assert self._camera is not None
        return replace(self._bench.wires, camera=self._camera.identifier)

    @property
    def truth(self) -> BenchTruth:
        """What the specimen really is: for whoever compares afterwards."""
        return self._bench.truth()

    @property
    def operator(self) -> VirtualOperator:
        """Who places targets and light."""
        return self._bench.operator

    def outputs(self) -> Outputs:
        """What reaches the tube now."""
        return self._bench.outputs()

    # The log of the bench server, and the ledger of the tube

    @property
    def log(self) -> Path:
        """File that the next client names as the log of its bench server."""
        return self._told if self._log_pipe is None else self.folder / "log.pipe"

    def begin_log_pipe(self) -> None:
        """Put a pipe in place of the log; what comes through it is kept where the log was."""
        if self._log_pipe is None:
            path = self.folder / "log.pipe"
            os.mkfifo(path)
            self._log_pipe = StoppablePipe(
                os.open(path, os.O_RDONLY | os.O_NONBLOCK), os.open(path, os.O_WRONLY)
            )

    def end_log_pipe(self) -> None:
        """Put the file back."""
        if self._log_pipe is not None:
            self.read_log()
            self._log_pipe.close_writer()
            self._log_pipe.close()
            self._log_pipe = None
            (self.folder / "log.pipe").unlink()

    def read_log(self) -> None:
        """Keep what came through the pipe."""
        if self._log_pipe is not None and (data := self._log_pipe.read()):
            with self._told.open("ab") as log:
                log.write(data)

    def block_log(self, blocked: bool) -> None:
        """Have the log take no more lines, or take them again."""
        if self._log_pipe is not None:
            self._log_pipe.stop() if blocked else self._log_pipe.go_on()

    def lock_ledger(self, locked: bool) -> None:
        """Hold the lock of the tube's dose ledger, as another program that hangs would, or let go
        of it.
        """
        if locked:
            self._locked = self.ledger.open("ab")
            fcntl.lockf(self._locked, fcntl.LOCK_EX)
        elif self._locked is not None:
            self._locked.close()
            self._locked = None

    def server(self) -> int | None:
        """Process number of the bench server that runs now."""
        self.read_log()
        starts = [each["pid"] for each in read_events(self._told) if each["event"] == "start"]
        return starts[-1] if starts and _runs(starts[-1]) else None

    def await_free(self) -> bool:
        """Wait until the server of the last client has ended; one that does not is killed, and
        False returned.
        """
        until_s = time.monotonic() + FREE_S
        while (pid := self.server()) is not None:
            if time.monotonic() > until_s:
                os.kill(pid, 9)
                return False
            time.sleep(0.02)
        return True

    # Breaking and healing

    def provoke(self, instrument: str, faults: Faults) -> None:
        """Give an instrument its faults."""
        inject_faults(self._bench.wires_folder, instrument, faults)

    def unplug(self, instrument: str) -> None:
        """Pull the plug of an instrument, or of the camera."""
        if instrument == "camera":
            assert self._camera is not None
            self._camera.kill()
        else:
            self._bench.instruments.unplug(instrument)

    def plug_in(self, instrument: str) -> None:
        """Plug it in again."""
        if instrument == "camera":
            self._camera = CameraProcess(self._bench.folder, self._bench.wires_folder).__enter__()
        else:
            self._bench.instruments.plug_in(instrument)

    def power_cycle(self, instrument: str) -> None:
        """Switch an instrument off and on, and do not wait until it is up again."""
        self._bench.instruments.unplug(instrument)
        self._bench.instruments.switch_on(instrument)

    def await_ports(self) -> None:
        """Wait until the instruments are up."""
        self._bench.instruments.await_ports()

    def heal(self) -> None:
        """Take all faults away."""
        for instrument in (*INSTRUMENTS, "camera", "surroundings"):
            self.provoke(instrument, Faults())
        self.block_log(False)
        self.lock_ledger(False)

    def switch_off_what_is_on(self) -> None:
        """Do what a person does after a fault that left an instrument deaf with its output on: off
        and on again.

        Wait until the tube is at rest: what is left of a voltage would pass for one that is on.
        """
        for instrument, is_on in (
            (GATE, self.outputs().gate_open),
            (SUPPLY, self.outputs().mcp_v > DANGEROUS_V),
        ):
            if is_on:
                self.unplug(instrument)
                self.plug_in(instrument)
        until_s = time.monotonic() + FREE_S
        while self.outputs().gate_open or self.outputs().mcp_v > DANGEROUS_V:
            if time.monotonic() > until_s:
                raise TimeoutError(
                    f"the tube must come to rest within {FREE_S:g} s, got {self.outputs()}"
                )
            time.sleep(0.02)


def _runs(pid: int) -> bool:
    """Whether a process runs; one that ended and was not asked after does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
