"""The weather of a day: clear skies against tables, files with their stamps and gaps, and a
measured day.
"""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance import STEFAN_BOLTZMANN
from simulate.radiance.outdoor import OutdoorScene, SceneCamera, Where
from simulate.radiance.outdoor import Weather as State
from simulate.radiance.sky import ObserverLocation
from simulate.thermal import (
    ZERO_C,
    Columns,
    clear_sun,
    dew_point_k,
    march,
    periodic_start,
    sky_emissivity,
    sky_radiance,
    sun_directions,
    temperatures,
    vapour_pressure_pa,
    weather_from_files,
    weather_of,
)
from simulate.thermal import weather as weather_module
from tests.simulate.thermal.slabs import forcing_of

ROCHESTER = ObserverLocation(latitude_deg=43.16, longitude_deg=-77.61, altitude_m=150.0)
EASTERN = timezone(timedelta(hours=-4))
NOON = datetime(1998, 6, 23, 12, tzinfo=EASTERN)


def scene_of(**weather) -> OutdoorScene:
    """Return an empty scene in Rochester at two in the morning."""
    where = Where(
        latitude_deg=43.16, longitude_deg=-77.61, altitude_m=150.0, time="1998-06-24T02:00:00-04:00"
    )
    return OutdoorScene(
        name="night",
        camera=SceneCamera(position_m=(0.0, 0.0, 1.0), look_at_m=(0.0, 1.0, 1.0)),
        place=where,
        weather=State(**weather),
    )


def test_the_clear_sun_is_that_of_another_code():
    # pvlib's Ineichen at Rochester on 1998-06-23, turbidity 3.79: direct and diffuse at 13, 10 and
    # 19 h.
    times = [datetime(1998, 6, 23, hour, tzinfo=EASTERN) for hour in (13, 10, 19)]
    sun, distance = sun_directions(ROCHESTER, times)
    direct, diffuse = clear_sun(sun[:, 2], distance, 150.0, 3.79)
    assert direct == pytest.approx([844.0, 779.0, 498.0], rel=0.01)
    assert diffuse == pytest.approx([133.0, 114.0, 67.0], rel=0.01)


def test_dew_points_and_vapour_pressures():
    assert vapour_pressure_pa(ZERO_C + 5.020) == pytest.approx(872.9, rel=1e-3)
    assert dew_point_k([283.15, 293.15, 273.15], [0.712, 0.5, 0.7]) - ZERO_C == pytest.approx(
        [5.020, 9.255, -4.824], abs=0.02
    )


def test_the_clear_sky_has_the_emissivity_of_berdahl_and_martin():
    # At 06 h the term of the hour is 0.
    found = sky_emissivity(ZERO_C + np.array([5.020, 9.255, -4.824]), np.full(3, 6.0), 1000.0, 0.0)
    assert found == pytest.approx([0.7409, 0.7691, 0.6857], abs=2e-4)
    assert sky_emissivity(np.array([283.15]), np.array([6.0]), 1000.0, 1.0) > 0.97


def test_the_sky_by_directions_has_its_mean_and_lights_walls_more():
    emissivity, air, dew = (
        np.array([0.72, 0.78, 0.84]),
        np.array([288.0, 294.0, 300.0]),
        np.array([279.0, 289.0, 297.0]),
    )
    square = (np.arange(400) + 0.5) / 400.0
    black = STEFAN_BOLTZMANN * air**4
    rings = sky_radiance(emissivity, air, dew, np.sqrt(square))
    assert rings.mean(axis=1) == pytest.approx(emissivity * black, rel=1e-4)
    zenith = sky_radiance(emissivity, air, dew, np.array([1.0]))[:, 0] / black
    assert zenith == pytest.approx(0.945 * emissivity, rel=0.01)
    # On a wall, over the sphere: cosine to the wall times solid angle, by height and azimuth.
    height, azimuth = np.meshgrid(
        (np.arange(300) + 0.5) * np.pi / 600.0, (np.arange(60) + 0.5) * np.pi / 120.0
    )
    weight = np.cos(height) ** 2 * np.cos(azimuth)
    on_wall = (
        sky_radiance(emissivity, air, dew, np.sin(height).ravel()) @ weight.ravel() / weight.sum()
    )
    assert on_wall / (emissivity * black) == pytest.approx(1.065, abs=0.012)
    even = sky_radiance(np.array([1.0, 1.02]), air[:2], dew[:2], np.array([0.0, 0.5, 1.0]))
    assert even / black[:2, None] == pytest.approx(np.array([[1.0] * 3, [1.02] * 3]))


