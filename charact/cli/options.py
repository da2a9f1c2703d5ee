"""Options of the verbs, made of the settings that functions declare."""

import inspect
import re
from collections.abc import Callable, Collection, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer
from typer.models import OptionInfo

from labdata.settings import Setting, declaration_of, default_option, parameters_of

if TYPE_CHECKING:
    from charact.reporting.frequency_unit import FrequencyUnit
    from labdata.camera.description import Camera

# Types of parameters that an option has as well; any other parameter takes a text.
PLAIN = {bool, int, float, str, Path, type(None)}
# Option of each parameter of the verbs, and the options of the verb that runs.
OPTIONS: dict[str, str] = {}
RUNNING: dict[str, str] = {}
Json = Annotated[bool, Setting("Print the result as one JSON object on stdout.", option="--json")]
Events = Annotated[bool, Setting("Write progress and messages as JSON lines on stderr.")]
Everything = Annotated[
    bool,
    Setting(
        "Print every value, flag and note (default: a summary of at most 40 lines).",
        option="--all",
    ),
]


def in_options(text: str) -> str:
    """Return a text with the options of the parameters that it names in backticks.

    Examples
    --------
    >>> OPTIONS["black_dn"] = "--black-dn"
    >>> in_options("`black_dn` below `mtf`")
    '--black-dn below `mtf`'
    """
    return re.sub(r"`(\w+)`", lambda name: OPTIONS.get(name[1], name[0]), text)


def error_in_options(sentence: str) -> str:
    """Return the sentence of an error with options of the verb that runs.

    A parameter that the sentence begins with, and one of several words, needs no backticks.
    """
    named = re.sub(
        r"^\w+(?= (?:must|needs|of|is) )|(?<![\w`])[a-z]+_\w+",
        lambda name: RUNNING.get(name[0], name[0]),
        sentence,
    )
    return in_options(named)


def of(function: Callable[..., Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of the settings that are parameters of a function."""
    return {
        name: settings[name] for name in inspect.signature(function).parameters if name in settings
    }


def verb(
    *functions: Callable[..., Any], without: Collection[str] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that makes options of the settings of a verb.

    These are the settings that the verb declares, and in place of its `**settings` those of the
    functions that it calls, but for those in `without`.
    """
    called = {
        name: parameter
        for function in functions
        for name, parameter in parameters_of(function).items()
        if isinstance(declaration_of(parameter.annotation), Setting) and name not in without
    }

    def enter(verb: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(verb).parameters
        parameters = [
            _as_option(parameter)
            for parameter in (own | called).values()
            if parameter.kind is not parameter.VAR_KEYWORD
        ]

        options = {p.name: name for p in parameters if (name := _name_of_option(p)) is not None}
        OPTIONS.update(options)

        @wraps(verb)
        def run(**arguments: Any) -> None:
            RUNNING.clear()
            RUNNING.update(options)
            verb(**arguments)

        run.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportAttributeAccessIssue]
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        del run.__wrapped__  # pyright: ignore[reportAttributeAccessIssue]
        return run

    return enter


def _as_option(parameter: inspect.Parameter) -> inspect.Parameter:
    """Return a parameter of a verb, as an option if it is a setting."""
    parameter = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
    setting = declaration_of(parameter.annotation)
    if not isinstance(setting, Setting):
        return parameter
    name, default = setting.option or default_option(parameter.name), parameter.default
    can_only_switch_off = name.startswith("--no-")
    option = typer.Option(
        f" /{name}" if can_only_switch_off else name,
        help=setting.help,
        min=setting.minimum,
        metavar=setting.metavar,
        show_default=not can_only_switch_off,
    )
    kind = _type_of_option(parameter.annotation)
    if setting.repeated:
        kind, default = list[str] | None, [default] if isinstance(default, str) else default
    return parameter.replace(annotation=Annotated[kind, option], default=default)


def _name_of_option(parameter: inspect.Parameter) -> str | None:
    """Return the name of the option of a parameter; None of an argument."""
    for option in get_args(parameter.annotation)[1:]:
        if isinstance(option, OptionInfo):
            # In an annotation the first name is where the default stands elsewhere.
            names = (option.default, *(option.param_decls or ()), default_option(parameter.name))
            return next(name.strip(" /") for name in map(str, names) if "--" in name)
    return None


def _type_of_option(annotation: Any) -> Any:
    """Return the type of the option of a parameter: its own, or a path or a text."""
    declared = get_args(annotation)[0]
    kinds = set(get_args(declared)) or {declared}
    if kinds > {str, Path}:
        return Path | None
    several = len(kinds - {type(None)}) > 1
    return declared if kinds <= PLAIN and not several else str | None


def frequency_unit(
    camera: "Camera | None",
    *,
    rows: int | None,
    sample_pitch_px: int = 1,
    units: Annotated[
        str,
        Setting(
            "Display unit of frequency: cy/px, lp/mm, lp/mm-cathode, tvl/ph, lw/ph, cy/in, "
            "cy/mrad or cy/arcmin. JSON is always cy/px."
        ),
    ] = "cy/px",
    pitch_um: Annotated[
        float | None,
        Setting("Pixel pitch for lp/mm and cy/mrad, µm (default: from the sensor)."),
    ] = None,
    demagnification: Annotated[
        float | None,
        Setting(
            "Photocathode-to-detector demagnification for lp/mm-cathode (default: from the sensor)."
        ),
    ] = None,
    focal_length_mm: Annotated[
        float | None, Setting("Focal length for cy/mrad, mm (default: from the sensor).")
    ] = None,
) -> "FrequencyUnit":
    """Return the display unit of frequency, with lengths of a camera description."""
    from charact.reporting.frequency_unit import FrequencyUnit

    return FrequencyUnit.of(
        camera,
        rows=rows,
        sample_pitch_px=sample_pitch_px,
        unit=units,
        pitch_um=pitch_um,
        demagnification=demagnification,
        focal_length_mm=focal_length_mm,
    )
