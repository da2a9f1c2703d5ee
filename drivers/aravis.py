"""A GigE Vision or USB3 Vision camera through Aravis: settings read back, and frames that are whole or counted lost."""

import ctypes
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from drivers import gige
from drivers.aravis_capture import PIXELS, AravisCapture
from drivers.aravis_library import PACKET_SOCKET_DISABLED, Aravis, aravis
from drivers.interface import CameraError
from labdata.capture import CameraSettings
from labdata.errors import BadInput

UNANSWERED = 5  # questions on the control port, 0.1 s each, before a camera is taken for dead
HEARTBEAT_S = 3.0  # a camera stays locked this long after its client died


@dataclass(frozen=True, kw_only=True)
class CameraFound:
    """A camera that answered."""

    identifier: str
    address: str
    model: str
    serial: str


def list_cameras() -> tuple[CameraFound, ...]:
    """Ask every interface which cameras are there."""
    library = aravis()
    library.plain("arv_update_device_list")
    names = ("arv_get_device_id", "arv_get_device_address", "arv_get_device_model", "arv_get_device_serial_nbr")
    rows = [
        [(library.plain(name, index) or b"").decode(errors="replace") for name in names]
        for index in range(library.plain("arv_get_n_devices"))
    ]
    return tuple(CameraFound(identifier=a, address=b, model=c, serial=d) for a, b, c, d in rows)


