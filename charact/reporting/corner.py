"""Corner plot of a posterior: joint regions of 68 and 95 %, marginals on the diagonal."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.reporting.figure_svg import Label, path_svg, svg_head
from charact.reporting.style import DATA, MODEL
from labdata.measurement import QUANTILES, Posterior
from labdata.number_format import MINUS, SUPERSCRIPTS
from labdata.quantity import QUANTITIES

BINS = 22
# Room at the left and below, distance of panels and the gap between them, points.
MARGIN, SIDE, GAP = 56.0, 90.0, 9.0
FRAME = 'fill="none" stroke="currentColor" stroke-width=".8"'
# Left, top, width and height of a panel, points.
Panel = tuple[float, float, float, float]
# Suffixes of parameter names that repeat the unit.
UNIT_SUFFIXES = {
    "cy/px": "_cy_per_px",
    "DN": "_dn",
    "px": "_px",
    "deg": "_deg",
    "e-": "_e",
    "DN2": "_dn2",
    "pe": "_pe",
}


def corner_svg(posterior: Posterior, title: str) -> str:
    """Return the corner plot of a posterior as SVG; at most five parameters that vary are shown."""
    shown = varying(posterior)
    width, height = (
        MARGIN + GAP + SIDE * max(len(shown), 1),
        MARGIN + 0.92 * SIDE * max(len(shown), 1),
    )
    parts = (
        [Label("No parameter varies.", width / 2, height / 2, 9.0).svg(height)] if not shown else []
    )
    for line in range(len(shown)):
        for column in range(line + 1):
            panel = (
                MARGIN + SIDE * column,
                4.0 + 0.92 * SIDE * line,
                SIDE - GAP,
                0.92 * SIDE - GAP,
            )
            parts.append(_cell(posterior, shown, (line, column), panel))
    head = svg_head(
        f'<svg viewBox="0 0 {width:g} {height:g}"', f"Corner plot of the posterior of {title}"
    )
    return f'{head}<g fill="currentColor">{"".join(parts)}</g></svg>'


def varying(posterior: Posterior) -> tuple[int, ...]:
    """Return the indices of at most five finite parameters that vary, quantities first."""
    draws = posterior.draws
    varies = (
        np.isfinite(draws).all(axis=0) & (np.ptp(draws, axis=0) > 0)
        if len(draws)
        else np.zeros(draws.shape[1], bool)
    )
    order = sorted(
        np.flatnonzero(varies).tolist(), key=lambda index: posterior.names[index] not in QUANTITIES
    )
    return tuple(sorted(order[:5]))


def _cell(posterior: Posterior, shown: tuple[int, ...], cell: tuple[int, int], panel: Panel) -> str:
    """Return one panel: a marginal on the diagonal, joint regions below it; labels at the left and
    the bottom only.
    """
    line, column = cell
    panel_x, top, width, height = panel
    x = posterior.draws[:, shown[column]]
    low, high = _limits(x)
    across = _ticks(posterior.draws[:, shown[column]], low, high)
    tick_x = [panel_x + width * fraction for _, fraction in across]
    bottom = top + height
    parts = [
        path_svg(
            [step for at in tick_x for step in (("M", at, bottom), ("L", at, bottom + 2))], FRAME
        )
    ]
    if line == column:
        parts += [
            _marginal(x, panel),
            path_svg([("M", panel_x, bottom), ("L", panel_x + width, bottom)], FRAME),
        ]
    else:
        y = posterior.draws[:, shown[line]]
        parts.append(_joint(x, y, panel))
        parts.append(
            path_svg(
                [("M", panel_x, top), ("L", panel_x, bottom), ("L", panel_x + width, bottom)], FRAME
            )
        )
        up = _ticks(y, *_limits(y))
        heights = [bottom - height * fraction for _, fraction in up]
        parts.append(
            path_svg(
                [step for at in heights for step in (("M", panel_x - 2, at), ("L", panel_x, at))],
                FRAME,
            )
        )
        if column == 0:
            labels = [
                Label(words, panel_x - 4, -at, 6.5, "end")
                for (words, _), at in zip(up, heights, strict=True)
            ]
            labels.append(
                Label(
                    parameter_label(posterior, shown[line]),
                    12.0,
                    -(top + height / 2),
                    7.0,
                    angle=90.0,
                )
            )
            parts += (label.svg(0.0) for label in labels)
    if line == len(shown) - 1:
        labels = [
            Label(words, at + 2, -bottom - 7, 6.5, "end", 40.0)
            for (words, _), at in zip(across, tick_x, strict=True)
        ]
        labels.append(
            Label(parameter_label(posterior, shown[column]), panel_x + width / 2, -bottom - 33, 7.0)
        )
        parts += (label.svg(0.0) for label in labels)
    return "".join(parts)


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.quantile(values, [0.003, 0.997])
    room = 0.08 * (high - low) or 1e-9
    return float(low - room), float(high + room)


def _marginal(values: NDArray[np.float64], panel: Panel) -> str:
    """Return the histogram of one parameter with the median and the limits of both intervals."""
    panel_x, top, width, height = panel
    low, high = _limits(values)
    counts, _ = np.histogram(values, BINS, (low, high))
    steps = [("M", panel_x, top + height)]
    for number, count in enumerate(counts / (1.05 * max(counts.max(), 1))):
        level = top + height * (1.0 - count)
        steps += [
            ("L", panel_x + width * number / BINS, level),
            ("L", panel_x + width * (number + 1) / BINS, level),
        ]
    parts = [
        path_svg([*steps, ("L", panel_x + width, top + height)], f'fill="{DATA}" fill-opacity=".6"')
    ]
    for quantile, dashes in zip(QUANTILES, ("1 1.5", "3 1.5", "", "3 1.5", "1 1.5"), strict=True):
        at = panel_x + width * (float(np.quantile(values, quantile)) - low) / (high - low)
        dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
        parts.append(path_svg([("M", at, top), ("L", at, top + height)], FRAME + dashed))
    return "".join(parts)


def _joint(x: NDArray[np.float64], y: NDArray[np.float64], panel: Panel) -> str:
    """Return the highest-density regions of 68 and 95 % of the draws, and the median."""
    from skimage.measure import find_contours

    panel_x, top, width, height = panel
    limits = _limits(x), _limits(y)

    def place(column: Any, row: Any) -> tuple[Any, Any]:
        return panel_x + width * column, top + height * (1.0 - row)

    counts, _, _ = np.histogram2d(x, y, bins=BINS, range=limits)
    # Empty bins around close the contours; they lie outside the draws.
    density = np.pad(_smooth_counts(counts), 1)
    levels = _density_levels(density, (0.95, 0.68))
    parts = []
    if levels[0] < levels[1] < density.max():
        for level, opacity in zip(levels, (0.25, 0.45), strict=True):
            steps = []
            for contour in find_contours(density, level):
                columns, rows = place(*np.clip((contour.T - 0.5) / BINS, 0.0, 1.0))
                steps += [
                    ("L" if n else "M", *at) for n, at in enumerate(zip(columns, rows, strict=True))
                ]
            parts.append(
                path_svg(steps, f'fill="{DATA}" fill-opacity="{opacity}" fill-rule="evenodd"')
            )
    else:
        spots = [
            place((a - limits[0][0]) / np.ptp(limits[0]), (b - limits[1][0]) / np.ptp(limits[1]))
            for a, b in zip(x[::10], y[::10], strict=True)
        ]
        parts += (f'<circle cx="{a:.1f}" cy="{b:.1f}" r="1" fill="{DATA}"/>' for a, b in spots)
    medians = [
        (float(np.median(z)) - low) / (high - low)
        for z, (low, high) in zip((x, y), limits, strict=True)
    ]
    a, b = place(*medians)
    cross = [("M", a - 3.5, b), ("L", a + 3.5, b), ("M", a, b - 3.5), ("L", a, b + 3.5)]
    return "".join([*parts, path_svg(cross, f'stroke="{MODEL}"')])


def _smooth_counts(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth a histogram by about one bin, because the draws are few."""
    for axis in (0, 1):
        counts = np.apply_along_axis(
            np.convolve, axis, counts, [0.05, 0.25, 0.4, 0.25, 0.05], "same"
        )
    return counts


