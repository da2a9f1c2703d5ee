"""Surface temperatures: layered slabs under sun, sky, air and neighbours, with the weather of a
day.
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.thermal.air import InfraredAir, bins_of, modtran_air
    from simulate.thermal.balance import Balance
    from simulate.thermal.clear_day import (
        clear_sun,
        sky_emissivity,
        sky_radiance,
        solar_hour,
        sun_directions,
    )
    from simulate.thermal.exposure import exposure_of, facets_of, open_rings
    from simulate.thermal.infrared_picture import apparent_temperature, notes_beyond_laws
    from simulate.thermal.infrared_rendering import infrared_radiance, tracer_of
    from simulate.thermal.infrared_sky import InfraredSky, notes_on_sky, ring_radiance, sky_of
    from simulate.thermal.infrared_surfaces import infrared_brdf, pane_transmittance
    from simulate.thermal.infrared_tracer import InfraredTracer
    from simulate.thermal.slab import (
        ZERO_C,
        Columns,
        Exchange,
        Forcing,
        dew_point_k,
        kernels,
        march,
        periodic_start,
        vapour_pressure_pa,
    )
    from simulate.thermal.temperatures import Temperatures, slab_of, temperatures_of
    from simulate.thermal.weather import Weather, weather_from_files, weather_of

__all__ = [
    "ZERO_C",
    "Balance",
    "Columns",
    "Exchange",
    "Forcing",
    "InfraredAir",
    "InfraredSky",
    "InfraredTracer",
    "Temperatures",
    "Weather",
    "apparent_temperature",
    "bins_of",
    "clear_sun",
    "dew_point_k",
    "exposure_of",
    "facets_of",
    "infrared_brdf",
    "infrared_radiance",
    "kernels",
    "march",
    "modtran_air",
    "notes_beyond_laws",
    "notes_on_sky",
    "open_rings",
    "pane_transmittance",
    "periodic_start",
    "ring_radiance",
    "sky_emissivity",
    "sky_of",
    "sky_radiance",
    "slab_of",
    "solar_hour",
    "sun_directions",
    "temperatures_of",
    "tracer_of",
    "vapour_pressure_pa",
    "weather_from_files",
    "weather_of",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.thermal.air": "InfraredAir bins_of modtran_air",
        "simulate.thermal.balance": "Balance",
        "simulate.thermal.clear_day": (
            "clear_sun sky_emissivity sky_radiance solar_hour sun_directions"
        ),
        "simulate.thermal.exposure": "exposure_of facets_of open_rings",
        "simulate.thermal.infrared_picture": "apparent_temperature notes_beyond_laws",
        "simulate.thermal.infrared_rendering": "infrared_radiance tracer_of",
        "simulate.thermal.infrared_sky": "InfraredSky notes_on_sky ring_radiance sky_of",
        "simulate.thermal.infrared_surfaces": "infrared_brdf pane_transmittance",
        "simulate.thermal.infrared_tracer": "InfraredTracer",
        "simulate.thermal.slab": (
            "ZERO_C Columns Exchange Forcing dew_point_k kernels march periodic_start "
            "vapour_pressure_pa"
        ),
        "simulate.thermal.temperatures": "Temperatures slab_of temperatures_of",
        "simulate.thermal.weather": "Weather weather_from_files weather_of",
    },
)
