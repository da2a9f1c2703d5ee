"""A scene on bands, ready for light: what reflects, what shines, and the air between."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import ROW
from simulate.radiance.trace import Hits
from simulate.radiance.transport.air import Air
from simulate.radiance.transport.bright_sky import BrightSky
from simulate.radiance.transport.lights import Lighting
from simulate.radiance.transport.lit_places import Beams
from simulate.radiance.transport.points import Coats, Points
from simulate.radiance.world.surfaces import Surfaces

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A scene on bands, ready for light.

    Parameters
    ----------
    surfaces, coats
        Surfaces and how they reflect.
    lighting
        What lights them.
    air
        What air does on the way.
    """

    surfaces: Surfaces
    coats: Coats
    lighting: Lighting
    air: Air

    @property
    def bands(self) -> int:
        """Number of bands."""
        return len(self.coats.wavelength_nm)

    @cached_property
    def beams(self) -> Beams:
        """How rays are drawn as lamps shine."""
        return Beams.of(self.lighting.lamps, self.surfaces.tracer)

    @property
    def bright_sky(self) -> BrightSky | None:
        """How bright sky is looked for by name; not through panes, which only gathering knows."""
        return self.lighting.bright_sky if self.coats.panes is None else None

    def points(
        self,
        hit: Hits,
        origin_m: Array,
        direction: Array,
        which: NDArray[np.int64],
        known: NDArray[np.float32] | None = None,
    ) -> Points:
        """Return what some of the rays of unit direction (ray, 3) hit.

        Parameters
        ----------
        hit, origin_m, direction
            All rays, and what they hit.
        which
            Numbers of the rays asked for, which hit something, shape (point,).
        known
            Of these points, see `Points`, shape (point,); None: all known.
        """
        place = origin_m[which] + hit.range_m[which, None] * direction[which]
        return self.coats.points(self.surfaces, hit.face[which], place, direction[which], known)

    def emitted(self, points: Points) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return the points that glow and their own radiance towards the eye, shape (glowing point, band)."""
        panels = self.lighting.panels
        if panels is None:
            return np.zeros(0, np.int64), np.zeros((0, self.bands), np.float32)
        kind = panels.kind_of_face[points.face & ROW]
        glows = np.flatnonzero((kind >= 0) & points.outside)
        return glows, panels.spectra[kind[glows]]
