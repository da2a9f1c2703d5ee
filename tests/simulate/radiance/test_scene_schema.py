"""`charact schema scene`: it holds for the scenes that ship, and knows no key that they may not
have.
"""

import json
from importlib import resources

import pytest
from typer.testing import CliRunner

from charact.cli.application import app
from labdata import read_toml
from tests.labdata.test_serialiser import keeps


def schema(kind):
    done = CliRunner().invoke(app, ["schema", kind])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("road", "scene"), ("hangar", "scene"), ("airfield", "scene"), ("bench", "bench")],
)
def test_the_schema_holds_for_a_scene_that_ships(name, kind):
    scene = read_toml(resources.files("simulate") / "scenes" / f"{name}.toml")
    if "place" in scene:
        scene["place"]["time"] = scene["place"]["time"].isoformat()
    whole = schema(kind)
    assert keeps(scene, whole, whole["$defs"])
    assert not keeps(scene | {"folder": "."}, whole, whole["$defs"])
