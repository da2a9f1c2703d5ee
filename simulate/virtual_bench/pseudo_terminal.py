"""Virtual serial instrument on a pseudo-terminal."""

import contextlib
import os
import select
import termios
import time
import tty
from collections import deque
from collections.abc import Iterable
from pathlib import Path

from simulate.virtual_bench.faults import FaultFile, Faults
from simulate.virtual_bench.instrument import SerialInstrument
from simulate.virtual_bench.prologix import PrologixAdapter

TICK_S = 0.02  # Longest time between two updates of an instrument's physics, s
# An instrument whose bench is gone switches itself off after this time without a byte, s
ORPHAN_S = 5.0


class PseudoTerminal:
    """The instrument's end of a pseudo-terminal, with a link at a stable path to the other end.

    Another rate than `baud` at the far end turns bytes to garbage; None: a USB adapter, which has
    no rate.
    """

    def __init__(self, link: Path, *, baud: int | None) -> None:
        self.link, self._baud = link, baud
        self.plugged = False
        self.plug()

    def plug(self, name: str = "") -> None:
        """Plug in: a new terminal behind the same link, or behind one of another name."""
        self._link = self.link.with_name(name) if name else self.link
        self._master, self._slave = os.openpty()
        # else the line echoes our own answers back to us until a client opens it
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(self._slave))
        self.plugged = True

    def close(self) -> None:
        """Unplug."""
        if not self.plugged:
            return
        self.plugged = False
        self._link.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that arrive within `timeout_s`; empty if none or unplugged."""
        if not self.plugged:
            time.sleep(timeout_s)
            return b""
        if not select.select([self._master], [], [], timeout_s)[0]:
            return b""
        return self._as_heard(os.read(self._master, 4096))

    def write(self, data: bytes) -> None:
        """Send bytes; those beyond the buffer of an unread terminal are lost."""
        if not self.plugged:
            return
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, self._as_heard(data))

    def seconds(self, characters: int) -> float:
        """Time that characters take on the line, s."""
        # start, eight data bits, stop
        return 0.0 if self._baud is None else characters * 10 / self._baud

    def _as_heard(self, data: bytes) -> bytes:
        if self._baud is None:
            return data
        far_end = termios.tcgetattr(self._master)[5]
        return (
            data
            if far_end == getattr(termios, f"B{self._baud}")
            else bytes(byte ^ 0xA5 for byte in data)
        )


def serve(
    instrument: SerialInstrument,
    terminal: PseudoTerminal,
    *,
    folder: Path,
    faults: FaultFile,
    parent: int,
) -> None:
    """Answer on the terminal until the bench process `parent` has ended and the line has been idle
    for `ORPHAN_S`.
    """
    waiting: deque[tuple[float, bytes]] = deque()
    heard_s, before = time.monotonic(), Faults()
    while os.getppid() == parent or time.monotonic() - heard_s < ORPHAN_S:
        data = terminal.read(_patience(waiting))
        now_s, present_faults = time.monotonic(), faults.now()
        if not present_faults.disobedient:
            instrument.advance(now_s, present_faults)
        if (
            terminal.plugged == present_faults.unplugged
            or before.port_name != present_faults.port_name
        ):
            terminal.close()
            waiting.clear()
            if not present_faults.unplugged:
                terminal.plug(present_faults.port_name)
        if present_faults.power_cycles > before.power_cycles:
            instrument.power_cycle()
            waiting.clear()
        if present_faults.panel != before.panel:
            enter_at_panel(instrument, present_faults.panel)
        before = present_faults
        if data:
            heard_s = now_s
        if data and not present_faults.silent:
            free_s = max(now_s, waiting[-1][0] if waiting else 0.0)
            for making_s, answer in instrument.receive(data):
                free_s += making_s + terminal.seconds(len(answer))
                waiting.append((free_s + present_faults.late_s, present_faults.arrives(answer)))
        while waiting and waiting[0][0] <= time.monotonic():
            terminal.write(waiting.popleft()[1])
        if not present_faults.disobedient:
            instrument.publish(folder)


def enter_at_panel(instrument: SerialInstrument, commands: Iterable[str]) -> None:
    """Enter commands at an instrument's front panel; answers do not reach the line."""
    for command in commands:
        if isinstance(instrument, PrologixAdapter):
            instrument.instrument.listen(command.encode(), end=True)
        else:
            instrument.receive(command.encode() + b"\n")


def _patience(waiting: deque[tuple[float, bytes]]) -> float:
    if not waiting:
        return TICK_S
    return min(TICK_S, max(0.0, waiting[0][0] - time.monotonic()))
