"""Figures as SVG for the page: their margins, axes and texts are written here, their data by
matplotlib.

Matplotlib makes five objects for each tick and sets each of their texts four times; over half a
hundred figures, that takes five times the time of all else on the page. A browser has its own
fonts, so an estimated width of a text does.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from typing import Any

import numpy as np

from charact.reporting.style import INK
from labdata.number_format import MINUS, SUPERSCRIPTS

# Mean width of a character and distance of lines, over the size of the font.
CHARACTER, LINE = 0.56, 1.2
# Distance between ticks, their labels and the axis label, and around the figure, points.
PAD = 3.5


@dataclass(frozen=True)
class Label:
    """A text of a figure: its middle line is at (x, y), points from the lower left corner; `angle`
    in degrees.
    """

    words: str
    x: float
    y: float
    size: float
    anchor: str = "middle"  #: "start", "middle" or "end"
    angle: float = 0.0

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Estimated left, bottom, right and top, points."""
        lines = self.words.split("\n")
        width, half = (
            CHARACTER * self.size * max(map(len, lines)),
            0.5 * LINE * self.size * len(lines),
        )
        start = {"start": 0.0, "middle": -0.5 * width, "end": -width}[self.anchor]
        turn = np.exp(1j * np.deg2rad(self.angle))
        corners = turn * np.array(
            [x + 1j * y for x in (start, start + width) for y in (-half, half)]
        )
        x, y = self.x + corners.real, self.y + corners.imag
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def svg(self, height: float) -> str:
        """Return the SVG elements in a figure of some height, points."""
        lines, x, y = self.words.split("\n"), f"{self.x:.1f}", height - self.y
        turn = f' transform="rotate({-self.angle:g} {x} {y:.1f})"' if self.angle else ""
        first = y + (0.35 - 0.5 * LINE * (len(lines) - 1)) * self.size
        return "".join(
            f'<text x="{x}" y="{first + LINE * self.size * number:.1f}" font-size="{self.size:g}" '
            f'text-anchor="{self.anchor}"{turn}>{escape(line)}</text>'
            for number, line in enumerate(lines)
        )


def as_svg(figure: Any, description: str) -> str:
    """Return a figure as an SVG element for an HTML page, with a text alternative.

    `figure`: a matplotlib figure of `charact.reporting.style.panels`; its axes are hidden
    thereafter.
    """
    figure.dpi = 72  # Points are the units of SVG.
    _set_margins(figure)
    height, drawn = float(figure.bbox.height), []
    for axis in _plain_axes(figure):
        drawn.append(_axis_svg(axis, height))
        axis.set_visible(False)
    text = StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    head, _, content = _lean(text.getvalue()).replace(INK, "currentColor").partition(">")
    return f'{svg_head(head, description)}<g fill="currentColor">{"".join(drawn)}</g>{content}'


def svg_head(head: str, description: str) -> str:
    """Return the tag "<svg ..." with a text alternative."""
    text = escape(description, quote=True)
    return (
        head.replace("<svg", f'<svg role="img" aria-label="{text}" font-family="sans-serif"', 1)
        + ">"
    )


def path_svg(steps: Iterable[tuple[Any, ...]], paint: str) -> str:
    """Return an SVG path of steps, each a command and its numbers; "" if there are none."""
    drawn = "".join(
        command + " ".join(f"{number:.1f}" for number in numbers) for command, *numbers in steps
    )
    return f'<path d="{drawn}" {paint}/>' if drawn else ""


def _plain_axes(figure: Any) -> list[Any]:
    """Return the axes with their ticks at the left or the bottom; matplotlib draws the others."""
    return [
        axis
        for axes in figure.axes
        if axes.axison and axes.get_visible()
        for axis in (axes.xaxis, axes.yaxis)
        if axis.get_visible() and axis.get_ticks_position() in ("bottom", "left")
    ]


def _set_margins(figure: Any) -> None:
    """Place the panels of a figure so that their labels have room."""
    engine, specs = figure.get_layout_engine(), [axes.get_subplotspec() for axes in figure.axes]
    if any(spec is None for spec in specs):  # colour bars
        if engine is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        for axes in figure.axes:  # An image keeps its proportions within its place.
            axes.apply_aspect()
        return
    figure.set_layout_engine(None)
    rows, columns = specs[0].get_gridspec().get_geometry()
    left_room, right_room, lower_room, upper_room = (
        np.zeros(columns),
        np.zeros(columns),
        np.zeros(rows),
        np.zeros(rows),
    )
    for axes, spec in zip(figure.axes, specs, strict=True):
        row, column = spec.rowspan.start, spec.colspan.start
        room = _room_around(axes)
        for side, index, size in zip(
            (left_room, lower_room, right_room, upper_room),
            (column, row, column, row),
            room,
            strict=True,
        ):
            side[index] = max(side[index], size)
    lower_room[-1] += sum(legend.get_window_extent().height + PAD for legend in figure.legends)
    _adjust(figure, (left_room, right_room), (upper_room, lower_room))


