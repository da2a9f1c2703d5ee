"""Separation of K, k, k F^2 and F^2.

Flats give K + k F^2. The white-noise floor or the sensor description gives K and so k F^2. A known
illumination gives k, the signal per photoelectron. Single photoelectrons in darks give the mean
pulse height k/p, and p F^2 = one plus the relative variance of heights; with the detection
probability p or a known light, k and F^2 follow. Quantities that a session cannot separate are
refused, with the measurement that would separate them.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from charact.estimators.noise.findings import Unmeasurable, finding
from charact.estimators.noise.gain.series import FlatSeries, gain_of
from charact.estimators.noise.gain.white_floor import floor_of
from charact.estimators.noise.illumination import (
    ELECTRON_C,
    light_of_series,
    lognormal_draws,
    photoelectrons_per_lux_s,
    photoelectrons_per_photon,
    pixel_area_m2,
    response_draws,
    signal_sd,
)
from charact.estimators.noise.thresholds import GAIN, SNR
from charact.method import Context
from charact.verdict import Finding, inherited, judge
from labdata import (
    Array,
    Measurement,
    Posterior,
    Result,
    Session,
    has_tube,
    make_refusal,
    measurement_from_draws,
)

# Illuminance, diameter of the spot and bandwidth of the specified signal-to-noise ratio of tubes.
ILLUMINANCE_LUX, SPOT_MM, BANDWIDTH_HZ = 108e-6, 0.2, 10.0


def snr_from_specification(
    sensitivity_ua_per_lm: ArrayLike, excess_noise_factor: ArrayLike
) -> Array:
    """Return the signal-to-noise ratio of a specified tube.

    `sensitivity_ua_per_lm`: luminous sensitivity of the photocathode at 2856 K.
    `excess_noise_factor`: F^2 including undetected photoelectrons; the square of the noise factor.
    """
    photoelectrons = np.asarray(sensitivity_ua_per_lm) * 1e-6 / ELECTRON_C
    return _snr(photoelectrons / np.asarray(excess_noise_factor))


def snr_from_measurement(
    response_dn_per_lux_s: ArrayLike, pulse_gain_dn: ArrayLike, pixel_area_m2: ArrayLike
) -> Array:
    """Return the signal-to-noise ratio of a measured tube and camera.

    `response_dn_per_lux_s`: signal of a pixel per lux and second at the photocathode.
    `pulse_gain_dn`: k F^2. `pixel_area_m2`: area of a pixel at the photocathode.
    """
    return _snr(
        np.asarray(response_dn_per_lux_s) / (np.asarray(pulse_gain_dn) * np.asarray(pixel_area_m2))
    )


def _snr(effective_per_lux_s_m2: Array) -> Array:
    """Return the signal-to-noise ratio from the photoelectrons per lux, second and m2 over F^2."""
    spot_m2 = np.pi / 4.0 * (SPOT_MM * 1e-3) ** 2
    return np.sqrt(effective_per_lux_s_m2 * ILLUMINANCE_LUX * spot_m2 / (2.0 * BANDWIDTH_HZ))


APART = (
    "a known light (illuminance_lux with gate or exposure, or photons_per_px at a "
    "wavelength_nm, and the sensor)"
)
PULSES = "the heights of single photoelectrons in dark frames"


@dataclass(frozen=True, kw_only=True)
class ResponsivityEstimate:
    """Responsivity and photoelectron gain from a known light."""

    # draws of k, DN per photoelectron; None if the photocathode is unknown
    gain: Array | None = None
    # draws of the signal per lux and second, DN; None without illuminance and time
    per_lux_s: Array | None = None
    note: str = ""  # note on the uncertainty of the light
    refusal_reason: str = ""  # reason for the absence of k


def separate_gains(
    series: FlatSeries,
    posterior: Posterior,
    *,
    context: Context,
    of_signal: Sequence[Finding],
    of_noise: Sequence[Finding],
    **fields: Any,
) -> list[Measurement]:
    """Return K, k F^2, k, F^2 and the tube's signal-to-noise ratio, measured or refused.

    `posterior`: draws of covariance gain and blur of the flats. `of_signal`, `of_noise`: findings
    on the signal, and on the covariance gain. k does not take those of the covariance gain.
    """
    return [
        judge(m, of_signal if m.quantity == "photoelectron_gain" else of_noise)
        if m.value is not None
        else m
        for m in _separated(series, posterior, context, fields)
    ]


def _separated(
    series: FlatSeries, posterior: Posterior, context: Context, fields: dict[str, Any]
) -> list[Measurement]:
    seed = context.seed
    floor = floor_of(series, posterior, context=context)
    response = response_of(series, len(posterior.draws), context)
    if floor.is_detected:
        out = [measurement_from_draws("conversion_gain", "DN/e-", floor.draws, **fields)]
    else:
        kind = "not-applicable" if has_tube(context.camera) else "failed"
        out = [
            make_refusal("conversion_gain", "DN/e-", floor.refusal_reason, refusal=kind, **fields)
        ]
    electrons = floor.draws * posterior["lag_factor"]
    pulses: Array | None = posterior["covariance_gain"] - electrons
    # K must be known, or negligible, relative to the covariance gain.
    low, high = np.quantile(electrons, [0.025, 0.975])
    if (high - low) / np.median(posterior["covariance_gain"]) <= GAIN.max_floor_range:
        note = (f"covariance_gain less K, which is {floor.source}",)
        draws = posterior_of("pulse_gain", "DN", pulses, seed)
        out.append(
            measurement_from_draws(
                "pulse_gain", "DN", pulses, notes=note, posterior=draws, **fields
            )
        )
    else:
        reason = (
            f"k F2 lies between {np.quantile(pulses, 0.025):.3g} and "
            f"{np.quantile(pulses, 0.975):.3g} DN, because no white-noise floor is detected: "
            "flats at low tube gain, or the sensor's conversion gain, would give K"
        )
        out.append(make_refusal("pulse_gain", "DN", reason, **fields))
        pulses = None
    gain = response.gain
    if gain is None:
        reason = (
            f"k and F2 are not separable: {response.refusal_reason}; {PULSES} would also "
            f"separate them"
        )
        names = (("photoelectron_gain", "DN/pe"), ("excess_noise_factor", "1"))
        out += [make_refusal(*name, reason, refusal="missing", **fields) for name in names]
        return [*out, _tube(response, pulses, context, fields)]
    notes = (
        response.note,
        "the interval includes the uncertainty of the photocathode's sensitivity",
    )
    draws = posterior_of("photoelectron_gain", "DN/pe", gain, seed)
    out.append(
        measurement_from_draws(
            "photoelectron_gain", "DN/pe", gain, posterior=draws, notes=notes, **fields
        )
    )
    if pulses is None:
        out.append(
            make_refusal("excess_noise_factor", "1", "k F2 is not known; see pulse_gain", **fields)
        )
    else:
        out.append(
            measurement_from_draws("excess_noise_factor", "1", pulses / gain, notes=notes, **fields)
        )
    return [*out, _tube(response, pulses, context, fields)]


def posterior_of(name: str, unit: str, draws: Array, seed: int) -> Posterior:
    """Return the posterior of one derived quantity."""
    return Posterior(
        names=(name,), units=(unit,), draws=draws[:, None], sampler="laplace", seed=seed
    )


def response_of(series: FlatSeries, count: int, context: Context) -> ResponsivityEstimate:
    """Return k and responsivity from the light of the flats."""
    try:
        light = light_of_series(series.flats)
    except Unmeasurable as reason:
        return ResponsivityEstimate(refusal_reason=f"{APART} would tell ({reason})")
    chosen = series.fitted & (series.signal_dn > 0)
    sd = np.array([signal_sd(f, d) for f, d in zip(series.flats, series.darks, strict=True)])
    rng = np.random.default_rng([context.seed, 3])
    recorded = response_draws(
        light.amount[chosen], series.signal_dn[chosen], sd[chosen], rng, count
    )
    true = recorded / light.scale(context.seed, count)
    if light.unit == "lux":
        if light.seconds is None:
            return ResponsivityEstimate(
                refusal_reason="the exposure time is unknown (gate_ns, exposure_s)"
            )
        per_lux_s = true / light.seconds
        if not has_tube(context.camera):
            reason = "the photocathode is unknown (name the sensor)"
            return ResponsivityEstimate(per_lux_s=per_lux_s, note=light.note, refusal_reason=reason)
        gain = per_lux_s / photoelectrons_per_lux_s(context, rng, count)
        return ResponsivityEstimate(gain=gain, per_lux_s=per_lux_s, note=light.note)
    wavelengths = {flat.conditions.wavelength_nm for flat in series.flats}
    known = next(iter(wavelengths)) if len(wavelengths) == 1 else None
    if not has_tube(context.camera) or known is None:
        reason = "photons need a single wavelength_nm and the photocathode of a sensor"
        return ResponsivityEstimate(refusal_reason=reason)
    efficiency = photoelectrons_per_photon(context, known, rng, count)
    if np.median(efficiency) <= 0:
        return ResponsivityEstimate(
            refusal_reason=f"the photocathode has no efficiency at {known:g} nm"
        )
    return ResponsivityEstimate(gain=true / efficiency, note=light.note)


def _tube(
    response: ResponsivityEstimate,
    pulses: Array | None,
    context: Context,
    fields: dict[str, Any],
) -> Measurement:
    """Return the tube's signal-to-noise ratio from responsivity and k F^2."""
    reason = None
    if response.per_lux_s is None:
        reason = f"it needs the signal per lux and second: {response.refusal_reason}"
    elif not has_tube(context.camera):
        reason = "it needs the pixel size at the photocathode: name the sensor"
    elif pulses is None:
        reason = "k F2 is not known; see pulse_gain"
    if response.per_lux_s is None or pulses is None or reason is not None:
        return make_refusal("tube_snr", "1", str(reason), refusal="missing", **fields)
    area = pixel_area_m2(context, np.random.default_rng([context.seed, 33]), len(pulses))
    notes = (
        "spot of 0.2 mm at 108 microlux, bandwidth 10 Hz, 2856 K; noise of dark frames excluded; "
        "luminous sensitivity and noise factor cancel",
        response.note,
    )
    draws = snr_from_measurement(response.per_lux_s, np.maximum(pulses, 1e-12), area)
    return measurement_from_draws("tube_snr", "1", draws, notes=notes, **fields)


