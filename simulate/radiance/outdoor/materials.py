"""Materials of a scene, and the layers below their surfaces: tables of a scene's file."""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from labdata.camera.parameters import Parameter
from labdata.errors import BadInput, check
from simulate.arrays import Array
from simulate.radiance.materials import Finish, Material, clearest, material

# Refractive index of soda-lime glass.
WINDOW_GLASS = 1.52


@dataclass(frozen=True, kw_only=True)
class MaterialSpec:
    """A material: from the library, by its parameters, measured, or a pane of glass; it may emit
    light.

    Parameters
    ----------
    label
        Its name in the scene.
    library
        Name on the shelf (`simulate.radiance.materials`); or else:
    wavelength_nm, reflectance, finish, roughness, refractive_index, retroreflected_share,
    half_width_deg
        As of `simulate.radiance.materials.Material`.
    measured
        An .npz file of a measured BRDF (`simulate.radiance.brdf.protocol`), relative to the
        scene's, in place of library and numbers.
    pane_transmittance
        Transmittance at normal incidence of a thin pane of glass, for each wavelength or one for
        all, in place of library and parameters: it reflects and transmits on both sides, by the
        `refractive_index` given or that of window glass. Each triangle of its object is a complete
        pane.
    glow_lm_per_m2
        Luminous exitance of an emitting surface, lm/m2; its spectrum is that of `lamp`.
    lamp
        Kind of lamp that gives the spectrum of the emission.
    slab
        What lies below the surface, for its temperature: a label of the scene's slabs or a name in
        `simulate.thermal.temperatures`; None: that of the library entry.
    note
        What was assumed of it, in a sentence, which the notes of its pictures repeat.
    """

    label: str
    library: str | None = None
    wavelength_nm: tuple[float, ...] = (550.0,)
    reflectance: tuple[float, ...] | None = None
    finish: Finish = "diffuse"
    roughness: float | None = None
    refractive_index: float | None = None
    retroreflected_share: float | None = None
    half_width_deg: float | None = None
    measured: str | None = None
    pane_transmittance: tuple[float, ...] | None = None
    glow_lm_per_m2: float = 0.0
    lamp: str = "incandescent"
    slab: str | None = None
    note: str = ""

    def __post_init__(self) -> None:
        kinds = (self.library, self.reflectance, self.measured, self.pane_transmittance)
        if sum(kind is not None for kind in kinds) != 1:
            raise BadInput(
                "a material must have a library entry, a reflectance, a measured file or a "
                f"pane's transmittance, got {self.label!r}"
            )
        check(self, of=f" of {self.label!r}", not_negative="glow_lm_per_m2")
        if any(self.material.transmittance):
            raise BadInput(
                f"out of doors light goes through panes alone (pane_transmittance), got "
                f"{self.label!r} of another kind"
            )
        self._check_pane()

    def _check_pane(self) -> None:
        if self.pane_transmittance is None:
            return
        if self.glow_lm_per_m2 > 0.0:
            raise BadInput(
                f"a pane must not glow, got {self.label!r} of {self.glow_lm_per_m2:g} lm/m2"
            )
        if not self.glass_index > 1.0:
            raise BadInput(
                f"refractive_index of a pane must exceed 1, got {self.glass_index:g} of "
                f"{self.label!r}"
            )
        count = len(self.pane_transmittance)
        if count not in (1, len(self.wavelength_nm)):
            raise BadInput(
                f"pane_transmittance must be one for all wavelengths or one for each, got {count} "
                f"for {len(self.wavelength_nm)} of {self.label!r}"
            )
        limit = clearest(self.glass_index)
        for transmittance in self.pane_transmittance:
            if not 0.0 <= transmittance <= limit:
                raise BadInput(
                    f"pane_transmittance must lie between 0 and what the faces leave, {limit:.4f}, "
                    f"got {transmittance:g} of {self.label!r}"
                )

    @property
    def glass_index(self) -> float:
        """Refractive index of a pane's glass."""
        return WINDOW_GLASS if self.refractive_index is None else self.refractive_index

    def let_through(self, wavelength_nm: Array) -> Array:
        """Return a pane's transmittance at normal incidence, shape (band,)."""
        fractions = self.pane_transmittance or (0.0,)
        transmittances = fractions * len(self.wavelength_nm) if len(fractions) == 1 else fractions
        return np.interp(wavelength_nm, self.wavelength_nm, transmittances)

    @cached_property
    def material(self) -> Material:
        """The material; of a measured one without its BRDF."""
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


