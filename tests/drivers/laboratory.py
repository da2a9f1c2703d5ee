"""A tube in a laboratory, with instruments that obey, half obey, break or are changed by hand, in
simulated time.

What hurts the tube is computed here from its own laws; none of the interlock's rules is known here.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from drivers.errors import (
    InstrumentDisconnected,
    InstrumentRejected,
    InstrumentReplyError,
    InstrumentTimeout,
    InstrumentTripped,
)
from drivers.serial_lines.line import InstrumentLine
from labdata import LampCalibration, Limits, Target, limits_in_force, load_sensor

SENSOR = load_sensor("pulnix-ag5745ef3")
LIMITS = replace(limits_in_force(Limits(), SENSOR), ramp_v_per_s=1000.0)
SAFE_AFTER_S = 1.0  # A tube that should have been made safe this long ago is hurt, s

# An instrument that fails or is changed must be noticed within this time, s: 0.5, and one answer
# that another look awaits meanwhile, for looks take turns here
NOTICED_AFTER_S = 0.9

EXCHANGE_S, ANSWER_S = 0.01, 0.4
# Of what stands in the wheel's positions; nobody calibrated the open hole, which is the last
DENSITIES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.0)

LAMP = LampCalibration(
    source="measured for this test",
    current_a=(1e-3, 1.0),
    illuminance_lux=(0.1, 100.0),
    relative_sd=(0.01, 0.01),
    filter_density=DENSITIES[:-1],
)
LUX_PER_A = 100.0


class Clock:
    """Simulated time, s; it passes where somebody would wait."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    time = monotonic

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


CLOCK = Clock()


class Wire(InstrumentLine):
    """A line without bytes: what is sent happens in the laboratory, as far as the instrument
    obeys.
    """

    def __init__(self, name: str, obey: Callable[[object, float], None]) -> None:
        super().__init__(None, name=name)  # type: ignore[arg-type]
        self.obey, self.lab = obey, None
        self.mend()

    def mend(self) -> None:
        """Work as it should."""
        self.trouble, self.since_s, self.back_s = "", math.inf, math.inf
        self.changed_s, self.tried_s, self.in_vain = math.inf, -math.inf, False

    def break_down(self, trouble: str, *, back_after_s: float = math.inf) -> None:
        self.trouble, self.since_s, self.back_s = trouble, CLOCK.now_s, CLOCK.now_s + back_after_s

    @property
    def is_seen_broken(self) -> bool:
        """Whether somebody who asks notices it."""
        return self.trouble in ("silent", "mute", "wrong", "gone")

    def write(self, command: object) -> None:
        self._require_turn()
        CLOCK.sleep(EXCHANGE_S)
        self._require_port()
        if self.trouble not in ("silent", "disobedient"):
            self.obey(command, 0.5 if self.trouble == "half" else 1.0)

    def answer(self, value: Callable[[], float]) -> float:
        """What the instrument reads back; it never lies, but may say nothing or nonsense."""
        self._require_turn()
        CLOCK.sleep(EXCHANGE_S)
        self._require_port()
        if self.trouble in ("silent", "mute"):
            CLOCK.sleep(ANSWER_S)
            raise InstrumentTimeout(f"the {self.name} must answer")
        if self.trouble == "wrong":
            raise InstrumentReplyError(f"the {self.name} must answer in a known form")
        return value()

    def reopen(self, path: str | None = None) -> None:
        if CLOCK.now_s < self.back_s:
            raise InstrumentDisconnected(f"the port of the {self.name} must be there")
        self.trouble = ""

    def _order(self, command: object) -> None:
        self.tried_s, self.in_vain = CLOCK.now_s, True
        self.write(command)
        self.in_vain = self.trouble in ("silent", "disobedient")

    def _require_port(self) -> None:
        if self.trouble == "gone":
            raise InstrumentDisconnected(f"the {self.name} must stay on")

    def _exchange(self, question: str) -> str:
        raise NotImplementedError

    def _get_into_step(self) -> None:
        raise NotImplementedError