def _density_levels(density: NDArray[np.float64], shares: tuple[float, ...]) -> list[float]:
    """Return the densities above which the given fractions of the draws lie."""
    ordered = np.sort(density.ravel())[::-1]
    cumulative = np.cumsum(ordered) / ordered.sum()
    return [
        float(ordered[min(int(np.searchsorted(cumulative, fraction)), cumulative.size - 1)])
        for fraction in shares
    ]


def _ticks(draws: NDArray[np.float64], low: float, high: float) -> list[tuple[str, float]]:
    """Return words and place, as a fraction of the axis, of two to four ticks; the label has the
    power of ten.
    """
    power = 10.0 ** _power(draws)
    step = 10.0 ** math.floor(math.log10((high - low) / 2.0))
    step *= max(factor for factor in (1.0, 2.0, 2.5, 5.0) if factor * step <= (high - low) / 2.0)
    values = np.arange(math.ceil(low / step), math.floor(high / step) + 1) * step
    return [
        (f"{value / power:.6g}".replace("-", MINUS), (value - low) / (high - low))
        for value in values.tolist()
    ]


def _power(draws: NDArray[np.float64]) -> int:
    """Return the power of ten removed from the ticks of a parameter."""
    exponent = math.floor(math.log10(np.abs(_limits(draws)).max()))
    return 0 if -3 <= exponent <= 3 else exponent


def parameter_label(posterior: Posterior, index: int) -> str:
    """Return the name of a parameter with unit and power of ten of its ticks."""
    name, unit = posterior.names[index], posterior.units[index]
    words = name.removesuffix(UNIT_SUFFIXES.get(unit, "")).replace("_", " ")
    power = _power(posterior.draws[:, index])
    scale = f"10{str(power).translate(SUPERSCRIPTS)}" if power else ""
    unit = unit if not power or unit != "1" else ""
    return (
        f"{words}\n({' '.join(part for part in (scale, unit) if part)})" if scale or unit else words
    )
