"""Infrared air and sky: transmittance, emission and brightness against LOWTRAN7 and MODTRAN 5."""

from dataclasses import replace
from datetime import datetime
from itertools import product

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance import (
    STEFAN_BOLTZMANN,
    Atmosphere,
    band_radiance,
    vapour_density_g_m3,
)
from simulate.radiance.outdoor import Weather as State
from simulate.radiance.sky import ObserverLocation
from simulate.thermal import (
    InfraredAir,
    InfraredSky,
    Weather,
    apparent_temperature,
    bins_of,
    notes_on_sky,
    ring_radiance,
    sky_of,
)
from simulate.thermal import air as air_module

RANGES_M = (10.0, 100.0, 300.0, 1000.0, 3000.0, 5000.0)
# Air temperature, K, relative humidity, band, transmittance of LOWTRAN7 with 420 ppm of CO2 over
# `RANGES_M`.
LEVEL_PATHS = [
    (293.15, 0.6, (3.0, 5.0), (0.882, 0.768, 0.673, 0.520, 0.342, 0.258)),
    (293.15, 0.6, (8.0, 12.0), (0.991, 0.962, 0.920, 0.813, 0.607, 0.466)),
    (293.15, 0.6, (8.0, 14.0), (0.983, 0.929, 0.862, 0.721, 0.498, 0.366)),
    (283.15, 0.8, (3.0, 5.0), (0.888, 0.782, 0.695, 0.552, 0.379, 0.291)),
    (283.15, 0.8, (8.0, 12.0), (0.993, 0.970, 0.937, 0.855, 0.690, 0.569)),
    (273.15, 0.6, (3.0, 5.0), (0.896, 0.807, 0.737, 0.623, 0.476, 0.394)),
    (273.15, 0.6, (8.0, 12.0), (0.996, 0.984, 0.968, 0.930, 0.858, 0.802)),
    (303.15, 0.8, (8.0, 12.0), (0.983, 0.911, 0.796, 0.528, 0.187, 0.073)),
]
ZENITH_DEG = (0.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0)
# Air temperature, K, precipitable water, cm, band, brightness temperature of the clear sky by
# LOWTRAN7, K.
SKIES = [
    (299.7, 4.11, (8.0, 12.0), (254.2, 258.2, 263.7, 272.6, 281.2, 286.3, 291.7, 295.9)),
    (299.7, 4.11, (8.0, 14.0), (261.9, 265.3, 270.1, 277.6, 284.6, 288.7, 292.9, 296.1)),
    (299.7, 4.11, (3.0, 5.0), (284.5, 285.4, 286.7, 288.7, 290.7, 291.9, 293.4, 295.2)),
    (294.2, 2.92, (8.0, 12.0), (238.8, 242.5, 247.8, 256.8, 266.3, 272.7, 280.5, 288.8)),
    (294.2, 2.92, (8.0, 14.0), (247.5, 250.9, 255.6, 263.5, 271.6, 276.8, 283.1, 289.6)),
    (294.2, 2.92, (3.0, 5.0), (278.6, 279.5, 280.9, 283.0, 285.0, 286.4, 288.0, 290.0)),
    (287.2, 2.08, (8.0, 12.0), (222.5, 225.8, 230.5, 238.8, 248.0, 254.6, 263.5, 275.6)),
    (288.2, 1.42, (8.0, 12.0), (211.4, 214.3, 218.6, 226.1, 234.7, 241.1, 250.3, 265.0)),
    (288.2, 1.42, (8.0, 14.0), (222.7, 225.4, 229.2, 235.9, 243.4, 248.9, 256.8, 269.1)),
    (288.2, 1.42, (3.0, 5.0), (268.1, 269.1, 270.4, 272.7, 275.0, 276.6, 278.6, 281.4)),
    (272.2, 0.85, (8.0, 12.0), (196.6, 199.0, 202.6, 208.9, 216.0, 221.4, 229.2, 242.6)),
    (257.2, 0.42, (8.0, 12.0), (182.5, 184.6, 187.5, 192.5, 198.2, 202.4, 208.6, 219.2)),
]
# Water vapour of the ground over the column above it in the compact law, g m-3 for a cm.
VAPOUR_PER_CM = 1.0 / 0.24


def humid_air(
    band, kelvin: float, humidity: float, visibility_km: float | None = None
) -> InfraredAir:
    """Return air of a relative humidity for the bins of a band."""
    vapour = vapour_density_g_m3(kelvin - 273.15, humidity)
    return InfraredAir(
        edges_um=bins_of(band),
        temperature_k=kelvin,
        vapour_g_m3=vapour,
        visibility_km=visibility_km,
    )


