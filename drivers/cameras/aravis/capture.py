"""Frames from the buffers of an Aravis camera.

Sources of the packed pixel formats: GenICam Pixel Format Naming Convention 2.4, section 6.2
(Mono10p, Mono12p: lower bits first, without gaps); GigE Vision 1.2, section 26.1 (Mono10Packed,
Mono12Packed: two pixels in three bytes, the lower bits of both in the middle one).
"""

import ctypes
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.aravis.connection import BUFFER_FAULTS, BUFFER_SUCCESS, SUSPICION_S, Connection
from drivers.cameras.frame_assembly import POLL_S, FrameCapture, IncompleteFrame, RunningNumbers
from drivers.errors import CameraError
from labdata.capture import CameraSettings, Frame

_Bytes = NDArray[np.uint16]


def _mono10p(byte: _Bytes) -> tuple[_Bytes, ...]:
    return (
        byte[0] | (byte[1] & 0x03) << 8,
        byte[1] >> 2 | (byte[2] & 0x0F) << 6,
        byte[2] >> 4 | (byte[3] & 0x3F) << 4,
        byte[3] >> 6 | byte[4] << 2,
    )


def _mono12p(byte: _Bytes) -> tuple[_Bytes, ...]:
    return byte[0] | (byte[1] & 0x0F) << 8, byte[1] >> 4 | byte[2] << 4


def _mono10_packed(byte: _Bytes) -> tuple[_Bytes, ...]:
    return byte[0] << 2 | byte[1] & 0x03, byte[2] << 2 | byte[1] >> 4 & 0x03


def _mono12_packed(byte: _Bytes) -> tuple[_Bytes, ...]:
    return byte[0] << 4 | byte[1] & 0x0F, byte[2] << 4 | byte[1] >> 4


