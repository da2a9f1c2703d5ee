"""Validation section of the page: verdict with its power, blind pair, pictures, figures, statistics
and controls.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.reporting.figure_registry import Figure
from charact.reporting.report_images import ReportImage, as_jpeg
from charact.reporting.validation_figures import (
    deviations_by_statistic,
    missing_figures,
    overlay_figure,
    power_figure,
    residual_figure,
    worst_deviations,
)
from charact.reporting.validation_text import (
    headline_of,
    sentence_of,
    size_text,
    tolerance_text,
)
from charact.validation import FramePair, Statistic, Validation, ValidationControl
from charact.validation.statistic import Agreement
from charact.validation.thresholds import VALIDATION
from labdata.number_format import MINUS

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
        status={"agrees": "ok", "differs": "refused", "undecided": "suspect"}[validation.verdict],
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
            "Departure ± 95 %",
            "Tolerance",
            "p-value (1)",
            "Departs in",
            "Verdict",
        ),
        rows=tuple(_row(statistic) for statistic in validation.statistics),
        controls=tuple(_control_row(control) for control in validation.controls),
        missing_figures=missing_figures(drawn.overlays),
        notes=validation.notes,
    )


def _summary(validation: Validation) -> str:
    return (
        f"The camera “{validation.sensor}” was simulated under the conditions of the session "
        f"“{validation.session}”: {validation.draws} posterior draws, seed {validation.seed}, "
        f"{validation.seconds:.0f} s. A departure is no chance where its p-value is low, which "
        f"happens by chance once in {1.0 / VALIDATION.level:g} sessions (Holm); it matters where "
        "it is beyond its tolerance."
    )


# Colour of a verdict on a statistic.
STATUS: dict[Agreement, str] = {
    "agrees": "ok",
    "within": "ok",
    "differs": "refused",
    "unseen": "suspect",
}


def _row(statistic: Statistic) -> dict[str, Any]:
    where, unseen = statistic.worst, len(statistic.unseen)
    if not statistic.passed:
        where += f"; may come from {statistic.cause}"
    if unseen:
        where += (
            f"; {unseen} of {len(statistic.labels)} numbers could not have seen their tolerance"
        )
    cells = (
        statistic.title,
        size_text(statistic) or "—",
        tolerance_text(statistic) or "—",
        statistic.p_text,
        where,
    )
    return {"cells": cells, "status": STATUS[statistic.verdict]}


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
