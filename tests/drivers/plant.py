"""A tube in a laboratory that anything may happen to: it obeys, half obeys or breaks, and writes down what hurt it.

It knows the interlock's commands and none of its rules: what hurts is computed here from the laws of the tube.
"""

import math
from dataclasses import dataclass, field

from drivers.bench.interlock import Interlock
from drivers.bench.rules import REACTIONS, RULES
from drivers.bench.state import (
    DarkSeen,
    Failed,
    FilterMoved,
    FilterRead,
    GainRead,
    GateRead,
    Heard,
    InterlockRefused,
    LightRead,
    LowerGain,
    OpenGate,
    RaiseGain,
    SafeOrdered,
    SetLight,
    TurnFilter,
)
from labdata.limits import Limits, limits_in_force
from labdata.sensors import load_sensor
from labdata.target import Target

SENSOR = load_sensor("pulnix-ag5745ef3")
LIMITS = limits_in_force(Limits(), SENSOR)
HURT_AFTER_S = 1.0
"""A tube that should have been made safe this long ago is hurt, s."""

VOLTS = (0.0, 50.0, 400.0, 600.0, 800.0, 850.0, 899.0, 900.0, 901.0, 950.0, 2000.0, math.nan)
RATES = (10.0, 49.0, 50.0, 51.0, 500.0, 0.0, -5.0, math.inf)
WIDTHS_NS = (1e3, 1e6, 1.6e7, 1.99e7, 2e7, 2.01e7, 1e9, 0.0, math.nan)
RATES_HZ = (1.0, 25.0, 50.0, 59.94, 60.1, 1000.0)
LUX = (0.0, 1e-5, 1e-4, 1e-3, 5e-3, 9.9e-3, 1e-2, 1.1e-2, 0.5, 9.0, 10.0, 11.0, 1e5, math.nan)
DENSITIES = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
TARGETS = (Target(), Target(angle_deg=5.0), Target(pinhole_px=1.0))
FAULTS = ("the supply tripped", "the camera has gone", "the supply is silent", "the disk is full")


