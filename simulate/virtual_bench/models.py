"""Virtual instruments by model name: built-in ones and those of other packages.

A package brings one with a Python entry point of the group `charact.virtual_instruments` whose value is a
`VirtualModel`; its name is the one of the driver's model in the group `charact.instruments`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from labdata.errors import BadInput
from labdata.instrument_config import models_by_name
from simulate.virtual_bench.delay_generator import DelayGenerator
from simulate.virtual_bench.dg535 import Dg535
from simulate.virtual_bench.filter_wheel import FilterWheel
from simulate.virtual_bench.high_voltage import HighVoltageSupply
from simulate.virtual_bench.instrument import SerialInstrument
from simulate.virtual_bench.iseg import IsegSupply
from simulate.virtual_bench.light_source import LightSource
from simulate.virtual_bench.meters import PowerMeter, Thermometer
from simulate.virtual_bench.prologix import PrologixAdapter

GROUP = "charact.virtual_instruments"
GATE, SUPPLY, WHEEL, LIGHT, METER, THERMOMETER = PLACES = (
    "delay_generator",
    "high_voltage",
    "filter_wheel",
    "light_source",
    "light_meter",
    "thermometer",
)


@dataclass(frozen=True, kw_only=True)
class VirtualModel:
    """One model of virtual instrument."""

    name: str  # Name of the model, such as "dg645"
    place: str  # Where it stands at the bench, one of `PLACES`: the name of its port and of its faults
    # Makes it, from its address on a bus and how much faster than life it moves
    make: Callable[[int, float], SerialInstrument]
    baud: int | None  # Rate set on it, baud; None: a USB adapter, which has none
    # Commands that do what a hand at its panel does, by setting: of a gate "source", "idle level", "width" and "busy"
    # (every second trigger is lost), of a supply "voltage" and "on"
    panel: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


SHIPPED = (
    VirtualModel(
        name="dg645",
        place=GATE,
        make=lambda address, scale: DelayGenerator(),
        baud=9600,
        panel={
            "source": ("TSRC 1",),
            "idle level": ("LOFF 1,2",),
            "width": ("DLAY 3,2,0.002",),
            "busy": ("DLAY 4,0,0.02",),
        },
    ),
    VirtualModel(
        name="dg535",
        place=GATE,
        make=lambda address, scale: PrologixAdapter({address: Dg535()}),
        baud=None,
        panel={"source": ("TM 4",), "idle level": ("OP 4,0",), "width": ("DT 3,2,0.002",), "busy": ("DT 5,1,0.02",)},
    ),
    VirtualModel(
        name="ps350",
        place=SUPPLY,
        make=lambda address, scale: PrologixAdapter({address: HighVoltageSupply(time_scale=scale)}),
        baud=None,
        panel={"voltage": ("VSET 350",), "on": ("VSET 100", "HVON")},
    ),
    VirtualModel(
        name="iseg",
        place=SUPPLY,
        make=lambda address, scale: IsegSupply(time_scale=scale),
        baud=9600,
        panel={"voltage": ("D1=350", "G1"), "on": ("D1=100", "G1")},
    ),
    VirtualModel(name="fw102c", place=WHEEL, make=lambda address, scale: FilterWheel(time_scale=scale), baud=115200),
    VirtualModel(name="dc2100", place=LIGHT, make=lambda address, scale: LightSource(), baud=115200),
    VirtualModel(name="pm101", place=METER, make=lambda address, scale: PowerMeter(), baud=115200),
    VirtualModel(name="ctc100", place=THERMOMETER, make=lambda address, scale: Thermometer(), baud=9600),
)


def virtual_models() -> dict[str, VirtualModel]:
    """Return all virtual models by name."""
    return models_by_name(SHIPPED, VirtualModel, GROUP)


def virtual_model(name: str) -> VirtualModel:
    """Return a virtual model by its name."""
    known = virtual_models()
    if name not in known:
        raise BadInput(f"a virtual instrument must be one of {', '.join(sorted(known))}, got {name!r}")
    return known[name]