def test_a_clear_day_passes_through_the_state_of_the_scene():
    weather = weather_of(scene_of(temperature_c=16.0, relative_humidity=0.7, wind_m_s=1.0))
    assert len(weather) == weather_module.DAY_STEPS and weather.times[-1] == datetime(
        1998, 6, 24, 6, tzinfo=UTC
    )
    assert weather.air_k[-1] == ZERO_C + 16.0 and weather.wind_m_s[-1] == 1.0
    assert np.ptp(weather.air_k) == pytest.approx(12.0, abs=0.2)
    hour = np.array([time.hour for time in weather.times])
    assert 3 <= hour[weather.air_k.argmin()] <= 5 and 15 <= hour[weather.air_k.argmax()] <= 17
    assert np.abs(np.diff(weather.air_k)).max() < 0.35
    assert 13 <= hour[weather.wind_m_s.argmax()] <= 16
    assert weather.dew_point_k == pytest.approx(ZERO_C + 10.5, abs=0.1)
    assert any("modelled" in note for note in weather.notes)
    calm = weather_of(scene_of(temperature_c=16.0, wind_m_s=1.0, day="constant"))
    assert np.ptp(calm.air_k) == 0.0 == np.ptp(calm.wind_m_s)


def test_clouds_take_the_sun_and_warm_the_sky():
    clear, cloudy = (weather_of(scene_of(wind_m_s=1.0, cloud=cloud)) for cloud in (0.0, 1.0))
    assert cloudy.direct_w_m2.max() == 0.0 and cloudy.diffuse_w_m2.max() > clear.diffuse_w_m2.max()
    assert cloudy.global_w_m2.sum() == pytest.approx(0.25 * clear.global_w_m2.sum())
    assert (cloudy.longwave_w_m2 > 1.1 * clear.longwave_w_m2).all()


def hours_of(place, first, count):
    """Return ends of hours and the means of the clear sun over them, direct and diffuse."""
    ends = [first + timedelta(hours=hour + 1) for hour in range(count)]
    fine = [end - timedelta(seconds=150.0 + 300.0 * part) for end in ends for part in range(12)]
    sun, distance = sun_directions(place, fine)
    light = clear_sun(sun[:, 2], distance, place.altitude_m, 3.8)
    return ends, [part.reshape(-1, 12).mean(axis=1) for part in light]


def epw(path, *, cut=slice(None), wind="2.0", longwave="310", dim_until=0):
    """Write an EPW of four clear days at Rochester, dim until an hour of standard time, and return
    the path.
    """
    first = datetime(1998, 6, 21, 0, tzinfo=timezone(timedelta(hours=-5)))
    _, (direct, diffuse) = hours_of(ROCHESTER, first, 96)
    rows = ["LOCATION,Rochester,NY,USA,TEST,725290,43.16,-77.61,-5.0,150.0", *["X"] * 7]
    for hour in range(96):
        time = first + timedelta(hours=hour)
        warm, dim = 15 + hour % 24 / 2, 0.4 if time.hour < dim_until else 1.0
        row = [
            "1985",
            time.month,
            time.day,
            time.hour + 1,
            0,
            "flags",
            warm,
            10,
            70,
            99500,
            0,
            0,
            longwave,
            0,
        ]
        row += [f"{dim * direct[hour]:.1f}", f"{diffuse[hour]:.1f}", 0, 0, 0, 0, 180, wind, 0, 0]
        rows.append(",".join(map(str, row)))
    path.write_text("\n".join([*rows[:8], *rows[8:][cut]]))
    return path


