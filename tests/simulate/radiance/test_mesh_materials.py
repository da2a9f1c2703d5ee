"""Materials of .glb files: by names of the library, by colour with the slab of paint, and
refused.
"""

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance import load_scene
from simulate.radiance.outdoor import build_surfaces
from simulate.thermal import slab_of, temperatures

SCENE = """
name = "a car"
camera = { position_m = [0, -9, 1.5], look_at_m = [0, 0, 1] }
[[object]]
label = "car"
unit = "m"
file = "car.glb"
"""


def load_with(folder, more="", **materials):
    """The scene of a mesh of one cube of each material, named as in the file."""
    import trimesh

    whole = trimesh.Scene()
    for number, (name, given) in enumerate(materials.items()):
        cube = trimesh.creation.box()
        paint = trimesh.visual.material.PBRMaterial(name=name.replace("__", " "), **given)
        cube.visual = trimesh.visual.TextureVisuals(material=paint, uv=np.zeros((8, 2)))
        whole.add_geometry(
            cube, transform=trimesh.transformations.translation_matrix([3.0 * number, 0, 0])
        )
    whole.export(folder / "car.glb")
    (folder / "scene.toml").write_text(SCENE + more)
    return load_scene(folder / "scene.toml")


def test_names_of_the_library_and_colours_become_materials(tmp_path):
    """A quarter of red is a reflectance of 0.25 (glTF's factors are linear); a grey texture of code
    188 is half.
    """
    from PIL import Image

    grey = Image.new("RGB", (2, 2), (188, 188, 188))
    scene = load_with(
        tmp_path,
        OLIVE__drab_paint={},
        red={"baseColorFactor": [64, 26, 13, 255], "metallicFactor": 0.0},
        cloth={"baseColorTexture": grey, "metallicFactor": 0.0},
    )
    named = {one.label: one for one in scene.material}
    assert scene.object[0].file_materials == {
        "OLIVE drab_paint": "car: OLIVE drab_paint",
        "red": "car: red",
        "cloth": "car: cloth",
    }
    assert named["car: OLIVE drab_paint"].library == "olive-drab-paint"
    assert named["car: red"].material.reflectance_at(
        np.array([450.0, 550.0, 610.0, 900.0])
    ) == pytest.approx(np.array([13.0, 26.0, 64.0, 64.0]) / 255.0, abs=1e-4)
    assert named["car: cloth"].reflectance == pytest.approx((0.503, 0.503, 0.503), abs=0.002)
    found = build_surfaces(scene)
    assert (
        found.notes == ()
        and len(found.materials) == 3
        and found.area_m2.sum() == pytest.approx(18.0)
    )


def test_colours_have_the_slab_of_paint_and_say_so_and_metals_have_none(tmp_path):
    scene = load_with(
        tmp_path,
        red={"baseColorFactor": [64, 26, 13, 255], "metallicFactor": 0.0},
        chrome={
            "baseColorFactor": [200, 200, 200, 255],
            "metallicFactor": 1.0,
            "roughnessFactor": 0.5,
        },
        concrete={"baseColorFactor": [9, 9, 9, 255]},
    )
    named = {one.label: one for one in scene.material}
    red, chrome, concrete = (named[f"car: {name}"] for name in ("red", "chrome", "concrete"))
    assert float(slab_of(scene, red).emissivity) == float(
        temperatures.library()["steel-sheet-painted"].emissivity
    )
    assert float(slab_of(scene, red).absorptivity) == pytest.approx(1.0 - 32.0 / 255.0, abs=0.07)
    assert "slab and infrared emissivity of painted steel" in red.note
    assert (chrome.finish, chrome.roughness) == ("metal", 0.25)
    with pytest.raises(
        BadInput, match="must have a slab for its temperature, got 'car: chrome' without one"
    ):
        slab_of(scene, chrome)
    assert concrete.library == "concrete" and not concrete.note


def test_a_material_without_name_and_colour_is_refused_and_one_of_the_scene_wins(tmp_path):
    with pytest.raises(
        BadInput,
        match=r"material of car\.glb must have a name of the library .* got 'thing' without",
    ):
        load_with(tmp_path, thing={})
    grey = '[[material]]\nlabel = "grey"\nreflectance = [0.2]\n'
    scene = load_with(tmp_path, 'material = "grey"\n' + grey, thing={})
    assert [one.label for one in scene.material] == ["grey"] and not scene.object[0].file_materials
