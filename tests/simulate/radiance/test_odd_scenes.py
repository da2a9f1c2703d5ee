"""Scenes at the border of what makes sense are rendered; the schema holds for those that ship."""

import json
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from typer.testing import CliRunner

from charact.cli.application import app
from labdata import Conditions, load_camera, read_toml
from simulate import OutdoorRendering
from simulate.camera import camera_from_description, photoelectrons_from_radiance
from simulate.radiance import load_scene
from tests.labdata.test_serialiser import keeps

# Scenes at the border of what makes sense are rendered without a warning, and a camera takes what
# comes out.


HEAD = 'name = "odd"\n'
CAMERA = "camera = { position_m = [0, -9, 1.5], look_at_m = [0, 0, 1] }\n"
SCANNER = CAMERA.replace(" }", ", scan = { line_time_s = 0.01, turn_deg_per_s = 10 } }")
RISING = CAMERA.replace(" }", ", scan = { line_time_s = 0.01, velocity_m_per_s = [0, 0, -1] } }")
MOON = (
    "place = { latitude_deg = 43.16, longitude_deg = -77.61, time = 1998-07-01T23:00:00-04:00 }\n"
)
GREY = '[[material]]\nlabel = "grey"\nreflectance = [0.5]\n'
GROUND = '[[object]]\nlabel = "ground"\nshape = "ground"\nsize_m = [400]\nmaterial = "grey"\n'
LAMP = '[[lamp]]\nlabel = "lamp"\nkind = "mercury"\nlumens = 10\nposition_m = [0, -1, 1.0556]\n'
HEADLAMP = LAMP.replace("[0, -1, 1.0556]", "[0, -9, 1.5]")
UNSEEN = LAMP.replace(
    'kind = "mercury"\nlumens = 10', 'kind = "narrow-band"\nwavelength_nm = 1150\nwatts = 10'
)
TO_THE_MOON = SCANNER.replace("look_at_m = [0, 0, 1]", "look_at_m = [-7.258, -12.968, 5.046]")


@pytest.mark.parametrize(
    "text",
    [
        CAMERA,
        CAMERA + LAMP,
        CAMERA + GREY + GROUND + UNSEEN,
        CAMERA + GREY + GROUND + HEADLAMP,
        CAMERA + "weather = { visibility_km = 0.02 }\n" + GREY + GROUND + LAMP,
        SCANNER + GREY + GROUND + LAMP,
        RISING + MOON + GREY + GROUND + LAMP,
        TO_THE_MOON + MOON + GREY + GROUND,
    ],
    ids=[
        "empty",
        "lamp alone",
        "unseen lamp",
        "lamp at the lens",
        "fog",
        "scanner",
        "scanner under a moon",
        "to it",
    ],
)
def test_an_odd_scene_is_rendered_without_a_warning_and_finite_for_a_camera(tmp_path, text):
    """Warnings are errors here."""
    (tmp_path / "scene.toml").write_text(HEAD + text)
    description = load_camera("pulnix-ag5745ef3")
    camera = camera_from_description(
        replace(description, ccd=replace(description.ccd, rows=12, columns=16))
    )
    seen = OutdoorRendering(load_scene(tmp_path / "scene.toml"), camera, Conditions()).render(
        tolerance=0.2, seed=1, threads=1
    )
    assert np.isfinite(seen.picture.cube.radiance).all()
    assert np.isfinite(
        photoelectrons_from_radiance(camera, seen.picture.cube, Conditions()).values
    ).all()
    assert seen.notes and seen.document()


# `charact schema scene`: it holds for the scenes that ship, and knows no key that they may not
# have.


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
