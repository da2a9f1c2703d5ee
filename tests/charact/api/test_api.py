"""The functions of `charact` measure arrays as files; a setting is declared once for
function and verb.
"""

import ast
import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import charact
import drivers
import simulate
from charact.cli.application import app
from charact.cli.options import RUNNING, error_in_options, in_options
from labdata import FrameStack, measurement_from_sd
from labdata.settings import Setting, declaration_of, default_option, documented, parameters_of
from tests.charact.cli.runner import small_camera
from tests.truth import EdgeScene, TrueBlur

# The functions of `charact` measure arrays as files, and say in one sentence what is no image.


SCENE = EdgeScene(
    blur=TrueBlur(sigma_px=1.06),
    rows=80,
    cols=96,
    dark_dn=500.0,
    bright_dn=3500.0,
    snr=67.0,
    full_scale_dn=65535.0,
)


@pytest.fixture(scope="module")
def edge() -> np.ndarray:
    """One frame of the edge."""
    return SCENE.frames_drawn(np.random.default_rng(5)).data[0]


def test_an_array_a_stack_and_a_file_have_one_result(edge, tmp_path):
    np.save(tmp_path / "e.npy", edge)
    sources = (
        edge,
        edge[None],
        edge.tolist(),
        FrameStack(data=edge[None]),
        tmp_path / "e.npy",
        str(tmp_path / "e.npy"),
    )
    found = [charact.mtf(source, method="edge-slanted").mtf50 for source in sources]
    assert len({(m.value, m.interval95) for m in found}) == 1


def test_the_mtf_of_an_array_is_that_of_its_blur(edge):
    m = charact.mtf(edge, quick=True).mtf50
    assert m.status == "ok"
    assert m.interval95[0] < SCENE.truth_mtf50 < m.interval95[1]


@pytest.mark.parametrize(
    "bad",
    [
        None,
        3.0,
        [1, 2, 3],
        np.zeros(5),
        [[1, 2], [3]],
        object(),
        np.zeros((5, 5), complex),
        "no-such-file.tif",
        np.full((40, 40), np.nan),
        np.ma.masked_equal(np.eye(40), 1),
        np.array([["a"]]),
    ],
    ids=lambda bad: type(bad).__name__,
)
def test_what_is_no_image_is_bad_input(bad):
    with pytest.raises(charact.BadInput) as caught:
        charact.mtf(bad)
    assert "\n" not in str(caught.value)


def test_flats_in_memory_have_the_gain_they_were_made_with(seed):
    rng = np.random.default_rng(seed)
    flats = [
        2.0 * rng.poisson(level, (16, 64, 64)) + rng.normal(100, 3, (16, 64, 64))
        for level in (50, 200, 800)
    ]
    darks = [rng.normal(100, 3, (16, 64, 64))]
    found = charact.noise(
        flats=flats, darks=darks, method="variance", quick=True, exposure_s=[1, 4, 16]
    )
    gain = found.system_gain
    assert abs(gain.value - 2.0) < 2.5 * (gain.interval95[1] - gain.value) / 1.96 + 1e-3


def test_conditions_are_one_for_all_or_one_for_each_flat():
    flats = [np.zeros((2, 40, 40))] * 2
    with pytest.raises(charact.BadInput, match="one entry for each of 2 flats"):
        charact.noise(flats=flats, exposure_s=[1.0])
    with pytest.raises(TypeError, match="no parameter `exposure`: did you mean `exposure_s`"):
        charact.noise(flats=flats, exposure=1.0)
    with pytest.raises(charact.BadInput, match="got both"):
        charact.noise("somewhere", flats=flats)
    with pytest.raises(charact.BadInput, match="`bars` describes another target than kind 'edge'"):
        charact.mtf(flats[0], bars=4)


def test_pixels_beyond_the_digitiser_are_bad_input():
    with pytest.raises(charact.BadInput, match="255 DN of 8 bits"):
        charact.session([charact.stack(np.full((2, 9, 9), 300.0), "dark")], bit_depth=8)


