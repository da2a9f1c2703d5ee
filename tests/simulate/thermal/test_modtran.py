"""Air by the database of MODTRAN: interpolation in range and visibility, what it does not hold, and
broken files.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, from_mapping
from simulate.radiance.geometry import Viewpoint
from simulate.radiance.outdoor import OutdoorScene
from simulate.thermal import (
    InfraredAir,
    bins_of,
    infrared_radiance,
    modtran_air,
    sky_of,
    temperatures_of,
    weather_of,
)
from simulate.thermal import air as air_module

BAND = (8.0, 12.0)
# Depth of gases at 1 km, by r^0.7, and of haze at 1 km and a visibility of 1 km, by r and 1/V.
GAS, POWER, HAZE = 0.4, 0.7, 0.5


def write_database(folder, transmittance) -> None:
    """Write a database of the package's format; `transmittance(km, visibility_km)` has a value or a
    spectrum.
    """
    rows, number = (
        ["Index, Altitude (km), Ground Range (km), IHAZE (1 = 23 km vis, 2 = 5 km vis)"],
        0,
    )
    for visibility, code in ((23.0, 1), (5.0, 2)):
        for height, each in air_module.PATHS_KM:
            for km in each:
                number += 1
                rows.append(f"{number},{height:g},{km:g},{code},")
                columns = np.zeros((5, len(air_module.WAVELENGTH_UM)), np.float32)
                columns[0] = transmittance(float(np.hypot(height, km)), visibility)
                columns.tofile(folder / f"{number}.bin")
    (folder / "fileDecoder.csv").write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    folder = tmp_path_factory.mktemp("atms")
    write_database(
        folder, lambda km, visibility: np.exp(-GAS * km**POWER - HAZE * km**POWER / visibility)
    )
    return folder


def scene_of(folder, height_m=5.0, altitude_m=0.0, **weather) -> OutdoorScene:
    summer = {
        "temperature_c": 21.0,
        "relative_humidity": 0.765,
        "wind_m_s": 1.0,
        "atmosphere": "modtran5",
    }
    table = {
        "name": "summer",
        "place": {
            "latitude_deg": 43.16,
            "longitude_deg": -77.61,
            "time": "1998-06-24T02:00:00-04:00",
        },
        "weather": summer | ({} if folder is None else {"modtran_folder": str(folder)}) | weather,
        "camera": {"position_m": [0, -20, height_m], "look_at_m": [0, 0, 0]},
        "material": [{"label": "concrete", "library": "concrete"}],
        "object": [
            {"label": "ground", "shape": "plane", "size_m": [60, 60], "material": "concrete"}
        ],
    }
    table["place"]["altitude_m"] = altitude_m
    return from_mapping(table, OutdoorScene, where="test")


def air_of(scene, height_m=5.0) -> InfraredAir:
    weather = weather_of(scene)
    return modtran_air(sky_of(BAND, weather, scene.weather).air, scene, weather, height_m)


@pytest.mark.parametrize("visibility_km", [5.0, 11.0, 23.0])
def test_depth_is_interpolated_by_powers_of_the_range_and_by_the_extinction_of_haze(
    database, visibility_km
):
    air = air_of(scene_of(database, visibility_km=visibility_km))
    metres = np.array([0.0, 0.5, 2.0, 37.0, 500.0, 1234.0, 8000.0])
    expected = np.exp(-(GAS + HAZE / visibility_km) * (1e-3 * metres) ** POWER)
    assert air.transmittance(metres) == pytest.approx(
        np.tile(expected[:, None], len(air.low_um)), abs=2e-4
    )


def test_a_bin_is_the_mean_over_a_black_body_of_its_own_part_of_the_spectrum(tmp_path):
    """Half of the bin from 10 to 10.5 um opaque, all else clear: the lower half has 50.0 % of the
    radiance.
    """
    write_database(
        tmp_path,
        lambda km, v: np.where(
            (air_module.WAVELENGTH_UM > 10.0) & (air_module.WAVELENGTH_UM < 10.25), 0.0, 1.0
        ),
    )
    found = air_of(scene_of(tmp_path)).transmittance([1000.0])[0]
    assert found == pytest.approx(
        np.where(np.array(bins_of(BAND)[:-1]) == 10.0, 0.5, 1.0), abs=0.02
    )


def test_paths_emit_what_they_absorb_at_the_temperature_of_the_scenes_air(database):
    air = air_of(scene_of(database))
    black = air.black_body(air.temperature_k)
    assert air.after_path(np.tile(black, (3, 1)), [1.0, 500.0, 8000.0]) == pytest.approx(
        np.tile(black, (3, 1))
    )


def test_the_database_agrees_with_the_law_of_short_paths(shared_data, tmp_path):
    """Rows of the real database in the stand-in: from 8 to 12 um within 0.005 of the built-in law
    to 1 km.
    """
    path = shared_data / "modtran5_pybsm" / "level_paths_2m.npz"
    if not path.exists():
        pytest.skip("the level paths of MODTRAN 5 are not here")
    with np.load(path) as file:
        known = {name: file[name].astype(float) for name in file.files}

    def spectrum(km, visibility):
        row = np.flatnonzero(
            np.isclose(known["range_km"], round(km, 1)) & (known["visibility_km"] == visibility)
        )
        return known["transmission"][row[0]] if len(row) else np.exp(-1e-3 * km)

    write_database(tmp_path, spectrum)
    for visibility in (5.0, 23.0):
        found = air_of(scene_of(tmp_path, visibility_km=visibility))
        law = InfraredAir(
            edges_um=found.edges_um,
            temperature_k=found.temperature_k,
            vapour_g_m3=14.0,
            visibility_km=visibility,
        )
        metres = [100.0, 200.0, 500.0, 1000.0]
        assert found.transmittance(metres).mean(axis=1) == pytest.approx(
            law.transmittance(metres).mean(axis=1), abs=0.005
        )


@pytest.mark.parametrize(
    ("change", "height_m", "got"),
    [
        ({"temperature_c": 15.0, "relative_humidity": 1.0}, 2.0, "got air of 15.0 C"),
        ({"relative_humidity": 0.5}, 2.0, "got 9.1 g/m3 of water vapour"),
        ({"visibility_km": 50.0}, 2.0, "got a visibility of 50 km"),
        ({"visibility_km": 2.0}, 2.0, "got a visibility of 2 km"),
        ({"altitude_m": 1500.0}, 2.0, "got a pressure of 8[0-9]+ hPa"),
        ({}, 150.0, "got a camera 150 m up"),
    ],
)
def test_air_that_the_database_does_not_hold_is_refused_by_what_it_holds(
    database, change, height_m, got
):
    with pytest.raises(
        BadInput, match=rf"holds level paths to 8 km .* visibilities of 5 to 23 km, {got}"
    ):
        air_of(scene_of(database, **change), height_m)


def test_farther_surfaces_are_refused(database):
    air = air_of(scene_of(database))
    with pytest.raises(BadInput, match=r"got a surface 9.5 km away"):
        air.after_path(np.zeros((2, len(air.low_um))), [10.0, 9500.0])


def test_without_the_package_the_message_names_the_extra(monkeypatch):
    monkeypatch.setattr(air_module, "find_spec", lambda name: None)
    with pytest.raises(
        BadInput, match=re.escape("pip install 'charact[modtran5]', or name its folder")
    ):
        air_of(scene_of(None))


def test_a_folder_belongs_to_the_database(database):
    with pytest.raises(
        BadInput,
        match=r'modtran_folder must come with atmosphere = "modtran5", got .* and .built-in',
    ):
        scene_of(database, atmosphere="built-in")


def test_broken_databases_are_refused(tmp_path):
    with pytest.raises(BadInput, match=r"must have a file fileDecoder.csv, got none"):
        air_of(scene_of(tmp_path))
    write_database(tmp_path, lambda km, visibility: 0.5)
    (tmp_path / "3.bin").write_bytes(b"version https://git-lfs.github.com/spec/v1\n!")
    with pytest.raises(
        BadInput, match=r"must have 6855 numbers for the path from 2 m up to 0.5 km away, got 11 in"
    ):
        air_of(scene_of(tmp_path, visibility_km=23.0))
    write_database(tmp_path, lambda km, visibility: 1.5)
    with pytest.raises(BadInput, match="must lie between 0 and 1, got others"):
        air_of(scene_of(tmp_path))
    (tmp_path / "fileDecoder.csv").write_text("Index\n1,0.002,0,1,\n2,0.002,0.1,1,\n")
    with pytest.raises(BadInput, match="for the path from 2 m up to"):
        air_of(scene_of(tmp_path))


def test_an_image_through_this_air_says_so_and_differs_from_one_through_the_other(database):
    view = Viewpoint(
        position_m=(0.0, -20.0, 5.0), forward=(0.0, 1.0, -0.3), shape=(6, 8), focal_px=(20.0, 20.0)
    )
    scene = scene_of(database)
    assert scene.weather is not None
    built_in = replace(
        scene, weather=replace(scene.weather, atmosphere="built-in", modtran_folder=None)
    )
    temperatures = temperatures_of(scene)
    found, other = (
        infrared_radiance(temperatures, of, view, band_um=BAND, netd_k=1.0, tolerance=None)
        for of in (scene, built_in)
    )
    assert any("MODTRAN 5.2.1" in note for note in found.notes) and not any(
        "MODTRAN" in note for note in other.notes
    )
    assert np.abs(found.radiance - other.radiance).max() > 1e-4
