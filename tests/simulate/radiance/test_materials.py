"""Surfaces: BRDFs are reciprocal and keep energy, materials have their published spectra, also
those of mesh files.
"""

import numpy as np
import pytest

from labdata import BadInput, from_mapping
from simulate.radiance import Material, load_scene, material, material_names
from simulate.radiance.brdf import (
    Glossy,
    Lambert,
    MeasuredTable,
    Metal,
    Reflectance,
    Retroreflector,
    grey,
    microfacet,
    specular_albedo,
)
from simulate.radiance.outdoor import build_surfaces
from simulate.thermal import slab_of, temperatures

# Every BRDF is reciprocal, gives back no more light than comes, and is drawn from as it says.


WAVELENGTH = np.array([450.0, 650.0, 850.0])
TINTED = Reflectance(wavelength_nm=(450.0, 650.0, 850.0), fraction=(0.2, 0.6, 1.0))
POLAR, AZIMUTH = np.linspace(0.0, 90.0, 10), np.linspace(0.0, 180.0, 7)


def measured():
    """A rising, then falling shape that depends on both angles and azimuth, reciprocal by
    construction.
    """
    tilt = np.sin(np.deg2rad(2.0 * POLAR))
    bent = tilt[:, None, None] * tilt[None, :, None] * (1.0 - 0.6 * np.cos(np.deg2rad(AZIMUTH)))
    table = np.stack([level * (0.18 + 0.05 * bent) for level in (0.2, 0.6, 1.0)])
    return MeasuredTable(
        wavelength_nm=WAVELENGTH, polar_deg=POLAR, azimuth_deg=AZIMUTH, table=table
    )


BRDFS = {
    "diffuse": Lambert(reflectance=TINTED),
    "metal-.05": Metal(reflectance=TINTED, roughness=0.05),
    "metal-.3": Metal(reflectance=TINTED, roughness=0.3),
    "metal-1": Metal(reflectance=TINTED, roughness=1.0),
    "glossy-.1": Glossy(reflectance=TINTED, roughness=0.1),
    "water-.6": Glossy(reflectance=TINTED, roughness=0.6, refractive_index=1.33),
    "retro-.5": Retroreflector(retroreflectance=grey(0.5), reflectance=TINTED, half_width_deg=0.5),
    "retro-10": Retroreflector(retroreflectance=TINTED, reflectance=grey(0.4), half_width_deg=10.0),
    "measured": measured(),
}
ANGLES = (0.0, 40.0, 75.0, 86.0)
every = pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS.keys())


def eye(angle_deg, count=1):
    angle = np.deg2rad(angle_deg)
    return np.tile([[np.sin(angle), 0.0, np.cos(angle)]], (count, 1))


def random_directions(rng, count):
    up = rng.random(count) ** 2
    turn = 2.0 * np.pi * rng.random(count)
    level = np.sqrt(1.0 - up**2)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), up])


@every
def test_light_and_eye_can_change_places(brdf, seed):
    rng = np.random.default_rng(seed)
    one, other = random_directions(rng, 4000), random_directions(rng, 4000)
    # Half of the pairs lie where lobes are.
    near = 1e-3 * rng.standard_normal((2000, 3))
    other[:1000] = one[:1000] + near[:1000]
    other[1000:2000] = one[1000:2000] * [-1.0, -1.0, 1.0] + near[1000:]
    other /= np.linalg.norm(other, axis=1)[:, None]
    there, back = brdf.value(one, other, WAVELENGTH), brdf.value(other, one, WAVELENGTH)
    assert np.allclose(there, back, rtol=1e-9, atol=1e-12)
    assert (there >= 0.0).all() and np.isfinite(there).all()


@every
@pytest.mark.parametrize("angle", ANGLES)
def test_draws_average_to_the_albedo(brdf, angle, seed):
    count = 60_000
    outgoing = eye(angle, count)
    incoming, density = brdf.sample(outgoing, np.random.default_rng([seed, int(angle)]))
    assert np.allclose(np.linalg.norm(incoming, axis=1), 1.0)
    assert np.allclose(density, brdf.pdf(incoming, outgoing))
    light = brdf.value(incoming, outgoing, WAVELENGTH) * np.maximum(incoming[:, 2], 0.0) / density
    error = light.std(axis=1) / np.sqrt(count)
    albedo = brdf.albedo(outgoing[:1], WAVELENGTH)[:, 0]
    assert (np.abs(light.mean(axis=1) - albedo) < 4.5 * error + 1e-9).all()
    # No draw is worth so much that means would not settle.
    assert light.max() < 40.0


