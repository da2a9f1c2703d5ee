"""What a bench is made of: instruments, limits, calibrations and files; and the way to it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labdata.dose_ledger import DoseLedger
from labdata.errors import BadInput
from labdata.gating import Gating
from labdata.instrument_config import PORT_KEYS, InstrumentConfig, Role
from labdata.lamp_calibration import LampCalibration
from labdata.limits import Limits, LimitsInForce, limits_in_force
from labdata.meters import Meters

if TYPE_CHECKING:
    from drivers.bench.client import BenchClient
    from drivers.bench.local_bench import LocalBench
    from drivers.serial_lines.line import InstrumentLine

FIELD_RATE_HZ = 60.0 / 1.001
"""Fields per second of 525-line video, Hz: the gate opens once in each."""


@dataclass(frozen=True, kw_only=True)
class BenchSetup:
    """One bench.

    Parameters
    ----------
    wires
        Models and serial ports of the instruments.
    limits
        Limits in force.
    log
        File to which every safety step is appended as a line of JSON.
    lamp
        Calibration of the light source that the wires name; None: there is none, and a person sets the light.
    meters
        How the auxiliary meters are read.
    field_hz
        Fields of the camera per second, Hz: the gate opens once in each.
    gating
        What triggers the gate.
    dose
        Ledger of the tube; None: the dose is not recorded.
    session
        Name of the session, for readers of the ledger.
    """

    wires: InstrumentConfig
    limits: LimitsInForce
    log: Path
    lamp: LampCalibration | None = None
    meters: Meters = field(default_factory=Meters)
    field_hz: float = FIELD_RATE_HZ
    gating: Gating = field(default_factory=Gating)
    dose: DoseLedger | None = None
    session: str = ""

    def __post_init__(self) -> None:
        if (self.lamp is None) != (self.wires.light is None):
            raise BadInput(f"a light source must have its calibration, got {self.lamp} for {self.wires.light}")


def open_bench(
    wires: InstrumentConfig,
    limits: Limits | LimitsInForce,
    *,
    log: str | Path,
    lines: "Mapping[Role, InstrumentLine] | None" = None,
    **details: Any,
) -> "BenchClient | LocalBench":
    """Return a bench, to be used in a `with` block.

    Entering shuts the gate and switches the high voltage off before anything else; so does leaving, by an exception
    too. A bench on serial ports lives in a server process of its own, which makes the tube safe when this process
    ends or hangs; this process does the same when the server ends or hangs.

    Parameters
    ----------
    wires, log, details
        See `BenchSetup`; details are its other fields.
    limits
        What may never be exceeded. A plan's bare limits are completed by those of a tube that nobody described.
    lines
        Lines to the instruments by role, ready-made, where there are no serial ports; the bench then lives in this
        process, and no other process makes the tube safe.

    Raises
    ------
    BadInput
        If an instrument has no port, or a light source has no calibration.
    """
    if lines is None and (without := [PORT_KEYS[one.role] for one in wires.instruments if not one.port]):
        raise BadInput(f"every instrument must have its serial port, got none for {' and '.join(without)}")
    in_force = limits if isinstance(limits, LimitsInForce) else limits_in_force(limits)
    setup = BenchSetup(wires=wires, limits=in_force, log=Path(log).absolute(), **details)
    if lines is None:
        from drivers.bench.client import BenchClient

        return BenchClient(setup)
    from drivers.bench.local_bench import LocalBench

    return LocalBench(setup, lines)
