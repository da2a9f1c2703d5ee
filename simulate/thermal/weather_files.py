"""Weather files: EPW, TMY3, SURFRAD, and CSV of this project, as rows of the same columns with date and place."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.sky.ephemeris import Place

Array = NDArray[np.float64]
NEEDED = ("air_c", "dew_point_c", "wind_m_s", "pressure_hpa", "direct_w_m2", "diffuse_w_m2")
OPTIONAL = ("longwave_w_m2", "cloud")
STANDARD_HPA, SCALE_M = 1013.25, 8434.5
OUR_HEADER = "time,air_c,dew_point_c,wind_m_s,direct_w_m2,diffuse_w_m2[,longwave_w_m2][,pressure_hpa][,cloud]"


@dataclass(frozen=True, kw_only=True)
class Record:
    """Rows of a weather file.

    Parameters
    ----------
    name
        Its name.
    place
        Where it was recorded.
    time_s
        Times that temperatures and wind belong to, seconds since 1970 UTC, ascending, shape (row,).
    columns
        `NEEDED` and of `OPTIONAL` what the file has, shape (row,); NaN where a value is missing.
    sun_delay_s
        How long before these times the middle of the interval lies that radiation is the mean of, s.
    interval_s
        Time between rows, s.
    typical
        Whether the rows are of a typical year: their year does not count.
    notes
        What a reader of the temperatures should know, in sentences.
    """

    name: str
    place: Place
    time_s: Array
    columns: dict[str, Array]
    sun_delay_s: float
    interval_s: float
    typical: bool = False
    notes: tuple[str, ...] = ()


def read_weather(path: Path) -> Record:
    """Return the rows of a weather file.

    Raises
    ------
    BadInput
        If the file is of no known kind, or is not a complete one of its kind.
    """
    readers: dict[str, Callable[[Path, list[str]], Record]] = {".epw": _epw, ".dat": _surfrad, ".csv": _csv}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise BadInput(f"a weather file must be one of {', '.join(readers)}, got {path.name}")
    try:
        lines = path.read_text(encoding="utf-8", errors="strict").splitlines()
    except FileNotFoundError:
        raise BadInput(f"a weather file must exist to be read, got {path}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"a weather file must be readable text, got {path.name}: {error}") from None
    try:
        return reader(path, [line for line in lines if line.strip()])
    except (ValueError, IndexError, KeyError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(
            f"{path.name} must be a complete {reader.__doc__} file, got a row or heading that is not: {error}"
        ) from None


def _epw(path: Path, lines: list[str]) -> Record:
    """EPW"""
    head = lines[0].split(",")
    rows = [line.split(",") for line in lines[8:]]
    zone = timezone(timedelta(hours=float(head[8])))
    ends = [_hour_end(int(r[0]), int(r[1]), int(r[2]), int(r[3]), zone) for r in rows]
    missing = {6: 99.9, 7: 99.9, 9: 999999.0, 12: 9999.0, 14: 9999.0, 15: 9999.0, 21: 999.0}
    air, dew, pressure, longwave, direct, diffuse, wind = (
        _known(np.array([float(r[column]) for r in rows]), value) for column, value in missing.items()
    )
    columns = dict(zip(NEEDED, (air, dew, wind, pressure / 100.0, direct, diffuse), strict=True))
    return Record(
        name=path.name,
        place=_place(head[6], head[7], head[9]),
        time_s=np.array(ends),
        columns=columns | {"longwave_w_m2": longwave},
        sun_delay_s=1800.0,
        interval_s=3600.0,
        typical=True,
        notes=(f"longwave of {path.name} is as the file gives it; most EPW files hold a model's, not a measurement",),
    )


def _tmy3(path: Path, lines: list[str]) -> Record:
    """TMY3"""
    head = lines[0].split(",")
    rows = list(csv.DictReader(lines[1:]))
    zone = timezone(timedelta(hours=float(head[3])))
    dates = [(row["Date (MM/DD/YYYY)"].split("/"), int(row["Time (HH:MM)"].split(":")[0])) for row in rows]
    ends = [_hour_end(int(date[2]), int(date[0]), int(date[1]), hour, zone) for date, hour in dates]
    names = ("Dry-bulb (C)", "Dew-point (C)", "Wspd (m/s)", "Pressure (mbar)", "DNI (W/m^2)", "DHI (W/m^2)")
    values = [_known(np.array([float(row[name]) for row in rows]), -9900.0) for name in (*names, "TotCld (tenths)")]
    return Record(
        name=path.name,
        place=_place(head[4], head[5], head[6]),
        time_s=np.array(ends),
        columns=dict(zip((*NEEDED, "cloud"), (*values[:-1], values[-1] / 10.0), strict=True)),
        sun_delay_s=1800.0,
        interval_s=3600.0,
        typical=True,
    )


def _surfrad(path: Path, lines: list[str]) -> Record:
    """SURFRAD"""
    latitude, longitude, altitude = lines[1].split()[:3]
    table = np.array([[float(cell) for cell in line.split()] for line in lines[2:]])
    days = np.array([datetime(int(r[0]), int(r[2]), int(r[3]), tzinfo=UTC).timestamp() for r in table])
    picked = _known(table[:, [38, 40, 42, 46, 12, 14, 16]], -9999.9)
    air, humidity, wind, pressure, direct, diffuse, longwave = picked.T
    from simulate.thermal.convection import ZERO_C, dew_point_k

    columns = (air, dew_point_k(air + ZERO_C, np.clip(humidity, 1.0, 100.0) / 100.0) - ZERO_C, wind, pressure)
    # Sensors read a few W/m2 below zero at night.
    columns = (*columns, np.maximum(direct, 0.0), np.maximum(diffuse, 0.0))
    return Record(
        name=path.name,
        # Stations are in the United States: longitudes are west, whether signed or not.
        place=_place(latitude, -abs(float(longitude)), altitude),
        time_s=days + 3600.0 * table[:, 4] + 60.0 * table[:, 5],
        columns=dict(zip((*NEEDED, "longwave_w_m2"), (*columns, longwave), strict=True)),
        sun_delay_s=0.0,
        interval_s=60.0,
        notes=(f"longwave of {path.name} was measured; readings of sunlight below zero count as zero",),
    )


def _csv(path: Path, lines: list[str]) -> Record:
    """CSV"""
    if any("Date (MM/DD/YYYY)" in line for line in lines[:2]):
        return _tmy3(path, lines)
    comment = [part for line in lines if line.startswith("#") for part in line.lstrip("# ").split(",")]
    place = {key.strip(): value for key, _, value in (part.partition("=") for part in comment)}
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    lacking = [name for name in ("latitude_deg", "longitude_deg") if name not in place]
    lacking += [name for name in ("time", *NEEDED) if name != "pressure_hpa" and name not in (rows[0] if rows else {})]
    if lacking:
        raise BadInput(
            f"a weather .csv must have a line '# latitude_deg = ..., longitude_deg = ..., altitude_m = ...' and the "
            f"heading {OUR_HEADER}, got {path.name} without {lacking[0]}"
        )
    moments = [datetime.fromisoformat(row["time"]) for row in rows]
    if any(moment.tzinfo is None for moment in moments):
        raise BadInput(f"times of a weather file must state their offset from UTC, got others in {path.name}")
    columns = {
        name: np.array([float(row[name]) if row[name] else np.nan for row in rows])
        for name in (*NEEDED, *OPTIONAL)
        if name in rows[0]
    }
    where = _place(place["latitude_deg"], place["longitude_deg"], place.get("altitude_m", "0"))
    level = STANDARD_HPA * np.exp(-where.altitude_m / SCALE_M)
    times = np.array([moment.timestamp() for moment in moments])
    notes = (f"longwave of {path.name} is as the file gives it",) if "longwave_w_m2" in columns else ()
    return Record(
        name=path.name,
        place=where,
        time_s=times,
        columns={"pressure_hpa": np.full(len(rows), level)} | columns,
        sun_delay_s=0.0,
        interval_s=float(np.median(np.diff(times))),
        notes=notes,
    )


def _hour_end(year: int, month: int, day: int, hour: int, zone: timezone) -> float:
    """Seconds at the end of an hour that is counted from 1 to 24."""
    return (datetime(year, month, day, tzinfo=zone) + timedelta(hours=hour)).timestamp()


def _known(values: Array, missing: float) -> Array:
    """Values with NaN for those that stand for missing ones."""
    return np.where(values <= missing if missing < 0.0 else values >= missing, np.nan, values)


def _place(latitude: str, longitude: str | float, altitude: str) -> Place:
    return Place(latitude_deg=float(latitude), longitude_deg=float(longitude), altitude_m=float(altitude))
