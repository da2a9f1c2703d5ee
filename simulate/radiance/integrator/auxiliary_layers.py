"""Auxiliary layers (AOVs): material, object, distance, normal and shadow at the centre of each
pixel.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.arrays import Array, Array32, Index, Mask
from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.direct_lighting import dot, ray_starts
from simulate.radiance.integrator.light_sources import SHORT, DiscLight
from simulate.radiance.integrator.spectral_scene import ShadingPoints, SpectralScene

# Bits of the shadow map; further sources have none.
BITS = 32
# Neighbours whose normals differ by more than acos(0.98) = 11 degrees belong to different faces.
SAME_NORMAL = 0.98


@dataclass(frozen=True, kw_only=True)
class AuxiliaryLayers:
    """Auxiliary layers of the pixel centres."""

    # Numbers into `materials` and `objects`, -1 for the sky, shape (row, col).
    material: NDArray[np.int16]
    object: NDArray[np.int32]
    range_m: Array32  # distance from the lens, infinite for the sky, shape (row, col), m
    normal: Array32  # unit normal on the camera's side, zero for the sky, shape (row, col, 3)
    # Bit n is set where source n of `sources` gives no light, because it is occluded or behind the
    # surface, shape (row, col).
    shadow: NDArray[np.uint32]
    temperature_k: Array32  # layer of the thermal model, here NaN, shape (row, col), K
    # Names.
    materials: tuple[str, ...]
    objects: tuple[str, ...]
    sources: tuple[str, ...]

    def edges(self, *, shadows: bool = True) -> Mask:
        """Return the pixels at which object, face or, if requested, shadow changes, shape (row,
        col).
        """
        is_edge = np.zeros(self.material.shape, bool)
        for axis in (0, 1):
            all_rows = (slice(None),) * axis
            near_side, far_side = (*all_rows, slice(None, -1)), (*all_rows, slice(1, None))
            differs = (self.object[near_side] != self.object[far_side]) | (
                self.material[near_side] != self.material[far_side]
            )
            if shadows:
                differs |= self.shadow[near_side] != self.shadow[far_side]
            normal_cosine = np.sum(self.normal[near_side] * self.normal[far_side], axis=-1)
            differs |= (normal_cosine < SAME_NORMAL) & (self.object[near_side] >= 0)
            is_edge[near_side] |= differs
            is_edge[far_side] |= differs
        return is_edge

    def save(self, path: Path, geometry: Mapping[str, ArrayLike]) -> None:
        """Write the maps, and the geometry of the view under its own names, to an .npz file."""
        maps: dict[str, Any] = {
            "material": self.material,
            "object": self.object,
            "range_m": self.range_m,
            "normal": self.normal.astype(np.float16),
            "shadow": self.shadow,
            "temperature_k": self.temperature_k,
            "materials": np.array(self.materials),
            "objects": np.array(self.objects),
            "sources": np.array(self.sources),
        }
        maps.update(geometry)
        np.savez_compressed(path, **maps)


def layers_of(
    surfaces: Surfaces,
    shape: tuple[int, int],
    pixels: Index,
    face: Index,
    *,
    normal: Array,
    shadow: NDArray,
    range_m: Array,
    temperature_k: Array,
    sources: tuple[str, ...],
) -> AuxiliaryLayers:
    """Return the auxiliary layers of a frame (row, col).

    Parameters
    ----------
    surfaces, shape
        What is seen, and the frame.
    pixels, face, normal, shadow
        Pixels that see a surface, shape (pixel,), the triangle, its normal on the camera's side and
        its bits of shadow.
    range_m, temperature_k
        Distance and temperature of all pixels, m and K.
    sources
        Names of the sources of the shadows.
    """
    row, layers = face & ROW, {}
    for name, values, sky_value in (
        ("material", surfaces.material_of[row], np.int16(-1)),
        ("object", surfaces.object_of[row], np.int32(-1)),
        ("normal", normal, np.float32(0.0)),
        ("shadow", shadow, np.uint32(0)),
    ):
        layer = np.full((shape[0] * shape[1], *values.shape[1:]), sky_value)
        layer[pixels] = values
        layers[name] = layer.reshape(*shape, *values.shape[1:])
    return AuxiliaryLayers(
        **layers,
        range_m=range_m.astype(np.float32).reshape(shape),
        temperature_k=temperature_k.astype(np.float32).reshape(shape),
        materials=surfaces.materials,
        objects=surfaces.objects,
        sources=sources,
    )


def truth(scene: SpectralScene, view: Viewpoint) -> AuxiliaryLayers:
    """Return the auxiliary layers of a view."""
    row, col = np.indices(view.shape).reshape(2, -1) + 0.5
    origin, direction = view.rays(row, col)
    hit = scene.surfaces.tracer.hits(origin, direction)
    points = scene.points(hit, origin, direction, hit.rays)
    return layers_of(
        scene.surfaces,
        view.shape,
        hit.rays,
        points.face,
        normal=points.normal,
        shadow=_shadows(scene, points),
        range_m=hit.range_m,
        temperature_k=np.full(row.shape, np.nan),
        sources=scene.lighting.names,
    )


def _shadows(scene: SpectralScene, points: ShadingPoints) -> NDArray[np.uint32]:
    """Return the bits of the sources whose centres are not visible from the points."""
    shadow_bits, tracer = np.zeros(len(points), np.uint32), scene.surfaces.tracer
    for bit, light in enumerate((*scene.lighting.discs, *scene.lighting.lamps)[:BITS]):
        if isinstance(light, DiscLight):
            vector, length_limit = np.broadcast_to(light.direction, points.normal.shape), None
        else:
            vector, length_limit = light.position_m - points.position_m, SHORT
        is_dark = dot(vector, points.normal) <= 0.0
        lit = np.flatnonzero(~is_dark)
        is_dark[lit] = tracer.is_occluded(
            ray_starts(points, lit, tracer), vector[lit], length_limit
        )
        shadow_bits |= is_dark.astype(np.uint32) << np.uint32(bit)
    return shadow_bits
