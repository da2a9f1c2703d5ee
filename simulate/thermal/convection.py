"""Heat and water between a surface and the air: convection by a chosen law, and condensation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.outdoor.description.surroundings import ConvectionLaw

Array = NDArray[np.float64]
ZERO_C = 273.15
# Psychrometric constant at 1013 hPa, Pa/K; it scales with pressure.
PSYCHROMETRIC_PA_K, STANDARD_HPA = 66.5, 1013.0
# Offset and coefficient of the wind, W m-2 K-1 and W m-2 K-1 / (m/s).
LINEAR_LAWS = {"mcadams": (5.7, 3.8), "watmuff": (2.8, 3.0)}


def vapour_pressure_pa(dew_point_k: ArrayLike) -> Array:
    """Return the pressure of vapour that is saturated at a temperature, Pa (Magnus formula over water)."""
    celsius = np.asarray(dew_point_k, float) - ZERO_C
    return 611.2 * np.exp(17.62 * celsius / (243.12 + celsius))


def dew_point_k(air_k: ArrayLike, relative_humidity: ArrayLike) -> Array:
    """Return the dew point of air with a relative humidity (0 to 1), K: `vapour_pressure_pa` inverted."""
    ratio = np.log(np.asarray(relative_humidity, float) * vapour_pressure_pa(air_k) / 611.2)
    return ZERO_C + 243.12 * ratio / (17.62 - ratio)


@dataclass(frozen=True, kw_only=True)
class Exchange:
    """How surfaces exchange heat and water with the air.

    Parameters
    ----------
    law, constant_w_m2_k
        "buoyant" (natural convection plus a coefficient times wind), "mcadams" (5.7 + 3.8 v), "watmuff" (2.8 + 3 v) or
        "constant", of which this is the coefficient, W m-2 K-1.
    wind_coefficient
        Of the law "buoyant", shape (surface,), W m-2 K-1 / (m/s).
    upward
        Vertical component of the unit normals, shape (surface,).
    condensation
        Whether vapour condenses on surfaces below the dew point.
    """

    law: ConvectionLaw
    constant_w_m2_k: float
    wind_coefficient: Array
    upward: Array
    condensation: bool = True

    def loss(
        self, surface_k: Array, air_k: Array, wind_m_s: Array, vapour_pa: Array, pressure_hpa: Array
    ) -> tuple[Array, Array]:
        """Return the heat flux from surfaces to air, W m-2, and its derivative with their temperature, W m-2 K-1.

        Notes
        -----
        Natural convection by TARP (Walton, NBSSIR 83-2655, 1983): on a surface warmer than the air and facing up, or
        colder and facing down, h = 9.482 dT^(1/3)/(7.238 - |cos|), else 1.810 dT^(1/3)/(1.382 + |cos|). Condensation:
        (h/gamma) (e_s(T) - e_a) where the surface is below the dew point; its water runs off and does not evaporate.
        """
        excess = surface_k - air_k
        if self.law == "buoyant":
            steep = np.abs(self.upward)
            unstable = excess * self.upward > 0.0
            natural = np.where(unstable, 9.482 / (7.238 - steep), 1.810 / (1.382 + steep)) * np.cbrt(np.abs(excess))
            forced = self.wind_coefficient * wind_m_s
            h, slope = natural + forced, 4.0 / 3.0 * natural + forced
        else:
            offset, factor = LINEAR_LAWS.get(self.law, (self.constant_w_m2_k, 0.0))
            h = slope = offset + factor * wind_m_s + np.zeros_like(excess)
        flux, saturated = h * excess, vapour_pressure_pa(surface_k)
        wet = (saturated < vapour_pa) & self.condensation
        exchange = np.where(wet, h / (PSYCHROMETRIC_PA_K * pressure_hpa / STANDARD_HPA), 0.0)
        steepness = saturated * 17.62 * 243.12 / (243.12 + surface_k - ZERO_C) ** 2
        return flux + exchange * (saturated - vapour_pa), slope + exchange * steepness
