"""A video device at the ioctl boundary: it answers requests as a kernel would, from a script of
what goes wrong.
"""

import errno
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from drivers.cameras.v4l2.fields import PROGRESSIVE
from drivers.cameras.v4l2.structures import (
    BUFFER_FAULTY,
    CAN_CAPTURE,
    CAN_STREAM,
    NEXT_CONTROL,
    Request,
    code_of,
)

ROWS, COLUMNS = 24, 32
SIZES = ((ROWS, COLUMNS), (12, 16))
BYTES = {"GREY": 1.0, "Y16 ": 2.0, "Y10 ": 2.0, "YUYV": 2.0, "UYVY": 2.0, "NV12": 1.5}
PERIOD_S = 1 / 30


@dataclass(frozen=True, kw_only=True)
class Sent:
    """What the device has ready when it is asked for a buffer; an error number is a refusal."""

    sequence: int = 0
    faulty: bool = False
    share: float = 1.0
    field: int | None = None
    error: int = 0
    index: int | None = None


def steadily(first: int = 0) -> Iterator[Sent]:
    """Frames without a fault."""
    return (Sent(sequence=sequence) for sequence in count(first))


@dataclass
class Knob:
    """One control: number, name, type of the kernel's, bounds and value."""

    identifier: int
    name: bytes
    kind: int
    low: int
    high: int
    value: int
    flags: int = 0


def knobs() -> list[Knob]:
    return [
        Knob(0x00980900, b"Brightness", 1, 0, 255, 128),
        Knob(0x00980912, b"Gain, Automatic", 2, 0, 1, 1),
        Knob(0x00980913, b"Gain", 1, 0, 255, 10),
        Knob(0x009A0901, b"Exposure, Auto", 3, 0, 3, 3),
        Knob(0x009A0902, b"Exposure Time, Absolute", 1, 1, 10_000, 166),
    ]


def luma(sequence: int, rows: int = ROWS, columns: int = COLUMNS, deep: bool = False) -> np.ndarray:
    """The picture of one number: no pixel is 0, so that a tail that never came shows."""
    row, column = np.mgrid[:rows, :columns]
    if deep:
        return ((row * 701 + column * 31 + sequence * 113) % 1021 + 1).astype(np.uint16)
    return ((row * 7 + column * 3 + sequence * 11) % 251 + 1).astype(np.uint8)


class FakeMemory:
    def __init__(self, length: int) -> None:
        self.data = np.zeros(length, np.uint8)
        self.is_closed = False

    def copy(self, size_bytes: int) -> np.ndarray:
        return self.data[:size_bytes].copy()

    def close(self) -> None:
        self.is_closed = True


