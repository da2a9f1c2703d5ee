"""Faults of the virtual instruments, injected through a file in the bench's folder."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from simulate.virtual_bench.outputs import faults_file, replace_file


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Faults of one instrument."""

    silent: bool = False  #: It hears nothing and says nothing
    mute: bool = False  #: It obeys, but none of its answers arrives
    late_s: float = 0.0  #: Extra time before each answer, s
    #: A short circuit of the load: a supply trips on current, a lamp goes out, as long as this
    #: holds
    tripped: bool = False
    garbage: bool = False  #: Every byte of its answers arrives changed
    half_lines: bool = False  #: Only the first half of each answer arrives
    unplugged: bool = False  #: Its port is gone as long as this holds; its outputs stay as they are
    #: How often it has lost its power for a moment; each rise is one more time
    power_cycles: int = 0
    stalled: bool = False  #: The camera answers, and sends no frame
    #: The camera sends its last pictures again and again under new numbers, as many in turn; 0: no
    repeated_pictures: int = 0
    ceiling_dn: int | None = None  #: Largest pixel value that the camera sends, DN; None: any
    lost_packet_share: float = 0.0  #: Fraction of the camera's packets that get lost, dimensionless
    clock_jump_s: float = 0.0  #: How far the camera's clock is off its time, s
    #: Commands entered at the front panel, in the instrument's own language: once, when they change
    panel: tuple[str, ...] = ()
    #: It answers as if it obeyed, and its outputs stay as they are; what it measures there is true
    disobedient: bool = False
    untriggered: bool = False  #: No pulses come to the delay generator's trigger input
    port_name: str = ""  #: Name under which its port stands now; empty: its own
    #: Of the surroundings: light that falls on the photocathode besides the source's, lux
    room_light_lux: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "panel", tuple(self.panel))  # JSON knows lists only

    def arrives(self, answer: bytes) -> bytes:
        """Return the bytes of an answer that arrive."""
        if self.mute:
            return b""
        if self.half_lines:
            answer = answer[: len(answer) // 2]
        return bytes(byte ^ 0x15 for byte in answer) if self.garbage else answer


def inject_faults(folder: Path, instrument: str, faults: Faults) -> None:
    """Set the faults of a place at the bench whose wires lie in a folder; `Faults()` removes
    them.
    """
    replace_file(faults_file(folder, instrument), json.dumps(asdict(faults)))


class FaultFile:
    """File with the faults of one instrument, read again after a change."""

    def __init__(self, folder: Path, instrument: str) -> None:
        self._path = faults_file(folder, instrument)
        self._stamp: tuple[int, int] | None = None
        self._faults = Faults()

    def now(self) -> Faults:
        """The faults at this moment."""
        try:
            status = self._path.stat()
        except FileNotFoundError:
            return self._faults
        stamp = (status.st_mtime_ns, status.st_ino)
        if stamp != self._stamp:
            self._stamp, self._faults = stamp, Faults(**json.loads(self._path.read_text()))
        return self._faults
