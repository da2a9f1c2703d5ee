"""The bench of the campaign: a small virtual camera and instruments on real wires, which outlive every client."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labdata.event_log import read_events
from labdata.sensors import load_sensor
from labdata.wires import Wires
from simulate.rig.bench import VirtualBench
from simulate.rig.camera_process import CameraProcess
from simulate.rig.faults import Faults, provoke
from simulate.rig.operator import VirtualOperator
from simulate.rig.outputs import Outputs
from simulate.rig.truth_folder import Truth

FREE_S = 20.0
DANGEROUS_V = 15.0  # the watchdog follows the voltage down to 10 V


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

    def __init__(self, folder: Path, seed: int, *, rows: int = 61, columns: int = 84, time_scale: float = 20.0) -> None:
        sensor = load_sensor("pulnix-ag5745ef3")
        self.sensor = replace(sensor, ccd=replace(sensor.ccd, rows=rows, columns=columns))
        self.folder, self.watchdog_log = folder, folder / "watchdog.jsonl"
        self._bench = VirtualBench(folder / "bench", self.sensor, seed, time_scale=time_scale)
        self._camera: CameraProcess | None = None

    def __enter__(self) -> Self:
        self._bench.__enter__()
        self._camera = self._bench.camera
        self.watchdog_log.touch()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._camera is not self._bench.camera and self._camera is not None:
            self._camera.__exit__(kind, error, trace)
        self._bench.__exit__(kind, error, trace)

    @property
    def wires(self) -> Wires:
        """How a client reaches the instruments."""
        assert self._camera is not None
        return replace(self._bench.wires, camera=self._camera.identifier)

    @property
    def truth(self) -> Truth:
        """What the specimen really is: for whoever compares afterwards."""
        return self._bench.truth()

    @property
    def operator(self) -> VirtualOperator:
        """Who places targets and light."""
        return self._bench.operator

    def outputs(self) -> Outputs:
        """What reaches the tube now."""
        return self._bench.outputs()

    def provoke(self, instrument: str, faults: Faults) -> None:
        """Give an instrument its faults."""
        provoke(self._bench.wires_folder, instrument, faults)

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
        for instrument in ("delay_generator", "high_voltage", "camera"):
            self.provoke(instrument, Faults())

    def switch_off_what_is_on(self) -> None:
        """Do what a person does after a fault that left an instrument deaf with its output on: off and on again.

        Wait until the tube is at rest: what is left of a voltage would pass for one that is on.
        """
        for instrument, is_on in (
            ("delay_generator", self.outputs().gate_open),
            ("high_voltage", self.outputs().mcp_v > DANGEROUS_V),
        ):
            if is_on:
                self.unplug(instrument)
                self.plug_in(instrument)
        until_s = time.monotonic() + FREE_S
        while self.outputs().gate_open or self.outputs().mcp_v > DANGEROUS_V:
            if time.monotonic() > until_s:
                raise TimeoutError(f"the tube must come to rest within {FREE_S:g} s, got {self.outputs()}")
            time.sleep(0.02)

    def await_free(self) -> None:
        """Wait until the watchdog of the last client has ended: it holds the ports until the voltage is down."""
        until_s = time.monotonic() + FREE_S
        while (pid := self.watchdog()) is not None:
            if time.monotonic() > until_s:
                raise TimeoutError(f"the watchdog {pid} must end within {FREE_S:g} s of its client")
            time.sleep(0.02)

    def watchdog(self) -> int | None:
        """Process number of the watchdog that runs now."""
        starts = [each["pid"] for each in read_events(self.watchdog_log) if each["event"] == "start"]
        return starts[-1] if starts and _runs(starts[-1]) else None

    def ordered_off_s(self, since_s: float) -> float | None:
        """Seconds from a monotonic time until the high voltage was ordered off; None if it was not.

        A run that was at its end then had ordered it before: 0.
        """
        told = list(read_events(self.watchdog_log))
        began_s = max((each["monotonic_s"] for each in told if _begins(each, since_s)), default=since_s)
        orders = (
            max(0.0, each["monotonic_s"] - since_s)
            for each in told
            if each["event"].startswith("high voltage: HVOF") and each["ok"] and each["monotonic_s"] >= began_s
        )
        return next(orders, None)


def _begins(event: Mapping[str, Any], before_s: float) -> bool:
    """Whether a watchdog began to guard, before a monotonic time."""
    return event["event"] == "start" and event["monotonic_s"] <= before_s


def _runs(pid: int) -> bool:
    """Whether a process runs; one that ended and was not asked after does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
