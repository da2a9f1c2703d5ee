"""Single photoelectrons of dark frames: background illumination, pulse height, excess noise
factor.
"""

from collections import Counter
from typing import Any

import numpy as np

from charact.estimators.noise.events.frames import MIDDLE, dark_frames, fits_filters, has_pulses
from charact.estimators.noise.events.pulse_height_fit import PulseFit, fit_pulses
from charact.estimators.noise.findings import (
    Remarks,
    Unmeasurable,
    finding,
    judged,
    posterior_findings,
    provenance,
)
from charact.estimators.noise.gain.series import gain_of
from charact.estimators.noise.illumination import lognormal_draws, photoelectrons_per_lux_s
from charact.estimators.noise.thresholds import EVENT_ACCURACY, EVENTS
from charact.frames.rounding import QUANTISED_DN2
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context
from charact.method.stopwatch import with_timing
from labdata import (
    Array,
    Conditions,
    FrameStack,
    Measurement,
    Posterior,
    Result,
    Session,
    StackEntry,
    has_tube,
    make_refusal,
    measurement_from_draws,
    open_lazy_stack,
)


def pulse_figure_data(pulse_fit: PulseFit) -> dict[str, Any]:
    """Return measured and fitted distributions of filtered pixels, and the fit parameters."""
    best, matched = pulse_fit.peak.pulses, pulse_fit.observed.filters[MIDDLE]
    noise = float(np.sqrt(matched.noise(best.line) * best.noise_dn2))
    low, high = (
        -EVENT_ACCURACY.figure_noise_sd * noise,
        EVENT_ACCURACY.figure_heights * pulse_fit.signal_to_noise * noise,
    )
    edges = np.linspace(low, high, EVENT_ACCURACY.figure_bins + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    value = [
        matched.within(change, matched.reach)[
            mask[
                :,
                matched.reach[0] : mask.shape[1] - matched.reach[0],
                matched.reach[1] : mask.shape[2] - matched.reach[1],
            ]
        ]
        for change, mask in zip(pulse_fit.frames.changes, pulse_fit.usable, strict=True)
    ]
    pixels = sum(part.size for part in value)
    count = sum(np.histogram(part, edges)[0] for part in value)
    spread = pulse_fit.posterior["relative_variance"]
    return {
        "figure": "pulse-heights",
        "edge_dn": edges.tolist(),
        "density_per_dn": (np.asarray(count) / pixels / np.diff(edges)).tolist(),
        "value_dn": middle.tolist(),
        "law_per_dn": _density(pulse_fit, middle, float(high - low)).tolist(),
        "noise_per_dn": (
            np.exp(-0.5 * (middle / noise) ** 2) / noise / np.sqrt(2.0 * np.pi)
        ).tolist(),
        "values": pixels,
        "filter_px": [matched.high, matched.broad],
        "response_to_mean_pulse_dn": pulse_fit.signal_to_noise * noise,
        "density_per_px": best.density,
        "mean_height_dn": best.height_dn,
        "relative_variance": best.relative_variance,
        "relative_variance_sd": float(np.std(spread)),
        "spot_column_px": best.column_px,
        "spot_row_px": best.row_px,
        "glow": best.glow,
        "glow_exposures": best.glow_exposures,
        "fast_exposures": best.fast_exposures,
        "signal_to_noise": pulse_fit.signal_to_noise,
        "ion_events": len(pulse_fit.ion_height_dn),
        "ion_events_per_px": len(pulse_fit.ion_height_dn)
        / sum(change.size for change in pulse_fit.frames.changes),
        "ion_mean_height_dn": float(np.mean(pulse_fit.ion_height_dn))
        if len(pulse_fit.ion_height_dn)
        else None,
        "chi2": pulse_fit.peak.chi2,
        "freedom": pulse_fit.peak.freedom,
        "chance": pulse_fit.peak.chance,
    }


def _density(pulse_fit: PulseFit, value: Array, span_dn: float) -> Array:
    """Return the fitted probability density of filtered pixels per DN, from its characteristic
    function.
    """
    step = EVENT_ACCURACY.figure_margin * span_dn / EVENT_ACCURACY.figure_points
    frequency = np.asarray(
        2.0 * np.pi * np.fft.rfftfreq(EVENT_ACCURACY.figure_points, step), np.float64
    )
    log = pulse_fit.peak.pulses.log_characteristic(pulse_fit.observed.filters[MIDDLE], frequency)
    # NumPy's transform uses exp(-i t y).
    density = np.fft.irfft(np.exp(np.conj(log)), EVENT_ACCURACY.figure_points) / step
    heights_dn = np.fft.fftfreq(
        EVENT_ACCURACY.figure_points, 1.0 / (EVENT_ACCURACY.figure_points * step)
    )
    order = np.argsort(heights_dn)
    return np.interp(value, heights_dn[order], np.maximum(density[order], 0.0))


METHOD = "pulse-law"


def pulses_of_darks(session: Session, darks: list[StackStatistics], *, context: Context) -> Result:
    """Measure single photoelectrons in the dark frames of an intensified camera.

    Returns measurements of the dark stack at the gain of most flats, or else of most frames; empty
    if neither a sensor nor an MCP voltage indicates an intensifier.
    """
    if not has_tube(context.camera) and not any(dark.conditions.mcp_v for dark in darks):
        return Result()
    gains = Counter(gain_of(entry.conditions) for entry in session.of_kind("flat"))
    common = max(gains, key=lambda gain: gains[gain], default=None)
    order = sorted(
        darks,
        key=lambda dark: (
            dark.frames >= EVENTS.min_frames,
            gain_of(dark.conditions) == common,
            dark.frames,
            dark.conditions.exposure_s or 0.0,
        ),
    )
    return measure_events(session.stack(order[-1].label), context=context) if order else Result()


@with_timing
def measure_events(dark: StackEntry, *, context: Context) -> Result:
    """Measure single photoelectrons in a dark stack."""
    context.progress("single photoelectrons in the darks", 0.95)
    fields: dict[str, Any] = {
        "method": METHOD,
        "stack": dark.label,
        "provenance": provenance(context),
    }
    stack = open_lazy_stack(dark)
    count = min(len(stack), EVENTS.max_frames)
    frames = FrameStack(
        data=stack.frames(0, count),
        frame_number=stack.frame_number[:count],
        full_scale_dn=stack.full_scale_dn,
    )
    try:
        pulse_fit = _fit_dark_frames(frames, dark.conditions, context)
    except Unmeasurable as reason:
        out = [
            make_refusal(name, unit, str(reason), **fields)
            for name, unit in (("detected_photoelectron_gain", "DN"), ("ebi", "pe/s/px"))
        ]
        return Result(measurements=tuple(out))
    remarks = pulse_remarks(pulse_fit)
    out = [
        m if m.value is None else judged(m, remarks)
        for m in _measurements(pulse_fit, dark.conditions, context, fields)
    ]
    return Result(measurements=tuple(out), evidence={"pulse-heights": pulse_figure_data(pulse_fit)})


def _fit_dark_frames(stack: FrameStack, conditions: Conditions, context: Context) -> PulseFit:
    """Return the pulse fit; Unmeasurable if the darks do not show single photoelectrons."""
    if len(stack) < EVENTS.min_frames:
        raise Unmeasurable(
            f"single photoelectrons need at least {EVENTS.min_frames} dark frames, got {len(stack)}"
        )
    look = dark_frames(stack, context, EVENTS.quick_values)
    rows, cols = look.changes[0].shape[1:]
    if not fits_filters(look, EVENTS.min_inside_px):
        raise Unmeasurable(f"exposures of {rows} x {cols} px are too small for the pulse filters")
    if look.still > EVENTS.max_unchanged:
        raise Unmeasurable(
            "the read noise is smaller than the quantisation step: "
            f"{100 * look.still:.0f} % of the values are equal in successive frames, and at most "
            f"{100 * EVENTS.max_unchanged:.0f} % must be; use a higher camera gain or 10 bits"
        )
    if not has_pulses(look):
        raise Unmeasurable(
            "no single-photoelectron events detected: filtered pixels are symmetric about their "
            "mean"
        )
    period_s, open_s = conditions.exposure_s, _open_s(conditions)
    open_share = min(1.0, open_s / period_s) if open_s and period_s else 1.0
    try:
        pulse_fit = fit_pulses(
            look, dark_frames(stack, context), context, period_s=period_s, open_share=open_share
        )
    except np.linalg.LinAlgError:
        raise Unmeasurable(
            "no pulse-height distribution fits the darks: their bright pixels are not single "
            "photoelectrons"
        ) from None
    chi2, error = pulse_fit.peak.chi2 / pulse_fit.peak.freedom, _relative_sd(pulse_fit.posterior)
    for is_refused, reason in (
        (
            pulse_fit.gain_of_pulses < EVENTS.min_chi2_gain,
            "no single-photoelectron events detected: chi2 improvement "
            f"{pulse_fit.gain_of_pulses:.0f}, at least {EVENTS.min_chi2_gain} required",
        ),
        (
            pulse_fit.signal_to_noise < EVENTS.min_snr,
            f"pulses are hidden by noise: a mean pulse is {pulse_fit.signal_to_noise:.2g} times "
            "the "
            f"noise of a matched filter, at least {EVENTS.min_snr:g} required",
        ),
        (
            chi2 > EVENTS.max_reduced_chi2,
            "no pulse-height distribution fits the darks: chi2 per degree of freedom is "
            f"{chi2:.0f}, at most {EVENTS.max_reduced_chi2:g} may be left",
        ),
        (
            error > EVENTS.max_relative_sd,
            (
                f"the uncertainty of number or height of pulses is {100 * error:.0f} %; take more "
                f"frames"
            ),
        ),
    ):
        if is_refused:
            raise Unmeasurable(reason)
    return pulse_fit


def _relative_sd(posterior: Posterior) -> float:
    """Return the relative uncertainty of density or height, the larger."""
    return max(float(np.std(np.log(posterior[name]))) for name in ("density", "height_dn"))


def pulse_remarks(pulse_fit: PulseFit) -> Remarks:
    """Return what was seen of a pulse fit."""
    best, frames, ions = pulse_fit.peak.pulses, pulse_fit.frames, pulse_fit.ion_height_dn
    count, error = best.density * pulse_fit.observed.pixels, _relative_sd(pulse_fit.posterior)
    remarks: Remarks = [f"the detection probability p is not measurable in darks: {_HOW_P}"]
    checks = (
        (
            pulse_fit.signal_to_noise < EVENTS.low_snr,
            "low-signal",
            f"a mean pulse is {pulse_fit.signal_to_noise:.2g} times the filtered noise",
        ),
        (
            count < EVENTS.few_events or error > EVENTS.high_relative_sd,
            "too-few-frames",
            f"{count:.0f} events: the uncertainty of number or height is {100 * error:.0f} %",
        ),
        (
            best.noise_dn2 < QUANTISED_DN2,
            "quantised",
            f"the noise beneath the pulses is {np.sqrt(best.noise_dn2):.2g} DN",
        ),
        (
            frames.full > EVENTS.clipped_fraction,
            "clipped",
            f"{100 * frames.full:.0f} % of the brightest values are at full scale",
        ),
        (
            frames.defects > EVENTS.blinking_fraction,
            "defects",
            f"{100 * frames.defects:.1f} % of the pixels are blinking",
        ),
        (
            pulse_fit.peak.chance < EVENTS.min_p_value,
            "model-misfit",
            f"residuals of the pulse fit have chi2 {pulse_fit.peak.chi2:.0f} of "
            f"{pulse_fit.peak.freedom}",
        ),
        (
            pulse_fit.fraction_contaminated > EVENTS.contaminated_fraction,
            "model-misfit",
            f"{100 * pulse_fit.fraction_contaminated:.0f} % of the values are near ion feedback "
            "events",
        ),
    )
    remarks += [finding(flag, effect) for applies, flag, effect in checks if applies]
    if len(ions):
        size = float(np.mean(ions)) / best.height_dn
        rate = len(ions) / sum(change.size for change in frames.changes)
        remarks.append(
            f"{len(ions)} ion feedback events, {rate:.2g} per pixel and exposure, of {size:.0f} "
            "mean pulses each, are excluded"
        )
    return remarks + posterior_findings(pulse_fit.posterior)


_HOW_P = "take a flat at known illuminance: it gives k, and p = k / pulse height"


def _measurements(
    pulse_fit: PulseFit, conditions: Conditions, context: Context, fields: dict[str, Any]
) -> list[Measurement]:
    """Return the quantities of a pulse fit, with the EBI: dark photoelectrons per second and pixel,
    and equivalent illumination.
    """
    posterior = pulse_fit.posterior
    rng = np.random.default_rng([context.seed, 7])
    height, spread = posterior["height_dn"], posterior["relative_variance"]
    detected, note = detection(context, rng, len(height))
    out = [
        measurement_from_draws(
            "detected_photoelectron_gain", "DN", height, posterior=posterior, **fields
        )
    ]
    gain_fields = {**fields, "notes": (note,)}
    out.append(
        measurement_from_draws("photoelectron_gain", "DN/pe", detected * height, **gain_fields)
    )
    out.append(
        measurement_from_draws("excess_noise_factor", "1", (1.0 + spread) / detected, **gain_fields)
    )
    density, open_s = posterior["density"] / detected, _open_s(conditions)
    if not open_s:
        reason = (
            f"{np.median(density):.3g} photoelectrons per pixel and exposure: their rate needs "
            "the exposure_s or gate_ns of the darks"
        )
        return [*out, make_refusal("ebi", "pe/s/px", reason, **gain_fields)]
    rate = density / open_s
    out.append(measurement_from_draws("ebi", "pe/s/px", rate, **gain_fields))
    if has_tube(context.camera):
        lux = rate / photoelectrons_per_lux_s(context, rng, len(rate))
        out.append(measurement_from_draws("ebi", "lm/cm2", 1e-4 * lux, **gain_fields))
    return out


def detection(context: Context, rng: np.random.Generator, count: int) -> tuple[Array, str]:
    """Return draws of the detection probability, and a note on its source."""
    if not has_tube(context.camera):
        low, high = EVENTS.detection_range
        return rng.uniform(
            low, high, count
        ), f"without a sensor description, p is assumed between {low:g} and {high:g}"
    stated = context.camera.microchannel_plate.detection_probability
    note = f"p from the sensor description, {float(stated):.2g}, within its range"
    return np.minimum(lognormal_draws(stated, rng, count), 1.0), note


def _open_s(conditions: Conditions) -> float | None:
    """Return the open time of one exposure, s."""
    return conditions.exposure_s if conditions.gate_ns is None else conditions.gate_ns * 1e-9
