"""Surface temperatures of a scene: of its objects over a day, and of the pixels of a view at the scene's time."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport.even import evenly
from simulate.radiance.world.description.scene import Scene
from simulate.radiance.world.site import Site
from simulate.radiance.world.viewpoint import Viewpoint
from simulate.thermal.balance import LAST, SUN_STEPS, Balance, Solution
from simulate.thermal.convection import ZERO_C
from simulate.thermal.exposure import Spots, exposure_of, facets_of, sunlit, view
from simulate.thermal.library import slab_of
from simulate.thermal.slab import STEPS_OF_HOUR
from simulate.thermal.weather import DAY_STEPS, weather_of

Array = NDArray[np.float64]
# Half of the noise-equivalent temperature difference of a 40 mK imager.
TOLERANCE_MK = 20.0
# Rays of a pixel to the sky; steps of the day that share one direction of the sun for pixels; rows at a time.
PIXEL_RAYS, SLOT_STEPS, ROWS = 64, 3, 16
# Facets that are covered less than this take what covers a pixel as at the temperature of the air.
COVERED = 1e-3


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of a scene.

    Parameters
    ----------
    balance, solution
        What acts on its facets, and their temperatures.
    """

    balance: Balance
    solution: Solution

    def means_c(self) -> tuple[list[float], Array, dict[str, Array]]:
        """Return the temperatures of the day before the scene's time, by hours.

        Returns
        -------
        hours, air_c, surfaces_c
            25 hours of local time; the air's temperature, C; mean over the area of each OBJECT:MATERIAL, C.
        """
        weather, facets = self.balance.weather, self.balance.facets
        steps = np.maximum(len(weather) - 1 - STEPS_OF_HOUR * np.arange(24, -1, -1), 0)
        times = [weather.times[step] for step in steps]
        hours = [round(time.hour + time.minute / 60.0 + time.second / 3600.0, 4) for time in times]
        means = {}
        for name in dict.fromkeys(facets.names):
            of = np.array([other == name for other in facets.names])
            faces = self.solution.faces_k[steps][:, of]
            means[name] = np.average(faces, axis=1, weights=facets.area_m2[of]) - ZERO_C
        return hours, weather.air_k[steps] - ZERO_C, means

    def map_k(
        self, viewpoint: Viewpoint, progress: Callable[[float], None] = lambda share: None
    ) -> NDArray[np.float32]:
        """Return the temperatures of the middles of a view's pixels at the scene's time, NaN for the sky, K.

        Notes
        -----
        A pixel's point differs from its facet by the sun and the sky that it sees. The facet's kernel makes these
        fluxes a temperature: within 0.04 K of a solution by itself for half a day of shade, 0.12 K for a whole one.
        """
        parts = []
        for row in range(0, viewpoint.shape[0], ROWS):
            parts.append(self._rows(viewpoint, row, min(row + ROWS, viewpoint.shape[0])))
            progress(min(1.0, (row + ROWS) / viewpoint.shape[0]))
        return np.concatenate(parts)

    def _rows(self, viewpoint: Viewpoint, start: int, stop: int) -> NDArray[np.float32]:
        surfaces = self.balance.facets.surfaces
        grid = np.meshgrid(np.arange(start, stop), np.arange(viewpoint.shape[1]), indexing="ij")
        row, col = (axis.ravel() for axis in grid)
        origin, towards = viewpoint.rays(row + 0.5, col + 0.5)
        hit = surfaces.tracer.hits(origin, towards)
        met = hit.met
        spots = Spots.on(surfaces, hit.face[met], origin[met] + hit.range_m[met, None] * towards[met])
        rings, _ = view(surfaces, spots, evenly(row[met], col[met], PIXEL_RAYS, [start]))
        facet = self.balance.facets.of_faces(hit.face[met])
        kelvin = np.full(len(row), np.nan, np.float32)
        kelvin[met] = self.solution.faces_k[-1, facet] + self.difference_k(facet, spots, rings)
        return kelvin.reshape(stop - start, -1)

    def difference_k(self, facet: NDArray[np.int64], spots: Spots, rings: Array) -> Array:
        """Return the temperatures of spots over those of their facets, by what they see of sun and sky, (spot,), K."""
        of_sun, of_rings, of_cover = self._kernels
        exposure, more = self.balance.exposure, rings - self.balance.exposure.rings[facet]
        found = np.einsum("sr,sr->s", of_rings[facet], more) + of_cover[facet] * more.sum(axis=1)
        middle = np.arange(SLOT_STEPS // 2, DAY_STEPS, SLOT_STEPS)
        sun = self.balance.weather.sun[LAST][middle]
        up = np.flatnonzero(sun[:, 2] > 0.0)
        lit = sunlit(self.balance.facets.surfaces, spots, sun[up])
        for slot, cosine in zip(up, lit, strict=True):
            found += of_sun[slot, facet] * (cosine - exposure.lit[middle[slot] // SUN_STEPS, facet])
        return found

    @cached_property
    def _kernels(self) -> tuple[Array, Array, Array]:
        """What more light does to the last temperature of facets, K.

        Of sun at a cosine of 1 in each slot of the day (slot, facet), of each ring of the sky's longwave (facet, ring),
        and of diffuse sunlight in place of what surfaces send where these cover less (facet,).
        """
        balance, kernel, weather = self.balance, self.solution.kernel, self.balance.weather
        covered = 1.0 - balance.exposure.sky
        neighbours = balance.longwave(self.solution.faces_k[LAST])[1] / np.maximum(covered, COVERED)
        neighbours = np.where(covered > COVERED, neighbours, balance.rings[LAST].mean(axis=1, keepdims=True))
        reflected = np.where(covered > COVERED, balance.reflected[LAST] / np.maximum(covered, COVERED), 0.0)
        direct = (kernel * weather.direct_w_m2[LAST, None]).reshape(-1, SLOT_STEPS, kernel.shape[1]).sum(axis=1)
        diffuse = (kernel * (weather.diffuse_w_m2[LAST, None] - reflected)).sum(axis=0)
        of_cover = balance.heating * diffuse - balance.emissivity * (kernel * neighbours).sum(axis=0)
        return balance.heating * direct, balance.emissivity[:, None] * (kernel.T @ balance.rings[LAST]), of_cover


def temperatures_of(scene: Scene, *, tolerance_mk: float = TOLERANCE_MK, seed: int = 0) -> Temperatures:
    """Return the surface temperatures of a scene.

    Parameters
    ----------
    scene
        A scene out of doors with a place, weather, and materials that have slabs.
    tolerance_mk
        What terms left out may change at the scene's time, mK.
    seed
        Seed of the points and rays by which facets see sun, sky and each other.

    Raises
    ------
    BadInput
        If the scene lacks a place, weather with wind, or the slab of a material; if its weather file does not suit.
    """
    weather, surfaces = weather_of(scene), Site(scene).surfaces
    by_label = {surface.label: surface for surface in scene.material}
    slabs = {name: slab_of(scene, by_label[name]) for name in surfaces.materials}
    things, facets = {thing.label: thing for thing in scene.object}, facets_of(surfaces)
    assert scene.weather is not None
    balance = Balance(
        facets=facets,
        exposure=exposure_of(facets, weather.sun[LAST][::SUN_STEPS], np.random.default_rng(seed)),
        slabs=tuple(slabs[surfaces.materials[number]] for number in facets.material),
        things=tuple(things[surfaces.objects[number]] for number in facets.object),
        weather=weather,
        state=scene.weather,
    )
    return Temperatures(balance, balance.solved(tolerance_mk))
