"""Settings of public functions: each is declared once, as the type of a parameter.

A declaration holds what a parameter means. From the signature of a function `documented` writes the
parameters section of its docstring and checks its arguments, and the command line makes its options
and their help. A sentence for a reader names a parameter in backticks: the command line shows its
option instead.
"""

import ast
import inspect
import math
import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import wraps
from numbers import Integral, Real
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ForwardRef,
    TypeVar,
    Unpack,
    cast,
    get_args,
    get_origin,
)

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
    """Return the declaration in the type of a parameter, or of `**settings` the docstring of their
    record; None if there is none.
    """
    if get_origin(annotation) is Unpack:
        return Argument(" ".join(get_args(annotation)[0].__doc__.split()))
    return next((one for one in get_args(annotation)[1:] if isinstance(one, Argument)), None)


def default_option(name: str) -> str:
    """Return the option of a parameter whose declaration names none."""
    return f"--{name.replace('_', '-')}"


def parameters_of(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Return the parameters of a function as they are declared.

    `inspect.signature` of a documented function has their types alone.
    """
    return inspect.signature(inspect.unwrap(function)).parameters


def documented(function: F) -> F:
    """Write the parameters section of a function's docstring from its signature, and return the
    function with its arguments checked.

    Each key of a record in `**conditions: Unpack[record]` is a parameter of the signature. A call
    with an unknown parameter or without a required one raises TypeError, an argument of another
    type or below its minimum BadInput.

    Raises
    ------
    TypeError
        If a parameter is not declared.
    """
    section, shown = ["Parameters", "----------"], list[inspect.Parameter]()
    minima: dict[str, float] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        declared = declaration_of(parameter.annotation)
        if declared is None:
            raise TypeError(f"{function.__qualname__} must declare {name} as Argument or Setting")
        section += [name, textwrap.indent(textwrap.fill(declared.help, WIDTH), "    ")]
        if isinstance(declared, Setting) and declared.minimum is not None:
            minima[name] = declared.minimum
        shown += _shown(parameter)
    text = inspect.cleandoc(function.__doc__ or "")
    following = re.search(r"^\w+\n-+$", text, re.MULTILINE)
    start = following.start() if following else len(text)
    parts = (text[:start].rstrip(), "\n".join(section), text[start:])
    returned = inspect.signature(function).return_annotation
    signature = inspect.Signature(shown, return_annotation=returned)

    @wraps(function)
    def checked(*arguments: Any, **settings: Any) -> Any:
        if unknown := [name for name in settings if name not in signature.parameters]:
            raise TypeError(_unknown_parameter(function.__name__, unknown[0], signature))
        try:
            bound = signature.bind(*arguments, **settings).arguments
        except TypeError as error:
            raise TypeError(
                f"{function.__name__}: {error} of {', '.join(signature.parameters)}"
            ) from None
        for name, value in bound.items():
            parameter = signature.parameters[name]
            several = parameter.kind is parameter.VAR_POSITIONAL
            for element in value if several else (value,):
                require_type(name, element, parameter.annotation, minima.get(name))
        return function(*arguments, **settings)

    checked.__doc__ = "\n\n".join(part for part in parts if part)
    checked.__signature__ = signature  # pyright: ignore[reportAttributeAccessIssue]
    return cast(F, checked)


def _shown(parameter: inspect.Parameter) -> list[inspect.Parameter]:
    """Return a parameter with its type alone, or each of the conditions that it stands for."""
    declared = get_args(parameter.annotation)[0]
    if parameter.kind is not parameter.VAR_KEYWORD:
        plain = declared.__forward_arg__ if isinstance(declared, ForwardRef) else declared
        return [parameter.replace(annotation=plain)]
    of_all = get_args(declared.__orig_bases__[0])
    types = {
        name: kind if isinstance(kind, type) else of_all[0]
        for name, kind in declared.__annotations__.items()
    }
    return [
        inspect.Parameter(name, parameter.KEYWORD_ONLY, default=None, annotation=kind | None)
        for name, kind in types.items()
    ]


def _unknown_parameter(function: str, name: str, signature: inspect.Signature) -> str:
    """Return the sentence on a parameter that a function does not take."""
    known = [p.name for p in signature.parameters.values() if p.kind is not p.VAR_POSITIONAL]
    if close := get_close_matches(name, known, n=1):
        return f"{function} takes no parameter `{name}`: did you mean `{close[0]}`?"
    return f"{function} takes no parameter `{name}`, only {', '.join(known)}"


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


def _is_list(value: Any) -> bool:
    ordered = hasattr(value, "__len__") and hasattr(value, "__getitem__")
    return ordered and not isinstance(value, str | Mapping)


#: Types of arguments by name: what an argument is, and whether a value is one
TYPES: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "None": ("None", lambda value: value is None),
    "bool": ("True or False", lambda value: type(value).__name__ in ("bool", "bool_")),
    "int": ("an integer", lambda value: isinstance(value, Integral)),
    "float": ("a finite number", _is_finite),
    "str": ("a text", lambda value: isinstance(value, str)),
    "Path": ("a path", lambda value: isinstance(value, Path)),
    "Kind": ("a text", lambda value: isinstance(value, str)),
    "Region": ("four integers", _is_list),
    "tuple": ("a sequence", _is_list),
    "Sequence": ("a sequence", _is_list),
    "Mapping": ("a mapping", lambda value: isinstance(value, Mapping)),
    "Iterable": ("a sequence", lambda value: _is_list(value) or hasattr(value, "__next__")),
    "Callable": ("a function", callable),
    "NDArray": ("an array", _is_list),
    "Any": ("any value", lambda value: True),
    "Frames": ("any value", lambda value: True),
}


#: Packages whose classes follow no protocol of ours
PLAIN = ("builtins", "numpy", "pathlib")


def require_type(name: str, value: Any, annotation: Any, minimum: float | None = None) -> None:
    """Raise BadInput if an argument is of none of the types of its parameter, or below a minimum.

    Classes are known by name, so that those of a type in quotes need not be imported.

    Examples
    --------
    >>> require_type("seed", 3, int)
    >>> require_type("seed", "a", "int | None")
    Traceback (most recent call last):
    labdata.errors.BadInput: `seed` must be an integer or None, got 'a'
    """
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    kinds = _kinds(ast.parse(text, mode="eval").body)
    above = f" from {minimum:g}" if minimum is not None else ""
    if any(_is_of_kind(value, *kind) for kind in kinds) and (
        minimum is None or value is None or value >= minimum
    ):
        return
    names = [TYPES[kind][0] if kind in TYPES else f"a {kind}" for kind, _ in kinds]
    names[0] += above
    expected = " or ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    shown = " ".join(repr(value).split())
    raise BadInput(f"`{name}` must be {expected}, got {textwrap.shorten(shown, 60)}")


def _kinds(annotation: ast.expr) -> list[tuple[str, ast.expr | None]]:
    """Return the names of the types of an annotation, and what their elements are."""
    match annotation:
        case ast.BinOp(left=first, right=second):
            return [*_kinds(first), *_kinds(second)]
        case ast.Subscript(value=container, slice=elements):
            return [(_kinds(container)[0][0], elements)]
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return [(name, None)]
    return [("None", None)]


def _is_of_kind(value: Any, kind: str, elements: ast.expr | None) -> bool:
    if kind not in TYPES:
        # A protocol may be followed by any class but the plain ones.
        known = any(base.__name__ == kind for base in type(value).__mro__)
        return known or type(value).__module__.partition(".")[0] not in PLAIN
    if not TYPES[kind][1](value):
        return False
    if kind not in ("Sequence", "Iterable") or elements is None or not _is_list(value):
        return True
    kinds = _kinds(elements)
    return all(any(_is_of_kind(element, *kind) for kind in kinds) for element in value)


def region_of(region: Region | str | None) -> Region | None:
    """Return a region of interest, that of a text ROW,COL,HEIGHT,WIDTH, or None.

    Examples
    --------
    >>> region_of("100,200,80,60")
    (100, 200, 80, 60)
    """
    if region is None:
        return None
    try:
        row, col, height, width = map(int, region.split(",") if isinstance(region, str) else region)
    except (ValueError, TypeError):
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
    str | int | None,
    Setting(
        "Colour plane: r, g, b or luminance (RGB), r, g1, g2 or b (raw; rggb:g1 states the "
        "mosaic); or an index from 0 along an axis that is not the frame axis. Default: luminance."
    ),
]
FrameAxis = Annotated[
    str | int | None,
    Setting("Frame axis, index from 0 or name, if the file does not state it."),
]
Extension = Annotated[
    str | int | None,
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
