"""Camera settings, single frames and lost frames."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from numpy.typing import NDArray

from labdata.errors import BadInput, check
from labdata.frames import read_only

# Bits of a pixel by format name: GenICam names for grey, V4L2 FourCC for the luma of colour video
PIXEL_BITS = {
    "Mono8": 8,
    "Mono10": 10,
    "Mono12": 12,
    "Mono14": 14,
    "Mono16": 16,
    "Mono10p": 10,
    "Mono10Packed": 10,
    "Mono12p": 12,
    "Mono12Packed": 12,
    **dict.fromkeys(
        ("YUYV", "YVYU", "UYVY", "VYUY", "NV12", "NV21", "NV16", "YU12", "YV12", "422P"), 8
    ),
}

# Rows of a frame exposed first: all at once, the top field (rows 0, 2, ...), or the bottom field
FieldOrder = Literal["progressive", "top first", "bottom first", "top only", "bottom only"]


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """Settings of a camera; None leaves a setting as it is."""

    rows: int | None = None  #: Size of the image, px
    columns: int | None = None  #: Size of the image, px
    first_row: int | None = None  #: First row and column of the image on the sensor, px
    first_column: int | None = None  #: First row and column of the image on the sensor, px
    pixel_format: str | None = None  #: A name of `PIXEL_BITS`, such as "Mono8" or "Mono16"
    exposure_s: float | None = None  #: Exposure of one field or frame, s
    gain_db: float | None = None  #: Camera gain, dB (of a camera with a raw gain: its own steps)
    frame_rate_hz: float | None = None  #: Frames per second, Hz
    #: "off": free-running; else the camera's name of the trigger source, such as "Line1"
    trigger: str | None = None
    field_order: FieldOrder | None = None  #: Order of the two fields of a frame
    notes: tuple[str, ...] = ()  #: Remarks of the camera on its frames; read back, never set

    def __post_init__(self) -> None:
        positive, not_negative = "rows columns exposure_s frame_rate_hz", "first_row first_column"
        check(self, of=" of a camera", positive=positive, not_negative=not_negative)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One complete frame as sent by the camera."""

    pixels: NDArray  #: Pixel values, shape (row, col), DN. Made read-only
    number: int  #: The camera's own running number; a gap is a lost frame
    time_s: float  #: The camera's own time stamp, s
    #: Order of its two fields; None where the camera does not report it
    field_order: FieldOrder | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", read_only(self.pixels))


@dataclass(frozen=True, kw_only=True)
class LostFrames:
    """Consecutive frames that the camera numbered and that were not recorded."""

    first: int  #: The camera's numbers of the first and the last of them
    last: int  #: The camera's numbers of the first and the last of them
    reason: str  #: Cause, such as "missing packets"

    def __post_init__(self) -> None:
        if self.last < self.first:
            raise BadInput(
                f"the last lost frame must not come before the first, got {self.first} to "
                f"{self.last}"
            )
        if not self.reason:
            raise BadInput(f"a lost frame must have a reason, got none for frame {self.first}")

    def __len__(self) -> int:
        return self.last - self.first + 1


NEVER_ARRIVED = "never arrived"


def losses_before(
    number: int, *, expected: int, faults: Mapping[int, str]
) -> tuple[LostFrames, ...]:
    """Return the frames missing before the complete frame `number`; `faults` are of incomplete
    frames, by number.
    """
    return _merge_adjacent(_stretches_before(number, expected=expected, faults=faults))


def lost_frames_with_reason(reason: str, numbers: Iterable[int]) -> tuple[LostFrames, ...]:
    """Return frames, given by ascending number, lost for one common reason."""
    return _merge_adjacent((number, number, reason) for number in numbers)


def _stretches_before(
    number: int, *, expected: int, faults: Mapping[int, str]
) -> Iterator[tuple[int, int, str]]:
    """Yield missing stretches as first, last and reason; a camera may skip more than 1e9
    numbers.
    """
    missing = expected
    for faulty in sorted(fault for fault in faults if expected <= fault < number):
        if missing < faulty:
            yield missing, faulty - 1, NEVER_ARRIVED
        yield faulty, faulty, faults[faulty]
        missing = faulty + 1
    if missing < number:
        yield missing, number - 1, NEVER_ARRIVED


def _merge_adjacent(lost: Iterable[tuple[int, int, str]]) -> tuple[LostFrames, ...]:
    """Merge consecutive stretches (first, last, reason) of one reason."""
    runs: list[tuple[int, int, str]] = []
    for first, last, reason in lost:
        if runs and runs[-1][1:] == (first - 1, reason):
            runs[-1] = (runs[-1][0], last, reason)
        else:
            runs.append((first, last, reason))
    return tuple(LostFrames(first=first, last=last, reason=reason) for first, last, reason in runs)
