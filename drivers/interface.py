"""Protocols that acquisition requires: camera, bench and operator."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labdata import CameraSettings, Conditions, Frame, Kind, LostFrames, Target


class Capture(Iterable[Frame], AbstractContextManager["Capture"], Protocol):
    """A running capture: iterate it for complete frames; incomplete frames are counted and never
    returned.
    """

    @property
    def lost_frames(self) -> int:
        """Number of frames numbered by the camera since the first one and not complete."""
        ...

    @property
    def losses(self) -> tuple[LostFrames, ...]:
        """The same frames with numbers and causes."""
        ...


class Camera(Protocol):
    """A camera, open in its `with` block."""

    @property
    def identifier(self) -> str:
        """Name of the camera."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None and return the read-back of all."""
        ...

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> Capture:
        """Start exposing, discard the first `discard` complete frames, return the next `frames`,
        and stop.

        `while_waiting` is called at least every 0.1 s while no frame comes; an exception ends the
        capture.
        """
        ...


# Fraction of full scale above black, or above 0 where black is unknown, from which a frame's own
# maximum may be a ceiling; drift of black and brightest dark (codes without noise look alike)
CEILING_ABOVE_BLACK, CEILING = 0.03, 0.25
# Fraction of pixels at a frame's own maximum, and their ratio to those at the next lower code, that
# noise does not give: a ceiling of the data below the camera's top code
CEILING_PIXELS, CEILING_RATIO = 0.002, 2.0


@dataclass(frozen=True, kw_only=True)
class FrameLevels:
    """Levels of a frame."""

    mean: float  #: Mean pixel value, fraction of full scale
    saturated: float  #: Fraction of pixels at full scale, or at the ceiling of the data below it
    allowed: float = 0.0  #: Fraction allowed by its step

    @classmethod
    def of(
        cls,
        pixels: NDArray,
        full_scale_dn: float,
        *,
        allowed: float = 0.0,
        black_dn: float | None = None,
    ) -> "FrameLevels":
        """Return the levels of a frame, shape (row, col), DN; `black_dn`: mean of a dark, if
        known.
        """
        top = pixels.max()
        saturated = np.count_nonzero(pixels >= min(full_scale_dn, top)) / pixels.size
        floor_dn = CEILING * full_scale_dn
        if black_dn is not None:
            floor_dn = black_dn + CEILING_ABOVE_BLACK * full_scale_dn
        if top < full_scale_dn and not (
            top > floor_dn
            and saturated > CEILING_PIXELS
            and _is_ceiling(pixels, top, top - CEILING_ABOVE_BLACK * full_scale_dn)
        ):
            saturated = 0.0
        return cls(
            mean=float(pixels.mean()) / full_scale_dn, saturated=float(saturated), allowed=allowed
        )


def _is_ceiling(pixels: NDArray, top: float, near: float) -> bool:
    """Whether pixels pile up at the largest code as noise alone does not; codes below `near` are
    another part of the scene.
    """
    lower = pixels[(pixels < top) & (pixels >= near)]
    if not lower.size:
        return True
    next_lower = np.count_nonzero(lower == lower.max())
    return bool(np.count_nonzero(pixels == top) > CEILING_RATIO * next_lower)


class Bench(Protocol):
    """Gate, gain and light of the tube; leaving its `with` block makes the tube safe."""

    # Called with the manual steps while a tube that may be hot is being made safe
    say: Callable[[str], None]

    def set_conditions(self, conditions: Conditions) -> Conditions:
        """Set gate and gain behind a shut gate, and return the read-backs; `gate_ns` None or 0
        leaves it shut.
        """
        ...

    def guard(self, operator: "Operator") -> "Operator":
        """Return the operator and the bench's lamp behind the interlock; only what is returned may
        be used.
        """
        ...

    def read_meters(self) -> tuple[Conditions, tuple[str, ...]]:
        """Read the auxiliary meters; return a sentence for each optional one that does not
        answer.
        """
        ...

    @property
    def dark_seen(self) -> bool:
        """Whether a dark frame was verified through the open gate since the bench was opened;
        required before light.
        """
        ...

    def dark_frame_seen(self, levels: FrameLevels) -> bool:
        """Report a frame without light, and return `dark_seen`; BenchError if it is bright."""
        ...

    def frame_seen(self, levels: FrameLevels) -> None:
        """Report the saturation of a frame, without waiting."""

    def verify(self) -> None:
        """Compare gate and supply with their settings; a difference is a BenchError and makes the
        tube safe.
        """

    def check(self) -> None:
        """Record a heartbeat of the run, and raise an error of the bench since the last check."""

    def patience(self, seconds: float) -> AbstractContextManager[None]:
        """Suspend the heartbeat for a time; the gate must be shut."""
        ...

    def slack_s(self) -> float:
        """Return the time by which limits grow on a busy machine, s."""
        ...

    def safe(self) -> None:
        """Shut the gate and order the high voltage off."""

    def safe_at_once(self) -> None:
        """Order the safe state without waiting, from any thread; `check` is BenchStopped from then
        on.
        """

    @property
    def last_words(self) -> str:
        """Final state of the tube, with manual steps if it may be hot; empty before the safe
        action.
        """
        ...


class Operator(Protocol):
    """Person or device that places targets and sets light."""

    @property
    def is_by_hand(self) -> bool:
        """Whether a person sets the light; the gate is then shut meanwhile."""
        ...

    # Called at least every 0.1 s while it waits for a person; an exception ends the wait
    while_waiting: Callable[[], None]

    def darken(self) -> None:
        """Block the light, without waiting."""

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Place a target and set the light behind the filter, lux (0: dark); return the reading of
        the light meter.

        `filter_density` None: any suitable filter. Returns `illuminance_lux` as read, and
        `illuminance_relative_sd` of the meter's calibration, where known.
        """
        ...
