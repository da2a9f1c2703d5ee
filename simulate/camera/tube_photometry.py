"""Photometry: illuminance to photoelectrons of a tube or chip, luminous gain to photons."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata import BadInput, Camera
from simulate.radiance.cube import band_widths
from simulate.radiance.spectrum import LUMENS_PER_WATT, hat_integrals, luminous_efficiency, planck

ELEMENTARY_CHARGE_C = 1.602176634e-19
JOULE_METRE = 6.62607015e-34 * 2.99792458e8
LAMP_K = 2856.0


def quantum_efficiency(sensor: Camera, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return the photocathode's quantum efficiency, linear in its table, scaled to its luminous
    sensitivity.
    """
    cathode = sensor.photocathode
    scale = float(cathode.luminous_sensitivity_ua_per_lm) / luminous_sensitivity(
        cathode.wavelength_nm, cathode.relative_quantum_efficiency
    )
    table = scale * np.asarray(cathode.relative_quantum_efficiency)
    return np.interp(
        np.asarray(wavelength_nm, float), cathode.wavelength_nm, table, left=0.0, right=0.0
    )


def detection_weights(
    wavelength_nm: ArrayLike, table_nm: ArrayLike, efficiency: ArrayLike, *, averaged: bool = False
) -> NDArray[np.float64]:
    """Return detected photons per spectral irradiance of each band, per m2, s and W m-2 nm-1, shape
    (band,).

    Between bands, ascending, irradiance is taken as linear, or as an average over each
    (`RadianceCube.averaged`); efficiency is linear in its table and zero outside.

    Notes
    -----
    int hat_b(l) QE(l) l/(h c) dl, hat_b linear from 1 at band b to 0 at its neighbours: exact for
    any spacing of the bands, where a sum over bands alone misses what the efficiency does between
    them. Of averages QE(b) b/(h c) times int hat_b dl: bands of a rendering stand where the
    efficiency bends, and a line's light keeps that of its own.
    """
    bands, nm, fraction = (
        np.asarray(wavelength_nm, float),
        np.asarray(table_nm, float),
        np.asarray(efficiency, float),
    )
    if bands.size < 2:
        raise BadInput(
            f"a spectrum must have at least two bands to be integrated, got {bands.size}"
        )
    if averaged:
        return (
            band_widths(bands)
            * np.interp(bands, nm, fraction, left=0.0, right=0.0)
            * bands
            * 1e-9
            / JOULE_METRE
        )
    return hat_integrals(bands, (nm, fraction), (nm[[0, -1]], nm[[0, -1]])) * 1e-9 / JOULE_METRE


def luminous_sensitivity(wavelength_nm: ArrayLike, quantum_efficiency: ArrayLike) -> float:
    """Return the photocurrent per lumen of a 2856 K lamp, uA/lm.

    Notes
    -----
    S = int R P dl / (683 int V P dl) with R = QE e l/(h c) and P Planck's law at 2856 K.
    """
    table = np.asarray(wavelength_nm, float), np.asarray(quantum_efficiency, float)
    fine = np.union1d(np.arange(360.0, 1100.0), table[0][(table[0] > 360.0) & (table[0] < 1099.0)])
    power = planck(fine, LAMP_K) * np.gradient(fine)
    efficiency = np.interp(fine, *table, left=0.0, right=0.0)
    responsivity = efficiency * ELEMENTARY_CHARGE_C * fine * 1e-9 / JOULE_METRE
    lumens = LUMENS_PER_WATT * np.sum(luminous_efficiency(fine) * power)
    return float(1e6 * np.sum(responsivity * power) / lumens)


def photoelectrons_per_lumen_s(sensor: Camera) -> float:
    """Return photoelectrons per lumen and second of 2856 K light, S/e."""
    return float(sensor.photocathode.luminous_sensitivity_ua_per_lm) * 1e-6 / ELEMENTARY_CHARGE_C