@dataclass
class Plant:
    """Tube, instruments and light as they are; the interlock sees of them only what it is told."""

    interlock: Interlock
    hurts: list[str] = field(default_factory=list)
    now_s: float = 100.0
    open: tuple[float, float] = (1e6, 50.0)  # a bench that somebody left on: width in ns, rate in Hz
    volts: float = 700.0
    lux: float = 1e-3
    filter: int = 3  # position of the wheel, from 1
    thought: int = 3  # where whoever sets the lamp thinks that it stands
    before: tuple[Target, bool] = (Target(), False)
    truly_dark_seen: bool = False
    guard_spoke_s: float = -math.inf
    failed: bool = False
    unsafe_since_s: float | None = None
    steps: int = 0
    passed: int = 0

    @property
    def duty(self) -> float:
        return self.open[0] * 1e-9 * self.open[1]

    @property
    def anode_na_per_cm2(self) -> float:
        """E S G d of the description, written out again."""
        amperes_per_m2 = self.lux * float(SENSOR.photocathode.luminous_sensitivity_ua_per_lm) * 1e-6
        plate = SENSOR.microchannel_plate
        gain = float(plate.electron_gain) * (self.volts / float(plate.reference_v)) ** float(plate.gain_exponent)
        return amperes_per_m2 * gain * min(self.duty, 1.0) * 1e9 / 1e4

    # Commands: each is asked for, then done by instruments that may stop half-way and say nothing.

    def command(self, command, *, share: float, answers: bool) -> None:
        """Order something; `share` of it is done, and it is read back only if the instrument answers."""
        try:
            self.interlock.permit(command)
        except InterlockRefused:
            return
        self.passed += 1
        act = {
            OpenGate: self._opens,
            RaiseGain: self._raises,
            LowerGain: self._lowers,
            SetLight: self._lights,
            TurnFilter: self._turns,
        }
        act[type(command)](command, share)
        if answers:
            self.answer(command)

    def answer(self, command) -> None:
        if isinstance(command, OpenGate):
            self.interlock.tell(GateRead(width_ns=self.open[0], rate_hz=self.open[1]))
        elif isinstance(command, RaiseGain | LowerGain):
            self.interlock.tell(GainRead(mcp_v=self.volts))
        elif isinstance(command, TurnFilter):
            self.thought = self.filter
            self.interlock.tell(FilterRead(position=self.filter))
        else:
            self.interlock.tell(LightRead(illuminance_lux=self.lux))

    def _opens(self, command: OpenGate, share: float) -> None:
        self._heated("the gate was opened")
        if self.lux > 0.0:
            self.hurts.append("the gate opened onto light")
        if not 0.0 < command.width_ns <= float(SENSOR.limits.gate_ns):
            self.hurts.append(f"a gate of {command.width_ns:g} ns")
        if share > 0.0:
            self.open = (command.width_ns, command.rate_hz)
        if not self.duty <= float(SENSOR.limits.gate_duty):
            self.hurts.append(f"a gate open for {self.duty:.3g} of the time")

    def _raises(self, command: RaiseGain, share: float) -> None:
        self._heated("the gain was raised")
        if self.lux > 0.0:
            self.hurts.append("the gain rose in the light")
        if not 0.0 < command.rate_v_per_s <= float(SENSOR.limits.ramp_v_per_s):
            self.hurts.append(f"the gain rose by {command.rate_v_per_s:g} V/s")
        self._move_gain(command.goal_v, share)

    def _lowers(self, command: LowerGain, share: float) -> None:
        self._heated("the gain was set")
        self._move_gain(command.goal_v, share)

    def _move_gain(self, goal_v: float, share: float) -> None:
        if self.open[0] > 0.0:
            self.hurts.append("the gain moved behind an open gate")
        self.volts += share * (goal_v - self.volts)
        if not self.volts <= float(SENSOR.limits.mcp_v) or not 0.0 <= goal_v <= float(SENSOR.limits.mcp_v):
            self.hurts.append(f"{goal_v:g} V were ordered, {self.volts:g} V reached")

    def _lights(self, command: SetLight, share: float) -> None:
        placed = (command.target, command.point)
        if placed != self.before and self.open[0] > 0.0:
            self.hurts.append("a target moved before an open gate")
        self.before = placed
        if command.illuminance_lux != 0.0:
            self._heated("the light was set")
            if not self.truly_dark_seen:
                self.hurts.append("light before a dark frame was seen")
        # The lamp's current is that which makes the light asked for behind the filter that is thought to stand there.
        thicker = DENSITIES[self.filter - 1] - DENSITIES[self.thought - 1]
        self.lux += share * (command.illuminance_lux * 10.0**-thicker - self.lux)
        if command.illuminance_lux > 0.0 and thicker != 0.0:
            self.hurts.append("light through another filter than was thought")
        limits = SENSOR.limits
        brightest = float(limits.point_illuminance_lux if command.point else limits.illuminance_lux)
        if command.illuminance_lux != 0.0 and not command.illuminance_lux <= brightest:
            self.hurts.append(f"a light of {command.illuminance_lux:g} lux")
        if command.illuminance_lux != 0.0:
            self._current_is_borne(command.point, 1.0)

    def _turns(self, command: TurnFilter, share: float) -> None:
        """The wheel turns, or stops half-way at a neighbour; what light there is passes through whatever comes by."""
        if self.lux > 0.0:
            self.hurts.append("a filter turned in the light")
        around = (command.position - self.filter) % len(DENSITIES)
        self.filter = (self.filter - 1 + round(share * around)) % len(DENSITIES) + 1

    def _current_is_borne(self, point: bool, tolerance: float) -> None:
        most = float(SENSOR.limits.point_anode_na_per_cm2 if point else SENSOR.limits.anode_na_per_cm2)
        if not self.anode_na_per_cm2 <= most * tolerance * (1 + 1e-9):
            self.hurts.append(f"a current of {self.anode_na_per_cm2:.3g} nA/cm2")

    def _heated(self, what: str) -> None:
        if self.failed:
            self.hurts.append(f"{what} after a failure")
        if not self.now_s - self.guard_spoke_s <= 1.0:
            self.hurts.append(f"{what} without a guard")

    # What needs no leave, and what happens by itself.

    def shut(self, *, works: bool) -> None:
        self.interlock.tell(SafeOrdered())
        if works:
            self.open = (0.0, 0.0)
            self.interlock.tell(GateRead(width_ns=0.0, rate_hz=0.0))

    def off(self, *, works: bool) -> None:
        self.interlock.tell(SafeOrdered())
        if works:
            self.volts = 0.0
            self.interlock.tell(GainRead(mcp_v=0.0))

    def darken(self, *, works: bool) -> None:
        if works:
            self.lux = 0.0
            self.interlock.tell(LightRead(illuminance_lux=0.0))

    def look(self) -> None:
        """Take a frame: dark where no light reaches the screen, for whatever reason."""
        if self.open[0] == 0.0 or self.volts == 0.0 or self.lux == 0.0:
            if self.open[0] > 0.0 and self.volts > 0.0:
                self.truly_dark_seen = True
            self.interlock.tell(DarkSeen())

    def speaks(self) -> None:
        self.guard_spoke_s = self.now_s
        self.interlock.tell(Heard(now_s=self.now_s))

    def fails(self, sentence: str) -> None:
        self.failed = True
        self.interlock.tell(Failed(sentence=sentence))

    def door_opens(self, lux: float) -> None:
        """Somebody lets light in, and the meter sees it."""
        self.lux = max(self.lux, lux)
        self.interlock.tell(LightRead(illuminance_lux=self.lux))

    def passes(self, seconds: float, *, guarded: bool = False) -> None:
        """Let time pass in small ticks; at each the interlock is asked whether the tube must be made safe."""
        until_s = self.now_s + seconds
        while self.now_s < until_s:
            self.now_s = min(self.now_s + 0.2, until_s)
            if guarded:
                self.speaks()
            if self.interlock.alarm():
                self.shut(works=True)
                self.off(works=True)
            self._should_be_safe()

    def _should_be_safe(self) -> None:
        hot = self.open[0] > 0.0 or self.volts > 0.0
        point = self.before[1]
        most = float(SENSOR.limits.point_anode_na_per_cm2 if point else SENSOR.limits.anode_na_per_cm2)
        brightest = float(SENSOR.limits.point_illuminance_lux if point else SENSOR.limits.illuminance_lux)
        reasons = [
            "after a failure" if self.failed and hot else "",
            "without a guard" if self.now_s - self.guard_spoke_s > 0.7 and hot else "",
            "under too much current" if not self.anode_na_per_cm2 <= 1.3 * most else "",
            "before too bright a light" if self.open[0] > 0.0 and not self.lux <= 1.3 * brightest else "",
        ]
        why = next((one for one in reasons if one), None)
        if why is None:
            self.unsafe_since_s = None
        elif self.unsafe_since_s is None:
            self.unsafe_since_s = self.now_s
        elif self.now_s - self.unsafe_since_s > HURT_AFTER_S:
            self.hurts.append(f"the tube was hot {why} for more than {HURT_AFTER_S:g} s")

    def bounds_hold(self) -> None:
        """The interlock never thinks the tube cooler than it is."""
        state = self.interlock.state
        if self.duty > state.duty * (1 + 1e-12) and state.duty < 1.0:
            self.hurts.append(f"the gate was thought open for {state.duty:.3g} and was for {self.duty:.3g}")
        if self.volts > state.mcp_v * (1 + 1e-12) or self.lux > state.light_lux * (1 + 1e-12):
            self.hurts.append("gain or light was thought lower than it was")
        if state.surely_open and self.open[0] == 0.0:
            self.hurts.append("a shut gate was taken for surely open")


