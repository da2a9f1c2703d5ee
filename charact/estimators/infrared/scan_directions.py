"""Lines of a two-way scanner by their direction: each direction has a place and an electronic delay
of its own.
"""

from collections.abc import Iterator
from dataclasses import replace

from charact.method import Context
from labdata.frames import FrameStack

Region = tuple[int, int, int, int]
DIRECTIONS = ("to the right", "to the left")


def scan_directions(
    stack: FrameStack, region: Region | None, *, context: Context
) -> Iterator[tuple[str, FrameStack, Region | None, Context]]:
    """Yield the frames of each scan direction with the region and the context that belong to them.

    A camera that is no two-way scanner has one direction, "". Of a scanner, successive lines of a
    field alternate: rows 4 n and 4 n + 1 of an interlaced frame, of either field, are scanned to
    the right, 4 n + 2 and 4 n + 3 to the left; 2 n and 2 n + 1 of a frame without fields. The
    frames of one direction are interlaced like the whole ones, at twice their row pitch.

    Parameters
    ----------
    stack
        Frames, shape (frame, row, col).
    region
        ROW, COL, HEIGHT, WIDTH in these frames, px; None: the whole frame.
    context
        Settings, with the description of the imager.
    """
    imager = context.camera
    if imager is None or imager.scanner is None:
        yield "", stack, region, context
        return
    fields = 2 if context.interlaced else 1
    scanner = replace(imager.scanner, lines_per_field=max(imager.scanner.lines_per_field // 2, 1))
    direction_context = replace(context, camera=replace(imager, scanner=scanner))
    rows = 2 * fields * (stack.shape[1] // (2 * fields))
    cut = None if region is None else (region[0] // 2, region[1], region[2] // 2, region[3])
    for number, direction in enumerate(DIRECTIONS):
        sets = stack.data[:, :rows].reshape(len(stack), -1, 2, fields, stack.shape[2])[:, :, number]
        yield (
            direction,
            replace(stack, data=sets.reshape(len(stack), -1, stack.shape[2])),
            cut,
            direction_context,
        )
