"""Validation section of the page: image pairs, overlays, and statistics with their two controls."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.report.figure_registry import Figure
from charact.report.number_format import short_text
from charact.report.report_images import ReportImage, as_jpeg
from charact.report.style import DATA, INK, MODEL, WARN, as_svg, has_all, panel, plot_band, report_style, subsample
from charact.validation import FramePair, Statistic, Validation, ValidationControl

CONTROL_WORDS = {"null": "must pass", "negative": "must fail"}


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
    notes: tuple[str, ...]


def validation_section(validation: Validation, aspect: float = 1.0) -> Section:
    """Return the validation section; `aspect`: row pitch over column pitch of the images."""
    good = sum(one.passed for one in validation.statistics)
    words = [
        f"{control.name} control {'held' if control.passed else 'did not hold'}" for control in validation.controls
    ]
    verdict = "agrees" if validation.passed else "does not agree"
    controls = (f"p in the {c.name} control ({CONTROL_WORDS[c.name]})" for c in validation.controls)
    return Section(
        status=_status(validation.passed),
        headline=f"Simulation {verdict}: {good} of {len(validation.statistics)} statistics pass; {', '.join(words)}",
        summary=_summary(validation),
        pairs=tuple(_pictures(pair, aspect) for pair in validation.pairs),
        figures=(*(_overlay(name, data) for name, data in validation.overlays.items()), *_pulls(validation)),
        columns=("Statistic", "Distance (1 is usual)", "p-value (1)", "Fails below (1)", *controls, "Verdict"),
        rows=tuple(_row(one, validation.controls) for one in validation.statistics),
        notes=(*(one.note for one in validation.statistics if one.note), *validation.notes),
    )


def _status(passed: bool) -> str:
    return "ok" if passed else "refused"


def _summary(validation: Validation) -> str:
    controls = " ".join(
        f"The {c.name} control ({CONTROL_WORDS[c.name]}) {'held' if c.passed else 'did not hold'}: "
        f"{c.title.rstrip('.')}."
        for c in validation.controls
    )
    return (
        f"The sensor {validation.sensor} was simulated under the conditions of the session "
        f"{validation.session}: {validation.draws} posterior draws, seed {validation.seed}, "
        f"{validation.seconds:.0f} s. A statistic fails where its p-value is below its level. {controls}"
    )


def _row(one: Statistic, controls: tuple[ValidationControl, ...]) -> dict[str, Any]:
    """Return the row of a statistic with its p-value in each control, a dash without one."""
    p_values = []
    for control in controls:
        same = [other for other in control.statistics if other.name == one.name]
        p_values.append(f"{short_text(same[0].p_value)} ({'passes' if same[0].passed else 'fails'})" if same else "—")
    cells = (one.title, f"{one.distance:.3g}", short_text(one.p_value), short_text(one.level), *p_values)
    return {"cells": cells, "status": _status(one.passed)}


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
    """Plot the deviation of each value from its prediction, in half-widths of the 95 % interval."""
    named = [one for one in validation.statistics if one.measured and len(one.measured) == len(one.low95)]
    if not named:
        return ()
    count = sum(len(one.measured) for one in named)
    with report_style():
        figure, axes = panel((5.6, 1.1 + 0.17 * count))
        axes.axvspan(-1, 1, color=MODEL, alpha=0.18, linewidth=0, label="95 % of the simulation")
        labels = []
        for one in named:
            low, high, measured = (np.asarray(v, float) for v in (one.low95, one.high95, one.measured))
            pull = (measured - (low + high) / 2) / np.maximum((high - low) / 2, 1e-300)
            rows = len(labels) + np.arange(len(pull))
            axes.plot(np.clip(pull, -4, 4), rows, "o", color=DATA if one.passed else WARN, markersize=4)
            labels += [f"{one.name}: {label}" for label in (one.labels or range(1, len(pull) + 1))]
        axes.axvline(0, color=INK, linewidth=0.8)
        axes.set_yticks(range(len(labels)), labels, fontsize=6.5)
        axes.set(xlim=(-4.2, 4.2), ylim=(len(labels) - 0.5, -0.5))
        axes.set_xlabel("measured minus predicted\n(half-widths of the 95 % interval)")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0))
        title = "Deviation of each value from its prediction"
        return (Figure(section="validation", title=title, svg=as_svg(figure, title)),)
