"""Options that several verbs share, each declared once."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from labdata.errors import BadInput

if TYPE_CHECKING:
    from labdata.session import Kind

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")]
Events = Annotated[bool, typer.Option("--events", help="Progress and messages as one JSON object a line on stderr.")]
Seed = Annotated[int, typer.Option(help="Seed of every random step; the same seed gives the same bytes.", min=0)]
Quick = Annotated[bool, typer.Option("--quick", help="No posterior: intervals from the curvature of the fit.")]
MethodName = Annotated[str, typer.Option("--method", help="auto, or a name that `charact methods` lists.")]
Within = Annotated[float, typer.Option("--within", help="Error that auto must meet, percent.", min=0.0)]
Roi = Annotated[str | None, typer.Option("--roi", help="Region ROW,COL,HEIGHT,WIDTH in px; else the target is found.")]
Plane = Annotated[
    str | None,
    typer.Option(
        help="r, g, b or luminance of a colour picture (else its luminance); r, g1, g2 or b of a mosaic; or a number "
        "from 0 along an axis that counts no frames."
    ),
]
Axis = Annotated[
    str | None, typer.Option(help="Axis that counts frames, its number from 0 or its name, if the file does not say.")
]
BlackDn = Annotated[
    float | None,
    typer.Option(help="Code at no light, DN, else the file's: tells sloping light from a halo, a gamma by noise."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="Address of a Dask scheduler whose workers read the stacks; they must see the same paths."),
]
SensorName = Annotated[str | None, typer.Option("--sensor", help="A shipped sensor's name, or a path to its TOML.")]
Units = Annotated[
    str,
    typer.Option(
        help="Frequency unit for people: cy/px, lp/mm (at the detector), lp/mm-cathode, tvl/ph or cy/mrad. "
        "JSON stays cy/px."
    ),
]
PitchUm = Annotated[
    float | None, typer.Option("--pitch-um", help="Pixel pitch for lp/mm and cy/mrad, um; else the sensor's.")
]
Demagnification = Annotated[
    float | None,
    typer.Option(help="Length at the cathode over length at the detector, for lp/mm-cathode; else the sensor's."),
]
FocalLengthMm = Annotated[
    float | None, typer.Option("--focal-length-mm", help="Focal length for cy/mrad, mm; else the sensor's.")
]
AtMost = Annotated[
    int, typer.Option("--at-most", help="Most targets of one frame that are measured, from all over it.", min=1)
]
Annotate = Annotated[Path | None, typer.Option(help="Write the image with the regions and their MTF50 drawn in, PNG.")]
BloomMap = Annotated[
    Path | None,
    typer.Option(
        "--map", help="Write which share of each pixel's signal is blooming: a picture (.png) or arrays (.npz)."
    ),
]
BloomMapOf = Annotated[
    str | None,
    typer.Option("--map-of", help="Stack that the map is of; else a scene, or the brightest point."),
]


def parse_kind(text: str) -> "Kind":
    """Return what a stack shows, as an --kind says; any other word is a BadInput."""
    from labdata.session import Kind

    for kind in get_args(Kind):
        if kind == text:
            return kind
    raise BadInput(f"--kind must be one of {', '.join(get_args(Kind))}, got {text!r}")


def parse_region(text: str | None) -> tuple[int, int, int, int] | None:
    """Return ROW, COL, HEIGHT, WIDTH of an --roi, or None; anything but four whole numbers is a BadInput."""
    if text is None:
        return None
    parts = text.split(",")
    try:
        row, col, height, width = (int(part) for part in parts)
    except ValueError:
        raise BadInput(f"--roi must be four whole numbers ROW,COL,HEIGHT,WIDTH, got {text!r}") from None
    return row, col, height, width
