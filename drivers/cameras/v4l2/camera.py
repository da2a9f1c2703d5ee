"""Linux camera or capture card (V4L2), every setting read back."""

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any, Literal, Self

from drivers.cameras.v4l2 import fields, listing, structures
from drivers.cameras.v4l2.capture import V4l2Capture
from drivers.cameras.v4l2.device import Device, offers, query_device
from drivers.cameras.v4l2.listing import Control, capture_capability, format_codes, list_sizes
from drivers.cameras.v4l2.pixels import LAYOUTS, BufferImage, picture_of
from drivers.cameras.v4l2.structures import CAPTURE, Format, StreamParameters, words
from drivers.errors import CameraError
from labdata import BadInput, CameraSettings

# Longest wait for a frame beyond `silence_s`, for any reported period and exposure, s
LONGEST_WAIT_S = 600.0


class V4l2Camera:
    """A camera of the kernel's video interface; use it in a `with` block.

    Frame numbers and time stamps (s, kernel's monotonic clock) are those of the driver. Frames
    dropped without a number by the driver cannot be detected.

    Parameters
    ----------
    path
        Device file.
    input_number
        Input of a capture card; None leaves it as it is.
    video_lines
        Lines of the analogue video on that input, 525 (NTSC) or 625 (PAL); None leaves them as they
        are.
    silence_s
        Longest time without a frame before the camera counts as dead, s; exposure and four frame
        periods are added, and three times as much before the first frame: USB cameras take a second
        or more to start.
    """

    def __init__(
        self,
        path: str = "/dev/video0",
        *,
        input_number: int | None = None,
        video_lines: Literal[525, 625] | None = None,
        silence_s: float = 0.5,
        open_device: Callable[[str], Device] = Device,
    ) -> None:
        self._path, self._input, self._silence_s = path, input_number, silence_s
        self._video_lines, self._open_device = video_lines, open_device
        self._device: Device | None = None
        self._card = ""

    @property
    def identifier(self) -> str:
        """Name of the device and its device file."""
        return f"{self._card} ({self._path})" if self._card else self._path

    def __enter__(self) -> Self:
        self._device = device = self._open_device(self._path)
        try:
            self._card = words(capture_capability(device, self._path).card)
            if self._input is not None:
                self._choose(device, self._input)
            if self._video_lines is not None:
                standard = structures.SET_STANDARD.structure(fields.STANDARDS[self._video_lines])
                rule = f"camera {self.identifier} must take video of {self._video_lines} lines"
                query_device(device, structures.SET_STANDARD, standard, rule)
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None and return the read-back of all.

        A value outside the camera's range is BadInput, a refused one or another read-back
        CameraError.
        """
        device_settings = V4l2Settings(self._open, self.identifier)
        device_settings.apply(settings)
        return device_settings.read()

    def controls(self) -> tuple[Control, ...]:
        """Return the controls of the camera."""
        return listing.list_controls(self._open)

    def control(self, name: str) -> int:
        """Return the value of a control, by its name."""
        return listing.read_control(self._open, self._control_named(name))

    def set_control(self, name: str, value: int) -> int | None:
        """Set a control by its name and return its read-back; None for a button."""
        return listing.write_control(self._open, self._control_named(name), value)

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> V4l2Capture:
        """Return a capture of `frames` complete frames after `discard` discarded ones."""
        device_settings = V4l2Settings(self._open, self.identifier)
        settings, form = device_settings.read(), device_settings.form()
        period_s = 1.0 / settings.frame_rate_hz if settings.frame_rate_hz else 0.0
        return V4l2Capture(
            self._open,
            form=form,
            standard=device_settings.standard(),
            patience_s=self._silence_s
            + min(4 * period_s + (settings.exposure_s or 0.0), LONGEST_WAIT_S),
            start_s=3.0
            * self._silence_s,  # Additional wait for the first frame, as a multiple of `silence_s`
            frames=frames,
            discard=discard,
            while_waiting=while_waiting,
            identifier=self.identifier,
        )

    def _control_named(self, name: str) -> Control:
        offered = {control.name: control for control in self.controls()}
        if name not in offered:
            raise BadInput(f"a control must be one of {', '.join(offered) or 'none'}, got {name!r}")
        return offered[name]

    def _choose(self, device: Device, number: int) -> None:
        rule = f"camera {self.identifier} must have the input {number}"
        query_device(device, structures.SET_INPUT, structures.SET_INPUT.structure(number), rule)
        is_now = structures.GET_INPUT.structure()
        query_device(
            device, structures.GET_INPUT, is_now, f"camera {self.identifier} must report its input"
        )
        if is_now.value != number:
            raise CameraError(
                f"camera {self.identifier} must accept the requested input, {number}, got "
                f"{is_now.value}"
            )

    @property
    def _open(self) -> Device:
        if self._device is None:
            raise CameraError(
                f"camera {self.identifier} must be opened with a with block before it is used"
            )
        return self._device

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()


class V4l2Settings:
    """Settings of an open device, each set and read back."""

    def __init__(self, device: Device, identifier: str) -> None:
        self._device, self._identifier = device, identifier

    def apply(self, settings: CameraSettings) -> None:
        """Apply the settings that are not None; a value that the camera does not allow is a
        BadInput.
        """
        if settings.first_row or settings.first_column:
            raise BadInput(
                f"a picture of camera {self._identifier} must begin at row 0 and column 0, "
                f"got {settings.first_row} and {settings.first_column}"
            )
        if settings.trigger not in (None, "off"):
            raise BadInput(
                f"camera {self._identifier} must run freely, V4L2 has no trigger, got "
                f"{settings.trigger!r}"
            )
        self._set_format(settings)
        if settings.frame_rate_hz is not None:
            self._set_frame_rate(settings.frame_rate_hz)
        if settings.exposure_s is not None:
            self._set_exposure(settings.exposure_s)
        if settings.gain_db is not None:
            self._set_gain(settings.gain_db)

    def read(self) -> CameraSettings:
        """Return every setting as the camera reads it back."""
        form = self.form()
        picture = picture_of(form)
        exposure, gain = (self._value(control) for control in (listing.EXPOSURE, listing.GAIN))
        return CameraSettings(
            rows=fields.rows_of(picture.rows, form.of.pix.field),
            columns=picture.columns,
            first_row=0,
            first_column=0,
            pixel_format=picture.layout.name,
            exposure_s=exposure * listing.EXPOSURE_UNIT_S if exposure else None,
            gain_db=None if gain is None else float(gain),
            frame_rate_hz=self._frame_rate_hz(),
            trigger="off",
            field_order=fields.field_order(form.of.pix.field, self.standard()),
            notes=self._notes(form, picture),
        )

    def form(self) -> Any:
        """Return the format in force."""
        form = Format(type=CAPTURE)
        self._query(structures.GET_FORMAT, form, "must report its image format")
        return form

    def standard(self) -> int:
        """Return the video standards of the input, as the kernel's bits; 0 where it has none."""
        standard = structures.GET_STANDARD.structure()
        return standard.value if offers(self._device, structures.GET_STANDARD, standard) else 0

    def _set_format(self, settings: CameraSettings) -> None:
        wanted = (settings.rows, settings.columns, settings.pixel_format, settings.field_order)
        if all(part is None for part in wanted):
            return
        before = self.form()
        form = Format.from_buffer_copy(before)
        pix = form.of.pix
        rows, pix.width = (
            settings.rows or fields.rows_of(pix.height, pix.field),
            settings.columns or pix.width,
        )
        pix.pixelformat = self._code(settings.pixel_format, now=pix.pixelformat)
        if settings.field_order is not None:
            pix.field = fields.NUMBERS[settings.field_order]
        pix.height = rows // fields.rows_of(1, pix.field)
        # The driver derives these from the others.
        pix.bytesperline = pix.sizeimage = 0
        rule = "must take a picture format"
        self._query(structures.SET_FORMAT, form, rule)
        if complaint := self._complaint(settings, form, code=pix.pixelformat):
            self._query(structures.SET_FORMAT, before, rule)
            raise BadInput(complaint)

    def _query(self, request: structures.Request, structure: Any, rule: str) -> None:
        query_device(self._device, request, structure, f"camera {self._identifier} {rule}")

    def _complaint(self, settings: CameraSettings, form: Any, *, code: int) -> str | None:
        """Return the first difference between the format in force and the requested one; None if
        there is none.
        """
        pix = form.of.pix
        rows_read = fields.rows_of(pix.height, pix.field)
        rows, columns = settings.rows or rows_read, settings.columns or pix.width
        if (rows_read, pix.width) != (rows, columns):
            sizes = list_sizes(self._device, code)
            offered = (
                ", ".join(f"{size_rows}x{size_columns}" for size_rows, size_columns in sizes)
                or "others"
            )
            return (
                f"a picture of camera {self._identifier} must have rows and columns that it "
                f"offers ({offered}), got {rows}x{columns}, which it makes {rows_read}x{pix.width}"
            )
        if settings.field_order is not None:
            order = fields.field_order(pix.field, self.standard())
            if order != settings.field_order:
                return (
                    f"camera {self._identifier} must accept the requested field order, "
                    f"{settings.field_order!r}, but reads back {order!r}"
                )
        if settings.pixel_format is not None and pix.pixelformat not in self._codes(
            settings.pixel_format
        ):
            return (
                f"camera {self._identifier} must accept the pixel format {settings.pixel_format}, "
                "it does not"
            )
        return None

    def _code(self, name: str | None, *, now: int) -> int:
        """Return the kernel's number of a pixel format; 8-bit grey may be the luma of video."""
        if name is None:
            return now
        codes = self._codes(name)
        if not codes:
            names = dict.fromkeys(
                LAYOUTS[code].name for code in format_codes(self._device) if code in LAYOUTS
            )
            offered = ", ".join(names) or "none"
            raise BadInput(
                f"a pixel format of camera {self._identifier} must be one of {offered}, got "
                f"{name!r}"
            )
        return codes[0]

    def _codes(self, name: str) -> list[int]:
        offered = format_codes(self._device)
        fitting = [code for code, layout in LAYOUTS.items() if layout.name == name]
        if name == "Mono8":
            fitting += [code for code, layout in LAYOUTS.items() if layout.is_video]
        return [code for code in fitting if code in offered]

    def _set_frame_rate(self, frame_rate_hz: float) -> None:
        before = self._parameters()
        period = Fraction(1 / frame_rate_hz).limit_denominator(100_000)
        parameters = StreamParameters(type=CAPTURE)
        parameters.of.capture.numerator, parameters.of.capture.denominator = (
            period.numerator,
            period.denominator,
        )
        rule = "must take a frame rate"
        self._query(structures.SET_PARAMETERS, parameters, rule)
        is_now = self._frame_rate_hz()
        if is_now is None or not math.isclose(is_now, frame_rate_hz, rel_tol=0.01):
            if before is not None:
                self._query(structures.SET_PARAMETERS, before, rule)
            raise BadInput(
                f"camera {self._identifier} must accept the requested frame rate, "
                f"{frame_rate_hz:g} Hz, but reads back "
                f"{'none' if is_now is None else f'{is_now:g}'}"
            )

    def _parameters(self) -> Any:
        parameters = StreamParameters(type=CAPTURE)
        return parameters if offers(self._device, structures.GET_PARAMETERS, parameters) else None

    def _frame_rate_hz(self) -> float | None:
        parameters = self._parameters()
        if parameters is None or not (
            parameters.of.capture.numerator and parameters.of.capture.denominator
        ):
            return None
        return parameters.of.capture.denominator / parameters.of.capture.numerator

    def _set_exposure(self, exposure_s: float) -> None:
        control = self._control(listing.EXPOSURE, "exposure")
        low, high = (end * listing.EXPOSURE_UNIT_S for end in (control.minimum, control.maximum))
        self._require_within("exposure", "s", exposure_s, low, high)
        self._switch(listing.EXPOSURE_MODE, listing.MANUAL_EXPOSURE)
        units = round(exposure_s / listing.EXPOSURE_UNIT_S)
        listing.write_control(self._device, self._control(listing.EXPOSURE, "exposure"), units)

    def _set_gain(self, gain: float) -> None:
        control = self._control(listing.GAIN, "gain")
        self._require_within("gain", "of its own steps", gain, control.minimum, control.maximum)
        self._switch(listing.AUTOMATIC_GAIN, 0)
        listing.write_control(self._device, self._control(listing.GAIN, "gain"), round(gain))

    def _require_within(self, word: str, unit: str, value: float, low: float, high: float) -> None:
        # Checked before automatic modes are switched off, so that a refusal leaves the camera
        # unchanged.
        if not low <= value <= high:
            raise BadInput(
                f"{word} of camera {self._identifier} must lie in {low:g}..{high:g} {unit}, got "
                f"{value:g}"
            )

    def _switch(self, identifier: int, value: int) -> None:
        """Set a mode, if the camera has it; an automatic mode would override the control set
        next.
        """
        mode = listing.find_control(self._device, identifier)
        if mode is not None and not mode.is_read_only:
            listing.write_control(self._device, mode, value)

    def _control(self, identifier: int, word: str) -> Control:
        control = listing.find_control(self._device, identifier)
        if control is None:
            raise BadInput(
                f"camera {self._identifier} must have a control for the {word} to set it, it has "
                "none"
            )
        return control

    def _value(self, identifier: int) -> int | None:
        control = listing.find_control(self._device, identifier)
        return None if control is None else listing.read_control(self._device, control)

    def _notes(self, form: Any, picture: BufferImage) -> tuple[str, ...]:
        notes = []
        if picture.layout.is_video and form.of.pix.quantization != 1:  # full range
            notes.append(
                f"grey is the luma of {picture.layout.name} video: black is 16 and white is 235 DN"
            )
        if self._value(listing.AUTOMATIC_GAIN):
            notes.append("the camera's automatic gain is on")
        if self._value(listing.EXPOSURE_MODE) not in (None, listing.MANUAL_EXPOSURE):
            notes.append("the camera's automatic exposure is on")
        return tuple(notes)
