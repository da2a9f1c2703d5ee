"""Natural light: sun, moon and the sky around them."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.radiance.sky.moon import (
        Disc,
        ObserverLocation,
        ephemeris,
        moon_reflectance,
        moon_spectrum,
        sun_spectrum,
        visible_disc_fraction,
    )
    from simulate.radiance.sky.night_sky import NightSky, TownGlow, dark_sky, van_rhijn
    from simulate.radiance.sky.scattering import (
        krisciunas_schaefer_mie,
        krisciunas_schaefer_rayleigh,
    )

__all__ = [
    "Disc",
    "NightSky",
    "ObserverLocation",
    "TownGlow",
    "dark_sky",
    "ephemeris",
    "krisciunas_schaefer_mie",
    "krisciunas_schaefer_rayleigh",
    "moon_reflectance",
    "moon_spectrum",
    "sun_spectrum",
    "van_rhijn",
    "visible_disc_fraction",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.radiance.sky.moon": (
            "Disc ObserverLocation ephemeris moon_reflectance moon_spectrum sun_spectrum "
            "visible_disc_fraction"
        ),
        "simulate.radiance.sky.night_sky": "NightSky TownGlow dark_sky van_rhijn",
        "simulate.radiance.sky.scattering": "krisciunas_schaefer_mie krisciunas_schaefer_rayleigh",
    },
)
