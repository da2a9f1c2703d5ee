"""Infrared reflectance and transmittance of materials, and the radiance that facets emit and
reflect.
"""

from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from simulate.arrays import Array, Index
from simulate.radiance.brdf.glossy import Facets as Microfacets
from simulate.radiance.brdf.glossy import Glossy, Metal
from simulate.radiance.brdf.microfacet import dielectric
from simulate.radiance.brdf.protocol import Brdf, Lambert, Reflectance
from simulate.radiance.integrator.spectral_scene import BsdfSet
from simulate.radiance.materials import pane_fractions
from simulate.radiance.outdoor.materials import MaterialSpec, Slab
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.thermal.air import WINDOWS_UM, InfraredAir
from simulate.thermal.infrared_sky import Surroundings, ring_radiance
from simulate.thermal.temperatures import Temperatures, slab_of
from simulate.thermal.thresholds import INFRARED

# Between these wavelengths, nm, the emissivity goes from that of 3.5 to 4.1 um to that of 8 to 14
# um.
BETWEEN_NM = tuple(1e3 * end for end in (WINDOWS_UM[0][1], WINDOWS_UM[1][0]))
# Refractive index of window glass from 3 to 4.6 um.
GLASS_INDEX = 1.47
# Roughness of window glass, and reflectances of a base or metal by which that of an emissivity is
# found.
GLASS_ROUGHNESS, TRIED = 0.01, np.linspace(0.0, 1.0, 129)
UP = np.array([[0.0, 0.0, 1.0]])
# Light between facets is followed until a further reflection adds less than this fraction.
CONVERGED, MOST_REFLECTIONS = 1e-9, 400


def infrared_brdf(surface: MaterialSpec, slab: Slab) -> Brdf:
    """Return the infrared BRDF of a material.

    Parameters
    ----------
    surface
        The material, whose finish it keeps. Panes of glass mirror. Retroreflectors and measured
        surfaces, whose shape is known in the visible alone, are diffuse.
    slab
        Its slab, whose emissivity is taken as that along the normal; without one for 3.5 to 4.1 um,
        that of 8 to 14 um. Of a pane it is all that is not reflected: absorbed or transmitted.

    Notes
    -----
    By Kirchhoff's law the emissivity towards a direction is 1 minus the albedo towards it. The base
    under a coat, or the metal, has the reflectance with which that holds along the normal; where
    the coat alone reflects more, the base is black and the emissivity lower.
    """
    longwave = float(slab.emissivity)
    reflectances = tuple(
        1.0 - float(value or longwave) for value in (slab.emissivity_mwir, longwave)
    )
    visible = surface.material.brdf() if surface.measured is None else None
    if surface.pane_transmittance is not None:
        return Metal(reflectance=_reflectance(reflectances), roughness=GLASS_ROUGHNESS)
    if not isinstance(visible, Microfacets):
        return Lambert(reflectance=_reflectance(reflectances))
    number = np.arange(len(TRIED), dtype=float)
    trial_reflectance = Reflectance(
        wavelength_nm=tuple(number + 1.0), fraction=tuple(TRIED.tolist())
    )
    kind = {"roughness": visible.roughness}
    if isinstance(visible, Glossy):
        kind["refractive_index"] = visible.refractive_index
    albedo = type(visible)(reflectance=trial_reflectance, **kind).albedo(UP, number + 1.0)[:, 0]
    return type(visible)(reflectance=_reflectance(np.interp(reflectances, albedo, TRIED)), **kind)


def pane_transmittance(thickness_mm: float, edges_um: tuple[float, ...]) -> Array:
    """Return the transmittance of a pane of soda-lime glass at normal incidence in bins, shape
    (bin,).

    Notes
    -----
    (1 - r)^2 t / (1 - r^2 t^2) with r of a face and t = exp(-4 pi k d / wavelength), the mean over
    each bin. It is 0 beyond 5 um, and less than 1 % from 4.5 um on for 4 mm. The extinction
    coefficient k (`glass.csv`) is that of clear soda-lime glass (Rubin, Sol. Energy Mater. 12, 275,
    1985; at 5 um that of all kinds), from the database of refractiveindex.info, which is in the
    public domain.

    Examples
    --------
    >>> pane_transmittance(4.0, (3.75, 4.0, 4.5, 5.0)).round(2).tolist()
    [0.24, 0.16, 0.0]
    """
    edges = np.array(edges_um)
    um = (
        edges[:-1, None]
        + np.diff(edges)[:, None] * (np.arange(INFRARED.bin_points) + 0.5) / INFRARED.bin_points
    )
    with (resources.files("simulate.thermal") / "glass.csv").open(encoding="utf-8") as file:
        known_um, extinction = np.genfromtxt(file, delimiter=",", skip_header=1).T
    depth = 4e3 * np.pi * np.interp(um, known_um, extinction) * thickness_mm / um
    internal = np.where(um < known_um[-1], np.exp(-depth), 0.0)
    face = float(dielectric(1.0, GLASS_INDEX))
    transmittance = ((1.0 - face) ** 2 * internal / (1.0 - (face * internal) ** 2)).mean(axis=1)
    return np.where(transmittance > INFRARED.opaque, transmittance, 0.0)


