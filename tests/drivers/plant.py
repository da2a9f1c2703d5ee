"""Stories of a bench server: what a client may ask, in whatever order, while anything happens in
its laboratory.
"""

import contextlib
import queue
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest import mock

from drivers.bench import safe_state, server, tube_bench
from drivers.bench.connection import Beat, Fault, Reply, Request
from drivers.bench.interlock import REACTIONS, RULES, Interlock
from drivers.bench.setup import BenchSetup
from drivers.bench.state import RaiseGain
from drivers.interface import FrameLevels
from labdata import Conditions, Gating, InstrumentConfig, Meters, Target
from tests.drivers import laboratory

CLOCK, LIMITS, SENSOR = laboratory.CLOCK, laboratory.LIMITS, laboratory.SENSOR

TICK_S = 0.1
VOLTS = (0.0, 50.0, 400.0, 600.0, 800.0, 850.0, 899.0, 900.0, 901.0, 950.0, 2000.0)
WIDTHS_NS = (0.0, 1e3, 1.6e5, 1e6, 1.6e7, 1.7e7, 1.99e7, 2e7, 2.01e7, 1e9)
LUX = (
    0.0,
    1e-5,
    1e-4,
    1e-3,
    5e-3,
    9.9e-3,
    1.01e-2,
    1.1e-2,
    0.5,
    9.0,
    10.0,
    10.5,
    1e5,
    float("nan"),
)

TARGETS = (Target(), Target(angle_deg=5.0), Target(pinhole_px=1.0))
# a gate that is too wide at the second is not open for too much of the time
FIELDS_HZ = 59.94, 49.0
DELAYS = (0, 1, 1, 1, 2, 2, 3, 4, 5, 7, 9, 11)  # exchanges of an order before something happens
TROUBLES = ("silent", "mute", "wrong", "gone", "disobedient", "half")


class InOneThread:
    """A crew whose tasks run one after the other, each from the same simulated time."""

    def run(
        self, tasks: Sequence[Callable[[], object]], again: Sequence[Callable[[], object]]
    ) -> None:
        began_s, ended_s = CLOCK.now_s, [CLOCK.now_s]
        for task in tasks:
            CLOCK.now_s = began_s
            task()
            ended_s.append(CLOCK.now_s)
        CLOCK.now_s = max(ended_s)

    def start(self, task: Callable[[], object]) -> None:
        task()

    def dismiss(self) -> None:
        pass


@contextlib.contextmanager
def simulated_time():
    """Let the server sleep in simulated time and start no threads; a plant calls their steps."""
    threads = mock.Mock(
        Thread=mock.Mock(), Event=threading.Event, Lock=threading.Lock, RLock=threading.RLock
    )
    with (
        mock.patch.object(safe_state, "time", CLOCK),
        mock.patch.object(tube_bench, "Crew", InOneThread),
        mock.patch.object(server, "threading", threads),
    ):
        yield


