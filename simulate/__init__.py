"""Simulation: scene radiance, intensified and solid-state cameras, and virtual instruments."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use
from labdata.numba_cache import keep_loops

if TYPE_CHECKING:
    from simulate.api import SimulationRequest, simulate
    from simulate.effect_selection import EffectSelection, OptionalEffect, select_effects
    from simulate.image_source import centre_on_frame, read_cube, read_image
    from simulate.infrared_view import InfraredView
    from simulate.lab import LabBench
    from simulate.motion import Look, Motion
    from simulate.operating_conditions import (
        conditions_of,
        load_described_camera,
        voltage_limit_warnings,
    )
    from simulate.outdoor_rendering import OutdoorRendering, RenderedView, render_sensor_of
    from simulate.radiance_files import save_view_radiance
    from simulate.session_files import save_session
    from simulate.shot import Shot, stage_images
    from simulate.surface_temperatures import SurfaceTemperatures, temperatures

keep_loops()

__all__ = [
    "EffectSelection",
    "InfraredView",
    "LabBench",
    "Look",
    "Motion",
    "OptionalEffect",
    "OutdoorRendering",
    "RenderedView",
    "Shot",
    "SimulationRequest",
    "SurfaceTemperatures",
    "centre_on_frame",
    "conditions_of",
    "load_described_camera",
    "read_cube",
    "read_image",
    "render_sensor_of",
    "save_session",
    "save_view_radiance",
    "select_effects",
    "simulate",
    "stage_images",
    "temperatures",
    "voltage_limit_warnings",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.api": "SimulationRequest simulate",
        "simulate.effect_selection": "EffectSelection OptionalEffect select_effects",
        "simulate.image_source": "centre_on_frame read_cube read_image",
        "simulate.infrared_view": "InfraredView",
        "simulate.lab": "LabBench",
        "simulate.motion": "Look Motion",
        "simulate.operating_conditions": (
            "conditions_of load_described_camera voltage_limit_warnings"
        ),
        "simulate.outdoor_rendering": "OutdoorRendering RenderedView render_sensor_of",
        "simulate.radiance_files": "save_view_radiance",
        "simulate.session_files": "save_session",
        "simulate.shot": "Shot stage_images",
        "simulate.surface_temperatures": "SurfaceTemperatures temperatures",
    },
)