def test_hours_of_an_epw_stamp_their_end_and_sunlight_follows_the_clear_sky(tmp_path):
    weather = weather_from_files([epw(tmp_path / "roc.epw")], ROCHESTER, NOON)
    clear, _ = clear_sun(weather.sun[:, 2], sun_directions(ROCHESTER, weather.times)[1], 150.0, 3.8)
    high = weather.sun[:, 2] > 0.1
    assert weather.direct_w_m2[high] == pytest.approx(clear[high], rel=0.03)
    assert weather.direct_w_m2[weather.sun[:, 2] <= 0.0].max() == 0.0
    assert weather.longwave_w_m2 == pytest.approx(310.0)
    # Noon of summer time is 11 h of standard time: the end of the file's hour 11, which has 15 +
    # 10/2.
    assert weather.air_k[-1] - ZERO_C == pytest.approx(20.0)
    assert any("model" in note for note in weather.notes) and any(
        "typical" in note for note in weather.notes
    )
    assert any("in steps of 60 minutes" in note for note in weather.notes)


def test_sunlight_of_hours_belongs_to_their_middle(tmp_path):
    weather = weather_from_files([epw(tmp_path / "roc.epw", dim_until=10)], ROCHESTER, NOON)
    clear, _ = clear_sun(weather.sun[:, 2], sun_directions(ROCHESTER, weather.times)[1], 150.0, 3.8)
    # Summer time is an hour ahead of the file's: its hour from 9 to 10 is dim, that from 10 to 11
    # is not.
    hour = np.array([time.hour + time.minute / 60.0 for time in weather.times])
    for at, part in ((10.5, 0.4), (11.0, 0.7), (11.5, 1.0)):
        last = np.flatnonzero(np.isclose(hour, at))[-1]
        assert weather.direct_w_m2[last] / clear[last] == pytest.approx(part, abs=0.03)


def test_a_tmy3_has_no_longwave_and_says_that_it_was_modelled(tmp_path):
    first = datetime(1998, 6, 21, 0, tzinfo=timezone(timedelta(hours=-5)))
    _, (direct, diffuse) = hours_of(ROCHESTER, first, 72)
    heading = (
        "Date (MM/DD/YYYY),Time (HH:MM),DNI (W/m^2),DHI (W/m^2),TotCld (tenths),Dry-bulb "
        "(C),Dew-point (C),"
    )
    rows = ['725290,"ROCHESTER",NY,-5.0,43.16,-77.61,150', heading + "Pressure (mbar),Wspd (m/s)"]
    for hour in range(72):
        date = first + timedelta(hours=hour)
        light = f"{direct[hour]:.1f},{diffuse[hour]:.1f}"
        rows.append(
            f"{date.month:02}/{date.day:02}/1990,{date.hour + 1:02}:00,{light},0,18,10,995,2"
        )
    path = tmp_path / "725290.csv"
    path.write_text("\n".join(rows))
    weather = weather_from_files([path], ROCHESTER, NOON)
    assert any("modelled" in note for note in weather.notes)
    black = STEFAN_BOLTZMANN * 291.15**4
    assert weather.longwave_w_m2 / black == pytest.approx(0.774, abs=0.015)
    assert weather.direct_w_m2.max() == pytest.approx(direct.max(), rel=0.03)


