"""Sweeps of settings, and the limits that they may not exceed."""

import itertools
from collections import Counter
from dataclasses import fields, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdata import (
    BadInput,
    Limits,
    Override,
    StopCriterion,
    SweepRecord,
    Target,
    limits_in_force,
    load_camera,
    load_sensor,
    plan_of,
    plan_toml,
    sensor_names,
)
from labdata import limits as limits_module
from labdata.camera import TubeLimits

# A sweep takes every combination once, in the order asked for, the same at every reading, with its
# darks between.


VOLTS, LUX = (600.0, 700.0, 800.0), (1e-5, 1e-4, 1e-3)
GRID = SweepRecord(kind="flat", frames=4, mcp_v=VOLTS, gate_ns=1.6e7, illuminance_lux=LUX)

lists = st.lists(st.floats(1.0, 800.0), min_size=1, max_size=4, unique=True).map(tuple)
sweeps = st.builds(
    SweepRecord,
    kind=st.just("flat"),
    frames=st.integers(1, 9),
    mcp_v=lists,
    gate_ns=lists,
    exposure_s=st.none() | lists,
    illuminance_lux=lists,
    repeats=st.integers(1, 3),
    order=st.sampled_from(["as-written", "boustrophedon", "randomised"]),
    seed=st.integers(0, 2**32),
    dark_every=st.integers(0, 5),
)
unhurried = settings(deadline=None, derandomize=True, max_examples=60)


def settings_of(sweep: SweepRecord) -> list[tuple]:
    return [
        (s.conditions.mcp_v, s.conditions.illuminance_lux)
        for s in sweep.steps()
        if s.kind != "dark"
    ]


def test_light_runs_fastest_as_written():
    assert settings_of(GRID) == list(itertools.product(VOLTS, LUX))


@unhurried
@given(sweeps)
def test_every_combination_is_taken_once_a_repeat_in_any_order(sweep):
    lit = [step for step in sweep.steps() if step.kind != "dark"]
    assert len(lit) == sweep.count
    assert set(Counter(step.conditions for step in lit).values()) == {sweep.repeats}


@unhurried
@given(sweeps)
def test_there_and_back_never_jumps(sweep):
    """Neighbours differ in one axis, by one place of its list."""
    lit = [step.conditions for step in replace(sweep, order="boustrophedon", dark_every=0).steps()]
    for before, after in itertools.pairwise(lit):
        moved = [
            axis
            for axis in ("mcp_v", "gate_ns", "exposure_s", "illuminance_lux")
            if getattr(before, axis) != getattr(after, axis)
        ]
        assert len(moved) <= 1
        for axis in moved:
            places = getattr(sweep, axis)
            assert (
                abs(places.index(getattr(before, axis)) - places.index(getattr(after, axis))) == 1
            )


@unhurried
@given(sweeps)
def test_darks_stand_first_last_and_no_further_apart_than_asked(sweep):
    kinds = [step.kind for step in sweep.steps()]
    if not sweep.dark_every:
        assert "dark" not in kinds
        return
    assert kinds[0] == kinds[-1] == "dark"
    runs = [len(list(run)) for kind, run in itertools.groupby(kinds) if kind != "dark"]
    assert max(runs) <= sweep.dark_every
    assert all(not step.conditions.illuminance_lux for step in sweep.steps() if step.kind == "dark")


def test_a_dark_is_taken_at_the_settings_of_its_neighbour():
    first, lit, *_ = replace(GRID, dark_every=9).steps()
    assert (
        replace(first.conditions, illuminance_lux=lit.conditions.illuminance_lux) == lit.conditions
    )


def test_another_seed_shuffles_otherwise_and_each_repeat_by_itself():
    one, other = (
        settings_of(replace(GRID, order="randomised", seed=seed, repeats=2)) for seed in (1, 2)
    )
    assert one != other
    assert one[:9] != one[9:]
    assert sorted(one[:9]) == sorted(one[9:])


def test_labels_name_what_varies():
    labels = [step.label for step in replace(GRID, mcp_v=800.0, repeats=2, label="lin").steps()]
    assert labels[:2] == ["lin-1e-05lux-r1", "lin-0.0001lux-r1"]
    targets = replace(
        GRID, mcp_v=800.0, illuminance_lux=1e-4, target=(Target(), Target(angle_deg=5.0))
    )
    assert [step.label for step in targets.steps()] == ["flat-target1", "flat-target2"]


