"""Interlock: the rules that refuse commands to the tube or force the safe state."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.bench.state import (
    Command,
    Event,
    InterlockRefused,
    LowerGain,
    OpenGate,
    RaiseGain,
    SetLight,
    TubeState,
    TurnFilter,
)
from labdata.limits import LimitsInForce

# Longest time since the client's last heartbeat for commands that increase the load of the tube, s
SILENCE_S = 0.6
# Largest duty of the gate in light that no frame has verified yet: a hundredth of the dose
PROBE_DUTY = 0.01

# Fraction of pixels that may be saturated beyond the limit of the step; lamps in view are smaller
MAX_EXCESS_SATURATION = 0.05

# Factor by which a light reading may exceed its limit, for the calibration of the meter
METER_TOLERANCE = 1.25


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A rule to refuse commands, breach(state, command, limits, now_s), or one for the safe state,
    breach(state, limits, now_s); it returns a sentence "rule, got value".
    """

    name: str
    breach: Callable[..., str | None]


def _voltage(state: TubeState, command: Command, limits: LimitsInForce, now_s: float) -> str | None:
    if isinstance(command, RaiseGain | LowerGain) and not 0.0 <= command.goal_v <= limits.mcp_v:
        return f"mcp_v must not exceed the limit {limits.mcp_v:g}, got {command.goal_v:g}"


def _ramp(state: TubeState, command: Command, limits: LimitsInForce, now_s: float) -> str | None:
    if isinstance(command, RaiseGain) and not 0.0 < command.rate_v_per_s <= limits.ramp_v_per_s:
        return (
            f"the voltage must rise by at most {limits.ramp_v_per_s:g} V/s, got "
            f"{command.rate_v_per_s:g}"
        )


def _width(state: TubeState, command: Command, limits: LimitsInForce, now_s: float) -> str | None:
    if isinstance(command, OpenGate) and not 0.0 < command.width_ns <= limits.gate_ns:
        return f"gate_ns must not exceed the limit {limits.gate_ns:g}, got {command.width_ns:g}"


def _duty(state: TubeState, command: Command, limits: LimitsInForce, now_s: float) -> str | None:
    if isinstance(command, OpenGate):
        duty = command.width_ns * 1e-9 * command.rate_hz
        if not 0.0 < duty <= limits.gate_duty:
            return (
                f"the gate must be open for at most {limits.gate_duty:g} of the time, got "
                f"{duty:.4g}: {command.width_ns:g} ns at {command.rate_hz:g} Hz"
            )


def _light(state: TubeState, command: Command, limits: LimitsInForce, now_s: float) -> str | None:
    if isinstance(command, SetLight):
        limit = limits.largest_lux(point=command.point)
        if not 0.0 <= command.illuminance_lux <= limit:
            return (
                f"illuminance_lux must not exceed the limit {limit:g}, got "
                f"{command.illuminance_lux:g}"
            )


