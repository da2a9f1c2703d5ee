"""Natural light: sun, moon and the sky around them."""

from simulate.radiance.sky.disc import Disc
from simulate.radiance.sky.ephemeris import ObserverLocation
from simulate.radiance.sky.night_sky import NightSky
from simulate.radiance.sky.town import TownGlow

__all__ = ["Disc", "NightSky", "ObserverLocation", "TownGlow"]
