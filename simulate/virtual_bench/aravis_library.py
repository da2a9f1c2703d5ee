"""The functions of the Aravis C library that make its fake GigE Vision camera, declared for
ctypes.
"""

import ctypes
import ctypes.util
import re
from collections.abc import Callable
from ctypes import (
    CFUNCTYPE,
    POINTER,
    byref,
    c_bool,
    c_char_p,
    c_double,
    c_size_t,
    c_uint32,
    c_uint64,
    c_void_p,
)
from enum import IntEnum
from pathlib import Path
from typing import Any

from labdata.errors import BadInput

_NAMES = ("libaravis-0.8.so.0", "libaravis-0.8.dylib", "libaravis-0.8-0.dll")
# buffer, our data, exposure in us, gain, pixel format
_FILL = CFUNCTYPE(None, c_void_p, c_void_p, c_uint32, c_uint32, c_uint32)
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_gv_fake_camera_new_full": (c_void_p, (c_char_p, c_char_p, c_char_p)),
    "arv_gv_fake_camera_is_running": (c_bool, (c_void_p,)),
    "arv_gv_fake_camera_get_fake_camera": (c_void_p, (c_void_p,)),
    "arv_fake_camera_new": (c_void_p, (c_char_p,)),
    "arv_fake_camera_get_genicam_xml": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_fake_camera_set_fill_pattern": (None, (c_void_p, _FILL, c_void_p)),
    "arv_fake_camera_read_register": (c_bool, (c_void_p, c_uint32, POINTER(c_uint32))),
    "arv_fake_camera_write_register": (c_bool, (c_void_p, c_uint32, c_uint32)),
    "arv_fake_camera_write_memory": (c_bool, (c_void_p, c_uint32, c_uint32, c_char_p)),
    "arv_fake_camera_set_trigger_frequency": (None, (c_void_p, c_double)),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,)),
    "arv_buffer_get_data": (c_void_p, (c_void_p, c_void_p)),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_set_timestamp": (None, (c_void_p, c_uint64)),
}


class Register(IntEnum):
    """Registers of the fake camera, from its GenICam description."""

    MODEL_NAME = 0x068
    WIDTH = 0x100
    HEIGHT = 0x104
    GAIN_RAW = 0x110
    SENSOR_HEIGHT = 0x118
    SENSOR_WIDTH = 0x11C
    EXPOSURE_US = 0x120
    ACQUISITION = 0x124
    PIXEL_FORMAT = 0x128
    X_OFFSET = 0x130
    Y_OFFSET = 0x134
    FRAME_PERIOD_US = 0x138
    TRIGGER_MODE = 0x300
    TRIGGER_SOURCE = 0x304
    TRIGGER_SOFTWARE = 0x30C


MODEL_NAME_BYTES = 32
MONO_8, MONO_16 = 0x01080001, 0x01100007


