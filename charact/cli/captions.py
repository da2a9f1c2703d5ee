"""Where captions go: near what was measured, not over it, and never over one another."""

from collections.abc import Iterator, Sequence

import numpy as np

Box = tuple[int, int, int, int]
"""Top, left, bottom, right, px."""

RING_STEP_PX, RINGS, DIRECTIONS = 14, 24, 16
# What a caption costs, in px of distance: a region's middle covered.
MIDDLE_PX, COVERED = 14, 120.0


def placed(boxes: Sequence[Box], sizes: Sequence[tuple[int, int]], frame: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return top and left of the caption of each box.

    Parameters
    ----------
    boxes
        Regions.
    sizes
        Height and width of each one's caption, px.
    frame
        Height and width of the picture, px, that captions stay in as far as they fit.

    Notes
    -----
    One after the other, each to the nearest place around the middle of its box that covers no caption before it and,
    if possible, no region's middle: there is what was measured.
    """
    taken: list[Box] = []
    places = []
    middles = [_middle(box) for box in boxes]
    for box, size in zip(boxes, sizes, strict=True):
        options = [(_cost(option, box, taken, middles), option) for option in _around(box, size, frame)]
        best = min(options, key=lambda option: option[0])[1]
        taken.append(best)
        places.append(best[:2])
    return places


def _middle(box: Box) -> tuple[float, float]:
    return 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])


def _around(box: Box, size: tuple[int, int], frame: tuple[int, ...]) -> Iterator[Box]:
    """Places around the middle of a box, kept inside the frame."""
    row, col = _middle(box)
    for ring in range(RINGS):
        for turn in range(DIRECTIONS if ring else 1):
            angle = 2.0 * np.pi * turn / DIRECTIONS
            top = row + ring * RING_STEP_PX * np.sin(angle) - 0.5 * size[0]
            left = col + 1.5 * ring * RING_STEP_PX * np.cos(angle) - 0.5 * size[1]
            top, left = (
                int(np.clip(start, 2, max(limit - length - 3, 2)))
                for start, limit, length in ((top, frame[0], size[0]), (left, frame[1], size[1]))
            )
            yield top, left, top + size[0], left + size[1]


def _cost(option: Box, box: Box, taken: list[Box], middles: list[tuple[float, float]]) -> float:
    """Return how far a place is from its box's middle, more where it covers what others need."""
    here, there = _middle(option), _middle(box)
    distance = float(np.hypot(here[0] - there[0], here[1] - there[1]))
    covered = sum(
        option[0] - MIDDLE_PX < row < option[2] + MIDDLE_PX and option[1] - MIDDLE_PX < col < option[3] + MIDDLE_PX
        for row, col in middles
    )
    over = sum(_overlap(option, other) for other in taken)
    return distance + COVERED * covered + 100.0 * over


def _overlap(one: Box, other: Box) -> float:
    """Return the covered area, px^2, gaps of 2 px counted as touching."""
    height = min(one[2], other[2]) - max(one[0], other[0]) + 2
    width = min(one[3], other[3]) - max(one[1], other[1]) + 2
    return float(max(height, 0) * max(width, 0))
