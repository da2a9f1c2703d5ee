"""Monte Carlo integrator: light transport from lamps and sky over surfaces to a camera."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.radiance.integrator.auxiliary_layers import truth
    from simulate.radiance.integrator.cache_smoothing import Nodes
    from simulate.radiance.integrator.camera_rays import radiance_along
    from simulate.radiance.integrator.environment_map import SkyImportance, black
    from simulate.radiance.integrator.integrator_settings import (
        IntegratorSettings,
        RenderSensor,
        SamplingSettings,
        additional_rays,
        one_by_one,
        workers,
    )
    from simulate.radiance.integrator.irradiance_cache import build_irradiance_cache
    from simulate.radiance.integrator.light_sources import (
        DiscLight,
        LampLight,
        Lighting,
        Panels,
        lamp_arrays,
        lamp_pattern,
    )
    from simulate.radiance.integrator.renderer import render_scene
    from simulate.radiance.integrator.spectral_scene import Air, BsdfSet, Panes, SpectralScene
    from simulate.radiance.integrator.subpixel_sources import add_small_sources

__all__ = [
    "Air",
    "BsdfSet",
    "DiscLight",
    "IntegratorSettings",
    "LampLight",
    "Lighting",
    "Nodes",
    "Panels",
    "Panes",
    "RenderSensor",
    "SamplingSettings",
    "SkyImportance",
    "SpectralScene",
    "add_small_sources",
    "additional_rays",
    "black",
    "build_irradiance_cache",
    "lamp_arrays",
    "lamp_pattern",
    "one_by_one",
    "radiance_along",
    "render_scene",
    "truth",
    "workers",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.radiance.integrator.auxiliary_layers": "truth",
        "simulate.radiance.integrator.cache_smoothing": "Nodes",
        "simulate.radiance.integrator.environment_map": "SkyImportance black",
        "simulate.radiance.integrator.integrator_settings": (
            "IntegratorSettings RenderSensor SamplingSettings additional_rays one_by_one workers"
        ),
        "simulate.radiance.integrator.irradiance_cache": "build_irradiance_cache",
        "simulate.radiance.integrator.light_sources": (
            "DiscLight LampLight Lighting Panels lamp_arrays lamp_pattern"
        ),
        "simulate.radiance.integrator.camera_rays": "radiance_along",
        "simulate.radiance.integrator.renderer": "render_scene",
        "simulate.radiance.integrator.spectral_scene": "Air BsdfSet Panes SpectralScene",
        "simulate.radiance.integrator.subpixel_sources": "add_small_sources",
    },
)