class FakeCamera:
    """Aravis' fake GigE Vision camera on one network interface.

    `address` is that of the interface, "127.0.0.1" for loopback; `serial` has at most 15
    characters; `description` is the file of `genicam_description`. A missing library, interface or
    GigE Vision port is BadInput.
    """

    def __init__(self, address: str, serial: str, description: Path) -> None:
        self._library = load()
        self._camera = self._call(
            "arv_gv_fake_camera_new_full",
            address.encode(),
            serial.encode(),
            str(description).encode(),
        )
        if not self._camera or not self._call("arv_gv_fake_camera_is_running", self._camera):
            raise BadInput(
                "a virtual camera needs the GigE Vision port of a local interface, got no port "
                f"on {address}"
            )
        self._registers = self._call("arv_gv_fake_camera_get_fake_camera", self._camera)
        self._callback: Any = None
        self.clock_jump_ns = 0  # How far the camera's time stamps are off, ns

    def read(self, register: int) -> int:
        """Read a register."""
        value = c_uint32()
        self._call("arv_fake_camera_read_register", self._registers, register, byref(value))
        return value.value

    def write(self, register: int, value: int) -> None:
        """Write a register."""
        self._call("arv_fake_camera_write_register", self._registers, register, value)

    def name_model(self, name: str) -> None:
        """Give the camera a model name."""
        text = name.encode()[: MODEL_NAME_BYTES - 1].ljust(MODEL_NAME_BYTES, b"\0")
        self._call(
            "arv_fake_camera_write_memory", self._registers, Register.MODEL_NAME, len(text), text
        )

    def lose_packets(self, fraction: float) -> None:
        """Lose a fraction of the packets of each frame on the wire."""
        gobject = ctypes.CDLL("libgobject-2.0.so.0")
        gobject.g_object_set.argtypes = (c_void_p, c_char_p, c_double, c_void_p)
        gobject.g_object_set(self._camera, b"gvsp-lost-ratio", fraction, None)

    def fill_frames(self, pixels: Callable[[int], bytes]) -> None:
        """Give every frame the pixels that `pixels` returns for its number; called by the wire's
        thread.
        """

        def fill(buffer: int, *_: int | None) -> None:
            data = pixels(self._call("arv_buffer_get_frame_id", buffer))
            # The buffer reports a size of 0 here; its memory holds width x height pixels.
            ctypes.memmove(self._call("arv_buffer_get_data", buffer, None), data, len(data))
            if self.clock_jump_ns:
                stamp_ns = self._call("arv_buffer_get_timestamp", buffer)
                self._call("arv_buffer_set_timestamp", buffer, stamp_ns + self.clock_jump_ns)

        self._callback = _FILL(fill)
        self._call("arv_fake_camera_set_fill_pattern", self._registers, self._callback, None)

    def send_when_triggered(self, frame_rate_hz: float, ready: Callable[[], bytes]) -> None:
        """Send a frame for each `trigger`, at most `frame_rate_hz` a second, with the pixels that
        `ready` returns.
        """
        self._call("arv_fake_camera_set_trigger_frequency", self._registers, frame_rate_hz)
        self.fill_frames(lambda _: ready())
        self.hold_trigger()

    def hold_trigger(self) -> None:
        """Keep the camera in trigger mode, whatever a client set."""
        self.write(Register.TRIGGER_SOURCE, 1)
        self.write(Register.TRIGGER_MODE, 1)

    def trigger(self) -> None:
        """Have one frame sent."""
        self.write(Register.TRIGGER_SOFTWARE, 1)

    def take_trigger_back(self) -> None:
        """Cancel a trigger for which no frame was sent."""
        self.write(Register.TRIGGER_SOFTWARE, 0)

    def _call(self, name: str, *arguments: Any) -> Any:
        return getattr(self._library, name)(*arguments)


def genicam_description(longest_exposure_us: float) -> str:
    """Return the fake camera's GenICam description for a video camera of a longest exposure, us."""
    library, size = load(), c_size_t()
    text = library.arv_fake_camera_get_genicam_xml(
        library.arv_fake_camera_new(b"description"), byref(size)
    )
    original = ctypes.string_at(text, size.value).decode()
    longest = original.replace("<Max>10000000.0</Max>", f"<Max>{longest_exposure_us:.1f}</Max>")
    grey = re.sub(
        r'\s*<EnumEntry Name="(?:Bayer|RGB)\w+".*?</EnumEntry>', "", longest, flags=re.DOTALL
    )
    if longest == original or grey == longest:
        raise BadInput(
            "the fake camera's description must be that of Aravis 0.8, got one of another form"
        )
    return grey


def load() -> ctypes.CDLL:
    """Load the library; raises `BadInput` where it is absent."""
    installed_name = ctypes.util.find_library("aravis-0.8")
    for name in (*_NAMES, *([installed_name] if installed_name else [])):
        try:
            library = ctypes.CDLL(name)
        except OSError:
            continue
        for function, (result, arguments) in _FUNCTIONS.items():
            getattr(library, function).restype = result
            getattr(library, function).argtypes = arguments
        return library
    raise BadInput(
        "a camera on real wires needs the Aravis library 0.8 (Debian: libaravis-0.8-0), got none"
    )


def is_available() -> bool:
    """Whether the library can be loaded."""
    try:
        load()
    except BadInput:
        return False
    return True