def add_event_gains(result: Result, session: Session, *, context: Context) -> Result:
    """Return the result with k and F^2 from flats, light and pulses, if pulses were measured at the
    same gain.

    `result`: `pulse_gain` of the flats and `detected_photoelectron_gain` of a dark stack, with
    their posteriors; without either it is returned unchanged; `session`: the session, with the gain
    of the dark stack.
    """
    flats = [m for m in result.find("pulse_gain") if m.posterior is not None]
    darks = [m for m in result.find("detected_photoelectron_gain") if m.posterior is not None]
    if not flats or not darks or not _same_gain(session, darks[0]):
        return result
    parted = _event_gains(result, flats[0], darks[0], context)
    better = {m.quantity for m in result.find("tube_snr") if m.value is not None}
    new = tuple(m for m in parted if m.quantity not in better)
    named = {m.quantity for m in new}
    return replace(
        result,
        measurements=(*(m for m in result.measurements if m.quantity not in named), *new),
    )


def _same_gain(session: Session, dark: Measurement) -> bool:
    """Return whether a dark stack was taken at the gain of most flats."""
    (main_gain, _), *_ = Counter(
        gain_of(entry.conditions) for entry in session.of_kind("flat")
    ).most_common()
    dark_gains = [
        gain_of(entry.conditions) for entry in session.of_kind("dark") if entry.label == dark.stack
    ]
    return main_gain in dark_gains


