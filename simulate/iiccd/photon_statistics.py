"""How photons arrive: why their number is taken as Poisson, and how far from it light of a given bandwidth would be."""

import numpy as np

from labdata.errors import BadInput

LIGHT_M_PER_S = 2.99792458e8


def modes(*, wavelength_nm: float, width_nm: float, time_s: float, area_cm2: float, f_number: float) -> float:
    """Return in how many modes of the light field a detector counts, dimensionless, at least 1.

    Parameters
    ----------
    wavelength_nm, width_nm
        Centre and width of the spectrum, nm.
    time_s
        Time over which it counts, s.
    area_cm2
        Area over which it counts, cm2.
    f_number
        Of the cone in which the light arrives.

    Notes
    -----
    M = (t dnu)(A/A_c) of chaotic light: coherence time 1/dnu, dnu = c dl/l^2, coherence area A_c = l^2/Omega,
    Omega = pi/(4 N^2) (Goodman, Statistical Optics, 6.1 and 9.2).
    """
    for name, value in (("wavelength_nm", wavelength_nm), ("width_nm", width_nm), ("time_s", time_s)):
        if not value > 0.0:
            raise BadInput(f"{name} must be positive, got {value:g}")
    wavelength_m = wavelength_nm * 1e-9
    width_hz = LIGHT_M_PER_S * width_nm * 1e-9 / wavelength_m**2
    coherence_m2 = wavelength_m**2 / (np.pi / (4.0 * f_number**2))
    return max(float(time_s * width_hz), 1.0) * max(float(area_cm2 * 1e-4 / coherence_m2), 1.0)


def variance_over_mean(photoelectrons: float, mode_count: float) -> float:
    """Return the variance of a count of photoelectrons over its mean, dimensionless: 1 + n/M, 1 for Poisson.

    Notes
    -----
    Chaotic light in M modes gives negative binomial counts (Mandel, Proc. Phys. Soc. 74, 233, 1959). A single mode of a
    lamp of 2856 K at 700 nm holds 8e-4 photons, so n/M stays below that whatever the lens, the level and the gate:
    Poisson arrivals are exact to a thousandth at worst, and far better of any scene that is dimmer than its lamp.
    """
    return 1.0 + photoelectrons / mode_count
