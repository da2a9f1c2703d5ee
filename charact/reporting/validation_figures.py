"""Figures of the validation section: curves with the simulated band, residuals, deviations by name,
and power.
"""

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.reporting.figure_registry import Figure
from charact.reporting.figure_svg import as_svg
from charact.reporting.style import (
    COLOURS,
    DATA,
    INK,
    MODEL,
    WARN,
    has_all,
    panel,
    plot_band,
    report_style,
    subsample,
)
from charact.validation import ResidualMap, Statistic, Validation
from charact.validation.thresholds import VALIDATION
from labdata.number_format import MINUS

# Numbers whose deviations are drawn by name: about as many as can be read at once.
NAMED = 16
# Colour scale of a residual, standard deviations, unless it is larger; linear range of large
# deviations.
LEAST_SCALE_SD, LINEAR_SD = 4.0, 5.0
DEVIATION_TICKS_SD = (-10000, -2000, -500, -100, -20, -5, 0, 5, 20, 100, 500, 2000, 10000)
# Marks on the colour scale of a residual, over its end.
SCALE = np.linspace(-1.0, 1.0, 5)
# Half of a two-sided 95 % interval of a Gaussian, standard deviations.
TWO_SIDED_95 = 1.96

CAPTIONS = {
    "histogram-dark": "A tail above the band: ions, cosmic rays or hot pixels that blink.",
    "histogram-flat": "A tail outside the band: pulse heights, clipping or rounding.",
    "noise-spectrum-horizontal": "A peak above the band is interference; a slope that departs "
    "from it is blur after the gain or the video bandwidth.",
    "noise-spectrum-vertical": (
        "A peak is banding or hum; an excess towards zero is noise of whole rows."
    ),
    "point": "The halo is what lies outside the blur of the source; other levels than the "
    "brightest are drawn, not tested.",
}


def overlay_figure(name: str, data: Mapping[str, Any]) -> Figure:
    """Plot measured curves over the simulated ones with their 95 % bands."""
    title, curves = str(data.get("title", name)), data["curves"]
    with report_style():
        figure, axes = panel((5.6, 3.6))
        for number, curve in enumerate(curves):
            model, measured_colour = (
                (MODEL, DATA) if len(curves) == 1 else (COLOURS[number], COLOURS[number])
            )
            named = _plot_curve(axes, curve, model, measured_colour, alone=len(curves) == 1)
            if named:
                axes.set_xticks(
                    range(len(curve["x"])), [str(x) for x in curve["x"]], rotation=30, ha="right"
                )
        if "y_scale" in data:
            axes.set_yscale(data["y_scale"])
        axes.set(
            xlabel=_with_unit(data.get("x_title", "")),
            ylabel=_with_unit(data.get("y_title", title)),
        )
        if len(curves) > 1:
            figure.legend(loc="outside lower center", ncols=min(len(curves), 2))
        else:
            axes.legend()
        band = (
            "Band: 95 % of simulated sets."
            if len(curves) == 1
            else (
                "Points or thick lines: measured; thin lines and bands: mean and 95 % of "
                "simulated sets."
            )
        )
        caption = f"{band} {CAPTIONS.get(name, '')}".strip()
        return Figure(section="validation", title=title, svg=as_svg(figure, title), caption=caption)


def _plot_curve(
    axes: Any, curve: Mapping[str, Any], model: str, measured_colour: str, *, alone: bool
) -> bool:
    """Plot a curve and its band; return whether its places are names."""
    named = isinstance(curve["x"][0], str)
    x = np.arange(len(curve["x"]), dtype=float) if named else np.asarray(curve["x"], float)
    x_simulated = np.asarray(curve["x_simulated"], float) if has_all(curve, "x_simulated") else x
    at, low, high = subsample(x_simulated, curve["low95"], curve["high95"])
    plot_band(axes, at, low, high, model)
    axes.plot(
        *subsample(x_simulated, curve["simulated"]),
        color=model,
        linewidth=1.4 if alone else 0.7,
        label="simulated, band 95 %" if alone else None,
    )
    axes.plot(
        *subsample(x, curve["measured"]),
        "o" if len(x) < 45 else "-",
        color=measured_colour,
        markersize=4 if alone else 3,
        linewidth=1.0,
        label="measured" if alone else f"{curve['name']}, measured",
    )
    return named


def _with_unit(title: str) -> str:
    """Return an axis title "quantity, unit" as "quantity (unit)"; without unit (1)."""
    quantity, comma, unit = title.rpartition(", ")
    return f"{quantity} ({unit})" if comma else f"{title} (1)"


