"""One level holds for all statistics, other parts of the frame count, and errors of parameters are
estimated.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from charact.validation import (
    SCORES,
    VALIDATION,
    Numbers,
    ParameterChange,
    ValidationTest,
    ensemble,
)

SETS = 20
# Numbers of a group, and how many standard deviations a relative error of 1 of a gain moves each.
SLOPES = {
    "level": (40.0, 30.0),
    "covariance": (20.0, 25.0, 30.0),
    "defects": (0.0, 0.0),
    "shading": (0.0, 0.0),
}


@pytest.fixture(autouse=True)
def few_replicates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "VALIDATION", replace(VALIDATION, replicates=2000))


def _numbers(rng: np.random.Generator, gain_error: float = 0.0) -> dict[str, Numbers]:
    return {
        name: {
            f"{name} {i}": float(rng.standard_normal() + gain_error * slope)
            for i, slope in enumerate(slopes)
        }
        for name, slopes in SLOPES.items()
    }


def _change(change: float, *, power: int = 1) -> ParameterChange:
    plain, changed = _numbers(np.random.default_rng(1)), _numbers(np.random.default_rng(1), change)
    return ParameterChange(title="gain", plain=plain, changed=changed, change=change, power=power)


def _sets(rng: np.random.Generator) -> list[Mapping[str, Numbers]]:
    return [_numbers(rng) for _ in range(SETS)]


def test_a_parameter_that_moves_no_number_is_not_estimated(seed: int) -> None:
    rng, gain = np.random.default_rng(seed), _change(0.3)
    # Light of a free level leaves rounding of the sensitivity.
    moved = {
        name: {label: value * (1.0 + 1e-15) for label, value in group.items()}
        for name, group in gain.plain.items()
    }
    hidden = replace(gain, title="sensitivity", changed=moved)
    assert hidden.changed != hidden.plain
    for changes, titles in (((gain, hidden), [("gain",)]), ((hidden,), [])):
        test = ValidationTest(_sets(rng), seed=seed, changes=changes)
        scores = [one for one in test.statistics(_numbers(rng)) if one.name == SCORES]
        assert [one.labels for one in scores] == titles


def test_a_defect_in_another_part_of_the_frame_fails_and_is_named_with_its_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    test, fresh = ValidationTest(_sets(rng), seed=seed), _numbers(rng)
    parts = {
        place: {name: _numbers(rng)[name] for name in ("defects", "shading")}
        for place in ("left", "right")
    }
    parts["right"]["defects"] = {"defects 0": 0.0, "defects 1": 25.0}
    found = {one.name: one for one in test.statistics(fresh, parts)}
    assert not found["defects"].passed
    assert found["defects"].worst == "defects 1, right"
    assert [name for name, one in found.items() if not one.passed] == ["defects"]


def test_a_gain_off_by_a_fifth_is_estimated_and_fails(seed: int) -> None:
    rng = np.random.default_rng(seed)
    test = ValidationTest(_sets(rng), seed=seed, changes=[_change(0.3)])
    found = {one.name: one for one in test.statistics(_numbers(rng, 0.2))}
    own = found[SCORES]
    assert own.labels == ("gain",)
    # The least error of an estimate by all numbers of unit variance is one over the root of the
    # summed squares.
    error = 1.0 / np.sqrt(sum(slope**2 for slopes in SLOPES.values() for slope in slopes))
    assert own.measured[0] == pytest.approx(0.2, abs=4.5 * 1.2 * error)
    assert own.high95[0] == pytest.approx(1.96 * error, rel=4.5 / np.sqrt(2.0 * SETS))
    assert not own.passed
    assert {one.name: one for one in test.statistics(_numbers(rng))}[SCORES].p_value > 1e-4


def test_the_error_found_of_a_parameter_is_that_of_all_numbers_together(seed: int) -> None:
    """It is smaller than that of any group, and a noise whose square counts may be off by about
    half as much.
    """
    rng = np.random.default_rng(seed)
    test = ValidationTest(_sets(rng), seed=seed, changes=[_change(0.3)])
    found = test.detectable(_change(0.3))
    assert found.statistic == SCORES
    alone = ValidationTest(_sets(rng), seed=seed).detectable(_change(0.3))
    assert alone.statistic in SLOPES
    assert found.relative_error < alone.relative_error
    noise = test.detectable(_change(0.3, power=2))
    # The same shift by a change of 0.3 is one of 0.69 of the square, and of 0.26 of the logarithm.
    # Of both ways, as half of the errors are: ((1 + e)^2 - (1 - e)^2) / 2, and of the logarithm.
    assert 2.0 * noise.relative_error == pytest.approx(found.relative_error * 0.69 / 0.3, rel=0.02)
    gain = test.detectable(_change(0.3, power=0))
    assert np.arctanh(gain.relative_error) == pytest.approx(
        found.relative_error * np.log(1.3) / 0.3, rel=0.02
    )


def test_an_error_that_can_only_be_found_upwards_is_above_1(seed: int) -> None:
    rng = np.random.default_rng(seed)
    test = ValidationTest(_sets(rng), seed=seed, changes=[_change(0.3)])
    # What a gain does by an error of 6 %, this noise does by an amount of 1.7: downwards it is 0.5
    # at most.
    amount = 1.7 / test.detectable(_change(0.3)).relative_error * 0.3
    slow = replace(_change(0.3), power=2, change=np.sqrt(1.0 + 2.0 * amount) - 1.0)
    error = test.detectable(slow).relative_error
    assert (1.0 + error) ** 2 / 2.0 - 0.5 == pytest.approx(1.7, rel=0.05)


def _correlated(rng: np.random.Generator, gain_error: float = 0.0) -> dict[str, Numbers]:
    """Return numbers that share an error, as those of one posterior draw do."""
    shared = rng.standard_normal()
    return {
        name: {label: value + shared for label, value in group.items()}
        for name, group in _numbers(rng, gain_error).items()
    }


def test_errors_of_the_printed_size_are_found_as_often_as_printed(seed: int) -> None:
    """The ensembles that halve correlations, and of one of which the centre is off, do so too."""
    rng, found, tries, ensembles = np.random.default_rng(seed), 0, 12, 20
    for number in range(ensembles):
        sets: list[Mapping[str, Numbers]] = [_correlated(rng) for _ in range(SETS)]
        test = ValidationTest(sets, seed=seed + number, changes=[_change(0.3)])
        error = test.detectable(_change(0.3)).relative_error
        for sign in (1.0, -1.0):
            wrong = [test.statistics(_correlated(rng, sign * error)) for _ in range(tries // 2)]
            found += sum(any(not one.passed for one in statistics) for statistics in wrong)
    print(f"{found} of {ensembles * tries} found")
    # Sets of one ensemble are correlated: their share has an error of .05.
    assert found / (ensembles * tries) == pytest.approx(VALIDATION.power, abs=0.15)


def test_no_error_is_printed_below_the_least_that_a_posterior_leaves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    test = ValidationTest(_sets(rng), seed=seed, changes=[_change(0.3)])
    assert test.detectable(replace(_change(0.3), least_error=0.4)).relative_error == 0.4
