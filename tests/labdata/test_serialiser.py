"""The border: what goes out comes back the same, and what should not come in is refused in one
sentence.
"""

import tomllib
from dataclasses import fields
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labdata import (
    BadInput,
    Conditions,
    InstrumentConfig,
    Limits,
    LostFrames,
    Plan,
    SessionFile,
    Step,
    Target,
    file_schema,
    from_mapping,
    plan_of,
    plan_toml,
    read_plan,
    stack_record,
    to_toml,
)

# The machine may be busy: how long an example takes is no law of the border.
unhurried = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])

numbers = st.floats(min_value=0, max_value=1e12, allow_nan=False)
signed = st.floats(min_value=-1e6, max_value=1e6)
texts = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1, max_size=12
)
kinds = st.sampled_from(["dark", "flat", "edge", "bars", "point", "scene"])
ranges_of_conditions = {
    "camera_gain_db": st.floats(-200.0, 200.0),
    "temperature_c": st.floats(-200.0, 150.0),
    "automatic_gain": st.booleans(),
    "brightness_control": st.booleans(),
    "em_gain": st.floats(1.0, 1e4),
    "blackbody_c": st.floats(-200.0, 3000.0),
    "background_c": st.floats(-200.0, 3000.0),
}
conditions = st.builds(
    Conditions,
    **{
        item.name: st.none() | ranges_of_conditions.get(item.name, numbers)
        for item in fields(Conditions)
    },
)
targets = st.builds(
    Target,
    bars=st.none() | st.integers(2, 20),
    frequency_cy_per_px=st.none() | st.floats(1e-6, 1.0),
    angle_deg=st.none() | signed,
    pinhole_px=st.none() | numbers,
    contrast=st.none() | st.floats(1e-6, 1.0),
    region=st.none() | st.tuples(*[st.integers(0, 10000)] * 4),
)
stacks = st.builds(
    stack_record,
    conditions,
    label=texts,
    kind=kinds,
    frames=texts | st.lists(texts, min_size=1, max_size=3).map(tuple),
    asked=st.none() | conditions.filter(lambda c: c != Conditions()),
    target=targets,
    finished=st.none() | st.booleans(),
    lost_frames=st.none() | st.integers(0, 99),
    lost=st.lists(
        st.builds(
            LostFrames, first=st.integers(0, 9), last=st.integers(9, 99), reason=texts.filter(bool)
        ),
        max_size=2,
    ).map(tuple),
    notes=st.lists(texts, max_size=2).map(tuple),
)
sessions = st.builds(
    SessionFile,
    name=texts,
    sensor=st.none() | texts,
    bit_depth=st.none() | st.integers(1, 16),
    interlaced=st.none() | st.booleans(),
    notes=st.lists(texts, max_size=2).map(tuple),
    stack=st.lists(stacks, max_size=3).map(tuple),
)
steps = st.builds(
    Step,
    label=texts,
    kind=kinds,
    frames=st.integers(1, 1000),
    conditions=conditions,
    target=targets,
)
plans = st.builds(
    Plan,
    name=texts,
    sensor=st.none() | texts,
    seed=st.integers(0, 2**63 - 1),
    scene=st.none() | texts,
    wires=st.builds(
        InstrumentConfig,
        bench=st.sampled_from(["virtual", "in-process", "real"]),
        gate_port=st.none() | texts,
    ),
    limits=st.just(Limits(**{item.name: 1e13 for item in fields(Limits)})),
    steps=st.lists(steps, min_size=1, max_size=3, unique_by=lambda step: step.label).map(tuple),
)


@unhurried
@given(sessions)
def test_a_session_file_written_and_read_is_the_same(form):
    assert from_mapping(tomllib.loads(to_toml(form)), SessionFile) == form


@unhurried
@given(plans)
def test_a_plan_file_written_and_read_is_the_same(plan):
    assert plan_of(tomllib.loads(plan_toml(plan))) == plan


def test_numbers_of_numpy_are_written_as_numbers():
    form = stack_record(
        Conditions(mcp_v=np.float64(0.1)),
        label="a",
        kind="dark",
        frames="a.tif",
        lost_frames=np.int64(3),
    )
    written = to_toml(SessionFile(name="s", bit_depth=np.int32(8), stack=(form,)))
    assert tomllib.loads(written)["stack"][0]["mcp_v"] == 0.1
    assert tomllib.loads(written)["bit_depth"] == 8


def test_a_number_that_could_not_be_read_back_is_not_written():
    with pytest.raises(BadInput, match="finite numbers only, got nan"):
        to_toml(Target(angle_deg=float("nan")))


# A stack's keys beside its label, and what is said of them; {} is the place.
WRONG_STACKS = [
    ({"mcp_volt": 780.0}, "unknown key 'mcp_volt' in {}; did you mean 'mcp_v'?"),
    ({"target": {"bar": 4}}, "unknown key 'bar' in target of {}; did you mean 'bars'?"),
    ({"asked": {"xyzzy": 4}}, "unknown key 'xyzzy' in asked of {}"),
    ({"frames": None}, "missing key 'frames' in {}"),
    (
        {"kind": "flap"},
        (
            "kind must be one of 'dark', 'flat', 'edge', 'bars', 'point' or 'scene', got "
            '"flap", in '
            "{}"
        ),
    ),
    ({"mcp_v": "780"}, 'mcp_v must be a number, got "780", in {}'),
    ({"mcp_v": True}, "mcp_v must be a number, got true, in {}"),
    ({"mcp_v": float("nan")}, "mcp_v must be a finite number, got NaN, in {}"),
    ({"mcp_v": -780.0}, "mcp_v must not be negative, got -780, in {}"),
    ({"frames": 7}, "frames must be a text or a list, got 7, in {}"),
    (
        {"target": {"region": [1, 2, 3]}},
        "region must be a list of 4, got [1, 2, 3], in target of {}",
    ),
    (
        {"target": {"region": [1, 2, 3, 4, 5]}},
        "region must be a list of 4, got [1, 2, 3, 4, 5], in target of {}",
    ),
    (
        {"target": {"region": [1, 2, 3, "4"]}},
        'every item of region must be a whole number, got "4", in target of {}',
    ),
]


