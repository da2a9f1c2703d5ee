"""The plan of the campaign: a dark and two flats at two gains, each a third of a second of frames."""

from pathlib import Path

from labdata.conditions import Conditions
from labdata.limits import Override
from labdata.plan import Plan, Step

FRAMES = 10
GATE_NS = 1.6e7
FAST = Override(limit="ramp_v_per_s", value=4000.0, reason="the virtual output moves faster than life")


def small_plan(sensor: Path, seed: int) -> Plan:
    """Return the plan for a sensor's description; the seed is the virtual bench's."""
    steps = (
        Step(label="dark", kind="dark", frames=FRAMES, conditions=Conditions(mcp_v=650.0, gate_ns=GATE_NS)),
        _flat("low", 650.0),
        _flat("high", 720.0),
    )
    return Plan(name="campaign", sensor=str(sensor), seed=seed, overrides=(FAST,), steps=steps)


def _flat(label: str, mcp_v: float) -> Step:
    asked = Conditions(mcp_v=mcp_v, gate_ns=GATE_NS, illuminance_lux=1e-5)
    return Step(label=label, kind="flat", frames=FRAMES, conditions=asked)
