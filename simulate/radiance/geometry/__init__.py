"""Triangle meshes, ray tracing and camera geometry."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.radiance.geometry.surfaces import (
        Mesh,
        box,
        collect_surfaces,
        disc,
        ground,
        plane,
        shape,
        shed,
        sphere,
    )
    from simulate.radiance.geometry.viewpoint import RasterGeometry, Viewpoint

__all__ = [
    "Mesh",
    "RasterGeometry",
    "Viewpoint",
    "box",
    "collect_surfaces",
    "disc",
    "ground",
    "plane",
    "shape",
    "shed",
    "sphere",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.radiance.geometry.surfaces": (
            "Mesh box collect_surfaces disc ground plane shape shed sphere"
        ),
        "simulate.radiance.geometry.viewpoint": "RasterGeometry Viewpoint",
    },
)
