"""What acquisition asks of a rig: a camera whose frames carry their own numbers, a bench, and an operator."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from numpy.typing import NDArray

from drivers.errors import BenchError
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frames import read_only
from labdata.session import Kind
from labdata.target import Target


class CameraError(BenchError):
    """A camera is missing, is held by another program, refuses a setting, or stopped sending."""


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """Settings of a camera; None leaves a setting as it is.

    Parameters
    ----------
    rows, columns
        Size of the picture, px.
    pixel_format
        GenICam name such as "Mono8" or "Mono16".
    exposure_s
        Exposure of one field or frame, s.
    gain_db
        Gain behind the sensor, dB (a camera with a raw gain counts it in its own steps).
    frame_rate_hz
        Frames per second, Hz.
    """

    rows: int | None = None
    columns: int | None = None
    pixel_format: str | None = None
    exposure_s: float | None = None
    gain_db: float | None = None
    frame_rate_hz: float | None = None

    def __post_init__(self) -> None:
        for name in ("rows", "columns", "exposure_s", "frame_rate_hz"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise BadInput(f"{name} of a camera must be positive, got {value:g}")


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One whole frame as the camera sent it.

    Parameters
    ----------
    pixels
        Pixel values, shape (row, col), DN. Made read-only.
    number
        The camera's own running number; a gap is a lost frame.
    time_s
        The camera's own time stamp, s.
    """

    pixels: NDArray
    number: int
    time_s: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", read_only(self.pixels))


class Capture(Protocol):
    """A running capture: iterate it for whole frames; frames that arrive in part are counted, never handed out."""

    @property
    def lost_frames(self) -> int:
        """Frames numbered by the camera since the first one and not whole."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Camera(Protocol):
    """A camera, open between `with` and the end of its block."""

    @property
    def identifier(self) -> str:
        """What the camera calls itself."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set what is not None and return every setting as the camera reads it back."""
        ...

    def capture(self, *, frames: int, discard: int = 0) -> Capture:
        """Start exposing, throw away the first `discard` whole frames, hand out the next `frames`, and stop."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Bench(Protocol):
    """Gate and gain of the tube, made safe by leaving its block."""

    def set_conditions(self, conditions: Conditions) -> Conditions:
        """Set gate and gain, and return what the instruments read back."""
        ...

    def safe(self) -> None:
        """Close the gate and order the high voltage off."""
        ...


@dataclass(frozen=True, kw_only=True)
class Light:
    """Light on the photocathode as its meter reads it.

    Parameters
    ----------
    illuminance_lux
        Reading of the meter, lux at 2856 K.
    relative_sd
        Relative standard uncertainty of the meter's calibration, dimensionless; None if unknown.
    """

    illuminance_lux: float
    relative_sd: float | None = None


class Operator(Protocol):
    """Whoever puts targets and light before the camera."""

    def place(self, *, kind: Kind, target: Target, illuminance_lux: float) -> Light:
        """Put a target before the camera, set the light (0: dark), and return what the meter reads."""
        ...
