"""Outdoor scenes: description, geometry, camera and render settings."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.radiance.outdoor.build import build_surfaces, place_mesh
    from simulate.radiance.outdoor.built_scene import BuiltScene
    from simulate.radiance.outdoor.materials import Layer, MaterialSpec, Slab
    from simulate.radiance.outdoor.objects import Object
    from simulate.radiance.outdoor.poses import (
        CameraKeyframe,
        ObjectKeyframe,
        Pose,
        pose_at,
        rotation_of,
    )
    from simulate.radiance.outdoor.render_settings import choose_render_settings
    from simulate.radiance.outdoor.scene import (
        ConvectionLaw,
        LampPlacement,
        OutdoorScene,
        RigSensor,
        SceneCamera,
        Weather,
        Where,
    )

__all__ = [
    "BuiltScene",
    "CameraKeyframe",
    "ConvectionLaw",
    "LampPlacement",
    "Layer",
    "MaterialSpec",
    "Object",
    "ObjectKeyframe",
    "OutdoorScene",
    "Pose",
    "RigSensor",
    "SceneCamera",
    "Slab",
    "Weather",
    "Where",
    "build_surfaces",
    "choose_render_settings",
    "place_mesh",
    "pose_at",
    "rotation_of",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.radiance.outdoor.build": "build_surfaces place_mesh",
        "simulate.radiance.outdoor.built_scene": "BuiltScene",
        "simulate.radiance.outdoor.materials": "Layer MaterialSpec Slab",
        "simulate.radiance.outdoor.objects": "Object",
        "simulate.radiance.outdoor.poses": "CameraKeyframe ObjectKeyframe Pose pose_at rotation_of",
        "simulate.radiance.outdoor.render_settings": "choose_render_settings",
        "simulate.radiance.outdoor.scene": (
            "ConvectionLaw LampPlacement OutdoorScene RigSensor SceneCamera Weather Where"
        ),
    },
)