def test_a_plan_holds_single_steps_and_then_its_sweeps_and_is_kept_as_steps():
    plan = plan_of(
        {
            "name": "p",
            "step": [{"label": "first", "kind": "dark", "frames": 2}],
            "sweep": [
                {"kind": "flat", "frames": 3, "mcp_v": [600.0, 700.0], "illuminance_lux": 1e-4}
            ],
            "settle": {"after_gain_s": 2.0},
        },
    )
    assert [step.label for step in plan.steps] == ["first", "flat-600V", "flat-700V"]
    assert [
        plan.settle.wait_s(a.conditions, b.conditions) for a, b in itertools.pairwise(plan.steps)
    ] == [2.0, 2.0]
    assert plan.settle.wait_s(plan.steps[1].conditions, plan.steps[1].conditions) == 0.0
    assert "step = [" in plan_toml(plan) and "sweep" not in plan_toml(plan)


@pytest.mark.parametrize(
    ("wrong", "rule"),
    [
        ({"mcp_v": []}, "a list must hold a value, got none for mcp_v"),
        ({"repeats": 0}, "repeats must lie between 1 and 20000, got 0"),
        ({"repeats": 10**30}, "repeats must lie between 1 and 20000"),
        ({"dark_every": -1}, "dark_every must be 0, or positive"),
        ({"frames": 0}, "at least one frame, got 0"),
        ({"mcp_v": [700.0, 700.0]}, "every step's label must be its own"),
        (
            {"order": "sideways"},
            "order must be one of 'as-written', 'boustrophedon' or 'randomised'",
        ),
        ({"mcp_v": ["high"]}, "must be a number"),
        ({"seed": -1}, "a seed must not be negative, got -1"),
        (
            {"mcp_v": [1.0] * 500, "illuminance_lux": [1e-4] * 500},
            "at most 20000 steps, got 250000",
        ),
        ({"label": "a", "volts": 1.0}, "unknown key 'volts'"),
    ],
)
def test_a_sweep_that_cannot_be_meant_is_refused(wrong, rule):
    with pytest.raises(BadInput, match=rule):
        plan_of({"name": "p", "sweep": [{"kind": "flat", "frames": 3, **wrong}]})


def test_levels_of_a_sweep_may_stop_early_and_their_darks_may_not():
    until = StopCriterion(mean_within_dn=0.1, least_frames=4)
    steps = replace(GRID, dark_every=3, until=until).steps()
    assert {step.until for step in steps if step.kind == "flat"} == {until}
    assert {step.until for step in steps if step.kind == "dark"} == {None}


# A plan can only tighten a tube's limits; to set one aside it names it and says why, and the
# session repeats that.


SENSOR = load_sensor("pulnix-ag5745ef3")
TUBES = [name for name in sensor_names() if load_camera(name).has_tube]


def test_the_tighter_of_plan_and_tube_holds():
    held = limits_in_force(Limits(mcp_v=700.0), SENSOR)
    assert held.mcp_v == 700.0
    assert held.ramp_v_per_s == float(SENSOR.limits.ramp_v_per_s)
    assert held.overridden == () and held.known


def test_an_override_holds_and_is_told_with_both_reasons():
    held = limits_in_force(Limits(), SENSOR, (override(),))
    assert held.mcp_v == 950.0
    (told,) = held.overridden
    assert told.startswith("The tube's limit mcp_v of 900 (a single plate")
    assert told.endswith("was overridden to 950: a stack of two.")


def override(**wrong) -> Override:
    return Override(**{"limit": "mcp_v", "value": 950.0, "reason": "a stack of two", **wrong})


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda: override(limit="colour"), "must name one of mcp_v, ramp_v_per_s"),
        (lambda: override(value=0.0), "must be positive, got 0 for mcp_v"),
        (lambda: override(reason="  "), "must say its reason, got none for mcp_v"),
        (lambda: limits_in_force(Limits(), SENSOR, (override(), override())), "overridden once"),
        (
            lambda: limits_in_force(Limits(mcp_v=950.0), SENSOR),
            r"limits.mcp_v must not exceed the tube's 900 \(a single plate.*\[\[override\]\]",
        ),
    ],
)
def test_a_limit_above_the_tubes_needs_one_explicit_override(make, rule):
    with pytest.raises(BadInput, match=rule):
        make()


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
