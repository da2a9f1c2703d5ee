"""The weather up to a scene's time, in steps: of files, or of a synthetic day through the scene's numbers."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.radiance.outdoor.scene import Weather as State
from simulate.radiance.sky.moon import EARTH_RADIUS_KM, ObserverLocation
from simulate.radiance.spectrum import STEFAN_BOLTZMANN
from simulate.thermal.clear_day import clear_sun, course, sky_emissivity, solar_hour, sun_directions, sun_under_cloud
from simulate.thermal.slab import ZERO_C, dew_point_k
from simulate.thermal.thresholds import LIMITS

Array = NDArray[np.floating]
# Of each quantity its column in a kind of file, our unit over that of the file, and from where on it is missing.
Columns = Mapping[str, tuple[int | str, float, float]]
# fmt: off
EPW: Columns = {
    "air_c": (6, 1.0, 99.9), "dew_point_c": (7, 1.0, 99.9), "pressure_hpa": (9, 0.01, 999999.0),
    "longwave_w_m2": (12, 1.0, 9999.0), "direct_w_m2": (14, 1.0, 9999.0), "diffuse_w_m2": (15, 1.0, 9999.0),
    "wind_m_s": (21, 1.0, 999.0),
}
TMY3: Columns = {
    "air_c": ("Dry-bulb (C)", 1.0, -9900.0), "dew_point_c": ("Dew-point (C)", 1.0, -9900.0),
    "pressure_hpa": ("Pressure (mbar)", 1.0, -9900.0), "direct_w_m2": ("DNI (W/m^2)", 1.0, -9900.0),
    "diffuse_w_m2": ("DHI (W/m^2)", 1.0, -9900.0), "wind_m_s": ("Wspd (m/s)", 1.0, -9900.0),
    "cloud": ("TotCld (tenths)", 0.1, -9900.0),
}
SURFRAD: Columns = {
    "direct_w_m2": (12, 1.0, -9999.0), "diffuse_w_m2": (14, 1.0, -9999.0), "longwave_w_m2": (16, 1.0, -9999.0),
    "air_c": (38, 1.0, -9999.0), "humidity": (40, 0.01, -9999.0), "wind_m_s": (42, 1.0, -9999.0),
    "pressure_hpa": (46, 1.0, -9999.0),
}
# fmt: on
DATE, HOUR = "Date (MM/DD/YYYY)", "Time (HH:MM)"
OWN = ("air_c", "dew_point_c", "wind_m_s", "direct_w_m2", "diffuse_w_m2")
OWN_OPTIONAL = ("longwave_w_m2", "pressure_hpa", "cloud")
OWN_PLACE = ("latitude_deg", "longitude_deg", "altitude_m")


@dataclass(frozen=True, kw_only=True)
class Record:
    """Rows of a weather file.

    Parameters
    ----------
    name, place
        Its name, and where it was recorded.
    time_s
        Seconds since 1970 UTC, ascending, shape (row,).
    columns
        By names as in `EPW`, shape (row,); NaN where a value is missing. Sunlight is the mean of the time before.
    interval_s
        Time between rows, s.
    notes
        Where values come from, in sentences.
    """

    name: str
    place: ObserverLocation
    time_s: Array
    columns: dict[str, Array]
    interval_s: float
    notes: tuple[str, ...]


def read_weather(path: Path, moment: datetime) -> Record:
    """Return the rows of a weather file; those of a typical year as of the years up to a moment.

    Raises
    ------
    BadInput
        If the file is of no known kind, or is not a complete one of its kind.
    """
    readers = {".epw": _epw, ".dat": _surfrad, ".csv": _csv}
    if path.suffix.lower() not in readers:
        raise BadInput(f"a weather file must be one of {', '.join(readers)}, got {path.name}")
    try:
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
        return readers[path.suffix.lower()](path.name, lines, moment)
    except BadInput:
        raise
    except FileNotFoundError:
        raise BadInput(f"a weather file must exist to be read, got {path}") from None
    except (OSError, ValueError, IndexError, KeyError, AttributeError) as error:
        kind = path.suffix.lower()
        raise BadInput(f"{path.name} must be a complete weather file of its kind ({kind}): {error}") from None


def _epw(name: str, lines: list[str], moment: datetime) -> Record:
    head, rows = lines[0].split(","), [line.split(",") for line in lines[8:]]
    dates = [(int(row[1]), int(row[2]), int(row[3])) for row in rows]
    note = f"longwave of {name} is as the file gives it; most EPW files hold that of a model, not a measurement"
    return _typical_year(name, head[6:10], dates, float(head[8]), _read(rows, EPW), moment, note)


def _tmy3(name: str, lines: list[str], moment: datetime) -> Record:
    head, rows = lines[0].split(","), list(csv.DictReader(lines[1:]))
    dates = [(*map(int, row[DATE].split("/")[:2]), int(row[HOUR].split(":")[0])) for row in rows]
    place = [head[4], head[5], head[3], head[6]]
    return _typical_year(name, place, dates, float(head[3]), _read(rows, TMY3), moment, f"{name} has no longwave")


def _typical_year(
    name: str, place: list[str], dates: list, zone_h: float, columns: dict[str, Array], moment: datetime, note: str
) -> Record:
    """Rows of a typical year, whose hours stamp their end, as of the year of a moment and the one before."""
    zone, found = timezone(timedelta(hours=zone_h)), []
    for year in (moment.year - 1, moment.year):
        for row, (month, day, hour) in enumerate(dates):
            if (month, day) != (2, 29):
                found.append(((datetime(year, month, day, tzinfo=zone) + timedelta(hours=hour)).timestamp(), row))
    found.sort()
    time_s, picked = np.array([time for time, _ in found]), np.array([row for _, row in found])
    return Record(
        name=name,
        place=_place(place[0], place[1], place[3]),
        time_s=time_s,
        columns={column: values[picked] for column, values in columns.items()},
        interval_s=3600.0,
        notes=(f"{name} is of a typical year, whose months are of different years", note),
    )


def _surfrad(name: str, lines: list[str], moment: datetime) -> Record:
    latitude, longitude, altitude = lines[1].split()[:3]
    rows = [line.split() for line in lines[2:]]
    columns = _read(rows, SURFRAD)
    humidity = np.clip(columns.pop("humidity"), 0.01, 1.0)
    # Sensors read a few W/m2 below zero at night.
    sunlight = {column: np.maximum(columns[column], 0.0) for column in ("direct_w_m2", "diffuse_w_m2")}
    time_s = [datetime(*(int(row[n]) for n in (0, 2, 3, 4, 5)), tzinfo=UTC).timestamp() for row in rows]
    return Record(
        name=name,
        # Stations are in the United States: longitudes are west, whether signed or not.
        place=_place(latitude, -abs(float(longitude)), altitude),
        time_s=np.array(time_s),
        columns=columns | sunlight | {"dew_point_c": dew_point_k(columns["air_c"] + ZERO_C, humidity) - ZERO_C},
        interval_s=60.0,
        notes=(f"longwave of {name} was measured; its sunlight below zero counts as zero",),
    )


def _csv(name: str, lines: list[str], moment: datetime) -> Record:
    if any(DATE in line for line in lines[:2]):
        return _tmy3(name, lines, moment)
    comments = ",".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    place = {key.strip(): value for key, _, value in (part.partition("=") for part in comments.split(","))}
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    headings = {*place, *(rows[0] if rows else ())}
    for lacking in (needed for needed in (*OWN_PLACE, "time", *OWN) if needed not in headings):
        raise BadInput(
            f"a weather .csv must have a line '# {' = ..., '.join(OWN_PLACE)} = ...' and the headings time, "
            f"{', '.join(OWN)} and perhaps {', '.join(OWN_OPTIONAL)}, got {name} without {lacking}"
        )
    if len(rows) < 2:
        raise BadInput(f"a weather file must cover a day, got {name} with {len(rows)} row")
    times = [datetime.fromisoformat(row["time"]) for row in rows]
    if any(time.tzinfo is None for time in times):
        raise BadInput(f"times of a weather file must state their offset from UTC, got others in {name}")
    time_s = np.array([time.timestamp() for time in times])
    present = {column: (column, 1.0, np.inf) for column in (*OWN, *OWN_OPTIONAL) if column in headings}
    return Record(
        name=name,
        place=_place(*(place[key] for key in OWN_PLACE)),
        time_s=time_s,
        columns=_read(rows, present),
        interval_s=float(np.median(np.diff(time_s))),
        notes=(f"longwave of {name} is as the file gives it",) if "longwave_w_m2" in present else (),
    )


def _read(rows: Sequence[Any], columns: Columns) -> dict[str, Array]:
    """Return columns of rows in our units, NaN where a value is missing."""
    found = {}
    for name, (column, unit, missing) in columns.items():
        values = np.array([float(row[column] or np.nan) for row in rows])
        gone = values <= missing if missing < 0.0 else values >= missing
        found[name] = np.where(gone, np.nan, unit * values)
    return found


def _place(latitude: str, longitude: str | float, altitude: str) -> ObserverLocation:
    return ObserverLocation(latitude_deg=float(latitude), longitude_deg=float(longitude), altitude_m=float(altitude))


DAY_STEPS = round(86400.0 / LIMITS.step_s)
# Sunlight of hours is interpolated as a fraction of the clear sky's where that is more, W m-2.
SHINES_W_M2 = 10.0
STANDARD_HPA, SCALE_M = 1013.25, 8434.5
MODELLED = "longwave of the sky was modelled (Berdahl and Martin), not measured: uncertain by 15 W/m2"


@dataclass(frozen=True, kw_only=True)
class Weather:
    """Weather at the ends of steps of `LIMITS.step_s`, the last of which is the scene's time; arrays of shape (step,).

    Parameters
    ----------
    place, moment
        Where, and when it ends.
    air_k, dew_point_k
        Temperature and dew point of the air, K.
    wind_m_s, pressure_hpa
        At 10 m, m/s; hPa.
    direct_w_m2, diffuse_w_m2
        Direct normal and diffuse horizontal irradiance of the sun, W m-2.
    longwave_w_m2
        Longwave irradiance of level ground by the sky, W m-2.
    notes
        Where it comes from and what of it was modelled, in sentences.
    """

    place: ObserverLocation
    moment: datetime
    air_k: Array
    dew_point_k: Array
    wind_m_s: Array
    pressure_hpa: Array
    direct_w_m2: Array
    diffuse_w_m2: Array
    longwave_w_m2: Array
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.air_k)

    @cached_property
    def times(self) -> list[datetime]:
        """Ends of the steps."""
        return _times(self.moment, len(self))

    @cached_property
    def sun(self) -> Array:
        """Direction of the sun, shape (step, 3)."""
        return sun_directions(self.place, self.times)[0]

    @property
    def global_w_m2(self) -> Array:
        """Sunlight on level ground, shape (step,), W m-2."""
        return self.direct_w_m2 * np.maximum(self.sun[:, 2], 0.0) + self.diffuse_w_m2


def weather_of(scene: OutdoorScene) -> Weather:
    """Return the weather before a scene's time: a day, or the full days that its files cover.

    Raises
    ------
    BadInput
        If the scene has no place or no weather with wind, or its file has gaps, another date or a place far away.
    """
    where, state = scene.place, scene.weather
    if where is None:
        raise BadInput(f"a scene must have a [place] with a time for surface temperatures, got none in {scene.name!r}")
    if state is None or (state.wind_m_s is None and not state.file):
        raise BadInput(
            "a scene must have a [weather] with wind_m_s or with a file for surface temperatures, got "
            f"{'none' if state is None else 'neither'} in {scene.name!r}"
        )
    place = ObserverLocation(
        latitude_deg=where.latitude_deg, longitude_deg=where.longitude_deg, altitude_m=where.altitude_m
    )
    if not state.file:
        return _synthetic_day(state, place, where.moment)
    names = (state.file,) if isinstance(state.file, str) else state.file
    return weather_from_files([scene.file(name) for name in names], place, where.moment, state.linke_turbidity)


def _times(moment: datetime, steps: int) -> list[datetime]:
    return [moment - timedelta(seconds=(steps - 1 - step) * LIMITS.step_s) for step in range(steps)]


def _synthetic_day(state: State, place: ObserverLocation, moment: datetime) -> Weather:
    """A day that passes through the state at the scene's time."""
    times = _times(moment, DAY_STEPS)
    sun, distance = sun_directions(place, times)
    hour, pressure = solar_hour(place, times), np.full(DAY_STEPS, _pressure(place))
    air, wind = course(hour, sun[:, 2] > 0.0)
    if state.day == "constant":
        air, wind = np.zeros(DAY_STEPS), np.ones(DAY_STEPS)
    air_k = ZERO_C + state.temperature_c + state.daily_swing_k * (air - air[-1])
    if state.dew_point_c is None and not 0.0 < state.relative_humidity <= 1.0:
        raise BadInput(f"relative_humidity must lie above 0 and up to 1, got {state.relative_humidity:g}")
    dew = dew_point_k(ZERO_C + state.temperature_c, state.relative_humidity)
    dew = float(dew if state.dew_point_c is None else ZERO_C + state.dew_point_c)
    dew_k, coldest = np.full(DAY_STEPS, min(dew, air_k.min())), air_k.min()
    notes = (f"weather of a {state.day} day through the state at {moment.isoformat()}", MODELLED)
    if dew > coldest:
        notes += (
            f"the dew point is that of the day's coldest air, {coldest - ZERO_C:.1f} C, not {dew - ZERO_C:.1f} C",
        )
    direct, diffuse = clear_sun(sun[:, 2], distance, place.altitude_m, state.linke_turbidity)
    direct, diffuse = sun_under_cloud(direct, diffuse, sun[:, 2], state.cloud)
    return Weather(
        place=place,
        moment=moment,
        air_k=air_k,
        dew_point_k=dew_k,
        wind_m_s=(state.wind_m_s or 0.0) * wind / wind[-1],
        pressure_hpa=pressure,
        direct_w_m2=direct,
        diffuse_w_m2=diffuse,
        longwave_w_m2=sky_emissivity(dew_k, hour, pressure, state.cloud) * STEFAN_BOLTZMANN * air_k**4,
        notes=notes,
    )


