"""The last real bench of this machine, kept so that its tube can be made safe without a plan, at whatever port."""

import json
import os
from dataclasses import asdict
from pathlib import Path

from drivers.serial_lines.port import usb_ports
from labdata.atomic_write import write_atomically
from labdata.errors import BadInput
from labdata.instrument_config import InstrumentConfig, Role


def remember_bench(wires: InstrumentConfig) -> None:
    """Keep the wires of a bench with the USB serial numbers of its ports; raises OSError where the disk refuses."""
    adapters = usb_ports()
    numbers = {one.role: adapters.get(os.path.realpath(one.port)) for one in wires.instruments if one.port}
    path = _path()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps({"wires": asdict(wires), "usb_serial_numbers": numbers}, indent=1).encode())


def last_bench() -> InstrumentConfig:
    """Return the wires of the last real bench, each instrument at the port where its USB serial number is now."""
    path = _path()
    try:
        kept = json.loads(path.read_text())
        return with_present_ports(InstrumentConfig(**kept["wires"]))
    except FileNotFoundError:
        raise BadInput("no real bench was used on this machine yet; name the plan whose bench is meant") from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise BadInput(
            f"the last bench must be readable in {path}, got: {error}; name the plan whose bench is meant"
        ) from None


def with_present_ports(wires: InstrumentConfig) -> InstrumentConfig:
    """Return the same bench with instruments whose port is missing at the ports where they were found last time."""
    try:
        numbers = json.loads(_path().read_text())["usb_serial_numbers"]
    except (OSError, ValueError, TypeError, KeyError):
        return wires
    ports: dict[tuple[str, ...], str] = {adapter: path for path, adapter in usb_ports().items()}
    moved: dict[Role, str | None] = {
        one.role: ports[adapter]
        for one in wires.instruments
        if one.port and not Path(one.port).exists() and (adapter := tuple(numbers.get(one.role) or ())) in ports
    }
    return wires.with_ports(moved)


def _path() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "charact" / "last-bench.json"
