"""Surface temperatures of a scene: of its objects over a day, and of the pixels of a view at the scene's time."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import ROW
from simulate.radiance.transport.even import evenly
from simulate.radiance.world.description.scene import Scene
from simulate.radiance.world.site import Site
from simulate.radiance.world.viewpoint import Viewpoint
from simulate.thermal.balance import SUN_STEPS, Body, Solution, bodies_of, solve
from simulate.thermal.convection import ZERO_C
from simulate.thermal.exposure import Spots, exposure_of, facets_of, sunlit, view
from simulate.thermal.library import slab_of
from simulate.thermal.slab import STEP_S
from simulate.thermal.weather import DAY_STEPS, Weather, weather_of

Array = NDArray[np.float64]
# Half of a 40 mK imager's noise-equivalent temperature difference.
TOLERANCE_MK = 20.0
# Rays of a pixel to the sky; steps of the day that share one direction of the sun for pixels; rows at a time.
PIXEL_RAYS, SUN_SLOT, ROWS = 64, 6, 16
HOUR_STEPS = round(3600.0 / STEP_S)


@dataclass(frozen=True, kw_only=True)
class TemperatureMap:
    """Temperatures of the middles of pixels.

    Parameters
    ----------
    temperature_k
        NaN for the sky, shape (row, col), K.
    object, material
        Numbers into `objects` and `materials`, -1 for the sky, shape (row, col).
    objects, materials
        Names.
    """

    temperature_k: NDArray[np.float32]
    object: NDArray[np.int32]
    material: NDArray[np.int16]
    objects: tuple[str, ...]
    materials: tuple[str, ...]


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of a scene.

    Parameters
    ----------
    site
        The scene with its surfaces.
    solution
        The balance of its facets.
    """

    site: Site
    solution: Solution

    @property
    def weather(self) -> Weather:
        """The weather."""
        return self.solution.weather

    @property
    def bodies(self) -> dict[str, Body]:
        """What the facets are by their names OBJECT:MATERIAL."""
        return dict(zip(self.solution.facets.names, self.solution.bodies, strict=True))

    def means_c(self) -> tuple[list[float], Array, dict[str, Array]]:
        """Return hours of local time from a day before the scene's time on, the air's temperature and those of surfaces.

        Returns
        -------
        hours, air_c, surfaces_c
            25 hours; C; mean over the area of each OBJECT:MATERIAL, C.
        """
        weather, facets = self.weather, self.solution.facets
        steps = np.maximum(len(weather) - 1 - HOUR_STEPS * np.arange(24, -1, -1), 0)
        times = [weather.times[step] for step in steps]
        hours = [round(time.hour + time.minute / 60.0 + time.second / 3600.0, 4) for time in times]
        names = np.array(facets.names)
        means = {
            name: np.average(
                self.solution.faces_k[steps][:, names == name], axis=1, weights=facets.area_m2[names == name]
            )
            - ZERO_C
            for name in dict.fromkeys(facets.names)
        }
        return hours, weather.air_k[steps] - ZERO_C, means

    def map(self, view: Viewpoint, progress: Callable[[float], None] = lambda share: None) -> TemperatureMap:
        """Return the temperatures of a view's pixels at the scene's time.

        Notes
        -----
        A pixel's point differs from its facet by the sun and the sky that it sees. The facet's kernel makes these
        fluxes a temperature: within 0.04 K of a solution by itself for half a day of shade, 0.12 K for a whole one.
        """
        parts = []
        for row in range(0, view.shape[0], ROWS):
            parts.append(self._rows(view, row, min(row + ROWS, view.shape[0])))
            progress(min(1.0, (row + ROWS) / view.shape[0]))
        kelvin, thing, material = (np.concatenate(part) for part in zip(*parts, strict=True))
        surfaces = self.solution.facets.surfaces
        return TemperatureMap(
            temperature_k=kelvin,
            object=thing,
            material=material,
            objects=surfaces.objects,
            materials=surfaces.materials,
        )

    def _rows(
        self, viewpoint: Viewpoint, start: int, stop: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int16]]:
        solution, surfaces = self.solution, self.solution.facets.surfaces
        grid = np.meshgrid(np.arange(start, stop), np.arange(viewpoint.shape[1]), indexing="ij")
        row, col = (axis.ravel() for axis in grid)
        origin, towards = viewpoint.rays(row + 0.5, col + 0.5)
        hit = surfaces.tracer.hits(origin, towards)
        met = hit.met
        face = hit.face[met]
        place = origin[met] + hit.range_m[met, None] * towards[met]
        facet = solution.facets.of_faces(face)
        spots = Spots.on(surfaces, face, place)
        rings, _ = view(surfaces, spots, evenly(row[met], col[met], PIXEL_RAYS, [start]))
        kelvin = np.full(len(row), np.nan, np.float32)
        kelvin[met] = solution.faces_k[-1, facet] + self._difference(facet, spots, rings)
        thing, material = np.full(len(row), -1, np.int32), np.full(len(row), -1, np.int16)
        thing[met], material[met] = surfaces.object_of[face & ROW], surfaces.material_of[face & ROW]
        shape = (stop - start, viewpoint.shape[1])
        return kelvin.reshape(shape), thing.reshape(shape), material.reshape(shape)

    def _difference(self, facet: NDArray[np.int64], spots: Spots, rings: Array) -> Array:
        """Temperature of spots over that of their facets, K."""
        exposure, by = self.solution.exposure, self._kernels
        more = rings - exposure.rings[facet]
        found = np.einsum("sr,sr->s", by.rings[facet], more) + by.covered[facet] * more.sum(axis=1)
        sun = self.weather.sun[self._slots]
        up = np.flatnonzero(sun[:, 2] > 0.0)
        lit = sunlit(self.solution.facets.surfaces, spots, sun[up])
        of_facets = exposure.lit[self._lit_slots]
        for slot, cosine in zip(up, lit, strict=True):
            found += by.sun[slot, facet] * (cosine - of_facets[slot, facet])
        return found

    @cached_property
    def _slots(self) -> NDArray[np.int64]:
        """Steps of the weather in the middle of the slots of the last day."""
        return len(self.weather) - DAY_STEPS + np.arange(SUN_SLOT // 2, DAY_STEPS, SUN_SLOT)

    @cached_property
    def _lit_slots(self) -> NDArray[np.int64]:
        """Rows of the exposure to the sun in the middle of the slots."""
        return np.arange(SUN_SLOT // 2, DAY_STEPS, SUN_SLOT) // SUN_STEPS

    @cached_property
    def _kernels(self) -> "_PixelKernels":
        solution, weather = self.solution, self.weather
        kernel, last = solution.kernel, solution.lasting
        emissivity = np.array([float(body.slab.emissivity) for body in solution.bodies])
        absorbed = np.array(
            [
                float(body.slab.absorptivity or 0.0) * (1.0 - float(body.slab.latent_fraction))
                for body in solution.bodies
            ]
        )
        direct = (kernel * weather.direct_w_m2[last, None]).reshape(-1, SUN_SLOT, kernel.shape[1]).sum(axis=1)
        diffuse = kernel * (weather.diffuse_w_m2[last, None] - solution.reflected)
        return _PixelKernels(
            sun=absorbed * direct,
            rings=emissivity[:, None] * (kernel.T @ solution.sky),
            covered=absorbed * diffuse.sum(axis=0) - emissivity * (kernel * solution.surrounding).sum(axis=0),
        )


@dataclass(frozen=True, kw_only=True)
class _PixelKernels:
    """What more of the sky does to the last temperature of each facet.

    Parameters
    ----------
    sun
        Of the sun in each slot of the day, for a cosine of 1, shape (slot, facet), K.
    rings
        Of longwave from each ring of the sky, shape (facet, ring), K.
    covered
        Of diffuse sunlight from sky in place of surfaces, less what these sent, shape (facet,), K.
    """

    sun: Array
    rings: Array
    covered: Array


def temperatures_of(scene: Scene, *, tolerance_mk: float = TOLERANCE_MK, seed: int = 0, days: int = 1) -> Temperatures:
    """Return the surface temperatures of a scene.

    Parameters
    ----------
    scene
        A scene out of doors with a place, weather, and materials that have slabs.
    tolerance_mk
        What terms left out may change at the scene's time, mK.
    seed
        Seed of the points and rays by which facets see sun, sky and each other.
    days
        Days of a weather file that are used at least.

    Raises
    ------
    BadInput
        If the scene lacks a place, weather with wind, or the slab of a material; if its weather file does not suit.
    """
    weather = weather_of(scene, days)
    site = Site(scene)
    facets = facets_of(site.surfaces)
    by_label = {surface.label: surface for surface in scene.material}
    slabs = {name: slab_of(scene, by_label[name]) for name in site.surfaces.materials}
    sun = weather.sun[len(weather) - DAY_STEPS :: SUN_STEPS]
    exposure = exposure_of(facets, sun, np.random.default_rng(seed))
    return Temperatures(site, solve(facets, bodies_of(scene, facets, slabs), exposure, weather, scene, tolerance_mk))