def weather_from_files(paths: list[Path], place: ObserverLocation, moment: datetime, turbidity: float = 3.8) -> Weather:
    """Return the weather of files up to a moment; see `weather_of`."""
    records = [read_weather(path, moment) for path in paths]
    names = ", ".join(record.name for record in records)
    away = max(_distance_km(record.place, place) for record in records)
    if away > LIMITS.farthest_km:
        raise BadInput(
            f"a weather file must be from within {LIMITS.farthest_km:g} km of the scene, got {names} {away:.0f} km away"
        )
    record = _join(records, names)
    begins = np.concatenate([record.time_s[:1], record.time_s[1:][np.diff(record.time_s) > 2.0 * record.interval_s]])
    begin = begins[begins <= moment.timestamp()].max(initial=record.time_s[0])
    covered = (moment.timestamp() - begin + record.interval_s) / 86400.0
    times = _times(moment, DAY_STEPS * int(np.clip(covered, 1, LIMITS.max_weather_days)))
    found = {name: _column_at(record, name, times) for name in record.columns}
    sun, distance = sun_directions(place, times)
    clear = clear_sun(sun[:, 2], distance, place.altitude_m, turbidity)
    for name, light in zip(("direct_w_m2", "diffuse_w_m2"), clear, strict=True):
        if record.interval_s > LIMITS.step_s:
            found[name] = _sunlight(record, name, times, light)
    air_k, dew_k = (found[name] + ZERO_C for name in ("air_c", "dew_point_c"))
    pressure = found.get("pressure_hpa", np.full(len(times), _pressure(place)))
    notes = tuple(note for record in records for note in record.notes)
    if "longwave_w_m2" not in found:
        cloud = found.get("cloud", np.zeros(len(times)))
        emissivity = sky_emissivity(dew_k, solar_hour(place, times), pressure, cloud)
        found["longwave_w_m2"] = emissivity * STEFAN_BOLTZMANN * air_k**4
        notes += (MODELLED if "cloud" in found else f"{MODELLED}, for a clear sky",)
    return Weather(
        place=place,
        moment=moment,
        air_k=air_k,
        dew_point_k=np.minimum(dew_k, air_k),
        pressure_hpa=pressure,
        notes=(f"weather of {names}, {away:.0f} km away", *notes),
        **{name: found[name] for name in ("wind_m_s", "direct_w_m2", "diffuse_w_m2", "longwave_w_m2")},
    )


