"""Stated illumination of the flats of one gain, and its systematic uncertainty.

One meter and one set of filters serve a session, so its error is one factor common to all
quantities per lux or photon. Errors that differ between levels show in the responsivity and are
fitted there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from charact.estimators.noise.findings import Unmeasurable
from charact.estimators.noise.thresholds import SNR
from charact.frames.rounding import rounding_sd
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context
from labdata import Array, Conditions, has_tube
from labdata.camera.parameters import Parameter

ELECTRON_C = 1.602176634e-19
# h c in J nm, and h c / k in nm K.
PHOTON_J_NM, SECOND_RADIATION_NM_K = 1.986445857e-16, 1.438776877e7
LUMENS_PER_WATT = 683.002
LAMP_K = 2856.0


def photoelectrons_per_lux_s(context: Context, rng: np.random.Generator, count: int) -> Array:
    """Return draws of the photoelectrons per pixel, lux and second of gate, shape (count,)."""
    sensor = context.camera
    assert sensor is not None
    sensitivity = lognormal_draws(sensor.photocathode.luminous_sensitivity_ua_per_lm, rng, count)
    return sensitivity * 1e-6 / ELECTRON_C * pixel_area_m2(context, rng, count)


def pixel_area_m2(context: Context, rng: np.random.Generator, count: int) -> Array:
    """Return draws of the pixel area at the photocathode, shape (count,), m2; two rows for a
    field.
    """
    sensor = context.camera
    assert sensor is not None
    demagnification = lognormal_draws(sensor.taper.demagnification, rng, count) / float(
        sensor.tube.magnification
    )
    rows = 2.0 if context.interlaced else 1.0
    return (
        float(sensor.ccd.pitch_x_um)
        * float(sensor.ccd.pitch_y_um)
        * demagnification**2
        * rows
        * 1e-12
    )


def photoelectrons_per_photon(
    context: Context, wavelength_nm: float, rng: np.random.Generator, count: int
) -> Array:
    """Return draws of the photocathode's quantum efficiency at a wavelength, shape (count,)."""
    assert has_tube(context.camera)
    cathode = context.camera.photocathode
    table = np.interp(
        wavelength_nm,
        cathode.wavelength_nm,
        cathode.relative_quantum_efficiency,
        left=0.0,
        right=0.0,
    )
    sensitivity = lognormal_draws(cathode.luminous_sensitivity_ua_per_lm, rng, count)
    of_table = table_sensitivity_ua_per_lm(
        cathode.wavelength_nm, cathode.relative_quantum_efficiency
    )
    return np.minimum(sensitivity / of_table * table, 1.0)


def table_sensitivity_ua_per_lm(
    wavelength_nm: Sequence[float], quantum_efficiency: Sequence[float]
) -> float:
    """Return the luminous sensitivity of a table of quantum efficiencies, uA/lm at 2856 K.

    S = int QE (e lambda / h c) P dlambda / (683 int V P dlambda), P Planck's law. V is the sum of
    two lobes of Wyman, Sloan & Shirley, JCGT 2 (2), 1 (2013), which gives the lumens of this lamp
    within 0.2 %.
    """
    wavelength = np.arange(360.0, 1101.0, 1.0)
    radiant = wavelength**-5.0 / np.expm1(SECOND_RADIATION_NM_K / (wavelength * LAMP_K))
    eye = 0.821 * _lobe(wavelength, 568.8, 46.9, 40.5) + 0.286 * _lobe(
        wavelength, 530.9, 16.3, 31.1
    )
    efficiency = np.interp(wavelength, wavelength_nm, quantum_efficiency, left=0.0, right=0.0)
    current = ELECTRON_C / PHOTON_J_NM * np.sum(efficiency * wavelength * radiant)
    return float(1e6 * current / (LUMENS_PER_WATT * np.sum(eye * radiant)))


def _lobe(wavelength_nm: Array, middle_nm: float, below_nm: float, above_nm: float) -> Array:
    """Return a Gaussian with another width on each side."""
    return np.exp(
        -0.5
        * ((wavelength_nm - middle_nm) / np.where(wavelength_nm < middle_nm, below_nm, above_nm))
        ** 2
    )


def lognormal_draws(parameter: Parameter, rng: np.random.Generator, count: int) -> Array:
    """Return lognormal draws of a parameter with its 95 % bounds; constant without bounds."""
    if parameter.low is None or parameter.high is None or parameter.low <= 0:
        return np.full(count, float(parameter))
    side = rng.standard_normal(count)
    up, down = (
        np.log(parameter.high / parameter.value) / 1.96,
        np.log(parameter.value / parameter.low) / 1.96,
    )
    return parameter.value * np.exp(np.where(side > 0, side * up, side * down))


# Relative standard deviation of a photometer of unstated uncertainty.
UNSTATED_ILLUMINANCE_SD = 0.1


