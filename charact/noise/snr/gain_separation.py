"""Separation of K, k, k F^2 and F^2.

Flats give K + k F^2. The white-noise floor or the sensor description gives K and so k F^2. A known illumination gives
k, the signal per photoelectron. Single photoelectrons in darks give the mean pulse height k/p, and p F^2 = one plus the
relative variance of heights; with the detection probability p or a known light, k and F^2 follow. Quantities that a
session cannot separate are refused, with the measurement that would separate them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.gain.series import FlatSeries
from charact.noise.gain.white_floor import Floor, floor_of
from charact.noise.snr.cathode_radiometry import photoelectrons_per_lux_s, photoelectrons_per_photon, pixel_area_m2
from charact.noise.snr.stated_illumination import StatedIllumination, light_of_series, response_draws, signal_sd
from charact.noise.snr.tube_snr import snr_from_measurement
from charact.noise.thresholds import GAIN
from labdata.measurement import Measurement, Posterior, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

APART = "a known light (illuminance_lux with gate or exposure, or photons_per_px at a wavelength_nm, and the sensor)"
PULSES = "the heights of single photoelectrons in dark frames"


@dataclass(frozen=True, kw_only=True)
class ResponsivityEstimate:
    """Responsivity and photoelectron gain from a known light.

    Parameters
    ----------
    gain
        Draws of k, DN per photoelectron; None if the photocathode is unknown.
    per_lux_s
        Draws of the signal per lux and second, DN; None without illuminance and time.
    note
        Note on the uncertainty of the light.
    why_not
        Reason for the absence of k.
    """

    gain: Array | None = None
    per_lux_s: Array | None = None
    note: str = ""
    why_not: str = ""


def separate_gains(series: FlatSeries, posterior: Posterior, *, context: Context, flags: tuple[str, ...],
              covariance_flags: tuple[str, ...], **fields: Any) -> list[Measurement]:  # fmt: skip
    """Return K, k F^2, k, F^2 and the tube's signal-to-noise ratio, measured or refused.

    Parameters
    ----------
    series, posterior
        The flats of one gain, and draws of covariance gain and blur.
    context
        Sensor and seed.
    flags, covariance_flags
        Flags of the signal, and of the covariance gain.
    """
    floor = floor_of(series, posterior, context=context)
    response = response_of(series, len(posterior.draws), context)
    pulses = posterior["covariance_gain"] - floor.draws * posterior["lag_factor"]
    told = spread_of(floor, posterior) <= GAIN.max_floor_range
    noisy = {"flags": covariance_flags, **fields}
    out = [_electrons(floor, **noisy), _pulses(pulses, floor, told, context.seed, **noisy)]
    if response.gain is None:
        reason = f"k and F2 are not separable: {response.why_not}; {PULSES} would also separate them"
        out += [make_refusal(name, unit, reason, **fields) for name, unit in _GAINS]
    else:
        out += _known_light_gains(
            response, response.gain, pulses if told else None, context.seed, signal_flags=flags, **noisy
        )
    return [*out, _tube(response, pulses if told else None, context, **noisy)]


_GAINS = (("photoelectron_gain", "DN/pe"), ("excess_noise_factor", "1"))


def _pulses(pulses: Array, floor: Floor, told: bool, seed: int, **fields: Any) -> Measurement:
    """Return k F^2, if K is known or negligible."""
    if told:
        kept = posterior_of("pulse_gain", "DN", pulses, seed)
        note = (f"covariance_gain less K, which is {floor.source}",)
        return measurement_from_draws("pulse_gain", "DN", pulses, notes=note, posterior=kept, **fields)
    fields.pop("flags")
    reason = (
        f"k F2 lies between {np.quantile(pulses, 0.025):.3g} and {np.quantile(pulses, 0.975):.3g} DN, because no "
        "white-noise floor is detected: flats at low tube gain, or the sensor's conversion gain, would give K"
    )
    return make_refusal("pulse_gain", "DN", reason, **fields)


def _known_light_gains(
    response: ResponsivityEstimate,
    gain: Array,
    pulses: Array | None,
    seed: int,
    *,
    signal_flags: tuple[str, ...],
    **fields: Any,
) -> list[Measurement]:
    """Return k and F^2 from a known light; k does not take the flags of the covariance gain."""
    notes = (response.note, "the interval includes the uncertainty of the photocathode's sensitivity")
    kept = posterior_of("photoelectron_gain", "DN/pe", gain, seed)
    own = {**fields, "flags": signal_flags}
    out = [measurement_from_draws("photoelectron_gain", "DN/pe", gain, notes=notes, posterior=kept, **own)]
    if pulses is not None:
        return [*out, measurement_from_draws("excess_noise_factor", "1", pulses / gain, notes=notes, **fields)]
    fields.pop("flags")
    return [*out, make_refusal("excess_noise_factor", "1", "k F2 is not known; see pulse_gain", **fields)]


def posterior_of(name: str, unit: str, draws: Array, seed: int) -> Posterior:
    """Return the posterior of one derived quantity."""
    return Posterior(names=(name,), units=(unit,), draws=draws[:, None], sampler="laplace", seed=seed)


def spread_of(floor: Floor, posterior: Posterior) -> float:
    """Return the 95 % range of K over the covariance gain."""
    low, high = np.quantile(floor.draws * posterior["lag_factor"], [0.025, 0.975])
    return float((high - low) / np.median(posterior["covariance_gain"]))


def _electrons(floor: Floor, **fields: Any) -> Measurement:
    """Return K, if the white-noise floor is detected."""
    if floor.seen:
        return measurement_from_draws("conversion_gain", "DN/e-", floor.draws, **fields)
    fields.pop("flags")
    return make_refusal("conversion_gain", "DN/e-", floor.why_unseen, **fields)


def response_of(series: FlatSeries, count: int, context: Context) -> ResponsivityEstimate:
    """Return k and responsivity from the light of the flats."""
    light = light_of_series(series)
    if isinstance(light, str):
        return ResponsivityEstimate(why_not=f"{APART} would tell ({light})")
    chosen = series.fitted & (series.signal_dn > 0)
    sd = np.array([signal_sd(f, d) for f, d in zip(series.flats, series.darks, strict=True)])
    rng = np.random.default_rng([context.seed, 3])
    recorded = response_draws(light.amount[chosen], series.signal_dn[chosen], sd[chosen], rng, count)
    true = recorded / light.scale(context.seed, count)
    if light.unit == "lux":
        return _of_lux(true, light, context, rng)
    return _of_photons(true, light, series, context, rng)


def _of_lux(
    per_lux: Array, light: StatedIllumination, context: Context, rng: np.random.Generator
) -> ResponsivityEstimate:
    """Return k from illuminance, time and luminous sensitivity."""
    if light.seconds is None:
        return ResponsivityEstimate(why_not="the exposure time is unknown (gate_ns, exposure_s)")
    per_lux_s = per_lux / light.seconds
    if context.sensor is None:
        return ResponsivityEstimate(
            per_lux_s=per_lux_s, note=light.note, why_not="the photocathode is unknown (name the sensor)"
        )
    gain = per_lux_s / photoelectrons_per_lux_s(context, rng, len(per_lux))
    return ResponsivityEstimate(gain=gain, per_lux_s=per_lux_s, note=light.note)


def _of_photons(
    per_photon: Array, light: StatedIllumination, series: FlatSeries, context: Context, rng: np.random.Generator
) -> ResponsivityEstimate:
    """Return k from photons of one wavelength and the quantum efficiency."""
    wavelengths = {flat.conditions.wavelength_nm for flat in series.flats}
    known = next(iter(wavelengths)) if len(wavelengths) == 1 else None
    if context.sensor is None or known is None:
        return ResponsivityEstimate(why_not="photons need a single wavelength_nm and the photocathode of a sensor")
    efficiency = photoelectrons_per_photon(context, known, rng, len(per_photon))
    if np.median(efficiency) <= 0:
        return ResponsivityEstimate(why_not=f"the photocathode has no efficiency at {known:g} nm")
    return ResponsivityEstimate(gain=per_photon / efficiency, note=light.note)


def _tube(response: ResponsivityEstimate, pulses: Array | None, context: Context, **fields: Any) -> Measurement:
    """Return the tube's signal-to-noise ratio from responsivity and k F^2."""
    name = "tube_snr"
    plain = {key: value for key, value in fields.items() if key != "flags"}
    if response.per_lux_s is None:
        reason = f"it needs the signal per lux and second: {response.why_not}"
        return make_refusal(name, "1", reason, **plain)
    if context.sensor is None:
        return make_refusal(name, "1", "it needs the pixel size at the photocathode: name the sensor", **plain)
    if pulses is None:
        return make_refusal(name, "1", "k F2 is not known; see pulse_gain", **plain)
    rng = np.random.default_rng([context.seed, 33])
    area = pixel_area_m2(context, rng, len(pulses))
    notes = (
        "spot of 0.2 mm at 108 microlux, bandwidth 10 Hz, 2856 K; noise of dark frames excluded; luminous sensitivity "
        "and noise factor cancel",
        response.note,
    )
    draws = snr_from_measurement(response.per_lux_s, np.maximum(pulses, 1e-12), area)
    return measurement_from_draws(name, "1", draws, notes=notes, **fields)
