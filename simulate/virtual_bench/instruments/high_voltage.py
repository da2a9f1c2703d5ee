"""A virtual Stanford PS350 high-voltage supply: commands, latched trips, and an output that slews
and decays.
"""

import math
from enum import IntFlag

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instrument import (
    LOAD_OHM,
    BusInstrument,
    Command,
    RefusedCommand,
    StandardEvent,
    VirtualModel,
    VoltageSource,
    commands_of,
    parse_number,
    read_register,
)
from simulate.virtual_bench.prologix import PrologixAdapter

IDENTITY = "StanfordResearchSystems,PS350,2067,1.40"
# in steps of 1 V; below the minimum only 0 can be set; recalled
FULL_SCALE_V, MINIMUM_V = 5000.0, 50.0
FULL_SCALE_A = 5.25e-3
RISE_V_PER_S = FULL_SCALE_V / 3.0  # full scale in about 3 s
DECAY_S = 6.0 / math.log(100.0)  # unloaded, to a hundredth in about 6 s
VOLTS, AMPERES = "{:.0f}", "{:.3E}"  # forms of the answers; recalled
_SWITCHES = {"TMOD": 1, "SMOD": 1, "*ESE": 255, "*SRE": 255, "*PSC": 1}  # largest values


class StatusByte(IntFlag):
    """Status byte of the PS350; the first bits but one latch."""

    STABLE = 1
    VOLTAGE_TRIP = 2
    CURRENT_TRIP = 4
    CURRENT_LIMIT = 8
    MAV = 16
    ESB = 32
    MSS = 64
    HV_ON = 128


LATCHED = StatusByte.VOLTAGE_TRIP | StatusByte.CURRENT_TRIP | StatusByte.CURRENT_LIMIT


