"""ctypes declarations of the Aravis C functions that the driver calls."""

import ctypes
import ctypes.util
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_uint32, c_uint64, c_void_p
from functools import cache
from typing import Any

from drivers.errors import CameraError

NAMES = ("libaravis-0.8.so.0", "libaravis-0.8.dylib", "libaravis-0.8-0.dll")
PACKET_SOCKET_DISABLED = 1  # ArvGvStreamOption
BUFFER_SUCCESS = 0  # ArvBufferStatus
BUFFER_FAULTS = {
    -1: "unknown",
    1: "cleared",
    2: "timeout",
    3: "missing packets",
    4: "wrong packet",
    5: "size mismatch",
    6: "filling",
    7: "aborted",
    8: "payload not supported",
}
INSTALL = "install it (Debian: apt-get install libaravis-0.8-0), or use the in-process camera"


class GError(ctypes.Structure):
    """GLib's error."""

    _fields_ = (("domain", c_uint32), ("code", c_int), ("message", c_char_p))


_ERROR = POINTER(POINTER(GError))
# name: (result, arguments before the error, whether it reports a GError)
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...], bool]] = {
    "arv_update_device_list": (None, (), False),
    "arv_get_n_devices": (c_uint, (), False),
    "arv_get_device_id": (c_char_p, (c_uint,), False),
    "arv_get_device_address": (c_char_p, (c_uint,), False),
    "arv_get_device_model": (c_char_p, (c_uint,), False),
    "arv_get_device_serial_nbr": (c_char_p, (c_uint,), False),
    "arv_camera_new": (c_void_p, (c_char_p,), True),
    "arv_camera_get_device": (c_void_p, (c_void_p,), False),
    "arv_camera_is_gv_device": (c_bool, (c_void_p,), False),
    "arv_gv_device_is_controller": (c_bool, (c_void_p,), False),
    "arv_gv_device_get_device_address": (c_void_p, (c_void_p,), False),
    "arv_camera_gv_set_stream_options": (None, (c_void_p, c_int), False),
    "arv_camera_set_region": (None, (c_void_p, c_int, c_int, c_int, c_int), True),
    "arv_camera_get_region": (None, (c_void_p, *[POINTER(c_int)] * 4), True),
    "arv_camera_get_sensor_size": (None, (c_void_p, *[POINTER(c_int)] * 2), True),
    "arv_camera_set_pixel_format_from_string": (None, (c_void_p, c_char_p), True),
    "arv_camera_get_pixel_format_as_string": (c_char_p, (c_void_p,), True),
    "arv_camera_set_trigger": (None, (c_void_p, c_char_p), True),
    "arv_camera_clear_triggers": (None, (c_void_p,), True),
    "arv_camera_get_trigger_source": (c_char_p, (c_void_p,), True),
    "arv_camera_is_feature_available": (c_bool, (c_void_p, c_char_p), True),
    "arv_camera_get_string": (c_char_p, (c_void_p, c_char_p), True),
    "arv_camera_get_payload": (c_uint, (c_void_p,), True),
    "arv_camera_create_stream": (c_void_p, (c_void_p, c_void_p, c_void_p), True),
    "arv_camera_start_acquisition": (None, (c_void_p,), True),
    "arv_camera_stop_acquisition": (None, (c_void_p,), True),
    "arv_buffer_new": (c_void_p, (c_size_t, c_void_p), False),
    "arv_buffer_get_status": (c_int, (c_void_p,), False),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,), False),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,), False),
    "arv_buffer_get_data": (c_void_p, (c_void_p, POINTER(c_size_t)), False),
    "arv_buffer_get_image_width": (c_int, (c_void_p,), False),
    "arv_buffer_get_image_height": (c_int, (c_void_p,), False),
    "arv_gv_stream_get_statistics": (None, (c_void_p, *[POINTER(c_uint64)] * 2), False),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p), False),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64), False),
}
for _feature in ("exposure_time", "gain", "frame_rate"):
    _FUNCTIONS |= {
        f"arv_camera_is_{_feature}_available": (c_bool, (c_void_p,), True),
        f"arv_camera_get_{_feature}_bounds": (None, (c_void_p, *[POINTER(c_double)] * 2), True),
        f"arv_camera_set_{_feature}": (None, (c_void_p, c_double), True),
        f"arv_camera_get_{_feature}": (c_double, (c_void_p,), True),
    }


