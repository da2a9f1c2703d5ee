"""Delay generator and high-voltage supply on pseudo-terminals, written from their manuals apart
from the twins of the virtual bench, in a process of their own.

A DG645 and a PS350 behind a Prologix adapter, as far as a bench speaks to them. What they put out
stands in shared memory, and faults come as messages over a socket.
"""

import collections
import json
import os
import random
import select
import struct
import time
import tty
from pathlib import Path

GATE, SUPPLY = "gate", "supply"
OPEN_ABOVE_V = 1.5  # Threshold of the gate unit
SLEW_V_PER_S = {"up": 8000.0, "down": 3000.0}
GATE_LEVELS = ("LOFF", "LAMP", "LPOL")
OUTPUTS = struct.Struct(
    "=???dd"
)  # gate open, voltage on, set at the panel; volts, time of the last


class Generator:
    """A DG645: registers by mnemonic and first argument, and a queue of errors."""

    def __init__(self) -> None:
        self.registers: dict[str, float] = {"TSRC": 5, "TRAT": 1000.0}
        self.delays = dict.fromkeys(range(2, 10), (0, 0.0))
        self.errors: collections.deque[int] = collections.deque(maxlen=20)
        for output in range(5):
            self.registers |= {f"LAMP{output}": 2.5, f"LOFF{output}": 0, f"LPOL{output}": 1}
            self.registers[f"PRES{output}"] = 1
        self.registers |= {"BURM": 0, "HOLD": 0.0, "ADVT": 0, "INHB": 0}

    @property
    def is_on(self) -> bool:
        """Whether the gate opens."""
        low, amplitude, is_positive = (self.registers[f"{name}1"] for name in GATE_LEVELS)
        idle_v, active_v = (low, low + amplitude) if is_positive else (low + amplitude, low)
        width_s = self.delays[3][1] if self.delays[3][0] == 2 else 0.0
        pulses = self.registers["TSRC"] in (0, 6) and width_s > 0.0
        return idle_v > OPEN_ABOVE_V or (pulses and active_v > OPEN_ABOVE_V)

    def answer(self, command: str) -> str | None:
        """Obey a command; return the answer of a question."""
        name, is_question = command[:4].rstrip("?"), "?" in command
        arguments = command[4:].replace("?", "").replace(" ", "").split(",")
        if command.startswith("*IDN?"):
            return "Stanford Research Systems,DG645,s/n004711,ver1.14.10E"
        if command.startswith("LERR?"):
            return str(self.errors.popleft() if self.errors else 0)
        if command.startswith("INSR?"):
            return str(int(self.registers["TSRC"] in (0, 6)))
        if command.startswith("*CLS"):
            self.errors.clear()
        elif name == "DLAY" and is_question:
            edge, seconds = self.delays[int(arguments[0])]
            return f"{edge},{seconds:+.12f}"
        elif name == "DLAY":
            edge, reference, seconds = int(arguments[0]), int(arguments[1]), float(arguments[2])
            self.delays[edge] = reference, round(seconds / 5e-12) * 5e-12
        else:
            key = name + (arguments[0] if f"{name}1" in self.registers else "")
            if key not in self.registers:
                self.errors.append(111)
            elif is_question:
                return f"{self.registers[key]:.12g}"
            else:
                self.registers[key] = float(arguments[-1])
        return None

    def pass_time(self, seconds: float) -> None:
        """Nothing moves."""


class HighVoltage:
    """A PS350."""

    def __init__(self) -> None:
        self.registers = {"VSET": 0.0, "VLIM": 5000.0}
        self.events, self.is_on, self.volts, self.is_tripped = 128, False, 0.0, False

    def answer(self, command: str) -> str | None:
        """Obey a command; return the answer of a question."""
        name = command[:4]
        if command.startswith("*IDN?"):
            return "StanfordResearchSystems,PS350,12345,1.40"
        if command.startswith("*ESR?"):
            events, self.events = self.events, 0
            return str(events)
        if command.startswith("*STB?"):
            return str(128 * self.is_on + 4 * self.is_tripped)
        if command.startswith("VOUT?"):
            return f"{self.volts:.0f}"
        if command in ("VSET?", "VLIM?"):
            return f"{self.registers[name]:.0f}"
        if name in self.registers:
            volts = float(command[4:])
            if name == "VSET" and volts > self.registers["VLIM"]:
                self.events |= 16
            else:
                self.registers[name] = volts
        elif name == "HVON":
            self.is_on = not self.is_tripped
            self.events |= 16 * self.is_tripped
        elif name == "HVOF":
            self.is_on = False
        elif name != "*CLS":
            self.events |= 32
        return None

    def pass_time(self, seconds: float) -> None:
        """Let the output move."""
        goal_v = self.registers["VSET"] if self.is_on else 0.0
        up_v, down_v = (rate * seconds for rate in SLEW_V_PER_S.values())
        self.volts += min(up_v, max(-down_v, goal_v - self.volts))


class Adapter:
    """A Prologix adapter in front of the supply."""

    def __init__(self, instrument: HighVoltage) -> None:
        self.instrument, self.address, self.pending = instrument, 0, ""

    def answer(self, line: str) -> str | None:
        """Obey the adapter's own commands, and hand others to the instrument."""
        if not line.startswith("++"):
            self.pending = self.instrument.answer(line) or "" if self.address == 14 else ""
            return None
        if line.startswith("++addr "):
            self.address = int(line.split()[1])
        answers = {"++ver": "Prologix GPIB-USB Controller version 6.107", "++addr": self.address}
        if line.startswith("++read"):
            answers[line], self.pending = self.pending, ""
        return str(answers.get(line, "")) or None


