"""Instruments of a bench: models, ports and addresses, and the use of the auxiliary meters."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules
from typing import Any, Literal, TypeVar

from labdata.errors import BadInput, check

Role = Literal[
    "gate", "supply", "light-source", "filter-wheel", "light-meter", "thermometer"
]  # Role of an instrument


@dataclass(frozen=True, kw_only=True)
class InstrumentConnection:
    """One serial instrument of the bench and its connection."""

    role: Role  #: Role of the instrument
    model: str  #: Name of its model
    port: str | None  #: Serial port of the instrument or of its adapter; None: not known
    address: int = 0  #: GPIB address behind an adapter


@dataclass(frozen=True, kw_only=True)
class InstrumentConfig:
    """Models and connections of the instruments."""

    #: "virtual": the processes of the virtual bench on pseudo-terminals. "in-process": its camera
    #: and lines inside this process, where Aravis is not available. "real": the ports below. On a
    #: virtual bench an instrument whose port is named, or a named camera, is a real one among
    #: virtual ones
    bench: Literal["virtual", "in-process", "real"] = "virtual"
    #: Model of the gate generator; other packages can provide further models
    gate: str = "dg645"
    #: Model of the high-voltage supply; other packages can provide further models
    supply: str = "ps350"
    gate_port: str | None = None  #: Serial port of the gate generator, or of its adapter
    supply_port: str | None = None  #: Serial port of the supply, or of its adapter
    gate_address: int = 15  #: GPIB address of the gate generator behind an adapter
    supply_address: int = 14  #: GPIB address of the supply behind an adapter
    #: Model of the light source; None: there is none, and the operator sets the light
    light: str | None = None
    light_port: str | None = None  #: Serial port of the light source
    wheel: str | None = None  #: Model of the filter wheel; None: there is none
    wheel_port: str | None = None  #: Serial port of the filter wheel
    light_meter: str | None = None  #: Model of the light meter; None: there is none
    light_meter_port: str | None = None  #: Serial port of the light meter
    thermometer: str | None = None  #: Model of the thermometer; None: there is none
    thermometer_port: str | None = None  #: Serial port of the thermometer
    #: Aravis identifier or IP address; "v4l2:/dev/video0" (with "#1": input 1 of a capture card);
    #: "replay:FOLDER" or "replay:FOLDER#LABEL": a recorded session or one of its stacks. None:
    #: the only camera there is, or the virtual bench's own
    camera: str | None = None

    def __post_init__(self) -> None:
        if self.wheel is not None and self.light is None:
            raise BadInput(
                f"a filter wheel must stand before a light source, got the wheel {self.wheel!r} "
                "alone"
            )

    @property
    def instruments(self) -> tuple[InstrumentConnection, ...]:
        """Serial instruments of the bench; gate and supply are always present."""
        return tuple(
            InstrumentConnection(
                role=role,
                model=model,
                port=getattr(self, PORT_KEYS[role]),
                address=getattr(self, f"{key}_address", 0),
            )
            for role, key in KEYS.items()
            if (model := getattr(self, key))
        )

    def with_ports(self, ports: Mapping[Role, str | None]) -> "InstrumentConfig":
        """Return the same wires with instruments at other ports, by their role."""
        return replace(self, **{PORT_KEYS[role]: port for role, port in ports.items()})


# Keys of models and ports, by role
KEYS: dict[Role, str] = {
    "gate": "gate",
    "supply": "supply",
    "light-source": "light",
    "filter-wheel": "wheel",
    "light-meter": "light_meter",
    "thermometer": "thermometer",
}
PORT_KEYS: dict[Role, str] = {role: f"{key}_port" for role, key in KEYS.items()}


@dataclass(frozen=True, kw_only=True)
class Meters:
    """Use of the auxiliary meters."""

    #: Illuminance on the photocathode per watt on the head of the light meter, lux/W; None: not
    #: calibrated, only watts are recorded
    lux_per_w: float | None = None
    wavelength_nm: float = 550.0  #: Wavelength of the light meter's sensitivity correction, nm
    #: Whether a run ends if the meter does not answer; otherwise this is reported and noted with
    #: the stack
    light_needed: bool = False
    temperature_needed: bool = False  #: Whether a run ends if the thermometer does not answer

    def __post_init__(self) -> None:
        check(self, positive="lux_per_w wavelength_nm")


T = TypeVar("T")


def models_by_name(package: str, kind: type[T], group: str) -> dict[str, T]:
    """Return the models of a kind by name: those in the modules of a package, and those that entry
    points bring.

    An entry point that does not load, is of another kind or name, or has a name in use is BadInput.
    """
    modules = (
        import_module(f"{package}.{one.name}")
        for one in iter_modules(import_module(package).__path__)
    )
    found = (
        value for module in modules for value in vars(module).values() if isinstance(value, kind)
    )
    known: dict[str, T] = {_name_of(model): model for model in found}
    for point in entry_points(group=group):
        try:
            model: Any = point.load()
        except Exception as error:
            raise BadInput(
                f"the instrument {point.name!r} of {point.value} must load, got: {error}"
            ) from error
        if not isinstance(model, kind) or _name_of(model) != point.name:
            raise BadInput(
                f"the entry point {point.name!r} must be a {kind.__name__} of that name, got "
                f"{model!r}"
            )
        if point.name in known:
            raise BadInput(
                f"the instrument {point.name!r} of {point.value} must have a new name, got a "
                f"taken one"
            )
        known[point.name] = model
    return known


def _name_of(model: Any) -> str:
    return model.name