def weighted(air: InfraredAir, share) -> np.ndarray:
    """Return the mean over the band by a black body of the air's temperature, shape (path,)."""
    black = air.black_body(air.temperature_k)
    return share @ black / black.sum()


def test_bins_hold_a_band_and_other_bands_are_refused():
    assert bins_of((8.0, 12.0)) == (8.0, 8.5, 9.0, 9.5, 10.0, 10.5, 11.0, 11.5, 12.0)
    assert bins_of((7.5, 13.5))[::12] == (7.5, 13.5)
    for band in ((3.0, 12.0), (5.0, 7.0), (9.0, 9.0), (8.0, 15.0)):
        with pytest.raises(BadInput, match=r"within 3 to 5 um or 7.5 to 14 um, got"):
            bins_of(band)


@pytest.mark.parametrize(("kelvin", "humidity", "band", "expected"), LEVEL_PATHS)
def test_transmittance_of_level_paths_is_lowtrans(kelvin, humidity, band, expected):
    """Within 0.015 from 8 to 14 um; from 3 to 5 um MODTRAN, which the law follows, is up to 0.05
    clearer.
    """
    air = humid_air(band, kelvin, humidity)
    above = weighted(air, air.transmittance(RANGES_M)) - expected
    low, high = (0.0, 0.05) if band == (3.0, 5.0) else (-0.015, 0.015)
    assert (above >= low).all() and (above <= high).all()


def test_depth_of_lines_grows_with_short_paths_and_ever_less_with_long_ones():
    """In every bin the depth of gases is as the range below 1 mm, and nowhere grows faster or
    falls.
    """
    for band in air_module.WINDOWS_UM:
        air = humid_air(band, 293.15, 0.6)
        km = np.geomspace(1e-8, 20.0, 200)
        growth = np.diff(np.log(air.depth(km, km, km)), axis=0) / np.diff(np.log(km))[:, None]
        assert (growth > 0.25).all() and (growth < 1.0 + 1e-6).all()
        assert growth[0] == pytest.approx(1.0, abs=0.03)


def test_beers_law_holds_in_no_band_but_haze_multiplies():
    air = humid_air((3.0, 5.0), 293.15, 0.6)
    short, long = weighted(air, air.transmittance([100.0, 1000.0]))
    assert long > 5.0 * short**10
    hazy = replace(air, visibility_km=5.0)
    ratio = hazy.transmittance([1000.0]) / air.transmittance([1000.0])
    # Rural haze at 4 um has 0.111 of the extinction at 0.55 um, 3.912 / 5 km less that of
    # molecules.
    assert ratio[0] == pytest.approx(np.exp(-0.111 * (3.912 / 5.0 - 0.0116)), rel=2e-3)


def test_air_emits_what_it_absorbs():
    """A path before a black body of the air's temperature changes nothing; an endless one is a
    black body.
    """
    air = humid_air((8.0, 14.0), 285.0, 0.7, 23.0)
    black = air.black_body(285.0)
    assert air.after_path(np.tile(black, (4, 1)), [0.0, 100.0, 1e4, 1e7]) == pytest.approx(
        np.tile(black, (4, 1))
    )
    cold = air.after_path(np.zeros((2, len(black))), [1000.0, 1e9])
    assert cold[0] == pytest.approx((1.0 - air.transmittance([1000.0])[0]) * black)
    assert cold[1] == pytest.approx(black)


def test_a_warm_target_looks_as_much_warmer_through_air_as_in_lowtran():
    """10 K above air of 293.15 K and 60 %: apparent rise at 100 m and 1 km in two bands."""
    for band, rises in (((8.0, 12.0), (9.62, 8.17)), ((8.0, 14.0), (9.38, 7.45))):
        air = humid_air(band, 293.15, 0.6)
        seen = air.after_path(np.tile(air.black_body(303.15), (2, 1)), [100.0, 1000.0]).sum(axis=1)
        assert apparent_temperature(seen, band) - 293.15 == pytest.approx(rises, abs=0.16)


def sky(kelvin: float, water_cm: float, band: tuple[float, float], **more) -> InfraredSky:
    air = InfraredAir(
        edges_um=bins_of(band), temperature_k=kelvin, vapour_g_m3=VAPOUR_PER_CM * water_cm
    )
    return InfraredSky(air=air, **more)


def ways(zenith_deg) -> np.ndarray:
    angle = np.deg2rad(zenith_deg)
    return np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)