@dataclass
class Laboratory:
    """Tube, instruments and light as they are, and what hurt the tube."""

    has_lamp: bool = True
    between: Callable[[], None] = lambda: None  # Called between two exchanges of a procedure
    # Called as lasts(seconds) by procedures that take their time
    lasts: Callable[[float], None] = CLOCK.sleep
    hurts: list[str] = field(default_factory=list)
    # a bench that somebody left on: width in ns, rate in Hz
    open: tuple[float, float] = 1e6, 50.0
    volts: float = 700.0
    lamp_a: float = 0.0
    placed_lux: float = 1e-3  # light that a person set
    door_lux: float = 0.0
    door_seen: bool = False  # whether a meter has seen it since anything was said of the light
    door_noted: bool = False  # whether one had when the present order began
    filter: int = 3  # position of the wheel, from 1
    thought: int = 1  # where whoever sets the light was last shown a calibrated filter
    before: tuple[Target | None, bool] = (None, False)
    truly_dark_seen: bool = False
    light_shown: bool = False  # whether a frame was truly not saturated in the present light
    beat_s: float = -math.inf
    stamp_s: float = -math.inf
    fault_s: float = math.inf
    cold_s: float = -math.inf  # when the tube was last seen safe
    # What nothing may be made hotter after: the end of the server, a safe action since the present
    # order began
    stopped_by: str = ""
    # What demands the safe state of a hot tube, and since when, s
    demands: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.has_lamp:
            self.lamp_a, self.placed_lux = 0.1, 0.0
        self.gate, self.supply = Gate(self), Supply(self)
        self.lamp, self.wheel, self.meter = LightSource(self), Wheel(self), Meter(self)

    # The laws of the tube

    @property
    def duty(self) -> float:
        return min(1.0, self.open[0] * 1e-9 * self.open[1])

    @property
    def own_lux(self) -> float:
        return LUX_PER_A * self.lamp_a * 10.0 ** -DENSITIES[self.filter - 1] + self.placed_lux

    @property
    def known_lux(self) -> float:
        """Light that the bench made or saw."""
        return self.own_lux + (self.door_lux if self.door_seen else 0.0)

    @property
    def noted_lux(self) -> float:
        """Light that the bench made, or had seen when the present order began."""
        return self.own_lux + (self.door_lux if self.door_noted else 0.0)

    @property
    def meter_zero_lux(self) -> float:
        """Light that a meter cannot tell from none."""
        return 1e-3 * self.most_lux

    def anode_na_per_cm2(self, lux: float) -> float:
        """E S G d of the description, written out again."""
        amperes_per_m2 = lux * float(SENSOR.photocathode.luminous_sensitivity_ua_per_lm) * 1e-6
        plate = SENSOR.microchannel_plate
        gain = float(plate.electron_gain) * (self.volts / float(plate.reference_v)) ** float(
            plate.gain_exponent
        )
        return amperes_per_m2 * gain * self.duty * 1e9 / 1e4

    @property
    def most_na_per_cm2(self) -> float:
        limits = SENSOR.limits
        return float(limits.point_anode_na_per_cm2 if self.before[1] else limits.anode_na_per_cm2)

    @property
    def most_lux(self) -> float:
        return float(
            SENSOR.limits.point_illuminance_lux if self.before[1] else SENSOR.limits.illuminance_lux
        )

    @property
    def looking(self) -> bool:
        return self.open[0] > 0.0 and self.volts > 0.0

    @property
    def saturated(self) -> float:
        """Share of a frame's pixels that the present light saturates."""
        if not self.looking:
            return 0.0
        fills = self.anode_na_per_cm2(self.own_lux + self.door_lux) > float(
            SENSOR.limits.anode_na_per_cm2
        )
        return (1e-3 if self.before[1] and self.door_lux == 0.0 else 0.9) if fills else 0.0

    # What instruments do

    def opens(self, width_ns: float, rate_hz: float, share: float) -> None:
        self._heated("the gate was opened")
        if not 0.0 < width_ns <= float(SENSOR.limits.gate_ns):
            self.hurts.append(f"a gate of {width_ns:g} ns")
        self.open, self.gate.line.changed_s = (width_ns * share, rate_hz), math.inf
        if not width_ns * 1e-9 * rate_hz <= float(SENSOR.limits.gate_duty):
            self.hurts.append(f"a gate open for {width_ns * 1e-9 * rate_hz:.3g} of the time")
        if self.noted_lux > 0.0:
            if not (self.light_shown or self.duty <= 0.01):
                self.hurts.append("the gate opened onto a light that no frame had shown")
            self._current_is_borne()

    def shuts(self) -> None:
        if self.open[0] > 0.0:
            self._gets_safe(self.gate.line)
        self.open, self.gate.line.changed_s = (0.0, 0.0), math.inf

    def moves_gain(self, volts: float, rate_v_per_s: float, share: float) -> None:
        if volts > self.volts and self.supply.line.changed_s == math.inf:
            self._heated("the gain was raised")
            if self.noted_lux > 0.0:
                self.hurts.append("the gain rose in the light")
            if not 0.0 < rate_v_per_s <= LIMITS.ramp_v_per_s:
                self.hurts.append(f"the gain rose by {rate_v_per_s:g} V/s")
        if self.open[0] > 0.0 and self.gate.line.changed_s == math.inf:
            self.hurts.append("the gain moved behind an open gate")
        self.volts += share * (volts - self.volts)
        self.supply.line.changed_s = math.inf
        if not 0.0 <= volts <= float(SENSOR.limits.mcp_v):
            self.hurts.append(f"{volts:g} V were ordered")

    def switches_off(self) -> None:
        if self.volts > 0.0:
            self._gets_safe(self.supply.line)
        self.volts, self.supply.line.changed_s = 0.0, math.inf

    def places(self, lux: float, target: Target, point: bool, share: float) -> None:
        """A person places a target and sets the light to what a meter should read, as far as known
        with what comes in.

        Where there is a lamp it is that of the lamp, behind the filter that is thought to stand.
        """
        if (
            (target, point) != self.before
            and self.open[0] > 0.0
            and self.gate.line.changed_s == math.inf
        ):
            self.hurts.append("a target moved before an open gate")
        self.before = (target, point)
        own_lux = max(0.0, lux - (self.door_lux if self.door_seen else 0.0))
        if not self.has_lamp:
            self.placed_lux += share * (own_lux - self.placed_lux)
        elif lux != 0.0:
            self.lamp_a += share * (
                own_lux / LUX_PER_A * 10.0 ** DENSITIES[self.thought - 1] - self.lamp_a
            )
        self._illumination(lux)

    def burns(self, current_a: float, share: float) -> None:
        self.lamp_a += share * (current_a - self.lamp_a)
        self._illumination(LUX_PER_A * current_a * 10.0 ** -DENSITIES[self.thought - 1])

    def opens_door(self, lux: float) -> None:
        """Light comes in, or less than before; more than before nobody has seen yet."""
        if lux > self.door_lux:
            self.door_seen = self.door_noted = False
        self.door_lux = lux

    def _illumination(self, lux: float) -> None:
        self.light_shown = False
        if lux == 0.0:
            return
        self._heated("the light was set")
        if not self.truly_dark_seen:
            self.hurts.append("light before a dark frame was seen")
        if self.has_lamp and self.filter != self.thought and self.wheel.line.changed_s == math.inf:
            self.hurts.append("light through another filter than was thought")
        if not lux <= self.most_lux * (1 + 1e-9):
            self.hurts.append(f"a light of {lux:g} lux")
        self._current_is_borne()

    def turns(self, position: int, share: float) -> None:
        """The wheel turns, or stops half-way; what light there is passes through whatever comes
        by.
        """
        if self.known_lux > 0.0:
            self.hurts.append("a filter turned in the light")
        around = (position - self.filter) % len(DENSITIES)
        self.filter = (self.filter - 1 + round(share * around)) % len(DENSITIES) + 1

    def _current_is_borne(self) -> None:
        """The plate bears what the light asks now, unless somebody changed that light by hand since
        it was read.
        """
        if min(self.lamp.line.changed_s, self.wheel.line.changed_s) < math.inf:
            return
        asked = self.anode_na_per_cm2(self.noted_lux)
        if not asked <= self.most_na_per_cm2 * 1.01:
            self.hurts.append(f"a current of {asked:.3g} nA/cm2")

    def _heated(self, what: str) -> None:
        if self.stopped_by:
            self.hurts.append(f"{what} after {self.stopped_by}")
        if self.fault_s < CLOCK.now_s:
            self.hurts.append(f"{what} after a failure")
        if not CLOCK.now_s - self.beat_s <= SAFE_AFTER_S:
            self.hurts.append(f"{what} without a guard")

    # What must be made safe, and when

    def watch(self) -> None:
        """Look for a tube that is hot though something demands the safe state."""
        if self.open[0] == 0.0 and self.volts == 0.0:
            self.demands.clear()
            self.cold_s = CLOCK.now_s
        since_s, why = self._demand()
        if CLOCK.now_s - since_s > SAFE_AFTER_S:
            for hot, line in (
                (self.open[0] > 0.0, self.gate.line),
                (self.volts > 0.0, self.supply.line),
            ):
                if hot and not (line.in_vain and line.tried_s >= since_s):
                    self.hurts.append(
                        f"the {line.name} was hot {why} for {CLOCK.now_s - since_s:.2f} s"
                    )

    def _demand(self) -> tuple[float, str]:
        """Since when something demands the safe state of a hot tube, and why; a time to come where
        nothing does.
        """
        now_s, lines = CLOCK.now_s, (self.gate.line, self.supply.line)
        present = {
            "under too much current": not self.anode_na_per_cm2(self.known_lux)
            <= 1.3 * self.most_na_per_cm2,
            "before too bright a light": self.open[0] > 0.0
            and not self.known_lux <= 1.3 * self.most_lux,
        }
        for why, holds in present.items():
            if holds:
                self.demands.setdefault(why, now_s)
            else:
                self.demands.pop(why, None)
        all_since_s = self.demands | {
            "after a failure": self.fault_s,
            "without a guard": self.beat_s + 0.3,
            "without a sign of life of the run": self.stamp_s + 1.2,
            **{
                f"with a {line.name} changed by hand": line.changed_s + NOTICED_AFTER_S
                for line in lines
            },
            **{
                f"with a broken {line.name}": line.since_s + NOTICED_AFTER_S
                for line in lines
                if line.is_seen_broken
            },
        }
        return min((max(since_s, self.cold_s), why) for why, since_s in all_since_s.items())

    def _gets_safe(self, line: Wire) -> None:
        """An instrument gets safe now: it must not be late, but for one whose port is back only
        now.
        """
        since_s, why = self._demand()
        late = CLOCK.now_s - since_s > SAFE_AFTER_S and not line.in_vain
        if late and not 0.0 <= CLOCK.now_s - line.back_s < 2.0:
            self.hurts.append(
                f"the {line.name} was made safe {CLOCK.now_s - since_s:.2f} s after it was hot "
                f"{why}"
            )


