"""The weather up to a scene's time, in steps: of files, or of a synthetic day through the scene's
numbers.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from simulate.arrays import Array
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.radiance.outdoor.scene import Weather as State
from simulate.radiance.sky.moon import EARTH_RADIUS_KM, ObserverLocation
from simulate.radiance.spectrum import STEFAN_BOLTZMANN
from simulate.thermal.clear_day import (
    clear_sun,
    course,
    sky_emissivity,
    solar_hour,
    sun_directions,
    sun_under_cloud,
)
from simulate.thermal.slab import ZERO_C, dew_point_k
from simulate.thermal.thresholds import LIMITS, UNCERTAINTY, WEATHER_BOUNDS
from simulate.thermal.weather_files import Record, read_weather, utc_text

DAY_STEPS = round(86400.0 / LIMITS.step_s)
# Sunlight of hours is interpolated as a fraction of the clear sky's where that is more, W m-2.
SHINES_W_M2 = 10.0
STANDARD_HPA, SCALE_M = 1013.25, 8434.5
MODELLED = (
    "longwave of the sky was modelled (Berdahl and Martin), not measured: uncertain by 15 W/m2"
)


@dataclass(frozen=True, kw_only=True)
class Weather:
    """Weather at the ends of steps of `LIMITS.step_s`, the last of which is the scene's time;
    arrays of shape (step,).

    Parameters
    ----------
    location, moment
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
    longwave_sd_w_m2
        Standard deviation of the longwave, W m-2.
    """

    location: ObserverLocation
    moment: datetime
    air_k: Array
    dew_point_k: Array
    wind_m_s: Array
    pressure_hpa: Array
    direct_w_m2: Array
    diffuse_w_m2: Array
    longwave_w_m2: Array
    notes: tuple[str, ...] = ()
    longwave_sd_w_m2: float = UNCERTAINTY.modelled_longwave_w_m2

    def __len__(self) -> int:
        return len(self.air_k)

    @cached_property
    def times(self) -> list[datetime]:
        """Ends of the steps."""
        return _times(self.moment, len(self))

    @cached_property
    def sun(self) -> Array:
        """Direction of the sun, shape (step, 3)."""
        return sun_directions(self.location, self.times)[0]

    @property
    def global_w_m2(self) -> Array:
        """Sunlight on level ground, shape (step,), W m-2."""
        return self.direct_w_m2 * np.maximum(self.sun[:, 2], 0.0) + self.diffuse_w_m2


def weather_of(scene: OutdoorScene) -> Weather:
    """Return the weather before a scene's time: a day, or the full days that its files cover.

    Raises
    ------
    BadInput
        If the scene has no place or no weather with wind, or its file has gaps, another date or a
        place far away.
    """
    observer, state = scene.place, scene.weather
    if observer is None:
        raise BadInput(
            f"a scene must have a [place] with a time for surface temperatures, got none in "
            f"{scene.name!r}"
        )
    if state is None or (state.wind_m_s is None and not state.file):
        raise BadInput(
            "a scene must have a [weather] with wind_m_s or with a file for surface "
            f"temperatures, got {'none' if state is None else 'neither'} in {scene.name!r}"
        )
    location = ObserverLocation(
        latitude_deg=observer.latitude_deg,
        longitude_deg=observer.longitude_deg,
        altitude_m=observer.altitude_m,
    )
    if not state.file:
        return _synthetic_day(state, location, observer.moment)
    names = (state.file,) if isinstance(state.file, str) else state.file
    return weather_from_files(
        [scene.file(name) for name in names], location, observer.moment, state.linke_turbidity
    )


def _times(moment: datetime, steps: int) -> list[datetime]:
    return [moment - timedelta(seconds=(steps - 1 - step) * LIMITS.step_s) for step in range(steps)]


def _synthetic_day(state: State, location: ObserverLocation, moment: datetime) -> Weather:
    """A day that passes through the state at the scene's time."""
    times = _times(moment, DAY_STEPS)
    sun, distance = sun_directions(location, times)
    hour, pressure = solar_hour(location, times), np.full(DAY_STEPS, _pressure(location))
    air, wind = course(hour, sun[:, 2] > 0.0)
    if state.day == "constant":
        air, wind = np.zeros(DAY_STEPS), np.ones(DAY_STEPS)
    air_k = ZERO_C + state.temperature_c + state.daily_swing_k * (air - air[-1])
    if state.dew_point_c is None and not 0.0 < state.relative_humidity <= 1.0:
        raise BadInput(
            f"relative_humidity must lie above 0 and up to 1, got {state.relative_humidity:g}"
        )
    dew = dew_point_k(ZERO_C + state.temperature_c, state.relative_humidity)
    dew = float(dew if state.dew_point_c is None else ZERO_C + state.dew_point_c)
    dew_k, coldest = np.full(DAY_STEPS, min(dew, air_k.min())), air_k.min()
    notes = (f"weather of a {state.day} day through the state at {moment.isoformat()}", MODELLED)
    if dew > coldest:
        notes += (
            (
                f"the dew point is that of the day's coldest air, {coldest - ZERO_C:.1f} C, not "
                f"{dew - ZERO_C:.1f} C"
            ),
        )
    direct, diffuse = clear_sun(sun[:, 2], distance, location.altitude_m, state.linke_turbidity)
    direct, diffuse = sun_under_cloud(direct, diffuse, sun[:, 2], state.cloud)
    return Weather(
        location=location,
        moment=moment,
        air_k=air_k,
        dew_point_k=dew_k,
        wind_m_s=(state.wind_m_s or 0.0) * wind / wind[-1],
        pressure_hpa=pressure,
        direct_w_m2=direct,
        diffuse_w_m2=diffuse,
        longwave_w_m2=sky_emissivity(dew_k, hour, pressure, state.cloud)
        * STEFAN_BOLTZMANN
        * air_k**4,
        notes=notes,
    )