@pytest.mark.parametrize(("kelvin", "water_cm", "band", "expected"), SKIES)
def test_the_clear_sky_by_direction_is_lowtrans(kelvin, water_cm, band, expected):
    light = sky(kelvin, water_cm, band).radiance(ways(ZENITH_DEG)).sum(axis=1)
    found = apparent_temperature(light, band)
    assert found == pytest.approx(expected, abs=3.0)
    assert (np.diff(found) > 0.0).all()


def test_sky_and_air_stay_within_black_bodies_in_any_weather():
    """From -50 to 45 C, dry and saturated, in fog, to the horizon: rising towards it, never warmer
    than the air.
    """
    zenith = np.array([*np.arange(0.0, 90.0, 5.0), 85.0, 87.0, 89.0, 89.9, 90.0])
    metres, found = np.geomspace(1e-3, 1e6, 100), set()
    for kelvin, humidity, visibility in product(
        (223.0, 268.0, 293.0, 318.0), (0.0, 0.5, 1.0), (None, 0.05)
    ):
        for band in air_module.WINDOWS_UM:
            air = humid_air(band, kelvin, humidity, visibility)
            through, light = (
                air.transmittance(metres),
                InfraredSky(air=air).radiance(ways(np.sort(zenith))),
            )
            assert (
                (through >= 0.0).all()
                and (through <= 1.0).all()
                and (np.diff(through, axis=0) <= 0.0).all()
            )
            assert (np.diff(light, axis=0) > -1e-9).all() and (
                light <= air.black_body(kelvin) * (1.0 + 1e-9)
            ).all()
            for degrees in (-1.0, 0.0, 0.01, 2.0):
                sunlight = InfraredSky(air=air, sun=ways([90.0 - degrees])[0]).sunlight
                assert np.isfinite(sunlight).all() and (sunlight >= 0.0).all()
        if notes_on_sky(air):
            assert "extrapolated to" in notes_on_sky(air)[0]
            found.add((kelvin, humidity))
    dry = {(kelvin, 0.0) for kelvin in (223.0, 268.0, 293.0, 318.0)}
    assert found == dry | {(223.0, 0.5), (223.0, 1.0), (268.0, 0.5), (318.0, 0.5), (318.0, 1.0)}


def test_below_the_horizon_is_ground_at_the_airs_temperature_and_clouds_are_warm():
    clear = sky(288.2, 1.42, (8.0, 12.0))
    ground = clear.radiance(ways([100.0, 180.0])).sum(axis=1)
    assert apparent_temperature(ground, (8.0, 12.0)) == pytest.approx(288.2)
    overcast = sky(288.2, 1.42, (8.0, 12.0), cloud=1.0).radiance(ways([0.0, 80.0])).sum(axis=1)
    seen = apparent_temperature(overcast, (8.0, 12.0))
    assert (seen > 288.2 - 6.5).all() and (seen < 288.2).all() and seen[1] > seen[0]
    rings = ring_radiance(clear).sum(axis=1)
    assert (np.diff(rings) < 0.0).all()


def test_the_sun_in_the_infrared_is_that_of_the_sheet():
    """21.8 W/m2 from 3 to 5 um and 1.30 from 8 to 12 um above the air, less on the ground, less
    under cloud.
    """
    up = np.array([0.0, 0.0, 1.0])
    for band, outside in (((3.0, 5.0), 21.8), ((8.0, 12.0), 1.30)):
        dry = sky(288.2, 0.0, band, sun=up)
        lost = dry.sunlight / dry.clear_transmittance(np.array([1.0]))[0]
        assert lost.sum() == pytest.approx(outside, rel=0.005)
        assert 0.3 < sky(288.2, 1.42, band, sun=up).sunlight.sum() / outside < 0.9
        assert (
            sky(288.2, 1.42, band, sun=up, cloud=1.0).sunlight.sum()
            == 0.0
            == sky(288.2, 1.42, band).sunlight.sum()
        )


def still(longwave: float) -> Weather:
    """Return weather of one step with a longwave, W m-2."""
    at = {
        "air_k": 289.15,
        "dew_point_k": 283.6,
        "pressure_hpa": 1000.0,
        "wind_m_s": 1.0,
        "longwave_w_m2": longwave,
    }
    return Weather(
        location=ObserverLocation(latitude_deg=43.0, longitude_deg=-77.0, altitude_m=0.0),
        moment=datetime.fromisoformat("1998-06-24T02:00:00-04:00"),
        direct_w_m2=np.zeros(1),
        diffuse_w_m2=np.zeros(1),
        notes=(),
        **{name: np.array([value]) for name, value in at.items()},
    )


