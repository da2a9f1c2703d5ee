"""Heat and water between a surface and the air: convection by a chosen law, and condensation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.world.description.surroundings import ConvectionLaw

Array = NDArray[np.float64]
ZERO_C = 273.15
# Psychrometric constant at 1013 hPa, Pa/K; it scales with pressure.
PSYCHROMETRIC_PA_K, STANDARD_HPA = 66.5, 1013.0


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
    law
        "buoyant" (natural convection plus a coefficient times wind), "mcadams" (5.7 + 3.8 v), "watmuff" (2.8 + 3 v) or
        "constant".
    constant_w_m2_k
        Coefficient of the law "constant", W m-2 K-1.
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
        self, surface_k: Array, air_k: ArrayLike, wind_m_s: ArrayLike, vapour_pa: ArrayLike, pressure_hpa: ArrayLike
    ) -> tuple[Array, Array]:
        """Return the heat flux from surfaces to air, W m-2, and its derivative with their temperature, W m-2 K-1.

        Notes
        -----
        Natural convection by TARP (Walton, NBSSIR 83-2655, 1983): on a surface warmer than the air and facing up, or
        colder and facing down, h = 9.482 dT^(1/3)/(7.238 - |cos|), else 1.810 dT^(1/3)/(1.382 + |cos|). Condensation:
        (h/gamma) (e_s(T) - e_a) where the surface is below the dew point. Water that has condensed runs off: it is not
        kept for evaporation.
        """
        excess = surface_k - air_k
        if self.law == "buoyant":
            steep = np.abs(self.upward)
            unstable = excess * self.upward > 0.0
            factor = np.where(unstable, 9.482 / (7.238 - steep), 1.810 / (1.382 + steep))
            natural = factor * np.cbrt(np.abs(excess))
            forced = self.wind_coefficient * wind_m_s
            h, slope = natural + forced, 4.0 / 3.0 * natural + forced
        else:
            offset, factor = {"mcadams": (5.7, 3.8), "watmuff": (2.8, 3.0)}.get(self.law, (self.constant_w_m2_k, 0.0))
            h = slope = offset + factor * np.asarray(wind_m_s, float) + np.zeros_like(excess)
        flux = h * excess
        if self.condensation:
            saturated = vapour_pressure_pa(surface_k)
            exchange = h / (PSYCHROMETRIC_PA_K * np.asarray(pressure_hpa) / STANDARD_HPA)
            wet = saturated < vapour_pa
            flux = flux + np.where(wet, exchange * (saturated - vapour_pa), 0.0)
            steepness = saturated * 17.62 * 243.12 / (243.12 + surface_k - ZERO_C) ** 2
            slope = slope + np.where(wet, exchange * steepness, 0.0)
        return flux, slope