class Plant:
    """A bench server at its laboratory; it can lack a rule, and its procedures may err."""

    def __init__(self, *, without: str | None = None, limits=LIMITS, kind: int = 0) -> None:
        CLOCK.now_s = 100.0
        assert without is None or without in {one.name for one in (*RULES, *REACTIONS)}
        self.rules = tuple(rule for rule in RULES if rule.name != without)
        self.reactions = tuple(one for one in REACTIONS if one.name != without)
        self.has_lamp, self.has_meter, field_hz = (
            kind % 3 == 2,
            kind % 3 > 0,
            FIELDS_HZ[kind // 3 % 2],
        )
        self.lab = laboratory.Laboratory(
            has_lamp=self.has_lamp, between=self.between, lasts=self.passes
        )
        wires = (
            InstrumentConfig(light="lamp", wheel="wheel") if self.has_lamp else InstrumentConfig()
        )
        self.setup = BenchSetup(
            wires=wires,
            limits=limits,
            log=Path("nowhere"),
            lamp=laboratory.LAMP if self.has_lamp else None,
            meters=Meters(lux_per_w=1.0),
            field_hz=field_hz,
            gating=Gating(),
        )
        self.steps = self.number = 0
        self.passed: Counter[str] = Counter()
        self.slip: str | None = None
        self.interruption: tuple[int, Callable[[], None]] | None = None
        self.safe_thread: threading.Thread | None = None
        self.open()

    # The server

    def open(self) -> None:
        """Start a server at this laboratory, its instruments mended; a bench that fails to open is
        not used.
        """
        lab = self.lab
        self.in_order = self.over = self.refused = False
        self.hung_until_s = self.silent_until_s = self.run_hangs_until_s = -1.0
        self.placing: dict[int, Callable[[], None]] = {}
        self.interlock = Interlock(
            self.setup.limits, rules=self.rules, reactions=self.reactions, clock=CLOCK.monotonic
        )
        self.interruption = self.slip = None
        lab.fault_s, lab.truly_dark_seen, lab.thought = float("inf"), False, 1
        lab.demands.clear()
        lab.stopped_by = ""
        if self.number % 2:
            # somebody turned the wheel while the bench was off
            lab.filter = len(laboratory.DENSITIES)
        lab.beat_s = lab.stamp_s = self.stamp_s = CLOCK.now_s
        drivers = {"gate": lab.gate, "supply": lab.supply, "light-meter": lab.meter}
        if self.has_lamp:
            drivers |= {"light-source": lab.lamp, "filter-wheel": lab.wheel}
        if not self.has_meter:
            del drivers["light-meter"]
        for driver in (lab.gate, lab.supply, lab.lamp, lab.wheel, lab.meter):
            driver.line.mend()
            driver.line.release()
        lab.supply.is_on = False
        stations = {
            role: tube_bench.Station(driver.line, driver) for role, driver in drivers.items()
        }
        for station in stations.values():
            station.procedure = Procedure(self)
        self.next_look_s = self.next_keep_s = CLOCK.now_s
        self.next_meter_s = CLOCK.now_s + 1.0
        self.server = server.BenchServer(
            self, self.setup, lambda *_, **__: None, clock=CLOCK.monotonic
        )
        with mock.patch.object(server, "TubeBench", type("Bench", (ErringBench,), {"plant": self})):
            self.server.open_bench(stations)
        self.ask("light_unknown")

    gone = False

    def send(self, message: object, descriptors: tuple[int, ...] = ()) -> None:
        """What the server says to its client."""
        if isinstance(message, Fault):
            self.lab.fault_s = min(self.lab.fault_s, CLOCK.now_s)
        elif isinstance(message, Reply):
            place, self.refused = self.placing.pop(message.number, None), message.error is not None
            if place is not None and not self.refused:
                place()

    # The client

    def ask(self, command: str, *arguments, later: bool = False, **named) -> None:
        """Ask for something, and have the server obey all that it was asked for, unless that comes
        later.
        """
        self.number += 1
        self.stamp_s = self.lab.stamp_s = CLOCK.now_s  # an order is a sign of life of the run
        self.server.take(
            Request(number=self.number, command=command, arguments=arguments, named=named)
        )
        if not later:
            self.obey()

    def obey(self) -> None:
        """Have the server do what was asked, in its order."""
        with contextlib.suppress(queue.Empty):
            while True:
                request = self.server.orders.get_nowait()
                self.in_order, self.lab.door_noted = True, self.lab.door_seen
                self.server.obey(request)
                self.passed[request.command] += not self.refused
                self.in_order, self.lab.stopped_by = False, "the server's end" if self.over else ""
                self.slip = self.interruption = None
                self.make_safe()
                self.lab.watch()

    def place(
        self,
        lux: float,
        target: Target,
        *,
        share: float = 1.0,
        shows: bool = True,
        later: bool = False,
    ) -> None:
        """A person places a target and sets a light where the bench permits it, and says what a
        meter reads.
        """
        point = target.pinhole_px is not None
        self.placing[self.number + 1] = partial(self.lab.places, lux, target, point, share)
        self.ask("permit_light", lux, point=point, target=target, later=later)
        if shows and not (later or self.refused) and (lux or not self.has_lamp):
            self.say_light(zero=lux == 0.0)

    def say_light(self, *, zero: bool = False) -> None:
        """Say what a person reads on a meter; with the light out nobody looks."""
        self.obey()
        lab = self.lab
        lab.door_seen = not zero and lab.door_lux > 0.0
        self.ask("light_read", lab.known_lux, zero=zero)
        if zero and lab.known_lux <= lab.meter_zero_lux:
            lab.placed_lux = 0.0

    def darken(self) -> None:
        """Block the light."""
        if self.has_lamp:
            self.ask("darken")
        else:
            self.obey()
            self.lab.placed_lux = 0.0
            self.say_light(zero=True)

    def show_dark_frame(self) -> None:
        """Take a frame with the light out, once all that was asked before is done, as a client
        waits for it.
        """
        self.obey()
        lab, bright = self.lab, self.lab.looking and self.lab.own_lux + self.lab.door_lux > 1e-5
        if lab.looking and not bright:
            lab.truly_dark_seen = True
        self.ask(
            "dark_frame_seen", FrameLevels(mean=0.8 if bright else 0.05, saturated=lab.saturated)
        )

    def show_frame(self, *, allowed: float = 0.0, more: float = 0.0) -> None:
        """Take a frame, once all that was asked before is done; some light in view may saturate a
        few more pixels.
        """
        self.obey()
        lab = self.lab
        levels = FrameLevels(mean=0.2, saturated=min(1.0, lab.saturated + more), allowed=allowed)
        if CLOCK.now_s >= self.hung_until_s:
            if levels.saturated - levels.allowed > 0.05:
                lab.demands.setdefault("in a light that saturates frames", CLOCK.now_s)
            elif lab.looking and levels.saturated <= levels.allowed:
                lab.light_shown = True
            self.ask("frame_seen", levels)
            self.make_safe()
            lab.watch()

    # Threads of the server

    def between(self) -> None:
        """Let a moment pass in a procedure, in which another thread may have its turn."""
        CLOCK.sleep(0.005)
        if (
            self.interruption is not None
            and self.in_order
            and threading.current_thread() is not self.safe_thread
        ):
            left, happens = self.interruption
            self.interruption = (left - 1, happens) if left else None
            if not left:
                happens()

    def passes(self, seconds: float) -> None:
        """Let time pass in small ticks, at each of which every thread of the server has its
        turn.
        """
        until_s = CLOCK.now_s + seconds
        while CLOCK.now_s < until_s - 1e-9:
            CLOCK.now_s = min(CLOCK.now_s + TICK_S, until_s)
            self._main_loop()
            if CLOCK.now_s >= self.next_look_s and not self.over:
                self.next_look_s = CLOCK.now_s + 0.3
                for role in self.server_bench.stations:
                    if role != "light-meter":
                        self._look(partial(tube_bench.TubeBench.look, role=role))
            if CLOCK.now_s >= self.next_meter_s and not self.over:
                self.next_meter_s = CLOCK.now_s + 1.0
                self._look(tube_bench.TubeBench.look_at_light)
            self.make_safe()
            if CLOCK.now_s >= self.next_keep_s and not self.over and self.safe_thread is None:
                self.next_keep_s = CLOCK.now_s + safe_state.FOLLOW_S
                self.server.keep_safe(lambda *_, **__: None)
            self.lab.watch()

    def _main_loop(self) -> None:
        self._hear()
        if CLOCK.now_s < self.hung_until_s or self.over:
            return
        if reason := self.server.end_reason():
            self.end(reason)
        else:
            self.server.react()

    def end(self, reason: str) -> None:
        self.over, self.lab.stopped_by = True, "the server's end"
        self.server.end(reason)

    def _hear(self) -> None:
        """Have the signs of life of client and run arrive, if they live and somebody listens."""
        if CLOCK.now_s >= self.run_hangs_until_s:
            self.stamp_s = CLOCK.now_s
        if CLOCK.now_s >= max(self.hung_until_s, self.silent_until_s):
            self.lab.beat_s, self.lab.stamp_s = CLOCK.now_s, self.stamp_s
            self.server.take(Beat(age_s=CLOCK.now_s - self.stamp_s))

    def _look(self, look: Callable[[tube_bench.TubeBench], object]) -> None:
        self.looking = True
        self.server.look_by(look)
        self.looking = False

    looking = False

    def make_safe(self) -> None:
        """Let the thread of the safe action have its turn; a procedure that it waits for goes on
        meanwhile.
        """
        while self.safe_thread is not None or not self.server.to_make_safe.empty():
            if self.safe_thread is None:
                self.waits, self.goes_on = queue.SimpleQueue(), threading.Event()
                order = self.server.to_make_safe.get_nowait()
                if not self.in_order:
                    self.server.make_safe(order)
                    self._hear()  # the main loop went on meanwhile
                    continue
                self.lab.stopped_by = "a safe action in mid-order"
                self.safe_thread = threading.Thread(target=self._act, args=(order,), daemon=True)
                self.safe_thread.start()
            elif self.in_order:
                return
            else:
                self.goes_on.set()
            if self.waits.get() == "done":
                self.safe_thread.join()
                self.safe_thread = None
            self._hear()

    def _act(self, order) -> None:
        try:
            self.server.make_safe(order)
        finally:
            self.waits.put("done")


class Procedure:
    """A station's lock among threads that take turns: who waits for it lets the others go on."""

    def __init__(self, plant: Plant) -> None:
        self.plant, self.holder, self.depth = plant, None, 0

    def _caller(self) -> str:
        if threading.current_thread() is self.plant.safe_thread:
            return "safe"
        return "look" if self.plant.looking else "order"

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        caller = self._caller()
        if self.holder not in (None, caller):
            if not blocking:
                return False
            assert caller == "safe", "only the safe action waits for a procedure"
            until_s = CLOCK.now_s + timeout
            self.plant.goes_on.clear()
            self.plant.waits.put("waits")
            self.plant.goes_on.wait()
            if CLOCK.now_s > until_s:
                return False
        self.holder, self.depth = caller, self.depth + 1
        return True

    def release(self) -> None:
        self.depth -= 1
        if not self.depth:
            self.holder = None

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_) -> None:
        self.release()