# Numbers of a slab that does not state them: usual surfaces, dry, smooth, adiabatic behind.
EMISSIVITY, NOTHING, SMOOTH = Parameter(value=0.95), Parameter(value=0.0), Parameter(value=3.0)
SHARES = ("emissivity", "emissivity_mwir", "absorptivity", "transmittance", "latent_fraction")


@dataclass(frozen=True, kw_only=True)
class Layer:
    """A layer of one material.

    Parameters
    ----------
    thickness_mm
        Thickness, mm.
    conductivity_w_m_k
        Thermal conductivity, W m-1 K-1.
    density_kg_m3
        Density, kg/m3.
    specific_heat_j_kg_k
        Specific heat capacity, J kg-1 K-1.
    """

    thickness_mm: Parameter
    conductivity_w_m_k: Parameter
    density_kg_m3: Parameter
    specific_heat_j_kg_k: Parameter

    def __post_init__(self) -> None:
        check(self, positive=(item.name for item in fields(self)))


@dataclass(frozen=True, kw_only=True)
class Slab:
    """Layers of a surface from the face inwards, or the rule that sets its temperature.

    Parameters
    ----------
    label
        Its name.
    layer
        Layers, from the face inwards; none where the temperature is prescribed.
    emissivity
        Hemispherical, 8 to 14 um, dimensionless.
    emissivity_mwir
        3.5 to 4.1 um, dimensionless; None if unknown.
    absorptivity
        Fraction of sunlight that is absorbed, dimensionless; None: from the reflectance of the
        scene's material.
    transmittance
        Fraction of sunlight that goes through, as of glass, dimensionless; what is neither absorbed
        nor transmitted is reflected.
    latent_fraction
        Fraction of the absorbed sun that evaporates water, dimensionless.
    wind_coefficient
        Convection for each m/s of wind, W m-2 K-1 / (m/s), of the law "buoyant": 3 on smooth
        plates, 5 on rough ground.
    back_w_m2_k
        Heat transfer coefficient behind the last layer, W m-2 K-1; 0 is adiabatic.
    back_c
        Temperature behind, C; None: that of the air.
    max_c
        Temperature that the face cannot exceed because it melts, C; None: no limit.
    temperature_c, above_air_k, above_mean_air_k
        In place of layers, one of: a constant temperature, C; an excess over the air's temperature
        at each time, K; an excess over the mean of the air's temperature, K.
    source
        Where the numbers come from that do not name their own source.
    """

    label: str = ""
    layer: tuple[Layer, ...] = ()
    emissivity: Parameter = EMISSIVITY
    emissivity_mwir: Parameter | None = None
    absorptivity: Parameter | None = None
    transmittance: Parameter = NOTHING
    latent_fraction: Parameter = NOTHING
    wind_coefficient: Parameter = SMOOTH
    back_w_m2_k: Parameter = NOTHING
    back_c: Parameter | None = None
    max_c: Parameter | None = None
    temperature_c: Parameter | None = None
    above_air_k: Parameter | None = None
    above_mean_air_k: Parameter | None = None
    source: str = ""

    def __post_init__(self) -> None:
        rules = (self.temperature_c, self.above_air_k, self.above_mean_air_k)
        if sum(rule is not None for rule in rules) != (0 if self.layer else 1):
            raise BadInput(
                "a slab must have layers or else one of temperature_c, above_air_k and "
                f"above_mean_air_k, got {len(self.layer)} layers and "
                f"{sum(rule is not None for rule in rules)} of these"
            )
        check(
            self,
            fraction=SHARES,
            not_negative="wind_coefficient back_w_m2_k",
            positive="emissivity",
        )

    def parameters(self) -> dict[str, Parameter]:
        """Return every number by its name, such as "layer 1 thickness_mm", with its source and
        standing.
        """
        tables = [
            ("", self),
            *((f"layer {number} ", layer) for number, layer in enumerate(self.layer, 1)),
        ]
        parameters = {
            prefix + item.name: value
            for prefix, table in tables
            for item in fields(table)
            if isinstance(value := getattr(table, item.name), Parameter)
        }
        return {
            name: value if value.source else replace(value, source=self.source)
            for name, value in parameters.items()
        }
