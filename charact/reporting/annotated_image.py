"""Annotated image: the mean frame with every region found, its MTF50 and its status, or why it has
none.
"""

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from charact.reporting.lines import in_unit
from charact.reporting.summary import Frequency, in_cycles_per_pixel
from labdata import FLAGS, BadInput, FrameStack, Measurement, Result, write_atomically

Box = tuple[int, int, int, int]
"""Top, left, bottom, right, px."""


def place_captions(
    boxes: Sequence[Box],
    sizes: Sequence[tuple[int, int]],
    frame: tuple[int, ...],
    normals_deg: Sequence[float | None] = (),
) -> list[tuple[int, int]]:
    """Return top and left of the caption of each box, from its height and width; inside the frame
    if it fits, px.

    Greedy: each caption takes the position nearest to the centre of its box that covers no earlier
    caption and, if possible, not the inner half of a region, along all of an edge whose normal is
    known.
    """
    taken: list[Box] = []
    hearts = [_inner_part(*each) for each in zip_longest(boxes, normals_deg)]
    for box, size in zip(boxes, sizes, strict=True):
        middle, area = np.array(_middle(box)), size[0] * size[1]

        length = float(np.hypot(box[2] - box[0], box[3] - box[1]))

        def cost(
            option: Box, middle: NDArray = middle, area: int = area, length: float = length
        ) -> float:
            """Return the distance from the centre of the box plus the cost of what is covered,
            px.
            """
            covered = sum(_overlap(option, heart) for heart in hearts) / area
            over = sum(_overlap(option, other) for other in taken)
            return (
                float(np.hypot(*(np.array(_middle(option)) - middle)))
                + max(250.0, length) * covered
                + 100.0 * over
            )

        taken.append(min(_around(box, size, frame), key=cost))
    return [place[:2] for place in taken]


def _middle(box: Box) -> tuple[float, float]:
    return 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])


def _around(box: Box, size: tuple[int, int], frame: tuple[int, ...]) -> Iterator[Box]:
    """Yield positions on rings around the centre of a box, inside the frame."""
    row, col = _middle(box)
    for ring in range(24):
        for angle in np.arange(16 if ring else 1) * np.pi / 8:
            top = row + 14 * ring * np.sin(angle) - 0.5 * size[0]
            left = col + 21 * ring * np.cos(angle) - 0.5 * size[1]
            top, left = (
                int(np.clip(start, 2, max(limit - length - 3, 2)))
                for start, limit, length in ((top, frame[0], size[0]), (left, frame[1], size[1]))
            )
            yield top, left, top + size[0], left + size[1]


def _inner_part(box: Box, normal_deg: float | None) -> Box:
    """Return the inner half of a box, at least 14 px to each side of the centre, and of an edge
    with a known normal all of its length.
    """
    row, col = _middle(box)
    across = None if normal_deg is None else int(45.0 < normal_deg % 180.0 < 135.0)
    down, right = (
        max((0.25 if across in (None, 1 - k) else 0.5) * (box[k + 2] - box[k]), 14) for k in (0, 1)
    )
    return int(row - down), int(col - right), int(row + down), int(col + right)


def _overlap(one: Box, other: Box) -> float:
    """Return the overlap of two boxes, px^2; gaps of 2 px count as overlap."""
    height = min(one[2], other[2]) - max(one[0], other[0]) + 2
    width = min(one[3], other[3]) - max(one[1], other[1]) + 2
    return float(max(height, 0) * max(width, 0))


Image = NDArray[np.uint8]
Unusable = Sequence[tuple[Box, str]]
"""Row, column, height and width of edges that are not measured, px, and why."""

# Blue, orange, vermilion and grey, distinct for all colour vision (Okabe and Ito); blue, green, red
# order.
NOT_MEASURED = "not measured"
VERDICT_COLOURS = {
    "ok": (230, 170, 70),
    "suspect": (0, 160, 240),
    "refused": (60, 80, 235),
    NOT_MEASURED: (170, 170, 170),
}
LINE_STYLES = {
    "ok": "solid line",
    "suspect": "dashed line",
    "refused": "crossed out",
    NOT_MEASURED: "grey line",
}
LINE_PX, DASH_PX = 18, 12
INK, PAPER = (255, 255, 255), (25, 25, 25)


def write_annotated_image(
    stack: FrameStack,
    result: Result,
    path: Path,
    frequency: Frequency = in_cycles_per_pixel,
    unusable: Unusable = (),
) -> None:
    """Write the mean frame with the regions of a result as PNG, atomically; captions in the unit of
    `frequency`.
    """
    import cv2

    ok, encoded = cv2.imencode(".png", render_annotations(stack, result, frequency, unusable))
    if not ok:
        raise BadInput(f"the annotated image must be encoded as PNG, and was not: {path}")
    write_atomically(path, encoded.tobytes())