def residual_figure(residual: ResidualMap, aspect: float) -> Figure:
    """Plot a measured mean frame less the simulated one; `aspect`: row pitch over column pitch."""
    difference, sd = np.asarray(residual.difference_dn, float), max(residual.sd_dn, 1e-9)
    largest = max(LEAST_SCALE_SD * sd, float(np.quantile(np.abs(difference), 0.998)))
    rows, cols = (size * residual.block_px for size in difference.shape)
    with report_style():
        figure, axes = panel((4.8, 0.6 + 2.3 * min(1.4, rows * aspect / cols)))
        figure.set_layout_engine("none")
        axes.set_position((0.13, 0.17, 0.51, 0.78))
        drawn = axes.imshow(
            difference,
            cmap="RdBu_r",
            vmin=-largest,
            vmax=largest,
            extent=(0, cols, rows, 0),
            interpolation="nearest",
            aspect=aspect,
        )
        bar = figure.colorbar(
            drawn, cax=figure.add_axes((0.67, 0.22, 0.03, 0.68)), ticks=largest * SCALE
        )
        bar.ax.set_yticklabels(
            [_minus(f"{at:+.2g} DN = {at / sd:+.2g} sd") if at else "0" for at in bar.get_ticks()]
        )
        axes.grid(False)
        axes.set(xlabel="column (px)", ylabel="row (px)")
        title = f"Residual of the {residual.role}, {residual.label}"
        mean, rms = float(difference.mean()), float(np.sqrt((difference**2).mean()))
        caption = (
            f"Measured mean frame less that of all simulated sets, means of {residual.block_px} × "
            f"{residual.block_px} px: mean {_minus(f'{mean:+.3g}')} DN, rms {rms:.3g} DN; sd of a "
            f"simulated set {sd:.3g} DN."
        )
        return Figure(section="validation", title=title, svg=as_svg(figure, title), caption=caption)


def _minus(text: str) -> str:
    return text.replace("-", MINUS)


def deviations(statistic: Statistic) -> NDArray[np.float64]:
    """Return the deviations of a statistic's numbers from their predictions, sd; empty where none
    was measurable.
    """
    # The probability of one that was not measurable is 0.
    if not statistic.measured or statistic.p_value == 0.0:
        return np.array([])
    low, high, measured = (
        np.asarray(v, float) for v in (statistic.low95, statistic.high95, statistic.measured)
    )
    return TWO_SIDED_95 * (measured - (low + high) / 2) / np.maximum((high - low) / 2, 1e-300)


def chance_limit(numbers: int, draws: int) -> float:
    """Return the deviation that one of several numbers exceeds with the probability of a false
    alarm, sd.

    Notes
    -----
    Student's t with one degree of freedom less than there are simulated sets, as their mean and
    spread are estimates; Bonferroni, as if the numbers were independent.
    """
    from scipy.special import stdtrit

    return float(stdtrit(max(draws - 1, 1), 1.0 - VALIDATION.level / (2.0 * max(numbers, 1))))


def worst_numbers(validation: Validation) -> list[tuple[str, Statistic, float]]:
    """Return label, statistic and deviation of the most deviating numbers, largest first; of each
    statistic that fails the worst one, however many of another one deviate more.
    """
    numbers = [
        (label, statistic, float(z))
        for statistic in validation.statistics
        for label, z in zip(statistic.labels, deviations(statistic), strict=False)
    ]
    numbers.sort(key=lambda entry: -abs(entry[2]))
    failing = {entry[1].name: entry for entry in reversed(numbers) if not entry[1].passed}
    first = sorted(numbers, key=lambda entry: entry is not failing.get(entry[1].name))
    return sorted(first[:NAMED], key=lambda entry: -abs(entry[2]))


def worst_deviations(validation: Validation) -> tuple[Figure, ...]:
    """Plot the most deviating numbers by name."""
    worst, total = (
        worst_numbers(validation),
        sum(len(deviations(statistic)) for statistic in validation.statistics),
    )
    if not worst:
        return ()
    limit = chance_limit(total, validation.draws)
    with report_style():
        figure, axes = panel((6.4, 0.9 + 0.22 * len(worst)))
        for row, (_, statistic, z) in enumerate(worst):
            colour = WARN if statistic.verdict == "differs" else DATA
            axes.plot([0.0, z], [row, row], color=colour, linewidth=2.4, solid_capstyle="butt")
            axes.plot([z], [row], "o", color=colour, markersize=4)
        _deviation_axis(axes, max(abs(z) for *_, z in worst), limit)
        axes.set_yticks(range(len(worst)), [label for label, *_ in worst], fontsize=7.5)
        axes.set(ylim=(len(worst) - 0.5, -0.5))
        title = f"The {len(worst)} most deviating of {total} numbers"
        caption = (
            "Measured minus predicted, in standard deviations of the prediction; of each statistic "
            "that fails at least the worst number. Dashed: "
            f"{limit:.2g} sd, which the largest of {total} independent numbers exceeds in "
            f"{100.0 * VALIDATION.level:g} % of sessions (Student's t of {validation.draws} "
            "sets). Red: the statistic of the number differs beyond its tolerance."
        )
        return (
            Figure(section="validation", title=title, svg=as_svg(figure, title), caption=caption),
        )