class AravisCamera:
    """A camera reached through Aravis; use it in a `with` block.

    Parameters
    ----------
    name
        Its Aravis identifier, such as "Aravis-Fake-GV01", or its IP address; None: the only camera there is.
    silence_s
        Longest time without a frame before the camera is taken for dead, s; the exposure and four frame periods come
        on top.
    control_s
        Longest wait for a camera that another program holds, s. One whose client died frees itself after its
        heartbeat time.
    say
        Told, in a sentence, why opening takes long.

    Raises
    ------
    CameraError
        On entering: if the camera is not there, or is held by another program.
    """

    def __init__(
        self,
        name: str | None = None,
        *,
        silence_s: float = 0.6,
        control_s: float = 2.5 * HEARTBEAT_S,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._name, self._silence_s, self._control_s, self._say = name, silence_s, control_s, say
        self._camera: int | None = None
        self._address: str | None = None
        self._dead = False
        self._unanswered = 0

    @property
    def is_dead(self) -> bool:
        """Whether the camera was found dead."""
        return self._dead

    @property
    def is_gige(self) -> bool:
        """Whether frames come over a network."""
        return self._address is not None

    @property
    def identifier(self) -> str:
        """The camera's Aravis identifier."""
        return self._name or "camera"

    def __enter__(self) -> Self:
        self._library: Aravis = aravis()
        self._name = self._name or _only_camera()
        self._camera = camera = self._take_control(self._name)
        if self._library.plain("arv_camera_is_gv_device", camera):
            self._address = self._library.address(self._library.plain("arv_camera_get_device", camera))
            self._library.plain("arv_camera_gv_set_stream_options", camera, PACKET_SOCKET_DISABLED)
        # A client that was killed left its camera sending, to an address that nobody hears any more.
        self._library.call("arv_camera_stop_acquisition", camera)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            self.release(camera)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set what is not None and return every setting as read back.

        Raises
        ------
        BadInput
            If a value lies outside what the camera allows.
        CameraError
            If the camera refuses, or reads back something else than was asked.
        """
        self.require_alive()
        if settings.pixel_format is not None:
            self._set_pixel_format(settings.pixel_format)
        if settings.rows is not None or settings.columns is not None:
            self._set_size(settings.rows, settings.columns)
        self._set_number("frame_rate", "frame rate", "Hz", settings.frame_rate_hz)
        self._set_number("exposure_time", "exposure", "us", settings.exposure_s and settings.exposure_s * 1e6)
        self._set_number("gain", "gain", "dB", settings.gain_db)
        return self._settings()

    def capture(self, *, frames: int, discard: int = 0) -> AravisCapture:
        """Return a capture of `frames` whole frames after `discard` whole ones that are thrown away."""
        if frames < 1 or discard < 0:
            raise BadInput(f"a capture must take at least 1 frame and discard 0 or more, got {frames} and {discard}")
        self.require_alive()
        settings = self._settings()
        period_s = 1.0 / settings.frame_rate_hz if settings.frame_rate_hz else 0.0
        return AravisCapture(
            self._library,
            self._open,
            settings=settings,
            frames=frames,
            discard=discard,
            patience_s=self._silence_s + 4 * period_s + (settings.exposure_s or 0.0),
            owner=self,
        )

    def require_alive(self) -> None:
        """Raise a `CameraError` if the camera's control port is closed, or has not answered several times in a row."""
        if self._camera is None:
            raise CameraError(f"camera {self.identifier} must be opened with a with block before it is used")
        if self._dead:
            raise self.died("has gone")
        if self._address is None:
            return
        answer = gige.ask(self._address)
        if answer == "refused":
            raise self.died("has gone: nothing listens on its control port")
        self._unanswered = self._unanswered + 1 if answer == "silent" else 0
        if self._unanswered >= UNANSWERED:
            raise self.died(f"no longer answers: it left {self._unanswered} questions in a row without reply")

    def died(self, how: str) -> CameraError:
        """Mark the camera as dead, so that nothing waits for it any more, and return the error to raise."""
        self._dead = True
        return CameraError(f"camera {self.identifier} {how}")

    def _take_control(self, name: str) -> int:
        until_s = time.monotonic() + self._control_s
        while True:
            camera = self._opened(name)
            if not self._library.plain("arv_camera_is_gv_device", camera) or self._library.plain(
                "arv_gv_device_is_controller", self._library.plain("arv_camera_get_device", camera)
            ):
                return camera
            self._library.release(camera)
            if time.monotonic() > until_s:
                raise CameraError(f"camera {name} is held by another program, waited {self._control_s:g} s for it")
            self._say(f"camera {name} is locked by another client; waiting for its heartbeat to run out")

    def _opened(self, name: str) -> int:
        try:
            return self._library.call("arv_camera_new", name.encode())
        except CameraError as error:
            there = ", ".join(camera.identifier for camera in list_cameras()) or "none"
            raise CameraError(f"camera {name} cannot be opened ({error}); cameras found: {there}") from None

    def _set_pixel_format(self, name: str) -> None:
        if name not in PIXELS:
            raise BadInput(f"a pixel format must be one of {', '.join(PIXELS)}, got {name!r}")
        self._library.call("arv_camera_set_pixel_format_from_string", self._camera, name.encode())

    def _set_size(self, rows: int | None, columns: int | None) -> None:
        most_columns, most_rows = self._library.pair("arv_camera_get_sensor_size", self._open, ctypes.c_int)
        rows, columns = rows or most_rows, columns or most_columns
        if rows > most_rows or columns > most_columns:
            raise BadInput(
                f"a picture must fit into the sensor's {most_rows} rows and {most_columns} columns, "
                f"got {rows} and {columns}"
            )
        self._library.call("arv_camera_set_region", self._camera, 0, 0, columns, rows)

    def _set_number(self, feature: str, word: str, unit: str, value: float | None) -> None:
        if value is None:
            return
        low, high = self._library.pair(f"arv_camera_get_{feature}_bounds", self._open)
        if not low <= value <= high:
            raise BadInput(f"{word} of camera {self.identifier} must lie in {low:g}..{high:g} {unit}, got {value:g}")
        self._library.call(f"arv_camera_set_{feature}", self._camera, value)
        is_value = self._library.call(f"arv_camera_get_{feature}", self._camera)
        # Exposures step by a microsecond, raw gains by one.
        if not math.isclose(is_value, value, rel_tol=0.01, abs_tol=1.0):
            raise CameraError(
                f"camera {self.identifier} must take the {word} asked, {value:g} {unit}, but reads back {is_value:g}"
            )

    def _settings(self) -> CameraSettings:
        columns, rows = self._size()
        exposure_us, gain, rate = (self._number(name) for name in ("exposure_time", "gain", "frame_rate"))
        return CameraSettings(
            rows=rows,
            columns=columns,
            pixel_format=self._pixel_format(),
            exposure_s=exposure_us and exposure_us * 1e-6,
            gain_db=gain,
            frame_rate_hz=rate,
        )

    def _number(self, feature: str) -> float | None:
        if not self._library.call(f"arv_camera_is_{feature}_available", self._camera):
            return None
        return self._library.call(f"arv_camera_get_{feature}", self._camera)

    def _size(self) -> tuple[int, int]:
        values = [ctypes.c_int() for _ in range(4)]
        self._library.call("arv_camera_get_region", self._camera, *map(ctypes.byref, values))
        return values[2].value, values[3].value

    def _pixel_format(self) -> str:
        return self._library.call("arv_camera_get_pixel_format_as_string", self._camera).decode()

    @property
    def _open(self) -> int:
        if self._camera is None:
            raise CameraError(f"camera {self.identifier} must be opened with a with block before it is used")
        return self._camera

    def release(self, thing: int) -> None:
        """Give up a camera or a stream; a dead camera's in the background."""
        if self._dead:
            # Letting go of a dead camera repeats its farewell for seconds; the gate must not wait for that.
            threading.Thread(target=self._library.release, args=(thing,), daemon=True).start()
        else:
            self._library.release(thing)


def _only_camera() -> str:
    found = [camera.identifier for camera in list_cameras()]
    if len(found) != 1:
        raise CameraError(f"a camera must be named unless there is exactly one, found {', '.join(found) or 'none'}")
    return found[0]
