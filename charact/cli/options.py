"""Options shared by several verbs."""

import inspect
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from labdata.errors import BadInput

if TYPE_CHECKING:
    from labdata.session import Kind

Json = Annotated[
    bool, typer.Option("--json", help="Print the result as one JSON object on stdout.")
]
Events = Annotated[
    bool, typer.Option("--events", help="Write progress and messages as JSON lines on stderr.")
]
Seed = Annotated[int, typer.Option(help="Random seed; equal seeds give identical output.", min=0)]
Quick = Annotated[
    bool,
    typer.Option(
        "--quick", help="Skip posterior sampling; intervals are from the Laplace approximation."
    ),
]
MethodName = Annotated[
    str, typer.Option("--method", help="Method name, or auto (see `charact methods`).")
]
Within = Annotated[
    float, typer.Option("--within", help="Error tolerance for auto, percent.", min=0.0)
]
Roi = Annotated[
    str | None,
    typer.Option("--roi", help="Region of interest ROW,COL,HEIGHT,WIDTH, px (default: found)."),
]
Plane = Annotated[
    str | None,
    typer.Option(
        help="Colour plane: r, g, b or luminance (RGB), r, g1, g2 or b (raw; rggb:g1 states the "
        "mosaic); or an index from 0 along an axis that is not the frame axis. Default: luminance."
    ),
]
Axis = Annotated[
    str | None,
    typer.Option(help="Frame axis, index from 0 or name, if the file does not state it."),
]
BlackDn = Annotated[
    float | None,
    typer.Option(
        help="Black level, DN (default: from the file). Separates non-uniform illumination from "
        "halo; for bars, also detects gamma from the noise."
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="Address of a Dask scheduler; its workers must see the same file paths."),
]
SensorName = Annotated[
    str | None,
    typer.Option("--sensor", help="Name of a shipped sensor description, or path to a TOML file."),
]
Units = Annotated[
    str,
    typer.Option(
        help="Display unit of frequency: cy/px, lp/mm, lp/mm-cathode, tvl/ph, lw/ph, cy/in, "
        "cy/mrad or cy/arcmin. JSON is always cy/px."
    ),
]
PitchUm = Annotated[
    float | None,
    typer.Option(
        "--pitch-um", help="Pixel pitch for lp/mm and cy/mrad, µm (default: from the sensor)."
    ),
]
Demagnification = Annotated[
    float | None,
    typer.Option(
        help=(
            "Photocathode-to-detector demagnification for lp/mm-cathode (default: from the sensor)."
        )
    ),
]
FocalLengthMm = Annotated[
    float | None,
    typer.Option(
        "--focal-length-mm", help="Focal length for cy/mrad, mm (default: from the sensor)."
    ),
]
MaxTargets = Annotated[
    int,
    typer.Option(
        "--max-targets",
        help="Maximum number of targets measured per frame, spread over the field.",
        min=1,
    ),
]
Annotate = Annotated[
    Path | None, typer.Option(help="Write a PNG of the frame with measured regions and MTF50.")
]
Everything = Annotated[
    bool,
    typer.Option(
        "--all", help="Print every value, flag and note (default: a summary of at most 40 lines)."
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option("--plot", help="Write the MTF curves as a figure: .png, .svg or .pdf."),
]
Csv = Annotated[
    Path | None, typer.Option("--csv", help="Write every value with its 95 % interval as CSV.")
]
BloomMap = Annotated[
    Path | None,
    typer.Option(
        "--map",
        help=(
            "Write the bloom map (fraction of each pixel's signal that is blooming): .png or .npz."
        ),
    ),
]
BloomMapOf = Annotated[
    str | None,
    typer.Option(
        "--map-of",
        help="Stack to map (default: a scene stack, otherwise the brightest point stack).",
    ),
]


# Annotation and default of the options of `mtf` and of the analyses of sessions.
SHARED: dict[str, tuple[Any, Any]] = {
    "roi": (Roi, None),
    "method": (MethodName, "auto"),
    "within": (Within, 2.0),
    "quick": (Quick, False),
    "seed": (Seed, 0),
    "plane": (Plane, None),
    "axis": (Axis, None),
    "black_dn": (BlackDn, None),
    "sensor": (SensorName, None),
    "units": (Units, "cy/px"),
    "pitch_um": (PitchUm, None),
    "demagnification": (Demagnification, None),
    "focal_length_mm": (FocalLengthMm, None),
    "max_targets": (MaxTargets, 24),
    "annotate": (Annotate, None),
    "plot": (Plot, None),
    "csv": (Csv, None),
    "everything": (Everything, False),
    "as_json": (Json, False),
    "events": (Events, False),
    "scheduler": (Scheduler, None),
    "map_to": (BloomMap, None),
    "map_of": (BloomMapOf, None),
}
# Options of `mtf edge` and `mtf bars`.
OF_A_TARGET = tuple(name for name in SHARED if name not in ("scheduler", "map_to", "map_of"))


def with_options(
    *names: str, table: Mapping[str, tuple[Any, Any]] = SHARED
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that replaces the `**settings` of a verb by named options of a table."""
    shared = {name: table[name] for name in names}

    def enter(verb: Callable[..., None]) -> Callable[..., None]:
        @wraps(verb)
        def run(**arguments: Any) -> None:
            verb(**arguments)

        own = [
            p
            for p in inspect.signature(verb).parameters.values()
            if p.kind is not p.VAR_KEYWORD and p.name not in shared
        ]
        kind = inspect.Parameter.KEYWORD_ONLY
        every = [p.replace(kind=kind) for p in own]
        every += [
            inspect.Parameter(n, kind, default=d, annotation=a) for n, (a, d) in shared.items()
        ]
        run.__signature__ = inspect.Signature(every)  # pyright: ignore[reportAttributeAccessIssue]
        run.__annotations__ = {p.name: p.annotation for p in every}
        del run.__wrapped__  # pyright: ignore[reportAttributeAccessIssue]
        return run

    return enter


def parse_kind(text: str) -> "Kind":
    """Return the stack kind of a --kind, or raise BadInput."""
    from labdata.session import Kind

    for kind in get_args(Kind):
        if kind == text:
            return kind
    raise BadInput(f"--kind must be one of {', '.join(get_args(Kind))}, got {text!r}")


def parse_region(text: str | None) -> tuple[int, int, int, int] | None:
    """Return ROW, COL, HEIGHT, WIDTH of an --roi, or None; raise BadInput unless it is four
    integers.
    """
    if text is None:
        return None
    parts = text.split(",")
    try:
        row, col, height, width = (int(part) for part in parts)
    except ValueError:
        raise BadInput(f"--roi must be four integers ROW,COL,HEIGHT,WIDTH, got {text!r}") from None
    return row, col, height, width