class Line:
    """A serial line to an instrument, with what is wrong with it."""

    def __init__(self, link: Path, instrument: Generator | HighVoltage) -> None:
        self.link, self.instrument = link, instrument
        self.far_end = Adapter(instrument) if isinstance(instrument, HighVoltage) else instrument
        self.wrong: dict[str, float] = {}
        self.heard, self.waiting = b"", collections.deque[tuple[float, bytes]]()
        self.ends: tuple[int, int] | None = None
        self.plug()

    def plug(self) -> None:
        """Make a new port."""
        self.unplug()
        self.ends = os.openpty()
        tty.setraw(self.ends[1])
        os.set_blocking(self.ends[0], False)
        unfinished = self.link.with_suffix(".new")
        unfinished.symlink_to(os.ttyname(self.ends[1]))
        unfinished.replace(self.link)

    def unplug(self) -> None:
        """Take the port away."""
        if self.ends is not None:
            self.link.unlink(missing_ok=True)
            for end in self.ends:
                os.close(end)
            self.ends, self.heard = None, b""
            self.waiting.clear()

    def turn(self, rng: random.Random) -> None:
        """Hear what came, obey and answer."""
        if self.ends is None:
            return
        try:
            data = os.read(self.ends[0], 4096)
        except BlockingIOError:
            data = b""
        if self.wrong.keys() & {"silent", "power"}:
            data = b""
        if "garbled orders" in self.wrong:
            data = bytes(byte ^ 0x11 for byte in data)
        *lines, self.heard = (self.heard + data.replace(b"\r", b"\n")).split(b"\n")
        for line in lines:
            if "lost orders" in self.wrong and rng.random() < self.wrong["lost orders"]:
                continue
            for command in line.replace(b"\x1b", b"").decode("latin-1").upper().split(";"):
                self._obey(command.strip(), rng)
        while self.waiting and self.waiting[0][0] <= time.monotonic():
            try:
                os.write(self.ends[0], self.waiting.popleft()[1])
            except BlockingIOError:
                break

    def _obey(self, command: str, rng: random.Random) -> None:
        own = command.lower() if command.startswith("++") else command
        try:
            text = self.far_end.answer(own) if own else None
        except (ValueError, IndexError, KeyError):  # what noise made of a command
            return
        lost = "lost answers" in self.wrong and rng.random() < self.wrong["lost answers"]
        if text is None or "mute" in self.wrong or lost:
            return
        answer = text.encode() + b"\r\n"
        if "short answers" in self.wrong:
            answer = answer[: rng.randrange(len(answer))]
        if "garbled answers" in self.wrong:
            answer = bytes(byte ^ 0x11 for byte in answer)
        if "answers twice" in self.wrong:
            answer *= 2
        self.waiting.append((time.monotonic() + 1e-3 + self.wrong.get("late answers", 0.0), answer))


def serve(folder: Path, shared: memoryview, control: int, parent: int, seed: int) -> None:
    """Serve both instruments until the parent is gone; messages are `[who, fault, value]`, value
    None: over.
    """
    rng = random.Random(seed)
    lines = {GATE: Line(folder / GATE, Generator()), SUPPLY: Line(folder / SUPPLY, HighVoltage())}
    panel: dict[tuple[str, str], float] = {}
    before_s = time.monotonic()
    while os.getppid() == parent:
        masters = [line.ends[0] for line in lines.values() if line.ends is not None]
        ready = select.select([control, *masters], [], [], 2e-3)[0]
        if control in ready:
            for message in os.read(control, 65536).splitlines():
                _take(json.loads(message), lines, panel)
        now_s = time.monotonic()
        for line in lines.values():
            line.instrument.pass_time(now_s - before_s)
            line.turn(rng)
        before_s = now_s
        gate, supply = (lines[who].instrument for who in (GATE, SUPPLY))
        changed = any(
            lines[who].instrument.registers[name] == value for (who, name), value in panel.items()
        )
        is_open = gate.is_on and "power" not in lines[GATE].wrong
        OUTPUTS.pack_into(shared, 0, is_open, supply.is_on, changed, supply.volts, now_s)


def _take(message: list, lines: dict[str, Line], panel: dict[tuple[str, str], float]) -> None:
    who, fault, value = message
    line = lines[who]
    if fault == "panel":
        for command in value.split(";"):
            line.instrument.answer(command)
            name, _, number = command.partition(" ")
            key = name + (number.split(",")[0] if "," in number else "")
            if name != "VLIM":  # a limit alone lets nothing out
                panel[who, key] = float(number.split(",")[-1])
    elif fault == "unplugged":
        line.plug() if value is None else line.unplug()
    elif fault == "swapped":
        for each in lines.values():
            each.unplug()
        lines[GATE].link, lines[SUPPLY].link = lines[SUPPLY].link, lines[GATE].link
        for each in lines.values():
            each.plug()
    elif value is None:
        line.wrong.pop(fault, None)
    else:
        line.wrong[fault] = value
        if fault == "power" and isinstance(line.instrument, HighVoltage):
            line.instrument.is_on = False
