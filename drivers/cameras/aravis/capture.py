"""A running capture of an Aravis camera: buffers become frames that are whole, or are counted lost."""

import ctypes
import math
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.aravis.gige_control import BlockNumbers
from drivers.cameras.aravis.library import BUFFER_FAULTS, BUFFER_SUCCESS, Aravis
from drivers.cameras.aravis.packed_pixels import PACKINGS
from drivers.cameras.frame_assembly import FrameAssembler, IncompleteFrame
from drivers.interface import CameraError
from labdata.capture import CameraSettings, Frame, LostFrames

UNPACKED = {"Mono8": "u1", "Mono10": "<u2", "Mono12": "<u2", "Mono14": "<u2", "Mono16": "<u2"}
PIXELS = (*UNPACKED, *PACKINGS)
SOCKET_BUFFER_BYTES = 8 << 20  # with the default one, every frame loses its tail
LEAST_BUFFERS = 16
MOST_BUFFER_BYTES = 256 << 20
# A sender or receiver that a busy machine holds up for a tenth of a second (the default) would lose its frame.
LATE_PACKET_S = 0.4
LATE_READER_S = 2.0  # so long a busy machine may keep a reader from its frames
_POLL_S = 0.05
SUSPICION_S = 0.2
"""Silence after which a camera is asked whether it is there, s."""


class Owner(Protocol):
    """The camera that a capture belongs to."""

    @property
    def identifier(self) -> str: ...

    @property
    def is_dead(self) -> bool: ...

    @property
    def is_gige(self) -> bool: ...

    def require_alive(self) -> None: ...

    def while_alive(self, act: Callable[[], None]) -> None: ...

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
    resend
        Whether packets that did not come are asked for again (GigE Vision).
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
        resend: bool,
        owner: Owner,
    ) -> None:
        if settings.pixel_format not in PIXELS:
            raise CameraError(
                f"the pixel format of camera {owner.identifier} must be one of {', '.join(PIXELS)}, "
                f"got {settings.pixel_format}"
            )
        self._library, self._camera, self._owner = library, camera, owner
        self._patience_s, self._resend = patience_s, resend
        self._format, self._frame_rate_hz = settings.pixel_format, settings.frame_rate_hz
        self._shape = (settings.rows or 0, settings.columns or 0)
        self._stream: int | None = None
        self._numbers = BlockNumbers()
        self._whole = FrameAssembler(wanted=frames, discard=discard, identifier=owner.identifier)
        self.lost_packets = 0
        """Packets that did not come in time, once the capture has ended (GigE Vision)."""
        self.resent_packets = 0
        """Packets that came because they were asked for again."""

    @property
    def lost_frames(self) -> int:
        """Frames numbered by the camera since the first whole one and not whole."""
        return self._whole.lost

    @property
    def losses(self) -> tuple[LostFrames, ...]:
        """The same frames with their numbers and why they are not whole."""
        return self._whole.losses

    def __enter__(self) -> Self:
        self._owner.while_alive(self._start)
        return self

    def _start(self) -> None:
        # A stream of its own, on a port of its own: no frame sent before can arrive in it.
        self._stream = stream = self._library.call("arv_camera_create_stream", self._camera, None, None)
        if self._owner.is_gige:
            self._library.fix_socket_buffer(stream, SOCKET_BUFFER_BYTES)
            self._library.wait_for_packets(stream, LATE_PACKET_S)
            self._library.ask_for_lost_packets(stream, self._resend)
        payload = self._library.call("arv_camera_get_payload", self._camera)
        for _ in range(self._buffers(payload)):
            self._give_back(self._library.plain("arv_buffer_new", payload, None))
        self._library.call("arv_camera_start_acquisition", self._camera)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        stream, self._stream = self._stream, None
        try:
            if not self._owner.is_dead:
                self._library.call("arv_camera_stop_acquisition", self._camera)
        finally:
            if stream is not None:
                if self._owner.is_gige:
                    self.resent_packets, self.lost_packets = self._library.packets(stream)
                self._owner.release(stream)

    def __iter__(self) -> Iterator[Frame]:
        """Hand out whole frames; a camera that falls silent or sends only broken ones is a `CameraError`."""
        return self._whole.of(self._frame)

    def _frame(self) -> Frame | IncompleteFrame:
        """Copy the next frame out of its buffer and give the buffer back."""
        buffer = self._next_buffer()
        plain = self._library.plain
        try:
            number = self._numbers.running(plain("arv_buffer_get_frame_id", buffer))
            if fault := self._fault_of(buffer):
                return IncompleteFrame(number=number, fault=fault)
            time_s = plain("arv_buffer_get_timestamp", buffer) * 1e-9
            return Frame(pixels=self._pixels(buffer), number=number, time_s=time_s)
        finally:
            self._give_back(buffer)

    def _fault_of(self, buffer: int) -> str:
        plain = self._library.plain
        status = plain("arv_buffer_get_status", buffer)
        if status != BUFFER_SUCCESS:
            return BUFFER_FAULTS.get(status, f"status {status}")
        size = (plain("arv_buffer_get_image_height", buffer), plain("arv_buffer_get_image_width", buffer))
        return f"{size} pixels instead of {self._shape}" if size != self._shape else ""

    def _buffers(self, payload: int) -> int:
        """Return how many buffers the stream needs: each frame that waits for a packet or for its reader keeps one."""
        waiting = math.ceil((self._frame_rate_hz or 0.0) * (LATE_PACKET_S + LATE_READER_S))
        return max(LEAST_BUFFERS, min(LEAST_BUFFERS + waiting, MOST_BUFFER_BYTES // max(1, payload)))

    def _next_buffer(self) -> int:
        """Wait for a buffer; the camera's death is noticed by its closed port, else by its silence."""
        began_s = time.monotonic()
        while True:
            buffer = self._library.plain("arv_stream_timeout_pop_buffer", self._stream, int(_POLL_S * 1e6))
            if buffer:
                return buffer
            silent_s = time.monotonic() - began_s
            if silent_s > SUSPICION_S:
                self._owner.require_alive()
            if silent_s > self._patience_s:
                raise self._owner.died(f"has sent no frame for {silent_s:.1f} s")

    def _give_back(self, buffer: int) -> None:
        self._library.plain("arv_stream_push_buffer", self._stream, buffer)

    def _pixels(self, buffer: int) -> NDArray[Any]:
        pixels = self._shape[0] * self._shape[1]
        packing = PACKINGS.get(self._format)
        kind = np.dtype(UNPACKED.get(self._format, "u1"))
        expected = packing.size_bytes(pixels) if packing else pixels * kind.itemsize
        size = ctypes.c_size_t()
        address = self._library.plain("arv_buffer_get_data", buffer, ctypes.byref(size))
        if size.value < expected:
            raise CameraError(f"a frame of {self._shape} pixels must hold {expected} bytes, got {size.value}")
        raw = np.frombuffer(ctypes.string_at(address, expected), kind)
        if packing:
            return packing.unpacked(raw, pixels).reshape(self._shape)
        return raw.reshape(self._shape).astype(kind.newbyteorder("="), copy=False)
