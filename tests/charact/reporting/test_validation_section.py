"""The validation's section tells what passed, what failed, and whether the controls came out as
they must.
"""

import base64
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from charact.reporting import (
    blind_pair,
    chance_limit,
    deviations,
    headline_of,
    missing_figures,
    page,
    sentence_of,
    validation_section,
    worst_numbers,
)
from charact.reporting.validation_figures import deviations_by_statistic
from charact.validation import (
    FramePair,
    ResidualMap,
    Statistic,
    Validation,
    ValidationControl,
    ValidationFigures,
)
from charact.validation.validation_result import DetectableError
from labdata import Result


def _statistic(p_value: float, name: str = "noise") -> Statistic:
    return Statistic(
        name=name,
        title="Variance and covariance against the mean",
        distance=1.2,
        p_value=p_value,
        level=0.01,
        labels=("variance", "covariance"),
        measured=(1.0, 2.0),
        low95=(0.9, 1.8),
        high95=(1.2, 2.5),
    )


def _validation(p_value: float = 0.4, null: float = 0.5, negative: float = 1e-6) -> Validation:
    frame = np.arange(48, dtype=np.uint8).reshape(6, 8)
    pair = FramePair(
        role="dim flat",
        kind="flat",
        label="flat-1",
        measured=frame,
        simulated=frame[::-1],
        low_dn=3.0,
        high_dn=90.0,
        frames=8,
    )
    curve = {
        "name": "",
        "x": [0.0, 0.1, 0.2],
        "measured": [1, 0.8, 0.5],
        "simulated": [1, 0.79, 0.52],
        "low95": [1, 0.7, 0.4],
        "high95": [1, 0.9, 0.6],
    }
    overlay = {
        "title": "Edge MTF",
        "x_title": "frequency, cy/px",
        "y_title": "MTF",
        "curves": [curve],
    }
    named = {
        "title": "Neighbours",
        "x_title": "lag, px",
        "y_title": "correlation",
        "curves": [{**curve, "x": ["row 1", "row 2", "col 1"]}],
    }
    levels = {
        "title": "Profile",
        "x_title": "radius, px",
        "y_title": "level, DN",
        "y_scale": "symlog",
        "curves": [{**curve, "name": "point-1"}, {**curve, "name": "point-2"}],
    }
    return Validation(
        session="day 1",
        sensor="fitted",
        seed=7,
        draws=16,
        seconds=21.0,
        statistics=(_statistic(p_value),),
        controls=(
            ValidationControl(
                name="null", title="frames of the fitted sensor", statistics=(_statistic(null),)
            ),
            ValidationControl(
                name="negative",
                title="blur after the gain removed",
                statistics=(_statistic(negative),),
            ),
        ),
        power=(
            DetectableError(
                title="PRNU", relative_error=0.12, probability=0.8, statistic="fixed-pattern"
            ),
            DetectableError(
                title="lag", relative_error=float("nan"), probability=0.8, statistic=""
            ),
        ),
        figures=ValidationFigures(
            overlays={"mtf": overlay, "autocorrelation": named, "point": levels},
            pairs=(pair,),
            blind=(pair,),
            patterns=(pair,),
            residuals=(
                ResidualMap(
                    role="dark",
                    label="dark-1",
                    block_px=4,
                    difference_dn=frame.astype(np.float32) - 20.0,
                    sd_dn=5.0,
                ),
            ),
        ),
        notes=("The edge was left out.",),
    )


def _bare() -> Validation:
    """Return a validation without figures."""
    return replace(_validation(), figures=ValidationFigures(), power=(), statistics=(), controls=())


def _text(html: str) -> str:
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", html)).split())


def test_the_page_shows_pictures_statistics_and_controls(made):
    html = page(made.session(), Result(), validation=_validation())
    text = _text(html)
    for piece in (
        "Measured, dim flat: flat-1",
        "Simulated, dim flat: flat-1",
        "Black 3 DN, white 90 DN.",
        "blur after the gain removed",
        "Residual of the dark, dark-1",
        "+27 DN = +5.4 sd",
        "Mean of 8 frames",
        "point-1, measured",
        "Which one is measured?",
        "Variance and covariance against the mean",
        "The edge was left out.",
        "16 posterior draws, seed 7",
        "must pass",
        "must be noticed",
        "Errors that this validation could not have detected",
        "12 %, fixed-pattern",
        "none below 100 %",
        "frequency (cy/px)",
        "MTF (1)",
        "lag (px)",
        "The 2 most deviating of 2 numbers",
    ):
        assert piece in text, piece
    assert html.count("data:image/jpeg") == 6 + len({entry.kind for entry in made.session().stacks})


