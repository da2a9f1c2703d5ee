"""Infrared image of a scene without an imager: radiance in bins, truth, terms, and notes on what
limits it.
"""

from dataclasses import dataclass

import numpy as np

from simulate.arrays import Array, Array32
from simulate.effect_selection import OptionalEffect
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.auxiliary_layers import AuxiliaryLayers
from simulate.radiance.spectrum import band_radiance
from simulate.thermal.air import InfraredAir
from simulate.thermal.slab import ZERO_C, vapour_pressure_pa
from simulate.thermal.thresholds import INFRARED

# Gas constant of water vapour, J kg-1 K-1.
VAPOUR_GAS = 461.5


@dataclass(frozen=True, kw_only=True)
class InfraredPicture:
    """Infrared image without an imager.

    Parameters
    ----------
    edges_um
        Edges of the spectral bins, um.
    radiance
        Radiance in each bin, W m-2 sr-1, shape (row, col, bin): at the middle of each pixel, and
        where objects or faces meet the mean over its parts.
    truth
        Temperature, K, NaN for the sky, range, material, object and normal of the middles of the
        pixels.
    error_k
        Monte Carlo error of a pixel that shows a surface, root mean square, as a temperature
        difference, K.
    rays
        Rays of a pixel to its surroundings, of diffuse surfaces and of glossy ones or metals.
    effects, left_out
        What terms change, and what those left out could change: mK of apparent temperature, at the
        pixel where most.
    notes
        How it was made, in sentences.
    """

    edges_um: tuple[float, ...]
    radiance: Array32
    truth: AuxiliaryLayers
    error_k: float
    rays: tuple[int, int]
    effects: tuple[OptionalEffect, ...]
    left_out: tuple[OptionalEffect, ...]
    notes: tuple[str, ...] = ()

    def apparent_k(self) -> Array32:
        """Return the temperature of black bodies of the pixels' radiance over all bins, shape (row,
        col), K.
        """
        return apparent_temperature(
            self.radiance.sum(axis=2), (self.edges_um[0], self.edges_um[-1])
        )

    def text(self, netd_mk: float) -> str:
        """Return retained and neglected terms over the noise of an imager, as lines."""
        rows = [(effect, "kept") for effect in self.effects] + [
            (effect, "left out") for effect in self.left_out
        ]
        rows.sort(key=lambda row: -row[0].influence)
        lines = [
            f"{'term of infrared radiance':46}  {'changes at most, mK':>20}  {'times the NETD':>14}"
        ]
        lines += [
            (
                f"{effect.name:46}  {effect.influence:20.3g}  {effect.influence / netd_mk:14.2g}  "
                f"{verdict}"
            )
            for effect, verdict in rows
        ]
        by_chance = (
            f"by chance surfaces are uncertain by {1e3 * self.error_k:.2g} mK, root mean square"
        )
        return "\n".join([*lines, f"{by_chance}; NETD of a pixel {netd_mk:.3g} mK"])


def apparent_temperature(radiance: Array, band_um: tuple[float, float]) -> Array32:
    """Return temperatures of black bodies of given radiances (W m-2 sr-1) in a band (um), K, to
    1e-4 K.

    Examples
    --------
    >>> float(apparent_temperature(np.array([38.5004]), (8.0, 12.0))[0].round(3))
    300.0
    """
    low, high = 150.0, 400.0
    while band_radiance(*band_um, high) < radiance.max(initial=0.0):
        high *= 1.5
    kelvin = np.arange(low, high + 0.1, 0.1)
    # The logarithm is nearly straight against 1/T.
    log_radiance = np.log(band_radiance(*band_um, kelvin))
    inverse_kelvin = np.interp(np.log(np.maximum(radiance, 1e-30)), log_radiance, 1.0 / kelvin)
    return (1.0 / inverse_kelvin).astype(np.float32)


def notes_beyond_laws(
    air: InfraredAir, sun: Array, viewpoint: Viewpoint, truth: AuxiliaryLayers
) -> tuple[str, ...]:
    """Return what of a picture lies beyond the range of the laws of air, sky and sun, in sentences.

    Parameters
    ----------
    air, sun
        The air near the ground, and the direction of the sun, shape (3,).
    viewpoint, truth
        Pixels, and what they show.
    """
    (coldest, warmest), (driest, wettest) = INFRARED.fitted_c, INFRARED.fitted_humidity
    celsius, elevation = (
        air.temperature_k - ZERO_C,
        float(np.rad2deg(np.arcsin(np.clip(sun[2], -1.0, 1.0)))),
    )
    vapour_pa = 1e-3 * air.vapour_g_m3 * VAPOUR_GAS * air.temperature_k
    humidity = vapour_pa / float(vapour_pressure_pa(air.temperature_k))
    surface, notes = truth.object >= 0, []
    if not (coldest <= celsius <= warmest and driest <= humidity <= wettest + 1e-6):
        notes.append(
            f"air of {celsius:.0f} C and {100.0 * humidity:.0f} % relative humidity lies beyond "
            f"the {coldest:g} to {warmest:g} C and {100.0 * driest:.0f} to {100.0 * wettest:.0f} "
            "% to which its transmittance was fitted"
        )
    far_km = 1e-3 * float(truth.range_m[surface].max(initial=0.0))
    if far_km > INFRARED.farthest_km:
        notes.append(
            f"surfaces are up to {far_km:.1f} km away: the air was compared with MODTRAN 5 up to "
            f"{INFRARED.farthest_km:g} km, and the earth is flat here"
        )
    height = viewpoint.rays(*(np.indices(viewpoint.shape).reshape(2, -1) + 0.5))[1][:, 2]
    low = ~surface.ravel() & (height > 0.0) & (height < np.sin(np.deg2rad(INFRARED.lowest_sky_deg)))
    if low.any():
        notes.append(
            f"{100.0 * float(low.mean()):.2g} % of the pixels show sky less than "
            f"{INFRARED.lowest_sky_deg:g} degrees above the horizon, which is uncertain by "
            f"{INFRARED.low_sky_k:g} K"
        )
    if abs(elevation) < INFRARED.low_sun_deg:
        notes.append(
            f"the sun stands {elevation:.1f} degrees above the horizon without refraction: "
            "sunlight that surfaces reflect begins or ends at 0"
        )
    return tuple(notes)
