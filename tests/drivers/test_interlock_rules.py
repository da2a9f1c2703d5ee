"""Nothing that a client asks or that happens hurts a tube behind the bench server; without any one
rule it does.
"""

from collections import Counter
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)

from drivers.bench.interlock import REACTIONS, RULES, Interlock
from drivers.bench.state import (
    DarkSeen,
    Failed,
    FilterRead,
    GainRead,
    GateRead,
    Heard,
    InterlockRefused,
    LightRead,
    LowerGain,
    OpenGate,
    RaiseGain,
    SetLight,
    TurnFilter,
)
from labdata import Target
from labdata.limits import LIMITS
from tests.drivers import plant

LEAST_STEPS = 100_000
ALL = [one.name for one in (*RULES, *REACTIONS)]


class AnythingHappens(RuleBasedStateMachine):
    """A bench server with all its rules, to which bursts of up to 400 things happen at a time."""

    tally: ClassVar[Counter] = Counter()

    @initialize(kind=st.integers(0, 5))
    def a_bench_is_opened(self, kind: int) -> None:
        self.plant = plant.Plant(kind=kind)

    @rule(program=st.binary(min_size=300, max_size=1200))
    def things_happen(self, program: bytes) -> None:
        before = self.plant.steps, Counter(self.plant.passed)
        plant.run(self.plant, program)
        self.tally["steps"] += self.plant.steps - before[0]
        self.tally.update(self.plant.passed - before[1])

    @rule(seconds=st.floats(0.0, 3.0))
    def time_passes(self, seconds: float) -> None:
        self.plant.passes(seconds)

    @rule()
    def the_bench_is_opened_anew(self) -> None:
        self.plant.open()

    @invariant()
    def nothing_hurts(self) -> None:
        if hasattr(self, "plant"):
            assert not self.plant.lab.hurts, self.plant.lab.hurts


@pytest.fixture
def simulated_time():
    with plant.simulated_time():
        yield