def _light_at_gain(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if isinstance(command, SetLight) and command.illuminance_lux > 0.0:
        limit = limits.largest_anode_na_per_cm2(point=command.point)
        asked = command.state_when_sent(state).anode_na_per_cm2(limits)
        if not asked <= limit:
            return (
                f"light, gain and gate together must not exceed {limit:g} nA/cm2 of MCP output, "
                f"got {asked:.4g}: {command.illuminance_lux:g} lux at {state.mcp_v:g} V, open for "
                f"{state.duty:.3g} of the time; lower the gain before raising the light"
            )


def _gate_opens_dark(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if not isinstance(command, OpenGate) or state.dark:
        return None
    if not state.probed and not command.width_ns * 1e-9 * command.rate_hz <= PROBE_DUTY:
        return (
            "the light must be out when the gate opens, or seen first with the gate open for at "
            f"most {PROBE_DUTY:g} of the time, got up to {state.light_lux:g} lux"
        )
    limit = limits.largest_anode_na_per_cm2(point=state.point)
    asked = command.state_when_sent(state).anode_na_per_cm2(limits)
    if not asked <= limit:
        return f"the gate must not exceed {limit:g} nA/cm2 of MCP output, got {asked:.4g}"


def _gain_up_dark(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if isinstance(command, RaiseGain) and not state.dark:
        return f"the light must be down before the gain goes up, got up to {state.light_lux:g} lux"


def _gain_moves_shut(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if isinstance(command, RaiseGain | LowerGain) and not state.shut:
        return (
            f"the gate must be shut while the gain moves, got it open for up to "
            f"{state.duty:.3g} of the time"
        )


def _target_moves_shut(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if not isinstance(command, SetLight) or state.shut:
        return None
    if (command.target, command.point) != (state.target, state.point):
        return (
            f"the gate must be shut while a target is placed, got it open for up to "
            f"{state.duty:.3g} of the time"
        )


def _dark_first(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if isinstance(command, SetLight) and command.illuminance_lux > 0.0 and not state.dark_seen:
        return (
            "a dark frame must be seen through the open gate before the first light, "
            f"got none before {command.illuminance_lux:g} lux"
        )


def _filter_turns_dark(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if isinstance(command, TurnFilter) and not state.dark:
        return f"the light must be out while a filter turns, got up to {state.light_lux:g} lux"


def _filter_known(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if isinstance(command, SetLight) and command.illuminance_lux > 0.0 and not state.filter_known:
        return (
            f"the filter must be read before there is light, got none read before "
            f"{command.illuminance_lux:g} lux"
        )


def _heartbeat_due(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if _heats(command) and not now_s - state.heard_s <= SILENCE_S:
        return (
            f"the bench must have shown life within {SILENCE_S:g} s, got "
            f"{now_s - state.heard_s:.3g} s of silence"
        )


def _no_failure(
    state: TubeState, command: Command, limits: LimitsInForce, now_s: float
) -> str | None:
    if _heats(command) and state.fault is not None:
        return f"the bench must be reopened after a failure, got: {state.fault}"


def _heats(command: Command) -> bool:
    return not (
        isinstance(command, TurnFilter)
        or (isinstance(command, SetLight) and command.illuminance_lux == 0.0)
    )


# All rules that refuse commands
RULES = (
    Rule(name="voltage", breach=_voltage),
    Rule(name="ramp", breach=_ramp),
    Rule(name="gate width", breach=_width),
    Rule(name="gate duty", breach=_duty),
    Rule(name="light", breach=_light),
    Rule(name="dark before the first light", breach=_dark_first),
    Rule(name="gate opens in the dark", breach=_gate_opens_dark),
    Rule(name="light down before gain up", breach=_gain_up_dark),
    Rule(name="gain moves behind a shut gate", breach=_gain_moves_shut),
    Rule(name="target moves before a shut gate", breach=_target_moves_shut),
    Rule(name="filter turns in the dark", breach=_filter_turns_dark),
    Rule(name="filter is known before light", breach=_filter_known),
    Rule(name="light at this gain", breach=_light_at_gain),
    Rule(name="guarded", breach=_heartbeat_due),
    Rule(name="nothing after a failure", breach=_no_failure),
)


def _silent(state: TubeState, limits: LimitsInForce, now_s: float) -> str | None:
    hot = not state.shut or state.mcp_v > 0.0
    if hot and not now_s - state.heard_s <= SILENCE_S:
        return (
            f"the bench must show life every {SILENCE_S:g} s, got {now_s - state.heard_s:.3g} "
            f"s of silence"
        )


def _overload(state: TubeState, limits: LimitsInForce, now_s: float) -> str | None:
    limit = METER_TOLERANCE * limits.largest_anode_na_per_cm2(point=state.point)
    asked = state.anode_na_per_cm2(limits)
    if not asked <= limit:
        return (
            f"the light must draw at most {limit:g} nA/cm2 of MCP output, got {asked:.4g} at "
            f"{state.light_lux:g} lux"
        )


def _too_bright(state: TubeState, limits: LimitsInForce, now_s: float) -> str | None:
    limit = METER_TOLERANCE * limits.largest_lux(point=state.point)
    if not state.shut and not state.light_lux <= limit:
        return (
            f"the light must read at most {limit:g} lux before an open gate, got "
            f"{state.light_lux:g}"
        )


def _saturation(state: TubeState, limits: LimitsInForce, now_s: float) -> str | None:
    if not state.excess_saturation <= MAX_EXCESS_SATURATION:
        return (
            f"at most {MAX_EXCESS_SATURATION:.0%} of a frame's pixels may be saturated beyond "
            f"what its step allows, got {state.excess_saturation:.0%}: find the light, or state "
            "saturated_fraction in the step"
        )


# All rules that force the safe state
REACTIONS = (
    Rule(name="silence makes safe", breach=_silent),
    Rule(name="too much current makes safe", breach=_overload),
    Rule(name="too bright a light makes safe", breach=_too_bright),
    Rule(name="a saturated frame makes safe", breach=_saturation),
)


def refuse(
    state: TubeState,
    command: Command,
    limits: LimitsInForce,
    now_s: float,
    rules: tuple[Rule, ...] = RULES,
) -> None:
    """Raise InterlockRefused for the first rule that a command breaks."""
    for rule in rules:
        if sentence := rule.breach(state, command, limits, now_s):
            raise InterlockRefused(sentence, rule=rule.name)


def alarm(
    state: TubeState,
    limits: LimitsInForce,
    now_s: float,
    reactions: tuple[Rule, ...] = REACTIONS,
) -> str | None:
    """Return the sentence of the first reaction that requires the safe state; None if there is
    none.
    """
    return next(
        (why for reaction in reactions if (why := reaction.breach(state, limits, now_s))), None
    )


Watcher = Callable[
    [TubeState, float], None
]  # Called as watcher(state, now_s) with the previous state, at every change


class Interlock:
    """State machine that permits or refuses commands to the tube; subsets of its rules only in
    tests.
    """

    def __init__(
        self,
        limits: LimitsInForce,
        *,
        rules: tuple[Rule, ...] = RULES,
        reactions: tuple[Rule, ...] = REACTIONS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limits = limits
        self._rules, self._reactions, self._clock = rules, reactions, clock
        self._state, self._watchers = TubeState(), []
        self._changing = threading.RLock()

    @property
    def state(self) -> TubeState:
        """Worst-case state of the tube."""
        return self._state

    def watch(self, watcher: Watcher) -> None:
        """Call a watcher before every change of state."""
        self._watchers.append(watcher)

    def foresee(self, *commands: Command, state: TubeState | None = None) -> None:
        """Check a sequence of commands from a state on, without effect; a refused one is
        InterlockRefused.
        """
        state = self._state if state is None else state
        for command in commands:
            refuse(state, command, self.limits, self._clock(), self._rules)
            state = command.state_when_sent(state)

    def permit(self, command: Command) -> None:
        """Permit a command, which then counts as done, or refuse it (InterlockRefused)."""
        with self._changing:
            refuse(self._state, command, self.limits, self._clock(), self._rules)
            self._become(command.state_when_sent(self._state))

    def tell(self, event: Event) -> None:
        """Update the state by an event."""
        with self._changing:
            self._become(event.state_after(self._state))

    def alarm(self) -> str | None:
        """Return the sentence of the first reaction that requires the safe state; None if there is
        none.
        """
        return alarm(self._state, self.limits, self._clock(), self._reactions)

    def _become(self, state: TubeState) -> None:
        for watcher in self._watchers:
            watcher(self._state, self._clock())
        self._state = state