@pytest.mark.parametrize(
    "brdf",
    [
        Lambert(reflectance=grey(1.0)),
        Glossy(reflectance=grey(1.0), roughness=0.2),
        *(Metal(reflectance=grey(1.0), roughness=roughness) for roughness in (0.02, 0.3, 1.0)),
    ],
)
def test_what_reflects_all_light_vanishes_in_an_even_glow(brdf):
    for angle in ANGLES:
        assert brdf.albedo(eye(angle), WAVELENGTH) == pytest.approx(1.0, abs=1e-9)


# Albedo of GGX with facets that reflect all, at 0, 30, 60, 80 degrees, to the digits of the
# reference.
@pytest.mark.parametrize(
    ("roughness", "albedo", "within"),
    [
        (0.1, (0.99, 0.99, 0.97, 0.90), 0.006),
        (0.3, (0.88, 0.86, 0.82, 0.85), 0.006),
        (1.0, (0.307, 0.335, 0.451, 0.668), 0.001),
    ],
)
def test_a_single_bounce_loses_light_on_rough_faces(roughness, albedo, within):
    table = specular_albedo(roughness)
    for angle, expected in zip((0.0, 30.0, 60.0, 80.0), albedo, strict=True):
        assert table.at(eye(angle))[0] == pytest.approx(expected, abs=within)


@pytest.mark.parametrize(
    ("angle", "reflectance"),
    [(0, 0.0400), (30, 0.0415), (45, 0.0502), (60, 0.0892), (75, 0.2531), (85, 0.6128)],
)
def test_glass_reflects_by_fresnel(angle, reflectance):
    assert microfacet.dielectric(np.cos(np.deg2rad(angle)), 1.5) == pytest.approx(
        reflectance, abs=6e-5
    )


@pytest.mark.parametrize(("index", "reflectance"), [(1.5, 0.0918), (1.33, 0.0659)])
def test_glass_and_water_in_an_even_glow(index, reflectance):
    cosine = (np.arange(20_000) + 0.5) / 20_000
    assert np.mean(2.0 * cosine * microfacet.dielectric(cosine, index)) == pytest.approx(
        reflectance, abs=1e-4
    )


def test_a_retroreflector_is_brightest_to_the_lamps_own_eye():
    sheet = Retroreflector(retroreflectance=grey(0.1), reflectance=grey(0.3), half_width_deg=0.5)
    towards = np.array([eye(30.0)[0], eye(30.5)[0], eye(35.0)[0], eye(-30.0)[0]])
    value = sheet.value(towards, eye(30.0, 4), [550.0])[0]
    base = value[3]
    assert (value[1] - base) / (value[0] - base) == pytest.approx(0.5, rel=0.01)
    assert value[2] == pytest.approx(base, rel=0.02)
    # 0.1 N(0), the coefficient of retroreflection at normal incidence, in cd lx-1 m-2.
    head_on = sheet.value(eye(0.0), eye(0.0), [550.0])[0, 0] - base
    assert head_on == pytest.approx(0.1 * np.log(2.0) / (np.deg2rad(0.5) ** 2 * np.pi), rel=0.01)


def test_a_measured_table_is_read_at_its_angles():
    brdf = measured()
    light = np.array(
        [
            [np.sin(np.deg2rad(30.0)) * c, np.sin(np.deg2rad(30.0)) * s, np.cos(np.deg2rad(30.0))]
            for c, s in ((1.0, 0.0), (0.5, np.sqrt(0.75)), (-1.0, 0.0))
        ]
    )
    found = brdf.value(light, eye(60.0, 3), WAVELENGTH)
    assert np.allclose(found, brdf.table[:, 3, 6, [0, 2, 6]])
    assert np.allclose(brdf.value(light, eye(60.0, 3), [550.0]), found[:2].mean(axis=0))


def bad_table(**change):
    table = np.full((1, 10, 10, 7), 0.2)
    for index, value in change.get("at", ()):
        table[index] = value
    keys = {
        "wavelength_nm": np.array([550.0]),
        "polar_deg": POLAR,
        "azimuth_deg": AZIMUTH,
        "table": table,
    }
    return MeasuredTable(**{**keys, **{k: v for k, v in change.items() if k != "at"}})


@every
def test_nothing_shines_through_from_below(brdf):
    down = np.array([[0.3, 0.0, -np.sqrt(0.91)]])
    assert not brdf.value(down, eye(20.0), WAVELENGTH).any()
    assert not brdf.value(eye(20.0), down, WAVELENGTH).any()


# Materials that ship have their published spectra and a surface; impossible ones are refused.


# Reflectance at 450, 550, 700, 850 nm.
PUBLISHED = {
    "green-canopy": (0.022, 0.081, 0.092, 0.445),
    "dry-soil": (0.10, 0.17, 0.31, 0.36),
    "concrete": (0.19, 0.25, 0.29, 0.31),
    "asphalt": (0.08, 0.093, 0.10, 0.11),
    "dead-grass": (0.04, 0.09, 0.16, 0.24),
    "olive-drab-paint": (0.05, 0.08, 0.08, 0.24),
    "snow": (0.95, 0.95, 0.92, 0.86),
    "light-skin": (0.25, 0.33, 0.52, 0.57),
    "dark-cotton": (0.05, 0.05, 0.30, 0.60),
}
UP = np.array([[0.0, 0.0, 1.0]])