@dataclass(frozen=True, kw_only=True)
class StatedIllumination:
    """Recorded light of the flats of a series."""

    # light of each flat, shape (flat,): illuminance scaled to an exposure of `seconds`, lux, or
    # photons per pixel and exposure
    amount: Array
    unit: str  # "lux" or "photons/px"
    seconds: float | None  # longest exposure time of the series, s; None if not stated
    relative_sd: float  # common relative standard deviation of the light, dimensionless
    stated: bool  # whether the session states the uncertainty

    def scale(self, seed: int, count: int) -> Array:
        """Return draws of true over recorded light, shape (count,); equal for equal seeds."""
        from scipy.special import ndtri

        # Every quantile once, in random order, leaves the median of a product unchanged.
        rank = np.random.default_rng([seed, 21]).permutation(count)
        return np.exp(self.relative_sd * ndtri((rank + 0.5) / count))

    @property
    def note(self) -> str:
        """Note on the uncertainty of the light."""
        percent = f"{100 * self.relative_sd:.2g} %"
        if self.stated:
            return (
                f"stated uncertainty of the light: {percent} (standard deviation, common to "
                f"all levels)"
            )
        if self.unit == "lux":
            return (
                f"the session states no uncertainty of its light: {percent} (standard deviation, "
                "common to all levels) is assumed, as for an uncalibrated photometer"
            )
        return "the session states no uncertainty of its photons: assumed exact"


def gathering_s(conditions: Conditions) -> float | None:
    """Return the exposure time including the gate, s; None if unknown."""
    times = [
        conditions.exposure_s,
        None if conditions.gate_ns is None else 1e-9 * conditions.gate_ns,
    ]
    known = [time for time in times if time]
    return min(known) if known else None


def relative_sd_of(conditions: list[Conditions], unit: str) -> tuple[float, bool]:
    """Return the relative standard deviation of the light, and whether any stack states it."""
    stated = [
        c.illuminance_relative_sd for c in conditions if c.illuminance_relative_sd is not None
    ]
    if stated:
        return max(stated), True
    return (UNSTATED_ILLUMINANCE_SD if unit == "lux" else 0.0), False


def light_of_series(flats: Sequence[StackStatistics]) -> StatedIllumination:
    """Return the light of a series; Unmeasurable if it is unknown."""
    known = [flat.conditions for flat in flats]
    lux, photons = [c.illuminance_lux for c in known], [c.photons_per_px for c in known]
    if all(lux):
        times = [gathering_s(c) for c in known]
        if any(times) and not all(times):
            raise Unmeasurable("either all flats must state exposure_s or gate_ns, or none")
        longest = max((time for time in times if time), default=None)
        relative_time = np.array(
            [1.0 if time is None or longest is None else time / longest for time in times]
        )
        amount, unit = np.array(lux, float) * relative_time, "lux"
        relative_sd, stated = relative_sd_of(known, unit)
        return StatedIllumination(
            amount=amount, unit=unit, seconds=longest, relative_sd=relative_sd, stated=stated
        )
    if all(photons):
        return light_of_photons(flats, np.array(photons, float))
    raise Unmeasurable(
        "the light on the flats is unknown: illuminance_lux or photons_per_px of every flat is "
        "needed"
    )


def light_of_photons(flats: Sequence[StackStatistics], photons: Array) -> StatedIllumination:
    """Return the light of flats with known photons per pixel."""
    relative_sd, stated = relative_sd_of([flat.conditions for flat in flats], "photons/px")
    return StatedIllumination(
        amount=photons, unit="photons/px", seconds=None, relative_sd=relative_sd, stated=stated
    )


def signal_sd(flat: StackStatistics, dark: StackStatistics) -> float:
    """Return the standard error of the signal, DN, from the scatter of frame means and from
    rounding.
    """
    steps = [rounding_sd(level.variance_dn2)[0] for level in (flat, dark)]
    return float(np.linalg.norm([flat.mean_sd_dn, dark.mean_sd_dn, *steps]))


def response_draws(
    amount: Array, signal: Array, sd: Array, rng: np.random.Generator, count: int
) -> Array:
    """Return draws of the signal per recorded light, shape (count,).

    `amount`: light of each level, shape (level,), positive; `signal`, `sd`: signal of each level
    and its standard error, DN.

    ln(signal / amount) = ln R + e, e normal with the error of the signal and a departure common to
    the levels whose standard deviation is unknown, see `SNR.departure_range`. With one level the
    prior remains.
    """
    from scipy.special import softmax

    ratio, relative_sd = np.log(signal / amount), sd / signal
    departure = np.geomspace(*SNR.departure_range, SNR.departures)
    weight = 1.0 / (relative_sd**2 + departure[:, None] ** 2)
    total = weight.sum(axis=1)
    mean = (weight * ratio).sum(axis=1) / total
    misfit = (weight * (ratio - mean[:, None]) ** 2).sum(axis=1)
    chance = softmax(0.5 * (np.log(weight).sum(axis=1) - np.log(total) - misfit))
    pick = rng.choice(SNR.departures, count, p=chance)
    return np.exp(mean[pick] + rng.standard_normal(count) / np.sqrt(total[pick]))
