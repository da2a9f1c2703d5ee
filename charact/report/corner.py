"""Corner plot of a posterior: joint regions of 68 and 95 %, marginals on the diagonal."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.report.number_format import MINUS, SUPERSCRIPTS
from charact.report.style import DATA, INK, MODEL, as_svg, panels, report_style, write_note
from labdata.measurement import QUANTILES, Posterior
from labdata.quantity import QUANTITIES

BINS = 22
# Suffixes of parameter names that repeat the unit.
UNIT_SUFFIXES = {"cy/px": "_cy_per_px", "DN": "_dn", "px": "_px", "deg": "_deg", "e-": "_e", "DN2": "_dn2", "pe": "_pe"}


def corner_svg(posterior: Posterior, title: str) -> str:
    """Return the corner plot of a posterior as SVG; at most five parameters that vary are shown."""
    shown = varying(posterior)
    count = max(len(shown), 1)
    with report_style():
        figure, grid = panels(count, count, size=(1.15 + 1.25 * count, 0.85 + 1.15 * count))
        if not shown:
            write_note(grid[0, 0], "No parameter varies.")
        for line in range(len(shown)):
            for column in range(len(shown)):
                _cell(grid[line, column], posterior, shown, line, column)
        return as_svg(figure, f"Corner plot of the posterior of {title}")


def varying(posterior: Posterior) -> tuple[int, ...]:
    """Return the indices of at most five finite parameters that vary, quantities first."""
    draws = posterior.draws
    good = (
        np.isfinite(draws).all(axis=0) & (np.ptp(draws, axis=0) > 0) if len(draws) else np.zeros(draws.shape[1], bool)
    )
    order = sorted(np.flatnonzero(good).tolist(), key=lambda index: posterior.names[index] not in QUANTITIES)
    return tuple(sorted(order[:5]))


def _cell(axes: Any, posterior: Posterior, shown: tuple[int, ...], line: int, column: int) -> None:
    """Plot one panel: empty above the diagonal, a marginal on it, joint regions below."""
    if column > line:
        axes.set_visible(False)
        return
    x = posterior.draws[:, shown[column]]
    axes.grid(False)
    axes.set_xlim(*_limits(x))
    if line == column:
        _marginal(axes, x)
    else:
        y = posterior.draws[:, shown[line]]
        axes.set_ylim(*_limits(y))
        _joint(axes, x, y)
    _label(axes, posterior, shown, line, column)


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.quantile(values, [0.003, 0.997])
    room = 0.08 * (high - low) or 1e-9
    return float(low - room), float(high + room)


def _marginal(axes: Any, values: NDArray[np.float64]) -> None:
    """Plot the histogram of one parameter with the limits of both intervals."""
    axes.hist(values, bins=BINS, range=_limits(values), color=DATA, alpha=0.6, histtype="stepfilled")
    for quantile, style in zip(QUANTILES, (":", "--", "-", "--", ":"), strict=True):
        axes.axvline(float(np.quantile(values, quantile)), color=INK, linewidth=0.8, linestyle=style)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _joint(axes: Any, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    """Plot the highest-density regions of 68 and 95 % of the draws."""
    counts, x_edges, y_edges = np.histogram2d(x, y, bins=BINS, range=(_limits(x), _limits(y)))
    density = _smooth_counts(counts)
    levels = _density_levels(density, (0.95, 0.68))
    middles = (x_edges[:-1] + x_edges[1:]) / 2, (y_edges[:-1] + y_edges[1:]) / 2
    if levels[0] < levels[1] < density.max():
        axes.contourf(*middles, density.T, levels=[*levels, density.max()], colors=[(DATA, 0.25), (DATA, 0.6)])
    else:
        axes.plot(x[::10], y[::10], ".", color=DATA, markersize=2)
    axes.plot(np.median(x), np.median(y), "+", color=MODEL, markersize=7)


def _smooth_counts(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth a histogram by about one bin, because the draws are few."""
    for axis in (0, 1):
        counts = np.apply_along_axis(np.convolve, axis, counts, [0.05, 0.25, 0.4, 0.25, 0.05], "same")
    return counts


def _density_levels(density: NDArray[np.float64], shares: tuple[float, ...]) -> list[float]:
    """Return the densities above which the given fractions of the draws lie."""
    ordered = np.sort(density.ravel())[::-1]
    held = np.cumsum(ordered) / ordered.sum()
    return [float(ordered[min(int(np.searchsorted(held, share)), held.size - 1)]) for share in shares]


def _label(axes: Any, posterior: Posterior, shown: tuple[int, ...], line: int, column: int) -> None:
    """Label the left and lower panels only."""
    last = line == len(shown) - 1
    _ticks(axes.xaxis, posterior.draws[:, shown[column]])
    axes.tick_params(labelsize=6.5, labelbottom=last, labelleft=column == 0 and line > 0, length=2)
    axes.tick_params(axis="x", rotation=40)
    if line > 0 and column < line:
        _ticks(axes.yaxis, posterior.draws[:, shown[line]])
    for number, setter, wanted in ((column, axes.set_xlabel, last), (line, axes.set_ylabel, column == 0 and line > 0)):
        if wanted:
            setter(parameter_label(posterior, shown[number]), fontsize=7)


def _ticks(axis: Any, draws: NDArray[np.float64]) -> None:
    """Set few ticks, with the power of ten moved to the label."""
    from matplotlib.ticker import MaxNLocator

    power = _power(draws)
    axis.set_major_locator(MaxNLocator(3, prune="both"))
    axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:g}".replace("-", MINUS))


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
    return f"{words}\n({' '.join(part for part in (scale, unit) if part)})" if scale or unit else words
