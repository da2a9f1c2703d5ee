"""A pair of driver and instrument on trial: what it can be made to suffer, and how a rule asks of it."""

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from drivers.instruments.instrument import InstrumentModel
from labdata.instrument_config import Role

WRONGS = ("silent", "mute", "garbage", "half-lines", "late", "unplugged", "power-cycle", "trip", "panel")
"""What a pair can be made to suffer; a late answer comes 0.6 s after its time, "panel" changes a setting by hand."""


class ConformancePair(Protocol):
    """A driver's model and an instrument that it can be tried on, at rest when a rule begins."""

    @property
    def model(self) -> InstrumentModel:
        """The model."""
        ...

    def driver(self) -> Any:
        """Open the line anew, after closing the one before, and return a driver on it."""
        ...

    def outputs(self) -> Mapping[str, Any]:
        """What the instrument puts out now, beside its line: gate_open, gate_ns, mcp_v, position, current_a, ..."""
        ...

    def suffer(self, wrong: str, setting: str = "") -> None:
        """Begin one of `WRONGS`, all others ended.

        "panel" needs a setting: of a gate "source", "idle level", "width" or "busy" (every second trigger is lost), of
        a supply "voltage" or "on".
        """
        ...

    def heal(self) -> None:
        """End what is wrong, and clear a trip as a person at the instrument would."""
        ...


Rule = Callable[[ConformancePair], None]
_RULES: dict[Role | None, list[Rule]] = {}


def rule_of(role: Role | None) -> Callable[[Rule], Rule]:
    """Enter a rule among those of a role; None: of every instrument."""

    def enter(rule: Rule) -> Rule:
        _RULES.setdefault(role, []).append(rule)
        return rule

    return enter


def rules_for(model: InstrumentModel) -> tuple[Rule, ...]:
    """Return the rules that hold for a model: those of every instrument, and those of its role."""
    return (*_RULES[None], *_RULES[model.role])


def identify_driver(pair: ConformancePair) -> Any:
    """Return a driver that knows who answers."""
    driver = pair.driver()
    driver.identify()
    return driver


def must_raise(kind: type[Exception], action: Callable[[], object]) -> None:
    """Demand that an action ends in an error of a kind."""
    try:
        result = action()
    except kind:
        return
    raise AssertionError(f"it must end in {kind.__name__}, got {result!r}")


def wait_for(there: Callable[[], bool], within_s: float = 5.0) -> None:
    """Wait until something is so."""
    deadline_s = time.monotonic() + within_s
    while not there():
        assert time.monotonic() < deadline_s, f"the outputs must follow within {within_s:g} s"
        time.sleep(0.01)


def discard_log(step: str, **details: object) -> None:
    """Nobody keeps a log of the trial."""
