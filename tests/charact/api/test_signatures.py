"""Each public function shows its parameters, and answers a wrong argument in one sentence."""

import doctest
import inspect
import pydoc
import subprocess
import sys
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import charact
import drivers
import simulate
from labdata import Camera, Conditions, FrameStack, load_camera, make_refusal, measurement_from_sd
from labdata.conditions import ConditionSettings
from labdata.measurement import Curve, Posterior, Result

FUNCTIONS = {
    name: getattr(charact, name)
    for name in charact.__all__
    if inspect.isfunction(getattr(charact, name))
} | {"temperatures": simulate.temperatures, "plan_report": drivers.plan_report}
# What the required parameters take besides any value.
VALID = {"kind": "flat", "stacks": (), "lux": 1.0}
PARAMETERS = [
    (function, parameter)
    for function, call in FUNCTIONS.items()
    for parameter in inspect.signature(call).parameters.values()
]


def required(function: str) -> dict[str, Any]:
    """Return arguments of the right type for the parameters without a default."""
    return {
        name: VALID.get(name, "nowhere")
        for name, parameter in inspect.signature(FUNCTIONS[function]).parameters.items()
        if parameter.default is parameter.empty and parameter.kind is not parameter.VAR_POSITIONAL
    }


@pytest.mark.parametrize("function", FUNCTIONS)
def test_signature_and_help_name_every_parameter(function):
    parameters = inspect.signature(FUNCTIONS[function]).parameters
    written = pydoc.render_doc(FUNCTIONS[function], renderer=pydoc.plaintext)
    assert all(p.kind is not p.VAR_KEYWORD for p in parameters.values())
    assert "Annotated" not in written and "Setting(" not in written
    assert all(name in written.partition("Parameters")[0] for name in parameters)
    assert f"def {function}(" in inspect.getsource(FUNCTIONS[function])


def short(case):
    """Return the id of a function or a parameter: equal in every process, unlike a default's."""
    return getattr(case, "name", case)


@pytest.mark.parametrize(("function", "parameter"), PARAMETERS, ids=short)
def test_a_mistyped_parameter_is_answered_with_the_right_one(function, parameter):
    if len(parameter.name) < 4 or parameter.kind is parameter.VAR_POSITIONAL:
        pytest.skip("its name has no typing error that is closer to it than to another one")
    mistyped = parameter.name[:2] + parameter.name[3:]
    with pytest.raises(TypeError) as caught:
        FUNCTIONS[function](**required(function), **{mistyped: None})
    assert str(caught.value) == (
        f"{function} takes no parameter `{mistyped}`: did you mean `{parameter.name}`?"
    )


