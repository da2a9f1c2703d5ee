"""`auto` says where the tolerance that it was given may not be met: by the chart, or by a number's
own interval.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.method import Context, registry
from charact.method.registry import beyond_note, meets
from labdata import make_measurement, make_refusal
from tests.truth import BarScene, EdgeScene, PointScene

QUICK = Context(quick=True)


def number(value, low, high, **fields):
    return make_measurement(
        "mtf50", "cy/px", value, (low, high), (low, high), method="fake", **fields
    )


def test_the_further_end_of_the_interval_is_what_counts():
    """0.2 is 1.5 % from its lower end and 3 % from its upper one."""
    found = number(0.2, 0.197, 0.206)
    assert beyond_note(found, 3.01) is None
    assert beyond_note(found, 2.0) == (
        "95 % interval extends 3 % from the value, beyond the tolerance `within_percent` 2 %."
    )
    assert beyond_note(make_refusal("mtf50", "cy/px", "nothing to see", method="fake"), 2.0) is None


def test_a_method_meets_a_tolerance_by_the_upper_limit_of_its_errors_where_the_chart_has_one():
    assert meets({"error_percent": 1.6}, 2.0)
    assert not meets({"error_percent": 1.6, "error_limit_percent": 2.4}, 2.0)
    assert meets({"error_percent": 1.6, "error_limit_percent": 1.9}, 2.0)


@pytest.mark.parametrize(
    ("kind", "scene", "target", "quantity"),
    [
        ("edge", EdgeScene(), {}, "mtf50"),
        (
            "bars",
            BarScene(),
            {"bars": BarScene().bars, "frequency_cy_per_px": BarScene().frequency_cy_per_px},
            "mtf",
        ),
        ("point", PointScene(), {}, "mtf50"),
    ],
)
def test_only_numbers_that_auto_was_to_measure_better_are_told(
    kind, scene, target, quantity, seed, monkeypatch
):
    """Asked for half and for twice as much as the interval reaches; a method that was named was
    asked for nothing.
    """
    rows = [
        {"method": name, "error_percent": 0.0, "seconds": 1.0}
        for name in registry.methods_of_kind(kind)
    ]
    monkeypatch.setattr(registry, "chart_table", lambda _: rows)
    stack = scene.frames_drawn(np.random.default_rng(seed))

    def notes(within_percent, method="auto"):
        found = mtf.measure(
            kind, stack, method=method, within_percent=within_percent, context=QUICK, **target
        )
        told = [
            m for m in found.measurements if any("`within_percent`" in note for note in m.notes)
        ]
        assert {m.quantity for m in told} <= {quantity}
        return found.find(quantity)[0], len(told)

    plain, none = notes(1000.0)
    reach = (
        100
        * max(plain.value - plain.interval95[0], plain.interval95[1] - plain.value)
        / plain.value
    )
    assert none == 0
    strict, told = notes(reach / 2)
    assert told >= 1
    assert f"{reach:.2g} % from the value" in strict.notes[-1]
    assert strict.flags == plain.flags
    assert notes(reach / 2, method=plain.method)[1] == 0