@pytest.mark.parametrize(
    ("validation", "status", "words"),
    [
        (
            _validation(),
            "ok",
            "agrees: 1 of 1 statistics agree within their tolerances; null controls hold; 1 of 1 "
            "negative controls noticed",
        ),
        (_validation(p_value=1e-4), "refused", "does not agree: 0 of 1"),
        (_validation(negative=0.5), "refused", "0 of 1 negative controls noticed"),
        (_validation(null=1e-5), "refused", "null controls do not hold"),
    ],
)
def test_the_headline_is_no_better_than_statistics_and_controls(validation, status, words):
    assert words in headline_of(validation)
    assert validation.passed == (status == "ok")


def test_an_agreement_says_what_it_could_have_seen_and_a_difference_where_it_is():
    agrees, differs = _validation(), _validation(p_value=1e-4)
    assert sentence_of(agrees) == (
        "In 80 % of cases it would have found an error of 12 % of PRNU. It could have missed one "
        "of any of lag"
    )
    where = replace(differs.statistics[0], worst="covariance", cause="hum")
    sentence = sentence_of(replace(differs, statistics=(where,)))
    assert sentence == (
        "No named cause explains it. It differs most in covariance (noise), which may come from hum"
    )


def test_the_page_says_whether_the_camera_was_fitted_to_the_same_session(made):
    marked = page(made.session(), Result(), validation=replace(_bare(), same_session=True))
    assert "agree by construction" in _text(marked).partition("Numbers to take along")[0]
    assert "▲ Same session" in _text(marked)
    other = _text(page(made.session(), Result(), validation=_bare()))
    assert "agree by construction" not in other
    assert "was not fitted to frames of this session" in other


def test_the_answer_is_the_truth_and_nothing_else_tells_the_pair_apart():
    pair = _validation().figures.blind[0]
    answers = set()
    for seed in range(8):
        blind = blind_pair(pair, seed, 1.0)
        first = base64.b64decode(blind.images[0].data)
        shown = _decoded(first)
        # Rows ascend in the measured frame and descend in the simulated one.
        assert (shown[0].mean() < shown[-1].mean()) == blind.answer.startswith("A is measured")
        words = [(image.title[1:], image.caption, image.rows, image.cols) for image in blind.images]
        assert words[0] == words[1]
        answers.add(blind.answer)
    assert len(answers) == 2


def _decoded(jpeg: bytes) -> np.ndarray:
    import cv2

    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return image.astype(float)


def test_deviations_are_in_standard_deviations_and_the_worst_come_first():
    statistic = replace(
        _statistic(0.4), measured=(2.0, 3.0), low95=(-1.96, 1.02), high95=(1.96, 4.98)
    )
    assert deviations(statistic) == pytest.approx([2.0, 0.0])
    # The probability of a number that cannot be measured is 0.
    unknown = replace(statistic, measured=(0.0, 0.0), p_value=0.0)
    assert deviations(unknown).size == 0
    worst = worst_numbers(replace(_validation(), statistics=(unknown, statistic)))
    assert [(label, z) for label, _, z in worst] == [
        ("variance", pytest.approx(2.0)),
        ("covariance", 0.0),
    ]


def test_the_worst_number_of_each_failing_statistic_is_drawn_beside_many_of_another_one():
    many = replace(
        _statistic(1e-9),
        name="many",
        labels=tuple(f"many {i}" for i in range(40)),
        measured=(100.0,) * 40,
        low95=(-1.96,) * 40,
        high95=(1.96,) * 40,
    )
    few = replace(
        many, name="few", labels=("few",), measured=(7.0,), low95=(-1.96,), high95=(1.96,)
    )
    chance = replace(few, name="chance", labels=("chance",), measured=(8.0,), p_value=0.5)
    shown = replace(_validation(), statistics=(chance, few, many))
    worst = worst_numbers(shown)
    assert [statistic.name for _, statistic, _ in worst] == ["many"] * (len(worst) - 1) + ["few"]
    names = [statistic.name for statistic in (chance, few, many)]
    unknown = replace(shown.statistics[0], name="unknown", p_value=0.0)
    with_unknown = replace(shown, statistics=(*shown.statistics, unknown))
    drawn = deviations_by_statistic(with_unknown)[0].svg
    assert ">unknown, not measurable<" in drawn
    assert sorted(names, key=lambda name: drawn.index(f">{name}<")) == ["many", "chance", "few"]


def test_the_chance_limit_is_students_quantile():
    # Quantile .995 of Student's t with 15 degrees of freedom, by the tables: 2.947.
    assert chance_limit(1, 16) == pytest.approx(2.947, abs=5e-4)
    assert chance_limit(100, 16) > chance_limit(10, 16)


def test_figures_that_a_session_cannot_give_are_named():
    section = validation_section(_bare())
    assert [sentence.split(":")[0] for sentence in section.missing_figures] == [
        "No MTF is drawn",
        "No halo profile is drawn",
    ]
    assert missing_figures(_validation().figures.overlays) == ()
