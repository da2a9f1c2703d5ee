"""Location, time, weather and natural light of a scene: tables of a scene's file."""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from labdata.errors import BadInput

ConvectionLaw = Literal["buoyant", "mcadams", "watmuff", "constant"]


@dataclass(frozen=True, kw_only=True)
class Where:
    """Location and time.

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
        """The time, with its offset from UTC."""
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
    """The air at the ground at the scene's time, and for surface temperatures its course over the day before.

    Parameters
    ----------
    visibility_km
        Distance at which a black object has a contrast of 2 %, km.
    relative_humidity
        0 to 1, dimensionless.
    temperature_c
        Air temperature, C.
    dew_point_c
        Dew point, C, in place of the relative humidity.
    wind_m_s
        Wind at 10 m, m/s; surface temperatures need it, or a file.
    cloud
        Fraction of the sky that low cloud covers, dimensionless.
    day
        How air and wind change over the day: "clear" (as on a clear day) or "constant".
    daily_swing_k
        Highest minus lowest air temperature of a clear day, K.
    linke_turbidity
        Turbidity of the air for sunlight (Linke), dimensionless.
    file
        Weather of the day up to the scene's time, in place of the numbers above from the temperature on: a file of kind
        EPW (.epw), TMY3 or `docs/thermal.md` (.csv) or SURFRAD (.dat), relative to the scene's.
    convection, convection_w_m2_k
        Law of convection (`simulate.thermal.slab`), and the coefficient of the law "constant", W m-2 K-1.
    """

    visibility_km: float = 23.0
    relative_humidity: float = 0.5
    temperature_c: float = 15.0
    dew_point_c: float | None = None
    wind_m_s: float | None = None
    cloud: float = 0.0
    day: Literal["clear", "constant"] = "clear"
    daily_swing_k: float = 12.0
    linke_turbidity: float = 3.8
    file: str | tuple[str, ...] | None = None
    convection: ConvectionLaw = "buoyant"
    convection_w_m2_k: float | None = None

    def __post_init__(self) -> None:
        if self.dew_point_c is not None and self.dew_point_c > self.temperature_c:
            raise BadInput(
                f"dew_point_c must not exceed temperature_c {self.temperature_c:g}, got {self.dew_point_c:g}"
            )
        if not 0.0 <= self.cloud <= 1.0:
            raise BadInput(f"cloud must lie between 0 and 1, got {self.cloud:g}")
        if (self.convection == "constant") != (self.convection_w_m2_k is not None):
            raise BadInput(
                'convection_w_m2_k must be given with convection = "constant" and only then, got '
                f"{self.convection!r} and {self.convection_w_m2_k}"
            )
        for name in ("wind_m_s", "daily_swing_k", "convection_w_m2_k"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise BadInput(f"{name} must not be negative, got {value:g}")
        if not self.linke_turbidity >= 1.0:
            raise BadInput(f"linke_turbidity must be at least 1, got {self.linke_turbidity:g}")


@dataclass(frozen=True, kw_only=True)
class Town:
    """The glow of a town beyond the horizon; see `simulate.radiance.sky.sky_glow`."""

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
