"""A running capture of an Aravis camera: buffers become frames that are whole, or are counted lost."""

import ctypes
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from drivers.aravis_library import BUFFER_FAULTS, BUFFER_SUCCESS, Aravis
from drivers.gige import BlockNumbers
from drivers.interface import CameraError
from labdata.capture import CameraSettings, Frame, LostFrames, losses_before

PIXELS = {"Mono8": "u1", "Mono10": "<u2", "Mono12": "<u2", "Mono14": "<u2", "Mono16": "<u2"}
SOCKET_BUFFER_BYTES = 8 << 20  # with the default one, every frame loses its tail
BUFFERS = 16
# A sender or receiver that a busy machine holds up for a tenth of a second (the default) would lose its frame.
LATE_PACKET_S = 0.4
_POLL_S = 0.05
_SUSPICION_S = 0.2


class Owner(Protocol):
    """The camera that a capture belongs to."""

    @property
    def identifier(self) -> str: ...

    @property
    def is_dead(self) -> bool: ...

    @property
    def is_gige(self) -> bool: ...

    def require_alive(self) -> None: ...

    def died(self, how: str) -> CameraError: ...

    def release(self, thing: int) -> None: ...


class AravisCapture:
    """A capture that runs within its `with` block; iterate it for whole frames.

    Parameters
    ----------
    library
        The Aravis library.
    camera
        Handle of the open camera.
    settings
        Settings in force.
    frames
        Whole frames to hand out.
    discard
        Whole frames to throw away first: those that may have been exposed under earlier conditions.
    patience_s
        Longest wait for a frame, s.
    owner
        The camera's driver.
    """

    def __init__(
        self,
        library: Aravis,
        camera: int,
        *,
        settings: CameraSettings,
        frames: int,
        discard: int,
        patience_s: float,
        owner: Owner,
    ) -> None:
        if settings.pixel_format not in PIXELS:
            raise CameraError(
                f"the pixel format of camera {owner.identifier} must be one of {', '.join(PIXELS)}, "
                f"got {settings.pixel_format}"
            )
        self._library, self._camera, self._owner = library, camera, owner
        self._wanted, self._discard, self._patience_s = frames, discard, patience_s
        self._type = np.dtype(PIXELS[settings.pixel_format])
        self._shape = (settings.rows or 0, settings.columns or 0)
        self._stream: int | None = None
        self._numbers = BlockNumbers()
        self._expected: int | None = None
        self._faults: dict[int, str] = {}
        self.losses: tuple[LostFrames, ...] = ()

    @property
    def lost_frames(self) -> int:
        """Frames numbered by the camera since the first whole one and not whole."""
        return sum(map(len, self.losses))

    def __enter__(self) -> Self:
        # A stream of its own, on a port of its own: no frame sent before can arrive in it.
        self._stream = stream = self._library.call("arv_camera_create_stream", self._camera, None, None)
        if self._owner.is_gige:
            self._library.fix_socket_buffer(stream, SOCKET_BUFFER_BYTES)
            self._library.wait_for_packets(stream, LATE_PACKET_S)
        payload = self._library.call("arv_camera_get_payload", self._camera)
        for _ in range(BUFFERS):
            self._give_back(self._library.plain("arv_buffer_new", payload, None))
        self._library.call("arv_camera_start_acquisition", self._camera)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        stream, self._stream = self._stream, None
        try:
            if not self._owner.is_dead:
                self._library.call("arv_camera_stop_acquisition", self._camera)
        finally:
            if stream is not None:
                self._owner.release(stream)

    def __iter__(self) -> Iterator[Frame]:
        """Hand out whole frames; a camera that falls silent or sends only broken ones is a `CameraError`."""
        whole = broken = 0
        while whole < self._discard + self._wanted:
            frame = self._frame()
            if frame is None:
                broken += 1
                self._require_some_whole(whole, broken)
                continue
            self._count_lost(frame.number, handed_out=whole >= self._discard)
            whole += 1
            if whole > self._discard:
                yield frame

    def _frame(self) -> Frame | None:
        """Copy the next frame out of its buffer and give the buffer back; None for a broken frame."""
        buffer = self._next_buffer()
        plain = self._library.plain
        try:
            number = self._numbers.running(plain("arv_buffer_get_frame_id", buffer))
            if fault := self._fault_of(buffer, late=self._expected is not None and number < self._expected):
                self._faults[number] = fault
                return None
            time_s = plain("arv_buffer_get_timestamp", buffer) * 1e-9
            return Frame(pixels=self._pixels(buffer), number=number, time_s=time_s)
        finally:
            self._give_back(buffer)

    def _fault_of(self, buffer: int, *, late: bool) -> str:
        plain = self._library.plain
        status = plain("arv_buffer_get_status", buffer)
        if status != BUFFER_SUCCESS:
            return BUFFER_FAULTS.get(status, f"status {status}")
        size = (plain("arv_buffer_get_image_height", buffer), plain("arv_buffer_get_image_width", buffer))
        if size != self._shape:
            return f"{size} pixels instead of {self._shape}"
        return "too late" if late else ""

    def _next_buffer(self) -> int:
        """Wait for a buffer; the camera's death is noticed by its closed port, else by its silence."""
        began_s = time.monotonic()
        while True:
            buffer = self._library.plain("arv_stream_timeout_pop_buffer", self._stream, int(_POLL_S * 1e6))
            if buffer:
                return buffer
            silent_s = time.monotonic() - began_s
            if silent_s > _SUSPICION_S:
                self._owner.require_alive()
            if silent_s > self._patience_s:
                raise self._owner.died(f"has sent no frame for {silent_s:.1f} s")

    def _give_back(self, buffer: int) -> None:
        self._library.plain("arv_stream_push_buffer", self._stream, buffer)

    def _count_lost(self, number: int, *, handed_out: bool) -> None:
        """Count the numbers that are missing since the last whole frame.

        Frames broken before the first whole one are not of this run: the library gives its socket the buffer asked
        for only when a frame is already coming, so that a busy machine receives the very first one without it.
        """
        if handed_out and self._expected is not None:
            self.losses += losses_before(number, expected=self._expected, faults=self._faults)
        self._faults.clear()
        self._expected = number + 1

    def _require_some_whole(self, whole: int, broken: int) -> None:
        if broken > 20 + self._wanted:
            raise CameraError(
                f"camera {self._owner.identifier} must send whole frames, got {broken} broken ones "
                f"(the last: {list(self._faults.values())[-1]}) beside {whole} whole"
            )

    def _pixels(self, buffer: int) -> NDArray[Any]:
        size = ctypes.c_size_t()
        address = self._library.plain("arv_buffer_get_data", buffer, ctypes.byref(size))
        expected = self._shape[0] * self._shape[1] * self._type.itemsize
        if size.value < expected:
            raise CameraError(f"a frame of {self._shape} pixels must hold {expected} bytes, got {size.value}")
        raw = np.frombuffer(ctypes.string_at(address, expected), self._type).reshape(self._shape)
        return raw.astype(self._type.newbyteorder("="), copy=False)
