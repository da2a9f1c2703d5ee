"""MTF curves of targets and files in the unit asked for, with their 95 % bands."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.reporting.curves import half_line
from charact.reporting.figure_svg import as_svg
from charact.reporting.frequency_unit import unit_title
from charact.reporting.style import (
    COLOURS,
    INK,
    arms,
    panel,
    plot_band,
    report_style,
    subsample,
    white_style,
)
from charact.reporting.summary import Frequency, in_cycles_per_pixel
from charact.reporting.truth import Truth
from labdata import Curve, Measurement, Result, Session

# Words for curves that have no stack or file; those of columns have "_vertical" in their name.
CURVES = {
    "mtf": "MTF",
    "sfr": "conventional SFR, ISO 12233",
    "mtf_bars": "through the bars",
    "mtf_joint": "all targets together",
    "mtf_post_gain": "after the gain, fitted model",
    "mtf_post_gain_free": "after the gain, without a model",
}
DEGREES = {"horizontal frequency": 0.0, "vertical frequency": 90.0, "slanted frequency": 45.0}


def mtf_svgs(
    session: Session | None,
    result: Result,
    truth: Truth | None = None,
    frequency: Frequency = in_cycles_per_pixel,
) -> tuple[str, ...]:
    """Plot all MTF curves and bar-target points of a result, one figure for each direction.

    Parameters
    ----------
    session
        The session, for the direction of each target; None for a single file.
    result
        Curves whose name starts with "mtf" and measurements of the quantity "mtf".
    truth
        True values; the entry "mtf" may be a function of frequency and direction.
    frequency
        Conversion of cycles per pixel to the displayed unit.

    Returns
    -------
    tuple of str
        SVG elements; empty if there is no curve and no point.
    """
    angles = (
        {} if session is None else {entry.label: entry.target.angle_deg for entry in session.stacks}
    )

    def direction(angle_deg: float | None) -> str:
        off = 0.0 if angle_deg is None else abs((angle_deg + 90) % 180 - 90)
        return list(DEGREES)[0 if off < 25 else 1 if off > 65 else 2]

    def curve_direction(name: str, curve: Curve) -> str:
        kind, _, label = name.partition(":")
        return direction(90.0 if "vertical" in kind else angles.get(curve.stack or label))

    curves = [
        (curve_direction(name, curve), name, curve)
        for name, curve in result.curves.items()
        if name.split(":")[0].startswith("mtf")
    ]
    points = [
        (
            direction(
                angles.get(m.stack or "") if m.orientation_deg is None else m.orientation_deg
            ),
            m,
        )
        for m in result.find("mtf")
        if m.value is not None and m.frequency_cy_per_px is not None
    ]
    drawn = []
    for way in (way for way in DEGREES if way in {plotted[0] for plotted in (*curves, *points)}):
        with report_style():
            figure, axes = panel((5.6, 3.9))
            curves_of_way = [
                (name, curve, _measured_on(result, name, curve))
                for its, name, curve in curves
                if its == way
            ]
            points_of_way = [m for its, m in points if its == way]
            _plot_curves(axes, way, curves_of_way, points_of_way, truth, frequency)
            drawn.append(as_svg(figure, f"MTF of all targets against {way}, with 95 % bands"))
    return tuple(drawn)


def plot_files(
    results: Mapping[str, Result], axes: Any = None, frequency: Frequency = in_cycles_per_pixel
) -> Any:
    """Plot the MTF curves of several files in one panel, on white; a file's main curve stands for
    it.

    `axes`: those of a figure to plot into; None: a new figure; `frequency`: conversion of cycles
    per pixel to the displayed unit. Returns the figure.
    """
    with white_style():
        axes = panel((5.6, 3.9))[1] if axes is None else axes
        curves, points = [], []
        for name, result in results.items():
            if len(results) > 1:
                main = [("mtf", result.curves["mtf"])] if "mtf" in result.curves else []
                curves += [(f":{name}", c, _measured_on(result, key, c)) for key, c in main]
                continue
            of_mtf = [
                key for key in result.curves if key == "sfr" or key.split(":")[0].startswith("mtf")
            ]
            curves += [
                (key, result.curves[key], _measured_on(result, key, result.curves[key]))
                for key in of_mtf or result.curves
            ]
            points += (
                m
                for m in result.find("mtf")
                if m.value is not None and m.frequency_cy_per_px is not None
            )
        _plot_curves(axes, "MTF", curves, points, None, frequency)
    return axes.figure


def _measured_on(result: Result, name: str, curve: Curve) -> Measurement | None:
    """Return a measurement on a curve, by which its frequencies are converted."""
    of = curve.stack or name.partition(":")[2]
    measured = [m for m in result.measurements if m.unit == "cy/px"]
    return next((m for m in measured if m.stack == of), next(iter(measured), None))


def _plot_curves(
    axes: Any,
    way: str,
    curves: list[tuple[str, Curve, Measurement | None]],
    points: list[Measurement],
    truth: Truth | None,
    convert: Frequency,
) -> None:
    """Plot one direction: bands, curves, points, truth."""
    top = max([0.5, *(float(curve.frequency_cy_per_px[-1]) for _, curve, _ in curves)])
    # Every unit is a multiple of cycles per pixel.
    widest, unit = convert(1.0, next((m for *_, m in curves), None))
    for colour, (name, curve, measured) in zip(COLOURS * 4, curves, strict=False):
        low, high = (curve.value, curve.value) if curve.interval95 is None else curve.interval95
        frequency, value, low, high = subsample(
            curve.frequency_cy_per_px, curve.value, low, high, max_points=120
        )
        frequency = frequency * convert(1.0, measured)[0]
        if curve.interval95 is not None:
            plot_band(axes, frequency, low, high, colour, 0.22)
        label = name.partition(":")[2] or curve.stack or curve_title(name)
        axes.plot(frequency, value, color=colour, label=label)
    drawn = {curve.stack or name.partition(":")[2] for name, curve, _ in curves}
    # Values read from a curve that is shown are redundant; those of bars are measurements.
    separate_points = [
        m for m in points if m.method.startswith("bars") or (m.stack or "") not in drawn
    ]
    for m in separate_points:
        error = None if m.interval95 is None or m.value is None else arms(m.value, *m.interval95)
        axes.errorbar(
            convert(m.frequency_cy_per_px or 0.0, m)[0],
            m.value,
            yerr=error,
            fmt="s",
            markersize=4.5,
            color=INK,
            linewidth=1,
        )
    if separate_points:
        axes.plot([], [], "s", color=INK, markersize=4.5, label="MTF at one frequency, 95 %")
    known = (truth or {}).get("mtf")
    if callable(known):
        frequency = np.linspace(1e-4, min(top, 1.0), 120)
        true = known(frequency, DEGREES[way])
        axes.plot(widest * frequency, true, "--", color=INK, linewidth=1.2, label="truth")
    half_line(axes)
    axes.set(
        xlim=(0, widest * min(top, 0.75)),
        ylim=(-0.05, 1.15),
        title=f"{way[:1].upper()}{way[1:]}; bands hold 95 %",
    )
    axes.set(xlabel=f"spatial frequency ({unit_title(unit)})", ylabel="MTF (1)")
    axes.legend(loc="upper right")


def curve_title(name: str) -> str:
    """Return the words of a legend for a curve by its name.

    Examples
    --------
    >>> curve_title("mtf_joint_vertical")
    'all targets together, along columns'
    """
    kind = name.replace("_vertical", "")
    along = ", along columns" if kind != name else ""
    return CURVES.get(kind, kind.replace("_", " ")) + along
