"""Null controls fail where the statistics are useless, not where one set is an extreme one; errors
of parameters are derivatives within the range of the digitiser.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from charact.fitting import fit_sensor
from charact.session_measurement import measure
from charact.validation import PARAMETERS, VALIDATION, side_by_side, validate
from charact.validation.controls import null_control
from charact.validation.statistic import Statistic
from labdata import load_camera
from labdata.camera.parameters import Draws
from tests.charact.fitting.test_stranger_camera import SHORT_S, LinearCamera, session_of

FULL = 33_000.0 / 0.94  # photons at full scale


def _failures(share: float, controls: int, rng: np.random.Generator) -> tuple[int, float]:
    """Return how many null controls fail where a share of the sets does, and their mean sets."""
    sets = 0

    def of_next_set() -> tuple[Statistic, ...]:
        nonlocal sets
        sets += 1
        p_value = 0.0 if rng.uniform() < share else 1.0
        return (Statistic(name="s", title="s", distance=1.0, p_value=p_value, level=0.01),)

    failed = sum(not null_control("null", of_next_set).passed for _ in range(controls))
    return failed, sets / controls


def test_a_null_control_fails_once_in_a_thousand_where_one_set_in_twenty_does(seed: int) -> None:
    """Wald's bound: the ratio of likelihoods exceeds a limit at most once in the limit."""
    rng = np.random.default_rng(seed)
    failed, sets = _failures(VALIDATION.sound_share, 20_000, rng)
    assert failed <= 20 + 4 * np.sqrt(20)
    assert sets < 1.5
    assert _failures(VALIDATION.level, 20_000, rng)[0] <= 4


def test_a_null_control_fails_where_all_sets_do_and_mostly_where_most_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert _failures(1.0, 10, rng) == (10, 3.0)
    assert _failures(0.9, 1000, rng)[0] > 700


def test_the_error_of_a_gain_found_is_not_below_its_interval_where_a_flat_nears_full_scale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flat at 79 % of full scale clips by 30 % more gain: its variance then vanishes, as if an
    error of 1 in 10,000 were found.
    """
    monkeypatch.setattr(side_by_side, "VALIDATION", replace(VALIDATION, draws=8))
    monkeypatch.setattr(side_by_side, "FAULTS", {})
    monkeypatch.setattr(
        side_by_side, "PARAMETERS", tuple(p for p in PARAMETERS if p.title == "gain")
    )
    camera = LinearCamera(1)
    levels = {"dark": 0.0, "flat-0": 0.3, "flat-1": 0.79}
    stacks = [
        (
            label.split("-")[0],
            label,
            camera.expose(level * FULL, SHORT_S, 4),
            SHORT_S,
            level * FULL,
            "",
        )
        for label, level in levels.items()
    ]
    session = session_of(tmp_path, stacks)
    fitted = fit_sensor(session, measure(session, quick=True))
    gain = fitted.parameters()["video.conversion_gain_dn_per_e"]
    (error,) = validate(session, fitted).power
    assert error.relative_error > (gain.high - gain.low) / (2.0 * 1.96) / gain.value / 3.0


def test_the_least_error_of_a_parameter_is_a_third_of_the_width_of_its_draws() -> None:
    gain = next(p for p in PARAMETERS if p.title == "gain")
    path = "video.conversion_gain_dn_per_e"
    camera = load_camera("machine-vision")
    values = float(camera.parameters()[path]) * np.array([0.97, 1.0, 1.03])
    drawn = replace(camera, draws=Draws(names=(path,), values=tuple((float(v),) for v in values)))
    assert gain.least_error(drawn) == pytest.approx(0.03 * np.sqrt(2.0 / 3.0) / 3.0)
    assert gain.least_error(camera) == 0.0
    # The full well and the digitiser cut what exceeds them: gains are made smaller.
    assert gain.change < 0.0
