"""State files of the virtual bench: outputs of its instruments, and the target placed by its
operator.
"""

import json
import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from labdata import Conditions, Kind, Target

GATE_FILE, VOLTAGE_FILE, LAMP_FILE, WHEEL_FILE, THERMOMETER_FILE = (
    f"{name}.output.json"
    for name in ("gate", "high_voltage", "light_source", "filter_wheel", "thermometer")
)


Trigger = Literal["clock", "mains", "camera"]


@dataclass(frozen=True, kw_only=True)
class GateOutput:
    """What the delay generator's AB output does to the gate unit."""

    gate_open: bool = False  #: Whether the gate opens at all
    #: Width of one opening, ns; infinite where the output idles in the state that opens the gate
    gate_ns: float = 0.0
    gate_hz: float = 0.0  #: Openings per second, Hz
    #: What triggers them: the generator's own clock, the mains, or the camera's field pulse at its
    #: input
    gate_trigger: Trigger = "clock"
    gate_delay_ns: float = 0.0  #: From trigger to opening, ns


@dataclass(frozen=True, kw_only=True)
class Outputs(GateOutput):
    """Present inputs of the tube."""

    mcp_v: float  #: Voltage across the microchannel plate, V
    lamp_a: float | None = None  #: Current through the lamp of the bench, A; None: it has no lamp
    #: Position of the wheel before the lamp; None: it turns, or there is none
    filter_position: int | None = None
    has_wheel: bool = False  #: Whether there is a wheel before the lamp
    #: Temperature of the tube, degrees Celsius; None: nobody measures it
    temperature_c: float | None = None
    room_light_lux: float = 0.0  #: Light of the surroundings on the photocathode, lux

    def open_ns(self, exposure_s: float) -> float:
        """Time that the gate is open during one exposure of `exposure_s` seconds, ns, averaged over
        its phase.
        """
        if not self.gate_open:
            return 0.0
        exposure_ns = exposure_s * 1e9
        if math.isinf(self.gate_ns) or self.gate_ns * self.gate_hz >= 1e9:
            return exposure_ns
        return min(self.gate_ns * self.gate_hz * exposure_s, exposure_ns)


def publish(folder: Path, file: str, outputs: dict[str, Any]) -> None:
    """Publish the outputs of an instrument in its file."""
    replace_file(folder / file, json.dumps(outputs))


def read_outputs(folder: Path) -> Outputs:
    """Read the outputs of the instruments of a bench; an instrument without a file has no
    output.
    """
    gate = _read(Path(folder) / GATE_FILE) or {}
    voltage = _read(Path(folder) / VOLTAGE_FILE) or {"mcp_v": 0.0}
    warm = _read(Path(folder) / THERMOMETER_FILE)
    lamp, wheel = _read(Path(folder) / LAMP_FILE), _read(Path(folder) / WHEEL_FILE)
    return Outputs(
        **gate,
        **voltage,
        lamp_a=None if lamp is None else lamp["current_a"],
        filter_position=None if wheel is None else wheel["position"],
        has_wheel=wheel is not None,
        temperature_c=None if warm is None else warm["temperature_c"],
        room_light_lux=read_room_light_lux(folder),
    )


def read_room_light_lux(folder: Path) -> float:
    """Read the light of the surroundings, lux; 0 without a file."""
    surroundings = _read(faults_file(folder, "surroundings"))
    return 0.0 if surroundings is None else surroundings["room_light_lux"]


def faults_file(folder: Path, instrument: str) -> Path:
    """Return the file in which the faults of an instrument, or of the surroundings, are kept."""
    return Path(folder) / f"{instrument}.faults.json"


def replace_file(path: Path, text: str) -> None:
    """Replace a file atomically."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    unfinished.write_text(text)
    unfinished.replace(path)


def _read(path: Path) -> dict | None:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return None


METER_RELATIVE_SD = 0.03  # calibration of a good illuminance meter
_FILE = "operator.json"


@dataclass(frozen=True, kw_only=True)
class TargetPlacement:
    """Target and light before the camera."""

    number: int = 0  #: Counts placements since the bench was built; no two have the same
    kind: Kind = "dark"  #: What the frames will show
    target: Target = field(default_factory=Target)  #: The target
    illuminance_lux: float = 0.0  #: Light on the photocathode as the meter reads it, lux


class VirtualOperator:
    """Places targets and light by a file in the bench's folder, which the virtual camera reads."""

    is_by_hand = False  # Whether a person sets the light

    def __init__(self, folder: Path) -> None:
        self._folder = Path(folder)
        # Never called: the virtual operator acts at once
        self.while_waiting: Callable[[], None] = lambda: None

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Place a target, set the light to the requested meter reading, and return the reading."""
        placement = TargetPlacement(
            number=read_placement(self._folder).number + 1,
            kind=kind,
            target=target,
            illuminance_lux=illuminance_lux,
        )
        replace_file(self._folder / _FILE, json.dumps(asdict(placement)))
        return Conditions(
            illuminance_lux=illuminance_lux,
            illuminance_relative_sd=METER_RELATIVE_SD,
            filter_density=filter_density,
        )

    def darken(self) -> None:
        """Block the light and leave the target where it is."""
        now = read_placement(self._folder)
        self.place(kind=now.kind, target=now.target, illuminance_lux=0.0)


def read_placement(folder: Path) -> TargetPlacement:
    """Read the target and light before the camera; initially dark."""
    try:
        text = (Path(folder) / _FILE).read_text()
    except FileNotFoundError:
        return TargetPlacement()
    values = json.loads(text)
    region = values["target"].pop("region")
    target = Target(**values.pop("target"), region=tuple(region) if region else None)
    return TargetPlacement(**values, target=target)
