"""Photometry of the tube: illuminance and quantum efficiency to photoelectrons, luminous gain to photons."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.sensor import Sensor
from simulate.radiance.cube import band_widths
from simulate.radiance.photometry import LUMENS_PER_WATT, luminous_efficiency, planck
from simulate.radiance.scene import LabScene

ELEMENTARY_CHARGE_C = 1.602176634e-19
JOULE_METRE = 6.62607015e-34 * 2.99792458e8
LAMP_K = 2856.0


def quantum_efficiency(sensor: Sensor, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return the photocathode's quantum efficiency at wavelengths, scaled to its luminous sensitivity.

    Linear between the table's wavelengths and zero outside them, dimensionless.
    """
    cathode = sensor.photocathode
    scale = float(cathode.luminous_sensitivity_ua_per_lm) / luminous_sensitivity(
        cathode.wavelength_nm, cathode.relative_quantum_efficiency
    )
    table = scale * np.asarray(cathode.relative_quantum_efficiency)
    return np.interp(wavelength_nm, cathode.wavelength_nm, table, left=0.0, right=0.0)


def luminous_sensitivity(wavelength_nm: ArrayLike, quantum_efficiency: ArrayLike) -> float:
    """Return the photocurrent per lumen of a 2856 K lamp, uA/lm.

    Notes
    -----
    S = int R P dl / (683 int V P dl) with R = QE e l/(h c) and P Planck's law at 2856 K.
    """
    fine = np.arange(360.0, 1100.0, 1.0)
    power = planck(fine, LAMP_K)
    efficiency = np.interp(fine, wavelength_nm, quantum_efficiency, left=0.0, right=0.0)
    responsivity = efficiency * ELEMENTARY_CHARGE_C * fine * 1e-9 / JOULE_METRE
    lumens = LUMENS_PER_WATT * np.sum(luminous_efficiency(fine) * power)
    return float(1e6 * np.sum(responsivity * power) / lumens)


def photoelectrons_per_lumen_s(sensor: Sensor) -> float:
    """Return photoelectrons per lumen and second of 2856 K light, S/e."""
    return float(sensor.photocathode.luminous_sensitivity_ua_per_lm) * 1e-6 / ELEMENTARY_CHARGE_C


def ebi_per_s_cm2(sensor: Sensor, temperature_c: float | None = None) -> float:
    """Return photoelectrons emitted in the dark, per s and cm2: EBI times S/e, doubling with warmth."""
    cathode = sensor.photocathode
    warmer = 0.0 if temperature_c is None else temperature_c - float(cathode.ebi_temperature_c)
    rate = float(cathode.ebi_lm_per_cm2) * photoelectrons_per_lumen_s(sensor)
    return rate * 2.0 ** (warmer / float(cathode.ebi_doubling_k))


def photons_per_photoelectron(sensor: Sensor) -> float:
    """Return screen photons per photoelectron at the reference voltage, the undetected counted.

    Notes
    -----
    A luminous gain of lm out per lm in means G/(K_lm E_ph) photons per lm in, and S/e photoelectrons per lm in.
    """
    photon_lumen_s = float(sensor.phosphor.luminous_efficacy_lm_per_w) * (
        float(sensor.phosphor.photon_energy_ev) * ELEMENTARY_CHARGE_C
    )
    return float(sensor.tube.luminous_gain) / photon_lumen_s / photoelectrons_per_lumen_s(sensor)


def voltage_factor(sensor: Sensor, mcp_v: float | None) -> float:
    """Return the gain relative to that at the reference voltage, (V/V0)^m; 1 without a voltage."""
    if mcp_v is None:
        return 1.0
    plate = sensor.microchannel_plate
    return (mcp_v / float(plate.reference_v)) ** float(plate.gain_exponent)


def photon_weights(sensor: Sensor, wavelength_nm: NDArray[np.float64], scene: LabScene) -> NDArray[np.float64]:
    """Return what turns a scene's radiance into photons on the photocathode at 1 lux from its open parts.

    Parameters
    ----------
    sensor
        The camera.
    wavelength_nm
        Bands of the radiance, shape (band,), nm.
    scene
        The bench; the illuminance is that of a large area of the open port.

    Returns
    -------
    NDArray
        Photons per s and cm2 for each unit of band radiance, shape (band,). Photons are referred to the wavelength of
        peak quantum efficiency: one that is detected half as well counts half.

    Notes
    -----
    The lens gives E = pi tau L/(4 N^2). Sums over bands replace integrals in the photometric and in the photoelectric
    sum alike, the latter scaled so that 2856 K light has exactly the tube's luminous sensitivity.
    """
    width = band_widths(wavelength_nm)
    optics = sensor.optics
    lens = np.pi * float(optics.transmission) / (4.0 * float(optics.f_number) ** 2)
    lumens = lens * width * LUMENS_PER_WATT * luminous_efficiency(wavelength_nm)
    efficiency = quantum_efficiency(sensor, wavelength_nm)
    electrons = lens * width * efficiency * wavelength_nm * 1e-9 / JOULE_METRE
    lamp = planck(wavelength_nm, LAMP_K)
    # Photoelectrons per lumen of this coarse sum against S/e.
    correction = photoelectrons_per_lumen_s(sensor) * np.sum(lumens * lamp) / np.sum(electrons * lamp)
    port = planck(wavelength_nm, scene.sphere.temperature_k) * scene.open.transmitted(wavelength_nm)
    peak = quantum_efficiency(sensor, sensor.photocathode.wavelength_nm).max()
    # 1 lux is 1e-4 lm/cm2.
    return electrons * correction / peak * 1e-4 / np.sum(lumens * port)