class Gate:
    """A gate generator, see `drivers.roles.Gate`."""

    shut_commands = ("shut",)

    def __init__(self, lab: Laboratory) -> None:
        self.lab, self.line, self.set = lab, Wire("gate", self._obey), (0.0, 0.0)

    def _obey(self, command, share: float) -> None:
        self.lab.shuts() if command == "shut" else self.lab.opens(*command, share)

    def identify(self) -> None:
        self.line.answer(float)

    def look(self) -> None:
        self.line.answer(float)
        if self.lab.open != self.set:
            raise InstrumentRejected("the gate must stay as it was set")

    def check_pulse(self, **_) -> None:
        pass

    def shut(self) -> None:
        self.lab.between()
        self.line.write("shut")
        self.lab.between()
        if self.line.answer(lambda: self.lab.open[0]) > 0.0:
            raise InstrumentRejected("the gate must shut")
        self.set = (0.0, 0.0)

    def open(self, *, width_ns: float, rate_hz: float, **_) -> float:
        self.shut()
        self.lab.between()
        self.line.write((width_ns, rate_hz))
        self.set = self.lab.open
        self.lab.between()
        return self.line.answer(lambda: self.lab.open[0])


class Supply:
    """A high-voltage supply, see `drivers.roles.Supply`."""

    off_commands, reading = ("off",), "volts?"

    def __init__(self, lab: Laboratory) -> None:
        self.lab, self.line, self.is_on, self.set = lab, Wire("supply", self._obey), False, None

    def _obey(self, command, share: float) -> None:
        self.lab.switches_off() if command == "off" else self.lab.moves_gain(*command, share)

    def identify(self) -> None:
        self.line.answer(float)

    def look(self) -> None:
        volts = self.read_voltage_v()
        if self.is_on:
            self.check_on()
        if volts != (self.set if self.is_on else 0.0) and (self.set is not None or not self.is_on):
            raise InstrumentRejected("the supply must stay as it was set")

    def check_voltage(self, volts: float) -> None:
        pass

    def prepare(self, *, limit_v: float) -> None:
        self.order_off()

    def order_off(self) -> None:
        self.is_on = False
        self.line.write("off")
        self.line.answer(float)

    def switch_on(self) -> None:
        self.lab.between()
        self.set = None
        self.line.write((50.0, 1.0))
        self.is_on = True

    def raise_to(self, goal_v: float, *, rate_v_per_s: float, check: Callable[[], None]) -> float:
        level_v, self.set = self.lab.volts, None
        while level_v < goal_v:
            level_v = min(level_v + 0.2 * rate_v_per_s, goal_v)
            self.lab.lasts(0.2)
            check()
            self.check_on()
            self.line.write((level_v, rate_v_per_s))
        return self._settled()

    def lower_to(self, goal_v: float, *, check: Callable[[], None]) -> float:
        self.lab.between()
        check()
        self.line.write((goal_v, 0.0))
        return self._settled()

    def off(self) -> float:
        self.lab.between()
        self.order_off()
        if (volts := self.read_voltage_v()) > 0.0:
            raise InstrumentRejected("the supply must switch off")
        return volts

    def read_voltage_v(self) -> float:
        return self.line.answer(lambda: self.lab.volts)

    def check_on(self) -> None:
        if self.line.answer(lambda: self.lab.volts) == 0.0:
            raise InstrumentTripped("the supply must stay on")

    def _settled(self) -> float:
        self.set = self.lab.volts
        self.lab.between()
        return self.read_voltage_v()


