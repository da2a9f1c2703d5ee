"""Laws of the rule from findings and interval to status."""

import ast
import dataclasses
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

import charact
from charact.verdict import Finding, judge, widen_curve
from labdata.measurement import Curve, make_measurement, make_refusal

# 95 % limits at .02 below and .04 above the value, 68 % limits at half of it.
NUMBER = make_measurement("mtf50", "cy/px", 0.2, (0.19, 0.22), (0.18, 0.24), method="m")
UNBOUNDED = Finding(flag="clipped", effect="the plateaus are lost", remedy="less light")


def bounded(flag: str, bound: float, sign: int = 0) -> Finding:
    return Finding(flag=flag, effect=f"a {flag}", remedy="more frames", bound=bound, sign=sign)


@pytest.mark.parametrize(
    ("findings", "moves", "held"),
    [
        ((bounded("drift", 0.0),), (0.0, 0.0), "at most 0 cy/px, within the interval"),
        ((bounded("drift", 0.019),), (0.0, 0.0), "at most 0.019 cy/px, within the interval"),
        ((bounded("drift", 0.03),), (0.03, 0.0), "at most 0.03 cy/px, by which the interval"),
        ((bounded("drift", 0.05),), (0.05, 0.05), "at most 0.05 cy/px, by which the interval"),
        ((bounded("drift", 0.05, 1),), (0.05, 0.0), "at most 0.05 cy/px too high, by which"),
        ((bounded("drift", 0.03, -1),), (0.0, 0.0), "at most 0.03 cy/px too low, within"),
        # Bounds of one side add: alone each lies within the interval.
        ((bounded("drift", 0.015), bounded("gamma", 0.01, 1)), (0.025, 0.0), "by which"),
        ((bounded("drift", 0.015, 1), bounded("gamma", 0.03, -1)), (0.0, 0.0), "within"),
    ],
)
def test_bounded_findings_leave_a_number_ok_in_an_interval_that_holds_them(findings, moves, held):
    judged = judge(NUMBER, findings)
    assert (judged.status, judged.flags, judged.value) == ("ok", (), NUMBER.value)
    assert (*judged.interval95, *judged.interval68) == pytest.approx(
        (0.18 - moves[0], 0.24 + moves[1], 0.19 - moves[0], 0.22 + moves[1])
    )
    assert all(held in note and "more frames" in note for note in judged.notes)


def test_a_number_is_suspect_by_what_no_interval_can_hold():
    judged = judge(NUMBER.with_(notes=("first",)), (bounded("drift", 0.05), UNBOUNDED))
    assert (judged.status, judged.flags) == ("suspect", ("clipped",))
    assert judged.interval95 == pytest.approx((0.13, 0.29))
    assert judged.notes[::2] == (
        "first",
        "clipped: the plateaus are lost; what settles it: less light",
    )
    bare = dataclasses.replace(NUMBER, interval68=None, interval95=None)
    assert [judge(bare, (bounded("drift", size),)).flags for size in (0.0, 1e-9)] == [
        (),
        ("drift",),
    ]


def test_a_refusal_stays_one_and_keeps_its_flags():
    refusal = make_refusal("mtf50", "cy/px", "no edge was found", method="m")
    judged = judge(refusal, (UNBOUNDED, bounded("drift", 0.01)))
    assert (judged.status, judged.flags) == ("refused", ("drift", "clipped"))


def test_neither_order_nor_repetition_of_findings_changes_the_verdict():
    findings = (bounded("drift", 0.013), bounded("gamma", 0.009, 1), UNBOUNDED)
    judged = judge(NUMBER, findings)
    for order in permutations(findings):
        other = judge(NUMBER, (*order, order[0]))
        assert set(other.notes) == set(judged.notes)
        assert other.with_(notes=()) == judged.with_(notes=())
    assert judge(judged, findings) == judged
    assert judge(NUMBER, ()) == NUMBER


def test_a_curve_is_widened_where_its_interval_does_not_hold_the_bound():
    # Draws by the standard deviation of an even spread, bound / sqrt(3).
    limits, draws = np.array([[0.4, 0.4], [0.6, 0.6]]), np.full((4000, 2), 0.5)
    curve = Curve(
        frequency_cy_per_px=np.array([0.1, 0.2]),
        value=np.full(2, 0.5),
        interval68=limits,
        interval95=limits,
        draws=draws,
    )
    wider = widen_curve(curve, np.array([0.05, 0.2]), np.array([0.0, 0.2]))
    assert wider.interval95 == pytest.approx(np.array([[0.4, 0.2], [0.6, 0.8]]))
    assert wider.draws.std(axis=0) == pytest.approx([0.0, 0.2 / np.sqrt(3.0)], rel=1e-3)


@pytest.mark.parametrize(
    "fields", [{"flag": "odd"}, {"bound": -1.0}, {"bound": float("inf")}, {"sign": 2}]
)
def test_a_finding_has_a_known_flag_and_a_finite_bound(fields):
    with pytest.raises(ValueError, match=r"odd|bound|sign"):
        Finding(**{"flag": "drift", "effect": "", "remedy": "", **fields})


MAKERS = {"Measurement", "make_measurement", "measurement_from_draws", "measurement_from_sd"}
# The verdict itself; fusion, with bands that have a status of their own.
EXCEPTIONS = ("verdict/", "fusion/")


def status_setters(source: str) -> list[str]:
    """Return the calls that hand flags or a status to what makes or changes a measurement.

    A refusal has no status to choose; `replace` of other things than measurements may have flags.
    """
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    setting = [
        call for call in calls if {"flags", "status"} & {keyword.arg for keyword in call.keywords}
    ]
    names = [getattr(call.func, "attr", getattr(call.func, "id", "")) for call in setting]
    return [name for name in names if name in MAKERS | {"with_"}]


def test_only_judge_sets_a_status():
    root = Path(charact.__file__).parent
    rooms = {path.relative_to(root).as_posix(): path for path in root.rglob("*.py")}
    found = {name: status_setters(path.read_text("utf-8")) for name, path in rooms.items()}
    assert not {
        name: calls for name, calls in found.items() if calls and not name.startswith(EXCEPTIONS)
    }
    # The law sees what breaks it.
    assert status_setters(
        "a = make_measurement(flags=f)\nb = m.with_(status=s)\nm.with_(notes=n)"
    ) == [
        "make_measurement",
        "with_",
    ]