def _adjust(figure: Any, across: tuple[Any, Any], down: tuple[Any, Any]) -> None:
    """Set margins and gaps; `across`: room at the left and right of each column; `down`: above and
    below each row.
    """
    ends: list[float] = []
    for size, (before, after) in (
        (figure.bbox.width, across),
        (figure.bbox.height, (down[1][::-1], down[0][::-1])),
    ):
        first, last = before[0] + PAD, after[-1] + PAD
        gap = float(np.max(after[:-1] + before[1:], initial=0.0)) + (
            PAD if len(before) > 1 else 0.0
        )
        length = max((size - first - last - gap * (len(before) - 1)) / len(before), 1.0)
        ends += [first / size, 1.0 - last / size, gap / length]
    left_edge, right_edge, wspace, bottom, top, hspace = ends
    figure.subplots_adjust(
        left=left_edge,
        right=max(right_edge, left_edge + 0.1),
        bottom=bottom,
        top=max(top, bottom + 0.1),
        wspace=wspace,
        hspace=hspace,
    )


def _room_around(axes: Any) -> tuple[float, float, float, float]:
    """Return the room that the texts of a panel take at its left, below, at its right and above,
    points.
    """
    axes.apply_aspect()
    panel = axes.get_window_extent()
    titles = [axes.get_title(loc=side) for side in ("left", "center", "right")]
    top_room = (
        max(title.count("\n") + 1 if title else 0 for title in titles)
        * LINE
        * axes.title.get_fontsize()
        + 2 * PAD
    )
    label_width = 0.0
    for other in axes.child_axes:  # a second axis, at the right or the top
        words = [label.get_text() for label in other.get_yticklabels()]
        size = other.yaxis.get_major_ticks(1)[0].label1.get_fontsize()
        label_width = max(
            [
                label_width,
                *(Label(text, 0.0, 0.0, size, "start").box[2] + 2 * PAD for text in words),
            ]
        )
        top_room += 3 * LINE * size if other.get_xlabel() else 0.0
    if not axes.axison:
        return 0.0, 0.0, label_width, top_room
    boxes = [
        label.box
        for axis in (axes.xaxis, axes.yaxis)
        if axis.get_visible()
        for label in _labels(axis, _ticks(axis))
    ]
    x_min, y_min, x_max, y_max = np.array([*boxes, (panel.x0, panel.y0, panel.x1, panel.y1)]).T
    return (
        panel.x0 - float(x_min.min()),
        panel.y0 - float(y_min.min()),
        max(float(x_max.max()) - panel.x1, label_width),
        max(float(y_max.max()) - panel.y1, top_room),
    )


def _axis_svg(axis: Any, height: float) -> str:
    """Return grid, ticks and labels of an axis."""
    panel, model, upright = (
        axis.axes.get_window_extent(),
        axis.get_major_ticks(1)[0],
        axis.axis_name == "y",
    )
    grid, marks, ticks = [], [], _ticks(axis)
    for tick in ticks:
        length = tick.length if model.tick1line.get_visible() else 0.0
        if upright:
            at = height - tick.at
            ends = ((panel.x0, at), (panel.x1, at), (panel.x0 - length, at))
        else:
            ends = (
                (tick.at, height - panel.y0),
                (tick.at, height - panel.y1),
                (tick.at, height - panel.y0 + length),
            )
        marks += [("M", *ends[0]), ("L", *ends[2])] if length else []
        grid += [] if tick.minor else [("M", *ends[0]), ("L", *ends[1])]
    opacity = 1.0 if model.gridline.get_alpha() is None else model.gridline.get_alpha()
    line = 'stroke="currentColor" stroke-width=".8"'
    return (
        (
            path_svg(grid, f'{line} stroke-opacity="{opacity:g}"')
            if model.gridline.get_visible()
            else ""
        )
        + path_svg(marks, line)
        + "".join(label.svg(height) for label in _labels(axis, ticks))
    )