def own(
    path,
    *,
    minutes=10,
    cut=None,
    head="# latitude_deg = 43.2, longitude_deg = -77.5, altitude_m = 150",
    zone="-04:00",
):
    """Write a CSV of this project for a day and more up to noon, and return the path."""
    rows = [head, "time,air_c,dew_point_c,wind_m_s,direct_w_m2,diffuse_w_m2,longwave_w_m2"]
    for step in range(25 * 60 // minutes + 1):
        time = datetime(1998, 6, 22, 11) + timedelta(minutes=minutes * step)
        light = "600,100" if 6 <= time.hour < 20 else "0,0"
        rows.append(f"{time.isoformat()}{zone},18,10,2,{light},{300 + step}")
    if cut is not None:
        del rows[2 + cut]
    path.write_text("\n".join(rows))
    return path


def test_a_csv_of_this_project_is_read_as_it_is(tmp_path):
    weather = weather_from_files([own(tmp_path / "day.csv", minutes=5)], ROCHESTER, NOON)
    assert len(weather) == weather_module.DAY_STEPS
    assert weather.longwave_w_m2[[0, -1]] == pytest.approx([300 + 13, 300 + 300])
    by_day = np.array([6 <= time.hour < 20 for time in weather.times])
    assert (
        weather.direct_w_m2[by_day] == pytest.approx(600.0)
        and weather.direct_w_m2[~by_day].max() < 600.0
    )


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: epw(path / "a.epw", cut=slice(0, 30)), "must cover the day before"),
        (lambda path: epw(path / "a.epw", wind="999"), "without wind_m_s"),
        (lambda path: epw(path / "a.epw", longwave="9999"), "without longwave_w_m2"),
        (lambda path: path / "absent.epw", "must exist"),
        (lambda path: path / "day.xlsx", "must be one of .epw, .dat, .csv"),
        (lambda path: own(path / "b.csv", zone=""), "offset from UTC"),
        (
            lambda path: own(path / "b.csv", head="# latitude_deg = 43, altitude_m = 0"),
            "without longitude_deg",
        ),
        (
            lambda path: own(
                path / "b.csv", head="# latitude_deg = 40, longitude_deg = -77, altitude_m = 0"
            ),
            "km away",
        ),
        (lambda path: own(path / "b.csv", minutes=2000), "must cover a day"),
        (lambda path: own(path / "b.csv", minutes=300, cut=2), "without gaps"),
        (lambda path: _text(path / "c.dat", "x\n1 2 3\n2016 1 1 1"), "complete weather file"),
        (lambda path: _text(path / "c.epw", "LOCATION"), "complete weather file"),
        (lambda path: _text(path / "c.csv", ""), "without latitude_deg"),
        (
            lambda path: changed(epw(path / "a.epw"), 40, ",", 6, None),
            "22 columns in each row, got 6 in row 41",
        ),
        (lambda path: changed(epw(path / "a.epw"), 50, ",", 3, "25"), "from 1 to 24, got 25"),
        (lambda path: changed(epw(path / "a.epw"), 50, ",", 3, "0"), "from 1 to 24, got 0"),
        (
            lambda path: changed(epw(path / "a.epw"), 50, ",", 3, "5"),
            "times of a weather file must rise",
        ),
        (
            lambda path: changed(epw(path / "a.epw"), 50, ",", 6, "85"),
            "air_c .* must lie from -95 to 62, got 85 at",
        ),
        (
            lambda path: changed(epw(path / "a.epw"), 50, ",", 21, "-5"),
            "wind_m_s .* must lie from 0 to 115, got -5",
        ),
        (lambda path: changed(epw(path / "a.epw"), 0, ",", 8, "30"), "within 14 h of UTC, got 30"),
        (
            lambda path: changed(epw(path / "a.epw"), 0, ",", 8, "5"),
            "must fall by day, got .* below the horizon",
        ),
        (lambda path: changed(epw(path / "a.epw"), 0, ",", 6, "25.8"), "a.epw 19.. km away"),
        (lambda path: changed(own(path / "b.csv"), 1, ",", 3, "wind"), "without wind_m_s"),
        (
            lambda path: changed(own(path / "b.csv"), 50, ",", 1, "-9999.9"),
            "air_c .* got -9999.9 at",
        ),
        (
            lambda path: changed(own(path / "b.csv"), 50, ",", 1, "warm"),
            "could not convert string to float: 'warm'",
        ),
        (lambda path: own(path / "b.csv", zone="+08:00"), "must fall by day"),
        (
            lambda path: surfrad(path / "c.dat"),
            "without air_c between 1998-06-22T16:59:00.00:00 and",
        ),
    ],
)
def test_bad_weather_files_are_refused_in_one_sentence(tmp_path, write, words):
    with pytest.raises(BadInput, match=words) as refused:
        weather_from_files([write(tmp_path)], ROCHESTER, NOON)
    assert "\n" not in str(refused.value)


def changed(path, line, separator, column, value):
    """Replace a column of a line of a file, or, without a value, cut the line there, and return the
    path.
    """
    lines = path.read_text().split("\n")
    row = lines[line].split(separator)
    row = row[:column] if value is None else [*row[:column], value, *row[column + 1 :]]
    lines[line] = separator.join(row)
    path.write_text("\n".join(lines))
    return path


