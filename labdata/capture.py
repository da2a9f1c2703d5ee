"""What passes between a camera and whoever records it: settings, frames with their numbers, and the lost ones."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import read_only


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


@dataclass(frozen=True, kw_only=True)
class LostFrames:
    """Frames that follow one another, that the camera numbered, and that are not in the record.

    Parameters
    ----------
    first, last
        The camera's numbers of the first and the last of them.
    reason
        Why they are not there, in a few words, such as "missing packets".
    """

    first: int
    last: int
    reason: str

    def __post_init__(self) -> None:
        if self.last < self.first:
            raise BadInput(f"the last lost frame must not come before the first, got {self.first} to {self.last}")
        if not self.reason:
            raise BadInput(f"a lost frame must have a reason, got none for frame {self.first}")

    def __len__(self) -> int:
        return self.last - self.first + 1


NEVER_ARRIVED = "never arrived"


def losses_before(number: int, *, expected: int, faults: Mapping[int, str]) -> tuple[LostFrames, ...]:
    """Return the frames that are missing before one that is whole.

    Parameters
    ----------
    number
        Number of the frame that is whole.
    expected
        Number that it should have had.
    faults
        What was wrong with the frames that came in part, by number; any other never arrived.
    """
    return _joined((missing, faults.get(missing, NEVER_ARRIVED)) for missing in range(expected, number))


def lost_for(reason: str, numbers: Iterable[int]) -> tuple[LostFrames, ...]:
    """Return frames, by number in order, that are all lost for one reason."""
    return _joined((number, reason) for number in numbers)


def _joined(lost: Iterable[tuple[int, str]]) -> tuple[LostFrames, ...]:
    """Join lost frames, number and reason, that follow one another and have the same reason."""
    runs: list[tuple[int, int, str]] = []
    for number, reason in lost:
        if runs and runs[-1][1:] == (number - 1, reason):
            runs[-1] = (runs[-1][0], number, reason)
        else:
            runs.append((number, number, reason))
    return tuple(LostFrames(first=first, last=last, reason=reason) for first, last, reason in runs)
