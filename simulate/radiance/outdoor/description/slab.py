"""What a surface consists of below its face, for its temperature: a table of a scene's file."""

from dataclasses import dataclass, fields, replace

from labdata.camera_description import Parameter, must_be_a_share, must_be_positive, must_not_be_negative
from labdata.errors import BadInput

# Numbers of a slab that does not state them: usual surfaces, dry, smooth, adiabatic behind.
EMISSIVITY, NOTHING, SMOOTH = Parameter(value=0.95), Parameter(value=0.0), Parameter(value=3.0)
SHARES = ("emissivity", "emissivity_mwir", "absorptivity", "latent_fraction")


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
        must_be_positive(self, *(item.name for item in fields(self)))


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
        Fraction of sunlight that is absorbed, dimensionless; None: from the reflectance of the scene's material.
    latent_fraction
        Fraction of the absorbed sun that evaporates water, dimensionless.
    wind_coefficient
        Convection for each m/s of wind, W m-2 K-1 / (m/s), of the law "buoyant": 3 on smooth plates, 5 on rough ground.
    back_w_m2_k
        Heat transfer coefficient behind the last layer, W m-2 K-1; 0 is adiabatic.
    back_c
        Temperature behind, C; None: that of the air.
    max_c
        Temperature that the face cannot exceed because it melts, C; None: no limit.
    temperature_c, above_air_k, above_mean_air_k
        In place of layers, one of: a constant temperature, C; an excess over the air's temperature at each time, K;
        an excess over the mean of the air's temperature, K.
    source
        Where the numbers come from that do not name their own source.
    """

    label: str = ""
    layer: tuple[Layer, ...] = ()
    emissivity: Parameter = EMISSIVITY
    emissivity_mwir: Parameter | None = None
    absorptivity: Parameter | None = None
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
                "a slab must have layers or else one of temperature_c, above_air_k and above_mean_air_k, "
                f"got {len(self.layer)} layers and {sum(rule is not None for rule in rules)} of these"
            )
        must_be_a_share(self, *(name for name in SHARES if getattr(self, name) is not None))
        must_not_be_negative(self, "wind_coefficient", "back_w_m2_k")
        must_be_positive(self, "emissivity")

    @property
    def prescribed(self) -> bool:
        """Whether its temperature is prescribed."""
        return not self.layer

    def parameters(self) -> dict[str, Parameter]:
        """Return every number by its name, such as "layer 1 thickness_mm", with its source and standing."""
        tables = [("", self), *((f"layer {number} ", layer) for number, layer in enumerate(self.layer, 1))]
        found = {
            place + item.name: value
            for place, table in tables
            for item in fields(table)
            if isinstance(value := getattr(table, item.name), Parameter)
        }
        return {name: value if value.source else replace(value, source=self.source) for name, value in found.items()}
