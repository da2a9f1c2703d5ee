"""The virtual instruments inside this process, behind ports of bytes, where there are no pseudo-terminals."""

import threading
import time
from typing import Any

from simulate.rig.faults import Faults
from simulate.rig.models import virtual_model
from simulate.rig.outputs import GateOutput, Outputs
from simulate.rig.prologix import PrologixAdapter
from simulate.rig.pseudo_terminal import Instrument


class InProcessPort:
    """A port whose far end is an instrument in this process; it answers at once.

    Parameters
    ----------
    instrument
        The instrument.
    """

    def __init__(self, instrument: Instrument) -> None:
        self._instrument, self._answers = instrument, b""
        self._turn = threading.RLock()
        self._power_cycles = 0
        self.faults = Faults()
        """What is wrong with the instrument; replace it to provoke a fault."""

    def send(self, data: bytes) -> None:
        """Send bytes."""
        with self._turn:
            self.advance()
            answers = [] if self.faults.silent else self._instrument.receive(data)
            self._answers += b"".join(self.faults.arrives(answer) for _, answer in answers)

    def receive(self, timeout_s: float) -> bytes:
        """Bytes that came; where none did, the wait takes its time."""
        with self._turn:
            answers, self._answers = self._answers, b""
        if not answers:
            time.sleep(timeout_s)
        return answers

    def advance(self) -> None:
        """Let the instrument's physics catch up with the clock."""
        with self._turn:
            if self.faults.power_cycles > self._power_cycles:
                self._instrument.power_cycle()
            self._power_cycles = self.faults.power_cycles
            self._instrument.advance(time.monotonic(), self.faults)

    def volts(self) -> float:
        """Voltage that a supply at the far end puts out now, V."""
        self.advance()
        return _behind_adapter(self._instrument).output_v

    def gate(self) -> GateOutput:
        """What a gate generator at the far end does to the gate unit now."""
        return _behind_adapter(self._instrument).gate()

    def close(self) -> None:
        """Nothing to let go of."""


class InProcessInstruments:
    """Gate and high-voltage supply in this process.

    Parameters
    ----------
    gate, supply
        Models of the two.
    gate_address, supply_address
        GPIB addresses of those behind an adapter.
    time_scale
        How much faster than life the supply's output moves, dimensionless.
    """

    def __init__(
        self,
        *,
        gate: str = "dg645",
        supply: str = "ps350",
        gate_address: int = 15,
        supply_address: int = 14,
        time_scale: float = 1.0,
    ) -> None:
        self.gate_port = InProcessPort(virtual_model(gate).make(gate_address, time_scale))
        self.supply_port = InProcessPort(virtual_model(supply).make(supply_address, time_scale))

    def outputs(self) -> Outputs:
        """What reaches the tube at this moment."""
        return Outputs(mcp_v=self.supply_port.volts(), **vars(self.gate_port.gate()))


def _behind_adapter(instrument: Any) -> Any:
    """The instrument itself, where it stands behind an adapter."""
    return instrument.only if isinstance(instrument, PrologixAdapter) else instrument
