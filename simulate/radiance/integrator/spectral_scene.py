"""A scene on the bands of a rendering: surfaces, BSDFs, light sources and air."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.ray_tracer import Hits
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.integrator import environment_map
from simulate.radiance.integrator.environment_map import SkyImportance
from simulate.radiance.integrator.light_sources import Lighting
from simulate.radiance.integrator.light_tracing import LightTracingSettings
from simulate.radiance.integrator.shading_points import BsdfSet, ShadingPoints

if TYPE_CHECKING:
    from simulate.radiance.atmosphere import Atmosphere


Array = NDArray[np.floating]
# Gas transmittance is tabulated at ranges of 2^(n / NODES) m from 1 m; shorter paths lose nothing to gases.
NODES, OCTAVES = 16, 20


@dataclass(frozen=True)
class Air:
    """Air of a scene, on bands.

    Parameters
    ----------
    extinction_per_m
        Extinction by haze and molecules, shape (band,), m-1; None: no air.
    gas_transmittance
        Gas transmittance over paths of 2^(n / `NODES`) m, shape (length, band).
    endless
        Radiance of an infinite path by direction; None for unlit air.
    """

    extinction_per_m: NDArray[np.float32] | None = None
    gas_transmittance: NDArray[np.float32] | None = None
    endless: environment_map.EnvironmentMap | None = None

    @property
    def absorbs(self) -> bool:
        """Whether there is air."""
        return self.extinction_per_m is not None

    def through(self, range_m: Array) -> NDArray[np.float32]:
        """Return the transmittance of paths of given lengths (ray,), m, shape (ray, band)."""
        return self._particle_transmittance(range_m) * self._gas_transmittance(range_m)

    def change_of(self, light: NDArray[np.float32], range_m: Array, direction: Array) -> NDArray[np.float32]:
        """Return the change of light (ray, band) along paths in unit directions (ray, 3): path radiance minus losses.

        Notes
        -----
        The path radiance is J (1 - T of haze and molecules) (T of gases over half the path), see
        `Atmosphere.path_radiance`.
        """
        left = self._particle_transmittance(range_m)
        change = left * self._gas_transmittance(range_m)
        change -= np.float32(1.0)
        change *= light
        if self.endless is not None:
            np.subtract(np.float32(1.0), left, out=left)
            left *= self.endless.irradiance(direction)
            left *= self._gas_transmittance(0.5 * range_m)
            change += left
        return change

    def _particle_transmittance(self, range_m: Array) -> NDArray[np.float32]:
        assert self.extinction_per_m is not None
        depth = np.asarray(-range_m, np.float32)[:, None] * self.extinction_per_m
        return np.exp(depth, out=depth)

    def _gas_transmittance(self, range_m: Array) -> NDArray[np.float32]:
        """Interpolate the gas transmittance in the logarithm of the length, shape (ray, band)."""
        table = self.gas_transmittance
        assert table is not None
        place = np.clip(NODES * np.log2(np.maximum(range_m, 1.0)), 0.0, len(table) - 1.0)
        below = np.minimum(place.astype(np.int64), len(table) - 2)
        share = (place - below).astype(np.float32)[:, None]
        found = table[below]
        found += share * (table[below + 1] - found)
        return found


def air(lit: "Atmosphere", wavelength_nm: NDArray[np.float64]) -> Air:
    """Tabulate an atmosphere on bands (band,), nm."""
    lengths = 2.0 ** (np.arange(NODES * OCTAVES + 1) / NODES)
    light = lit.light
    return Air(
        lit.extinction_per_m(wavelength_nm).astype(np.float32),
        np.ascontiguousarray(lit.gas_transmittance(lengths, wavelength_nm).T, np.float32),
        None if light is None else environment_map.sphere(lambda way: light.air_radiance(way, wavelength_nm)),
    )


@dataclass(frozen=True, kw_only=True)
class SpectralScene:
    """A scene on the bands of a rendering.

    Parameters
    ----------
    surfaces, bsdfs
        Surfaces and their BSDFs.
    lighting
        Light sources.
    air
        Attenuation and path radiance of air.
    """

    surfaces: Surfaces
    bsdfs: BsdfSet
    lighting: Lighting
    air: Air

    @property
    def bands(self) -> int:
        """Number of bands."""
        return len(self.bsdfs.wavelength_nm)

    @cached_property
    def beams(self) -> LightTracingSettings:
        """Sampling of lamp directions by intensity."""
        return LightTracingSettings.of(self.lighting.lamps, self.surfaces.tracer)

    @property
    def bright_sky(self) -> SkyImportance | None:
        """Importance sampling of the sky; None with panes, which next-event estimation does not handle."""
        return self.lighting.bright_sky if self.bsdfs.panes is None else None

    def points(
        self,
        hit: Hits,
        origin_m: Array,
        direction: Array,
        which: NDArray[np.int64],
        sky_control_fraction: NDArray[np.float32] | None = None,
    ) -> ShadingPoints:
        """Return the shading points of some of the rays of unit direction (ray, 3).

        Parameters
        ----------
        hit, origin_m, direction
            All rays, and their hits.
        which
            Indices of the requested rays, which hit a surface, shape (point,).
        sky_control_fraction
            Of these points, see `ShadingPoints`, shape (point,); None: all known.
        """
        place = origin_m[which] + hit.range_m[which, None] * direction[which]
        return self.bsdfs.points(self.surfaces, hit.face[which], place, direction[which], sky_control_fraction)

    def emission(self, points: ShadingPoints) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return the indices of emitting points and their emitted radiance, shape (emitting point, band)."""
        panels = self.lighting.panels
        if panels is None:
            return np.zeros(0, np.int64), np.zeros((0, self.bands), np.float32)
        kind = panels.kind_of_face[points.face & ROW]
        glows = np.flatnonzero((kind >= 0) & points.outside)
        return glows, panels.spectra[kind[glows]]