def surfrad(path):
    """Write a SURFRAD day at night's light whose air temperature is missing for an hour, and return
    the path.
    """
    rows = [" Rochester", "  43.16   77.61  150 m version 1"]
    for minute in range(25 * 60):
        time = datetime(1998, 6, 22, 15, 30, tzinfo=UTC) + timedelta(minutes=minute)
        row = ["0 0"] * 20
        row[4], row[15], row[16], row[17], row[19] = "350 0", "18 0", "60 0", "2 0", "995 0"
        if (time.day, time.hour) == (22, 17):
            row[15] = "-9999.9 1"
        stamp = (
            f"{time.year} 173 {time.month} {time.day} {time.hour} {time.minute} "
            f"{time.hour:.3f} 60.0"
        )
        rows.append(" ".join([stamp, *row]))
    return _text(path, "\n".join(rows))


def _text(path, text):
    path.write_text(text)
    return path


def test_scenes_without_place_or_weather_are_refused():
    scene = scene_of(wind_m_s=1.0)
    for changes, words in (
        ({"place": None}, "place"),
        ({"weather": None}, "weather"),
        ({"weather": State()}, "wind_m_s"),
    ):
        with pytest.raises(BadInput, match=words):
            weather_of(OutdoorScene(**{**vars(scene), **changes}))


def test_alamosa_is_met_with_nothing_fitted(shared_data):
    """Moist soil of the library, the default law of convection, the measured absorbed sun and
    longwave.
    """
    folder = shared_data / "surfrad_alamosa"
    if not folder.is_dir():
        pytest.skip("the two days of Alamosa are not among the shared data")
    files = [folder / "slv15365.dat", folder / "slv16001.dat"]
    place = ObserverLocation(latitude_deg=37.70, longitude_deg=-105.92, altitude_m=2317.0)
    weather = weather_from_files(files, place, datetime(2016, 1, 2, tzinfo=UTC))
    assert len(weather) == 2 * weather_module.DAY_STEPS and any(
        "measured" in note for note in weather.notes
    )
    rows = np.concatenate([np.loadtxt(file, skiprows=2) for file in files])[4::5]
    assert len(rows) == len(weather)
    absorbed = np.maximum(rows[:, 8] - rows[:, 10], 0.0)
    measured = ((rows[:, 22] - 0.03 * rows[:, 16]) / (0.97 * STEFAN_BOLTZMANN)) ** 0.25
    soil = temperatures.library()["moist-soil"]
    emissivity = float(soil.emissivity)
    forcing = forcing_of(
        (absorbed + emissivity * weather.longwave_w_m2)[:, None],
        weather.air_k,
        emissivity=emissivity,
        law="buoyant",
        wind_coefficient=float(soil.wind_coefficient),
        wind_m_s=weather.wind_m_s,
        vapour_pa=vapour_pressure_pa(weather.dew_point_k),
        pressure_hpa=weather.pressure_hpa,
    )
    columns = Columns.of([soil])
    _, start = periodic_start(columns, forcing.part(slice(0, weather_module.DAY_STEPS)))
    found = march(columns, forcing.part(slice(weather_module.DAY_STEPS, None)), start)[0][:, 0]
    exact, air = measured[weather_module.DAY_STEPS :], weather.air_k[weather_module.DAY_STEPS :]
    error = found - exact
    rms = float(np.sqrt(np.mean(error**2)))
    null = float(np.sqrt(np.mean((air - exact) ** 2)))
    print(f"RMSE {rms:.2f} K, bias {error.mean():+.2f}, surface = air {null:.2f}")
    print(f"max {found.max() - exact.max():+.2f}, min {found.min() - exact.min():+.2f} K")
    assert rms <= 2.0 and abs(error.mean()) <= 1.0
    assert found.max() == pytest.approx(exact.max(), abs=2.5) and found.min() == pytest.approx(
        exact.min(), abs=2.5
    )
    assert null == pytest.approx(4.4, abs=0.1)