class HighVoltageSupply(BusInstrument, VoltageSource):
    """High-voltage supply behind its GPIB connector after power-on; it moves `time_scale` times
    faster than life.
    """

    def __init__(self, *, time_scale: float = 1.0) -> None:
        BusInstrument.__init__(self)
        VoltageSource.__init__(self, time_scale=time_scale)
        self._switches = {**dict.fromkeys(_SWITCHES, 0), "*PSC": 1}
        self._reset()
        self.power_cycle()

    def power_cycle(self) -> None:
        """Lose power and get it back: settings stay, the high voltage comes up off (recalled)."""
        self.clear()
        self._on, self._trip_pending, self._latched = False, False, 0
        self._event_status = StandardEvent.PON

    # The bus

    def talk(self) -> bytes:
        """Return the answer, EOI with its last byte; empty, with a query error, without a query."""
        if not self._output:
            self._event_status |= StandardEvent.QYE
        return super().talk()

    def _status_byte(self) -> int:
        stable = self._on and abs(self.output_v - self._goal_v()) < 1.0
        event = bool(self._event_status & self._switches["*ESE"])
        byte = (
            self._latched
            | StatusByte.STABLE * stable
            | StatusByte.ESB * event
            | StatusByte.HV_ON * self._on
            | StatusByte.MAV * bool(self._output)
        )
        return byte | StatusByte.MSS * bool(byte & self._switches["*SRE"])

    def _overrun(self) -> None:
        self._output = b""
        self._event_status |= StandardEvent.DDE

    def _message(self, line: str) -> None:
        if line.strip() and self._output:  # a new message before the answer was taken
            self._output = b""
            self._event_status |= StandardEvent.QYE
        answers = []
        for command in commands_of(line):
            try:
                answers.append(self._obey(command))
            except RefusedCommand as refusal:
                self._event_status |= refusal.code
        if texts := [answer for answer in answers if answer is not None]:
            self._output = ";".join(texts).encode() + b"\n"

    def _obey(self, command: Command | None) -> str | None:
        if command is None:
            raise RefusedCommand(StandardEvent.CME)
        name, arguments = command.mnemonic, command.arguments
        if command.query and name in ("*STB", "*ESR"):
            return self._register(name, arguments)
        if command.query or name in _ACTIONS:
            if arguments or (command.query and name not in self._readings()):
                raise RefusedCommand(StandardEvent.CME)
            return self._readings()[name] if command.query else _ACTIONS[name](self)
        if len(arguments) != 1 or name not in (*self._set, *self._switches):
            raise RefusedCommand(StandardEvent.CME)
        value = parse_number(arguments[0], float, StandardEvent.CME)
        if name in self._set:
            self._set[name] = self._check_setting(name, value)
        elif not 0 <= int(value) <= _SWITCHES[name]:
            raise RefusedCommand(StandardEvent.EXE)
        else:
            self._switches[name] = int(value)
        return None

    def _check_setting(self, name: str, value: float) -> float:
        """Return the value that a setting takes; one out of range or order is refused."""
        if name[0] == "V":
            value = float(round(value))
            allowed = value == 0 or MINIMUM_V <= value <= FULL_SCALE_V
            ordered = value <= self._set["VLIM"] if name == "VSET" else value >= self._set["VSET"]
        else:
            allowed, ordered = 0 < value <= FULL_SCALE_A, True
        if not (allowed and ordered):
            raise RefusedCommand(StandardEvent.EXE)
        return value

    def _readings(self) -> dict[str, str]:
        return {
            "*IDN": IDENTITY,
            "*OPC": "1",
            "*TST": "0",
            "VOUT": VOLTS.format(self.output_v),
            "IOUT": AMPERES.format(round(self.output_v / LOAD_OHM, 6)),
            **{
                name: (VOLTS if name[0] == "V" else AMPERES).format(value)
                for name, value in self._set.items()
            },
            **{name: str(value) for name, value in self._switches.items()},
        }

    def _register(self, name: str, arguments: tuple[str, ...]) -> str:
        """Read a register, or one of its bits, which clears what latches."""
        is_event = name == "*ESR"
        refusals = StandardEvent.CME, StandardEvent.CME, StandardEvent.EXE
        register = self._event_status if is_event else self._status_byte()
        value, remaining_bits = read_register(register, arguments, refusals, float)
        if is_event:
            self._event_status = remaining_bits
        else:
            self._latched &= remaining_bits | ~LATCHED
        return str(value)

    def _switch_on(self) -> None:
        if self._trip_pending:
            raise RefusedCommand(StandardEvent.EXE)
        self._on = True

    def _switch_off(self) -> None:
        self._on = False

    def _clear_trip(self) -> None:
        self._trip_pending = False

    def _reset(self) -> None:
        self._on = False
        self._set = {"VSET": 0.0, "VLIM": FULL_SCALE_V, "ILIM": FULL_SCALE_A, "ITRP": FULL_SCALE_A}

    def _clear_status(self) -> None:
        self._event_status = self._latched = 0

    def _operation_complete(self) -> None:
        self._event_status |= StandardEvent.OPC

    # Physics

    def _goal_v(self) -> float:
        return min(self._set["VSET"], self._set["ILIM"] * LOAD_OHM) if self._on else 0.0

    def advance(self, now_s: float, faults: Faults) -> None:
        """Advance the output to a time, s: up at a constant rate, down by discharge through load
        and bleeder.
        """
        elapsed_s = self._pass_time(now_s)
        if self._on and (faults.tripped or self.output_v / LOAD_OHM > self._set["ITRP"]):
            self._on, self._trip_pending = False, self._switches["TMOD"] == 0
            self._latched |= StatusByte.CURRENT_TRIP
        goal_v = self._goal_v()
        if self.output_v < goal_v:
            self.output_v = min(goal_v, self.output_v + RISE_V_PER_S * elapsed_s)
        else:
            self.output_v = max(goal_v, self.output_v * math.exp(-elapsed_s / DECAY_S))
        if not self._on and self.output_v < 0.05:
            self.output_v = 0.0
        if self._on and self._set["VSET"] > self._set["ILIM"] * LOAD_OHM:
            self._latched |= StatusByte.CURRENT_LIMIT


_ACTIONS = {
    "HVON": HighVoltageSupply._switch_on,
    "HVOF": HighVoltageSupply._switch_off,
    "TCLR": HighVoltageSupply._clear_trip,
    "*RST": HighVoltageSupply._reset,
    "*CLS": HighVoltageSupply._clear_status,
    "*OPC": HighVoltageSupply._operation_complete,
    "*WAI": lambda _: None,
}


MODEL = VirtualModel(
    name="ps350",
    bench_name="high_voltage",
    make=lambda address, scale: PrologixAdapter(address, HighVoltageSupply(time_scale=scale)),
    baud=None,
    panel={"voltage": ("VSET 350",), "on": ("VSET 100", "HVON")},
)
