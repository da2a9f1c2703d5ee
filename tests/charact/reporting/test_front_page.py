"""The first page says no more than the numbers do."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from charact.reporting import is_tube, leading, sheet, verdict
from labdata import Measurement, Result, load_sensor, make_refusal, measurement_from_sd, result_io
from tests.truth.sessions import session_in_memory

SESSION = session_in_memory(())
NOTHING = Result(measurements=(make_refusal("mtf50", "cy/px", "no edge", method="m"),))
UNITS = {"mtf50": "cy/px", "system_gain": "DN/e-", "read_noise": "DN", "prnu": "%"}


def numbers(**flags: tuple[str, ...]) -> Result:
    """Four quantities of a plain camera, with flags by quantity."""
    made = [
        measurement_from_sd(name, unit, 0.2, 0.01, method="m", flags=flags.get(name, ()))
        for name, unit in UNITS.items()
    ]
    return Result(measurements=tuple(made))


def outcome(passed: bool) -> Any:
    """A validation of one statistic."""
    return SimpleNamespace(
        passed=passed, statistics=(SimpleNamespace(title="blur", passed=passed),), controls=()
    )


@pytest.mark.parametrize(
    ("result", "validation", "status", "words"),
    [
        (numbers(), None, "ok", "all 4 leading numbers are ok"),
        (numbers(), outcome(True), "ok", "simulated frames agree"),
        (numbers(), outcome(False), "refused", "Do not trust the fitted sensor"),
        (numbers(prnu=("drift",)), None, "suspect", "Look at 1 of 4"),
        (numbers(prnu=("clipped",), mtf50=("saturated",)), None, "refused", "Do not trust: 2 of 4"),
        (numbers(**dict.fromkeys(UNITS, ("drift",))), None, "refused", "Do not trust: 4 of 4"),
        (NOTHING, None, "refused", "Nothing could"),
    ],
)
def test_the_verdict_is_no_better_than_the_numbers(result, validation, status, words):
    found = verdict(SESSION, result, validation)
    assert found.status == status and words in found.heading


def test_a_validation_that_fails_by_its_controls_names_the_null_control_alone():
    def control(name: str, *noticed: str, passed: bool) -> SimpleNamespace:
        return SimpleNamespace(name=name, title=f"{name} frames", passed=passed, noticed_by=noticed)

    statistics = (SimpleNamespace(title="blur", passed=True),)
    # A negative control that nothing notices is a limit of the validation, no failure.
    unnoticed = control("negative", passed=False)
    failed = SimpleNamespace(
        passed=False,
        statistics=statistics,
        controls=(control("null", "point", passed=False), unnoticed),
    )
    assert verdict(SESSION, numbers(), failed).reasons == (
        "a null control did not hold in point: null frames",
    )
    blind = SimpleNamespace(
        passed=False, statistics=statistics, controls=(control("null", passed=True), unnoticed)
    )
    assert verdict(SESSION, numbers(), blind).reasons == ("no negative control was noticed",)


def test_a_reason_names_quantity_finding_and_flag():
    noted = (
        numbers(prnu=("drift",))
        .measurements[-1]
        .with_(notes=("drift: 3 DN a frame; what settles it: a lamp",))
    )
    (reason,) = verdict(
        SESSION, Result(measurements=(*numbers().measurements[:3], noted)), None
    ).reasons
    assert reason == "prnu: 3 DN a frame; what settles it: a lamp (drift)"


def test_the_sheet_of_a_described_tube_is_in_its_units_and_an_ok_value_leads():
    tube = replace(SESSION, camera=load_sensor("gen3-digital-iccd"))
    doubtful, good = (
        measurement_from_sd("mtf50", "cy/px", value, 0.01, method="m", stack=name, flags=flags)
        for value, name, flags in ((0.1, "a", ("drift",)), (0.2, "b", ()))
    )
    assert leading(tube, Result(measurements=(doubtful, good))) == (good,)
    assert sheet(tube, Result(measurements=(good,)))[0].value.endswith("lp/mm at cathode")


def test_correlated_noise_makes_a_tube_of_an_unknown_camera():
    covariance = measurement_from_sd("covariance_gain", "DN", 12.0, 0.1, method="m")
    refused: Measurement = make_refusal("system_gain", "DN/e-", "correlated", method="m")
    assert is_tube(SESSION, Result(measurements=(covariance, refused)))
    assert not is_tube(SESSION, numbers())


def test_the_result_of_one_analysis_replaces_its_quantities_only(tmp_path):
    result_io.save(numbers(), tmp_path)
    again = measurement_from_sd("prnu", "%", 0.5, 0.01, method="m")
    result_io.save_into(Result(measurements=(again,)), tmp_path)
    kept = result_io.load(tmp_path)
    assert kept is not None and {m.quantity: m.value for m in kept.measurements} == {
        "mtf50": 0.2,
        "system_gain": 0.2,
        "read_noise": 0.2,
        "prnu": 0.5,
    }
