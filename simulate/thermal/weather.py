"""The weather up to a scene's time, in steps: of files, or of a synthetic day through the scene's own numbers."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.blackbody import STEFAN_BOLTZMANN
from simulate.radiance.sky.ephemeris import EARTH_RADIUS_KM, Place
from simulate.radiance.world.description.scene import Scene
from simulate.thermal.clear_day import (
    clear_sun,
    course,
    sky_emissivity,
    solar_hour,
    sun_directions,
    times_until,
    under_cloud,
)
from simulate.thermal.convection import ZERO_C, dew_point_k
from simulate.thermal.slab import STEP_S
from simulate.thermal.weather_files import SCALE_M, STANDARD_HPA, Record, read_weather

Array = NDArray[np.float64]
DAY_STEPS = round(86400.0 / STEP_S)
# Weather of a station farther away than this is refused, km.
FARTHEST_KM = 200.0
# Sunlight is interpolated over the clear sky's where that is more, W m-2.
SHINES_W_M2 = 10.0
MODELLED = "longwave of the sky was modelled by the formula of Berdahl and Martin, not measured: 15 W/m2 uncertain"


@dataclass(frozen=True, kw_only=True)
class Weather:
    """Weather at the ends of steps of `STEP_S`, the last of which is the scene's time.

    Parameters
    ----------
    place, moment
        Where, and when it ends.
    air_k, dew_point_k
        Temperature and dew point of the air, shape (step,), K.
    wind_m_s, pressure_hpa
        Shape (step,).
    direct_w_m2, diffuse_w_m2
        Direct normal and diffuse horizontal irradiance, shape (step,), W m-2.
    longwave_w_m2
        Longwave irradiance from the sky on level ground, shape (step,), W m-2.
    notes
        What is modelled and not measured, in sentences.
    """

    place: Place
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
        return times_until(self.moment, len(self), STEP_S)

    @cached_property
    def sun(self) -> Array:
        """Direction of the sun, shape (step, 3)."""
        return sun_directions(self.place, self.times)[0]

    @property
    def global_w_m2(self) -> Array:
        """Sunlight on level ground, shape (step,), W m-2."""
        return self.direct_w_m2 * np.maximum(self.sun[:, 2], 0.0) + self.diffuse_w_m2


def weather_of(scene: Scene, days: int = 1) -> Weather:
    """Return the weather before a scene's time.

    Parameters
    ----------
    scene
        The scene.
    days
        Days of a file that are used at least; more where it has more, up to 10.

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
            "a scene must have a [weather] with wind_m_s, or with a file, for surface temperatures, got "
            f"{'none' if state is None else 'neither'} in {scene.name!r}"
        )
    place = Place(latitude_deg=where.latitude_deg, longitude_deg=where.longitude_deg, altitude_m=where.altitude_m)
    if not state.file:
        return _synthetic(scene, place, where.moment)
    names = (state.file,) if isinstance(state.file, str) else state.file
    return from_files([scene.file(name) for name in names], place, where.moment, days, state.linke_turbidity)


