"""Connection to one Aravis camera, and the test whether it still answers.

The Aravis library repeats an unanswered command for seconds, too long for an open gate. Calls that
access the camera therefore run in a thread, and the control port of a GigE Vision camera is queried meanwhile.
"""

import queue
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar, cast

from drivers.cameras.aravis.library import PACKET_SOCKET_DISABLED, Aravis, aravis
from drivers.cameras.frame_assembly import POLL_S
from drivers.errors import CameraError

T = TypeVar("T")

CONTROL_PORT = 3956
CONTROL_S = 0.08  # longest wait for an answer on the control port
UNANSWERED = 6  # consecutive unanswered queries before a camera counts as dead
SUSPICION_S = 0.2  # Time without a frame or an answer after which the control port of a camera is queried, s
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
    names = ("arv_get_device_id", "arv_get_device_address", "arv_get_device_model", "arv_get_device_serial_nbr")
    rows = [
        [(library.plain(name, index) or b"").decode(errors="replace") for name in names]
        for index in range(library.plain("arv_get_n_devices"))
    ]
    return tuple(CameraFound(identifier=a, address=b, model=c, serial=d) for a, b, c, d in rows)


def only_camera() -> str:
    """Return the identifier of the only camera; none or several are a `CameraError`."""
    found = [camera.identifier for camera in list_cameras()]
    if len(found) != 1:
        raise CameraError(f"a camera must be named unless there is exactly one, found {', '.join(found) or 'none'}")
    return found[0]


class Connection:
    """Control of one camera by identifier or IP address, from its construction to `close`.

    A camera that is missing, or in use by another program for `control_s`, is CameraError; `say` reports the wait.
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
        if self._unanswered >= UNANSWERED:
            raise self.mark_dead(f"no longer answers: it left {self._unanswered} questions in a row without reply")

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

    def while_alive(self, act: Callable[[], T], while_waiting: Callable[[], None] = lambda: None) -> T:
        """Run an action that accesses the camera; return its result or raise its error.

        If the camera is found dead meanwhile, or `while_waiting` raises, that is raised at once and the action ends in
        the background.
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
                raise CameraError(f"camera {self.identifier} is held by another program, waited {control_s:g} s for it")
            say(f"camera {self.identifier} is locked by another client; waiting for its heartbeat to run out")

    def _open_camera(self) -> int:
        try:
            return self.library.call("arv_camera_new", self.identifier.encode())
        except CameraError as error:
            there = ", ".join(camera.identifier for camera in list_cameras()) or "none"
            raise CameraError(f"camera {self.identifier} cannot be opened ({error}); cameras found: {there}") from None


def ask_control_port(address: str, *, timeout_s: float = CONTROL_S) -> bool | None:
    """Send one GigE Vision discovery command to a camera's address.

    Returns whether the acknowledgement came within `timeout_s`; None if no camera listens there (known at once on
    loopback, when the camera's process is gone).
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