def weather_from_files(
    paths: list[Path], location: ObserverLocation, moment: datetime, turbidity: float = 3.8
) -> Weather:
    """Return the weather of files up to a moment; see `weather_of`."""
    records = [read_weather(path, moment) for path in paths]
    names = ", ".join(record.name for record in records)
    distance_km = max(_distance_km(record.location, location) for record in records)
    if distance_km > LIMITS.farthest_km:
        raise BadInput(
            f"a weather file must be from within {LIMITS.farthest_km:g} km of the scene, got "
            f"{names} {distance_km:.0f} km away"
        )
    record = _join(records, names)
    starts_s = np.concatenate(
        [record.time_s[:1], record.time_s[1:][np.diff(record.time_s) > 2.0 * record.interval_s]]
    )
    start_s = starts_s[starts_s <= moment.timestamp()].max(initial=record.time_s[0])
    covered_days = (moment.timestamp() - start_s + record.interval_s) / 86400.0
    times = _times(moment, DAY_STEPS * int(np.clip(covered_days, 1, LIMITS.max_weather_days)))
    _refuse_sun_at_night(record, location, times)
    columns = {name: _column_at(record, name, times) for name in record.columns}
    sun, distance = sun_directions(location, times)
    clear = clear_sun(sun[:, 2], distance, location.altitude_m, turbidity)
    for name, light in zip(("direct_w_m2", "diffuse_w_m2"), clear, strict=True):
        if record.interval_s > LIMITS.step_s:
            columns[name] = _sunlight(record, name, times, light)
    air_k, dew_k = (columns[name] + ZERO_C for name in ("air_c", "dew_point_c"))
    pressure = columns.get("pressure_hpa", np.full(len(times), _pressure(location)))
    notes = tuple(note for record in records for note in record.notes)
    if record.interval_s > LIMITS.step_s:
        notes += (
            (
                f"weather in steps of {record.interval_s / 60.0:g} minutes: clouds and gusts that "
                f"pass are averaged"
            ),
        )
    if len(times) == DAY_STEPS:
        notes += ("one day of weather: slabs start as if the days before it had been alike",)
    longwave_sd = max(record.longwave_sd_w_m2 for record in records)
    if "longwave_w_m2" not in columns:
        longwave_sd = UNCERTAINTY.modelled_longwave_w_m2
        cloud = columns.get("cloud", np.zeros(len(times)))
        emissivity = sky_emissivity(dew_k, solar_hour(location, times), pressure, cloud)
        columns["longwave_w_m2"] = emissivity * STEFAN_BOLTZMANN * air_k**4
        notes += (MODELLED if "cloud" in columns else f"{MODELLED}, for a clear sky",)
    return Weather(
        location=location,
        moment=moment,
        air_k=air_k,
        dew_point_k=np.minimum(dew_k, air_k),
        pressure_hpa=pressure,
        notes=(f"weather of {names}, {distance_km:.0f} km away", *notes),
        longwave_sd_w_m2=longwave_sd,
        **{
            name: columns[name]
            for name in ("wind_m_s", "direct_w_m2", "diffuse_w_m2", "longwave_w_m2")
        },
    )


def _join(records: list[Record], names: str) -> Record:
    """Return the rows of several files, with the columns that all have."""
    first_record = records[0]
    time_s, order = np.unique(
        np.concatenate([record.time_s for record in records]), return_index=True
    )
    common = [
        name for name in first_record.columns if all(name in record.columns for record in records)
    ]
    columns = {
        name: np.concatenate([record.columns[name] for record in records])[order] for name in common
    }
    return replace(first_record, name=names, time_s=time_s, columns=columns)


