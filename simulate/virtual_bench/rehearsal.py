"""A rehearsal: a script of faults strikes a running virtual bench, each at its time, and never twice."""

import json
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from labdata.event_log import EventLog, read_events
from simulate.virtual_bench.fault_script import FaultScript, ScriptedFault, combine_faults
from simulate.virtual_bench.faults import Faults

TICK_S = 0.02
STRUCK = "fault strikes"


class Rehearsal:
    """Strikes as long as its `with` block lasts, in a thread of its own; on leaving all is healed.

    Parameters
    ----------
    script
        The faults.
    provoke
        Gives an instrument its faults, see `VirtualBench.provoke`.
    steps
        Log of the session, which tells which step begins.
    log
        File that remembers what struck: a resumed run goes on with the rest of the script.
    say
        Told in a sentence what strikes.

    Raises
    ------
    BadInput
        On entering, if the script strikes an instrument that `provoke` does not know.
    """

    def __init__(
        self,
        script: FaultScript,
        *,
        provoke: Callable[[str, Faults], None],
        steps: Path,
        log: Path,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._script, self._provoke, self._say = script, provoke, say
        self._steps, self._log_path = _Steps(steps), log
        self._power_cycles: Counter[str] = Counter()
        self._holding: dict[int, float] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._strike, daemon=True)

    def __enter__(self) -> Self:
        told = read_events(self._log_path) if self._log_path.exists() else []
        struck = {each["number"] for each in told if each["event"] == STRUCK}
        self._left = {number: one for number, one in enumerate(self._script.fault) if number not in struck}
        for instrument in {one.instrument for one in self._script.fault}:
            self._provoke(instrument, Faults())
        self._log = EventLog(self._log_path)
        self._began_s = time.monotonic()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        for number in list(self._holding):
            self._end(number)
        self._log.close()

    def _strike(self) -> None:
        while not self._over.wait(TICK_S):
            now_s = time.monotonic()
            self._steps.look(now_s)
            for number, one in list(self._left.items()):
                if (begins_s := self._begins_s(one)) is not None and now_s >= begins_s:
                    del self._left[number]
                    self._begin(number, one, now_s)
            for number, until_s in list(self._holding.items()):
                if now_s >= until_s:
                    self._end(number)

    def _begins_s(self, one: ScriptedFault) -> float | None:
        """When a fault strikes; None where its step has not begun."""
        since_s = self._began_s if one.at_step is None else self._steps.began_s.get(one.at_step)
        return None if since_s is None else since_s + one.at_s

    def _begin(self, number: int, one: ScriptedFault, now_s: float) -> None:
        self._log(STRUCK, number=number, instrument=one.instrument, kind=one.kind, for_s=one.for_s)
        self._say(f"Rehearsal: {one.words} for {one.for_s:g} s.")
        self._holding[number] = now_s + one.for_s
        self._power_cycles[one.instrument] += one.kind == "power cycle"
        self._tell(one.instrument)

    def _end(self, number: int) -> None:
        del self._holding[number]
        one = self._script.fault[number]
        # The latch of a trip is cleared by a person, who switches the instrument off and on.
        self._power_cycles[one.instrument] += one.kind == "trip"
        self._tell(one.instrument)
        self._log("fault ends", number=number)

    def _tell(self, instrument: str) -> None:
        holding = [one for number in self._holding if (one := self._script.fault[number]).instrument == instrument]
        self._provoke(instrument, combine_faults(holding, self._power_cycles[instrument]))


class _Steps:
    """Which steps of the running acquisition began, and when; what its log held before belongs to an earlier run."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._read = log.stat().st_size if log.exists() else 0
        self.began_s: dict[str, float] = {}

    def look(self, now_s: float) -> None:
        if not self._log.exists() or self._log.stat().st_size == self._read:
            return
        with self._log.open("rb") as file:
            file.seek(self._read)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._read += len(whole)
        for line in whole.splitlines():
            event = json.loads(line)
            if event["event"] == "step begins":
                self.began_s.setdefault(event["step"], now_s)