def _join(records: list[Record], names: str) -> Record:
    """Return the rows of several files, with the columns that all have."""
    first = records[0]
    time_s, order = np.unique(np.concatenate([record.time_s for record in records]), return_index=True)
    common = [name for name in first.columns if all(name in record.columns for record in records)]
    columns = {name: np.concatenate([record.columns[name] for record in records])[order] for name in common}
    return replace(first, name=names, time_s=time_s, columns=columns)


def _column_at(record: Record, name: str, times: list[datetime]) -> Array:
    """Return a column at times, linear between rows; gaps longer than a step or a row are refused."""
    seconds = np.array([time.timestamp() for time in times])
    fine = np.isfinite(record.columns[name])
    known = record.time_s[fine]
    # Rows stand for the interval before or around them: one may lack at either end.
    ends = [seconds[0] - record.interval_s, seconds[-1] + record.interval_s]
    inside = np.concatenate([ends[:1], known[(known > ends[0]) & (known < ends[1])], ends[1:]])
    gap = int(np.argmax(np.diff(inside)))
    if inside[gap + 1] - inside[gap] > max(LIMITS.step_s, 1.01 * record.interval_s):
        start, end = (datetime.fromtimestamp(inside[index], UTC).isoformat() for index in (gap, gap + 1))
        raise BadInput(
            f"a weather file must cover the day before the scene's time without gaps, got {record.name} without {name} "
            f"between {start} and {end}"
        )
    return np.interp(seconds, known, record.columns[name][fine])