def deviations_by_statistic(validation: Validation) -> tuple[Figure, ...]:
    """Plot the deviation of each number from its prediction by statistic, the worst first.

    A statistic that was not measurable has a row without numbers above all others.
    """
    shown = sorted(
        ((statistic, deviations(statistic)) for statistic in validation.statistics),
        key=lambda row: -np.abs(row[1]).max(initial=0.0) if row[1].size else -np.inf,
    )
    if not any(pull.size for _, pull in shown):
        return ()
    with report_style():
        figure, axes = panel((5.6, 1.1 + 0.24 * len(shown)))
        axes.axvspan(-TWO_SIDED_95, TWO_SIDED_95, color=MODEL, alpha=0.18, linewidth=0)
        for row, (statistic, pull) in enumerate(shown):
            positions = (
                row + np.linspace(-0.25, 0.25, len(pull)) if len(pull) != 1 else np.array([row])
            )
            colour = WARN if statistic.verdict == "differs" else DATA
            axes.plot(pull, positions, "o", color=colour, markersize=3)
        _deviation_axis(axes, max(float(np.abs(pull).max(initial=0.0)) for _, pull in shown))
        names = [
            statistic.name if pull.size else f"{statistic.name}, not measurable"
            for statistic, pull in shown
        ]
        axes.set_yticks(range(len(shown)), names, fontsize=7.5)
        axes.set(ylim=(len(shown) - 0.5, -0.5))
        title = "Deviation of each number from its prediction, by statistic"
        caption = (
            "Measured minus predicted. Band: 95 % of the simulation. Red: the statistic differs "
            "beyond its tolerance."
        )
        return (
            Figure(section="validation", title=title, svg=as_svg(figure, title), caption=caption),
        )


def _deviation_axis(axes: Any, largest: float, *limits: float) -> None:
    """Set an axis of deviations, logarithmic beyond the linear range if one lies far beyond it."""
    side = 1.15 * max(largest, LINEAR_SD, *limits)
    if largest > 4.0 * LINEAR_SD:
        axes.set_xscale("symlog", linthresh=LINEAR_SD)
        ticks = [at for at in DEVIATION_TICKS_SD if abs(at) < side]
        axes.set_xticks(ticks, [_minus(f"{at:g}") for at in ticks])
    axes.set(xlim=(-side, side), xlabel="deviation (sd)")
    axes.axvline(0, color=INK, linewidth=0.8)
    for limit in limits:
        for sign in (-1.0, 1.0):
            axes.axvline(sign * limit, color=INK, linewidth=0.8, linestyle="--")


def power_figure(validation: Validation) -> tuple[Figure, ...]:
    """Plot the least error of each parameter that would have been found."""
    rows = sorted(
        validation.power, key=lambda error: error.relative_error if error.statistic else np.inf
    )
    if not rows:
        return ()
    percent = [100.0 * error.relative_error if error.statistic else 100.0 for error in rows]
    axis_start = 10.0 ** np.floor(np.log10(min(*percent, 1.0)))
    with report_style():
        figure, axes = panel((6.4, 0.9 + 0.26 * len(rows)))
        for row, (error, length) in enumerate(zip(rows, percent, strict=True)):
            axes.barh(
                row,
                length - axis_start,
                left=axis_start,
                height=0.62,
                color=DATA if error.statistic else WARN,
                alpha=0.75,
            )
            words = f"{error.percent}, {error.statistic}" if error.statistic else "none below 100 %"
            axes.text(1.12 * length, row, words, va="center", fontsize=7.5)
        axes.set_xscale("log")
        axes.set_yticks(range(len(rows)), [fill(error.title, 34) for error in rows], fontsize=7.5)
        axes.set(
            xlim=(axis_start, 1500.0),
            ylim=(len(rows) - 0.5, -0.5),
            xlabel="least error that would be found (%)",
        )
        ticks = 10.0 ** np.arange(np.log10(axis_start), 2.01)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.grid(False, axis="y")
        title = "Least error of each parameter that would be found"
        caption = (
            "Errors shorter than a bar are missed in more than "
            f"{100.0 - 100.0 * rows[0].probability:g} % of cases. After the number: the statistic "
            "that finds the error. Numbers are taken as linear in the parameter."
        )
        return (
            Figure(section="validation", title=title, svg=as_svg(figure, title), caption=caption),
        )


def missing_figures(overlays: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a sentence for each curve that the session does not give."""
    reasons = {
        "mtf": "No MTF is drawn: the session has no edge that could be measured in all sets.",
        "point": (
            "No halo profile is drawn: the session has no point source that was found in all sets."
        ),
    }
    return tuple(sentence for name, sentence in reasons.items() if name not in overlays)