def _synthetic(scene: Scene, place: Place, moment: datetime) -> Weather:
    """A day that passes through the state at the scene's time."""
    state = scene.weather
    assert state is not None and state.wind_m_s is not None
    times = times_until(moment, DAY_STEPS, STEP_S)
    sun, distance = sun_directions(place, times)
    hour = solar_hour(place, times)
    pressure = np.full(DAY_STEPS, STANDARD_HPA * np.exp(-place.altitude_m / SCALE_M))
    air, wind = course(hour, sun[:, 2] > 0.0)
    if state.day == "constant":
        air, wind = np.zeros(DAY_STEPS), np.ones(DAY_STEPS)
    air_k = ZERO_C + state.temperature_c + state.daily_swing_k * (air - air[-1])
    if state.dew_point_c is not None:
        dew = ZERO_C + state.dew_point_c
    elif 0.0 < state.relative_humidity <= 1.0:
        dew = float(dew_point_k(ZERO_C + state.temperature_c, state.relative_humidity))
    else:
        raise BadInput(
            f"relative_humidity must lie above 0 and up to 1 for a dew point, got {state.relative_humidity:g}"
        )
    dew_k = np.full(DAY_STEPS, min(dew, air_k.min()))
    notes = [f"weather of a {state.day} day through the state at {moment.isoformat()}", MODELLED]
    if dew > air_k.min():
        notes.append(
            f"the dew point is that of the day's coldest air, {air_k.min() - ZERO_C:.1f} C, not {dew - ZERO_C:.1f} C"
        )
    emissivity = sky_emissivity(dew_k, hour, pressure, state.cloud)
    direct, diffuse = clear_sun(sun[:, 2], distance, place.altitude_m, state.linke_turbidity)
    direct, diffuse = under_cloud(direct, diffuse, sun[:, 2], state.cloud)
    return Weather(
        place=place,
        moment=moment,
        air_k=air_k,
        dew_point_k=dew_k,
        wind_m_s=state.wind_m_s * wind / wind[-1],
        pressure_hpa=pressure,
        direct_w_m2=direct,
        diffuse_w_m2=diffuse,
        longwave_w_m2=emissivity * STEFAN_BOLTZMANN * air_k**4,
        notes=tuple(notes),
    )


def from_files(paths: list[Path], place: Place, moment: datetime, days: int = 1, turbidity: float = 3.8) -> Weather:
    """Return the weather of files up to a moment; see `weather_of`."""
    records = [_of_year(read_weather(path), moment) for path in paths]
    first = records[0]
    for record in records:
        away = _distance_km(record.place, place)
        if away > FARTHEST_KM:
            raise BadInput(
                f"a weather file must be from within {FARTHEST_KM:g} km of the scene's place, got {record.name} "
                f"{away:.0f} km away"
            )
    time_s = np.concatenate([record.time_s for record in records])
    order = np.argsort(time_s, kind="stable")
    columns = {
        name: np.concatenate([record.columns[name] for record in records])[order]
        for name in first.columns
        if all(name in record.columns for record in records)
    }
    covered = (moment.timestamp() - time_s.min() + first.interval_s + 1.0) / 86400.0
    steps = DAY_STEPS * int(np.clip(covered, days, 10))
    merged = replace(first, time_s=time_s[order], columns=columns)
    times = times_until(moment, steps, STEP_S)
    found = {name: _at(merged, name, times) for name in columns if name not in ("direct_w_m2", "diffuse_w_m2")}
    sun, distance = sun_directions(place, times)
    clear = clear_sun(sun[:, 2], distance, place.altitude_m, turbidity)
    direct, diffuse = (
        _sunlight(merged, name, times, of_clear)
        for name, of_clear in zip(("direct_w_m2", "diffuse_w_m2"), clear, strict=True)
    )
    air_k, dew_k = (found[name] + ZERO_C for name in ("air_c", "dew_point_c"))
    notes = [note for record in records for note in record.notes]
    if "longwave_w_m2" not in found:
        hour, cloud = solar_hour(place, times), found.get("cloud", np.zeros(steps))
        emissivity = sky_emissivity(dew_k, hour, found["pressure_hpa"], cloud)
        found["longwave_w_m2"] = emissivity * STEFAN_BOLTZMANN * air_k**4
        notes.append(MODELLED if "cloud" in found else f"{MODELLED}, for a clear sky")
    if first.typical:
        notes.append(f"{first.name} is of a typical year: its months are of different years")
    away = max(_distance_km(record.place, place) for record in records)
    return Weather(
        place=place,
        moment=moment,
        air_k=air_k,
        dew_point_k=np.minimum(dew_k, air_k),
        wind_m_s=found["wind_m_s"],
        pressure_hpa=found["pressure_hpa"],
        direct_w_m2=direct,
        diffuse_w_m2=diffuse,
        longwave_w_m2=found["longwave_w_m2"],
        notes=(f"weather of {', '.join(record.name for record in records)}, {away:.0f} km away", *notes),
    )