def _reflectance(fractions: Any) -> Reflectance:
    return Reflectance(
        wavelength_nm=BETWEEN_NM, fraction=tuple(float(reflectance) for reflectance in fractions)
    )


@dataclass(frozen=True, kw_only=True)
class InfraredSurfaces:
    """Surfaces of a scene in the bins of the air.

    Parameters
    ----------
    bsdfs
        BRDFs of the materials.
    clear
        Transmittance at normal incidence of those that are panes of glass with layers, else 0,
        shape (material, bin).
    rings
        Mean radiance of each ring of the sky, W m-2 sr-1, shape (ring, bin).
    facets
        Radiance of each facet, the same in all directions, panes taken as opaque, W m-2 sr-1, shape
        (facet, bin).
    black
        That of black bodies of their temperatures, shape (facet, bin).
    """

    bsdfs: BsdfSet
    clear: Array
    rings: Array
    facets: Array
    black: Array

    def pane_transmittance(self, material: Index, cosine: Array) -> tuple[Index, Array]:
        """Return which rays meet clear panes, and the transmittance of each, shape (ray that does,
        bin).

        Parameters
        ----------
        material, cosine
            Of what each ray meets, and of its angle from the normal, shape (ray,).
        """
        glass = np.flatnonzero((self.clear.max(axis=1) > 0.0)[material])
        transmittance = np.zeros((len(glass), self.clear.shape[1]))
        for number in np.unique(material[glass]):
            rows = np.flatnonzero(material[glass] == number)
            transmittance[rows] = pane_fractions(
                cosine[glass[rows]], self.clear[number], GLASS_INDEX
            )[1]
        return glass, transmittance

    def change_by_lit_interiors(self, sky: Surroundings, ground: Array) -> float:
        """Return an upper bound of what sky and sun through panes change of diffuse surfaces behind
        them, W m-2 sr-1.

        By the most reflecting of them, below a sky wholly seen through the clearest pane.
        """
        light = np.abs(self.rings - ground).max(axis=0) + sky.sunlight / np.pi
        return float(
            (np.pi * self.bsdfs.rho_by_pi[:-1].max(axis=0) * self.clear.max(axis=0) * light).sum()
        )


def infrared_surfaces(
    temperatures: Temperatures, scene: OutdoorScene, air: InfraredAir, sky: Surroundings
) -> InfraredSurfaces:
    """Return the infrared surfaces of a scene at its time, in the bins of the air and below a sky.

    Notes
    -----
    Facets reflect diffusely, by their emissivity along the normal, whatever the incoming light: L =
    e B(T) + (1 - e) (sky + facets + ground where the scene ends + sun), solved by adding
    reflections until they converge.
    """
    balance = temperatures.balance
    facets, exposure = balance.facets, balance.exposure
    by_label = {surface.label: surface for surface in scene.material}
    specs = [by_label[name] for name in facets.surfaces.materials]
    slabs = [slab_of(scene, surface) for surface in specs]
    brdfs = tuple(infrared_brdf(surface, slab) for surface, slab in zip(specs, slabs, strict=True))
    albedo = np.array([brdf.albedo(UP, air.centre_nm)[:, 0] for brdf in brdfs])[facets.material]
    black, rings = air.black_body(temperatures.solution.faces_k[-1]), ring_radiance(sky)
    surroundings = exposure.rings @ rings + exposure.off_scene[:, None] * air.black_body(
        air.temperature_k
    )
    surroundings += exposure.lit[-1][:, None] * sky.sunlight / np.pi
    radiosity, emitted = black, (1.0 - albedo) * black
    for _ in range(MOST_REFLECTIONS):
        next_radiosity = emitted + albedo * (surroundings + exposure.sees @ radiosity)
        change, radiosity = np.abs(next_radiosity - radiosity).max(), next_radiosity
        if change <= CONVERGED * radiosity.max():
            break
    clear = [
        pane_transmittance(sum(float(layer.thickness_mm) for layer in slab.layer), air.edges_um)
        if surface.pane_transmittance is not None and slab.layer
        else np.zeros(len(air.low_um))
        for surface, slab in zip(specs, slabs, strict=True)
    ]
    return InfraredSurfaces(
        bsdfs=BsdfSet.of(brdfs, air.centre_nm),
        clear=np.array(clear),
        rings=rings,
        facets=radiosity,
        black=black,
    )
