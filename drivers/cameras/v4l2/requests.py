"""What can be asked of a V4L2 device: the number of each request and the structure that goes with it."""

import ctypes
from dataclasses import dataclass

from drivers.cameras.v4l2 import structures

_READ, _WRITE, _BOTH = 2, 1, 3


@dataclass(frozen=True, kw_only=True)
class Request:
    """One kind of ioctl.

    Parameters
    ----------
    name
        Its name in the kernel, without VIDIOC_.
    code
        Its number: direction, size of the structure, the letter V, and a running number (asm-generic/ioctl.h).
    structure
        What goes along and comes back.
    """

    name: str
    code: int
    structure: type


def _request(name: str, number: int, structure: type, direction: int = _BOTH) -> Request:
    code = direction << 30 | ctypes.sizeof(structure) << 16 | ord("V") << 8 | number
    return Request(name=name, code=code, structure=structure)


CAPABILITIES = _request("QUERYCAP", 0, structures.Capability, _READ)
LIST_FORMATS = _request("ENUM_FMT", 2, structures.FormatDescription)
GET_FORMAT = _request("G_FMT", 4, structures.Format)
SET_FORMAT = _request("S_FMT", 5, structures.Format)
REQUEST_BUFFERS = _request("REQBUFS", 8, structures.BufferRequest)
QUERY_BUFFER = _request("QUERYBUF", 9, structures.Buffer)
QUEUE_BUFFER = _request("QBUF", 15, structures.Buffer)
TAKE_BUFFER = _request("DQBUF", 17, structures.Buffer)
START = _request("STREAMON", 18, ctypes.c_int, _WRITE)
STOP = _request("STREAMOFF", 19, ctypes.c_int, _WRITE)
GET_PARAMETERS = _request("G_PARM", 21, structures.StreamParameters)
SET_PARAMETERS = _request("S_PARM", 22, structures.StreamParameters)
GET_STANDARD = _request("G_STD", 23, ctypes.c_uint64, _READ)
SET_STANDARD = _request("S_STD", 24, ctypes.c_uint64, _WRITE)
LIST_INPUTS = _request("ENUMINPUT", 26, structures.Input)
GET_CONTROL = _request("G_CTRL", 27, structures.ControlValue)
SET_CONTROL = _request("S_CTRL", 28, structures.ControlValue)
QUERY_CONTROL = _request("QUERYCTRL", 36, structures.ControlQuery)
QUERY_MENU = _request("QUERYMENU", 37, structures.MenuQuery)
GET_INPUT = _request("G_INPUT", 38, ctypes.c_int, _READ)
SET_INPUT = _request("S_INPUT", 39, ctypes.c_int)
LIST_SIZES = _request("ENUM_FRAMESIZES", 74, structures.FrameSize)
