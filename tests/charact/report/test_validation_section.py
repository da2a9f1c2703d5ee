"""The validation's section tells what passed, what failed, and whether the controls came out as they must."""

import re
from html import unescape

import numpy as np
import pytest

from charact.report import page
from charact.report.validation import validation_section
from charact.validation import FramePair, Statistic, Validation, ValidationControl
from charact.validation.validation_result import DetectableError
from labdata.measurement import Result


def _statistic(p_value: float, name: str = "noise") -> Statistic:
    return Statistic(
        name=name, title="Variance and covariance against the mean", distance=1.2, p_value=p_value, level=0.01,
        labels=("variance", "covariance"), measured=(1.0, 2.0), low95=(0.9, 1.8), high95=(1.2, 2.5),
    )  # fmt: skip


def _validation(p_value: float = 0.4, null: float = 0.5, negative: float = 1e-6) -> Validation:
    frame = np.arange(48, dtype=np.uint8).reshape(6, 8)
    overlay = {"title": "Edge MTF", "x_title": "frequency, cy/px", "y_title": "MTF", "x": [0.0, 0.1, 0.2]}
    curves = {"measured": [1, 0.8, 0.5], "simulated": [1, 0.79, 0.52], "low95": [1, 0.7, 0.4], "high95": [1, 0.9, 0.6]}
    named = {**overlay, "title": "Neighbours", "x_title": "lag, px", "x": ["row 1", "row 2", "col 1"]}
    return Validation(
        session="day 1", sensor="fitted", seed=7, draws=16, seconds=21.0,
        statistics=(_statistic(p_value),),
        controls=(
            ValidationControl(name="null", title="frames of the fitted sensor", statistics=(_statistic(null),)),
            ValidationControl(name="negative", title="blur after the gain removed", statistics=(_statistic(negative),)),
        ),
        power=(DetectableError(title="PRNU", relative_error=0.12, probability=0.8, statistic="fixed-pattern"),),
        overlays={"mtf": {**overlay, **curves}, "autocorrelation": {**named, **curves}},
        pairs=(FramePair(kind="flat", label="flat-1", measured=frame, simulated=frame, low_dn=3.0, high_dn=90.0),),
        notes=("The edge was left out.",),
    )  # fmt: skip


def _text(html: str) -> str:
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", html)).split())


def test_the_page_shows_pictures_statistics_and_controls(made):
    html = page(made.session(), Result(), validation=_validation())
    text = _text(html)
    for piece in (
        "Measured: flat-1", "Simulated: flat-1", "Black 3 DN, white 90 DN.", "blur after the gain removed",
        "Variance and covariance against the mean", "The edge was left out.", "16 posterior draws, seed 7",
        "must pass", "must be noticed", "What this validation could not have seen", "PRNU 12 % fixed-pattern",
        "frequency (cy/px)", "MTF (1)", "lag (px)", "half-widths of the 95 % interval",
    ):  # fmt: skip
        assert piece in text, piece
    assert html.count("data:image/jpeg") == 2 + len({entry.kind for entry in made.session().stacks})


@pytest.mark.parametrize(
    ("validation", "status", "words"),
    [
        (_validation(), "ok", "agrees: 1 of 1 statistics pass; null controls hold; 1 of 1 negative controls noticed"),
        (_validation(p_value=1e-4), "refused", "does not agree: 0 of 1"),
        (_validation(negative=0.5), "refused", "0 of 1 negative controls noticed"),
        (_validation(null=1e-5), "refused", "null controls do not hold"),
    ],
)
def test_the_headline_is_no_better_than_statistics_and_controls(validation, status, words):
    section = validation_section(validation)
    assert section.status == status
    assert words in section.headline
