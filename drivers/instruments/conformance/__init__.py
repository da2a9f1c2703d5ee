"""What every driver must do with its instrument: the rules that each pair of driver and instrument is tried against.

A rule is a function of a `ConformancePair`; it returns when the pair keeps it and raises AssertionError, or whatever
the driver raises wrongly, when it does not. `rules_for` returns those of a model, so that the maker of a new driver can
run them in a test of their own, or by the command `charact conform MODEL`.
"""

from drivers.instruments.conformance.common import COMMON
from drivers.instruments.conformance.conformance_pair import ConformancePair, Rule
from drivers.instruments.conformance.gates import GATE_RULES
from drivers.instruments.conformance.lights import LIGHT_RULES, METER_RULES, THERMOMETER_RULES, WHEEL_RULES
from drivers.instruments.conformance.supplies import SUPPLY_RULES
from drivers.instruments.models import InstrumentModel
from labdata.wires import Role

__all__ = ["OF_ROLE", "ConformancePair", "Rule", "rules_for"]

OF_ROLE: dict[Role, tuple[Rule, ...]] = {
    "gate": GATE_RULES,
    "supply": SUPPLY_RULES,
    "filter-wheel": WHEEL_RULES,
    "light-source": LIGHT_RULES,
    "light-meter": METER_RULES,
    "thermometer": THERMOMETER_RULES,
}


def rules_for(model: InstrumentModel) -> tuple[Rule, ...]:
    """Return the rules that hold for a model: those of every instrument, and those of its role."""
    return (*COMMON, *OF_ROLE[model.role])