def ebi_per_s_cm2(sensor: Camera, temperature_c: float | None = None) -> float:
    """Return photoelectrons emitted in the dark, per s and cm2: EBI times S/e, doubling with
    warmth.
    """
    cathode = sensor.photocathode
    warmer = 0.0 if temperature_c is None else temperature_c - float(cathode.ebi_temperature_c)
    rate = float(cathode.ebi_lm_per_cm2) * photoelectrons_per_lumen_s(sensor)
    return rate * 2.0 ** (warmer / float(cathode.ebi_doubling_k))


def photons_per_photoelectron(sensor: Camera) -> float:
    """Return phosphor photons per photoelectron at the reference voltage, the undetected counted.

    Notes
    -----
    A luminous gain of lm out per lm in means G/(K_lm E_ph) photons per lm in, and S/e
    photoelectrons per lm in.
    """
    photon_lumen_s = float(sensor.phosphor.luminous_efficacy_lm_per_w) * (
        float(sensor.phosphor.photon_energy_ev) * ELEMENTARY_CHARGE_C
    )
    return float(sensor.tube.luminous_gain) / photon_lumen_s / photoelectrons_per_lumen_s(sensor)


def gain_factor(sensor: Camera, mcp_v: float | None, gain_control: float | None) -> float:
    """Return the gain relative to the nominal one, by the MCP's voltage or by the control word that
    sets it.

    Notes
    -----
    (V/V0)^m, or ratio^((word - reference)/counts): the published gain of an intensified camera at
    control words 0 to 255 follows it within 3 % with a ratio of 1.95 per 51 counts.
    """
    plate = sensor.microchannel_plate
    if mcp_v is not None and gain_control is not None:
        raise BadInput(
            f"mcp_v and gain_control set the same gain and must not both be given, got {mcp_v:g} "
            f"V and {gain_control:g}"
        )
    if gain_control is not None:
        ratio = float(plate.gain_control_ratio)
        steps = (gain_control - float(plate.gain_control_reference)) / float(
            plate.gain_control_counts
        )
        if steps * math.log10(ratio) > 30.0:
            raise BadInput(
                f"a control word must raise the gain by at most 30 decades, got {gain_control:g}"
            )
        return ratio**steps
    return (
        1.0 if mcp_v is None else (mcp_v / float(plate.reference_v)) ** float(plate.gain_exponent)
    )


def photons_per_lux(
    sensor: Camera,
    wavelength_nm: NDArray[np.float64],
    radiance: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64]]:
    """Return the photons of light of a given spectrum, in bands, and what turns radiance in these
    into photons.

    Returns
    -------
    photon_ratio
        Photons per s and cm2 on photocathode or chip at 1 lux of this light, referred to the
        wavelength of peak quantum efficiency: one that is detected half as well counts half.
    weight
        Photons per radiance of each band, relative to the light's own, shape (band,).

    Notes
    -----
    Sums over bands replace integrals in the photometric and in the photoelectric sum alike, scaled
    so that light of 2856 K has exactly the tube's luminous sensitivity, or that of the chip's table
    of quantum efficiency.
    """
    width = band_widths(wavelength_nm)
    lumens = width * LUMENS_PER_WATT * luminous_efficiency(wavelength_nm)
    if sensor.has_tube:
        efficiency = quantum_efficiency(sensor, wavelength_nm)
        peak = quantum_efficiency(sensor, sensor.photocathode.wavelength_nm).max()
        per_lumen_s = photoelectrons_per_lumen_s(sensor)
    else:
        table = sensor.silicon.wavelength_nm, sensor.silicon.quantum_efficiency
        efficiency = np.interp(wavelength_nm, *table, left=0.0, right=0.0)
        peak = max(sensor.silicon.quantum_efficiency)
        per_lumen_s = luminous_sensitivity(*table) * 1e-6 / ELEMENTARY_CHARGE_C
    electrons = width * efficiency * wavelength_nm
    lamp = planck(wavelength_nm, LAMP_K)
    per_lumen_of_lamp = np.sum(electrons * lamp) / np.sum(lumens * lamp)
    per_lumen = np.sum(electrons * radiance) / np.sum(lumens * radiance)
    # 1 lux is 1e-4 lm/cm2.
    photons = 1e-4 * per_lumen_s * per_lumen / per_lumen_of_lamp / peak
    return float(photons), electrons / np.sum(electrons * radiance)
