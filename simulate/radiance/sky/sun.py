"""The sun's spectrum outside the atmosphere."""

import numpy as np

from simulate.radiance.spectrum import SourceSpectrum
from simulate.radiance.tables import table

PACKAGE = "simulate.radiance.sky"


def sun_spectrum(distance_au: float = 1.0) -> SourceSpectrum:
    """Return the sun's irradiance normal to the beam, W m-2, at a distance in astronomical units.

    Notes
    -----
    ASTM G173-03's extraterrestrial spectrum in steps of 5 nm: Fraunhofer lines are averaged, 133,100 lux are kept.
    """
    sun = table(PACKAGE, "sun")
    return SourceSpectrum(
        wavelength_nm=sun["wavelength_nm"], density=sun["irradiance_w_m2_nm"] / np.square(distance_au)
    )
