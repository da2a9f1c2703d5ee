"""Materials: spectral reflectance and transmittance, BRDF, the shipped library, and panes of
glass.
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from labdata.errors import BadInput, check
from labdata.serialiser import from_toml
from simulate.arrays import Array
from simulate.radiance.brdf.microfacet import dielectric, dielectric_polarised
from simulate.radiance.brdf.protocol import Lambert, Reflectance

if TYPE_CHECKING:
    from simulate.radiance.brdf.protocol import Brdf


Finish = Literal["diffuse", "glossy", "metal", "retroreflective"]
# Parameters that each finish needs in addition to the tables.
NEEDED = {
    "diffuse": (),
    "glossy": ("roughness", "refractive_index"),
    "metal": ("roughness",),
    "retroreflective": ("retroreflected_share", "half_width_deg"),
}


@dataclass(frozen=True, kw_only=True)
class Material:
    """Spectral reflectance and transmittance of a surface, and its finish.

    Parameters
    ----------
    wavelength_nm
        Wavelengths of the tables, ascending, nm; one wavelength makes a grey material.
    reflectance, transmittance
        Fractions of the light, dimensionless, together at most 1; linear between wavelengths,
        constant outside. One value applies to all wavelengths.
    finish
        "diffuse" (Lambertian), "glossy" (a dielectric over a diffuse base of this reflectance),
        "metal" (rough mirror of this reflectance at normal incidence) or "retroreflective" (a lobe
        back to the light over a diffuse base).
    roughness
        Roughness of dielectric or metal (GGX's a), dimensionless.
    refractive_index
        Of the dielectric, dimensionless.
    retroreflected_share, half_width_deg
        Fraction of the light in the lobe, and the angle between light and viewer at half of its
        maximum.
    emissivity
        Between 8 and 12 um, dimensionless; None if unknown.
    slab
        Name of the slab (`simulate.thermal.temperatures`) that it covers unless a scene says
        otherwise; None without one.
    source
        Where the numbers come from.
    """

    wavelength_nm: tuple[float, ...] = (550.0,)
    reflectance: tuple[float, ...] = (0.0,)
    transmittance: tuple[float, ...] = (0.0,)
    finish: Finish = "diffuse"
    roughness: float | None = None
    refractive_index: float | None = None
    retroreflected_share: float | None = None
    half_width_deg: float | None = None
    emissivity: float | None = None
    slab: str | None = None
    source: str = ""

    def __post_init__(self) -> None:
        self._check_tables()
        for name in {name for names in NEEDED.values() for name in names}:
            is_given, is_needed = getattr(self, name) is not None, name in NEEDED[self.finish]
            if is_given != is_needed:
                rule = "must be given for" if is_needed else "must not be given for"
                raise BadInput(f"{name} {rule} a {self.finish} material")
        check(self, fraction="emissivity")
        _ = self.brdf()

    def _check_tables(self) -> None:
        count = len(self.wavelength_nm)
        if (
            count == 0
            or len(self.reflectance) not in (1, count)
            or len(self.transmittance) not in (1, count)
        ):
            raise BadInput(
                "a material must have one reflectance and one transmittance for all wavelengths "
                f"or for each, got {count} wavelengths, {len(self.reflectance)} and "
                f"{len(self.transmittance)}"
            )
        for reflectance, transmittance in zip(
            self._by_wavelength(self.reflectance),
            self._by_wavelength(self.transmittance),
            strict=True,
        ):
            if reflectance < 0.0 or transmittance < 0.0 or reflectance + transmittance > 1.0:
                raise BadInput(
                    "reflectance and transmittance must not be negative nor exceed 1 together, "
                    f"got {reflectance:g} and {transmittance:g}"
                )

    def _by_wavelength(self, fractions: tuple[float, ...]) -> tuple[float, ...]:
        """Return one value per wavelength."""
        return fractions * len(self.wavelength_nm) if len(fractions) == 1 else fractions

    def reflectance_at(self, wavelength_nm: ArrayLike) -> Array:
        """Return the reflectance at wavelengths, dimensionless; of the base alone under a coat or
        lobe.
        """
        return np.interp(
            np.asarray(wavelength_nm, float),
            self.wavelength_nm,
            self._by_wavelength(self.reflectance),
        )

    def transmittance_at(self, wavelength_nm: ArrayLike) -> Array:
        """Return the transmittance at wavelengths, dimensionless."""
        return np.interp(
            np.asarray(wavelength_nm, float),
            self.wavelength_nm,
            self._by_wavelength(self.transmittance),
        )

    def brdf(self) -> "Brdf":
        """Return the BRDF."""
        from simulate.radiance.brdf.glossy import Glossy, Metal, Retroreflector

        table = Reflectance(
            wavelength_nm=self.wavelength_nm, fraction=self._by_wavelength(self.reflectance)
        )
        if (
            self.finish == "glossy"
            and self.roughness is not None
            and self.refractive_index is not None
        ):
            return Glossy(
                reflectance=table, roughness=self.roughness, refractive_index=self.refractive_index
            )
        if self.finish == "metal" and self.roughness is not None:
            return Metal(reflectance=table, roughness=self.roughness)
        if self.retroreflected_share is not None and self.half_width_deg is not None:
            lobe = Reflectance(fraction=(self.retroreflected_share,))
            return Retroreflector(
                retroreflectance=lobe, reflectance=table, half_width_deg=self.half_width_deg
            )
        return Lambert(reflectance=table)


@dataclass(frozen=True, kw_only=True)
class Shelf:
    """Materials by name.

    Parameters
    ----------
    material
        Name and description of each.
    """

    material: dict[str, Material]


@cache
def shelf() -> Shelf:
    """Return the shipped materials."""
    with resources.as_file(resources.files("simulate.radiance") / "materials.toml") as path:
        return from_toml(path, Shelf)


def material_names() -> tuple[str, ...]:
    """Return the names of the shipped materials."""
    return tuple(sorted(shelf().material))


def material(name: str) -> Material:
    """Return a shipped material by name.

    Raises BadInput if there is none of that name.
    """
    if name not in shelf().material:
        raise BadInput(f"a material must be one of {', '.join(material_names())}, got {name!r}")
    return shelf().material[name]


# Cosine of the most grazing angle that is distinguished from 90 degrees.
GRAZING = 1e-6


def clearest(refractive_index: float) -> float:
    """Return the transmittance at normal incidence of a pane that absorbs nothing,
    dimensionless.
    """
    face = float(dielectric(1.0, refractive_index))
    return (1.0 - face) / (1.0 + face)


def internal_transmittance(transmittance: ArrayLike, refractive_index: float) -> Array:
    """Return the internal transmittance of the glass at normal incidence, from a pane's
    transmittance.

    Notes
    -----
    T = (1 - r)^2 t / (1 - r^2 t^2) at normal incidence, r the reflectance of a face, solved for t.
    """
    pane, face = np.asarray(transmittance, float), float(dielectric(1.0, refractive_index))
    face_squared = (1.0 - face) ** 2
    return 2.0 * pane / (face_squared + np.sqrt(face_squared**2 + 4.0 * (face * pane) ** 2))


def pane_fractions(
    cosine: Array, transmittance: Array, refractive_index: float
) -> tuple[Array, Array]:
    """Return reflectance and transmittance of a pane for unpolarised light, each of shape (ray,
    band).

    By cosines of the angles of incidence (ray,), transmittance at normal incidence (band,) and
    index of the glass.

    Notes
    -----
    All reflections between the faces are summed without interference (Born and Wolf, Principles of
    Optics, 7.6, for a coherence length below the thickness): for each polarisation T = (1 - r)^2 t
    / (1 - r^2 t^2), R = r (1 + t T), with t to the power of 1/cos of the angle in the glass. The
    rest is absorbed.
    """
    clipped_cosine = np.clip(np.abs(cosine), GRAZING, 1.0)
    internal_cosine = np.sqrt(1.0 - (1.0 - clipped_cosine**2) / refractive_index**2)
    internal = (
        internal_transmittance(transmittance, refractive_index)[None]
        ** (1.0 / internal_cosine)[:, None]
    )
    reflected, transmitted = np.zeros(internal.shape), np.zeros(internal.shape)
    for polarised in dielectric_polarised(clipped_cosine, refractive_index):
        face = polarised[:, None]
        polarised_transmittance = (1.0 - face) ** 2 * internal / (1.0 - (face * internal) ** 2)
        transmitted += 0.5 * polarised_transmittance
        reflected += 0.5 * face * (1.0 + internal * polarised_transmittance)
    return reflected, transmitted
