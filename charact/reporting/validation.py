"""Validation section of the page: verdict with its power, blind pair, pictures, figures, statistics
and controls.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.reporting.figure_registry import Figure
from charact.reporting.number_format import MINUS, short_text
from charact.reporting.report_images import ReportImage, as_jpeg
from charact.reporting.validation_figures import (
    deviations_by_statistic,
    missing_figures,
    overlay_figure,
    power_figure,
    residual_figure,
    worst_deviations,
)
from charact.validation import FramePair, Statistic, Validation, ValidationControl

# Overlays in their order on the page.
OVERLAYS = (
    "photon-transfer",
    "covariance",
    "noise-spectrum-horizontal",
    "noise-spectrum-vertical",
    "autocorrelation",
    "histogram-dark",
    "histogram-flat",
    "mtf",
    "point",
)
# Parameters that the sentence of power names at each end.
NAMED = 3
# Weakest quality of a JPEG, and most bytes of one: 40 kB are 60 kB in base64.
LEAST_QUALITY, MOST_BYTES = 40, 40_000


@dataclass(frozen=True, kw_only=True)
class BlindPair:
    """Measured and simulated image in a random order, and which one is measured."""

    images: tuple[ReportImage, ...]
    answer: str


@dataclass(frozen=True, kw_only=True)
class Section:
    """Validation section of the page; `rows`: cells and status of each statistic."""

    status: str
    headline: str
    sentence: str  # what the validation could have seen, or what deviates
    origin: str  # what the camera was fitted to
    same_session: bool
    summary: str
    blind: BlindPair | None
    pairs: tuple[tuple[ReportImage, ...], ...]
    patterns: tuple[tuple[ReportImage, ...], ...]
    residuals: tuple[Figure, ...]
    figures: tuple[Figure, ...]
    deviations: tuple[Figure, ...]
    power: tuple[Figure, ...]
    columns: tuple[str, ...]
    rows: tuple[dict[str, Any], ...]
    controls: tuple[dict[str, Any], ...]  # rows of the controls: cells and status
    missing_figures: tuple[str, ...]  # figures that the session does not give
    notes: tuple[str, ...]


def validation_section(validation: Validation, aspect: float = 1.0) -> Section:
    """Return the validation section; `aspect`: row pitch over column pitch of the images."""
    drawn = validation.figures
    return Section(
        status=_status(validation.passed),
        headline=headline_of(validation),
        sentence=sentence_of(validation),
        origin=validation.origin,
        same_session=validation.same_session,
        summary=_summary(validation),
        blind=blind_pair(drawn.blind[0], validation.seed, aspect) if drawn.blind else None,
        pairs=tuple(_pictures(pair, aspect) for pair in drawn.pairs),
        patterns=tuple(_pictures(pair, aspect, pattern=True) for pair in drawn.patterns),
        residuals=tuple(residual_figure(residual, aspect) for residual in drawn.residuals),
        figures=tuple(
            overlay_figure(name, drawn.overlays[name])
            for name in OVERLAYS
            if name in drawn.overlays
        ),
        deviations=(*worst_deviations(validation), *deviations_by_statistic(validation)),
        power=power_figure(validation),
        columns=(
            "Statistic",
            "Distance (1 is usual)",
            "p-value (1)",
            "Fails below (1)",
            "Deviates most",
            "Verdict",
        ),
        rows=tuple(_row(statistic) for statistic in validation.statistics),
        controls=tuple(_control_row(control) for control in validation.controls),
        missing_figures=missing_figures(drawn.overlays),
        notes=(
            *(statistic.note for statistic in validation.statistics if statistic.note),
            *validation.notes,
        ),
    )


def _status(passed: bool) -> str:
    return "ok" if passed else "refused"


def headline_of(validation: Validation) -> str:
    """Return the number of statistics that pass and the state of the controls."""
    passed = sum(result.passed for result in validation.statistics)
    nulls, negatives = (
        [result for result in validation.controls if result.name == name]
        for name in ("null", "negative")
    )
    verdict = "agrees" if validation.passed else "does not agree"
    nulls_verdict = "hold" if all(result.passed for result in nulls) else "do not hold"
    noticed = sum(result.passed for result in negatives)
    return (
        f"Simulation {verdict}: {passed} of {len(validation.statistics)} statistics pass; null "
        f"controls {nulls_verdict}; {noticed} of {len(negatives)} negative "
        "controls noticed"
    )


def sentence_of(validation: Validation) -> str:
    """Return the errors that an agreement excludes and those it does not, or what deviates most."""
    return _power_sentence(validation) if validation.passed else _deviation_sentence(validation)


def _power_sentence(validation: Validation) -> str:
    """Return the least errors that would have been found, and the largest that could have been
    missed.
    """
    detectable = sorted(
        (error for error in validation.power if error.statistic),
        key=lambda error: error.relative_error,
    )
    never = [error.title for error in validation.power if not error.statistic]
    if not validation.power:
        return "How large an error it would have found is not known"
    texts = [f"{error.percent} of {error.title}" for error in detectable]
    detected_text = "; ".join(texts[:NAMED])
    missed = "; ".join(
        [
            *(f"up to {text}" for text in texts[NAMED:][-NAMED:]),
            *(f"any of {title}" for title in never),
        ]
    )
    probability = f"{100.0 * validation.power[0].probability:g} %"
    sentences = (
        f"In {probability} of cases it would have found an error of {detected_text}"
        if detected_text
        else "",
        f"It could have missed one of {missed}" if missed else "",
    )
    return ". ".join(sentence for sentence in sentences if sentence)


def _deviation_sentence(validation: Validation) -> str:
    """Return the likely causes, what deviates most and what may cause it."""
    likely = "".join(f"Likely cause: {result.note}. " for result in validation.likely_causes)
    failed = sorted(
        (result for result in validation.statistics if not result.passed),
        key=lambda result: -result.distance,
    )
    if not failed:
        return "Every statistic passes; the controls did not come out as they must"
    first, further = failed[0], len(failed) - 1
    more = (
        f"; {further} more statistics differ"
        if further > 1
        else "; one more statistic differs"
        if further
        else ""
    )
    return (
        f"{likely}It differs most in {first.worst} ({first.name}), which may come from "
        f"{first.cause}{more}"
    )


def _summary(validation: Validation) -> str:
    return (
        f"The camera “{validation.sensor}” was simulated under the conditions of the session "
        f"“{validation.session}”: {validation.draws} posterior draws, seed {validation.seed}, "
        f"{validation.seconds:.0f} s. A statistic fails where its p-value is below its level, "
        "which holds all of them together to a false alarm in 100 sessions (Holm)."
    )


def _row(statistic: Statistic) -> dict[str, Any]:
    where = (
        statistic.worst
        if statistic.passed
        else f"{statistic.worst}; may come from {statistic.cause}"
    )
    cells = (
        statistic.title,
        f"{statistic.distance:.3g}",
        statistic.p_text,
        short_text(statistic.level),
        where,
    )
    return {"cells": cells, "status": _status(statistic.passed)}


def _control_row(control: ValidationControl) -> dict[str, Any]:
    """Return the row of a control; a negative one that was not noticed is a limit of the
    validation, no failure.
    """
    noticed = ", ".join(control.noticed_by) or "nothing"
    must = "must pass" if control.name == "null" else "must be noticed"
    status = "ok" if control.passed else "refused" if control.name == "null" else "suspect"
    return {"cells": (control.title, must, noticed), "status": status}


def _pictures(pair: FramePair, aspect: float, *, pattern: bool = False) -> tuple[ReportImage, ...]:
    """Return both images of a pair with the same grey scale."""
    what = f"Mean of {pair.frames} frames without shading. " if pattern else ""
    caption = f"{what}Black {pair.low_dn:.4g} DN, white {pair.high_dn:.4g} DN.".replace("-", MINUS)
    return tuple(
        _image(frame, f"{word}, {pair.role}: {pair.label}", caption, aspect)
        for word, frame in (("Measured", pair.measured), ("Simulated", pair.simulated))
    )


def _image(codes: Any, title: str, caption: str, aspect: float) -> ReportImage:
    """Return an image of codes of 8 bits (row, col), as detailed as fits into `MOST_BYTES`."""
    for quality in range(72, LEAST_QUALITY - 1, -8):
        data = as_jpeg(codes, (0.0, 255.0), quality)
        if len(data) * 3 / 4 <= MOST_BYTES:
            break
    return ReportImage(
        title=title,
        caption=caption,
        data=data,
        rows=codes.shape[0],
        cols=codes.shape[1],
        aspect=aspect,
    )


def blind_pair(pair: FramePair, seed: int, aspect: float) -> BlindPair:
    """Return both images in an order set by seed and frame, without labels that identify them."""
    first = bool(np.random.default_rng([seed, int(pair.measured.sum())]).integers(2))
    images = (pair.measured, pair.simulated) if first else (pair.simulated, pair.measured)
    return BlindPair(
        images=tuple(
            _image(
                image,
                f"{name}, a frame of the {pair.role} {pair.label}",
                "Both have one grey scale.",
                aspect,
            )
            for name, image in zip("AB", images, strict=True)
        ),
        answer=f"{'A' if first else 'B'} is measured, {'B' if first else 'A'} is simulated.",
    )
