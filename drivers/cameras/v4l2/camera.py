"""A camera or capture card of Linux (V4L2): settings read back, and frames that are whole or counted lost."""

from collections.abc import Callable
from types import TracebackType
from typing import Literal, Self

from drivers.cameras.v4l2 import requests
from drivers.cameras.v4l2.capture import V4l2Capture
from drivers.cameras.v4l2.controls import Control, list_controls, read_control, write_control
from drivers.cameras.v4l2.device import Device, KernelDevice, query_device
from drivers.cameras.v4l2.fields import ALTERNATE, STANDARDS
from drivers.cameras.v4l2.listing import capture_capability
from drivers.cameras.v4l2.pixels import picture_of
from drivers.cameras.v4l2.settings import V4l2Settings
from drivers.cameras.v4l2.structures import words
from drivers.interface import CameraError
from labdata.capture import CameraSettings
from labdata.errors import BadInput

BEGINS = 3.0
"""Silence allowed before the first frame, besides, over that between frames."""

LONGEST_WAIT_S = 600.0
"""Longest wait for a frame beyond the silence allowed, whatever period and exposure a driver tells, s."""


class V4l2Camera:
    """A camera reached through the kernel's video interface; use it in a `with` block.

    Frame numbers and time stamps (s, of the kernel's monotonic clock) are the driver's. A driver that does not number
    the frames it drops cannot be caught at it.

    Parameters
    ----------
    path
        File of the device.
    input_number
        Input of a capture card; None leaves it as it is.
    video_lines
        Lines of the analogue video on that input, 525 (NTSC) or 625 (PAL); None leaves them as they are.
    silence_s
        Longest time without a frame before the camera is taken for dead, s; the exposure and four frame periods come
        on top, and before the first frame three times as much: cameras on USB take a second and more to begin.
    open_device
        Opens the device; another one in tests.

    Raises
    ------
    CameraError
        On entering: if the device is not there, may not be opened, or cannot capture.
    """

    def __init__(
        self,
        path: str = "/dev/video0",
        *,
        input_number: int | None = None,
        video_lines: Literal[525, 625] | None = None,
        silence_s: float = 0.5,
        open_device: Callable[[str], Device] = KernelDevice,
    ) -> None:
        self._path, self._input, self._silence_s = path, input_number, silence_s
        self._video_lines, self._open_device = video_lines, open_device
        self._device: Device | None = None
        self._card = ""

    @property
    def identifier(self) -> str:
        """Name of the device and its file."""
        return f"{self._card} ({self._path})" if self._card else self._path

    def __enter__(self) -> Self:
        self._device = device = self._open_device(self._path)
        try:
            self._card = words(capture_capability(device, self._path).card)
            if self._input is not None:
                self._choose(device, self._input)
            if self._video_lines is not None:
                standard = requests.SET_STANDARD.structure(STANDARDS[self._video_lines])
                rule = f"camera {self.identifier} must take video of {self._video_lines} lines"
                query_device(device, requests.SET_STANDARD, standard, rule)
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set what is not None and return every setting as read back.

        Raises
        ------
        BadInput
            If a value lies outside what the camera offers.
        CameraError
            If the camera refuses, or reads back something else than was asked.
        """
        own = V4l2Settings(self._open, self.identifier)
        own.apply(settings)
        return own.read()

    def controls(self) -> tuple[Control, ...]:
        """Return the controls that the camera offers."""
        return list_controls(self._open)

    def control(self, name: str) -> int:
        """Return the value of a control, by its name."""
        return read_control(self._open, self._named(name))

    def set_control(self, name: str, value: int) -> int | None:
        """Set a control by its name and return what it reads back; None for a button."""
        return write_control(self._open, self._named(name), value)

    def capture(self, *, frames: int, discard: int = 0) -> V4l2Capture:
        """Return a capture of `frames` whole frames after `discard` whole ones that are thrown away."""
        if frames < 1 or discard < 0:
            raise BadInput(f"a capture must take at least 1 frame and discard 0 or more, got {frames} and {discard}")
        own = V4l2Settings(self._open, self.identifier)
        settings, form = own.read(), own.form()
        period_s = 1.0 / settings.frame_rate_hz if settings.frame_rate_hz else 0.0
        return V4l2Capture(
            self._open,
            picture=picture_of(form),
            standard=own.standard(),
            alternate=form.of.pix.field == ALTERNATE,
            frames=frames,
            discard=discard,
            patience_s=self._silence_s + min(4 * period_s + (settings.exposure_s or 0.0), LONGEST_WAIT_S),
            start_s=BEGINS * self._silence_s,
            identifier=self.identifier,
        )

    def _named(self, name: str) -> Control:
        offered = {one.name: one for one in self.controls()}
        if name not in offered:
            raise BadInput(f"a control must be one of {', '.join(offered) or 'none'}, got {name!r}")
        return offered[name]

    def _choose(self, device: Device, number: int) -> None:
        rule = f"camera {self.identifier} must have the input {number}"
        query_device(device, requests.SET_INPUT, requests.SET_INPUT.structure(number), rule)
        is_now = requests.GET_INPUT.structure()
        query_device(device, requests.GET_INPUT, is_now, f"camera {self.identifier} must tell its input")
        if is_now.value != number:
            raise CameraError(f"camera {self.identifier} must take the input asked, {number}, got {is_now.value}")

    @property
    def _open(self) -> Device:
        if self._device is None:
            raise CameraError(f"camera {self.identifier} must be opened with a with block before it is used")
        return self._device

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()
