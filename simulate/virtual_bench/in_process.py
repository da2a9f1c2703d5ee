"""Virtual instruments and camera in this process, without pseudo-terminals and without Aravis."""

import copy
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from labdata import BadInput, CameraSettings, Frame
from labdata.instrument_config import InstrumentConfig, Role
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instrument import SerialInstrument, virtual_model
from simulate.virtual_bench.instruments.meters import TEMPERATURE_C
from simulate.virtual_bench.outputs import Outputs
from simulate.virtual_bench.pseudo_terminal import enter_at_panel
from simulate.virtual_bench.tube import VirtualTube


class InProcessPort:
    """Port of an instrument in this process."""

    def __init__(self, instrument: SerialInstrument) -> None:
        self._instrument, self._answers = instrument, b""
        self._ready_s = 0.0
        self._turn = threading.RLock()
        self._faults = Faults()
        self._shown = instrument

    @property
    def faults(self) -> Faults:
        """Faults of the instrument; assign to inject faults."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        with self._turn:
            self.advance()
            if faults.disobedient != self._faults.disobedient:
                # Its outputs stay as they are now, whatever it answers.
                self._shown = (
                    copy.deepcopy(self._instrument) if faults.disobedient else self._instrument
                )
            if faults.power_cycles > self._faults.power_cycles:
                self._instrument.power_cycle()
            if faults.panel != self._faults.panel:
                enter_at_panel(self._instrument, faults.panel)
            self._faults = faults

    def send(self, data: bytes) -> None:
        """Send bytes."""
        with self._turn:
            self.advance()
            answers = [] if self.faults.silent else self._instrument.receive(data)
            self._answers += b"".join(self.faults.arrives(answer) for _, answer in answers)
            making_s = max((seconds for seconds, _ in answers), default=0.0)
            if making_s > 2.5e-3:  # Commands that take less time are answered at once, s
                self._ready_s = time.monotonic() + making_s

    def receive(self, timeout_s: float) -> bytes:
        """Return the received bytes; waits for the time-out without any."""
        if (left_s := self._ready_s - time.monotonic()) > 0.0:
            time.sleep(min(left_s, timeout_s))
            if left_s > timeout_s:
                return b""
        with self._turn:
            answers, self._answers = self._answers, b""
        if not answers:
            time.sleep(timeout_s)
        return answers

    def advance(self) -> None:
        """Advance the instrument's physics to the present time."""
        with self._turn:
            if not self._faults.disobedient:
                self._instrument.advance(time.monotonic(), self._faults)

    def far_end(self) -> Any:
        """The instrument at the far end as it is now, whatever adapter stands before it."""
        self.advance()
        return getattr(self._shown, "instrument", self._shown)

    def reopen(self, path: str | None = None) -> None:
        """Nothing to open: the instrument is in this process."""

    def fileno(self) -> int:
        """No descriptor: there is no file."""
        return -1

    def close(self) -> None:
        """Nothing to close."""


class InProcessInstruments:
    """The serial instruments of a bench in this process, by default gate and supply."""

    def __init__(self, wires: InstrumentConfig | None = None, *, time_scale: float = 1.0) -> None:
        connections = (wires or InstrumentConfig()).instruments
        self.ports: dict[Role, InProcessPort] = {
            connection.role: InProcessPort(
                virtual_model(connection.model).make(connection.address, time_scale)
            )
            for connection in connections
        }

    @property
    def gate_port(self) -> InProcessPort:
        """Port of the gate generator."""
        return self.ports["gate"]

    @property
    def supply_port(self) -> InProcessPort:
        """Port of the supply, or of the adapter before it."""
        return self.ports["supply"]

    def outputs(self) -> Outputs:
        """Return the present inputs of the tube."""
        light, wheel = self.ports.get("light-source"), self.ports.get("filter-wheel")
        return Outputs(
            mcp_v=self.supply_port.far_end().output_v,
            **vars(self.gate_port.far_end().gate()),
            lamp_a=None if light is None else light.far_end().current_a,
            filter_position=None if wheel is None else wheel.far_end().position,
            has_wheel=wheel is not None,
            temperature_c=TEMPERATURE_C if "thermometer" in self.ports else None,
        )


POLL_S = 0.05  # Longest wait for a frame between two calls of `while_waiting`, s


class InProcessCamera:
    """Camera with the driver's interface and the frames of the virtual camera, exposed to
    `outputs`.
    """

    identifier = "in-process"

    def __init__(self, folder: Path, outputs: Callable[[], Outputs]) -> None:
        self._tube = VirtualTube(folder, outputs)
        sensor = self._tube.sensor
        field_rate_hz = float(sensor.video.field_rate_hz)
        self._number = 0
        self._turn = threading.Lock()
        self._settings = CameraSettings(
            rows=sensor.ccd.rows,
            columns=sensor.ccd.columns,
            pixel_format="Mono8" if sensor.video.bit_depth <= 8 else "Mono16",
            exposure_s=round(1e6 / field_rate_hz) * 1e-6,
            gain_db=0.0,
            frame_rate_hz=field_rate_hz / (2 if sensor.video.interlaced else 1),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set the settings that are not None and return all; size and pixel format are fixed by the
        sensor.
        """
        stated = {
            item.name: value
            for item in fields(settings)
            if (value := getattr(settings, item.name)) is not None
        }
        for name in ("rows", "columns", "pixel_format"):
            fixed_value = getattr(self._settings, name)
            if stated.get(name, fixed_value) != fixed_value:
                raise BadInput(
                    f"{name} of the in-process camera must be {fixed_value}, got {stated[name]}"
                )
        self._settings = replace(self._settings, **stated)
        return self._settings

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> "InProcessCapture":
        """Return a capture of `frames` frames after `discard` discarded ones."""
        return InProcessCapture(self, frames=frames, discard=discard, while_waiting=while_waiting)

    def begin_exposure(self) -> Future[Frame]:
        """Start to expose a frame after the previous one, in a thread that no end waits for."""
        drawing: Future[Frame] = Future()
        threading.Thread(target=self._draw, args=(drawing,), daemon=True).start()
        return drawing

    def _draw(self, drawing: Future[Frame]) -> None:
        try:
            with self._turn:
                drawing.set_result(self._expose())
        except BaseException as error:
            drawing.set_exception(error)

    def _expose(self) -> Frame:
        self._number += 1
        scene = self._tube.scene(
            exposure_s=self._settings.exposure_s or 0.0, gain_db=self._settings.gain_db or 0.0
        )
        deep = self._settings.pixel_format != "Mono8"
        pixels = self._tube.expose(scene).astype(np.uint16 if deep else np.uint8, copy=False)
        return Frame(pixels=pixels, number=self._number, time_s=time.time())


class InProcessCapture:
    """A capture that loses nothing."""

    lost_frames = 0
    losses = ()

    def __init__(
        self,
        camera: InProcessCamera,
        *,
        frames: int,
        discard: int,
        while_waiting: Callable[[], None],
    ) -> None:
        self._camera, self._frames, self._discard = camera, frames, discard
        self._while_waiting = while_waiting

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def __iter__(self) -> Iterator[Frame]:
        for index in range(self._discard + self._frames):
            self._while_waiting()
            drawing = self._camera.begin_exposure()
            while not wait([drawing], POLL_S).done:
                self._while_waiting()
            frame = drawing.result()
            if index >= self._discard:
                yield frame