@dataclass(frozen=True)
class Tick:
    """A tick: its place along the axis and its length, points, and its words, "" without a
    label.
    """

    at: float
    words: str
    length: float
    minor: bool = False


def _ticks(axis: Any) -> list[Tick]:
    """Return the ticks of an axis within its panel."""
    from matplotlib.ticker import NullLocator

    upright, panel, ticks = axis.axis_name == "y", axis.axes.get_window_extent(), []
    low, high = (panel.y0, panel.y1) if upright else (panel.x0, panel.x1)
    transform = (
        axis.axes.get_yaxis_transform("grid") if upright else axis.axes.get_xaxis_transform("grid")
    )
    for minor in (False, True):
        values = (
            []
            if minor and isinstance(axis.get_minor_locator(), NullLocator)
            else axis.get_ticklocs(minor=minor)
        )
        if len(values):
            length = (axis.get_minor_ticks(1) if minor else axis.get_major_ticks(1))[
                0
            ].tick1line.get_markersize()
            formatter = axis.get_minor_formatter() if minor else axis.get_major_formatter()
            positions = transform.transform(np.column_stack([values, values]))[
                :, int(upright)
            ].tolist()
            ticks += [
                Tick(at, _plain(words), length, minor)
                for at, words in zip(positions, formatter.format_ticks(values), strict=True)
                if low - 0.5 < at < high + 0.5
            ]
    return ticks


def _labels(axis: Any, ticks: Sequence[Tick]) -> list[Label]:
    """Return the labels of the ticks, their common factor and the label of an axis."""
    model, panel, upright = (
        axis.get_major_ticks(1)[0],
        axis.axes.get_window_extent(),
        axis.axis_name == "y",
    )
    size, angle = model.label1.get_fontsize(), model.label1.get_rotation()
    label_gap = (model.tick1line.get_markersize() if model.tick1line.get_visible() else 0.0) + PAD
    anchor = {"left": "start", "center": "middle", "right": "end"}[
        model.label1.get_horizontalalignment()
    ]
    # Where the text of an axis begins: its right end or its upper one.
    rim, labels = (panel.x0 if upright else panel.y0) - label_gap, []
    if model.label1.get_visible():
        lines = max((tick.words.count("\n") + 1 for tick in ticks), default=1)
        level = rim if upright else rim - 0.5 * LINE * size * lines
        for tick in (tick for tick in ticks if tick.words):
            x, y = (level, tick.at) if upright else (tick.at, level)
            labels.append(Label(tick.words, x, y, size, anchor, angle))
        rim = min((label.box[1 - upright] for label in labels), default=rim)
        if factor := _plain(axis.get_major_formatter().get_offset()):
            position = (panel.x0, panel.y1 + size) if upright else (panel.x1, rim - 0.6 * size)
            labels.append(Label(factor, *position, size, "start" if upright else "end"))
    if words := axis.label.get_text():
        font_size = axis.label.get_fontsize()
        middle, rim = (
            0.5 * (panel.y0 + panel.y1),
            rim - PAD - 0.5 * LINE * font_size * (words.count("\n") + 1),
        )
        position = (rim, middle) if upright else (0.5 * (panel.x0 + panel.x1), rim)
        labels.append(Label(words, *position, font_size, angle=90.0 if upright else 0.0))
    return labels


def _plain(words: str) -> str:
    """Return a power of ten in matplotlib's mathematical notation as plain text."""
    words = re.sub(r"\^\{([^}]*)\}", lambda power: power[1].translate(SUPERSCRIPTS), words)
    words = re.sub(r"\$|\\mathdefault|[{}]", "", words.replace(r"\times", "×"))
    return words.replace("-", MINUS) if re.fullmatch(r"[-\d.e×⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+", words) else words


def _lean(svg: str) -> str:
    """Strip prologue, metadata, name spaces, group names, superfluous digits and space."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", svg, flags=re.S)
    svg = re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r' (width|height)="[\d.]+pt"', "", svg, count=2)
    svg = re.sub(r"'DejaVu Sans'[^;\"]*", "sans-serif", svg)
    # Group names repeat between figures; names of definitions are hashes of their content.
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    # Only inside tags; visible text keeps its digits.
    svg = re.sub(
        r"<[^>]*>", lambda tag: re.sub(r"(\d\.\d)\d+", r"\1", " ".join(tag.group().split())), svg
    )
    svg = re.sub(r">\s+<", "><", svg)
    return re.sub(r"(<g/>)|(<g></g>)", "", svg)
