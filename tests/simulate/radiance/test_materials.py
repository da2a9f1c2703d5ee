"""Materials that ship have their published spectra and a surface; impossible ones are refused."""

import numpy as np
import pytest

from labdata import BadInput, from_mapping
from simulate.radiance import Material, material, material_names
from simulate.radiance.brdf import Glossy, Lambert, Metal, Retroreflector

# Reflectance at 450, 550, 700, 850 nm.
TABLE = {
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


@pytest.mark.parametrize(("name", "shares"), TABLE.items())
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


@pytest.mark.parametrize(
    ("keys", "says"),
    [
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
    ],
)
def test_impossible_materials_are_refused_in_a_sentence(keys, says):
    with pytest.raises(BadInput, match=says):
        from_mapping(keys, Material)


def test_an_unknown_material_gets_the_list_of_known_ones():
    with pytest.raises(BadInput, match=r"one of aluminium, asphalt.*got 'gold'"):
        material("gold")