class FakeDevice:
    """The device; `spoil` may change any structure that it answers with."""

    def __init__(
        self,
        script: Callable[[], Iterable[Sent]] = steadily,
        *,
        letters: Iterable[str] = ("GREY", "Y16 ", "YUYV"),
        field: int = PROGRESSIVE,
        standard: int = 0,
        spoil: Callable[[str, Any], None] = lambda name, structure: None,
    ) -> None:
        self.script, self.letters, self.field, self.standard, self.spoil = (
            script,
            tuple(letters),
            field,
            standard,
            spoil,
        )
        self.knobs = knobs()
        self.rows, self.columns, self.code = ROWS, COLUMNS, code_of(self.letters[0])
        self.period = (1, 30)
        self.memory: list[FakeMemory] = []
        self.lent: list[FakeMemory] = []
        self.queued: list[int] = []
        self.streaming: Iterator[Sent] | None = None
        self.is_closed = False
        self.asked: list[str] = []
        self.waits_s: list[float] = []

    def ask(self, request: Request, structure: Any) -> None:
        self.asked.append(request.name)
        answer = getattr(self, f"_{request.name.lower()}", None)
        if answer is None:
            raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")
        answer(structure)
        self.spoil(request.name, structure)

    def map(self, length_bytes: int, offset: int) -> FakeMemory:
        if length_bytes > 1 << 24:
            raise OSError(errno.ENOMEM, "Cannot allocate memory")
        self.lent.append(FakeMemory(length_bytes))
        self.memory.append(self.lent[-1])
        return self.lent[-1]

    def wait(self, timeout_s: float) -> bool:
        self.waits_s.append(timeout_s)
        return True

    def close(self) -> None:
        self.is_closed = True

    @property
    def size_bytes(self) -> int:
        return int(self.rows * self.columns * BYTES[self._letters])

    @property
    def _letters(self) -> str:
        return self.code.to_bytes(4, "little").decode()

    def _querycap(self, it: Any) -> None:
        it.driver, it.card, it.bus_info = b"fake", b"Fake grabber", b"nowhere"
        it.capabilities = CAN_CAPTURE | CAN_STREAM

    def _enum_fmt(self, it: Any) -> None:
        if it.index >= len(self.letters):
            raise OSError(errno.EINVAL, "Invalid argument")
        it.pixelformat = code_of(self.letters[it.index])

    def _enum_framesizes(self, it: Any) -> None:
        if it.index >= len(SIZES):
            raise OSError(errno.EINVAL, "Invalid argument")
        it.type, (it.sizes[1], it.sizes[0]) = 1, SIZES[it.index]

    def _g_fmt(self, it: Any) -> None:
        pix = it.of.pix
        pix.width, pix.height, pix.pixelformat, pix.field = (
            self.columns,
            self.rows,
            self.code,
            self.field,
        )
        pix.bytesperline = int(self.columns * (BYTES[self._letters] // 1))
        pix.sizeimage = self.size_bytes

    def _s_fmt(self, it: Any) -> None:
        pix = it.of.pix
        if pix.pixelformat in map(code_of, self.letters):
            self.code = pix.pixelformat
        self.rows, self.columns = min(
            SIZES, key=lambda size: abs(size[0] - pix.height) + abs(size[1] - pix.width)
        )
        self._g_fmt(it)

    def _g_std(self, it: Any) -> None:
        if not self.standard:
            raise OSError(errno.ENODATA, "No data available")
        it.value = self.standard

    def _g_parm(self, it: Any) -> None:
        it.of.capture.numerator, it.of.capture.denominator = self.period

    def _s_parm(self, it: Any) -> None:
        asked = (it.of.capture.numerator, it.of.capture.denominator)
        self.period = asked if 60 * asked[0] >= asked[1] else (1, 60)

    def _queryctrl(self, it: Any) -> None:
        last = it.id & ~NEXT_CONTROL
        fits = last.__lt__ if it.id & NEXT_CONTROL else last.__eq__
        knob = next((knob for knob in self.knobs if fits(knob.identifier)), None)
        if knob is None:
            raise OSError(errno.EINVAL, "Invalid argument")
        it.id, it.type, it.name, it.flags = knob.identifier, knob.kind, knob.name, knob.flags
        it.minimum, it.maximum, it.step, it.default_value = knob.low, knob.high, 1, knob.low

    def _querymenu(self, it: Any) -> None:
        if it.index not in (1, 3):
            raise OSError(errno.EINVAL, "Invalid argument")
        it.name = {1: b"Manual Mode", 3: b"Aperture Priority Mode"}[it.index]

    def _knob(self, identifier: int) -> Knob:
        for knob in self.knobs:
            if knob.identifier == identifier:
                return knob
        raise OSError(errno.EINVAL, "Invalid argument")

    def _g_ctrl(self, it: Any) -> None:
        it.value = self._knob(it.id).value

    def _s_ctrl(self, it: Any) -> None:
        self._knob(it.id).value = it.value

    def _reqbufs(self, it: Any) -> None:
        self.queued.clear()
        self.lent = []

    def _querybuf(self, it: Any) -> None:
        it.length, it.offset = self.size_bytes, it.index * 4096

    def _qbuf(self, it: Any) -> None:
        self.queued.append(it.index)

    def _streamon(self, it: Any) -> None:
        self.streaming = iter(self.script())

    def _streamoff(self, it: Any) -> None:
        self.streaming = None

    def _dqbuf(self, it: Any) -> None:
        if self.streaming is None:
            raise OSError(errno.EINVAL, "Invalid argument")
        sent = next(self.streaming, Sent(error=errno.EAGAIN))
        if sent.error:
            raise OSError(sent.error, "refused")
        index = self.queued.pop(0)
        whole = self._bytes(sent.sequence)
        there = int(len(whole) * sent.share)
        self.lent[index].data[:] = 0
        self.lent[index].data[:there] = whole[:there]
        if sent.faulty:
            self.lent[index].data[there // 2 :] = 0
        it.index, it.bytesused, it.sequence = (
            index if sent.index is None else sent.index,
            there,
            sent.sequence,
        )
        it.flags = BUFFER_FAULTY if sent.faulty else 0
        it.field = self.field if sent.field is None else sent.field
        at_us = round(1e6 * (1000.0 + sent.sequence * PERIOD_S))
        it.timestamp.seconds, it.timestamp.microseconds = divmod(at_us, 1_000_000)

    def _bytes(self, sequence: int) -> np.ndarray:
        letters = self._letters
        if letters.startswith("Y1"):
            return (
                luma(sequence, self.rows, self.columns, deep=True)
                .astype("<u2")
                .reshape(-1)
                .view(np.uint8)
            )
        grey = luma(sequence, self.rows, self.columns)
        if letters == "GREY":
            return grey.reshape(-1)
        if letters == "NV12":
            return np.concatenate([grey.reshape(-1), np.full(grey.size // 2, 128, np.uint8)])
        pairs = np.full((self.rows, self.columns, 2), 128, np.uint8)
        pairs[..., 0 if letters == "YUYV" else 1] = grey
        return pairs.reshape(-1)