@dataclass(frozen=True, kw_only=True)
class Packing:
    """Packing of pixels into bytes."""

    pixels: int  #: Pixels of one group, and its bytes
    bytes: int  #: Pixels of one group, and its bytes
    #: Converts the bytes of all groups, shape (byte, group), to the pixels, one array each
    split: Callable[[_Bytes], tuple[_Bytes, ...]]

    def size_bytes(self, pixels: int) -> int:
        """Return the bytes of a number of pixels."""
        return -(-pixels * self.bytes // self.pixels)

    def unpack(self, packed: NDArray[np.uint8], pixels: int) -> NDArray[np.uint16]:
        """Return the first `pixels` pixels of packed bytes, shape (pixel,), DN."""
        groups = -(-pixels // self.pixels)
        complete = np.zeros(groups * self.bytes, np.uint8)
        available = packed[: self.size_bytes(pixels)]
        complete[: len(available)] = available
        byte = complete.reshape(groups, self.bytes).T.astype(np.uint16)
        return np.stack(self.split(byte), axis=1).reshape(-1)[:pixels]


PACKINGS = {
    "Mono10p": Packing(pixels=4, bytes=5, split=_mono10p),
    "Mono12p": Packing(pixels=2, bytes=3, split=_mono12p),
    "Mono10Packed": Packing(pixels=2, bytes=3, split=_mono10_packed),
    "Mono12Packed": Packing(pixels=2, bytes=3, split=_mono12_packed),
}


UNPACKED = {"Mono8": "u1", "Mono10": "<u2", "Mono12": "<u2", "Mono14": "<u2", "Mono16": "<u2"}
PIXELS = (*UNPACKED, *PACKINGS)
SOCKET_BUFFER_BYTES = 8 << 20  # with the default buffer, every frame loses its last packets
LEAST_BUFFERS = 16
# On a busy machine a delay of 0.1 s (the default) would lose a frame.
LATE_PACKET_S = 0.4
BLOCK_NUMBERS = 65535  # of GigE Vision's 16 bits, 1..65535


class AravisCapture(FrameCapture):
    """Complete frames of an open camera; `patience_s` is the longest wait for one, s."""

    def __init__(
        self,
        connection: Connection,
        *,
        settings: CameraSettings,
        patience_s: float,
        resend: bool,
        frames: int,
        discard: int,
        while_waiting: Callable[[], None],
    ) -> None:
        super().__init__(
            frames=frames,
            discard=discard,
            while_waiting=while_waiting,
            identifier=connection.identifier,
            patience_s=patience_s,
        )
        if settings.pixel_format not in PIXELS:
            raise CameraError(
                f"the pixel format of camera {connection.identifier} must be one of "
                f"{', '.join(PIXELS)}, got {settings.pixel_format}"
            )
        self._connection, self._library = connection, connection.library
        self._resend = resend
        self._format, self._frame_rate_hz = settings.pixel_format, settings.frame_rate_hz
        self._shape = (settings.rows or 0, settings.columns or 0)
        self._stream: int | None = None
        self._numbers = RunningNumbers(BLOCK_NUMBERS)
        # Number of missing packets, after the end of the capture (GigE Vision)
        self.lost_packets = 0
        self.resent_packets = 0  # Number of packets received after a repeated request

    def _start(self) -> None:
        self._connection.while_alive(self._start_stream, self._while_waiting)

    def _stop(self) -> None:
        if self._connection.is_dead:
            self._connection.begin(self._stop_stream)
        else:
            self._connection.while_alive(self._stop_stream, self._while_waiting)

    def _start_stream(self) -> None:
        # A new stream on a new port cannot receive earlier frames.
        self._stream = stream = self._library.call(
            "arv_camera_create_stream", self._connection.camera, None, None
        )
        if self._connection.address is not None:
            self._library.set_up_stream(
                stream,
                buffer_bytes=SOCKET_BUFFER_BYTES,
                longest_s=LATE_PACKET_S,
                resend=self._resend,
            )
        payload = self._library.call("arv_camera_get_payload", self._connection.camera)
        for _ in range(self._buffers(payload)):
            self._give_back(self._library.plain("arv_buffer_new", payload, None))
        self._library.call("arv_camera_start_acquisition", self._connection.camera)

    def _stop_stream(self) -> None:
        stream, self._stream = self._stream, None
        try:
            if not self._connection.is_dead:
                self._library.call("arv_camera_stop_acquisition", self._connection.camera)
        finally:
            if stream is not None:
                if self._connection.address is not None:
                    self.resent_packets, self.lost_packets = self._library.packets(stream)
                self._library.release(stream)

    def _next_frame(self) -> Frame | IncompleteFrame:
        """Copy the next frame out of its buffer and return the buffer to the stream."""
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
        size = (
            plain("arv_buffer_get_image_height", buffer),
            plain("arv_buffer_get_image_width", buffer),
        )
        return f"{size} pixels instead of {self._shape}" if size != self._shape else ""

    def _buffers(self, payload: int) -> int:
        """Return the number of buffers of the stream: one per frame that waits for packets or for
        the reader.
        """
        # longest delay of the reader on a busy machine
        waiting = math.ceil((self._frame_rate_hz or 0.0) * (LATE_PACKET_S + 2.0))
        return max(LEAST_BUFFERS, min(LEAST_BUFFERS + waiting, (256 << 20) // max(1, payload)))

    def _next_buffer(self) -> int:
        """Wait for a buffer; a dead camera is detected by its closed port, or by the missing
        frame.
        """
        began_s = time.monotonic()
        while True:
            buffer = self._library.plain(
                "arv_stream_timeout_pop_buffer", self._stream, int(POLL_S * 1e6)
            )
            if buffer:
                return buffer
            self._while_waiting()
            silent_s = time.monotonic() - began_s
            if silent_s > SUSPICION_S:
                self._connection.require_alive()
                self._while_waiting()
            if silent_s > self._patience_s:
                raise self._connection.mark_dead(f"has sent no frame for {silent_s:.1f} s")

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
            raise CameraError(
                f"a frame of {self._shape} pixels must hold {expected} bytes, got {size.value}"
            )
        raw = np.frombuffer(ctypes.string_at(address, expected), kind)
        if packing:
            return packing.unpack(raw, pixels).reshape(self._shape)
        return raw.reshape(self._shape).astype(kind.newbyteorder("="), copy=False)