def _sunlight(record: Record, name: str, times: list[datetime], clear: Array) -> Array:
    """Return sunlight at times from means over hours: their fraction of the clear sky's is interpolated."""
    seconds = np.array([time.timestamp() for time in times])
    total = np.concatenate([[0.0], np.cumsum(0.5 * (clear + np.concatenate([clear[:1], clear[:-1]]))) * LIMITS.step_s])
    ends = np.concatenate([[seconds[0] - LIMITS.step_s], seconds])
    mean = np.interp(record.time_s, ends, total) - np.interp(record.time_s - record.interval_s, ends, total)
    mean /= record.interval_s
    within = (record.time_s - record.interval_s >= ends[0]) & (record.time_s <= ends[-1])
    lit = (mean > SHINES_W_M2) & within & np.isfinite(record.columns[name])
    if not lit.any():
        return np.zeros(len(times))
    middle = record.time_s[lit] - 0.5 * record.interval_s
    return clear * np.interp(seconds, middle, record.columns[name][lit] / mean[lit])


def _pressure(place: ObserverLocation) -> float:
    return float(STANDARD_HPA * np.exp(-place.altitude_m / SCALE_M))


def _distance_km(one: ObserverLocation, other: ObserverLocation) -> float:
    """Distance of two places, straight through the earth, km."""
    points = []
    for place in (one, other):
        latitude, longitude = np.deg2rad([place.latitude_deg, place.longitude_deg])
        level = np.cos(latitude)
        points.append(np.array([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)]))
    return float(EARTH_RADIUS_KM * np.linalg.norm(points[0] - points[1]))