def _event_gains(
    result: Result, flats: Measurement, darks: Measurement, context: Context
) -> list[Measurement]:
    """Return k and F^2, and the tube's signal-to-noise ratio."""
    from charact.estimators.noise.events.event_measurements import detection

    assert flats.posterior is not None and darks.posterior is not None
    rng = np.random.default_rng([context.seed, 41])
    pulses = rng.choice(flats.posterior["pulse_gain"], SNR.separation_draws)
    height = rng.choice(darks.posterior["height_dn"], SNR.separation_draws)
    detected, note = detection(context, rng, SNR.separation_draws)
    gain, agreement = _gain(result, flats.method, height, detected, rng)
    labels: dict[str, Any] = {
        "method": f"{flats.method} + {darks.method}",
        "provenance": flats.provenance,
    }
    notes = (
        note,
        "from the light and single photoelectrons"
        if agreement < 1.0
        else "from single photoelectrons of the dark frames",
    )
    gain_posterior = posterior_of("photoelectron_gain", "DN/pe", gain, context.seed)
    factor = pulses / gain
    out = [
        measurement_from_draws(
            "photoelectron_gain", "DN/pe", gain, notes=notes, posterior=gain_posterior, **labels
        ),
        measurement_from_draws("excess_noise_factor", "1", factor, notes=notes, **labels),
    ]
    if has_tube(context.camera):
        sensitivity = context.camera.photocathode.luminous_sensitivity_ua_per_lm
        draws = snr_from_specification(
            lognormal_draws(sensitivity, rng, SNR.separation_draws), factor
        )
        notes = (*notes, "luminous sensitivity from the sensor description")
        out.append(measurement_from_draws("tube_snr", "1", draws, notes=notes, **labels))
    heights = measurement_from_draws("pulse_height_factor", "1", pulses / height, **labels)
    findings, misfit = inherited(flats, darks), []
    if agreement < SNR.min_agreement:
        effect = f"light and pulses agree in {100 * agreement:.2g} % of the draws"
        misfit = [finding("model-misfit", effect, "the light and the tube as they were")]
    return [judge(heights, findings), *(judge(m, [*findings, *misfit]) for m in out)]


def _gain(
    result: Result, method: str, height: Array, detected: Array, rng: np.random.Generator
) -> tuple[Array, float]:
    """Return draws of k, and the effective fraction consistent with light and pulses; 1 without a
    known light.
    """
    lit = [m for m in result.find("photoelectron_gain", method=method) if m.posterior is not None]
    if not lit or lit[0].posterior is None:
        return detected * height, 1.0
    gain = rng.choice(lit[0].posterior["photoelectron_gain"], SNR.separation_draws)
    density, edges = np.histogram(np.log(detected), bins=SNR.bins, density=True)
    cell = np.searchsorted(edges, np.log(gain / height)) - 1
    is_inside = (cell >= 0) & (cell < SNR.bins)
    weight = np.where(is_inside, density[np.clip(cell, 0, SNR.bins - 1)], 0.0)
    if not weight.any():
        return gain, 0.0
    agreement = float(weight.sum() ** 2 / (weight**2).sum() / SNR.separation_draws)
    return gain[
        rng.choice(SNR.separation_draws, SNR.separation_draws, p=weight / weight.sum())
    ], min(agreement, 0.999)
