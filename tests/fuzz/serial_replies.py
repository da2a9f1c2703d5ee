"""Replies that no instrument should give, to every parser of serial replies.

Each question of each driver is answered by bytes that are random, cut, repeated, or nearly right. A
driver may end in one of its own errors and in nothing else, within its time and with bounded
memory. A new driver adds its line to `PARSERS`.
"""

import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.errors import BenchError
from drivers.instruments.delay_generator import DelayGenerator
from drivers.instruments.dg535 import Dg535
from drivers.instruments.filter_wheel import FilterWheel, PromptLine
from drivers.instruments.high_voltage import HighVoltage
from drivers.instruments.iseg import Iseg, IsegLine, legacy_number
from drivers.instruments.light_source import KNOWN, LightSource
from drivers.instruments.voltage_limits import Supply
from drivers.serial_lines.line import LONGEST_ANSWER, FramedLine, PrologixLine
from labdata import BadInput

ANSWER_S = 0.002
WITHIN_S = 5.0  # a busy machine may take seconds over what takes milliseconds
PIECES = (
    b"\r\n",
    b"\n",
    b"\r",
    b"> ",
    b"0",
    b"-1",
    b"5\r\n",
    b"+60.000000\r\n",
    b"2,+0.016000000000\r\n",
    b"nan",
    b"1e999",
    b"9" * 400,
    b"S1=ON \r\n",
    b"S1=TRP\r\n",
    b"S1",
    b"=",
    b"U1\r\n",
    b"+05000-01\r\n",
    b"0001-7\r\n",
    b"????\r\n",
    b"? UMAX=0900\r\n",
    b"#\r\n480012;3.15;3000V;100uA\r\n",
    b"T1\r\n004\r\n",
    b"pos?\r3\r> ",
    b"*idn?\r",
    b"FW102C",
    b"Command error CMD_NOT_DEFINED\n> ",
    b"ERROR 2: out of range\r\n",
    b"DC2100\r\n",
    b"14\r\n",
    b"Version 6\r\n",
    b"\xff\xfe",
    b"\x00" * 40,
    b"x" * (LONGEST_ANSWER + 10),
)


class NoisyPort:
    """A port at whose far end somebody says what they like, in pieces."""

    def __init__(self, said: bytes, rng: random.Random) -> None:
        self._said, self._rng = said, rng

    def send(self, data: bytes) -> None:
        """Nobody listens."""

    def receive(self, timeout_s: float) -> bytes:
        """The next piece."""
        size = self._rng.choice((1, 3, 40, 5000))
        piece, self._said = self._said[:size], self._said[size:]
        if not piece:
            time.sleep(min(timeout_s, ANSWER_S))
        return piece

    def reopen(self, path: str | None = None) -> None:
        """It was never gone."""

    def fileno(self) -> int:
        """No descriptor."""
        return -1

    def close(self) -> None:
        """Nothing to let go of."""


def _in_step(line: Any) -> Any:
    line._in_step = True
    return line


def _framed(port: NoisyPort) -> FramedLine:
    return FramedLine(port, name="instrument", answer_s=ANSWER_S)


def _bus(port: NoisyPort) -> PrologixLine:
    return _in_step(PrologixLine(port, name="instrument", address=14, answer_s=ANSWER_S))


def _echo(port: NoisyPort) -> IsegLine:
    return _in_step(IsegLine(port, name="instrument", answer_s=ANSWER_S))


def _prompt(port: NoisyPort) -> PromptLine:
    return _in_step(PromptLine(port, name="instrument", answer_s=ANSWER_S))


def _after_shut(gate: DelayGenerator) -> DelayGenerator:
    gate._kept = {"TSRC?": ("trigger source", "5"), "LOFF? 1": ("idle level", "+0.00")}
    gate._external_hz = 60.0
    return gate


def _at_800_v(supply: Supply) -> Supply:
    supply.is_on, supply._reached_v = True, 800.0
    return supply