class LightSource:
    """A lamp behind the filters, see `drivers.roles.LightSource`."""

    dark_commands = ("dark",)

    def __init__(self, lab: Laboratory) -> None:
        self.lab, self.line, self.set = lab, Wire("lamp", self._obey), 0.0

    def _obey(self, command, share: float) -> None:
        if command == "dark":
            self.lab.lamp_a, self.line.changed_s = 0.0, math.inf
        else:
            self.lab.burns(command, share)

    def identify(self) -> None:
        self.line.answer(float)

    def look(self) -> None:
        if self.line.answer(lambda: self.lab.lamp_a) != self.set:
            raise InstrumentRejected("the lamp must stay as it was set")

    def prepare(self, *, limit_a: float) -> None:
        self.darken()

    def darken(self) -> None:
        self.lab.between()
        self.line.write("dark")
        if self.line.answer(lambda: self.lab.lamp_a) > 0.0:
            raise InstrumentRejected("the lamp must go out")
        self.set, self.lab.door_seen, self.lab.door_noted = 0.0, False, False

    def shine(self, current_a: float) -> float:
        self.lab.between()
        self.line.write(current_a)
        self.set = self.lab.lamp_a
        self.lab.between()
        self.lab.door_seen = self.lab.door_noted = False
        return self.line.answer(lambda: self.lab.lamp_a)


