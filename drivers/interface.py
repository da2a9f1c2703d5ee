"""What acquisition asks of a rig: a camera whose frames carry their own numbers, a bench, and an operator."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labdata.capture import CameraSettings, Frame, LostFrames
from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target


class Capture(Iterable[Frame], AbstractContextManager["Capture"], Protocol):
    """A running capture: iterate it for whole frames; frames that arrive in part are counted, never handed out."""

    @property
    def lost_frames(self) -> int:
        """Frames numbered by the camera since the first one and not whole."""
        ...

    @property
    def losses(self) -> tuple[LostFrames, ...]:
        """The same frames with their numbers and why they are not whole."""
        ...


class Camera(Protocol):
    """A camera, open between `with` and the end of its block."""

    @property
    def identifier(self) -> str:
        """What the camera calls itself."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set what is not None and return every setting as the camera reads it back."""
        ...

    def capture(self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None) -> Capture:
        """Start exposing, throw away the first `discard` whole frames, hand out the next `frames`, and stop.

        `while_waiting` is called at least every 0.1 s while no frame comes; what it raises ends the capture.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class FrameLevels:
    """How bright a frame is."""

    mean: float
    """Mean pixel value, of full scale."""
    saturated: float
    """Share of pixels at full scale, 0..1."""
    allowed: float = 0.0
    """Share that its step allows, 0..1."""

    @classmethod
    def of(cls, pixels: NDArray, full_scale_dn: float, *, allowed: float = 0.0) -> "FrameLevels":
        """Return the levels of a frame, shape (row, col), DN."""
        saturated = float(np.count_nonzero(pixels >= full_scale_dn)) / pixels.size
        return cls(mean=float(pixels.mean()) / full_scale_dn, saturated=saturated, allowed=allowed)


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

    def read_meters(self) -> tuple[Conditions, tuple[str, ...]]:
        """Read the auxiliary meters, and return a sentence for each that does not answer and is not needed."""
        ...

    @property
    def dark_seen(self) -> bool:
        """Whether a dark frame was seen through the open gate since the bench was opened; no light is set before."""
        ...

    def dark_frame_seen(self, levels: FrameLevels) -> bool:
        """Report a frame taken without light, and return `dark_seen`; one that is not dark is a BenchError."""
        ...

    def frame_seen(self, levels: FrameLevels) -> None:
        """Report how much of a frame is saturated, waiting for nothing."""
        ...

    def verify(self) -> None:
        """Compare gate and supply with what was set; a difference is a BenchError, and the tube is made safe."""
        ...

    def check(self) -> None:
        """Show a sign of life of the run, and raise what went wrong at the bench since the last look."""
        ...

    def patience(self, seconds: float) -> AbstractContextManager[None]:
        """Announce that no sign of life may come for some seconds; the gate must be shut."""
        ...

    def safe(self) -> None:
        """Shut the gate and order the high voltage off."""
        ...

    def safe_at_once(self) -> None:
        """Order the same and wait for nothing, from any thread."""
        ...

    @property
    def last_words(self) -> str:
        """How the tube was left, and what to do by hand where it may be hot; empty before it was made safe."""
        ...


class Operator(Protocol):
    """Whoever puts targets and light before the camera."""

    @property
    def is_by_hand(self) -> bool:
        """Whether it is a person who sets the light, for whom the gate is shut meanwhile."""
        ...

    while_waiting: Callable[[], None]
    """Called at least every 0.1 s while it waits for a person; what it raises ends the waiting."""

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