def new_plant(*, without: str | None = None, limits=LIMITS) -> Plant:
    """A plant behind all rules, or all but one."""
    known = {one.name for one in (*RULES, *REACTIONS)}
    assert without is None or without in known
    rules = tuple(rule for rule in RULES if rule.name != without)
    reactions = tuple(one for one in REACTIONS if one.name != without)
    plant = Plant(interlock=None)  # type: ignore[arg-type]
    plant.interlock = Interlock(limits, rules=rules, reactions=reactions, clock=lambda: plant.now_s)
    plant.interlock.tell(FilterMoved())
    return plant


def run(plant: Plant, program: bytes) -> None:
    """Let a program happen to a plant: three bytes a step, stopping at the first hurt."""
    for at in range(0, len(program) - 2, 3):
        step(plant, program[at], program[at + 1], program[at + 2])
        plant.steps += 1
        plant.bounds_hold()
        if plant.hurts:
            return


def step(plant: Plant, what: int, first: int, second: int) -> None:
    """One thing that somebody does or that happens."""
    share, answers = (1.0, True) if second % 8 else ((second >> 3) % 3 / 2, second >= 128)
    if what < 128:
        _sensible(plant, first, share, answers)
    elif what < 148:
        plant.command(
            OpenGate(width_ns=_of(WIDTHS_NS, first), rate_hz=_of(RATES_HZ, second)), share=share, answers=answers
        )
    elif what < 168:
        plant.command(
            RaiseGain(goal_v=_of(VOLTS, first), rate_v_per_s=_of(RATES, second)), share=share, answers=answers
        )
    elif what < 180:
        plant.command(LowerGain(goal_v=_of(VOLTS, first)), share=share, answers=answers)
    elif what < 205:
        target = _of(TARGETS, second // 16)
        light = SetLight(illuminance_lux=_of(LUX, first), point=target.pinhole_px is not None, target=target)
        plant.command(light, share=share, answers=answers)
    elif what < 208:
        turn = TurnFilter(position=first % len(DENSITIES) + 1)
        plant.command(turn, share=share, answers=answers)
    elif what < 215:
        plant.shut(works=answers)
    elif what < 220:
        plant.off(works=answers)
    elif what < 228:
        plant.darken(works=answers)
    elif what < 232:
        plant.look()
    elif what < 240:
        plant.speaks()
    elif what < 244:
        plant.door_opens(_of((1e-5, 1e-3, 1.15e-2, 0.1, 50.0), first))
        plant.passes(1.6 * (second % 2), guarded=True)
    elif what < 246:
        if first < 32:  # rarely: nothing can be done to a failed bench
            plant.fails(_of(FAULTS, first))
    else:
        plant.passes(first / 100.0, guarded=bool(second % 4))


def _sensible(plant: Plant, first: int, share: float, answers: bool) -> None:
    """The next thing that a careful person would do, so that programs get somewhere hot."""
    plant.speaks()
    state = plant.interlock.state
    goal_v, lux = (600.0, 800.0, 865.0, 899.0)[first % 4], (1e-4, 2e-3, 9e-3, 9.0)[first // 4 % 4]
    target = TARGETS[2] if lux > 1.0 else TARGETS[0]
    point = lux > 1.0
    if state.shut and (state.target, state.point) != (target, point):
        plant.command(SetLight(illuminance_lux=0.0, point=point, target=target), share=1.0, answers=True)
    elif not state.shut and (state.surely_v == 0.0 or first > 240):
        plant.shut(works=answers)
    elif not state.dark:
        plant.darken(works=answers)
    elif state.shut and (state.surely_v < 50.0 or first > 200):
        plant.command(RaiseGain(goal_v=goal_v, rate_v_per_s=50.0), share=share, answers=answers)
    elif state.shut:
        plant.command(OpenGate(width_ns=1.6e7, rate_hz=59.94), share=share, answers=answers)
    elif not state.dark_seen:
        plant.look()
    elif not state.filter_known or first % 16 == 1:
        plant.command(TurnFilter(position=first // 16 % len(DENSITIES) + 1), share=share, answers=answers)
    else:
        light = SetLight(illuminance_lux=lux, point=state.point, target=state.target or Target())
        plant.command(light, share=share, answers=answers)


def _of(values, byte: int):
    return values[byte % len(values)]
