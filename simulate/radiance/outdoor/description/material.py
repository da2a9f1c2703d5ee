"""A material of a scene by name, by its numbers, as measured, or as a pane of glass: a table of the scene's file."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.materials.library import material
from simulate.radiance.materials.material import Finish, Material
from simulate.radiance.materials.pane import clearest

# Refractive index of soda-lime glass.
WINDOW_GLASS = 1.52


@dataclass(frozen=True, kw_only=True)
class MaterialSpec:
    """A material by name: from the shelf of those that ship, or by its numbers; it may glow.

    Parameters
    ----------
    label
        Its name in the scene.
    library
        Name on the shelf (`simulate.radiance.materials.library`); or else:
    wavelength_nm, reflectance, finish, roughness, refractive_index, retroreflected_share, half_width_deg
        As of `simulate.radiance.materials.material.Material`.
    measured
        An .npz file of a measured BRDF (`simulate.radiance.outdoor.measured_surface`), relative to the scene's, in place
        of library and numbers.
    pane_transmittance
        Transmittance at normal incidence of a thin pane of glass, for each wavelength or one for all, in place of
        library and numbers: its surfaces mirror and let through light on both sides (`materials.pane`), by the
        `refractive_index` given or that of window glass. Each triangle of its object is a whole pane.
    glow_lm_per_m2
        Luminous exitance of a surface that glows, lm/m2; its spectrum is that of `lamp`.
    lamp
        Kind of lamp whose spectrum the glow has.
    slab
        What lies below the surface, for its temperature: a label of the scene's slabs or a name in
        `simulate.thermal.library`; None: that of the library entry.
    """

    label: str
    library: str | None = None
    wavelength_nm: tuple[float, ...] = (550.0,)
    reflectance: tuple[float, ...] | None = None
    finish: Finish = "matt"
    roughness: float | None = None
    refractive_index: float | None = None
    retroreflected_share: float | None = None
    half_width_deg: float | None = None
    measured: str | None = None
    pane_transmittance: tuple[float, ...] | None = None
    glow_lm_per_m2: float = 0.0
    lamp: str = "incandescent"
    slab: str | None = None

    def __post_init__(self) -> None:
        kinds = (self.library, self.reflectance, self.measured, self.pane_transmittance)
        if sum(given is not None for given in kinds) != 1:
            raise BadInput(
                "a material must have a library entry, a reflectance, a measured file or a pane's transmittance, "
                f"got {self.label!r}"
            )
        if not self.glow_lm_per_m2 >= 0.0:
            raise BadInput(f"glow_lm_per_m2 must not be negative, got {self.glow_lm_per_m2:g} of {self.label!r}")
        if any(self.made.transmittance):
            raise BadInput(
                f"out of doors light goes through panes alone (pane_transmittance), got {self.label!r} of another kind"
            )
        self._check_pane()

    def _check_pane(self) -> None:
        if self.pane_transmittance is None:
            return
        if self.glow_lm_per_m2 > 0.0:
            raise BadInput(f"a pane must not glow, got {self.label!r} of {self.glow_lm_per_m2:g} lm/m2")
        if not self.glass_index > 1.0:
            raise BadInput(f"refractive_index of a pane must exceed 1, got {self.glass_index:g} of {self.label!r}")
        count = len(self.pane_transmittance)
        if count not in (1, len(self.wavelength_nm)):
            raise BadInput(
                f"pane_transmittance must be one for all wavelengths or one for each, got {count} "
                f"for {len(self.wavelength_nm)} of {self.label!r}"
            )
        most = clearest(self.glass_index)
        for share in self.pane_transmittance:
            if not 0.0 <= share <= most:
                raise BadInput(
                    f"pane_transmittance must lie between 0 and what the faces leave, {most:.4f}, got {share:g} "
                    f"of {self.label!r}"
                )

    @property
    def glass_index(self) -> float:
        """Refractive index of a pane's glass."""
        return WINDOW_GLASS if self.refractive_index is None else self.refractive_index

    def let_through(self, wavelength_nm: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return a pane's transmittance at normal incidence, shape (band,)."""
        shares = self.pane_transmittance or (0.0,)
        each = shares * len(self.wavelength_nm) if len(shares) == 1 else shares
        return np.interp(wavelength_nm, self.wavelength_nm, each)

    @cached_property
    def made(self) -> Material:
        """The material; of a measured one only what glows."""
        if self.library is not None:
            return material(self.library)
        return Material(
            wavelength_nm=self.wavelength_nm,
            reflectance=self.reflectance or (0.0,),
            finish=self.finish,
            roughness=self.roughness,
            refractive_index=None if self.pane_transmittance is not None else self.refractive_index,
            retroreflected_share=self.retroreflected_share,
            half_width_deg=self.half_width_deg,
        )
