"""A running capture of a V4L2 camera: mapped buffers become frames that are whole, or are counted lost."""

import errno
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import TracebackType
from typing import Self, TypeVar

from numpy.typing import NDArray

from drivers.cameras.frame_assembly import FrameAssembler, IncompleteFrame
from drivers.cameras.v4l2 import requests
from drivers.cameras.v4l2.device import Device, Mapped, query_device
from drivers.cameras.v4l2.field_pairs import Field, FieldPairs
from drivers.cameras.v4l2.fields import BOTTOM, TOP, field_order, older_field
from drivers.cameras.v4l2.pixels import BufferImage
from drivers.cameras.v4l2.structures import BUFFER_FAULTY, CAPTURE, MEMORY_MAPPED, Buffer, BufferRequest
from drivers.interface import CameraError
from labdata.capture import Frame, LostFrames
from labdata.errors import BadInput

BUFFERS = 8
MOST_BUFFERS = 32  # VIDEO_MAX_FRAME
MOST_BYTES = 1 << 30

T = TypeVar("T")


class V4l2Capture:
    """A capture that runs within its `with` block; iterate it for whole frames.

    Parameters
    ----------
    device
        The open device.
    picture
        How a picture lies in a buffer.
    standard
        Video standards of the input, as the kernel's bits.
    alternate
        Whether a picture is one field, and its frame's other one comes in a buffer of its own.
    frames
        Whole frames to hand out.
    discard
        Whole frames to throw away first: those that may have been exposed under earlier conditions.
    patience_s
        Longest wait for a frame, s.
    start_s
        What the first frame may take besides, s.
    identifier
        The camera's name, for sentences.
    """

    def __init__(
        self,
        device: Device,
        *,
        picture: BufferImage,
        standard: int,
        alternate: bool,
        frames: int,
        discard: int,
        patience_s: float,
        start_s: float,
        identifier: str,
    ) -> None:
        self._device, self._picture, self._standard = device, picture, standard
        self._alternate = alternate
        self._patience_s, self._start_s, self._identifier = patience_s, start_s, identifier
        self._memory: list[Mapped] = []
        self._numbers = RunningNumbers()
        self._whole = FrameAssembler(wanted=frames, discard=discard, identifier=identifier)

    @property
    def lost_frames(self) -> int:
        """Frames numbered by the driver since the first whole one and not whole."""
        return self._whole.lost

    @property
    def losses(self) -> tuple[LostFrames, ...]:
        """The same frames with their numbers and why they are not whole."""
        return self._whole.losses

    def __enter__(self) -> Self:
        try:
            for index in range(self._request_buffers()):
                self._memory.append(self._mapped(index))
                self._queue(index)
            rule = f"camera {self._identifier} must start"
            query_device(self._device, requests.START, requests.START.structure(CAPTURE), rule)
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def __iter__(self) -> Iterator[Frame]:
        """Hand out whole frames; a camera that falls silent, goes or sends only broken ones is a `CameraError`."""
        if self._alternate:
            return self._whole.of(FieldPairs(older_field(self._standard), self._field).frame)
        return self._whole.of(lambda: self._taken(self._as_frame))

    def _field(self) -> Field | IncompleteFrame:
        return self._taken(self._as_field)

    def _as_frame(self, buffer: Buffer, pixels: NDArray, number: int) -> Frame:
        order = field_order(buffer.field, self._standard)
        return Frame(pixels=pixels, number=number, time_s=_time_s(buffer), field_order=order)

    def _as_field(self, buffer: Buffer, pixels: NDArray, number: int) -> Field:
        if buffer.field not in (TOP, BOTTOM):
            raise BadInput(f"a buffer must say which field it holds, got {buffer.field}")
        return Field(pixels=pixels, parity=buffer.field, number=number, time_s=_time_s(buffer))

    def _taken(self, made: Callable[[Buffer, NDArray, int], T]) -> T | IncompleteFrame:
        """Copy the next picture out of its buffer, make of it what it is, and give the buffer back."""
        buffer = self._next_buffer()
        if not buffer.index < len(self._memory):
            raise CameraError(
                f"camera {self._identifier} must fill one of {len(self._memory)} buffers, got number {buffer.index}"
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

    def _fault_of(self, buffer: Buffer) -> str:
        if buffer.flags & BUFFER_FAULTY:
            return "marked as spoiled by its driver"
        if buffer.bytesused < self._picture.size_bytes:
            return f"{buffer.bytesused} bytes instead of {self._picture.size_bytes}"
        return ""

    def _next_buffer(self) -> Buffer:
        """Wait for a filled buffer; a device that is unplugged says so at once."""
        patience_s = self._patience_s + self._start_s
        until_s = time.monotonic() + patience_s
        while True:
            buffer = Buffer(type=CAPTURE, memory=MEMORY_MAPPED)
            try:
                self._device.ask(requests.TAKE_BUFFER, buffer)
                self._start_s = 0.0
                return buffer
            except OSError as error:
                if error.errno not in (errno.EAGAIN, errno.EINTR):
                    raise self._gone(error) from None
            left_s = until_s - time.monotonic()
            if left_s <= 0 or not self._device.wait(left_s):
                raise CameraError(f"camera {self._identifier} has sent no frame for {patience_s:.1f} s")

    def _request_buffers(self) -> int:
        wanted = BufferRequest(count=BUFFERS, type=CAPTURE, memory=MEMORY_MAPPED)
        query_device(self._device, requests.REQUEST_BUFFERS, wanted, f"camera {self._identifier} must lend buffers")
        if not 2 <= wanted.count <= MOST_BUFFERS:
            raise CameraError(f"camera {self._identifier} must lend 2 to {MOST_BUFFERS} buffers, got {wanted.count}")
        return wanted.count

    def _mapped(self, index: int) -> Mapped:
        buffer = Buffer(index=index, type=CAPTURE, memory=MEMORY_MAPPED)
        query_device(
            self._device, requests.QUERY_BUFFER, buffer, f"camera {self._identifier} must show its buffer {index}"
        )
        if not self._picture.size_bytes <= buffer.length <= MOST_BYTES:
            raise CameraError(
                f"a buffer of camera {self._identifier} must hold a picture of {self._picture.size_bytes} bytes, "
                f"got {buffer.length}"
            )
        try:
            return self._device.map(buffer.length, buffer.offset)
        except (OSError, ValueError) as error:
            raise CameraError(f"a buffer of camera {self._identifier} must be mapped, got: {error}") from None

    def _queue(self, index: int) -> None:
        buffer = Buffer(index=index, type=CAPTURE, memory=MEMORY_MAPPED)
        query_device(
            self._device, requests.QUEUE_BUFFER, buffer, f"camera {self._identifier} must take its buffer {index}"
        )

    def _give_back(self, index: int) -> None:
        """Give a buffer back to a camera that runs; one that does not take it does not run any more."""
        try:
            self._device.ask(requests.QUEUE_BUFFER, Buffer(index=index, type=CAPTURE, memory=MEMORY_MAPPED))
        except OSError as error:
            raise self._gone(error) from None

    def _gone(self, error: OSError) -> CameraError:
        return CameraError(f"camera {self._identifier} has gone or failed ({error.strerror})")

    def _stop(self) -> None:
        """Stop the camera and give its buffers back; a device that is gone has nothing left to stop."""
        with suppress(OSError):
            self._device.ask(requests.STOP, requests.STOP.structure(CAPTURE))
        for memory in self._memory:
            memory.close()
        self._memory.clear()
        with suppress(OSError):
            self._device.ask(requests.REQUEST_BUFFERS, BufferRequest(type=CAPTURE, memory=MEMORY_MAPPED))


def _time_s(buffer: Buffer) -> float:
    """When the kernel stamped a buffer, s of its clock."""
    return buffer.timestamp.seconds + buffer.timestamp.microseconds * 1e-6


class RunningNumbers:
    """Running numbers from the driver's 32-bit sequence, which starts again at 0."""

    _CYCLE = 1 << 32

    def __init__(self) -> None:
        self._sequence: int | None = None
        self._number = 0

    def running(self, sequence: int) -> int:
        """Return the running number of a sequence number; the first keeps its own, a step back counts as one."""
        if self._sequence is None:
            self._number = sequence
        else:
            step = (sequence - self._sequence) % self._CYCLE
            self._number += step - self._CYCLE if step > self._CYCLE // 2 else step
        self._sequence = sequence
        return self._number
