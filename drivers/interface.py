"""What acquisition asks of a rig: a camera whose frames carry their own numbers, a bench, and an operator."""

from collections.abc import Iterator
from types import TracebackType
from typing import Protocol, Self

from numpy.typing import NDArray

from drivers.errors import BenchError
from labdata.capture import CameraSettings, Frame, LostFrames
from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target


class CameraError(BenchError):
    """A camera is missing, is held by another program, refuses a setting, or stopped sending."""


class Capture(Protocol):
    """A running capture: iterate it for whole frames; frames that arrive in part are counted, never handed out."""

    @property
    def lost_frames(self) -> int:
        """Frames numbered by the camera since the first one and not whole."""
        ...

    @property
    def losses(self) -> tuple[LostFrames, ...]:
        """The same frames with their numbers and why they are not whole."""
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


class Bench(Protocol):
    """Gate and gain of the tube, made safe by leaving its block."""

    def set_conditions(self, conditions: Conditions) -> Conditions:
        """Set gate and gain, the gate shut meanwhile, and return what the instruments read back.

        `gate_ns` None or 0 leaves the gate shut.
        """
        ...

    def guard(self, operator: "Operator") -> "Operator":
        """Put the bench's lamp, and whoever places targets and light, behind the interlock.

        Only what is returned may be used.
        """
        ...

    def read_beside(self) -> tuple[Conditions, tuple[str, ...]]:
        """Read the meters beside the tube, and return a sentence for each that does not answer and is not needed."""
        ...

    @property
    def dark_seen(self) -> bool:
        """Whether a dark frame was seen through the open gate since the bench was opened; no light is set before."""
        ...

    def saw_without_light(self, pixels: NDArray, full_scale_dn: float) -> None:
        """Look at a frame, shape (row, col), taken without light; one that is not dark is a BenchError."""
        ...

    def check(self) -> None:
        """Raise what went wrong at the bench since the last look."""
        ...

    def safe(self) -> None:
        """Close the gate and order the high voltage off."""
        ...


class Operator(Protocol):
    """Whoever puts targets and light before the camera."""

    def darken(self) -> None:
        """Block the light, waiting for nobody."""
        ...

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Put a target before the camera, set the light (0: dark), and return what the light meter reads.

        Parameters
        ----------
        kind, target
            What the frames will show.
        illuminance_lux
            On the photocathode, behind the filter, lux.
        filter_density
            Optical density of the neutral filter in the light; None: whichever suits.

        Returns
        -------
        Conditions
            `illuminance_lux` as read, and `illuminance_relative_sd` of the meter's calibration where it is known.
        """
        ...
