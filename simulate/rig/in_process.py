"""The virtual instruments inside this process, behind ports of bytes, where there are no pseudo-terminals."""

import threading
import time

from simulate.rig.delay_generator import DelayGenerator
from simulate.rig.faults import Faults
from simulate.rig.high_voltage import HighVoltageSupply
from simulate.rig.outputs import Outputs
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
            self._instrument.advance(time.monotonic(), self.faults)

    def close(self) -> None:
        """Nothing to let go of."""


class InProcessInstruments:
    """Delay generator and high-voltage supply in this process.

    Parameters
    ----------
    supply_address
        GPIB address of the supply behind its adapter.
    time_scale
        How much faster than life the supply's output moves, dimensionless.
    """

    def __init__(self, *, supply_address: int = 14, time_scale: float = 1.0) -> None:
        self._gate, self._supply = DelayGenerator(), HighVoltageSupply(time_scale=time_scale)
        self.gate_port = InProcessPort(self._gate)
        self.supply_port = InProcessPort(PrologixAdapter({supply_address: self._supply}))

    def outputs(self) -> Outputs:
        """What reaches the tube at this moment."""
        self.supply_port.advance()
        return Outputs(mcp_v=self._supply.output_v, **vars(self._gate.gate()))