def _column_at(record: Record, name: str, times: list[datetime]) -> Array:
    """Return a column at times, linear between rows; gaps longer than a step or a row are
    refused.
    """
    seconds = np.array([time.timestamp() for time in times])
    fine = np.isfinite(record.columns[name])
    valid_s = record.time_s[fine]
    # Rows stand for the interval before or around them: one may lack at either end.
    limits = [seconds[0] - record.interval_s, seconds[-1] + record.interval_s]
    known_s = np.concatenate(
        [limits[:1], valid_s[(valid_s > limits[0]) & (valid_s < limits[1])], limits[1:]]
    )
    gap = int(np.argmax(np.diff(known_s)))
    if known_s[gap + 1] - known_s[gap] > max(LIMITS.step_s, 1.01 * record.interval_s):
        start, end = (utc_text(float(known_s[index])) for index in (gap, gap + 1))
        raise BadInput(
            "a weather file must cover the day before the scene's time without gaps, got "
            f"{record.name} without {name} between {start} and {end}"
        )
    values, (low, high) = record.columns[name][fine], WEATHER_BOUNDS[name]
    invalid = np.flatnonzero(
        ((values < low) | (values > high)) & (valid_s > limits[0]) & (valid_s < limits[1])
    )
    if len(invalid):
        raise BadInput(
            f"{name} of a weather file must lie from {low:g} to {high:g}, got "
            f"{values[invalid[0]]:g} at {utc_text(float(valid_s[invalid[0]]))} in {record.name}"
        )
    return np.interp(seconds, valid_s, values)


def _refuse_sun_at_night(record: Record, location: ObserverLocation, times: list[datetime]) -> None:
    """Refuse a file in which the sun shines at night at a place, for its hours are those of another
    time zone.
    """
    limits_s = times[0].timestamp(), times[-1].timestamp()
    light = np.nan_to_num(record.columns["direct_w_m2"])
    rows = np.flatnonzero(
        (light > LIMITS.night_w_m2)
        & (record.time_s >= limits_s[0])
        & (record.time_s <= limits_s[1])
    )
    rows = rows[:: max(1, round(LIMITS.step_s / record.interval_s))]
    for row in rows:
        # The row is the mean of the interval before it.
        end_s = float(record.time_s[row])
        interval_times = [
            datetime.fromtimestamp(end_s - fraction * record.interval_s, UTC)
            for fraction in (0.0, 0.5, 1.0)
        ]
        sine = sun_directions(location, interval_times)[0][:, 2].max()
        if sine < LIMITS.night_sine:
            raise BadInput(
                f"sunlight of a weather file must fall by day, got {light[row]:.0f} W/m2 at "
                f"{interval_times[0].isoformat()} in {record.name} with the sun "
                f"{np.rad2deg(np.arcsin(-sine)):.0f} degrees below the horizon: its time zone or "
                "its place is wrong"
            )


def _sunlight(record: Record, name: str, times: list[datetime], clear: Array) -> Array:
    """Return sunlight at times from means over hours: their fraction of the clear sky's is
    interpolated.
    """
    seconds = np.array([time.timestamp() for time in times])
    total = np.concatenate(
        [[0.0], np.cumsum(0.5 * (clear + np.concatenate([clear[:1], clear[:-1]]))) * LIMITS.step_s]
    )
    limits_s = np.concatenate([[seconds[0] - LIMITS.step_s], seconds])
    mean = np.interp(record.time_s, limits_s, total) - np.interp(
        record.time_s - record.interval_s, limits_s, total
    )
    mean /= record.interval_s
    in_period = (record.time_s - record.interval_s >= limits_s[0]) & (record.time_s <= limits_s[-1])
    lit = (mean > SHINES_W_M2) & in_period & np.isfinite(record.columns[name])
    if not lit.any():
        return np.zeros(len(times))
    centre_s = record.time_s[lit] - 0.5 * record.interval_s
    return clear * np.interp(seconds, centre_s, record.columns[name][lit] / mean[lit])


def _pressure(location: ObserverLocation) -> float:
    return float(STANDARD_HPA * np.exp(-location.altitude_m / SCALE_M))


def _distance_km(observer: ObserverLocation, station: ObserverLocation) -> float:
    """Distance of two places, straight through the earth, km."""
    points = []
    for location in (observer, station):
        latitude, longitude = np.deg2rad([location.latitude_deg, location.longitude_deg])
        level = np.cos(latitude)
        points.append(
            np.array([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)])
        )
    return float(EARTH_RADIUS_KM * np.linalg.norm(points[0] - points[1]))
