"""A plan can only tighten a tube's limits; to set one aside it names it and says why, and the
session repeats that.
"""

from dataclasses import fields

import pytest

from labdata import (
    BadInput,
    Limits,
    Override,
    limits_in_force,
    load_camera,
    load_sensor,
    sensor_names,
)
from labdata import limits as limits_module
from labdata.camera import TubeLimits

SENSOR = load_sensor("pulnix-ag5745ef3")
TUBES = [name for name in sensor_names() if load_camera(name).has_tube]


def test_the_tighter_of_plan_and_tube_holds():
    held = limits_in_force(Limits(mcp_v=700.0), SENSOR)
    assert held.mcp_v == 700.0
    assert held.ramp_v_per_s == float(SENSOR.limits.ramp_v_per_s)
    assert held.overridden == () and held.known


def test_a_limit_above_the_tubes_needs_an_override():
    with pytest.raises(
        BadInput,
        match=r"limits.mcp_v must not exceed the tube's 900 \(a single plate.*\[\[override\]\]",
    ):
        limits_in_force(Limits(mcp_v=950.0), SENSOR)


def test_an_override_holds_and_is_told_with_both_reasons():
    held = limits_in_force(
        Limits(), SENSOR, (Override(limit="mcp_v", value=950.0, reason="a stack of two"),)
    )
    assert held.mcp_v == 950.0
    (told,) = held.overridden
    assert told.startswith("The tube's limit mcp_v of 900 (a single plate")
    assert told.endswith("was overridden to 950: a stack of two.")


@pytest.mark.parametrize(
    ("wrong", "rule"),
    [
        ({"limit": "colour"}, "must name one of mcp_v, ramp_v_per_s"),
        ({"value": 0.0}, "must be positive, got 0 for mcp_v"),
        ({"reason": "  "}, "must say its reason, got none for mcp_v"),
    ],
)
def test_an_override_is_explicit(wrong, rule):
    with pytest.raises(BadInput, match=rule):
        Override(**{"limit": "mcp_v", "value": 950.0, "reason": "a stack of two", **wrong})


def test_one_limit_is_overridden_once():
    twice = Override(limit="mcp_v", value=950.0, reason="why")
    with pytest.raises(BadInput, match="overridden once"):
        limits_in_force(Limits(), SENSOR, (twice, twice))


def test_an_unknown_tube_is_taken_for_a_delicate_and_strong_one():
    unknown, known = limits_in_force(), limits_in_force(Limits(), SENSOR)
    assert not unknown.known
    assert all(
        getattr(unknown, name) <= getattr(known, name)
        for name in limits_module.LIMITS
        if not name.startswith("point_anode")
    )
    for volts in (600.0, 800.0, 900.0):
        assert unknown.load.anode_na_per_cm2(1e-3, volts, 1.0) > known.load.anode_na_per_cm2(
            1e-3, volts, 1.0
        )


@pytest.mark.parametrize("name", TUBES)
def test_every_limit_of_a_shipped_tube_has_its_reason(name):
    limits = load_sensor(name).limits
    assert all(getattr(limits, item.name).source for item in fields(TubeLimits))
    assert not any(
        "nothing is known" in getattr(limits, item.name).source for item in fields(TubeLimits)
    )
