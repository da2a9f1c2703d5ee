"""Where and when a scene is, what the air is like there and how bright the sky: tables of a scene's file."""

from dataclasses import dataclass
from datetime import datetime

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Where:
    """Place and time.

    Parameters
    ----------
    latitude_deg, longitude_deg
        North and east positive, deg.
    altitude_m
        Above the sea, m.
    time
        Date, time of day and offset from UTC, such as 1998-06-24T02:00:00-04:00.
    """

    latitude_deg: float
    longitude_deg: float
    time: str
    altitude_m: float = 0.0

    @property
    def moment(self) -> datetime:
        """The time, which knows its offset from UTC."""
        try:
            moment = datetime.fromisoformat(self.time)
        except ValueError:
            raise BadInput(f"time must be written like 1998-06-24T02:00:00-04:00, got {self.time!r}") from None
        if moment.tzinfo is None:
            raise BadInput(f"time must state its offset from UTC, like 02:00:00-04:00 or 06:00:00Z, got {self.time!r}")
        return moment

    def __post_init__(self) -> None:
        _ = self.moment


@dataclass(frozen=True, kw_only=True)
class Weather:
    """The air at the ground.

    Parameters
    ----------
    visibility_km
        Distance at which a black thing keeps 2 % of its contrast, km.
    relative_humidity
        0 to 1, dimensionless.
    temperature_c
        Air temperature, C.
    """

    visibility_km: float = 23.0
    relative_humidity: float = 0.5
    temperature_c: float = 15.0


@dataclass(frozen=True, kw_only=True)
class Town:
    """The glow of a town beyond the horizon; see `simulate.radiance.sky.town`."""

    azimuth_deg: float
    luminance_cd_m2: float
    height_deg: float = 10.0
    half_width_deg: float = 35.0
    lamp: str = "high-pressure-sodium"


@dataclass(frozen=True, kw_only=True)
class Sky:
    """The sky's own light, each part over that of a dark site.

    Parameters
    ----------
    airglow, zodiacal, starlight
        Strengths, dimensionless.
    moon, sun
        False takes the body out of the sky.
    towns
        Glow of towns.
    """

    airglow: float = 1.0
    zodiacal: float = 1.0
    starlight: float = 1.0
    moon: bool = True
    sun: bool = True
    towns: tuple[Town, ...] = ()
