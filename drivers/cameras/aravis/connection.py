"""Connection to one Aravis camera, and the test whether it still answers.

The Aravis library repeats an unanswered command for seconds, too long for an open gate. Calls that
access the camera therefore run in a thread, and the control port of a GigE Vision camera is queried
meanwhile.
"""

import ctypes
import ctypes.util
import queue
import socket
import struct
import threading
import time
from collections.abc import Callable
from ctypes import (
    POINTER,
    byref,
    c_bool,
    c_char_p,
    c_double,
    c_int,
    c_size_t,
    c_uint,
    c_uint32,
    c_uint64,
    c_void_p,
)
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar, cast

from drivers.cameras.frame_assembly import POLL_S
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
        self._gobject, self._glib, self._gio = map(
            _companion, ("gobject-2.0", "glib-2.0", "gio-2.0")
        )
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
            sentence = (error.contents.message or b"an error without words").decode(
                errors="replace"
            )
            self._glib.g_error_free(error)
            raise CameraError(sentence)
        return result

    def pair(self, name: str, camera: int, kind: Any = c_double) -> tuple[Any, Any]:
        """Call a getter of two numbers, such as bounds."""
        low, high = kind(), kind()
        self.call(name, camera, byref(low), byref(high))
        return low.value, high.value

    def set_up_stream(
        self, stream: int, *, buffer_bytes: int, longest_s: float, resend: bool
    ) -> None:
        """Give a GigE Vision stream a receive buffer of a fixed size; set how long an incomplete
        frame waits after its last packet, s, and whether missing packets are requested again.
        """
        self._gobject.g_object_set(
            c_void_p(stream),
            b"socket-buffer",
            c_int(0),  # ARV_GV_STREAM_SOCKET_BUFFER_FIXED
            b"socket-buffer-size",
            c_int(buffer_bytes),
            b"frame-retention",
            c_uint(round(longest_s * 1e6)),
            b"packet-resend",
            c_int(int(resend)),
            c_void_p(None),
        )

    def packets(self, stream: int) -> tuple[int, int]:
        """Return the numbers of resent and of missing packets of a GigE Vision stream."""
        resent, missing = c_uint64(), c_uint64()
        self.plain("arv_gv_stream_get_statistics", stream, byref(resent), byref(missing))
        return resent.value, missing.value

    def address(self, device: int) -> str:
        """Return the IP address of a GigE Vision device."""
        socket_address = self.plain("arv_gv_device_get_device_address", device)
        text = self._gio.g_inet_address_to_string(
            self._gio.g_inet_socket_address_get_address(socket_address)
        )
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
    installed_name = ctypes.util.find_library("aravis-0.8")
    for name in (*NAMES, *([installed_name] if installed_name else [])):
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


T = TypeVar("T")

CONTROL_PORT = 3956
# Time without a frame or an answer after which the control port of a camera is queried, s
SUSPICION_S = 0.2
HEARTBEAT_S = 3.0  # time that a camera stays locked after its client died
# GVCP discovery command: key, acknowledge required, command 0x0002, no payload, request number.
_DISCOVERY = struct.pack(">BBHHH", 0x42, 0x01, 0x0002, 0, 0x7FFF)


@dataclass(frozen=True, kw_only=True)
class CameraFound:
    """A camera found on an interface."""

    identifier: str
    address: str
    model: str
    serial: str


def list_cameras() -> tuple[CameraFound, ...]:
    """Return the cameras found on all interfaces."""
    library = aravis()
    library.plain("arv_update_device_list")
    names = (
        "arv_get_device_id",
        "arv_get_device_address",
        "arv_get_device_model",
        "arv_get_device_serial_nbr",
    )
    rows = [
        [(library.plain(name, index) or b"").decode(errors="replace") for name in names]
        for index in range(library.plain("arv_get_n_devices"))
    ]
    return tuple(CameraFound(identifier=a, address=b, model=c, serial=d) for a, b, c, d in rows)


def only_camera() -> str:
    """Return the identifier of the only camera; none or several are a `CameraError`."""
    identifiers = [camera.identifier for camera in list_cameras()]
    if len(identifiers) != 1:
        raise CameraError(
            "a camera must be named unless there is exactly one, found "
            f"{', '.join(identifiers) or 'none'}"
        )
    return identifiers[0]


