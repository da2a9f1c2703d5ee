"""The hottest that the tube may be: what was ordered counts as done until it is read back, and the unread as open."""

import math
from dataclasses import dataclass, replace

from labdata.errors import BadInput
from labdata.limits import LimitsInForce
from labdata.target import Target


class InterlockRefused(BadInput):
    """The interlock refused a command; nothing was sent.

    Use this when what was asked would hurt the tube, in itself or at this moment: `rule` names the rule.
    """

    def __init__(self, sentence: str, *, rule: str = "") -> None:
        super().__init__(sentence)
        self.rule = rule


@dataclass(frozen=True, kw_only=True)
class TubeState:
    """What may be true of gate, gain and light now; nothing is known before it is read.

    Parameters
    ----------
    duty
        Largest share of the time that the gate may be open; 0: read back as shut.
    mcp_v
        Highest voltage that may be across the plate, V.
    light_lux
        Brightest that the light may be, lux.
    point
        Whether that light is inside a pinhole's image only.
    target
        The target before the camera.
    filter_known
        Whether it is known which filter stands in the light; a bench without a wheel has one for good.
    dark_seen
        Whether a frame taken through the open gate at gain, with the light out, was dark.
    excess_saturation
        Share of saturated pixels of the last frame beyond what its step allows, 0..1.
    probed
        Whether a frame taken in this light through an open gate at gain was not saturated.
    surely_open
        Whether the gate was read back as open and nothing was ordered since that could have shut it.
    surely_v
        Voltage that was read across the plate, V; 0 where it may have fallen since.
    heard_s
        When the guard of the bench last gave a sign of life, s of a monotonic clock.
    fault
        What failed since the bench was opened, in a sentence; only opening it anew forgets that.
    """

    duty: float = 1.0
    mcp_v: float = math.inf
    light_lux: float = math.inf
    point: bool = False
    target: Target | None = None
    filter_known: bool = True
    dark_seen: bool = False
    excess_saturation: float = 0.0
    probed: bool = False
    surely_open: bool = False
    surely_v: float = 0.0
    heard_s: float = -math.inf
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
        """Largest current density that may now be asked of the plate, nA/cm2."""
        if self.shut or self.dark or self.mcp_v == 0.0:
            return 0.0
        return limits.load.anode_na_per_cm2(self.light_lux, self.mcp_v, self.duty)


# Commands that may make the tube hotter; to shut, to lower to nothing and to darken needs no leave.


@dataclass(frozen=True, kw_only=True)
class OpenGate:
    """Open the gate for `width_ns` at each of `rate_hz` triggers a second."""

    width_ns: float
    rate_hz: float

    def ordered(self, state: TubeState) -> TubeState:
        """State once the order is out."""
        return replace(state, duty=max(state.duty, min(1.0, self.width_ns * 1e-9 * self.rate_hz)))


@dataclass(frozen=True, kw_only=True)
class RaiseGain:
    """Raise the voltage to `goal_v` no faster than `rate_v_per_s`."""

    goal_v: float
    rate_v_per_s: float

    def ordered(self, state: TubeState) -> TubeState:
        """State once the order is out."""
        return replace(state, mcp_v=max(state.mcp_v, self.goal_v))


@dataclass(frozen=True, kw_only=True)
class LowerGain:
    """Lower the voltage of a supply that stays on to `goal_v`."""

    goal_v: float

    def ordered(self, state: TubeState) -> TubeState:
        """State once the order is out: no lower before that is read back."""
        return replace(state, mcp_v=max(state.mcp_v, self.goal_v), surely_v=0.0)


@dataclass(frozen=True, kw_only=True)
class SetLight:
    """Put a target before the camera and set the light on it to `illuminance_lux`."""

    illuminance_lux: float
    point: bool
    target: Target

    def ordered(self, state: TubeState) -> TubeState:
        """State once the order is out; the target counts as moved."""
        lux = max(state.light_lux, self.illuminance_lux)
        return replace(state, light_lux=lux, point=self.point, target=self.target, probed=False)


@dataclass(frozen=True, kw_only=True)
class TurnFilter:
    """Turn the filter wheel to `position`; on the way any filter, and none, passes through the light."""

    position: int

    def ordered(self, state: TubeState) -> TubeState:
        """State once the order is out: which filter it will be is not known before it is read."""
        return replace(state, filter_known=False)


Command = OpenGate | RaiseGain | LowerGain | SetLight | TurnFilter


# Events: what was read, seen or heard.


@dataclass(frozen=True, kw_only=True)
class SafeOrdered:
    """Gate or gain was ordered shut, down or off, which needs no leave; until it is read neither is known."""

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        return replace(state, surely_open=False, surely_v=0.0)


@dataclass(frozen=True, kw_only=True)
class GateRead:
    """The gate generator read back openings of `width_ns` at `rate_hz`; 0: shut, idle at 0 V."""

    width_ns: float
    rate_hz: float

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        duty = min(1.0, self.width_ns * 1e-9 * self.rate_hz)
        return replace(state, duty=duty, surely_open=duty > 0.0)


@dataclass(frozen=True, kw_only=True)
class GainRead:
    """The supply's output was read as `mcp_v` and is settled; 0: off and discharged."""

    mcp_v: float

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        return replace(state, mcp_v=self.mcp_v, surely_v=self.mcp_v)


@dataclass(frozen=True, kw_only=True)
class LightRead:
    """The light was read as `illuminance_lux`; 0: blocked."""

    illuminance_lux: float

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        probed = state.probed and self.illuminance_lux <= state.light_lux
        return replace(state, light_lux=self.illuminance_lux, probed=probed)


@dataclass(frozen=True, kw_only=True)
class FilterMoved:
    """There is a filter wheel, and where it stands is not known."""

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        return replace(state, filter_known=False)


@dataclass(frozen=True, kw_only=True)
class FilterRead:
    """The filter wheel was read to stand at `position`."""

    position: int

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        return replace(state, filter_known=True)


@dataclass(frozen=True, kw_only=True)
class DarkSeen:
    """A frame was dark, taken now; it counts only through an open gate, at gain and without light."""

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        looking = state.surely_open and state.surely_v > 0.0 and state.dark
        return replace(state, dark_seen=state.dark_seen or looking)


@dataclass(frozen=True, kw_only=True)
class FrameSeen:
    """A frame had a share of saturated pixels beyond what its step allows; below 0 where it had fewer."""

    excess_saturation: float

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        looking = state.surely_open and state.surely_v > 0.0 and self.excess_saturation <= 0.0
        return replace(state, excess_saturation=self.excess_saturation, probed=state.probed or looking)


@dataclass(frozen=True, kw_only=True)
class Heard:
    """The guard of the bench gave a sign of life at `now_s`."""

    now_s: float

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known."""
        return replace(state, heard_s=self.now_s)


@dataclass(frozen=True, kw_only=True)
class Failed:
    """Something failed: a supply tripped or silent, a camera lost, a disk full."""

    sentence: str

    def seen(self, state: TubeState) -> TubeState:
        """State once this is known; the first failure is kept."""
        return replace(state, fault=state.fault or self.sentence)


Event = SafeOrdered | GateRead | GainRead | LightRead | FilterMoved | FilterRead | DarkSeen | FrameSeen | Heard | Failed
