"""Grey images from the memory of V4L2 buffers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.v4l2.fields import FIRST_ROW, weave
from drivers.cameras.v4l2.structures import BIG_ENDIAN, code_of, four_letters
from labdata.errors import BadInput

MOST_PIXELS_A_SIDE = 65536


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Position of the grey values in memory."""

    name: str  #: Name of the format, as in `labdata.capture.PIXEL_BITS`
    kind: str = "u1"  #: NumPy type of one value
    first: int = 0  #: Position of the first value of a row, and distance to the next one, in values
    step: int = 1  #: Position of the first value of a row, and distance to the next one, in values
    #: Size of the complete image relative to the plane of grey values, dimensionless
    planes: float = 1.0

    @property
    def is_video(self) -> bool:
        """Whether it is the luma of colour video, black 16 and white 235 of 255 (ITU-R BT.601)."""
        return self.name != "Mono8" and self.kind == "u1"

    def row_bytes(self, columns: int) -> int:
        """Return the bytes of one row."""
        return columns * self.step * np.dtype(self.kind).itemsize


def _layouts() -> dict[int, Layout]:
    grey = {"GREY": Layout(name="Mono8")}
    grey |= {f"Y{bits} ": Layout(name=f"Mono{bits}", kind="<u2") for bits in (10, 12, 14, 16)}
    pairs = {name: Layout(name=name, step=2) for name in ("YUYV", "YVYU")}
    pairs |= {name: Layout(name=name, step=2, first=1) for name in ("UYVY", "VYUY")}
    planar = {name: Layout(name=name, planes=1.5) for name in ("NV12", "NV21", "YU12", "YV12")}
    planar |= {name: Layout(name=name, planes=2.0) for name in ("NV16", "422P")}
    known = {code_of(letters): layout for letters, layout in (grey | pairs | planar).items()}
    return known | {code_of("Y16 ") | BIG_ENDIAN: Layout(name="Mono16", kind=">u2")}


LAYOUTS = _layouts()  # Supported formats by the kernel's number, in order of preference


@dataclass(frozen=True, kw_only=True)
class BufferImage:
    """Layout of one image in a buffer."""

    rows: int  #: Size of the image, px
    columns: int  #: Size of the image, px
    row_bytes: int  #: Bytes from one row to the next
    layout: Layout  #: Position of the grey values
    #: First row of the field stored first, 0 (top) or 1 (bottom), for fields one after the other;
    #: None for interleaved rows
    first_field: int | None = None

    def __post_init__(self) -> None:
        if not (0 < self.rows <= MOST_PIXELS_A_SIDE and 0 < self.columns <= MOST_PIXELS_A_SIDE):
            raise BadInput(
                f"a picture must have 1 to {MOST_PIXELS_A_SIDE} rows and columns, got {self.rows} "
                f"and {self.columns}"
            )
        least_bytes = self.layout.row_bytes(self.columns)
        if not least_bytes <= self.row_bytes <= 16 * least_bytes + 65536:
            raise BadInput(
                f"a row of {self.columns} {self.layout.name} pixels must take {least_bytes} bytes, "
                f"got {self.row_bytes}"
            )
        if self.first_field is not None and (self.rows % 2 or self.layout.planes != 1.0):
            raise BadInput(
                f"fields one after the other must be halves of one plane, got {self.rows} rows of "
                f"{self.layout.name}"
            )

    @property
    def size_bytes(self) -> int:
        """Bytes of a complete image, colour included."""
        # The last row may be unpadded.
        plane = (self.rows - 1) * self.row_bytes + self.layout.row_bytes(self.columns)
        return (
            plane
            if self.layout.planes == 1.0
            else int(self.rows * self.row_bytes * self.layout.planes)
        )

    def grey(self, data: NDArray[np.uint8]) -> NDArray:
        """Return the grey values of at least `size_bytes` bytes, shape (row, col), DN, uint8 or
        uint16.
        """
        kind, layout = np.dtype(self.layout.kind), self.layout
        plane = np.zeros((self.rows, self.row_bytes), np.uint8)
        available = data[: plane.size]
        plane.reshape(-1)[: len(available)] = available
        values = (
            plane[:, : layout.row_bytes(self.columns)]
            .copy()
            .view(kind)[:, layout.first :: layout.step]
        )
        rows = values.astype(kind.newbyteorder("="), copy=True)
        if self.first_field is None:
            return rows
        return weave(rows[: self.rows // 2], rows[self.rows // 2 :], first_row=self.first_field)


def picture_of(form: Any) -> BufferImage:
    """Return the image layout of a kernel format; an unsupported one is a BadInput."""
    pix = form.of.pix
    if pix.pixelformat not in LAYOUTS:
        known = ", ".join(dict.fromkeys(layout.name for layout in LAYOUTS.values()))
        raise BadInput(
            f"a pixel format must be one of {known}, got {four_letters(pix.pixelformat)!r}"
        )
    layout = LAYOUTS[pix.pixelformat]
    return BufferImage(
        rows=pix.height,
        columns=pix.width,
        row_bytes=pix.bytesperline or layout.row_bytes(pix.width),
        layout=layout,
        first_field=FIRST_ROW.get(pix.field),
    )