@pytest.mark.parametrize(("stack", "sentence"), WRONG_STACKS)
def test_what_is_wrong_in_a_stack_is_one_sentence_with_key_and_place(stack, sentence):
    second = {"label": "flat-03", "kind": "flat", "frames": "f.tif", **stack}
    second = {key: value for key, value in second.items() if value is not None}
    mapping = {"name": "s", "stack": [{"label": "a", "kind": "dark", "frames": "a.tif"}, second]}
    with pytest.raises(BadInput) as error:
        from_mapping(mapping, SessionFile, where="session.toml")
    assert str(error.value) == sentence.format('stack 2 ("flat-03") of session.toml')


@pytest.mark.parametrize(
    ("mapping", "sentence"),
    [
        ({"nom": "s"}, "missing key 'name' in session.toml"),
        ({"name": "s", "stack": 3}, "stack must be a list, got 3, in session.toml"),
        (
            {"name": "s", "stack": [3]},
            "every item of stack must be a table, got 3, in session.toml",
        ),
    ],
)
def test_what_is_wrong_in_a_file_is_one_sentence(mapping, sentence):
    with pytest.raises(BadInput) as error:
        from_mapping(mapping, SessionFile, where="session.toml")
    assert str(error.value) == sentence


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (b"name = ", "must be a TOML file"),
        (b"\xff\xfe\x00", "must be a TOML file"),
        (
            b"name = 1979-05-27\nstep = [{label = 'a', kind = 'dark', frames = 1}]",
            "name must be a text, got",
        ),
    ],
)
def test_a_file_that_is_no_toml_is_refused(tmp_path, content, rule):
    (tmp_path / "p.toml").write_bytes(content)
    with pytest.raises(BadInput, match=rule) as error:
        read_plan(tmp_path / "p.toml")
    assert "\n" not in str(error.value)


def test_a_plan_beyond_its_limits_is_refused_with_its_place():
    mapping = {"name": "p", "step": [{"label": "a", "kind": "flat", "frames": 2, "mcp_v": 950.0}]}
    with pytest.raises(
        BadInput, match=r"mcp_v of step 'a' must not exceed the limit 900, got 950, in p\.toml"
    ):
        plan_of(mapping, where="p.toml")


def keeps(value, schema: dict, definitions: dict) -> bool:
    """Whether a value keeps the part of JSON Schema that ours use."""
    if "$ref" in schema:
        return keeps(value, definitions[schema["$ref"].rsplit("/", 1)[1]], definitions)
    if "anyOf" in schema:
        return any(keeps(value, one, definitions) for one in schema["anyOf"])
    if "enum" in schema and value not in schema["enum"]:
        return False
    types = {
        "number": (int, float),
        "integer": int,
        "string": str,
        "boolean": bool,
        "array": list,
        "object": dict,
    }
    if not isinstance(value, types[schema["type"]]):
        return False
    if schema["type"] == "object" and "properties" not in schema:
        return all(
            keeps(one, schema["additionalProperties"], definitions) for one in value.values()
        )
    if schema["type"] == "object":
        keys = schema["properties"]
        known = value.keys() <= keys.keys() or schema.get("additionalProperties") is not False
        whole = all(key in value for key in schema.get("required", ()))
        return (
            known
            and whole
            and all(keeps(one, keys[key], definitions) for key, one in value.items())
        )
    if schema["type"] == "array" and "prefixItems" in schema:
        return len(value) == schema["minItems"]
    if schema["type"] == "array":
        return all(keeps(one, schema["items"], definitions) for one in value)
    return True


schema_of = cache(file_schema)


@unhurried
@given(sessions)
def test_the_schema_of_a_session_holds_for_every_session_file(form):
    schema = schema_of("session")
    assert keeps(tomllib.loads(to_toml(form)), schema, schema["$defs"])


@unhurried
@given(plans)
def test_the_schema_of_a_plan_holds_for_every_plan_file(plan):
    schema = schema_of("plan")
    assert keeps(tomllib.loads(plan_toml(plan)), schema, schema["$defs"])


def test_the_schema_of_a_sensor_holds_for_the_shipped_ones_and_not_for_a_misspelt_key():
    from importlib import resources

    from labdata import sensor_names

    for name in sensor_names():
        mapping = tomllib.loads((resources.files("labdata.sensors") / f"{name}.toml").read_text())
        schema = schema_of(
            "sensor" if "tube" in mapping else "solid-state" if "silicon" in mapping else "infrared"
        )
        assert keeps(mapping, schema, schema["$defs"])
        mapping["optics"]["fnumber"] = 1.0
        assert not keeps(mapping, schema, schema["$defs"])


def test_the_schema_knows_no_null_as_toml_has_none():
    assert not any(
        "null" in str(schema_of(kind)) for kind in ("session", "sensor", "solid-state", "plan")
    )
