"""Frames from the mapped buffers of a V4L2 camera."""

import errno
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from numpy.typing import NDArray

from drivers.cameras.frame_assembly import POLL_S, FrameCapture, IncompleteFrame, RunningNumbers
from drivers.cameras.v4l2 import structures
from drivers.cameras.v4l2.device import Device, MappedBuffer, query_device
from drivers.cameras.v4l2.fields import (
    ALTERNATE,
    BOTTOM,
    TOP,
    Field,
    FieldPairs,
    field_order,
    older_field,
)
from drivers.cameras.v4l2.pixels import picture_of
from drivers.cameras.v4l2.structures import (
    BUFFER_FAULTY,
    CAPTURE,
    MEMORY_MAPPED,
    Buffer,
    BufferRequest,
    Request,
)
from drivers.errors import CameraError
from labdata import BadInput, Frame

BUFFERS = 8
MOST_BUFFERS = 32  # VIDEO_MAX_FRAME
MOST_BYTES = 1 << 30

T = TypeVar("T")


class V4l2Capture(FrameCapture):
    """Complete frames of an open device in one image format and the kernel's bits of its video
    standards.

    `patience_s` is the longest wait for a frame, s, and `start_s` the additional one for the first.
    """

    def __init__(
        self,
        device: Device,
        *,
        form: Any,
        standard: int,
        patience_s: float,
        start_s: float,
        frames: int,
        discard: int,
        while_waiting: Callable[[], None],
        identifier: str,
    ) -> None:
        super().__init__(
            frames=frames,
            discard=discard,
            while_waiting=while_waiting,
            identifier=identifier,
            patience_s=patience_s,
        )
        self._device, self._picture, self._standard = device, picture_of(form), standard
        self._start_s = start_s
        self._memory: list[MappedBuffer] = []
        self._numbers = RunningNumbers(1 << 32)
        is_alternate = form.of.pix.field == ALTERNATE
        self._pairs = (
            FieldPairs(older_field(standard), lambda: self._take_buffer(self._as_field))
            if is_alternate
            else None
        )

    def _start(self) -> None:
        for index in range(self._request_buffers()):
            self._memory.append(self._map_buffer(index))
            self._query(structures.QUEUE_BUFFER, _buffer(index), f"must take its buffer {index}")
        self._query(structures.START, structures.START.structure(CAPTURE), "must start")

    def _stop(self) -> None:
        """Stop the camera and release its buffers; errors of a disconnected device are ignored."""
        with suppress(OSError):
            self._device.ask(structures.STOP, structures.STOP.structure(CAPTURE))
        for memory in self._memory:
            memory.close()
        self._memory.clear()
        with suppress(OSError):
            self._device.ask(
                structures.REQUEST_BUFFERS, BufferRequest(type=CAPTURE, memory=MEMORY_MAPPED)
            )

    def _next_frame(self) -> Frame | IncompleteFrame:
        return self._take_buffer(self._as_frame) if self._pairs is None else self._pairs.frame()

    def _as_frame(self, buffer: Any, pixels: NDArray, number: int) -> Frame:
        order = field_order(buffer.field, self._standard)
        return Frame(pixels=pixels, number=number, time_s=_time_s(buffer), field_order=order)

    def _as_field(self, buffer: Any, pixels: NDArray, number: int) -> Field:
        if buffer.field not in (TOP, BOTTOM):
            raise BadInput(f"a buffer must say which field it holds, got {buffer.field}")
        return Field(pixels=pixels, parity=buffer.field, number=number, time_s=_time_s(buffer))

    def _take_buffer(self, made: Callable[[Any, NDArray, int], T]) -> T | IncompleteFrame:
        """Copy the next image out of its buffer, convert it, and return the buffer to the
        device.
        """
        buffer = self._next_buffer()
        if not buffer.index < len(self._memory):
            raise CameraError(
                f"camera {self._identifier} must fill one of {len(self._memory)} buffers, got "
                f"number {buffer.index}"
            )
        number = self._numbers.running(buffer.sequence)
        try:
            if fault := self._fault_of(buffer):
                return IncompleteFrame(number=number, fault=fault)
            data = self._memory[buffer.index].copy(self._picture.size_bytes)
            return made(buffer, self._picture.grey(data), number)
        except BadInput as error:
            return IncompleteFrame(number=number, fault=str(error))
        finally:
            self._give_back(buffer.index)

    def _fault_of(self, buffer: Any) -> str:
        if buffer.flags & BUFFER_FAULTY:
            return "marked as spoiled by its driver"
        if buffer.bytesused < self._picture.size_bytes:
            return f"{buffer.bytesused} bytes instead of {self._picture.size_bytes}"
        return ""

    def _next_buffer(self) -> Any:
        """Wait for a filled buffer; an unplugged device raises at once."""
        patience_s = self._patience_s + self._start_s
        until_s = time.monotonic() + patience_s
        while True:
            buffer = _buffer()
            try:
                self._device.ask(structures.TAKE_BUFFER, buffer)
                self._start_s = 0.0
                return buffer
            except OSError as error:
                if error.errno not in (errno.EAGAIN, errno.EINTR):
                    raise self._loss_error(error) from None
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                raise CameraError(
                    f"camera {self._identifier} has sent no frame for {patience_s:.1f} s"
                )
            self._device.wait(min(left_s, POLL_S))
            self._while_waiting()

    def _request_buffers(self) -> int:
        wanted = BufferRequest(count=BUFFERS, type=CAPTURE, memory=MEMORY_MAPPED)
        self._query(structures.REQUEST_BUFFERS, wanted, "must lend buffers")
        if not 2 <= wanted.count <= MOST_BUFFERS:
            raise CameraError(
                f"camera {self._identifier} must lend 2 to {MOST_BUFFERS} buffers, got "
                f"{wanted.count}"
            )
        return wanted.count

    def _map_buffer(self, index: int) -> MappedBuffer:
        buffer = _buffer(index)
        self._query(structures.QUERY_BUFFER, buffer, f"must show its buffer {index}")
        if not self._picture.size_bytes <= buffer.length <= MOST_BYTES:
            raise CameraError(
                f"a buffer of camera {self._identifier} must hold a picture of "
                f"{self._picture.size_bytes} bytes, got {buffer.length}"
            )
        try:
            return self._device.map(buffer.length, buffer.offset)
        except (OSError, ValueError) as error:
            raise CameraError(
                f"a buffer of camera {self._identifier} must be mapped, got: {error}"
            ) from None

    def _query(self, request: Request, structure: Any, rule: str) -> None:
        query_device(self._device, request, structure, f"camera {self._identifier} {rule}")

    def _give_back(self, index: int) -> None:
        """Return a buffer to a running camera."""
        try:
            self._device.ask(structures.QUEUE_BUFFER, _buffer(index))
        except OSError as error:
            raise self._loss_error(error) from None

    def _loss_error(self, error: OSError) -> CameraError:
        return CameraError(f"camera {self._identifier} has gone or failed ({error.strerror})")


def _buffer(index: int = 0) -> Any:
    return Buffer(index=index, type=CAPTURE, memory=MEMORY_MAPPED)


def _time_s(buffer: Any) -> float:
    """Return the kernel's time stamp of a buffer, s."""
    return buffer.timestamp.seconds + buffer.timestamp.microseconds * 1e-6