def unusable_edges(stack: FrameStack, result: Result) -> Unusable:
    """Return the edges of a frame that could not be measured, but for those in a measured
    region.
    """
    from charact.estimators.mtf.target_detection.edges import find_unusable_edges

    measured = [
        _in_stack(m.region, stack) for m in result.measurements if m.value is not None and m.region
    ]

    def is_measured(edge: Box) -> bool:
        row, col = edge[0] + edge[2] / 2, edge[1] + edge[3] / 2
        return any(r[0] <= row < r[0] + r[2] and r[1] <= col < r[1] + r[3] for r in measured)

    return [(edge, why) for edge, why in find_unusable_edges(stack) if not is_measured(edge)]


def _in_stack(region: Box, stack: FrameStack) -> Box:
    """Return a region of the file (row, col, height, width) in the stack, whose border may be
    cropped.
    """
    return region[0] - stack.origin[0], region[1] - stack.origin[1], region[2], region[3]


def require_png(path: Path) -> None:
    """Raise BadInput unless the file is named .png."""
    if path.suffix.lower() != ".png":
        raise BadInput(f"`annotate` must name a .png file, got {path.name!r}")


def render_annotations(
    stack: FrameStack,
    result: Result,
    frequency: Frequency = in_cycles_per_pixel,
    unusable: Unusable = (),
) -> Image:
    """Return the annotated image, shape (row, col, 3), blue, green, red.

    Every region has an outline in the colour and line style of its status and a caption with the
    value and its 95 % interval, or why it has none; a leader connects it to the region's centre.
    `unusable` edges are grey. A legend is below the image.
    """
    shown = _one_per_region(result)
    placed = [_in_stack(m.region or (*stack.origin, *stack.shape[1:]), stack) for m in shown]
    regions = [*placed, *(region for region, _ in unusable)]
    statuses = [*(m.status for m in shown), *(NOT_MEASURED for _ in unusable)]
    captions = [_caption(m, frequency, alone=len(shown) == 1) for m in shown] + [
        [why] for _, why in unusable
    ]
    normals_deg = [m.orientation_deg for m in shown]
    image = _outlined(stack, regions, statuses, captions, normals_deg)
    return np.concatenate([image, _legend(shown, statuses, frequency, image.shape[1])])


def write_layout_image(
    stack: FrameStack, parts: Sequence[tuple[Box, str, bool]], path: Path
) -> None:
    """Write the mean frame with the parts of the chip as PNG, atomically.

    `parts`: region, name, and whether it is measured; what is not is crossed out.
    """
    import cv2

    regions, names, measured = zip(*parts, strict=True) if parts else ((), (), ())
    statuses = ["ok" if is_measured else "refused" for is_measured in measured]
    image = _outlined(stack, regions, statuses, [[name] for name in names])
    write_atomically(path, cv2.imencode(".png", image)[1].tobytes())


def _outlined(
    stack: FrameStack,
    regions: Sequence[Box],
    statuses: Sequence[str],
    captions: Sequence[list[str]],
    normals_deg: Sequence[float | None] = (),
) -> Image:
    """Return the enlarged mean frame with outlines of regions and their captions."""
    import cv2

    scale = max(1, int(np.ceil(1500 / stack.shape[2])))
    mean = stack.data.mean(axis=0)
    low, high = np.percentile(mean, (0.5, 99.5))
    grey = (np.clip((mean - low) / max(high - low, 1e-12), 0, 1) * 255).astype(np.uint8)
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    image = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)
    boxes = [_box(region, scale) for region in regions]
    for box, status in zip(boxes, statuses, strict=True):
        _outline(image, box, status)
    sizes = [(LINE_PX * len(lines) + 8, max(map(_width, lines)) + 12) for lines in captions]
    places = place_captions(boxes, sizes, image.shape[:2], normals_deg)
    for status, lines, place, size, box in zip(
        statuses, captions, places, sizes, boxes, strict=True
    ):
        _write(image, lines, place, size, box, status)
    return image


def _one_per_region(result: Result) -> list[Measurement]:
    """Return one measurement for each region: its MTF50, else its first one.

    Measurements without a region, such as a joint MTF, are left out unless there are no others.
    """
    by_region: dict[object, Measurement] = {}
    placed_ones = [
        measurement for measurement in result.measurements if measurement.region is not None
    ]
    for measurement in placed_ones or result.measurements:
        held = by_region.get(measurement.region)
        if held is None or (measurement.quantity == "mtf50" and held.quantity != "mtf50"):
            by_region[measurement.region] = measurement
    return list(by_region.values())


def _box(region: Box, scale: int) -> Box:
    """Return top, left, bottom and right of a region (row, col, height, width) in the enlarged
    image.
    """
    row, col, height, width = region
    return scale * row, scale * col, scale * (row + height) - 1, scale * (col + width) - 1


