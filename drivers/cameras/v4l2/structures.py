"""Structures and request numbers of V4L2 on a 64-bit Linux.

Names, order and sizes are those of the kernel's `linux/videodev2.h` (Linux Media userspace API, part I).
"""

import ctypes
from ctypes import c_char, c_int32, c_int64, c_uint8, c_uint32, c_uint64
from dataclasses import dataclass

CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MEMORY_MAPPED = 1  # V4L2_MEMORY_MMAP

CAN_CAPTURE = 0x00000001
CAN_STREAM = 0x04000000
HAS_OWN_CAPABILITIES = 0x80000000

BUFFER_FAULTY = 0x0040  # V4L2_BUF_FLAG_ERROR: the data may be spoiled

CONTROL_DISABLED, CONTROL_READ_ONLY, CONTROL_INACTIVE = 0x0001, 0x0004, 0x0010
NEXT_CONTROL = 0x80000000
BIG_ENDIAN = 0x80000000

STANDARDS_525 = 0x0000F900  # V4L2_STD_525_60: NTSC in its kinds, and PAL of 525 lines (M, 60)


def _u32(*names: str) -> tuple[tuple[str, type], ...]:
    """Return unsigned 32-bit fields."""
    return tuple((name, c_uint32) for name in names)


class Capability(ctypes.Structure):
    """VIDIOC_QUERYCAP."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        *_u32("version", "capabilities", "device_caps"),
        ("reserved", c_uint32 * 3),
    )


class FormatDescription(ctypes.Structure):
    """VIDIOC_ENUM_FMT."""

    _fields_ = (
        *_u32("index", "type", "flags"),
        ("description", c_char * 32),
        *_u32("pixelformat", "mbus_code"),
        ("reserved", c_uint32 * 3),
    )


class FrameSize(ctypes.Structure):
    """VIDIOC_ENUM_FRAMESIZES; a discrete size has its width and height in the first two of `sizes`.

    Stepwise: smallest width, largest width, step of width, smallest height, largest height, step of height.
    """

    _fields_ = (*_u32("index", "pixel_format", "type"), ("sizes", c_uint32 * 6), ("reserved", c_uint32 * 2))


class PixelFormat(ctypes.Structure):
    """Image in memory."""

    _fields_ = (
        *_u32("width", "height", "pixelformat", "field", "bytesperline", "sizeimage"),
        *_u32("colorspace", "priv", "flags", "ycbcr_enc", "quantization", "xfer_func"),
    )


class _FormatOf(ctypes.Union):
    # Another member of the kernel's union is a pointer, which determines the alignment.
    _fields_ = (("pix", PixelFormat), ("raw", c_uint8 * 200), ("alignment", c_uint64))


class Format(ctypes.Structure):
    """VIDIOC_G_FMT, VIDIOC_S_FMT."""

    _fields_ = (("type", c_uint32), ("of", _FormatOf))


class BufferRequest(ctypes.Structure):
    """VIDIOC_REQBUFS."""

    _fields_ = (*_u32("count", "type", "memory", "capabilities"), ("flags", c_uint8), ("reserved", c_uint8 * 3))


class TimeStamp(ctypes.Structure):
    """Seconds and microseconds of the kernel's clock."""

    _fields_ = (("seconds", c_int64), ("microseconds", c_int64))


class _TimeCode(ctypes.Structure):
    _fields_ = (("type", c_uint32), ("flags", c_uint32), ("digits", c_uint8 * 8))


class Buffer(ctypes.Structure):
    """VIDIOC_QUERYBUF, VIDIOC_QBUF, VIDIOC_DQBUF."""

    _fields_ = (
        *_u32("index", "type", "bytesused", "flags", "field"),
        ("timestamp", TimeStamp),
        ("timecode", _TimeCode),
        *_u32("sequence", "memory"),
        ("offset", c_uint64),  # a union of 8 bytes; the offset is its lower half on a little-endian machine
        *_u32("length", "reserved2"),
        ("request_fd", c_int32),
    )