@pytest.mark.usefixtures("simulated_time")
def test_nothing_that_a_client_asks_and_nothing_that_happens_hurts_the_tube():
    """At least 100,000 random steps, at most 400 between two looks at the tube."""
    AnythingHappens.tally.clear()
    relaxed = settings(
        max_examples=200,
        stateful_step_count=12,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(AnythingHappens, settings=relaxed)
    tally = AnythingHappens.tally
    print(f"{tally['steps']} random steps, 0 violations, commands passed: {dict(tally)}")
    assert tally["steps"] >= LEAST_STEPS
    for command in ("set_conditions", "permit_light", "shine", "dark_frame_seen"):
        assert tally[command] > LEAST_STEPS / 200, "a bench that lets nothing pass proves nothing"


# First program that finds out a lack that programs 0 to 4 do not, or do late
SEEDS = {
    "gate width": 3,
    "filter turns in the dark": 56,
    "filter is known before light": 2,
    "guarded": 9,
    "silence makes safe": 10,
    "too much current makes safe": 20,
    "too bright a light makes safe": 8,
    "a saturated frame makes safe": 18,
    "gate_ns": 3,
    "point_illuminance_lux": 22,
    "point_anode_na_per_cm2": 6,
}


def hurts_of(*, name: str, steps: int = 40_000, **made) -> list[str]:
    """What hurts a tube first, over programs of 400 steps; where one of `SEEDS` does it, it is the
    first.
    """
    for seed in range(SEEDS.get(name, 0), SEEDS.get(name, 0) + steps // 400):
        tube = plant.Plant(kind=seed, **made)
        plant.run(tube, np.random.default_rng(seed).bytes(1200))
        if tube.lab.hurts:
            return tube.lab.hurts
    return []


@pytest.mark.usefixtures("simulated_time")
@pytest.mark.parametrize("without", ALL)
def test_each_rule_is_needed(without):
    """A server that lacks one rule lets the tube be hurt."""
    assert hurts_of(name=without, without=without)


@pytest.mark.usefixtures("simulated_time")
@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_a_tenth_too_high_is_found_out(name):
    loose = replace(plant.LIMITS, **{name: 1.1 * getattr(plant.LIMITS, name)})
    assert hurts_of(name=name, limits=loose)


def unread():
    """An interlock that was told nothing."""
    return Interlock(plant.LIMITS, clock=lambda: 100.0)


def hot():
    """An interlock in a sound hot state: gate open at gain, light out, dark seen."""
    tube = unread()
    tube.tell(FilterRead(known=False))
    for event in (
        GateRead(width_ns=0.0, rate_hz=0.0),
        GainRead(mcp_v=0.0),
        LightRead(illuminance_lux=0.0),
        FilterRead(known=True),
        Heard(now_s=100.0),
    ):
        tube.tell(event)
    tube.permit(SetLight(illuminance_lux=0.0, point=False, target=Target()))
    tube.permit(RaiseGain(goal_v=800.0, rate_v_per_s=50.0))
    tube.tell(GainRead(mcp_v=800.0))
    tube.permit(OpenGate(width_ns=1.6e7, rate_hz=59.94))
    tube.tell(GateRead(width_ns=1.6e7, rate_hz=59.94))
    tube.tell(DarkSeen())
    return tube


def light(lux: float, **changes) -> SetLight:
    return SetLight(**{"illuminance_lux": lux, "point": False, "target": Target(), **changes})


@pytest.mark.parametrize(
    ("event", "command", "sentence"),
    [
        (None, light(0.02), "illuminance_lux must not exceed the limit 0.01, got 0.02"),
        (
            None,
            RaiseGain(goal_v=850.0, rate_v_per_s=50.0),
            "the gate must be shut while the gain moves",
        ),
        (None, LowerGain(goal_v=700.0), "the gate must be shut while the gain moves"),
        (None, light(0.0, target=Target(bars=4)), "the gate must be shut while a target is placed"),
        (
            None,
            OpenGate(width_ns=2.1e7, rate_hz=10.0),
            r"gate_ns must not exceed the limit 2e\+07, got 2.1e\+07",
        ),
        (
            None,
            OpenGate(width_ns=1.9e7, rate_hz=59.94),
            "open for at most 0.999 of the time, got 1.139",
        ),
        (
            LightRead(illuminance_lux=1e-4),
            OpenGate(width_ns=1e6, rate_hz=50.0),
            "light must be out when the gate opens",
        ),
        (
            LightRead(illuminance_lux=1e-4),
            TurnFilter(),
            "must be out while a filter turns, got up to 0.0001",
        ),
        (
            FilterRead(known=False),
            light(1e-4),
            "the filter must be read before there is light, got none read before 0.0001 lux",
        ),
        (
            Failed(sentence="the supply tripped"),
            light(1e-4),
            "reopened after a failure, got: the supply tripped",
        ),
        (Heard(now_s=99.0), light(1e-4), "shown life within 0.6 s, got 1 s of silence"),
    ],
)
def test_a_refusal_names_the_rule_and_the_value(event, command, sentence):
    tube = hot()
    if event is not None:
        tube.tell(event)
    with pytest.raises(InterlockRefused, match=sentence):
        tube.permit(command)


def test_more_light_is_allowed_at_less_gain():
    tube = hot()
    tube.permit(light(9e-3))
    tube = hot()
    tube.tell(GainRead(mcp_v=890.0))
    with pytest.raises(
        InterlockRefused, match=r"exceed 120 nA/cm2 of MCP output, got 169.2.*lower the gain before"
    ):
        tube.permit(light(9e-3))
    tube.permit(light(6e-3))


def test_nothing_is_known_before_it_is_read():
    tube = unread()
    tube.tell(Heard(now_s=100.0))
    for command in (
        RaiseGain(goal_v=100.0, rate_v_per_s=1.0),
        OpenGate(width_ns=1e3, rate_hz=1.0),
        light(1e-6),
    ):
        with pytest.raises(InterlockRefused):
            tube.permit(command)


def test_a_dark_frame_behind_a_gate_not_surely_open_proves_nothing():
    tube = unread()
    tube.tell(LightRead(illuminance_lux=0.0))
    tube.tell(DarkSeen())
    assert not tube.state.dark_seen