def _caption(m: Measurement, frequency: Frequency, *, alone: bool) -> list[str]:
    """Return the lines of a caption: complete for a single region, else value and interval."""
    name = f"{m.quantity} " if alone else ""
    if m.value is None:
        reason = str(m.reason).replace("`", "")
        return [f"{name}refused", *([reason[:90]] if alone else m.flags[:1] or [reason[:30]])]
    value, unit, ends = in_unit(m, frequency)
    of = f" {unit}" if alone and unit != "1" else ""
    at = (
        ""
        if m.frequency_cy_per_px is None
        else " at {:.3g} {}".format(*frequency(m.frequency_cy_per_px, m))
    )
    lines = [f"{name}{value:#.4g}{of}{at}"]
    if ends:
        lines.append(f"{ends[0]:#.4g} to {ends[1]:#.4g}" + (" (95 %)" if alone else ""))
    return [*lines, *(m.flags if alone else m.flags[:1])]


def _width(text: str) -> int:
    import cv2

    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)[0][0]


def _outline(image: Image, box: Box, status: str) -> None:
    """Outline a region: solid, dashed or crossed out by its status."""
    import cv2

    top, left, bottom, right = box
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        _line(image, start, end, VERDICT_COLOURS[status], dashed=status == "suspect")
    if status == "refused":
        cv2.line(image, corners[0], corners[2], VERDICT_COLOURS[status], 1, cv2.LINE_AA)
        cv2.line(image, corners[1], corners[3], VERDICT_COLOURS[status], 1, cv2.LINE_AA)


def _line(
    image: Image,
    start: tuple[int, int],
    end: tuple[int, int],
    colour: tuple[int, int, int],
    *,
    dashed: bool,
) -> None:
    import cv2

    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    stops = np.arange(0.0, length, DASH_PX) if dashed else np.array([0.0])
    ends = np.minimum(stops + 0.6 * DASH_PX, length) if dashed else np.array([length])
    for first, last in zip(stops / max(length, 1.0), ends / max(length, 1.0), strict=True):
        one, other = (
            [round(a + share * (b - a)) for a, b in zip(start, end, strict=True)]
            for share in (first, last)
        )
        cv2.line(image, one, other, PAPER, 3)
        cv2.line(image, one, other, colour, 2)


def _text(image: Image, line: str, left: int, bottom: int) -> None:
    import cv2

    cv2.putText(image, line, (left, bottom), cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)


def _write(
    image: Image,
    lines: list[str],
    place: tuple[int, int],
    size: tuple[int, int],
    box: Box,
    status: str,
) -> None:
    """Write a caption on a dark background, with a leader if it lies outside its region."""
    import cv2

    (top, left), (height, width) = place, size
    middle = ((box[1] + box[3]) // 2, (box[0] + box[2]) // 2)
    if not (left <= middle[0] <= left + width and top <= middle[1] <= top + height):
        nearest = (
            int(np.clip(middle[0], left, left + width)),
            int(np.clip(middle[1], top, top + height)),
        )
        cv2.line(image, nearest, middle, PAPER, 3, cv2.LINE_AA)
        cv2.line(image, nearest, middle, VERDICT_COLOURS[status], 1, cv2.LINE_AA)
        cv2.circle(image, middle, 4, PAPER, -1, cv2.LINE_AA)
        cv2.circle(image, middle, 3, VERDICT_COLOURS[status], -1, cv2.LINE_AA)
    cv2.rectangle(image, (left, top), (left + width, top + height), PAPER, -1)
    cv2.rectangle(image, (left, top), (left + width, top + height), VERDICT_COLOURS[status], 1)
    for number, line in enumerate(lines):
        _text(image, line, left + 6, top + LINE_PX * (number + 1))


def _legend(
    shown: list[Measurement], statuses: list[str], frequency: Frequency, width: int
) -> Image:
    """Return the legend below the image: quantities, line styles of the status, and flags."""
    quantities = dict.fromkeys(
        f"{m.quantity}, {frequency(0.0, m)[1] if m.unit == 'cy/px' else m.unit}" for m in shown
    )
    flags = dict.fromkeys(flag for m in shown for flag in m.flags)
    lines = [
        f"{'; '.join(quantities)}: value and 95 % interval",
        *(f"{flag}: {FLAGS[flag]}" for flag in flags),
    ]
    strip = np.full((LINE_PX * (len(lines) + 1) + 16, width, 3), PAPER, np.uint8)
    left = 10
    for status in (status for status in VERDICT_COLOURS if status in statuses):
        _outline(strip, (9, left, 9 + LINE_PX - 4, left + 40), status)
        text = f"{status} ({LINE_STYLES[status]}): {statuses.count(status)}"
        _text(strip, text, left + 50, 8 + LINE_PX - 4)
        left += 80 + _width(text)
    for number, line in enumerate(lines):
        _text(strip, line, 10, 8 + LINE_PX * (number + 2) - 4)
    return strip
