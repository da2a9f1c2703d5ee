"""Layout of the frames of one chip: unexposed strips, amplifiers and rows that were lost.

Mean frames are averaged over eight bands across an axis; p_b(c) is band b at column (or row) c.

A strip along a side sees no light: the flats less the darks vanish in it and reach the level of
the picture within two pixels, at the same column in every band. Vignetting and the rim of a tube
are neither sharp nor straight.

An amplifier begins where offset (of darks) or response (of flats less darks) steps along a
complete column. With medians L2, L1 | R1, R2 of four adjacent windows of w columns, the step

    t = 3/2 (R1 - L1) - 1/2 (R2 - L2),   var t = 5 (pi / 2) s^2 / w

is free of any parabola; s is the scatter of columns in a window. Single bad columns move no
median, and every band but one must show the step, whatever its sign: of four amplifiers the step
of the upper half is not that of the lower one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from charact.frames.robust import NORMAL
from charact.frames.thresholds import LAYOUT
from labdata import Array
from labdata.frames import LazyStack

Region = tuple[int, int, int, int]
Profiles = tuple[Array, Array]  # of columns (band, col), and of rows (band, row), DN
AXES = ("columns", "rows")
STRIP, LOST, BORDER = "unexposed strip", "lost rows", "border"
NOTES = {
    STRIP: "{axis} {first} to {last} are an unexposed strip ({seen})",
    LOST: "rows {first} to {last} of frame {frame}{of_stack} are {seen} (lost data)",
    BORDER: "between {axis} {before} and {first} another amplifier begins: {seen}",
}
OFFSET, RESPONSE = "offset by {:.3g} ± {:.1g} DN", "response by {:.3g} ± {:.1g} %"


@dataclass(frozen=True, kw_only=True)
class Part:
    """Columns (axis 0) or rows (axis 1) of a chip that see no light or that one frame lost, or the
    border (`first` = `stop`) behind which another amplifier begins.
    """

    name: str  # STRIP, LOST or BORDER
    axis: int
    first: int
    stop: int
    seen: str  # what was measured, with its standard error
    step: float = 0.0  # of a border, largest relative step of the response
    frame: int = 0  # of lost rows
    stack: str = ""  # of lost rows

    @property
    def note(self) -> str:
        """What was seen, as one line of text."""
        return NOTES[self.name].format(
            axis=AXES[self.axis],
            before=self.first - 1,
            first=self.first,
            last=self.stop - 1,
            frame=self.frame,
            of_stack=self.stack and f" of {self.stack}",
            seen=self.seen,
        )


@dataclass(frozen=True, kw_only=True)
class Layout:
    """What the frames of one chip show of its parts."""

    size: tuple[int, int]  # rows and columns
    parts: tuple[Part, ...] = ()

    def of(self, name: str) -> tuple[Part, ...]:
        """Return the parts of a name."""
        return tuple(part for part in self.parts if part.name == name)

    def span(self, axis: int) -> tuple[int, int]:
        """Return the first and last-plus-one exposed column (axis 0) or row (axis 1)."""
        strips = [part for part in self.of(STRIP) if part.axis == axis]
        first = max((part.stop for part in strips if not part.first), default=0)
        return first, min(
            (part.first for part in strips if part.first), default=self.size[1 - axis]
        )

    @property
    def exposed(self) -> Region:
        """Row, column, height and width of what sees light."""
        (first_col, last_col), (first_row, last_row) = self.span(0), self.span(1)
        return first_row, first_col, last_row - first_row, last_col - first_col

    @property
    def amplifiers(self) -> tuple[Region, ...]:
        """Exposed area of each amplifier, by rows; none where there is one amplifier."""
        cols, rows = (
            sorted({*self.span(axis), *(b.first for b in self.of(BORDER) if b.axis == axis)})
            for axis in (0, 1)
        )
        areas = tuple(
            (top, first, bottom - top, last - first)
            for top, bottom in pairwise(rows)
            for first, last in pairwise(cols)
        )
        return areas if self.of(BORDER) else ()

    @property
    def areas(self) -> tuple[tuple[Region, str, bool], ...]:
        """Region and name of each area, and whether it is measured; none of a plain frame."""
        rows, cols = self.size
        areas = [
            ((part.first, 0, part.stop - part.first, cols), part.note, False)
            if part.axis
            else ((0, part.first, rows, part.stop - part.first), part.note, False)
            for part in (*self.of(STRIP), *self.of(LOST))
        ]
        numbered = enumerate(self.amplifiers, 1)
        return (*areas, *((region, f"amplifier {number}", True) for number, region in numbered))

    def touching(self, region: Region) -> tuple[str, ...]:
        """Return notes on the parts that a region (row, col, height, width) reaches into."""
        row, col, height, width = region
        spans = (col, col + width), (row, row + height)
        return tuple(
            part.note
            for part in self.parts
            if spans[part.axis][0] < part.stop and part.first < spans[part.axis][1]
        )


@dataclass(frozen=True, kw_only=True)
class AreaView:
    """Sound frames of a stack, cut to a rectangle (row, col, height, width), on reading."""

    region: Region
    frames: NDArray[np.int64] | None = None  # numbers of the sound frames; None: all

    def through(self, stack: LazyStack) -> LazyStack:
        """Return the cut stack."""
        row, col, height, width = self.region
        numbers = np.arange(len(stack)) if self.frames is None else self.frames

        def block(first: int, last: int) -> NDArray:
            chosen = numbers[first:last]
            data = stack.frames(int(chosen[0]), int(chosen[-1]) + 1)[chosen - chosen[0]]
            return data[:, row : row + height, col : col + width]

        stamps = {
            name: stamp[numbers] if len(stamp := getattr(stack, name)) else stamp
            for name in ("time_s", "frame_number")
        }
        return replace(stack, block=block, shape=(len(numbers), height, width), **stamps)


# Rows that are looked at together.
ROWS_AT_ONCE = 1024


def profiles_of(mean_frame: NDArray) -> Profiles:
    """Return a mean frame of two pixels a band and more averaged over bands."""
    columns, rows = (
        np.stack([band.mean(axis=0, dtype=float) for band in np.array_split(frame, LAYOUT.bands)])
        for frame in (mean_frame, mean_frame.T)
    )
    return columns, rows


def lost_rows(frames: NDArray, start: int = 0) -> tuple[Part, ...]:
    """Return the rows (frame, row, col) that hold one value where noise cannot, from an end of the
    row over at least an eighth of it; part of a row is lost only at an end of the frames' values.

    `start`: number of the first frame. Where a fraction f of the same pixels in another frame, else
    of an adjacent row, has its commonest value, n pixels have one value with probability f^n. Noise
    that whole rows share brings some of them nearer to one code: f is that of the evenest other row
    of the frame, if larger.
    """
    ends = frames[:, :, : LAYOUT.bands], frames[:, :, -LAYOUT.bands :]
    is_even = np.any([np.all(end == end[:, :, :1], axis=2) for end in ends], axis=0)
    if not is_even.any():
        return ()
    cols = frames.shape[2]
    ends_dn = float(frames.min()), float(frames.max())
    pixels = {}  # of the rows that hold one value
    even_rows = np.argwhere(is_even)
    for numbers in np.array_split(even_rows, 1 + len(even_rows) // ROWS_AT_ONCE):
        values = frames[numbers[:, 0], numbers[:, 1]]
        # Pixels from each end of the row to the first that differs from the end's.
        first, last = (
            np.where(differs.any(axis=1), differs.argmax(axis=1), cols)
            for differs in (values != values[:, :1], (values != values[:, -1:])[:, ::-1])
        )
        held = np.maximum(first, last) >= max(cols // 8, LAYOUT.bands)
        is_even[numbers[:, 0], numbers[:, 1]] = held
        for (frame, row), at_first, at_last in zip(
            numbers[held].tolist(), first[held].tolist(), last[held].tolist(), strict=True
        ):
            pixels[frame, row] = (
                np.s_[:at_first] if at_first >= at_last else np.s_[cols - at_last :]
            )
    lost = []
    for frame in np.flatnonzero(is_even.any(axis=1)).tolist():
        starts = np.flatnonzero(np.diff(is_even[frame], prepend=False, append=False))
        for first, stop in starts.reshape(-1, 2).tolist():
            held = pixels[frame, first]
            sound = np.flatnonzero(~is_even[:, first])
            if len(sound):
                normal = frames[sound[np.abs(sound - frame).argmin()], first, held]
            else:
                normal = frames[frame, first - 1 if first else stop % frames.shape[1], held]
            value, middle = float(frames[frame, first, held][0]), float(np.median(normal))
            others = frames[frame, ~is_even[frame]][:, held]
            medians = np.median(others, axis=1, keepdims=True)
            shares = (np.mean(others == medians, axis=1), np.mean(normal == middle))
            chance = normal.size * np.log(max(*np.hstack(shares), 1.0 / normal.size))
            departs = len(sound) and abs(value - middle) > LAYOUT.lost_sd * normal.std() > 0.0
            # Correlated noise of a few codes holds one of them over part of a row.
            is_end = normal.size == cols or value in ends_dn
            if is_end and (chance < LAYOUT.lost_chance or departs):
                seen = f"{value:g} DN" + f" in {normal.size} columns" * (normal.size < cols)
                rows = {"axis": 1, "first": first, "stop": stop, "seen": seen}
                lost.append(Part(name=LOST, frame=start + frame, **rows))
    return tuple(lost)


def layout_of(
    darks: Sequence[Profiles], flats: Sequence[Profiles], *, lost: Sequence[Part] = ()
) -> Layout:
    """Return the layout shown by the profiles of darks and of evenly lit flats of one size.

    Without darks the dimmest of several flats stands for them; one flat alone shows no offset.
    """
    first = (*darks, *flats)[0]
    layout = Layout(size=(first[1].shape[1], first[0].shape[1]), parts=tuple(lost))
    flats = sorted(flats, key=lambda profiles: float(profiles[0].mean()))
    black, lit = (darks, flats) if darks or len(flats) < 2 else (flats[:1], flats[1:])
    offsets, signals = (
        [np.mean([profiles[axis] for profiles in stacks], axis=0) for axis in (0, 1) if stacks]
        for stacks in (black, lit)
    )
    if offsets and signals:
        signals = [signal - offset for signal, offset in zip(signals, offsets, strict=True)]
    strips = [
        strip
        for axis, signal in enumerate(signals)
        for strip in _strips(signal, axis, bool(offsets))
    ]
    layout = replace(layout, parts=(*strips, *layout.parts))
    borders = [
        border
        for axis in (0, 1)
        for border in _borders(
            offsets[axis] if darks else None, signals[axis] if signals else None, layout, axis
        )
    ]
    return replace(layout, parts=(*layout.parts, *borders))


def _strips(signal: Array, axis: int, black_known: bool) -> list[Part]:
    """Return the strips at both ends of an axis, from the signal (band, n), DN.

    Where black is not known, each end is taken as black of its side.
    """
    strips = []
    for backwards in (False, True):
        profile = signal[:, ::-1] if backwards else signal
        profile = profile if black_known else profile - np.median(profile[:, :2])
        lit = np.median(profile, axis=1)
        if lit.max() <= 0.0:
            continue
        bands, level = (part[lit > LAYOUT.lit_fraction * lit.max()] for part in (profile, lit))
        noise = NORMAL * np.median(np.abs(np.diff(bands, axis=1)), axis=1) / np.sqrt(2.0)
        is_dark = np.abs(bands) < LAYOUT.unlit_fraction * level[:, None]
        widths = np.argmin(is_dark, axis=1)
        width = int(np.median(widths))
        longest = bands.shape[1] // (2 if black_known else LAYOUT.bands)
        if not LAYOUT.min_strip_px <= width <= longest or np.ptp(widths) > 1:
            continue
        behind = bands[:, width + 1 : width + 2 + LAYOUT.adjacent_px]
        exposed = behind[:, 1:].mean(axis=1)
        strip = bands[:, : int(widths.min())]
        is_sharp = (behind[:, 0] > LAYOUT.sharp_fraction * exposed) & (
            np.abs(strip).max(axis=1) < LAYOUT.unlit_fraction * exposed
        )
        is_flat = black_known or np.ptp(strip.mean(axis=1)) < LAYOUT.flat_fraction * exposed.mean()
        if is_flat and np.all(is_sharp & (level > LAYOUT.lit_sd * noise)):
            first = bands.shape[1] - width if backwards else 0
            error = strip.std() / np.sqrt(strip.size)
            seen = f"signal {strip.mean():.2g} ± {error:.1g} DN, {exposed.mean():.4g} DN beyond it"
            ends = {"axis": axis, "first": first, "stop": first + width, "seen": seen}
            strips.append(Part(name=STRIP, **ends))
    return strips


def _borders(offset: Array | None, signal: Array | None, layout: Layout, axis: int) -> list[Part]:
    """Return the borders across an axis, from profiles (band, n) of the darks and of the signal."""
    (first, last), (low, high) = layout.span(axis), layout.span(1 - axis)
    width = int(np.clip((last - first) // LAYOUT.windows, 4, LAYOUT.max_window_px)) // 2 * 2
    ends = np.linspace(0, layout.size[axis], LAYOUT.bands + 1)
    is_exposed = (ends[:-1] > low - 1) & (ends[1:] < high + 1)
    if last - first < 6 * width or is_exposed.sum() < LAYOUT.bands // 2:
        return []
    bands = {}
    if offset is not None:
        bands[OFFSET] = offset[is_exposed, first:last]
    if signal is not None:
        exposed = signal[is_exposed, first:last]
        level = np.median(exposed, axis=1, keepdims=True)
        bands |= {RESPONSE: 100.0 * exposed / level} if np.all(level > 0.0) else {}
    searched = {kind: _places(of_kind, width) for kind, of_kind in bands.items()}
    places: list[int] = []
    for at in sorted(at for of_kind, _ in searched.values() for at in of_kind):
        if not places or at - places[-1] > LAYOUT.same_border_px:
            places.append(at)
    borders = []
    for at in places:
        steps = {
            kind: _of_half(_steps(bands[kind], width)[:, at - 2 * width], searched[kind][1])
            for kind in bands
        }
        seen = [f"{kind.format(*step)}" for kind, step in steps.items()]
        ends = {"axis": axis, "first": first + at, "stop": first + at, "seen": " and ".join(seen)}
        borders.append(Part(name=BORDER, step=abs(steps.get(RESPONSE, (0.0,))[0]) / 100.0, **ends))
    return borders


def _places(bands: Array, width: int) -> tuple[list[int], Array]:
    """Return where profiles (band, n) step, and the standard error of a step in each band.

    The error is that of the scatter of columns, or the scatter of the statistic elsewhere if it is
    larger, as where adjacent columns are alike.
    """
    places: list[int] = []
    half = width // 2
    while True:
        steps, middles = np.abs(_steps(bands, width)), _medians(bands, width)
        residual = bands[:, half : half + middles.shape[1]] - middles
        scatter = NORMAL * np.median(np.abs(residual), axis=1)
        sd = scatter * np.sqrt(2.5 * np.pi / width)
        # Rounding of the values: columns of one value have no scatter.
        sd += max(np.finfo(float).eps * float(np.abs(bands).max()), np.finfo(float).tiny ** 0.5)
        # All bands but one must show the step.
        peak = int(np.argmax(np.sort(steps / sd[:, None], axis=0)[1]))
        is_apart = np.abs(np.arange(steps.shape[1]) - peak) >= 2 * width
        if is_apart.sum() >= width:
            sd = np.maximum(sd, NORMAL * np.median(steps[:, is_apart], axis=1))
        # Medians step somewhere within half a window; means peak at the border.
        first = max(peak - half, 0)
        columns = range(2 * width + first, 2 * width + min(peak + half + 1, steps.shape[1]))
        at = max(columns, key=lambda column: float(np.abs(_change(bands, column, width)).sum()))
        step = _steps(bands, width)[:, at - 2 * width]
        is_significant = np.sort(np.abs(step) / sd)[1] > LAYOUT.step_sd
        # Shading that no parabola follows is not sharp: between four pairs of columns it is less.
        jump = np.sign(step) * _steps(bands[:, at - 4 : at + 4], 2)[:, 0]
        is_sharp = np.median(jump - LAYOUT.sharp_fraction * np.abs(step)) > 0.0
        if len(places) == LAYOUT.max_borders or not (is_significant and is_sharp):
            return places, sd
        places.append(at)
        bands = np.concatenate([bands[:, :at], bands[:, at:] - step[:, None]], axis=1)


def _change(bands: Array, at: int, width: int) -> Array:
    """Return the mean of a window of columns behind a border less that before it, shape (band,)."""
    return bands[:, at : at + width].mean(axis=1) - bands[:, at - width : at].mean(axis=1)


def _medians(bands: Array, width: int) -> Array:
    """Return the medians of the windows that begin at each column, shape (band, n - width + 1)."""
    return np.median(sliding_window_view(bands, width, axis=1), axis=2)


def _steps(bands: Array, width: int) -> Array:
    """Return t of profiles (band, n) at the columns 2 w to n - 2 w."""
    middles = _medians(bands, width)
    positions = middles.shape[1] - 3 * width
    l2, l1, r1, r2 = (middles[:, shift * width :][:, :positions] for shift in range(4))
    return 1.5 * (r1 - l1) - 0.5 * (r2 - l2)


def _of_half(steps: Array, sd: Array) -> tuple[float, float]:
    """Return the larger step of both halves of the bands, and its standard error."""
    halves = np.array_split(steps, 2), np.array_split(sd, 2)
    means = [
        (float(step.mean()), float(np.sqrt(np.sum(error**2)) / len(error)))
        for step, error in zip(*halves, strict=True)
    ]
    return max(means, key=lambda pair: abs(pair[0]))
