"""A script of faults to rehearse a night with: which instrument suffers what, when and for how long."""

from dataclasses import dataclass
from typing import Literal

from labdata.errors import BadInput
from simulate.virtual_bench.faults import Faults

Place = Literal[
    "delay_generator",
    "high_voltage",
    "filter_wheel",
    "light_source",
    "light_meter",
    "thermometer",
    "camera",
    "surroundings",
]
Kind = Literal[
    "garbage",
    "half lines",
    "silence",
    "no answers",
    "late answers",
    "unplugged",
    "power cycle",
    "trip",
    "packet loss",
    "stalled camera",
    "clock jump",
    "front panel",
    "disobedience",
    "no triggers",
    "port renamed",
    "room light",
]

# Kinds that need a number, and what it counts; those that only some instruments can suffer.
_COUNTED = {"late answers": "s late", "packet loss": "share of packets", "clock jump": "s off", "room light": "lux"}
_OF_THE_CAMERA = ("packet loss", "stalled camera", "clock jump")
_OF = {
    "trip": ("high_voltage", "light_source"),
    "front panel": ("delay_generator", "high_voltage", "light_source"),
    "disobedience": ("delay_generator", "high_voltage", "light_source"),
    "no triggers": ("delay_generator",),
    "room light": ("surroundings",),
}


@dataclass(frozen=True, kw_only=True)
class ScriptedFault:
    """One fault.

    Parameters
    ----------
    instrument
        Whose.
    kind
        What is wrong with it.
    at_step
        Label of the step whose beginning starts the clock; None: the beginning of the run.
    at_s
        How long after that it strikes, s.
    for_s
        How long it lasts, s; a power cycle is over at once.
    value
        For late answers how late, s; for packet loss the share lost; for a clock jump how far, s; for room light the
        illuminance on the photocathode, lux.
    panel
        For the front panel: what is entered there, in the instrument's own language.
    """

    instrument: Place
    kind: Kind
    at_step: str | None = None
    at_s: float = 0.0
    for_s: float = 1.0
    value: float | None = None
    panel: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.at_s >= 0.0 or not self.for_s > 0.0:
            raise BadInput(f"a fault must strike at 0 s or later for some time, got {self.at_s:g} and {self.for_s:g} s")
        if (self.kind in _OF_THE_CAMERA) != (self.instrument == "camera"):
            raise BadInput(f"a camera must suffer one of {', '.join(_OF_THE_CAMERA)}, and no other, got {self.words}")
        if self.instrument not in _OF.get(self.kind, (self.instrument,)):
            raise BadInput(f"a fault of kind {self.kind!r} must be of {' or '.join(_OF[self.kind])}, got {self.words}")
        if self.instrument == "surroundings" and self.kind != "room light":
            raise BadInput(f"the surroundings must suffer room light, and nothing else, got {self.words}")
        if (self.kind == "front panel") != bool(self.panel):
            raise BadInput(f"panel must hold commands for a front panel, and for no other, got {self.panel}")
        if (self.kind in _COUNTED) != (self.value is not None):
            counted = ", ".join(_COUNTED)
            raise BadInput(f"value must be given for {counted}, and for no other, got {self.value} for {self.kind}")
        if self.kind == "packet loss" and not 0.0 < (self.value or 0.0) <= 1.0:
            raise BadInput(f"the share of packets lost must lie between 0 and 1, got {self.value}")

    @property
    def words(self) -> str:
        """What happens, for people."""
        much = "" if self.value is None else f" ({self.value:g} {_COUNTED[self.kind]})"
        return f"{self.kind} of {self.instrument}{much}"

    @property
    def faults(self) -> Faults:
        """The same as the virtual instruments know it; a power cycle is counted by whoever strikes."""
        value = self.value or 0.0
        known = {
            "garbage": Faults(garbage=True),
            "half lines": Faults(half_lines=True),
            "silence": Faults(silent=True),
            "no answers": Faults(mute=True),
            "late answers": Faults(late_s=value),
            "unplugged": Faults(unplugged=True),
            "power cycle": Faults(power_cycles=1),
            "trip": Faults(tripped=True),
            "packet loss": Faults(lost_packet_share=value),
            "stalled camera": Faults(stalled=True),
            "clock jump": Faults(clock_jump_s=value),
            "front panel": Faults(panel=self.panel),
            "disobedience": Faults(disobedient=True),
            "no triggers": Faults(untriggered=True),
            "port renamed": Faults(port_name=f"{self.instrument}.renamed"),
            "room light": Faults(room_light_lux=value),
        }
        return known[self.kind]


@dataclass(frozen=True, kw_only=True)
class FaultScript:
    """A file of faults.

    Parameters
    ----------
    fault
        The faults, in any order.
    """

    fault: tuple[ScriptedFault, ...]

    def __post_init__(self) -> None:
        if not self.fault:
            raise BadInput("a script of faults must hold at least one, got none")


def combine_faults(strikes: list[ScriptedFault], power_cycles: int) -> Faults:
    """Return what is wrong with one instrument while several faults hold.

    Parameters
    ----------
    strikes
        Those that hold now; of two that count something, the worse one.
    power_cycles
        How often it has lost its power so far.
    """
    names = vars(Faults())
    wrong = {name: max((getattr(each.faults, name) for each in strikes), default=names[name]) for name in names}
    return Faults(**{**wrong, "power_cycles": power_cycles})