class Wheel:
    """A filter wheel, see `drivers.roles.FilterWheel`."""

    positions = len(DENSITIES)

    def __init__(self, lab: Laboratory) -> None:
        self.lab, self.line, self.set = lab, Wire("wheel", self._obey), 0

    def _obey(self, command, share: float) -> None:
        self.lab.turns(command, share)

    def identify(self) -> None:
        self.line.answer(float)

    def look(self) -> None:
        if self.line.answer(lambda: self.lab.filter) != self.set:
            raise InstrumentRejected("the wheel must stay where it stood")

    def position(self) -> int:
        self.lab.between()
        self.set = int(self.line.answer(lambda: self.lab.filter))
        if self.set < self.positions:
            self.lab.thought = self.set
            self.line.changed_s = math.inf
        return self.set

    def turn_to(self, position: int) -> int:
        self.line.write(position)
        self.lab.lasts(0.3)
        if self.position() != position:
            raise InstrumentRejected("the wheel must turn")
        return position


class Meter:
    """A light meter at the tube, see `drivers.roles.LightMeter`; a watt on its head is a lux."""

    def __init__(self, lab: Laboratory) -> None:
        self.lab, self.line = lab, Wire("meter", lambda *_: None)

    def identify(self) -> None:
        self.line.answer(float)

    def tune(self, wavelength_nm: float) -> None:
        self.line.answer(float)

    def power_w(self) -> float:
        watts = self.line.answer(lambda: self.lab.own_lux + self.lab.door_lux)
        self.lab.door_seen = self.lab.door_lux > 0.0
        return watts
