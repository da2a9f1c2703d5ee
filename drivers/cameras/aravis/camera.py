"""A GigE Vision or USB3 Vision camera through Aravis: settings read back, and frames that are whole or counted lost."""

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self, TypeVar, cast

from drivers.cameras.aravis import gige_control
from drivers.cameras.aravis.capture import SUSPICION_S, AravisCapture
from drivers.cameras.aravis.library import PACKET_SOCKET_DISABLED, Aravis, aravis
from drivers.cameras.aravis.settings import AravisSettings
from drivers.interface import CameraError
from labdata.capture import CameraSettings
from labdata.errors import BadInput

T = TypeVar("T")

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
    resend
        Whether packets that did not come are asked for again (GigE Vision).
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
        resend: bool = True,
        silence_s: float = 0.5,
        control_s: float = 2.5 * HEARTBEAT_S,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._name, self._silence_s, self._control_s, self._say = name, silence_s, control_s, say
        self._resend = resend
        self._camera: int | None = None
        self._address: str | None = None
        self._dead = False
        self._unanswered = 0
        self._act: threading.Thread | None = None

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
        features = self._features

        def applied() -> CameraSettings:
            features.apply(settings)
            return features.read()

        return self.while_alive(applied)

    def capture(self, *, frames: int, discard: int = 0) -> AravisCapture:
        """Return a capture of `frames` whole frames after `discard` whole ones that are thrown away."""
        if frames < 1 or discard < 0:
            raise BadInput(f"a capture must take at least 1 frame and discard 0 or more, got {frames} and {discard}")
        self.require_alive()
        settings = self.while_alive(self._features.read)
        period_s = 1.0 / settings.frame_rate_hz if settings.frame_rate_hz else 0.0
        return AravisCapture(
            self._library,
            self._open,
            settings=settings,
            frames=frames,
            discard=discard,
            patience_s=self._silence_s + 4 * period_s + (settings.exposure_s or 0.0),
            resend=self._resend,
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
        answer = gige_control.ask(self._address)
        if answer == "refused":
            raise self.died("has gone: nothing listens on its control port")
        self._unanswered = self._unanswered + 1 if answer == "silent" else 0
        if self._unanswered >= UNANSWERED:
            raise self.died(f"no longer answers: it left {self._unanswered} questions in a row without reply")

    def while_alive(self, act: Callable[[], T]) -> T:
        """Return what an act that speaks to the camera returns, or raise what it raises.

        The library repeats for seconds what is not answered, and the gate must not stay open for as long: where the
        camera is found dead meanwhile, that is raised and the act left to end by itself.
        """
        done: queue.SimpleQueue[tuple[T | None, BaseException | None]] = queue.SimpleQueue()

        def tried() -> None:
            try:
                done.put((act(), None))
            except BaseException as error:  # whoever waits raises it
                done.put((None, error))

        self._act = threading.Thread(target=tried, daemon=True)
        self._act.start()
        while True:
            try:
                result, error = done.get(timeout=SUSPICION_S)
            except queue.Empty:
                self.require_alive()
                continue
            if error is not None:
                raise error
            return cast(T, result)

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

    @property
    def _features(self) -> AravisSettings:
        return AravisSettings(self._library, self._open, self.identifier)

    @property
    def _open(self) -> int:
        if self._camera is None:
            raise CameraError(f"camera {self.identifier} must be opened with a with block before it is used")
        return self._camera

    def release(self, thing: int) -> None:
        """Give up a camera or a stream; a dead camera's in the background."""
        if self._dead:
            # Letting go of a dead camera repeats its farewell for seconds; the gate must not wait for that.
            threading.Thread(target=self._release_last, args=(thing, self._act), daemon=True).start()
        else:
            self._release_last(thing, self._act)

    def _release_last(self, thing: int, act: threading.Thread | None) -> None:
        """Give up a thing once the last act, which may still use it, has ended."""
        if act is not None:
            act.join()
        self._library.release(thing)


def _only_camera() -> str:
    found = [camera.identifier for camera in list_cameras()]
    if len(found) != 1:
        raise CameraError(f"a camera must be named unless there is exactly one, found {', '.join(found) or 'none'}")
    return found[0]
