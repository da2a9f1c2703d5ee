"""A scene on bands, ready for light: what reflects, what shines, and the air between."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import ROW
from simulate.radiance.outdoor.surfaces import Surfaces
from simulate.radiance.ray_tracer import Hits
from simulate.radiance.transport.air_path_table import Air
from simulate.radiance.transport.light_sources import Lighting
from simulate.radiance.transport.light_tracing import LightTracingSettings
from simulate.radiance.transport.shading_points import BsdfSet, ShadingPoints
from simulate.radiance.transport.sky_importance_sampling import SkyImportance

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class SpectralScene:
    """A scene on bands, ready for light.

    Parameters
    ----------
    surfaces, bsdfs
        Surfaces and how they reflect.
    lighting
        What lights them.
    air
        What air does on the way.
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
        """How rays are drawn as lamps shine."""
        return LightTracingSettings.of(self.lighting.lamps, self.surfaces.tracer)

    @property
    def bright_sky(self) -> SkyImportance | None:
        """How bright sky is looked for by name; not through panes, which only gathering knows."""
        return self.lighting.bright_sky if self.bsdfs.panes is None else None

    def points(
        self,
        hit: Hits,
        origin_m: Array,
        direction: Array,
        which: NDArray[np.int64],
        known: NDArray[np.float32] | None = None,
    ) -> ShadingPoints:
        """Return what some of the rays of unit direction (ray, 3) hit.

        Parameters
        ----------
        hit, origin_m, direction
            All rays, and what they hit.
        which
            Numbers of the rays asked for, which hit something, shape (point,).
        known
            Of these points, see `ShadingPoints`, shape (point,); None: all known.
        """
        place = origin_m[which] + hit.range_m[which, None] * direction[which]
        return self.bsdfs.points(self.surfaces, hit.face[which], place, direction[which], known)

    def emission(self, points: ShadingPoints) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return the points that glow and their own radiance towards the eye, shape (glowing point, band)."""
        panels = self.lighting.panels
        if panels is None:
            return np.zeros(0, np.int64), np.zeros((0, self.bands), np.float32)
        kind = panels.kind_of_face[points.face & ROW]
        glows = np.flatnonzero((kind >= 0) & points.outside)
        return glows, panels.spectra[kind[glows]]
