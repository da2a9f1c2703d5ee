"""Where captions go: near what was measured, not over it, and never over one another."""

from collections.abc import Iterator, Sequence

import numpy as np

Box = tuple[int, int, int, int]
"""Top, left, bottom, right, px."""

RING_STEP_PX, RINGS, DIRECTIONS = 14, 24, 16
# Reach of the inner part of a small region, and what covering such parts with all of a caption costs in distance, px.
LEAST_HEART_PX, COVERED_PX = 14, 250.0


def place_captions(
    boxes: Sequence[Box], sizes: Sequence[tuple[int, int]], frame: tuple[int, ...]
) -> list[tuple[int, int]]:
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
    if possible, no region's inner half: there is what was measured.
    """
    taken: list[Box] = []
    places = []
    hearts = [_heart(box) for box in boxes]
    for box, size in zip(boxes, sizes, strict=True):
        options = [(_cost(option, box, taken, hearts), option) for option in _around(box, size, frame)]
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


def _heart(box: Box) -> Box:
    """Return the inner half of a box, and a little more of a small one: there is what was measured."""
    row, col = _middle(box)
    down, right = (max(0.25 * (box[k + 2] - box[k]), LEAST_HEART_PX) for k in (0, 1))
    return int(row - down), int(col - right), int(row + down), int(col + right)


def _cost(option: Box, box: Box, taken: list[Box], hearts: list[Box]) -> float:
    """Return how far a place is from its box's middle, more where it covers what others need."""
    here, there = _middle(option), _middle(box)
    distance = float(np.hypot(here[0] - there[0], here[1] - there[1]))
    area = (option[2] - option[0]) * (option[3] - option[1])
    covered = sum(_overlap(option, heart) for heart in hearts) / area
    over = sum(_overlap(option, other) for other in taken)
    return distance + COVERED_PX * covered + 100.0 * over


def _overlap(one: Box, other: Box) -> float:
    """Return the covered area, px^2, gaps of 2 px counted as touching."""
    height = min(one[2], other[2]) - max(one[0], other[0]) + 2
    width = min(one[3], other[3]) - max(one[1], other[1]) + 2
    return float(max(height, 0) * max(width, 0))
