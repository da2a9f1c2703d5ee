"""GigE Vision or USB3 Vision camera through Aravis, every setting read back."""

import ctypes
import math
from collections.abc import Callable
from typing import Self

from drivers.cameras.aravis.capture import PIXELS, AravisCapture
from drivers.cameras.aravis.connection import HEARTBEAT_S, Connection, only_camera
from drivers.errors import CameraError
from labdata import BadInput, CameraSettings


class AravisCamera:
    """A camera reached through Aravis; use it in a `with` block.

    Parameters
    ----------
    name
        Aravis identifier, such as "Aravis-Fake-GV01", or IP address; None: the only camera.
    resend
        Whether missing packets are requested again (GigE Vision).
    silence_s
        Longest time without a frame before the camera counts as dead, s; exposure and four frame
        periods are added.
    control_s
        Longest wait for a camera in use by another program, s; that of a dead client is released
        after its heartbeat.
    say
        Called with a sentence if opening takes long.
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
        self._open: Connection | None = None

    @property
    def identifier(self) -> str:
        """The camera's Aravis identifier."""
        return self._name or "camera"

    @property
    def connection(self) -> Connection:
        """Connection to the open camera."""
        if self._open is None:
            raise CameraError(
                f"camera {self.identifier} must be opened with a with block before it is used"
            )
        return self._open

    def __enter__(self) -> Self:
        self._name = self._name or only_camera()
        self._open = Connection(self._name, control_s=self._control_s, say=self._say)
        return self

    def __exit__(self, *_: object) -> None:
        connection, self._open = self._open, None
        if connection is not None:
            connection.close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None and return the read-back of all.

        A value outside the camera's range is BadInput, a refused one or another read-back
        CameraError.
        """
        features = AravisSettings(self.connection)

        def apply_settings() -> CameraSettings:
            features.apply(settings)
            return features.read()

        self.connection.require_alive()
        return self.connection.while_alive(apply_settings)

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> AravisCapture:
        """Return a capture of `frames` complete frames after `discard` discarded ones."""
        self.connection.require_alive()
        settings = self.connection.while_alive(AravisSettings(self.connection).read, while_waiting)
        period_s = 1.0 / settings.frame_rate_hz if settings.frame_rate_hz else 0.0
        return AravisCapture(
            self.connection,
            settings=settings,
            patience_s=self._silence_s + 4 * period_s + (settings.exposure_s or 0.0),
            resend=self._resend,
            frames=frames,
            discard=discard,
            while_waiting=while_waiting,
        )


class AravisSettings:
    """Settings of an open camera, each set and read back."""

    def __init__(self, connection: Connection) -> None:
        self._library, self._camera, self._identifier = (
            connection.library,
            connection.camera,
            connection.identifier,
        )

    def apply(self, settings: CameraSettings) -> None:
        """Apply the settings that are not None; a value that the camera does not allow is a
        BadInput.
        """
        if settings.pixel_format is not None:
            self._set_pixel_format(settings.pixel_format)
        self._set_region(settings)
        if settings.trigger is not None:
            self._set_trigger(settings.trigger)
        self._require_no_fields(settings)
        self._set_number("frame_rate", "frame rate", "Hz", settings.frame_rate_hz)
        self._set_number(
            "exposure_time", "exposure", "us", settings.exposure_s and settings.exposure_s * 1e6
        )
        self._set_number("gain", "gain", "dB", settings.gain_db)

    def read(self) -> CameraSettings:
        """Return every setting as the camera reads it back."""
        first_column, first_row, columns, rows = self._region()
        exposure_us, gain, rate = (
            self._number(name) for name in ("exposure_time", "gain", "frame_rate")
        )
        return CameraSettings(
            rows=rows,
            columns=columns,
            first_row=first_row,
            first_column=first_column,
            pixel_format=self._pixel_format(),
            exposure_s=exposure_us and exposure_us * 1e-6,
            gain_db=gain,
            frame_rate_hz=rate,
            trigger=self._trigger(),
        )

    def _set_pixel_format(self, name: str) -> None:
        if name not in PIXELS:
            raise BadInput(f"a pixel format must be one of {', '.join(PIXELS)}, got {name!r}")
        self._library.call("arv_camera_set_pixel_format_from_string", self._camera, name.encode())

    def _set_region(self, settings: CameraSettings) -> None:
        """Set position and size of the image; None leaves a value unchanged."""
        asked = (settings.first_column, settings.first_row, settings.columns, settings.rows)
        if all(part is None for part in asked):
            return
        column, row, columns, rows = (
            now if part is None else part for part, now in zip(asked, self._region(), strict=True)
        )
        most_columns, most_rows = self._library.pair(
            "arv_camera_get_sensor_size", self._camera, ctypes.c_int
        )
        if row + rows > most_rows or column + columns > most_columns:
            raise BadInput(
                f"a picture must fit into the sensor's {most_rows} rows and {most_columns} "
                f"columns, got {rows} rows from row {row} and {columns} columns from column "
                f"{column}"
            )
        self._library.call("arv_camera_set_region", self._camera, column, row, columns, rows)
        if (is_now := self._region()) != (column, row, columns, rows):
            raise CameraError(
                f"camera {self._identifier} must accept the requested region (column, row, "
                f"columns, rows), {(column, row, columns, rows)}, but reads back {is_now}"
            )

    def _set_trigger(self, source: str) -> None:
        """Set free-running frames ("off"), or a trigger source."""
        if source == "off":
            self._library.call("arv_camera_clear_triggers", self._camera)
        else:
            self._library.call("arv_camera_set_trigger", self._camera, source.encode())
        if (is_now := self._trigger()) != source:
            raise CameraError(
                f"camera {self._identifier} must accept the requested trigger, {source!r}, but "
                f"reads back {is_now!r}"
            )

    def _require_no_fields(self, settings: CameraSettings) -> None:
        if settings.field_order not in (None, "progressive"):
            raise BadInput(
                f"the field order of camera {self._identifier} cannot be set, GenICam has none, "
                f"got {settings.field_order!r}"
            )

    def _set_number(self, feature: str, word: str, unit: str, value: float | None) -> None:
        if value is None:
            return
        low, high = self._library.pair(f"arv_camera_get_{feature}_bounds", self._camera)
        if not low <= value <= high:
            raise BadInput(
                f"{word} of camera {self._identifier} must lie in {low:g}..{high:g} {unit}, got "
                f"{value:g}"
            )
        self._library.call(f"arv_camera_set_{feature}", self._camera, value)
        is_value = self._library.call(f"arv_camera_get_{feature}", self._camera)
        # Exposures have steps of 1 us, raw gains of 1.
        if not math.isclose(is_value, value, rel_tol=0.01, abs_tol=1.0):
            raise CameraError(
                f"camera {self._identifier} must accept the requested {word}, {value:g} {unit}, "
                f"but reads back {is_value:g}"
            )

    def _number(self, feature: str) -> float | None:
        if not self._library.call(f"arv_camera_is_{feature}_available", self._camera):
            return None
        return self._library.call(f"arv_camera_get_{feature}", self._camera)

    def _region(self) -> tuple[int, int, int, int]:
        """Return first column, first row, columns and rows."""
        values = [ctypes.c_int() for _ in range(4)]
        self._library.call("arv_camera_get_region", self._camera, *map(ctypes.byref, values))
        column, row, columns, rows = (value.value for value in values)
        return column, row, columns, rows

    def _trigger(self) -> str | None:
        """Return the trigger source; "off" for free-running frames, None if unknown."""
        if not self._library.call("arv_camera_is_feature_available", self._camera, b"TriggerMode"):
            return None
        if self._library.call("arv_camera_get_string", self._camera, b"TriggerMode") != b"On":
            return "off"
        return self._library.call("arv_camera_get_trigger_source", self._camera).decode()

    def _pixel_format(self) -> str:
        return self._library.call("arv_camera_get_pixel_format_as_string", self._camera).decode()