def test_cloud_follows_from_the_longwave_of_the_weather():
    black = STEFAN_BOLTZMANN * 289.15**4
    clear = sky_of((8.0, 12.0), still(0.70 * black), State())
    half = sky_of((8.0, 12.0), still(0.88 * black), State())
    assert (
        clear.cloud
        == 0.0
        < half.cloud
        < 1.0
        == sky_of((8.0, 12.0), still(1.05 * black), State()).cloud
    )
    assert clear.sun is None and clear.air.vapour_g_m3 == pytest.approx(9.45, abs=0.1)


def modtran(shared_data):
    path = shared_data / "modtran5_pybsm" / "level_paths_2m.npz"
    if not path.exists():
        pytest.skip("the level paths of MODTRAN 5 are not here")
    with np.load(path) as file:
        return {name: file[name].astype(float) for name in file.files}


# Of the mid-latitude summer at the ground; the air of the database's paths emits as that 1 km up
# does, opaque bands over 100 m as well, where no air but that of the ground can be seen.
GROUND_K, PATH_K, VAPOUR_G_M3 = 294.2, 289.7, 14.0


# MODTRAN 5.2 of the same database from a sensor 32.5 m up, whose paths are as long as they should
# be: band, visibility, km, transmittance weighted by a black body of the ground's air, over
# `LONG_M`.
LONG_M = (1000.0, 2000.0, 3000.0, 5000.0, 8000.0)
LONG_PATHS = [
    ((3.0, 5.0), 23.0, (0.516, 0.397, 0.324, 0.238, 0.168)),
    ((3.0, 5.0), 5.0, (0.484, 0.349, 0.268, 0.173, 0.101)),
    ((8.0, 12.0), 23.0, (0.731, 0.565, 0.443, 0.282, 0.153)),
    ((8.0, 12.0), 5.0, (0.692, 0.505, 0.374, 0.212, 0.097)),
    ((8.0, 14.0), 23.0, (0.630, 0.458, 0.346, 0.210, 0.110)),
    ((8.0, 14.0), 5.0, (0.597, 0.411, 0.293, 0.159, 0.070)),
]


@pytest.mark.parametrize(("band", "visibility_km", "expected"), LONG_PATHS)
def test_air_absorbs_as_modtran_to_8_km(band, visibility_km, expected):
    """Transmittance within 0.01, and what is absorbed, and emitted, within 2 %."""
    air = summer_air(band, visibility_km)
    found = weighted(air, air.transmittance(LONG_M))
    assert found == pytest.approx(expected, abs=0.01)
    assert 1.0 - found == pytest.approx(1.0 - np.array(expected), rel=0.02)


def summer_air(band, visibility_km: float) -> InfraredAir:
    return InfraredAir(
        edges_um=bins_of(band),
        temperature_k=GROUND_K,
        vapour_g_m3=VAPOUR_G_M3,
        visibility_km=visibility_km,
    )


def test_emission_of_paths_is_modtrans_to_2_km(shared_data):
    """Transmittance within 0.01, emission within 5 % of the path's own, from 0.1 km on."""
    known = modtran(shared_data)
    um = known["wavelength_um"]
    black = band_radiance(um - 0.005, um + 0.005, GROUND_K)
    for band in ((8.0, 12.0), (8.0, 14.0), (3.0, 5.0)):
        inside = (um >= band[0] - 1e-6) & (um <= band[1] + 1e-6)
        for number in np.flatnonzero(known["range_km"] < 2.5):
            through, emitted = (
                known["transmission"][number, inside],
                known["path_thermal"][number, inside],
            )
            air = summer_air(band, float(known["visibility_km"][number]))
            ours = air.transmittance([1e3 * known["range_km"][number]])
            theirs = through @ black[inside] / black[inside].sum()
            assert weighted(air, ours)[0] == pytest.approx(theirs, abs=0.01)
            path = ((1.0 - ours) @ air.black_body(PATH_K))[0]
            assert path == pytest.approx(np.trapezoid(emitted, um[inside]), rel=0.05)


def test_the_visible_and_near_infrared_air_agrees_with_modtran_to_2_km(shared_data):
    known = modtran(shared_data)
    um = known["wavelength_um"]
    for low, high in ((0.5, 0.7), (0.85, 0.9)):
        inside = (um >= low) & (um <= high)
        for number in np.flatnonzero(known["range_km"] < 2.5):
            air = Atmosphere(
                visibility_km=float(known["visibility_km"][number]),
                temperature_c=21.05,
                relative_humidity=0.763,
            )
            ours = air.transmittance([1e3 * known["range_km"][number]], 1e3 * um[inside])[:, 0]
            assert ours.mean() == pytest.approx(
                known["transmission"][number, inside].mean(), abs=0.03
            )