@pytest.mark.parametrize(("name", "shares"), PUBLISHED.items())
def test_matt_materials_have_their_spectra(name, shares):
    grid = [450.0, 550.0, 700.0, 850.0]
    assert material(name).reflectance_at(grid) == pytest.approx(shares)
    assert material(name).brdf().albedo(UP, grid)[:, 0] == pytest.approx(shares)


@pytest.mark.parametrize("name", material_names())
def test_every_material_says_its_source_and_gives_off_no_more_than_it_gets(name):
    found = material(name)
    assert found.source
    grid = np.linspace(380.0, 1100.0, 40)
    assert (found.brdf().albedo(UP, grid)[:, 0] + found.transmittance_at(grid) <= 1.0 + 1e-9).all()
    assert (found.reflectance_at(grid) >= 0.0).all()


def test_finishes_make_their_surfaces():
    kinds = {"concrete": Lambert, "aluminium": Metal, "water": Glossy, "road-sign": Retroreflector}
    assert all(isinstance(material(name).brdf(), kind) for name, kind in kinds.items())
    # Head-on, smooth water reflects 2 %.
    assert material("water").brdf().albedo(UP, [550.0])[0, 0] == pytest.approx(0.02, abs=1e-3)


def test_leaves_and_dyes_turn_bright_in_the_near_infrared():
    for name in ("green-canopy", "dark-cotton"):
        green, infrared = material(name).reflectance_at([550.0, 850.0])
        assert infrared > 5.0 * green


def test_one_share_stands_for_all_wavelengths():
    leaf = Material(wavelength_nm=(500.0, 800.0), reflectance=(0.1, 0.5), transmittance=(0.3,))
    assert leaf.transmittance_at([400.0, 600.0, 900.0]) == pytest.approx(0.3)


WRONG_MATERIALS = [
    ({"reflectance": [0.6], "transmittance": [0.6]}, "nor exceed 1 together, got 0.6 and 0.6"),
    ({"reflectance": [-0.1]}, "must not be negative"),
    ({"wavelength_nm": [500.0, 400.0], "reflectance": [0.1, 0.1]}, "wavelengths must ascend"),
    (
        {"wavelength_nm": [400.0, 500.0, 600.0], "reflectance": [0.1, 0.1]},
        "3 wavelengths, 2 and 1",
    ),
    ({"finish": "metal"}, "roughness must be given for a metal material"),
    ({"roughness": 0.2}, "roughness must not be given for a diffuse material"),
    (
        {"finish": "glossy", "roughness": 2.0, "refractive_index": 1.5},
        "roughness must lie between",
    ),
    ({"finish": "shiny"}, "finish"),
    ({"emissivity": 1.5}, r"emissivity must lie between 0 and 1, got 1.5"),
    ({"colour": 1.0}, "colour"),
]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda: bad_table(table=np.full((1, 10, 10, 7), 0.4)),
            "must not give off more light than arrives, got 1.2",
        ),
        (
            lambda: bad_table(at=[((0, 2, 7), 0.3)]),
            "the same with light and eye exchanged, got a difference of 0.1",
        ),
        (
            lambda: bad_table(at=[((0, 0, 3, 2), 0.3), ((0, 3, 0, 2), 0.3)]),
            "must not depend on the azimuth",
        ),
        (lambda: bad_table(polar_deg=POLAR[::-1]), "polar_deg of a measured BRDF must ascend"),
        (lambda: bad_table(polar_deg=0.9 * POLAR), "polar_deg must run from 0 to 90"),
        (lambda: bad_table(at=[((0, 0, 0, 0), -1.0)]), "finite and not negative"),
        (
            lambda: Metal(reflectance=grey(0.5), roughness=0.0),
            r"roughness must lie between 0.002 and 1, got 0",
        ),
        (
            lambda: Glossy(reflectance=grey(0.5), roughness=0.1, refractive_index=1.0),
            r"must lie in \(1, 4\], got 1",
        ),
        (
            lambda: Retroreflector(
                retroreflectance=grey(0.5), reflectance=grey(0.1), half_width_deg=0.0
            ),
            "half_width_deg must lie",
        ),
        *((lambda keys=keys: from_mapping(keys, Material), says) for keys, says in WRONG_MATERIALS),
        (lambda: material("gold"), r"one of aluminium, asphalt.*got 'gold'"),
    ],
)
def test_impossible_surfaces_and_materials_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()


# Materials of .glb files: by names of the library, by colour with the slab of paint, and refused.


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
