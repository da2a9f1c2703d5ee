"""Readers of weather files: EPW, TMY3, SURFRAD, and the CSV of this project."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

from labdata.errors import BadInput
from simulate.arrays import Array
from simulate.radiance.sky.moon import ObserverLocation
from simulate.thermal.slab import ZERO_C, dew_point_k
from simulate.thermal.thresholds import UNCERTAINTY

# Of each quantity its column in a kind of file, our unit over that of the file, and from where on
# it is missing.
Columns = Mapping[str, tuple[int | str, float, float]]
EPW: Columns = {
    "air_c": (6, 1.0, 99.9),
    "dew_point_c": (7, 1.0, 99.9),
    "pressure_hpa": (9, 0.01, 999999.0),
    "longwave_w_m2": (12, 1.0, 9999.0),
    "direct_w_m2": (14, 1.0, 9999.0),
    "diffuse_w_m2": (15, 1.0, 9999.0),
    "wind_m_s": (21, 1.0, 999.0),
}
TMY3: Columns = {
    "air_c": ("Dry-bulb (C)", 1.0, -9900.0),
    "dew_point_c": ("Dew-point (C)", 1.0, -9900.0),
    "pressure_hpa": ("Pressure (mbar)", 1.0, -9900.0),
    "direct_w_m2": ("DNI (W/m^2)", 1.0, -9900.0),
    "diffuse_w_m2": ("DHI (W/m^2)", 1.0, -9900.0),
    "wind_m_s": ("Wspd (m/s)", 1.0, -9900.0),
    "cloud": ("TotCld (tenths)", 0.1, -9900.0),
}
SURFRAD: Columns = {
    "direct_w_m2": (12, 1.0, -9999.0),
    "diffuse_w_m2": (14, 1.0, -9999.0),
    "longwave_w_m2": (16, 1.0, -9999.0),
    "air_c": (38, 1.0, -9999.0),
    "humidity": (40, 0.01, -9999.0),
    "wind_m_s": (42, 1.0, -9999.0),
    "pressure_hpa": (46, 1.0, -9999.0),
}
DATE, HOUR = "Date (MM/DD/YYYY)", "Time (HH:MM)"
OWN = ("air_c", "dew_point_c", "wind_m_s", "direct_w_m2", "diffuse_w_m2")
OWN_OPTIONAL = ("longwave_w_m2", "pressure_hpa", "cloud")
OWN_PLACE = ("latitude_deg", "longitude_deg", "altitude_m")


@dataclass(frozen=True, kw_only=True)
class Record:
    """Rows of a weather file.

    Parameters
    ----------
    name, location
        Its name, and where it was recorded.
    time_s
        Seconds since 1970 UTC, ascending, shape (row,).
    columns
        By names as in `EPW`, shape (row,); NaN where a value is missing. Sunlight is the mean of
        the time before.
    interval_s
        Time between rows, s.
    notes
        Where values come from, in sentences.
    longwave_sd_w_m2
        Standard deviation of the longwave, W m-2.
    """

    name: str
    location: ObserverLocation
    time_s: Array
    columns: dict[str, Array]
    interval_s: float
    notes: tuple[str, ...]
    longwave_sd_w_m2: float = UNCERTAINTY.modelled_longwave_w_m2

    def __post_init__(self) -> None:
        disorder = np.flatnonzero(np.diff(self.time_s) <= 0.0)
        if len(disorder):
            time, next_time = (utc_text(float(self.time_s[disorder[0] + n])) for n in (0, 1))
            raise BadInput(
                f"the times of a weather file must rise, got {next_time} after {time} in "
                f"{self.name}"
            )


def utc_text(seconds: float) -> str:
    """Return the time of seconds since 1970 as text."""
    return datetime.fromtimestamp(seconds, UTC).isoformat()


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
        raise BadInput(
            f"{path.name} must be a complete weather file of its kind ({kind}): {error}"
        ) from None


def _rows(
    name: str, lines: list[str], heading: int, separator: str | None, columns: int
) -> list[list[str]]:
    """Return the rows after a heading, split; each must have so many columns."""
    rows = [line.split(separator) for line in lines[heading:]]
    for number, row in enumerate(rows, heading + 1):
        if len(row) < columns:
            raise BadInput(
                f"a complete weather file of its kind must have {columns} columns in each row, "
                f"got {len(row)} in row {number} of {name}"
            )
    if not rows:
        raise BadInput(
            f"a complete weather file must have rows after its {heading} lines of heading, got "
            f"none in {name}"
        )
    return rows


def _epw(name: str, lines: list[str], moment: datetime) -> Record:
    head, rows = lines[0].split(","), _rows(name, lines, 8, ",", 22)
    dates = [(int(row[1]), int(row[2]), int(row[3])) for row in rows]
    note = (
        f"longwave of {name} is as the file gives it; most EPW files hold that of a model, not "
        f"a measurement"
    )
    return _typical_year(name, head[6:10], dates, float(head[8]), _read(rows, EPW), moment, note)


def _tmy3(name: str, lines: list[str], moment: datetime) -> Record:
    head, rows = lines[0].split(","), list(csv.DictReader(lines[1:]))
    dates = [(*map(int, row[DATE].split("/")[:2]), int(row[HOUR].split(":")[0])) for row in rows]
    head_fields = [head[4], head[5], head[3], head[6]]
    return _typical_year(
        name,
        head_fields,
        dates,
        float(head[3]),
        _read(rows, TMY3),
        moment,
        f"{name} has no longwave",
    )


def _typical_year(
    name: str,
    location_fields: list[str],
    dates: list,
    zone_h: float,
    columns: dict[str, Array],
    moment: datetime,
    note: str,
) -> Record:
    """Rows of a typical year, whose hours stamp their end, as of the year of a moment and the one
    before.
    """
    invalid_hour = next((hour for _, _, hour in dates if not 1 <= hour <= 24), None)
    if invalid_hour is not None:
        raise BadInput(
            f"hours of a typical year stamp their end and must lie from 1 to 24, got "
            f"{invalid_hour} in {name}"
        )
    if not -14.0 <= zone_h <= 14.0:
        raise BadInput(
            f"the time zone of a weather file must lie within 14 h of UTC, got {zone_h:g} in {name}"
        )
    zone = timezone(timedelta(hours=zone_h))
    stamped_rows = sorted(
        ((datetime(year, month, day, tzinfo=zone) + timedelta(hours=hour)).timestamp(), row)
        for year in (moment.year - 1, moment.year)
        for row, (month, day, hour) in enumerate(dates)
        if (month, day) != (2, 29)
    )
    rows = np.array([row for _, row in stamped_rows])
    return Record(
        name=name,
        location=_location(location_fields[0], location_fields[1], location_fields[3]),
        time_s=np.array([time for time, _ in stamped_rows]),
        columns={column: values[rows] for column, values in columns.items()},
        interval_s=3600.0,
        notes=(f"{name} is of a typical year, whose months are of different years", note),
    )


def _surfrad(name: str, lines: list[str], moment: datetime) -> Record:
    latitude, longitude, altitude = lines[1].split()[:3]
    rows = _rows(name, lines, 2, None, 48)
    columns = _read(rows, SURFRAD)
    humidity = np.clip(columns.pop("humidity"), 0.01, 1.0)
    # Sensors read a few W/m2 below zero at night.
    sunlight = {
        column: np.maximum(columns[column], 0.0) for column in ("direct_w_m2", "diffuse_w_m2")
    }
    time_s = [
        datetime(*(int(row[n]) for n in (0, 2, 3, 4, 5)), tzinfo=UTC).timestamp() for row in rows
    ]
    return Record(
        name=name,
        # Stations are in the United States: longitudes are west, whether signed or not.
        location=_location(latitude, -abs(float(longitude)), altitude),
        time_s=np.array(time_s),
        columns=columns
        | sunlight
        | {"dew_point_c": dew_point_k(columns["air_c"] + ZERO_C, humidity) - ZERO_C},
        interval_s=60.0,
        notes=(f"longwave of {name} was measured; its sunlight below zero counts as zero",),
        longwave_sd_w_m2=UNCERTAINTY.measured_longwave_w_m2,
    )


def _csv(name: str, lines: list[str], moment: datetime) -> Record:
    if any(DATE in line for line in lines[:2]):
        return _tmy3(name, lines, moment)
    comments = ",".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    location_fields = {
        key.strip(): value
        for key, _, value in (part.partition("=") for part in comments.split(","))
    }
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    headings = {*location_fields, *(rows[0] if rows else ())}
    for heading in (
        candidate for candidate in (*OWN_PLACE, "time", *OWN) if candidate not in headings
    ):
        raise BadInput(
            f"a weather .csv must have a line '# {' = ..., '.join(OWN_PLACE)} = ...' and the "
            f"headings time, {', '.join(OWN)} and perhaps {', '.join(OWN_OPTIONAL)}, got {name} "
            f"without {heading}"
        )
    if len(rows) < 2:
        raise BadInput(f"a weather file must cover a day, got {name} with {len(rows)} row")
    times = [datetime.fromisoformat(row["time"]) for row in rows]
    if any(time.tzinfo is None for time in times):
        raise BadInput(
            f"times of a weather file must state their offset from UTC, got others in {name}"
        )
    time_s = np.array([time.timestamp() for time in times])
    file_columns = {
        column: (column, 1.0, np.inf) for column in (*OWN, *OWN_OPTIONAL) if column in headings
    }
    return Record(
        name=name,
        location=_location(*(location_fields[key] for key in OWN_PLACE)),
        time_s=time_s,
        columns=_read(rows, file_columns),
        interval_s=float(np.median(np.diff(time_s))),
        notes=(f"longwave of {name} is as the file gives it",)
        if "longwave_w_m2" in file_columns
        else (),
    )


def _read(rows: Sequence[Any], columns: Columns) -> dict[str, Array]:
    """Return columns of rows in our units, NaN where a value is missing."""
    columns_read = {}
    for name, (column, unit, missing) in columns.items():
        values = np.array([float(row[column] or np.nan) for row in rows])
        is_missing = values <= missing if missing < 0.0 else values >= missing
        columns_read[name] = np.where(is_missing, np.nan, unit * values)
    return columns_read


def _location(latitude: str, longitude: str | float, altitude: str) -> ObserverLocation:
    return ObserverLocation(
        latitude_deg=float(latitude), longitude_deg=float(longitude), altitude_m=float(altitude)
    )