class ControlQuery(ctypes.Structure):
    """VIDIOC_QUERYCTRL."""

    _fields_ = (
        *_u32("id", "type"),
        ("name", c_char * 32),
        *((name, c_int32) for name in ("minimum", "maximum", "step", "default_value")),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class MenuQuery(ctypes.Structure):
    """VIDIOC_QUERYMENU."""

    _pack_ = 1
    _fields_ = (("id", c_uint32), ("index", c_uint32), ("name", c_char * 32), ("reserved", c_uint32))


class ControlValue(ctypes.Structure):
    """VIDIOC_G_CTRL, VIDIOC_S_CTRL."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class CaptureParameters(ctypes.Structure):
    """Frame period as a fraction of a second."""

    _fields_ = (
        *_u32("capability", "capturemode", "numerator", "denominator", "extendedmode", "readbuffers"),
        ("reserved", c_uint32 * 4),
    )


class _ParametersOf(ctypes.Union):
    _fields_ = (("capture", CaptureParameters), ("raw", c_uint8 * 200))


class StreamParameters(ctypes.Structure):
    """VIDIOC_G_PARM, VIDIOC_S_PARM."""

    _fields_ = (("type", c_uint32), ("of", _ParametersOf))


class Input(ctypes.Structure):
    """VIDIOC_ENUMINPUT."""

    _fields_ = (
        ("index", c_uint32),
        ("name", c_char * 32),
        *_u32("type", "audioset", "tuner"),
        ("std", c_uint64),
        *_u32("status", "capabilities"),
        ("reserved", c_uint32 * 3),
    )


_READ, _WRITE, _BOTH = 2, 1, 3


@dataclass(frozen=True, kw_only=True)
class Request:
    """One kind of ioctl."""

    name: str  # Name in the kernel, without VIDIOC_
    code: int  # Number: direction, size of the structure, the letter V, and a running number (asm-generic/ioctl.h)
    structure: type  # Structure passed to the kernel and filled in by it


def _request(name: str, number: int, structure: type, direction: int = _BOTH) -> Request:
    code = direction << 30 | ctypes.sizeof(structure) << 16 | ord("V") << 8 | number
    return Request(name=name, code=code, structure=structure)


CAPABILITIES = _request("QUERYCAP", 0, Capability, _READ)
LIST_FORMATS = _request("ENUM_FMT", 2, FormatDescription)
GET_FORMAT = _request("G_FMT", 4, Format)
SET_FORMAT = _request("S_FMT", 5, Format)
REQUEST_BUFFERS = _request("REQBUFS", 8, BufferRequest)
QUERY_BUFFER = _request("QUERYBUF", 9, Buffer)
QUEUE_BUFFER = _request("QBUF", 15, Buffer)
TAKE_BUFFER = _request("DQBUF", 17, Buffer)
START = _request("STREAMON", 18, ctypes.c_int, _WRITE)
STOP = _request("STREAMOFF", 19, ctypes.c_int, _WRITE)
GET_PARAMETERS = _request("G_PARM", 21, StreamParameters)
SET_PARAMETERS = _request("S_PARM", 22, StreamParameters)
GET_STANDARD = _request("G_STD", 23, ctypes.c_uint64, _READ)
SET_STANDARD = _request("S_STD", 24, ctypes.c_uint64, _WRITE)
LIST_INPUTS = _request("ENUMINPUT", 26, Input)
GET_CONTROL = _request("G_CTRL", 27, ControlValue)
SET_CONTROL = _request("S_CTRL", 28, ControlValue)
QUERY_CONTROL = _request("QUERYCTRL", 36, ControlQuery)
QUERY_MENU = _request("QUERYMENU", 37, MenuQuery)
GET_INPUT = _request("G_INPUT", 38, ctypes.c_int, _READ)
SET_INPUT = _request("S_INPUT", 39, ctypes.c_int)
LIST_SIZES = _request("ENUM_FRAMESIZES", 74, FrameSize)


def words(text: bytes) -> str:
    """Return a name of the kernel as text; invalid bytes are replaced."""
    return text.split(b"\0")[0].decode("ascii", errors="replace").strip()


def four_letters(code: int) -> str:
    """Return the FourCC of a pixel format; its highest bit marks big-endian values."""
    letters = words(bytes(code >> shift & 0x7F for shift in (0, 8, 16, 24)))
    return f"{letters}-BE" if code & BIG_ENDIAN else letters


def code_of(letters: str) -> int:
    """Return the number of a FourCC."""
    return int.from_bytes(letters.ljust(4).encode("ascii")[:4], "little")
