"""Target in front of the camera."""

from dataclasses import dataclass
from typing import Literal, get_args

from labdata.errors import BadInput, check

Kind = Literal["dark", "flat", "edge", "bars", "point", "scene"]

# Fields of a single kind of target.
BELONGS_TO = {"bars": "bars", "frequency_cy_per_px": "bars", "pinhole_px": "point"}


def kind_of(text: str) -> Kind:
    """Return the kind of target of a text."""
    for kind in get_args(Kind):
        if kind == text:
            return kind
    raise BadInput(f"`kind` must be one of {', '.join(get_args(Kind))}, got {text!r}")


@dataclass(frozen=True, kw_only=True)
class Target:
    """Target in front of the camera; only the fields of the stack's kind are set."""

    bars: int | None = None  #: Number of bars of a bar target
    #: Frequency of the bars at the detector, cycles per column pitch
    frequency_cy_per_px: float | None = None
    #: Direction across the bars or along the edge's normal, degrees from the row direction: 0 is
    #: horizontal frequency : (vertical bars or edge), 90 is vertical frequency
    angle_deg: float | None = None
    pinhole_px: float | None = None  #: Diameter of the pinhole's image, column pitches
    #: (bright - dark) / (bright + dark) of bars or edge, dimensionless
    contrast: float | None = None
    #: ROW, COL, HEIGHT, WIDTH of the target in the frame, px
    region: tuple[int, int, int, int] | None = None

    def __post_init__(self) -> None:
        if self.bars is not None and self.bars < 2:
            raise BadInput(f"a bar target must have at least 2 bars, got {self.bars}")
        check(self, positive="frequency_cy_per_px", not_negative="pinhole_px")
        if self.contrast is not None and not 0 < self.contrast <= 1:
            raise BadInput(f"contrast must lie in (0, 1], got {self.contrast:g}")

    def superfluous_names(self, kind: str) -> tuple[str, ...]:
        """Return the names of fields that are set and do not belong to a target of this kind."""
        return tuple(
            name
            for name, of in BELONGS_TO.items()
            if of != kind and getattr(self, name) is not None
        )
