"""State of the tube as the interlock knows it: the worst case of what was not read back."""

import math
from dataclasses import dataclass, replace

from labdata import BadInput, Target
from labdata.limits import LimitsInForce


class InterlockRefused(BadInput):
    """The interlock refused a command that would damage the tube, and nothing was sent; `rule`
    names the rule.
    """

    def __init__(self, sentence: str, *, rule: str = "") -> None:
        super().__init__(sentence)
        self.rule = rule


@dataclass(frozen=True, kw_only=True)
class TubeState:
    """Worst case of gate, gain and light; a value is unknown until it is read."""

    #: Largest possible fraction of the time that the gate is open; 0: read back as shut
    duty: float = 1.0
    mcp_v: float = math.inf  #: Highest possible voltage across the MCP, V
    light_lux: float = math.inf  #: Highest possible illuminance, lux
    point: bool = False  #: Whether that light is inside a pinhole's image only
    target: Target | None = None  #: Target in front of the camera
    #: Whether the filter in the light is known; always true without a filter wheel
    filter_known: bool = True
    #: Whether a frame through the open gate at gain, with the light off, was dark
    dark_seen: bool = False
    #: Fraction of saturated pixels of the last frame beyond the limit of its step
    excess_saturation: float = 0.0
    #: Whether a frame in this light through an open gate at gain was not saturated
    probed: bool = False
    surely_open: bool = False  #: Whether the gate was read back as open and not ordered shut since
    surely_v: float = 0.0  #: Voltage read across the MCP, V; 0 where it may have fallen since
    heard_s: float = -math.inf  #: Time of the last heartbeat, s of a monotonic clock
    #: Sentence on the first failure since the bench was opened; cleared only by reopening it
    fault: str | None = None

    @property
    def shut(self) -> bool:
        """Whether the gate is known to be shut."""
        return self.duty == 0.0

    @property
    def dark(self) -> bool:
        """Whether the light is known to be out."""
        return self.light_lux == 0.0

    def anode_na_per_cm2(self, limits: LimitsInForce) -> float:
        """Return the largest possible MCP output current density, nA/cm2."""
        if self.shut or self.dark or self.mcp_v == 0.0:
            return 0.0
        return limits.load.anode_na_per_cm2(self.light_lux, self.mcp_v, self.duty)


# `state_when_sent` returns the state after a command was sent, `state_after` that after an event.
# Commands that may increase the load of the tube; shutting, switching off and darkening need no
# permission.


@dataclass(frozen=True, kw_only=True)
class OpenGate:
    """Open the gate for `width_ns` at each of `rate_hz` triggers a second."""

    width_ns: float
    rate_hz: float

    def state_when_sent(self, state: TubeState) -> TubeState:
        return replace(state, duty=max(state.duty, min(1.0, self.width_ns * 1e-9 * self.rate_hz)))


@dataclass(frozen=True, kw_only=True)
class RaiseGain:
    """Raise the voltage to `goal_v` no faster than `rate_v_per_s`."""

    goal_v: float
    rate_v_per_s: float

    def state_when_sent(self, state: TubeState) -> TubeState:
        return replace(state, mcp_v=max(state.mcp_v, self.goal_v))


@dataclass(frozen=True, kw_only=True)
class LowerGain:
    """Lower the voltage of a supply that stays on to `goal_v`."""

    goal_v: float

    def state_when_sent(self, state: TubeState) -> TubeState:
        # The voltage is lower only once read back.
        return replace(state, mcp_v=max(state.mcp_v, self.goal_v), surely_v=0.0)


@dataclass(frozen=True, kw_only=True)
class SetLight:
    """Place a target and set the light to `illuminance_lux`."""

    illuminance_lux: float
    point: bool
    target: Target

    def state_when_sent(self, state: TubeState) -> TubeState:
        # The target counts as moved.
        lux = max(state.light_lux, self.illuminance_lux)
        return replace(state, light_lux=lux, point=self.point, target=self.target, probed=False)


@dataclass(frozen=True, kw_only=True)
class TurnFilter:
    """Turn the filter wheel; other filters pass through the light on the way."""

    def state_when_sent(self, state: TubeState) -> TubeState:
        # The filter is unknown until read.
        return replace(state, filter_known=False)


Command = OpenGate | RaiseGain | LowerGain | SetLight | TurnFilter


# Events: read-backs, frames, heartbeats and failures.


@dataclass(frozen=True, kw_only=True)
class SafeOrdered:
    """Gate or gain was ordered shut, down or off; both are unknown until read back."""

    def state_after(self, state: TubeState) -> TubeState:
        return replace(state, surely_open=False, surely_v=0.0)


@dataclass(frozen=True, kw_only=True)
class GateRead:
    """The gate generator read back pulses of `width_ns` at `rate_hz`; 0: shut, idle at 0 V."""

    width_ns: float
    rate_hz: float

    def state_after(self, state: TubeState) -> TubeState:
        duty = min(1.0, self.width_ns * 1e-9 * self.rate_hz)
        return replace(state, duty=duty, surely_open=duty > 0.0)


@dataclass(frozen=True, kw_only=True)
class GainRead:
    """The supply's output was read as `mcp_v` and is settled; 0: off and discharged."""

    mcp_v: float

    def state_after(self, state: TubeState) -> TubeState:
        return replace(state, mcp_v=self.mcp_v, surely_v=self.mcp_v)


@dataclass(frozen=True, kw_only=True)
class LightRead:
    """The light was read as `illuminance_lux`; 0: blocked."""

    illuminance_lux: float

    def state_after(self, state: TubeState) -> TubeState:
        probed = state.probed and self.illuminance_lux <= state.light_lux
        return replace(state, light_lux=self.illuminance_lux, probed=probed)


@dataclass(frozen=True, kw_only=True)
class FilterRead:
    """The filter wheel was read at a calibrated position, or is not `known` yet."""

    known: bool

    def state_after(self, state: TubeState) -> TubeState:
        return replace(state, filter_known=self.known)


@dataclass(frozen=True, kw_only=True)
class DarkSeen:
    """A frame was dark; it counts only through an open gate, at gain and without light."""

    def state_after(self, state: TubeState) -> TubeState:
        looking = state.surely_open and state.surely_v > 0.0 and state.dark
        return replace(state, dark_seen=state.dark_seen or looking)


@dataclass(frozen=True, kw_only=True)
class FrameSeen:
    """A frame had a fraction of saturated pixels beyond the limit of its step; below 0 if fewer."""

    excess_saturation: float

    def state_after(self, state: TubeState) -> TubeState:
        looking = state.surely_open and state.surely_v > 0.0 and self.excess_saturation <= 0.0
        return replace(
            state, excess_saturation=self.excess_saturation, probed=state.probed or looking
        )


@dataclass(frozen=True, kw_only=True)
class Heard:
    """A heartbeat of the client came at `now_s`."""

    now_s: float

    def state_after(self, state: TubeState) -> TubeState:
        return replace(state, heard_s=self.now_s)


@dataclass(frozen=True, kw_only=True)
class Failed:
    """A failure: a tripped or silent supply, a lost camera, a full disk."""

    sentence: str

    def state_after(self, state: TubeState) -> TubeState:
        # The first failure is kept.
        return replace(state, fault=state.fault or self.sentence)


Event = (
    SafeOrdered
    | GateRead
    | GainRead
    | LightRead
    | FilterRead
    | DarkSeen
    | FrameSeen
    | Heard
    | Failed
)