class Connection:
    """Control of one camera by identifier or IP address, from its construction to `close`.

    A camera that is missing, or in use by another program for `control_s`, is CameraError; `say`
    reports the wait.
    """

    def __init__(self, name: str, *, control_s: float, say: Callable[[str], None]) -> None:
        self.library: Aravis = aravis()
        self.identifier = name
        self.is_dead = False  # Whether the camera was found dead
        self.address: str | None = None  # IP address of a camera whose frames come over a network
        self._unanswered = 0
        self._act: threading.Thread | None = None
        self.camera = camera = self._take_control(control_s, say)  # The library's handle
        if self.library.plain("arv_camera_is_gv_device", camera):
            self.address = self.library.address(self.library.plain("arv_camera_get_device", camera))
            self.library.plain("arv_camera_gv_set_stream_options", camera, PACKET_SOCKET_DISABLED)
        # The camera of a killed client may still be sending.
        self.library.call("arv_camera_stop_acquisition", camera)

    def close(self) -> None:
        """Release the camera; in the background if it does not answer."""
        if self.is_dead or (self._act is not None and self._act.is_alive()):
            self.begin(lambda: self.library.release(self.camera))
        else:
            self.library.release(self.camera)

    def require_alive(self) -> None:
        """Raise `CameraError` if the control port is closed, or repeatedly does not answer."""
        if self.is_dead:
            raise self.mark_dead("has gone")
        if self.address is None:
            return
        answers = ask_control_port(self.address)
        if answers is None:
            raise self.mark_dead("has gone: nothing listens on its control port")
        self._unanswered = 0 if answers else self._unanswered + 1
        if self._unanswered >= 6:  # consecutive unanswered queries before a camera counts as dead
            raise self.mark_dead(
                f"no longer answers: it left {self._unanswered} questions in a row without reply"
            )

    def mark_dead(self, how: str) -> CameraError:
        """Mark the camera as dead, which ends all waits for it, and return the error to raise."""
        self.is_dead = True
        return CameraError(f"camera {self.identifier} {how}")

    def begin(self, act: Callable[[], None]) -> threading.Thread:
        """Run an action in a thread after the end of the previous one."""
        before = self._act

        def in_turn() -> None:
            if before is not None:
                before.join()
            act()

        self._act = threading.Thread(target=in_turn, daemon=True)
        self._act.start()
        return self._act

    def while_alive(
        self, act: Callable[[], T], while_waiting: Callable[[], None] = lambda: None
    ) -> T:
        """Run an action that accesses the camera; return its result or raise its error.

        If the camera is found dead meanwhile, or `while_waiting` raises, that is raised at once and
        the action ends in the background.
        """
        done: queue.SimpleQueue[tuple[T | None, BaseException | None]] = queue.SimpleQueue()

        def attempt() -> None:
            try:
                done.put((act(), None))
            except BaseException as error:  # raised by the waiting thread
                done.put((None, error))

        thread, asked_s = self.begin(attempt), time.monotonic()
        while True:
            try:
                result, error = done.get(timeout=POLL_S)
            except queue.Empty:
                while_waiting()
                if time.monotonic() - asked_s > SUSPICION_S:
                    self.require_alive()
                    while_waiting()
                    asked_s = time.monotonic()
                continue
            thread.join()
            if error is not None:
                raise error
            return cast(T, result)

    def _take_control(self, control_s: float, say: Callable[[str], None]) -> int:
        until_s = time.monotonic() + control_s
        while True:
            camera = self._open_camera()
            if not self.library.plain("arv_camera_is_gv_device", camera) or self.library.plain(
                "arv_gv_device_is_controller", self.library.plain("arv_camera_get_device", camera)
            ):
                return camera
            self.library.release(camera)
            if time.monotonic() > until_s:
                raise CameraError(
                    f"camera {self.identifier} is held by another program, waited {control_s:g} s "
                    "for it"
                )
            say(
                f"camera {self.identifier} is locked by another client; waiting for its heartbeat "
                "to run out"
            )

    def _open_camera(self) -> int:
        try:
            return self.library.call("arv_camera_new", self.identifier.encode())
        except CameraError as error:
            identifiers = ", ".join(camera.identifier for camera in list_cameras()) or "none"
            raise CameraError(
                f"camera {self.identifier} cannot be opened ({error}); cameras found: {identifiers}"
            ) from None


# longest wait for an answer on the control port
def ask_control_port(address: str, *, timeout_s: float = 0.08) -> bool | None:
    """Send one GigE Vision discovery command to a camera's address.

    Returns whether the acknowledgement came within `timeout_s`; None if no camera listens there
    (known at once on loopback, when the camera's process is gone).
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        control.settimeout(timeout_s)
        try:
            control.connect((address, CONTROL_PORT))
            control.send(_DISCOVERY)
            control.recv(1024)
        except TimeoutError:
            return False
        except OSError:
            return None
    return True