@pytest.mark.parametrize(("function", "parameter"), PARAMETERS, ids=short)
def test_an_argument_of_another_type_is_bad_input_with_its_parameter(function, parameter):
    if "Any" in str(parameter.annotation).split(".") or "Frames" in str(parameter.annotation):
        pytest.skip("frames are arrays of any library")
    with pytest.raises(charact.BadInput) as caught:
        FUNCTIONS[function](**(required(function) | {parameter.name: 3j}))
    sentence = str(caught.value)
    assert sentence.startswith(f"`{parameter.name}` must be ") and sentence.endswith(", got 3j")
    assert "\n" not in sentence and len(sentence) < 250


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"roi": (1, 2, 3)}, "`roi` must be four integers ROW,COL,HEIGHT,WIDTH, got (1, 2, 3)"),
        ({"roi": (1, 2, 3, "a")}, "`roi` must be four integers"),
        ({"seed": "a"}, "`seed` must be an integer from 0, got 'a'"),
        ({"seed": -1}, "`seed` must be an integer from 0, got -1"),
        ({"seed": 1.5}, "`seed` must be an integer from 0, got 1.5"),
        ({"within_percent": np.nan}, "`within_percent` must be a finite number from 0, got nan"),
        ({"quick": "yes"}, "`quick` must be True or False, got 'yes'"),
        ({"frames": np.full((40, 40), 1e300)}, "every pixel must be finite and below 9.0e+15"),
        ({"frames": np.full((40, 40), "a")}, "an image must be an array of numbers"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_an_argument_that_breaks_a_rule_is_bad_input_with_rule_and_value(arguments, sentence):
    with pytest.raises(charact.BadInput) as caught:
        charact.mtf(**({"frames": np.eye(40)} | arguments))
    assert str(caught.value).startswith(sentence) and "\n" not in str(caught.value)


def test_numbers_of_numpy_are_numbers():
    frames = np.random.default_rng(1).poisson(100.0, (4, 48, 48))
    found = charact.noise(
        flats=[frames, 2 * frames],
        darks=[frames - 90],
        seed=np.int64(3),
        quick=np.True_,
        within_percent=np.float32(2.0),
        exposure_s=np.array([1.0, 2.0]),
    )
    assert found.session.stacks[1].conditions.exposure_s == 2.0


def test_conditions_as_parameters_are_the_fields_of_conditions():
    assert set(ConditionSettings.__annotations__) == {item.name for item in fields(Conditions)}
    kinds = inspect.signature(charact.stack).parameters
    for item in fields(Conditions):
        assert kinds[item.name].annotation == item.type


def test_one_of_several_flats_that_is_no_stack_is_bad_input():
    with pytest.raises(charact.BadInput, match=r"`stacks` must be a sequence, got \[3\]"):
        charact.session([3])
    with pytest.raises(charact.BadInput, match="`kind` must be one of dark, flat, edge"):
        charact.stack(np.zeros((2, 9, 9)), "flatt")
    assert charact.session(iter([charact.stack(np.zeros((2, 9, 9)), "dark")])).name == "arrays"


# A representation is one line that says what a thing is.


MEASURED = measurement_from_sd("mtf50", "cy/px", 0.2205, 0.000216, method="edge-slanted")
SHOWN = {
    "mtf50 = 0.22050 ± 0.00042 cy/px, ok": MEASURED,
    "mtf50 = 0.22050 ± 0.00042 cy/px, suspect: clipped": MEASURED.with_(flags=("clipped",)),
    "mtf at 0.25 cy/px = 0.5000 ± 0.0196, ok": measurement_from_sd(
        "mtf", "1", 0.5, 0.01, method="bars", frequency_cy_per_px=0.25
    ),
    "mtf50 refused: no edge": make_refusal("mtf50", "cy/px", "no edge", method="edge-slanted"),
    "FrameStack(data=uint8 (2, 9, 9), full_scale_dn=255)": FrameStack(
        data=np.zeros((2, 9, 9), np.uint8), full_scale_dn=255.0
    ),
    "Curve(frequency_cy_per_px=float64 (500,), value=float64 (500,))": Curve(
        frequency_cy_per_px=np.arange(500.0), value=np.arange(500.0)
    ),
    "Posterior(names=('K',), units=('DN',), draws=float64 (900, 1))": Posterior(
        names=("K",), units=("DN",), draws=np.zeros((900, 1))
    ),
    "Result(measurements=<90>)": Result(measurements=(MEASURED,) * 90),
}


@pytest.mark.parametrize("text", SHOWN)
def test_a_representation_says_what_a_thing_is_on_one_line(text):
    assert repr(SHOWN[text]) == text


def test_representations_of_results_and_descriptions_are_short():
    rng = np.random.default_rng(1)
    frames = rng.poisson(100.0, (4, 48, 48))
    found = charact.noise(flats=[frames, 2 * frames], darks=[frames - 90], quick=True)
    fused = charact.fuse(frames[0], frames[1], method="weighted", registered=True)
    shown = (
        *found.measurements,
        *(m.provenance for m in found.measurements),
        found,
        found.session,
        *found.session.stacks,
        charact.compare(found, found),
        charact.check(found, [{"quantity": "system_gain", "min": 0.0}]),
        fused,
        *fused.pictures.values(),
        *(load_camera(name) for name in ("gen3-digital-iccd", "machine-vision", "vox-lwir-640")),
    )
    assert all("\n" not in repr(thing) and 3 < len(repr(thing)) < 240 for thing in shown)
    assert any(isinstance(thing, Camera) for thing in shown)


def test_photon_transfer_is_the_plot_of_a_noise_result_and_others_are_named(tmp_path):
    rng = np.random.default_rng(1)
    flats = [2.0 * rng.poisson(level, (8, 64, 64)) + 100.0 for level in (100, 400, 900)]
    darks = [100.0 + rng.normal(0, 3, (8, 64, 64))]
    found = charact.noise(flats=flats, darks=darks, method="variance", quick=True)
    (axes,) = found.plot(tmp_path / "ptc.png").axes
    assert (tmp_path / "ptc.png").stat().st_size > 5000
    (points,) = (line for line in axes.lines if len(line.get_xdata()) == len(flats))
    slope = np.polyfit(points.get_xdata(), points.get_ydata(), 1)[0]
    assert slope == pytest.approx(found.system_gain.value, rel=0.05)
    with pytest.raises(charact.BadInput, match="`kind` must be one of photon-transfer, "):
        found.plot(kind="halo")
    with pytest.raises(charact.BadInput, match=r"in \.png, \.svg, \.pdf, got 'ptc\.gif'"):
        found.plot(tmp_path / "ptc.gif")


@pytest.mark.parametrize("module", ["analysis", "deciding", "fusing", "inputs", "measuring"])
def test_the_examples_of_docstrings_are_right(module):
    assert doctest.testmod(import_module(f"charact.api.{module}")).failed == 0


SCRIPT = """
import numpy as np

import charact

frame = np.zeros((40, 40))
charact.mtf(frame, method="auto", roi=(0, 0, 40, 40))
charact.noise(flats=[frame], exposure_s=[1.0])
charact.stack(frame, "flat", exposure_s=1.0)
charact.simulate(frame, sensor="machine-vision", gain=3.0)
"""
MISTYPED = {"metod=": "method=", "exposures=": "exposure_s=", "gainn=": "gain="}


def test_a_type_checker_finds_a_mistyped_parameter_of_a_script(tmp_path):
    checker = Path(sys.executable).with_name("basedpyright")
    if not checker.is_file():
        pytest.skip("basedpyright is not installed")
    wrong = SCRIPT
    for mistyped, parameter in MISTYPED.items():
        wrong = wrong.replace(parameter, mistyped)
    for name, text in {"right.py": SCRIPT, "wrong.py": wrong}.items():
        (tmp_path / name).write_text(text)
    done = subprocess.run(
        [checker, "--level", "error", tmp_path], capture_output=True, text=True, timeout=60
    )
    errors = [line for line in done.stdout.splitlines() if "error:" in line]
    assert len(errors) == 4 and all("wrong.py" in line for line in errors), done.stdout
    for name in MISTYPED:
        assert any(f'No parameter named "{name[:-1]}"' in line for line in errors)
