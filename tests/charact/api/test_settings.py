"""A setting is declared once: signature, docstring, option and help of every function agree."""

import ast
import inspect
import re
from pathlib import Path
from typing import Any

import pytest
import typer

import charact
import drivers
import simulate
from charact.cli.application import app
from charact.cli.options import RUNNING, error_in_options, in_options
from labdata.settings import Setting, declaration_of, default_option, documented

VERBS = {
    charact.mtf: ("mtf edge", "mtf bars", "mtf point", "mtf flats"),
    charact.fuse: ("fuse pictures",),
    charact.fusion_scores: ("fuse score",),
    simulate.temperatures: ("temperatures",),
    drivers.acquire: ("acquire",),
} | {
    getattr(charact, name): (name,)
    for name in ("noise", "bloom", "measure", "fit", "validate", "report", "compare", "check")
}
FUNCTIONS = (
    *VERBS,
    charact.simulate,
    charact.session,
    charact.stack,
    charact.frames_of,
    charact.fusion_colours,
    drivers.plan_report,
)
# Settings whose meaning or default is that of one function: the fitted camera, the visible frame.
OF_ONE_FUNCTION = {
    ("validate", "--sensor"),
    ("temperatures", "--sensor"),
    ("fuse", "--method"),
    ("fuse", "--black-dn"),
    ("fuse", "--within"),
}
# Options of what a verb prints and writes; the function returns it instead.
OUTPUT = {
    "--all",
    "--annotate",
    "--csv",
    "--demagnification",
    "--events",
    "--explain",
    "--focal-length-mm",
    "--force",
    "--help",
    "--inject-faults",
    "--json",
    "--map",
    "--map-of",
    "--pitch-um",
    "--plot",
    "--sensor-out",
    "--units",
}


def commands(group: Any, words: str = "") -> dict[str, Any]:
    """Return the options of the verbs of a group by their words."""
    verbs: dict[str, Any] = {}
    for name, command in group.commands.items():
        options = {
            (p.opts + p.secondary_opts)[0]: p
            for p in command.params
            if p.param_type_name == "option"
        }
        inner = hasattr(command, "commands")
        verbs |= commands(command, f"{words}{name} ") if inner else {words + name: options}
    return verbs


OPTIONS = commands(typer.main.get_command(app))


def settings_of(function: Any) -> dict[str, tuple[Setting, Any]]:
    """Return declaration and default of each setting of a function, by its option."""
    declared = {
        key: (declaration_of(p.annotation), p.default)
        for key, p in inspect.signature(function).parameters.items()
    }
    return {
        setting.option or default_option(key): (setting, default)
        for key, (setting, default) in declared.items()
        if isinstance(setting, Setting)
    }


@pytest.mark.parametrize("function", VERBS)
def test_every_setting_of_a_function_is_an_option_of_its_verb_and_the_reverse(function):
    settings, verbs = settings_of(function), [OPTIONS[words] for words in VERBS[function]]
    assert settings.keys() == {option for options in verbs for option in options} - OUTPUT
    for options in verbs:
        for key in options.keys() & settings.keys():
            (setting, default), option = settings[key], options[key]
            assert (option.help, option.min) == (setting.help, setting.minimum)
            assert option.required == (default is inspect.Parameter.empty)
            assert option.required or option.default in (default, [default])


@pytest.mark.parametrize("function", FUNCTIONS)
def test_the_parameters_of_a_docstring_are_those_of_the_signature(function):
    section = re.search(r"\nParameters\n-+\n(.*?)(?:\n\n|\Z)", function.__doc__, re.DOTALL)
    entries = re.findall(r"^(\w+)\n((?:    .+\n?)+)", section[1], re.MULTILINE)
    assert [(key, " ".join(text.split())) for key, text in entries] == [
        (key, declaration_of(parameter.annotation).help)
        for key, parameter in inspect.signature(function).parameters.items()
    ]


def test_a_setting_has_one_default_and_one_declaration_in_all_functions():
    held: dict[str, tuple[Setting, Any]] = {}
    for function in FUNCTIONS:
        for option, setting in settings_of(function).items():
            if (function.__name__, option) not in OF_ONE_FUNCTION:
                assert held.setdefault(option, setting) == setting, (function, option)


def test_a_parameter_has_one_option_in_all_verbs():
    names = {(p.name, option) for options in OPTIONS.values() for option, p in options.items()}
    assert len(names) == len({name for name, _ in names})


def test_a_function_must_declare_its_parameters():
    with pytest.raises(TypeError, match="must declare function as"):
        documented(settings_of)


def test_messages_of_packages_name_parameters_and_the_command_line_shows_options():
    assert in_options("`within_percent` 2 %, a larger `roi`") == "--within 2 %, a larger --roi"
    assert in_options("`frequency_cy_per_px`, `mtf`") == "--frequency, `mtf`"
    RUNNING.clear()
    RUNNING.update({"plane": "--plane", "black_dn": "--black-dn"})
    assert error_in_options("plane must be r of plane, no black_dn or pitch_um; axis must") == (
        "--plane must be r of plane, no --black-dn or pitch_um; axis must"
    )
    assert error_in_options("plane surfaces are flat") == "plane surfaces are flat"


def test_no_message_of_a_package_names_an_option():
    root = Path(charact.__file__).parent
    assert not [
        f"{path.relative_to(root)}:{node.lineno}"
        for path in root.rglob("*.py")
        if path.relative_to(root).parts[0] not in ("api", "cli", "fusion")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant)
        and re.search(r"(?<![\w-])--[a-z]", str(node.value))
        and "pip install" not in str(node.value)
    ]
