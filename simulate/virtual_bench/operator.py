"""The hands of the virtual bench: which target and how much light stand before the virtual camera now."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target
from simulate.virtual_bench.outputs import replace_file

METER_RELATIVE_SD = 0.03  # calibration of a good illuminance meter
_FILE = "operator.json"


@dataclass(frozen=True, kw_only=True)
class TargetPlacement:
    """What stands before the camera.

    Parameters
    ----------
    number
        Counts placements since the bench was built; no two have the same.
    kind
        What the frames will show.
    target
        The target.
    illuminance_lux
        Light on the photocathode as the meter reads it, lux.
    """

    number: int = 0
    kind: Kind = "dark"
    target: Target = field(default_factory=Target)
    illuminance_lux: float = 0.0


class VirtualOperator:
    """Places targets and light by a file in the bench's folder, which the virtual camera reads.

    Parameters
    ----------
    folder
        Folder of the bench.
    """

    is_by_hand = False
    """Whether a person sets the light."""

    def __init__(self, folder: Path) -> None:
        self._folder = Path(folder)
        self.while_waiting: Callable[[], None] = lambda: None
        """Never called: nobody is waited for."""

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Put a target before the camera, set the light until the meter reads what is asked, and return its reading."""
        placement = TargetPlacement(
            number=read_placement(self._folder).number + 1, kind=kind, target=target, illuminance_lux=illuminance_lux
        )
        replace_file(self._folder / _FILE, json.dumps(asdict(placement)))
        return Conditions(
            illuminance_lux=illuminance_lux, illuminance_relative_sd=METER_RELATIVE_SD, filter_density=filter_density
        )

    def darken(self) -> None:
        """Block the light and leave the target where it is."""
        now = read_placement(self._folder)
        self.place(kind=now.kind, target=now.target, illuminance_lux=0.0)


def read_placement(folder: Path) -> TargetPlacement:
    """Read what stands before the camera; a bench that nobody touched is dark."""
    try:
        text = (Path(folder) / _FILE).read_text()
    except FileNotFoundError:
        return TargetPlacement()
    values = json.loads(text)
    region = values["target"].pop("region")
    target = Target(**values.pop("target"), region=tuple(region) if region else None)
    return TargetPlacement(**values, target=target)
