"""A driver and its virtual instrument over a pseudo-terminal, for conformance tests."""

import contextlib
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.instruments.models import InstrumentModel, models
from drivers.serial_lines.line import InstrumentLine
from labdata.errors import BadInput
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.models import virtual_model
from simulate.virtual_bench.process import VirtualInstruments

ADDRESS = 14
_FAULTS = {
    "silent": Faults(silent=True),
    "mute": Faults(mute=True),
    "garbage": Faults(garbage=True),
    "half-lines": Faults(half_lines=True),
    "late": Faults(late_s=0.6),
    "unplugged": Faults(unplugged=True),
    "trip": Faults(tripped=True),
    "power-cycle": Faults(),
    "panel": Faults(),
}


class VirtualPair:
    """Driver and virtual instrument of a model, running within a `with` block.

    Parameters
    ----------
    name
        Name of the model.
    folder
        Folder for the virtual instrument.
    """

    def __init__(self, name: str, folder: Path) -> None:
        known = models()
        if name not in known:
            raise BadInput(f"a model must be one of {', '.join(sorted(known))}, got {name!r}")
        self.model: InstrumentModel = known[name]
        self._virtual, self._folder = virtual_model(name), Path(folder)
        self._instruments = VirtualInstruments(
            self._folder, models=(name,), gate_address=ADDRESS, supply_address=ADDRESS, time_scale=20.0
        )
        self._line: InstrumentLine | None = None
        self._power_cycles, self._tripped = 0, False

    def __enter__(self) -> Self:
        self._instruments.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()
        self._instruments.stop()

    def driver(self) -> Any:
        """Reopen the line and return a driver on it."""
        self._close()
        self._line = self.model.open_line(self._instruments.port(self._virtual.place), ADDRESS)
        return self.model.driver(self._line)

    def outputs(self) -> Mapping[str, Any]:
        """Return the present outputs of the instrument."""
        found: dict[str, Any] = {}
        for path in self._folder.glob("*.output.json"):
            found |= json.loads(path.read_text())
        return found

    def suffer(self, wrong: str, setting: str = "") -> None:
        """Start one fault and end all others; "panel" changes a setting at the instrument's front panel."""
        self._power_cycles += wrong == "power-cycle"
        self._tripped = wrong == "trip"
        if wrong == "panel":
            self._now(Faults(panel=self._virtual.panel[setting]))
        self._now(_FAULTS[wrong])

    def heal(self) -> None:
        """End all faults; a trip is cleared by a power cycle."""
        self._power_cycles += self._tripped
        self._now(Faults())
        self._tripped = False

    def _now(self, faults: Faults) -> None:
        inject_faults(self._folder, self._virtual.place, replace(faults, power_cycles=self._power_cycles))
        # Time until a virtual instrument reads its fault file, s.
        time.sleep(0.06)

    def _close(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            with contextlib.suppress(OSError):
                line.close()
