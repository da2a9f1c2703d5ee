"""Settings of public functions: each is declared once, as the type of a parameter.

A declaration holds what a parameter means. From the signature of a function `documented` writes the
parameters section of its docstring, and the command line makes its options and their help. A
sentence for a reader names a parameter in backticks: the command line shows its option instead.
"""

import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args

from labdata.errors import BadInput

if TYPE_CHECKING:
    from labdata.camera.description import Camera

F = TypeVar("F", bound=Callable[..., Any])
Progress = Callable[[str, float], None]
Region = tuple[int, int, int, int]
WIDTH = 88  # columns of a help sentence in a docstring


@dataclass(frozen=True)
class Argument:
    """Meaning of a parameter that no option can hold, such as frames and results."""

    help: str


@dataclass(frozen=True)
class Setting(Argument):
    """Meaning of a parameter that is an option of the command line.

    Parameters
    ----------
    help
        One sentence for the docstring and for the help of the option; it names the unit.
    option
        Name of the option; "": that of the parameter, with dashes.
    minimum
        Lowest value, of a number.
    metavar
        Form of the text that the option takes; None: by the type.
    repeated
        Whether the option may be given several times, of a list.
    """

    option: str = ""
    minimum: float | None = None
    metavar: str | None = None
    repeated: bool = False


def ignore_progress(sentence: str, share: float) -> None:
    """Discard a progress message."""


def declaration_of(annotation: Any) -> Argument | None:
    """Return the declaration in the type of a parameter; None if it has none."""
    return next((one for one in get_args(annotation)[1:] if isinstance(one, Argument)), None)


def default_option(name: str) -> str:
    """Return the option of a parameter whose declaration names none."""
    return f"--{name.replace('_', '-')}"


def documented(function: F) -> F:
    """Write the parameters section of a function's docstring from its signature, and return it.

    Raises
    ------
    TypeError
        If a parameter is not declared.
    """
    section = ["Parameters", "----------"]
    for name, parameter in inspect.signature(function).parameters.items():
        declared = declaration_of(parameter.annotation)
        if declared is None:
            raise TypeError(f"{function.__qualname__} must declare {name} as Argument or Setting")
        section += [name, textwrap.indent(textwrap.fill(declared.help, WIDTH), "    ")]
    text = inspect.cleandoc(function.__doc__ or "")
    following = re.search(r"^\w+\n-+$", text, re.MULTILINE)
    start = following.start() if following else len(text)
    parts = (text[:start].rstrip(), "\n".join(section), text[start:])
    function.__doc__ = "\n\n".join(part for part in parts if part)
    return function


def region_of(region: Region | str | None) -> Region | None:
    """Return a region of interest, that of a text ROW,COL,HEIGHT,WIDTH, or None.

    Examples
    --------
    >>> region_of("100,200,80,60")
    (100, 200, 80, 60)
    """
    if not isinstance(region, str):
        return region
    try:
        row, col, height, width = (int(part) for part in region.split(","))
    except ValueError:
        raise BadInput(
            f"`roi` must be four integers ROW,COL,HEIGHT,WIDTH, got {region!r}"
        ) from None
    return row, col, height, width


Seed = Annotated[int, Setting("Random seed; equal seeds give identical output.", minimum=0)]
ProgressSink = Annotated[
    Progress, Argument("Called with a sentence and the fraction done (0 to 1).")
]
Roi = Annotated[
    Region | str | None,
    Setting(
        "Region of interest: row, column, height and width, px (default: found).",
        metavar="ROW,COL,HEIGHT,WIDTH",
    ),
]
Plane = Annotated[
    str | None,
    Setting(
        "Colour plane: r, g, b or luminance (RGB), r, g1, g2 or b (raw; rggb:g1 states the "
        "mosaic); or an index from 0 along an axis that is not the frame axis. Default: luminance."
    ),
]
FrameAxis = Annotated[
    str | None,
    Setting("Frame axis, index from 0 or name, if the file does not state it."),
]
Extension = Annotated[
    str | None,
    Setting(
        "Picture to read of a file that holds several, name or number: image of FITS (0 is the "
        "primary one), series of TIFF, array of HDF5, section of SIF. Default: the first, of TIFF "
        "and HDF5 the largest."
    ),
]
Partial = Annotated[
    bool, Setting("Read the whole frames of a SIF, SPE or SER file that ends early.")
]
SceneCamera = Annotated[
    "str | Path | Camera",
    Setting(
        "Camera of visible light whose lens and pixels define the map: name of a shipped "
        "description, or path of a TOML file.",
        option="--sensor",
    ),
]
WithinMk = Annotated[
    float, Setting("Error budget for neglected terms at the scene's time, mK.", minimum=0.0)
]
OfType = Annotated[
    bool,
    Setting(
        "Leave out the maps of the specimen: fixed patterns are drawn from the parameters.",
        option="--type",
    ),
]
Resume = Annotated[bool, Setting("Resume an interrupted run; completed steps are kept.")]
CameraDescription = Annotated[
    "str | Path | Camera | None",
    Setting(
        "Camera description: name of a shipped one, or path of a TOML file (default: that of the "
        "session, otherwise unknown)."
    ),
]
