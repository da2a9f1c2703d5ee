"""What every gate must do: open as read back, refuse what it cannot, and shut, heard or not."""

import time

from drivers.bench.safe_state import make_safe
from drivers.errors import InstrumentRejected
from drivers.instruments.conformance.conformance_pair import (
    ConformancePair,
    discard_log,
    identify_driver,
    must_raise,
    rule_of,
    wait_for,
)
from labdata.errors import BadInput

_RATE_HZ, _WIDTH_NS = 60.0, 1e6
_TWO_TRIGGERS_S = 0.1


@rule_of("gate")
def the_gate_opens_as_read_back_and_shuts(pair: ConformancePair) -> None:
    """The gate opens for the width and at the rate that were read back, and shuts."""
    driver = identify_driver(pair)
    driver.shut()
    assert not pair.outputs()["gate_open"]
    read_ns = driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ, delay_ns=500.0)
    assert abs(read_ns - _WIDTH_NS) <= 1e-6 * _WIDTH_NS
    wait_for(lambda: pair.outputs()["gate_open"])
    out = pair.outputs()
    assert abs(out["gate_ns"] - read_ns) <= 1e-6 * read_ns
    assert abs(out["gate_hz"] - _RATE_HZ) <= 1e-3 * _RATE_HZ
    driver.shut()
    wait_for(lambda: not pair.outputs()["gate_open"])


@rule_of("gate")
def an_impossible_pulse_is_refused_untouched(pair: ConformancePair) -> None:
    """A pulse that is too short, too fine, or longer than the time between triggers is refused before it is sent."""
    driver = identify_driver(pair)
    driver.shut()
    for width_ns in (0.0, 1e-3, 10.0012, 1e9 / _RATE_HZ + 1.0, float("nan")):
        must_raise(BadInput, lambda width_ns=width_ns: driver.open(width_ns=width_ns, rate_hz=_RATE_HZ))
    must_raise(BadInput, lambda: driver.open(width_ns=100.0, rate_hz=_RATE_HZ, delay_ns=0.0012))
    assert not pair.outputs()["gate_open"]


@rule_of("gate")
def making_safe_shuts_the_gate(pair: ConformancePair) -> None:
    """The safe action shuts an open gate and verifies it; a mute one is shut too, and nothing is claimed."""
    driver = identify_driver(pair)
    for is_mute in (False, True):
        driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ)
        wait_for(lambda: pair.outputs()["gate_open"])
        if is_mute:
            pair.suffer("mute")
        assert make_safe(gate=driver, supply=None, record=discard_log).gate_shut is not is_mute
        wait_for(lambda: not pair.outputs()["gate_open"])
    pair.heal()


@rule_of("gate")
def a_setting_changed_at_the_panel_is_reported(pair: ConformancePair) -> None:
    """A source, idle level or width changed at the panel is reported at the next look, with the gate open or shut."""
    driver = identify_driver(pair)
    driver.look()
    for is_open, setting in ((1, "source"), (1, "idle level"), (1, "width"), (0, "source"), (0, "idle level")):
        if is_open:
            driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ)
            driver.look()
        driver.look()
        pair.suffer("panel", setting)
        must_raise(InstrumentRejected, driver.look)
        driver.shut()


@rule_of("gate")
def lost_triggers_are_reported(pair: ConformancePair) -> None:
    """Triggers of an external source that come while the gate is busy are reported at the next look."""
    driver = identify_driver(pair)
    driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ, sync="line-locked")
    time.sleep(_TWO_TRIGGERS_S)
    driver.look()
    pair.suffer("panel", "busy")
    time.sleep(_TWO_TRIGGERS_S)
    must_raise(InstrumentRejected, driver.look)
    driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ, sync="line-locked")
    driver.look()
    driver.shut()
