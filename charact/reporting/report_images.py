"""Report images: one frame of each stack kind with measured regions and grey scale."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.frames.clipping import is_clipped
from labdata import Conditions, Measurement, Session, StackEntry, has_tube

COLOURS = {"ok": "#35c46a", "suspect": "#f0a020", "refused": "#ff4d4d"}


@dataclass(frozen=True, kw_only=True)
class Box:
    """A rectangle ROW, COL, HEIGHT, WIDTH in an image, px, with status and label."""

    region: tuple[int, int, int, int]
    status: str
    words: str

    @property
    def colour(self) -> str:
        """Colour of the status."""
        return COLOURS.get(self.status, "#ffffff")


@dataclass(frozen=True, kw_only=True)
class ReportImage:
    """A frame for the page: JPEG as base64, size of the frame, px, row pitch over column pitch, and
    regions to show.
    """

    title: str
    caption: str
    data: str
    rows: int
    cols: int
    aspect: float = 1.0
    boxes: tuple[Box, ...] = ()


def grey_limits(frame: NDArray) -> tuple[float, float]:
    """Return the grey values shown as black and white: percentiles 0.5 and 99.8, at least 1 DN
    apart.
    """
    low, high = np.percentile(frame, [0.5, 99.8])
    return float(low), float(max(high, low + 1))


def as_jpeg(frame: NDArray, limits: tuple[float, float], quality: int = 72) -> str:
    """Return a frame (row, col) as a grey JPEG in base64; a large frame is averaged over blocks of
    pixels.

    `limits`: values shown as black and white, in the frame's unit.
    """
    from PIL import Image

    step = -(-max(frame.shape) // 720)
    rows, cols = (size // step * step for size in frame.shape)
    small = (
        np.asarray(frame, float)[:rows, :cols]
        .reshape(rows // step, step, cols // step, step)
        .mean(axis=(1, 3))
    )
    low, high = limits
    grey = np.clip((small - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    buffer = BytesIO()
    Image.fromarray(grey).save(buffer, format="JPEG", quality=quality)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def image_of(
    frame: NDArray, title: str, caption: str = "", *, unit: str = "DN", aspect: float = 1.0
) -> ReportImage:
    """Return an image of one frame, shape (row, col), with its grey scale in the caption."""
    low, high = grey_limits(frame)
    caption = f"{caption} Black {low:.4g} {unit}, white {high:.4g} {unit}.".strip()
    rows, cols = frame.shape
    return ReportImage(
        title=title,
        caption=caption,
        data=as_jpeg(frame, (low, high)),
        rows=rows,
        cols=cols,
        aspect=aspect,
    )


def representative(
    session: Session, measurements: Sequence[Measurement], layout: Mapping[str, Any] | None = None
) -> tuple[ReportImage, ...]:
    """Return the central frame of an informative stack of each kind; `layout`: parts of the chip,
    shown on darks and flats.
    """
    kinds = dict.fromkeys(entry.kind for entry in session.stacks)
    chosen = [
        _informative_stack([entry for entry in session.stacks if entry.kind == kind])
        for kind in kinds
    ]
    parts = _boxes_of_parts(layout) if layout is not None else ()
    return tuple(
        replace(picture, boxes=parts) if parts and entry.kind in ("dark", "flat") else picture
        for entry in chosen
        for picture in [_picture(session, entry, measurements)]
    )


def _boxes_of_parts(layout: Mapping[str, Any]) -> tuple[Box, ...]:
    """Return one box for each part of the chip; what is not measured counts as refused."""
    parts = zip(layout["region"], layout["name"], layout["measured"], strict=True)
    return tuple(
        Box(region=tuple(region), status="ok" if measured else "refused", words=name)
        for region, name, measured in parts
    )


def _informative_stack(entries: Sequence[StackEntry]) -> StackEntry:
    """Return the first stack with the most light, of flats the first that is not saturated."""
    by_light = _by_light(entries)
    if entries[0].kind != "flat":
        return by_light[0]
    return next((entry for entry in by_light if not _is_saturated(entry)), by_light[0])


def _is_saturated(entry: StackEntry) -> bool:
    """Return whether the central frame of a stack is clipped."""
    stack = entry.read()
    middle = len(stack) // 2
    return is_clipped(stack.data[middle : middle + 1], stack.full_scale_dn)


def _by_light(entries: Sequence[StackEntry]) -> list[StackEntry]:
    """Return stacks from the brightest on, by their conditions, else by the mean of their
    frames.
    """
    for light in (lambda conditions: conditions.photons_per_px, _lux_s):
        stated = [light(entry.conditions) for entry in entries]
        if all(amount is not None for amount in stated):
            order = np.argsort(-np.array(stated, float), kind="stable")
            return [entries[index] for index in order]
    if len(entries) == 1:
        return list(entries)
    return sorted(entries, key=lambda entry: -entry.read().mean_dn)


def _lux_s(conditions: Conditions) -> float | None:
    """Return illuminance times exposure or gate time, lux s; None if unknown."""
    open_s = conditions.exposure_s if conditions.gate_ns is None else 1e-9 * conditions.gate_ns
    return (
        None
        if conditions.illuminance_lux is None or open_s is None
        else conditions.illuminance_lux * open_s
    )


def _picture(
    session: Session, entry: StackEntry, measurements: Sequence[Measurement]
) -> ReportImage:
    stack = entry.read()
    middle = len(stack) // 2
    frame, caption = stack.data[middle], f"Frame {middle + 1} of {len(stack)}."
    row, col, height, width = (0, 0, *frame.shape)
    if entry.kind in ("bars", "point"):
        row, col, height, width = bright_region(stack.data.mean(axis=0))
        caption += f" Rows {row}–{row + height - 1}, cols {col}–{col + width - 1}."
    cut = frame[row : row + height, col : col + width]
    image = image_of(
        cut, f"{entry.label} ({entry.kind})", caption, unit=stack.unit, aspect=aspect_of(session)
    )
    is_full_frame = (height, width) == frame.shape
    return replace(image, boxes=_boxes(entry, measurements) if is_full_frame else ())


def bright_region(mean: NDArray) -> tuple[int, int, int, int]:
    """Return ROW, COL, HEIGHT, WIDTH around the bright part of a frame, shape (row, col), with a
    margin.

    Bright pixels exceed the mean of the median and the 99.99 percentile; the region has the frame's
    proportions.
    """
    half = (np.median(mean) + np.percentile(mean, 99.99)) / 2
    rows, cols = (np.flatnonzero((mean > half).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return (0, 0, *mean.shape)
    fraction = max(2.5 * np.ptp(rows) / mean.shape[0], 2.5 * np.ptp(cols) / mean.shape[1], 0.15)
    height, width = (min(int(fraction * size), size) for size in mean.shape)
    top = int(np.clip((rows[0] + rows[-1] - height) // 2, 0, mean.shape[0] - height))
    first_col = int(np.clip((cols[0] + cols[-1] - width) // 2, 0, mean.shape[1] - width))
    return top, first_col, height, width


def aspect_of(session: Session) -> float:
    """Return row pitch over column pitch; 1 without sensor description."""
    return session.camera.pitch_ratio if has_tube(session.camera) else 1.0


def _boxes(entry: StackEntry, measurements: Sequence[Measurement]) -> tuple[Box, ...]:
    """Return one box for each measured region of the stack, with the worst status of its
    measurements.
    """
    worst: dict[tuple[int, int, int, int], Measurement] = {}
    order = ("ok", "suspect", "refused")
    for m in measurements:
        if m.stack == entry.label and m.region is not None:
            now = worst.get(m.region)
            if now is None or order.index(m.status) > order.index(now.status):
                worst[m.region] = m
    if not worst and entry.target.region is not None:
        return (Box(region=entry.target.region, status="", words="target"),)
    return tuple(
        Box(region=region, status=m.status, words=f"{m.method}: {m.status}")
        for region, m in worst.items()
    )
