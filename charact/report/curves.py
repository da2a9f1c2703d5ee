"""The MTF of every target of a session in one picture: curves with their bands, bars as points, truth if known."""

from typing import Any

import numpy as np

from charact.report.style import COLOURS, INK, as_svg, panels, report_style, subsample
from charact.report.truth import Truth
from labdata.measurement import Curve, Measurement, Result
from labdata.session import Session

HORIZONTAL, VERTICAL, SLANTED = "horizontal frequency", "vertical frequency", "slanted frequency"
DEGREES = {HORIZONTAL: 0.0, VERTICAL: 90.0, SLANTED: 45.0}


def mtf_svgs(session: Session | None, result: Result, truth: Truth | None = None) -> tuple[str, ...]:
    """Draw all MTF curves and four-bar points of a result, one figure for each direction.

    Parameters
    ----------
    session
        The session, which knows the direction of each target; None where a single file was measured.
    result
        Curves whose name starts with "mtf" and measurements of the quantity "mtf".
    truth
        True values; the entry "mtf" may be a function of frequency and direction.

    Returns
    -------
    tuple of str
        SVG elements; none if there is no curve and no point.
    """
    curves = [(name, curve) for name, curve in result.curves.items() if name.split(":")[0].startswith("mtf")]
    points = [m for m in result.find("mtf") if m.value is not None and m.frequency_cy_per_px is not None]
    ways = [_direction(session, name, curve.stack) for name, curve in curves]
    point_ways = [_point_way(session, m) for m in points]
    drawn = []
    for way in (way for way in DEGREES if way in (*ways, *point_ways)):
        own = [item for item, its in zip(curves, ways, strict=True) if its == way]
        single = [m for m, its in zip(points, point_ways, strict=True) if its == way]
        with report_style():
            figure, grid = panels(size=(5.6, 3.9))
            _plot_curves(grid[0, 0], way, own, single, truth)
            drawn.append(as_svg(figure, f"MTF of all targets against {way}, with 95 % bands"))
    return tuple(drawn)


def _way(angle_deg: float | None) -> str:
    """Direction of a frequency in words."""
    if angle_deg is None:
        return HORIZONTAL
    off = abs((angle_deg + 90) % 180 - 90)
    return HORIZONTAL if off < 25 else VERTICAL if off > 65 else SLANTED


def _point_way(session: Session | None, m: Measurement) -> str:
    """Direction of a single frequency: its own, else its target's."""
    return _target_way(session, m.stack) if m.orientation_deg is None else _way(m.orientation_deg)


def _target_way(session: Session | None, label: str | None) -> str:
    known = {} if session is None else {entry.label: entry.target.angle_deg for entry in session.stacks}
    return _way(known.get(label or ""))


def _direction(session: Session | None, name: str, label: str | None) -> str:
    """Direction of a curve, from its name or from the target of its stack."""
    kind, _, suffix = name.partition(":")
    return VERTICAL if "vertical" in kind else _target_way(session, label or suffix)


def _plot_curves(
    axes: Any, way: str, curves: list[tuple[str, Curve]], points: list[Measurement], truth: Truth | None
) -> None:
    """One direction: bands, curves, points, truth."""
    top = max([0.5, *(float(curve.frequency_cy_per_px[-1]) for _, curve in curves)])
    for colour, (name, curve) in zip(COLOURS * 4, curves, strict=False):
        _plot_curve(axes, curve, colour, name.partition(":")[2] or curve.stack or name)
    drawn = {curve.stack or name.partition(":")[2] for name, curve in curves}
    # A single frequency read off a curve that is here says nothing new; bars measured theirs.
    own = [m for m in points if m.method.startswith("bars") or (m.stack or "") not in drawn]
    for m in own:
        axes.errorbar(m.frequency_cy_per_px, m.value, yerr=_arms(m), fmt="s", markersize=4.5, color=INK, linewidth=1)
    if own:
        axes.plot([], [], "s", color=INK, markersize=4.5, label="MTF at one frequency, 95 %")
    known = (truth or {}).get("mtf")
    if callable(known):
        frequency = np.linspace(1e-4, min(top, 1.0), 120)
        axes.plot(frequency, known(frequency, DEGREES[way]), "--", color=INK, linewidth=1.2, label="truth")
    axes.axhline(0.5, color=INK, linewidth=0.6, alpha=0.5)
    axes.set(xlim=(0, min(top, 0.75)), ylim=(-0.05, 1.15), title=f"{way.capitalize()}; bands hold 95 %")
    axes.set(xlabel="spatial frequency (cy/px)", ylabel="MTF (1)")
    axes.legend(loc="upper right")


def _arms(m: Measurement) -> Any:
    """Distances to the ends of the 95 % interval, shape (2, 1)."""
    if m.interval95 is None or m.value is None:
        return None
    return np.maximum([[m.value - m.interval95[0]], [m.interval95[1] - m.value]], 0)


def _plot_curve(axes: Any, curve: Curve, colour: str, label: str) -> None:
    """One curve with its 95 % band."""
    band = curve.interval95
    low, high = (curve.value, curve.value) if band is None else band
    frequency, value, low, high = subsample(curve.frequency_cy_per_px, curve.value, low, high, most=120)
    if band is not None:
        axes.fill_between(frequency, low, high, color=colour, alpha=0.22, linewidth=0)
    axes.plot(frequency, value, color=colour, label=label)
