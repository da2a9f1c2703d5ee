"""Validation section of the page: image pairs, overlays, and statistics with their two controls."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.report.figure_registry import Figure
from charact.report.figure_svg import as_svg
from charact.report.number_format import short_text
from charact.report.report_images import ReportImage, as_jpeg
from charact.report.style import DATA, INK, MODEL, WARN, has_all, panel, plot_band, report_style, subsample
from charact.validation import FramePair, Statistic, Validation, ValidationControl


@dataclass(frozen=True, kw_only=True)
class Section:
    """Validation section of the page; `rows`: cells and status of each statistic."""

    status: str
    headline: str
    summary: str
    pairs: tuple[tuple[ReportImage, ...], ...]
    figures: tuple[Figure, ...]
    columns: tuple[str, ...]
    rows: tuple[dict[str, Any], ...]
    controls: tuple[dict[str, Any], ...]  # rows of the controls: cells and status
    power: tuple[tuple[str, ...], ...]  # parameter, error that would have been found, statistic that finds it
    notes: tuple[str, ...]


def validation_section(validation: Validation, aspect: float = 1.0) -> Section:
    """Return the validation section; `aspect`: row pitch over column pitch of the images."""
    good = sum(one.passed for one in validation.statistics)
    nulls, negatives = ([one for one in validation.controls if one.name == name] for name in ("null", "negative"))
    verdict = "agrees" if validation.passed else "does not agree"
    seen = sum(one.passed for one in negatives)
    held = "hold" if all(one.passed for one in nulls) else "do not hold"
    return Section(
        status=_status(validation.passed),
        headline=f"Simulation {verdict}: {good} of {len(validation.statistics)} statistics pass; "
        f"null controls {held}; {seen} of {len(negatives)} negative controls noticed",
        summary=_summary(validation),
        pairs=tuple(_pictures(pair, aspect) for pair in validation.pairs),
        figures=(*(_overlay(name, data) for name, data in validation.overlays.items()), *_pulls(validation)),
        columns=("Statistic", "Distance (1 is usual)", "p-value (1)", "Fails below (1)", "Deviates most", "Verdict"),
        rows=tuple(_row(one) for one in validation.statistics),
        controls=tuple(_control_row(one) for one in validation.controls),
        power=tuple(
            (one.title, f"{100.0 * one.relative_error:.2g} %", one.statistic)
            if one.statistic
            else (one.title, "none below 100 %", "—")
            for one in validation.power
        ),
        notes=(*(one.note for one in validation.statistics if one.note), *validation.notes),
    )


def _status(passed: bool) -> str:
    return "ok" if passed else "refused"


def _summary(validation: Validation) -> str:
    return (
        f"The camera {validation.sensor} was simulated under the conditions of the session "
        f"{validation.session}: {validation.draws} posterior draws, seed {validation.seed}, "
        f"{validation.seconds:.0f} s. A statistic fails where its p-value is below its level, which holds all of them "
        "together to a false alarm in 100 sessions (Holm)."
    )


def _row(one: Statistic) -> dict[str, Any]:
    where = one.worst if one.passed else f"{one.worst}; may come from {one.cause}"
    cells = (one.title, f"{one.distance:.3g}", one.p_text, short_text(one.level), where)
    return {"cells": cells, "status": _status(one.passed)}


def _control_row(one: ValidationControl) -> dict[str, Any]:
    """Return the row of a control; a negative one that was not noticed is a limit of the validation, no failure."""
    noticed = ", ".join(one.noticed_by) or "nothing"
    must = "must pass" if one.name == "null" else "must be noticed"
    status = "ok" if one.passed else "refused" if one.name == "null" else "suspect"
    return {"cells": (one.title, must, noticed), "status": status}


def _pictures(pair: FramePair, aspect: float) -> tuple[ReportImage, ...]:
    """Return both frames with the same grey scale."""
    caption = f"Black {pair.low_dn:.4g} DN, white {pair.high_dn:.4g} DN."
    return tuple(
        ReportImage(
            title=f"{word}: {pair.label} ({pair.kind})", caption=caption, data=as_jpeg(frame, (0.0, 255.0)),
            rows=frame.shape[0], cols=frame.shape[1], aspect=aspect,
        )
        for word, frame in (("Measured", pair.measured), ("Simulated", pair.simulated))
    )  # fmt: skip


def _overlay(name: str, data: Mapping[str, Any]) -> Figure:
    """Plot the measured curve over the simulated one with its 95 % band."""
    title = str(data.get("title", name))
    with report_style():
        figure, axes = panel((5.6, 3.6))
        named = isinstance(data["x"][0], str)
        x = np.arange(len(data["x"]), dtype=float) if named else np.asarray(data["x"], float)
        x_simulated = np.asarray(data["x_simulated"], float) if has_all(data, "x_simulated") else x
        at, low, high = subsample(x_simulated, data["low95"], data["high95"])
        plot_band(axes, at, low, high, MODEL)
        axes.plot(*subsample(x_simulated, data["simulated"]), color=MODEL, label="simulated, band 95 %")
        style = "o" if len(x) < 30 else "-"
        axes.plot(*subsample(x, data["measured"]), style, color=DATA, markersize=4, label="measured")
        if named:
            axes.set_xticks(x, [str(label) for label in data["x"]], rotation=30, ha="right")
        axes.set(xlabel=_with_unit(data.get("x_title", "")), ylabel=_with_unit(data.get("y_title", title)))
        axes.legend()
        return Figure(section="validation", title=title, svg=as_svg(figure, title))


def _with_unit(title: str) -> str:
    """Return an axis title "quantity, unit" as "quantity (unit)"; without unit (1)."""
    quantity, comma, unit = title.rpartition(", ")
    return f"{quantity} ({unit})" if comma else f"{title} (1)"


def _pulls(validation: Validation) -> tuple[Figure, ...]:
    """Plot the deviation of each number from its prediction, in half-widths of the 95 % interval, by statistic."""
    named = [one for one in validation.statistics if one.measured and len(one.measured) == len(one.low95)]
    if not named:
        return ()
    with report_style():
        figure, axes = panel((5.6, 1.1 + 0.24 * len(named)))
        axes.axvspan(-1, 1, color=MODEL, alpha=0.18, linewidth=0, label="95 % of the simulation")
        for row, one in enumerate(named):
            low, high, measured = (np.asarray(v, float) for v in (one.low95, one.high95, one.measured))
            pull = (measured - (low + high) / 2) / np.maximum((high - low) / 2, 1e-300)
            place = row + np.linspace(-0.25, 0.25, len(pull)) if len(pull) > 1 else np.array([row])
            axes.plot(np.clip(pull, -4, 4), place, "o", color=DATA if one.passed else WARN, markersize=3)
        axes.axvline(0, color=INK, linewidth=0.8)
        axes.set_yticks(range(len(named)), [one.name for one in named], fontsize=7.5)
        axes.set(xlim=(-4.2, 4.2), ylim=(len(named) - 0.5, -0.5))
        axes.set_xlabel("measured minus predicted\n(half-widths of the 95 % interval)")
        figure.legend(loc="outside lower center")
        title = "Deviation of each number from its prediction"
        return (Figure(section="validation", title=title, svg=as_svg(figure, title)),)
