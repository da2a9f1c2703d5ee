"""Auxiliary layers (AOVs): material, object, distance, normal and shadow at the centre of each pixel."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator import direct_lighting
from simulate.radiance.integrator.spectral_scene import SpectralScene

Array = NDArray[np.floating]
ROWS = 64
# Bits of the shadow map; further sources have none.
BITS = 32
# Neighbours whose normals differ by more than acos(0.98) = 11 degrees belong to different faces.
SAME_NORMAL, SAME_PLANE = 0.98, 0.01


@dataclass(frozen=True, kw_only=True)
class AuxiliaryLayers:
    """Auxiliary layers of the pixel centres.

    Parameters
    ----------
    material, object
        Numbers into `materials` and `objects`, -1 for the sky, shape (row, col).
    range_m
        Distance from the lens, infinite for the sky, shape (row, col), m.
    normal
        Unit normal on the camera's side, zero for the sky, shape (row, col, 3).
    shadow
        Bit n is set where source n of `sources` gives no light, because it is occluded or behind the surface, shape
        (row, col).
    temperature_k
        Layer of the thermal model, here NaN, shape (row, col), K.
    materials, objects, sources
        Names.
    """

    material: NDArray[np.int16]
    object: NDArray[np.int32]
    range_m: NDArray[np.float32]
    normal: NDArray[np.float32]
    shadow: NDArray[np.uint32]
    temperature_k: NDArray[np.float32]
    materials: tuple[str, ...]
    objects: tuple[str, ...]
    sources: tuple[str, ...]

    def edges(self, *, shadows: bool = True) -> NDArray[np.bool_]:
        """Return the pixels at which object, face or, if requested, shadow changes, shape (row, col)."""
        found = np.zeros(self.material.shape, bool)
        for axis in (0, 1):
            here = _but_last(self, axis)
            there = _but_first(self, axis)
            differs = (here["object"] != there["object"]) | (here["material"] != there["material"])
            if shadows:
                differs |= here["shadow"] != there["shadow"]
            differs |= (np.sum(here["normal"] * there["normal"], axis=-1) < SAME_NORMAL) & (here["object"] >= 0)
            found[_first(axis)] |= differs
            found[_rest(axis)] |= differs
        return found

    def save(self, path: Path) -> None:
        """Write the maps to an .npz file."""
        np.savez_compressed(
            path,
            material=self.material,
            object=self.object,
            range_m=self.range_m,
            normal=self.normal.astype(np.float16),
            shadow=self.shadow,
            temperature_k=self.temperature_k,
            materials=np.array(self.materials),
            objects=np.array(self.objects),
            sources=np.array(self.sources),
        )


def truth(stage: SpectralScene, view: Viewpoint) -> AuxiliaryLayers:
    """Return the auxiliary layers of a view."""
    rows, columns = view.shape
    parts = [_band(stage, view, start, min(start + ROWS, rows)) for start in range(0, rows, ROWS)]
    maps = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    shaped = {name: values.reshape(rows, columns, *values.shape[1:]) for name, values in maps.items()}
    surfaces = stage.surfaces
    return AuxiliaryLayers(
        **shaped,
        temperature_k=np.full(view.shape, np.nan, np.float32),
        materials=surfaces.materials,
        objects=surfaces.objects,
        sources=stage.lighting.names,
    )


def _band(stage: SpectralScene, view: Viewpoint, start: int, stop: int) -> dict[str, NDArray]:
    row, col = np.meshgrid(np.arange(start, stop) + 0.5, np.arange(view.shape[1]) + 0.5, indexing="ij")
    origin, towards = view.rays(row.ravel(), col.ravel())
    surfaces = stage.surfaces
    hit = surfaces.tracer.hits(origin, towards)
    met = hit.met
    face = hit.face[met]
    points = stage.points(hit, origin, towards, met)
    count = len(hit.face)
    material, thing = np.full(count, -1, np.int16), np.full(count, -1, np.int32)
    material[met], thing[met] = surfaces.material_of[face & ROW], surfaces.object_of[face & ROW]
    normal, shadow = np.zeros((count, 3), np.float32), np.zeros(count, np.uint32)
    normal[met] = points.normal
    shadow[met] = _shadows(stage, points)
    return {
        "material": material,
        "object": thing,
        "range_m": hit.range_m.astype(np.float32),
        "normal": normal,
        "shadow": shadow,
    }


def _shadows(stage: SpectralScene, points: direct_lighting.ShadingPoints) -> NDArray[np.uint32]:
    """Return the bits of the sources whose centres are not visible from the points."""
    found = np.zeros(len(points), np.uint32)
    every = np.arange(len(points))
    lights = (*stage.lighting.discs, *stage.lighting.lamps)[:BITS]
    for bit, light in enumerate(lights):
        if isinstance(light, direct_lighting.DiscLight):
            way, reach = np.broadcast_to(light.direction, points.normal.shape), None
        else:
            way, reach = light.position_m - points.place_m, direct_lighting.SHORT
        dark = np.einsum("ij,ij->i", way, points.normal) <= 0.0
        lit = every[~dark]
        dark[lit] = direct_lighting.is_occluded(points, lit, way[lit], stage.surfaces.tracer, reach)
        found |= dark.astype(np.uint32) << np.uint32(bit)
    return found


def _first(axis: int) -> tuple[slice, ...]:
    return (slice(None),) * axis + (slice(None, -1),)


def _rest(axis: int) -> tuple[slice, ...]:
    return (slice(None),) * axis + (slice(1, None),)


def _but_last(maps: AuxiliaryLayers, axis: int) -> dict[str, NDArray]:
    return {name: getattr(maps, name)[_first(axis)] for name in ("object", "material", "normal", "shadow")}


def _but_first(maps: AuxiliaryLayers, axis: int) -> dict[str, NDArray]:
    return {name: getattr(maps, name)[_rest(axis)] for name in ("object", "material", "normal", "shadow")}
