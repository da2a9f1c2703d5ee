"""Slabs that ship (`library.toml`), and the slab of each material of a scene."""

from dataclasses import replace
from functools import cache
from importlib import resources

import numpy as np

from labdata.camera_description import Parameter
from labdata.errors import BadInput
from labdata.serialiser import from_mapping, read_toml
from simulate.radiance.outdoor.description.material import MaterialSpec
from simulate.radiance.outdoor.description.scene import OutdoorScene
from simulate.radiance.outdoor.description.slab import Slab
from simulate.radiance.sky.sun import sun_spectrum


@cache
def library() -> dict[str, Slab]:
    """Return the slabs that ship by their names."""
    with resources.as_file(resources.files("simulate.thermal") / "library.toml") as path:
        tables = read_toml(path)["slab"]
    return {name: from_mapping(table | {"label": name}, Slab, where="library.toml") for name, table in tables.items()}


def slab_of(scene: OutdoorScene, surface: MaterialSpec) -> Slab:
    """Return the slab of a material of a scene, its absorptivity known.

    Raises
    ------
    BadInput
        If the material has no slab, or names one that neither the scene nor the library has.

    Notes
    -----
    Where the scene states the material's reflectance by numbers, the absorptivity is 1 minus that reflectance over the
    sun's spectrum, unless the scene's slab states it; elsewhere that of the slab.
    """
    described = {slab.label: slab for slab in scene.slab}
    name = surface.slab or surface.made.slab
    if name is None:
        raise BadInput(
            f"a material must have a slab for its temperature, got {surface.label!r} without one; give slab = one of "
            f"{', '.join(sorted({*described, *library()}))}, or describe one in [[slab]]"
        )
    if name not in described and name not in library():
        raise BadInput(
            f"slab must be one of {', '.join(sorted({*described, *library()}))}, got {name!r} of {surface.label!r}"
        )
    slab = described.get(name) or library()[name]
    if slab.absorptivity is not None and (name in described or surface.reflectance is None):
        return slab
    return replace(slab, absorptivity=_absorptivity(surface))


def _absorptivity(surface: MaterialSpec) -> Parameter:
    """1 minus the reflectance over the sun's spectrum; tables end before the sun does and are constant from there."""
    sun = sun_spectrum()
    nm = np.asarray(sun.wavelength_nm)
    reflectance = np.trapezoid(surface.made.reflected(nm) * sun.density, nm) / np.trapezoid(sun.density, nm)
    return Parameter(
        value=float(1.0 - reflectance),
        standing="derived",
        source=f"reflectance of {surface.label!r} over the sun from {nm[0]:.0f} to {nm[-1]:.0f} nm, its table constant "
        f"beyond {surface.made.wavelength_nm[-1]:.0f} nm",
    )
