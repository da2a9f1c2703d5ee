"""Configuration of a bench, and the record of the last real one."""

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

from drivers.serial_lines.port import usb_ports
from labdata import BadInput, DoseLedger, Gating, LampCalibration, write_atomically
from labdata.instrument_config import InstrumentConfig, Meters, Role
from labdata.limits import LimitsInForce

FIELD_RATE_HZ = 60.0 / 1.001  # Field rate of 525-line video, Hz


@dataclass(frozen=True, kw_only=True)
class BenchSetup:
    """Configuration of one bench."""

    wires: InstrumentConfig  #: Models and serial ports of the instruments
    limits: LimitsInForce  #: Limits in force
    log: Path  #: File to which every safety step is appended as a JSON line
    #: Calibration of the light source named in the wires; None: a person sets the light
    lamp: LampCalibration | None = None
    meters: Meters = field(default_factory=Meters)  #: Use of the auxiliary meters
    field_hz: float = FIELD_RATE_HZ  #: Field rate of the camera, Hz; the gate opens once per field
    gating: Gating = field(default_factory=Gating)  #: Trigger of the gate
    dose: DoseLedger | None = None  #: Dose ledger of the tube; None: the dose is not recorded
    session: str = ""  #: Name of the session, written to the ledger

    def __post_init__(self) -> None:
        if (self.lamp is None) != (self.wires.light is None):
            raise BadInput(
                f"a light source must have its calibration, got {self.lamp} for {self.wires.light}"
            )


def remember_bench(wires: InstrumentConfig) -> None:
    """Save the wires of a bench with the USB serial numbers of its ports; OSError if the disk
    refuses.
    """
    adapters = usb_ports()
    numbers = {
        connection.role: adapters.get(os.path.realpath(connection.port))
        for connection in wires.instruments
        if connection.port
    }
    path = _path()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(
        path, json.dumps({"wires": asdict(wires), "usb_serial_numbers": numbers}, indent=1).encode()
    )


def last_bench() -> InstrumentConfig:
    """Return the wires of the last real bench, each instrument at the present port of its USB
    serial number.
    """
    path = _path()
    try:
        saved = json.loads(path.read_text())
        return with_present_ports(InstrumentConfig(**saved["wires"]))
    except FileNotFoundError:
        raise BadInput(
            "no real bench was used on this machine yet; name the plan whose bench is meant"
        ) from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise BadInput(
            f"the last bench must be readable in {path}, got: {error}; name the plan whose bench "
            "is meant"
        ) from None


def with_present_ports(wires: InstrumentConfig) -> InstrumentConfig:
    """Return the wires with missing ports replaced by the present ports of their USB serial
    numbers.
    """
    try:
        numbers = json.loads(_path().read_text())["usb_serial_numbers"]
    except (OSError, ValueError, TypeError, KeyError):
        return wires
    ports: dict[tuple[str, ...], str] = {adapter: path for path, adapter in usb_ports().items()}
    present_ports: dict[Role, str | None] = {
        connection.role: ports[adapter]
        for connection in wires.instruments
        if connection.port
        and not Path(connection.port).exists()
        and (adapter := tuple(numbers.get(connection.role) or ())) in ports
    }
    return wires.with_ports(present_ports)


def _path() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "charact" / "last-bench.json"