PARSERS: dict[str, Callable[[NoisyPort], object]] = {
    "dg645 identity": lambda port: DelayGenerator(_framed(port)).identify(),
    "dg645 shut": lambda port: DelayGenerator(_framed(port)).shut(),
    "dg645 width": lambda port: DelayGenerator(_framed(port))._verify_delay(
        "gate width", 3, 2, 1e6
    ),
    "dg645 look": lambda port: DelayGenerator(_framed(port)).look(),
    "dg645 look after shut": lambda port: _after_shut(DelayGenerator(_framed(port))).look(),
    "dg535 delay": lambda port: Dg535(_bus(port)).identify(),
    "dg535 shut": lambda port: Dg535(_bus(port)).shut(),
    "ps350 prepare": lambda port: HighVoltage(_bus(port)).prepare(limit_v=900.0),
    "ps350 status": lambda port: HighVoltage(_bus(port)).check_on(),
    "ps350 look": lambda port: _at_800_v(HighVoltage(_bus(port))).look(),
    "ps350 volts": lambda port: HighVoltage(_bus(port)).read_voltage_v(),
    "prologix address": lambda port: PrologixLine(
        port, name="instrument", address=14, answer_s=ANSWER_S
    ).ask("VOUT?"),
    "iseg identity": lambda port: Iseg(_echo(port)).identify(),
    "iseg state": lambda port: Iseg(_echo(port)).check_on(),
    "iseg look": lambda port: _at_800_v(Iseg(_echo(port))).look(),
    "iseg volts": lambda port: Iseg(_echo(port)).read_voltage_v(),
    "iseg number": lambda port: legacy_number(port.receive(0.0).decode("ascii", "replace")),
    "wheel identity": lambda port: FilterWheel(_prompt(port)).identify(),
    "wheel position": lambda port: FilterWheel(_prompt(port)).position(),
    "light identity": lambda port: LightSource(
        FramedLine(port, name="instrument", answer_s=ANSWER_S, known=KNOWN)
    ).identify(),
    "light look": lambda port: LightSource(_framed(port)).look(),
    "late answer": lambda port: [_framed(port).ask("TSRC?")],
}


def reply(rng: random.Random) -> bytes:
    """Draw what an instrument might say: pieces of real answers, cut, repeated, and with wrong
    bytes among them.
    """
    said = b"".join(rng.choice(PIECES) * rng.choice((1, 1, 1, 3)) for _ in range(rng.randrange(8)))
    if rng.random() < 0.3:
        said = rng.randbytes(rng.randrange(200))
    if said and rng.random() < 0.3:
        said = said[: rng.randrange(len(said))]
    if said and rng.random() < 0.3:
        place = rng.randrange(len(said))
        said = said[:place] + rng.randbytes(1) + said[place + 1 :]
    return said


def try_once(name: str, said: bytes, rng: random.Random) -> bool:
    """Let one parser hear one reply; whether it was one. What is not one of the drivers' own errors
    comes out.
    """
    began_s, heard = time.monotonic(), True
    try:
        PARSERS[name](NoisyPort(said, rng))
    except (BenchError, BadInput) as error:
        heard = False
        if len(str(error)) > 1000:
            raise AssertionError(
                f"a sentence must stay one, got {len(str(error))} characters"
            ) from error
    if (took_s := time.monotonic() - began_s) > WITHIN_S:
        raise AssertionError(f"{name} must end within {WITHIN_S:g} s, got {took_s:.2f} s")
    return heard


def once(rng: random.Random, _folder: Path) -> bool:
    """Let one parser hear one reply; whether it found what it asked for."""
    return hear(rng.choice(tuple(PARSERS)), rng, _folder)


def hear(name: str, rng: random.Random, _folder: Path) -> bool:
    """Let a parser hear one reply; whether it found what it asked for."""
    return try_once(name, reply(rng), rng)