class ErringBench(tube_bench.TubeBench):
    """A bench whose procedures may leave out a step or err, and between whose steps other threads
    have their turn.
    """

    plant: Plant

    def __init__(self, *arguments, **named) -> None:
        super().__init__(*arguments, **named)
        self.interlock, self.plant.server_bench = self.plant.interlock, self

    def check(self) -> None:
        self.plant.between()
        super().check()

    def shut_gate(self) -> None:
        if self.plant.slip != "gate not shut":
            super().shut_gate()

    def _gain_move(self, volts: float):
        move = super()._gain_move(volts)
        fast = isinstance(move, RaiseGain) and self.plant.slip == "too fast"
        return replace(move, rate_v_per_s=10.0 * move.rate_v_per_s) if fast else move


def run(plant: Plant, program: bytes) -> None:
    """Let a program happen to a plant: three bytes a step, stopping at the first hurt."""
    for at in range(0, len(program) - 2, 3):
        step(plant, program[at], program[at + 1], program[at + 2])
        plant.steps += 1
        bounds_hold(plant)
        if plant.lab.hurts:
            return


def bounds_hold(plant: Plant) -> None:
    """The interlock never thinks the tube cooler than it is, but for what was changed by hand a
    moment ago.
    """
    state, lab = plant.interlock.state, plant.lab
    unseen = {
        line.name
        for line in (lab.gate.line, lab.supply.line, lab.lamp.line, lab.wheel.line)
        if line.changed_s <= CLOCK.now_s
    }
    if lab.duty > state.duty * (1 + 1e-9) and "gate" not in unseen:
        lab.hurts.append(
            f"the gate was thought open for {state.duty:.3g} and was for {lab.duty:.3g}"
        )
    if lab.volts > state.mcp_v * (1 + 1e-9) and "supply" not in unseen:
        lab.hurts.append(f"the gain was thought {state.mcp_v:g} V and was {lab.volts:g}")
    if lab.known_lux > 1.25 * state.light_lux + 1e-5 and not unseen & {"lamp", "wheel"}:
        lab.hurts.append(f"the light was thought {state.light_lux:g} lux and was {lab.known_lux:g}")
    if state.surely_open and lab.open[0] == 0.0:
        lab.hurts.append("a shut gate was taken for surely open")