def _of_year(record: Record, moment: datetime) -> Record:
    """Return the rows of a typical year as those of the two years up to a moment."""
    if not record.typical:
        return record
    dates = [datetime.fromtimestamp(second, UTC) for second in record.time_s]
    last, seconds, rows = moment.astimezone(UTC).year, [], []
    for year in (last - 1, last, last + 1):
        for row, date in enumerate(dates):
            if (date.month, date.day) != (2, 29):
                seconds.append(date.replace(year=year).timestamp())
                rows.append(row)
    ascending, which = np.unique(np.array(seconds), return_index=True)
    picked = np.array(rows)[which]
    return replace(record, time_s=ascending, columns={name: column[picked] for name, column in record.columns.items()})


def _at(record: Record, name: str, times: list[datetime]) -> Array:
    """Return a column at times, linear between rows; gaps are refused."""
    seconds = np.array([time.timestamp() for time in times])
    known, values = _known_rows(record, name, seconds)
    if record.interval_s >= STEP_S:
        return np.interp(seconds, known, values)
    return _step_means(known, values, seconds)


def _step_means(known: Array, values: Array, seconds: Array) -> Array:
    """Return means over the steps that end at times."""
    step = np.ceil((known - seconds[0]) / STEP_S).astype(int)
    inside = (step >= 0) & (step < len(seconds))
    count = np.bincount(step[inside], minlength=len(seconds))
    total = np.bincount(step[inside], values[inside], minlength=len(seconds))
    return np.interp(seconds, seconds[count > 0], total[count > 0] / count[count > 0])


def _known_rows(record: Record, name: str, seconds: Array) -> tuple[Array, Array]:
    """Return times and values of a column where it has values; refuse gaps of the time asked for."""
    values = record.columns[name]
    fine = np.isfinite(values)
    known = record.time_s[fine]
    limit = max(STEP_S, record.interval_s) + record.interval_s
    near = known[(known > seconds[0] - limit) & (known < seconds[-1] + limit)]
    # Half a step of the file may lack at either end: its rows stand for an interval.
    bounds = np.concatenate([[seconds[0] - record.interval_s], near, [seconds[-1] + record.interval_s]])
    gap = int(np.argmax(np.diff(bounds)))
    if not len(near) or bounds[gap + 1] - bounds[gap] > limit + record.interval_s * (gap in (0, len(near))):
        start, end = (datetime.fromtimestamp(bounds[index], UTC).isoformat() for index in (gap, gap + 1))
        raise BadInput(
            f"a weather file must have {name} for the whole time up to the scene's, got {record.name} without it "
            f"between {start} and {end}"
        )
    return known, values[fine]


def _sunlight(record: Record, name: str, times: list[datetime], clear: Array) -> Array:
    """Return direct or diffuse sunlight at times: interpolated as a fraction of the clear sky's, 0 while the sun is down.

    Rows of less than a step are taken as they are.
    """
    seconds = np.array([time.timestamp() for time in times])
    if record.interval_s <= STEP_S:
        return np.maximum(_at(record, name, times), 0.0)
    known, values = _known_rows(record, name, seconds)
    middle = known - record.sun_delay_s
    edges = np.cumsum(np.concatenate([[0.0], clear])) * STEP_S
    ends = np.concatenate([[seconds[0] - STEP_S], seconds])
    half = 0.5 * record.interval_s
    mean = (np.interp(middle + half, ends, edges) - np.interp(middle - half, ends, edges)) / record.interval_s
    lit = mean > SHINES_W_M2
    if not lit.any():
        return np.zeros(len(times))
    return clear * np.interp(seconds, middle[lit], values[lit] / mean[lit])


def _distance_km(one: Place, other: Place) -> float:
    """Distance of two places along the ground, km."""
    a, b, c, d = np.deg2rad([one.latitude_deg, one.longitude_deg, other.latitude_deg, other.longitude_deg])
    chord = np.sin(0.5 * (a - c)) ** 2 + np.cos(a) * np.cos(c) * np.sin(0.5 * (b - d)) ** 2
    return float(2.0 * EARTH_RADIUS_KM * np.arcsin(np.sqrt(min(chord, 1.0))))
