"""Structures and request numbers of V4L2 on a 64-bit Linux.

Names, order and sizes are those of the kernel's `linux/videodev2.h` (Linux Media userspace API,
part I).
"""

import ctypes
from dataclasses import dataclass
from typing import Any

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


_KINDS: dict[str, Any] = {
    "u8": ctypes.c_uint8,
    "u32": ctypes.c_uint32,
    "u64": ctypes.c_uint64,
    "i32": ctypes.c_int32,
    "i64": ctypes.c_int64,
    "char": ctypes.c_char,
}


def _structure(
    name: str, fields: str, *, base: type = ctypes.Structure, pack: int = 0, **parts: Any
) -> Any:
    """Return a structure of fields "name:kind*count"; kinds are those of `_KINDS`, by default u32,
    or parts.
    """
    made = []
    for field_text in fields.split():
        field, _, kind = field_text.partition(":")
        kind, _, count = (kind or "u32").partition("*")
        type_ = parts[kind] if kind in parts else _KINDS[kind]
        made.append((field, type_ * int(count) if count else type_))
    return type(name, (base,), {"_fields_": made} | ({"_pack_": pack} if pack else {}))


Capability = _structure(
    "Capability",
    "driver:char*16 card:char*32 bus_info:char*32 version capabilities device_caps reserved:u32*3",
)
FormatDescription = _structure(
    "FormatDescription", "index type flags description:char*32 pixelformat mbus_code reserved:u32*3"
)
# A discrete size has its width and height in the first two of `sizes`; stepwise: smallest, largest,
# step of each
FrameSize = _structure("FrameSize", "index pixel_format type sizes:u32*6 reserved:u32*2")
PixelFormat = _structure(
    "PixelFormat",
    (
        "width height pixelformat field bytesperline sizeimage colorspace priv flags ycbcr_enc "
        "quantization xfer_func"
    ),
)
# Another member of the kernel's union is a pointer, which determines the alignment.
_FormatOf = _structure(
    "_FormatOf", "pix:pix raw:u8*200 alignment:u64", base=ctypes.Union, pix=PixelFormat
)
Format = _structure("Format", "type of:of", of=_FormatOf)
BufferRequest = _structure("BufferRequest", "count type memory capabilities flags:u8 reserved:u8*3")
TimeStamp = _structure("TimeStamp", "seconds:i64 microseconds:i64")
_TimeCode = _structure("_TimeCode", "type flags digits:u8*8")
# The offset is the lower half of a union of 8 bytes on a little-endian machine.
Buffer = _structure(
    "Buffer",
    "index type bytesused flags field timestamp:time timecode:code sequence memory offset:u64 "
    "length reserved2 request_fd:i32",
    time=TimeStamp,
    code=_TimeCode,
)
ControlQuery = _structure(
    "ControlQuery",
    "id type name:char*32 minimum:i32 maximum:i32 step:i32 default_value:i32 flags reserved:u32*2",
)
ControlValue = _structure("ControlValue", "id value:i32")
CaptureParameters = _structure(
    "CaptureParameters",
    "capability capturemode numerator denominator extendedmode readbuffers reserved:u32*4",
)
_ParametersOf = _structure(
    "_ParametersOf", "capture:capture raw:u8*200", base=ctypes.Union, capture=CaptureParameters
)
StreamParameters = _structure("StreamParameters", "type of:of", of=_ParametersOf)
Input = _structure(
    "Input", "index name:char*32 type audioset tuner std:u64 status capabilities reserved:u32*3"
)


_READ, _WRITE, _BOTH = 2, 1, 3


@dataclass(frozen=True, kw_only=True)
class Request:
    """One kind of ioctl."""

    name: str  #: Name in the kernel, without VIDIOC_
    #: Number: direction, size of the structure, the letter V, and a running number
    #: (asm-generic/ioctl.h)
    code: int
    structure: Any  #: Structure passed to the kernel and filled in by it


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