def step(plant: Plant, what: int, first: int, second: int) -> None:
    """One thing that somebody does or that happens."""
    if what < 140:
        _sensible(plant, first, second)
    elif what < 150:
        asked = Conditions(mcp_v=_of(VOLTS, first), gate_ns=_of(WIDTHS_NS, second))
        plant.slip = (None, None, None, "gate not shut", "too fast")[first // 16 % 5]
        plant.ask("set_conditions", asked, later=second > 250)
    elif what < 164:
        plant.place(
            _of(LUX, first),
            _of(TARGETS, second // 16),
            share=second % 3 / 2,
            shows=second > 40,
            later=second < 4,
        )
    elif what < 172:
        target = _of(TARGETS, second // 16)
        point, density = target.pinhole_px is not None, (None, *laboratory.DENSITIES)[second % 8]
        plant.ask(
            "shine",
            _of(LUX, first),
            point=point,
            target=target,
            filter_density=density,
            later=second > 250,
        )
    elif what < 192:
        other = (
            plant.darken,
            partial(plant.ask, "shut_gate"),
            partial(plant.ask, "read_meters"),
            plant.say_light,
        )
        more = (
            partial(plant.ask, "verify"),
            partial(plant.ask, "check"),
            partial(plant.ask, "light_unknown"),
        )
        _of(
            (
                *other,
                *more,
                partial(plant.ask, "safe"),
                plant.show_dark_frame,
                partial(plant.ask, "nonsense"),
            ),
            first,
        )()
    elif what < 204:
        plant.show_frame(
            allowed=(0.0, 0.0, 0.3)[first % 3], more=(0.0, 0.0, 0.02, 0.04)[second % 4]
        )
    elif what < 216:
        plant.interruption = (_of(DELAYS, what), partial(_happens, plant, second))
        _sensible(plant, first, second)
    elif what < 236:
        plant.passes((0.05, 0.1, 0.3, 0.7)[first % 4])
    elif what < 248 or first % 2:
        plant.passes(0.1)
    else:
        _happens(plant, second)


def _happens(plant: Plant, which: int) -> None:
    """Something goes wrong, or somebody else asks for the safe state."""
    lab, lines = plant.lab, _lines(plant)
    kind, detail, now_s = which % 16, which // 16, CLOCK.now_s
    if kind < 2:
        plant.server.take(Request(number=0, command="safe"))
        plant.make_safe()
    elif kind < 4:
        _of(lines, detail).break_down(
            _of(TROUBLES, which // 3), back_after_s=1.0 if detail % 2 else float("inf")
        )
    elif kind < 8:
        lab.opens_door(_of((0.0, 1e-4, 3e-3, 6e-3, 9e-3, 0.1, 50.0), detail))
        if detail % 2:
            plant.show_frame()
        plant.passes(2.3)
    elif kind < 9:
        plant.silent_until_s = now_s + (0.3, 0.45, 2.0)[detail % 3]
        plant.passes((0.3, 1.7)[detail % 2])
    elif kind < 10:
        plant.run_hangs_until_s = now_s + (0.5, 1.0, 4.0)[detail % 3]
        plant.passes((0.3, 3.0)[detail % 2])
    elif kind < 13:
        plant.hung_until_s = now_s + (0.3, 2.5)[detail % 2]
        plant.passes((0.3, 1.2, 2.0)[detail % 3])
    elif kind < 14 and plant.server.end_reason() is None:
        plant.end("the client leaves")
        plant.make_safe()
    else:
        _by_hand(plant, detail)
        plant.passes(0.7)


def _by_hand(plant: Plant, which: int) -> None:
    """Somebody turns a knob at the front panel; a server that ended does not look any more."""
    lab, now_s = plant.lab, CLOCK.now_s
    if plant.over:
        return
    if which % 4 == 0:
        lab.open, lab.gate.line.changed_s = (1e6, 50.0), now_s
    elif which % 4 == 1:
        lab.volts, lab.supply.line.changed_s = 850.0 if lab.volts < 850.0 else 100.0, now_s
    elif which % 4 == 2 and lab.lamp_a > 0.0:
        lab.lamp_a, lab.lamp.line.changed_s = 2.0 * lab.lamp_a, now_s
    elif which % 4 == 3 and plant.has_lamp:
        lab.filter, lab.wheel.line.changed_s = lab.filter % len(laboratory.DENSITIES) + 1, now_s


def _sensible(plant: Plant, first: int, second: int) -> None:
    """The next thing that a careful client would do, so that programs get somewhere hot."""
    lab, state = plant.lab, plant.interlock.state
    if lab.fault_s <= CLOCK.now_s or plant.over:
        if first < 100:
            lab.door_lux = 0.0
            plant.open()
        elif first < 120:
            plant.ask("set_conditions", Conditions(mcp_v=600.0, gate_ns=1e6))
        elif first < 140:
            plant.place(1e-4, Target())
        return
    plant.passes(0.02)
    volts, lux = (
        _of((600.0, 800.0, 865.0, 899.0, 899.0), first),
        _of((1e-4, 2e-3, 5e-3, 9e-3, 5.2), second),
    )
    target = TARGETS[2] if lux > 1.0 else TARGETS[0]
    width_ns = 1.6e7 if plant.setup.field_hz > 50.0 else 1.9e7
    if not state.dark and first % 4:
        plant.show_frame()
    elif not state.dark:
        plant.darken()
    elif (state.target, state.point) != (target, lux > 1.0) and not (state.shut or first % 8):
        plant.ask("shut_gate")
    elif state.shut and (state.target, state.point) != (target, lux > 1.0):
        plant.place(0.0, target)
    elif state.shut or state.surely_v < 50.0 or not first % 8:
        plant.ask("set_conditions", Conditions(mcp_v=volts, gate_ns=width_ns))
    elif not state.dark_seen:
        plant.show_dark_frame()
    elif plant.has_lamp and first % 8 != 7:
        plant.ask("shine", lux, point=state.point, target=state.target, filter_density=None)
    else:
        plant.place(lux, state.target or Target())


def _lines(plant: Plant):
    lab = plant.lab
    return [
        one.line
        for one in (lab.gate, lab.supply, lab.gate, lab.supply, lab.lamp, lab.wheel, lab.meter)
    ]


def _of(values, byte: int):
    return values[byte % len(values)]