class Aravis:
    """The loaded library: `call` for functions that report a GError, `plain` for others."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._gobject, self._glib, self._gio = map(_companion, ("gobject-2.0", "glib-2.0", "gio-2.0"))
        self._functions = {name: _declare(library, name) for name in _FUNCTIONS}
        self._gobject.g_object_unref.argtypes = (c_void_p,)
        self._glib.g_error_free.argtypes = (POINTER(GError),)
        self._glib.g_free.argtypes = (c_void_p,)
        for name in ("g_inet_socket_address_get_address", "g_inet_address_to_string"):
            function = getattr(self._gio, name)
            function.argtypes, function.restype = (c_void_p,), c_void_p

    def plain(self, name: str, *arguments: Any) -> Any:
        """Call a function without GError."""
        return self._functions[name](*arguments)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function and turn its GError into a `CameraError`."""
        error = POINTER(GError)()
        result = self._functions[name](*arguments, byref(error))
        if error:
            sentence = (error.contents.message or b"an error without words").decode(errors="replace")
            self._glib.g_error_free(error)
            raise CameraError(sentence)
        return result

    def pair(self, name: str, camera: int, kind: Any = c_double) -> tuple[Any, Any]:
        """Call a getter of two numbers, such as bounds."""
        low, high = kind(), kind()
        self.call(name, camera, byref(low), byref(high))
        return low.value, high.value

    def fix_socket_buffer(self, stream: int, size_bytes: int) -> None:
        """Give a GigE Vision stream a receive buffer of a fixed size."""
        self._gobject.g_object_set(
            c_void_p(stream),
            b"socket-buffer",
            c_int(0),  # ARV_GV_STREAM_SOCKET_BUFFER_FIXED
            b"socket-buffer-size",
            c_int(size_bytes),
            c_void_p(None),
        )

    def wait_for_packets(self, stream: int, longest_s: float) -> None:
        """Set how long an incomplete frame of a GigE Vision stream waits after its last packet, s."""
        self._gobject.g_object_set(c_void_p(stream), b"frame-retention", c_uint(round(longest_s * 1e6)), c_void_p(None))

    def ask_for_lost_packets(self, stream: int, wanted: bool) -> None:
        """Set whether a GigE Vision stream requests missing packets again."""
        self._gobject.g_object_set(c_void_p(stream), b"packet-resend", c_int(1 if wanted else 0), c_void_p(None))

    def packets(self, stream: int) -> tuple[int, int]:
        """Return the numbers of resent and of missing packets of a GigE Vision stream."""
        resent, missing = c_uint64(), c_uint64()
        self.plain("arv_gv_stream_get_statistics", stream, byref(resent), byref(missing))
        return resent.value, missing.value

    def address(self, device: int) -> str:
        """Return the IP address of a GigE Vision device."""
        socket_address = self.plain("arv_gv_device_get_device_address", device)
        text = self._gio.g_inet_address_to_string(self._gio.g_inet_socket_address_get_address(socket_address))
        try:
            return (ctypes.string_at(text) if text else b"").decode()
        finally:
            self._glib.g_free(text)

    def release(self, thing: int) -> None:
        """Release one reference to an object."""
        self._gobject.g_object_unref(thing)


@cache
def aravis() -> Aravis:
    """Load the library; CameraError with the installation command if it is missing."""
    found = ctypes.util.find_library("aravis-0.8")
    for name in (*NAMES, *([found] if found else [])):
        try:
            library = ctypes.CDLL(name)
        except OSError:
            continue
        return Aravis(library)
    raise CameraError(f"the Aravis library (0.8) is not on this machine: {INSTALL}")


def _declare(library: ctypes.CDLL, name: str) -> Any:
    result, arguments, reports = _FUNCTIONS[name]
    function = getattr(library, name)
    function.restype = result
    function.argtypes = (*arguments, _ERROR) if reports else arguments
    return function


def _companion(name: str) -> ctypes.CDLL:
    for path in (f"lib{name}.so.0", ctypes.util.find_library(name)):
        try:
            if path:
                return ctypes.CDLL(path)
        except OSError:
            continue
    raise CameraError(f"the library {name}, which Aravis needs, is not on this machine: {INSTALL}")