def test_a_quantity_is_an_attribute_and_several_are_asked_for_by_their_place():
    one = measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, method="m", stack="a")
    other = measurement_from_sd("mtf50", "cy/px", 0.3, 0.01, method="m", stack="b")
    assert charact.Analysis(measurements=(one,)).mtf50 is one
    with pytest.raises(AttributeError, match=r"find\('mtf50', stack='a'\)"):
        charact.Analysis(measurements=(one, other)).mtf50  # noqa: B018
    with pytest.raises(AttributeError, match="was not measured"):
        charact.Analysis(measurements=(one,)).read_noise  # noqa: B018
    assert "mtf50" in dir(charact.Analysis(measurements=(one,)))


def test_a_result_is_shown_and_exported(edge, tmp_path):
    pytest.importorskip("pandas")
    xarray = pytest.importorskip("xarray")
    found = charact.mtf(edge)
    assert repr(found).startswith("<Analysis: mtf50 ") and "\n" not in repr(found)
    assert "<table" in found._repr_html_()
    found.plot(tmp_path / "mtf.png")
    assert (tmp_path / "mtf.png").stat().st_size > 5000
    assert found.to_frame().set_index("quantity").loc["mtf50", "value"] == found.mtf50.value
    assert float(found.to_xarray()["mtf"].sel(frequency=0.0)) == pytest.approx(1.0)
    draws = found.to_arviz("mtf50")
    assert isinstance(draws, xarray.DataTree) and draws["posterior"].sizes["chain"] == 1


def test_an_array_goes_through_a_camera_and_same_seed_gives_same_frames(edge, tmp_path):
    sensor = small_camera(tmp_path, 64, 96, "gen3-digital-iccd")
    made = [
        charact.simulate(edge, sensor=sensor, frames=2, photoelectrons_per_dn=0.01, seed=seed)
        for seed in (1, 1, 2)
    ]
    assert made[0].shape == (2, 64, 96)
    assert np.array_equal(made[0].data, made[1].data)
    assert not np.array_equal(made[0].data, made[2].data)


def test_every_name_is_in_dir_and_callable():
    for name in charact.__all__:
        assert name in dir(charact)
        assert callable(getattr(charact, name))


def test_results_of_unlike_sessions_are_refused():
    rng = np.random.default_rng(1)

    def day(exposure_s: float):
        stacks = [
            charact.stack(rng.normal(level, 9.0, (4, 64, 64)), kind, exposure_s=exposure_s)
            for kind, level in (("dark", 100.0), ("flat", 500.0))
        ]
        return charact.noise(charact.session(stacks), method="variance", quick=True)

    with pytest.raises(charact.BadInput, match="must be alike"):
        charact.compare(day(0.01), day(0.02))


def test_small_frames_of_a_plain_camera_have_their_gain_by_the_variance_of_pixels():
    rng = np.random.default_rng(0)

    def frames(electrons: float) -> np.ndarray:
        return np.round(
            0.5 * rng.poisson(electrons, (8, 48, 64)) + rng.normal(20.0, 1.5, (8, 48, 64))
        ).astype(np.uint16)

    found = charact.noise(
        flats=[frames(n) for n in (500, 2000, 6000)], darks=[frames(0)], quick=True
    )
    low, high = found.system_gain.interval95
    assert low < 0.5 < high
    assert found.system_gain.method == "variance"


# A setting is declared once: signature, docstring, option and help of every function agree.


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
# Settings whose meaning or default is that of one function: the fitted camera and its tolerances,
# the visible frame.
OF_ONE_FUNCTION = {
    ("validate", "--sensor"),
    ("validate", "--limits"),
    ("validate", "--quick"),
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
    "--open",
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
        key: (declaration_of(p.annotation), p.default) for key, p in parameters_of(function).items()
    }
    return {
        setting.option or default_option(key): (setting, default)
        for key, (setting, default) in declared.items()
        if isinstance(setting, Setting)
    }


@pytest.mark.parametrize("function", VERBS)
def test_every_setting_of_a_function_is_an_option_of_its_verb_and_the_reverse(function):
    settings, verbs = settings_of(function), [OPTIONS[words] for words in VERBS[function]]
    # The units of a report are a setting of its function.
    output = OUTPUT - settings.keys()
    assert settings.keys() == {option for options in verbs for option in options} - output
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
        for key, parameter in parameters_of(function).items()
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
