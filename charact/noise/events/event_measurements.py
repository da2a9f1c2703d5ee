"""What single photoelectrons in dark frames tell: background illumination, pulse height and its spread."""

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.noise.checks import QUANTISED_DN2
from charact.noise.events.figure_data import pulse_figure_data
from charact.noise.events.frames import MOST_FRAMES, QUICK_VALUES, DarkFrames, dark_frames, fits_filters, has_pulses
from charact.noise.events.pulse_height_fit import PulseFit, fit_pulses
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.gain.series import gain_of
from charact.noise.provenance import provenance
from charact.noise.snr.cathode_radiometry import lognormal_draws, photoelectrons_per_lux_s
from charact.noise.stack.stack_statistics import StackStatistics
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.lazy_stack import open_lazy_stack
from labdata.measurement import Measurement, Posterior, Result, make_refusal, measurement_from_draws
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]

METHOD = "pulse-law"
LEAST_FRAMES = 8
# Smallest images: what is left inside the filters' reach, px.
LEAST_INSIDE = 24
# Response to a mean pulse over the filtered noise below which the law is not looked for, and below which it is doubted.
LOST, WEAK = 1.2, 3.0
# Relative standard errors of density or height beyond which nothing, and beyond which little, is known.
UNKNOWN, VAGUE = 0.4, 0.2
FEW_EVENTS = 200
LEAST_GAIN = 40
# Share of values that stay the same from frame to frame: that of rounded noise of 0.5 DN.
MOST_STILL = 0.53
# Shares of pixels that flicker, of bright values at the highest code, of values beside ion events.
DEFECT_SHARE, FULL_SHARE, SPOILT_SHARE = 0.01, 0.02, 0.5
LEAST_CHANCE = 1e-4
# Squared residuals per degree of freedom beyond which the law says nothing.
WORST_MISFIT = 8.0
# Share of the photoelectrons that start a pulse, where no sensor states it: open area, film and recovery.
DETECTION = (0.45, 1.0)


def pulses_of_darks(session: Session, darks: list[StackStatistics], *, context: Context) -> Result:
    """Measure the law of single photoelectrons in a session's dark frames, if they are an intensified camera's.

    Parameters
    ----------
    session, darks
        The session, and the statistics of its dark stacks.
    context
        Sensor, seed, fields and highest code.

    Returns
    -------
    Result
        Of the dark stack at the gain of most flats, or else of most frames; nothing where neither a sensor is named nor
        a voltage of the plate recorded, for then nobody says that there is an intensifier.
    """
    if context.sensor is None and not any(dark.conditions.mcp_v for dark in darks):
        return Result()
    gains = Counter(gain_of(entry.conditions) for entry in session.of_kind("flat"))
    common = max(gains, key=lambda gain: gains[gain], default=None)
    order = sorted(darks, key=lambda dark: (dark.frames >= LEAST_FRAMES, gain_of(dark.conditions) == common,
                                            dark.frames, dark.conditions.exposure_s or 0.0))  # fmt: skip
    return measure_events(session.stack(order[-1].label), context=context) if order else Result()


@with_timing
def measure_events(dark: StackEntry, *, context: Context) -> Result:
    """Measure the law of single photoelectrons in a dark stack."""
    context.progress("single photoelectrons in the darks", 0.95)
    fields: dict[str, Any] = {"method": METHOD, "stack": dark.label, "provenance": provenance(context)}
    found = _fit_dark_frames(_frames(dark), dark.conditions, context)
    if isinstance(found, str):
        out = [make_refusal(name, unit, found, **fields)
               for name, unit in (("detected_photoelectron_gain", "DN"), ("ebi", "pe/s/px"))]  # fmt: skip
        return Result(measurements=tuple(out))
    findings = pulse_findings(found)
    fields |= {"flags": flags_of(findings), "notes": notes_of(findings)}
    out = _measurements(found, dark.conditions, context, fields)
    return Result(measurements=tuple(out), evidence={"pulse-heights": pulse_figure_data(found)})


def _frames(dark: StackEntry) -> FrameStack:
    """As many frames as are used, of a stack that may be larger than memory."""
    stack = open_lazy_stack(dark)
    count = min(len(stack), MOST_FRAMES)
    return FrameStack(data=stack.frames(0, count), frame_number=stack.frame_number[:count],
                      full_scale_dn=stack.full_scale_dn)  # fmt: skip


def _fit_dark_frames(stack: FrameStack, conditions: Conditions, context: Context) -> PulseFit | str:
    """The law of the pulses, or why it cannot be had."""
    if len(stack) < LEAST_FRAMES:
        return f"pulses take at least {LEAST_FRAMES} dark frames, got {len(stack)}"
    look = dark_frames(stack, context, QUICK_VALUES)
    reason = frames_obstacle(look)
    if reason is not None:
        return reason
    period_s, open_s = conditions.exposure_s, _open_s(conditions)
    share = min(1.0, open_s / period_s) if open_s and period_s else 1.0
    try:
        found = fit_pulses(look, dark_frames(stack, context), context, period_s=period_s, open_share=share)
    except np.linalg.LinAlgError:
        return "no law of pulses comes near the darks: what brightens their pixels is not single photoelectrons"
    return found if isinstance(found, str) else fit_obstacle(found) or found


def frames_obstacle(frames: DarkFrames) -> str | None:
    """Why no pulses can be looked for in dark frames, or None."""
    if not fits_filters(frames, LEAST_INSIDE):
        rows, cols = frames.changes[0].shape[1:]
        return f"exposures of {rows} x {cols} px leave no room around the filters that find pulses"
    if frames.still > MOST_STILL:
        return (
            f"the noise under the pulses is finer than the digitiser's steps: {100 * frames.still:.0f} % of the values "
            f"stay the same from frame to frame, at most {100 * MOST_STILL:.0f} % may; a higher gain of the camera "
            "or a capture of 10 bits and more would show it"
        )
    if not has_pulses(frames):
        return "noise alone explains the darks: filtered pixels are as often far below their mean as above it"
    return None


def fit_obstacle(found: PulseFit) -> str | None:
    """Why the pulses cannot be measured, or None."""
    if found.gain_of_pulses < LEAST_GAIN:
        return (
            f"noise alone explains the darks: pulses improve chi2 by {found.gain_of_pulses:.0f}, less than {LEAST_GAIN}"
        )
    if found.signal_to_noise < LOST:
        return (
            f"pulses do not stand out of the noise: a mean one is {found.signal_to_noise:.2g} times the noise of a "
            f"filter that suits it, and {LOST:g} are needed"
        )
    if found.peak.chi2 > WORST_MISFIT * found.peak.freedom:
        return (
            "no law of pulses comes near the darks: chi2 per degree of freedom is "
            f"{found.peak.chi2 / found.peak.freedom:.0f}, at most {WORST_MISFIT:g} may be left"
        )
    error = max(_relative_sd(found.posterior, name) for name in ("density", "height_dn"))
    if error > UNKNOWN:
        return f"number and height of the pulses are known to {100 * error:.0f} % only: more frames are needed"
    return None


def _relative_sd(posterior: Posterior, name: str) -> float:
    return float(np.std(np.log(posterior[name])))


def pulse_findings(found: PulseFit) -> list[Finding]:
    """What to distrust, and what was seen."""
    best, frames, out = found.peak.pulses, found.frames, list[Finding]()
    out.append((None, f"the share p of the photoelectrons that start a pulse shows in no dark frame: {_HOW_P}"))
    if found.signal_to_noise < WEAK:
        out.append(("low-signal", f"a mean pulse is {found.signal_to_noise:.2g} times the filtered noise"))
    count = best.density * found.observed.pixels
    error = max(_relative_sd(found.posterior, name) for name in ("density", "height_dn"))
    if count < FEW_EVENTS or error > VAGUE:
        out.append(("too-few-frames", f"{count:.0f} events: number and height are known to {100 * error:.0f} %"))
    if best.noise_dn2 < QUANTISED_DN2:
        out.append(("quantised", f"the noise under the pulses is {np.sqrt(best.noise_dn2):.2g} DN"))
    if frames.full > FULL_SHARE:
        out.append(("clipped", f"{100 * frames.full:.0f} % of the brightest values are at the highest code"))
    if frames.defects > DEFECT_SHARE:
        out.append(("defects", f"{100 * frames.defects:.1f} % of the pixels flicker by themselves"))
    if found.peak.chance < LEAST_CHANCE:
        out.append(("model-misfit", f"pulses leave chi2 {found.peak.chi2:.0f} of {found.peak.freedom}"))
    if found.spoilt > SPOILT_SHARE:
        out.append(("model-misfit", f"{100 * found.spoilt:.0f} % of the values lie beside ion events"))
    if len(found.ion_height_dn):
        size = float(np.mean(found.ion_height_dn)) / best.height_dn
        rate = len(found.ion_height_dn) / sum(change.size for change in frames.changes)
        apart = f"{len(found.ion_height_dn)} ion events, {rate:.2g} per pixel and exposure"
        out.append((None, f"{apart}, of {size:.0f} mean pulses each are counted apart"))
    return out + [(flag, "see the posterior") for flag in found.posterior.flags]


_HOW_P = "a flat of known light tells k, and p is k over the pulse height"


def _measurements(found: PulseFit, conditions: Conditions, context: Context, fields: dict[str, Any]
                  ) -> list[Measurement]:  # fmt: skip
    """The quantities of a law that was found."""
    posterior = found.posterior
    rng = np.random.default_rng([context.seed, 7])
    height, spread = posterior["height_dn"], posterior["relative_variance"]
    detected, note = detection(context, rng, len(height))
    out = [measurement_from_draws("detected_photoelectron_gain", "DN", height, posterior=posterior, **fields)]
    told = {**fields, "notes": (*fields["notes"], note)}
    out.append(measurement_from_draws("photoelectron_gain", "DN/pe", detected * height, **told))
    out.append(measurement_from_draws("excess_noise_factor", "1", (1.0 + spread) / detected, **told))
    return out + _background(posterior["density"] / detected, conditions, context, rng, told)


def detection(context: Context, rng: np.random.Generator, count: int) -> tuple[Array, str]:
    """Return draws of the share of photoelectrons that start a pulse, and a sentence on where it is from."""
    if context.sensor is None:
        low, high = DETECTION
        return rng.uniform(low, high, count), f"no sensor is named: p is taken as anywhere from {low:g} to {high:g}"
    stated = context.sensor.microchannel_plate.detection_probability
    return np.minimum(
        lognormal_draws(stated, rng, count), 1.0
    ), f"p is the sensor's, {float(stated):.2g}, within its range"


def _open_s(conditions: Conditions) -> float | None:
    """Time in which photoelectrons come into one exposure, s."""
    return conditions.exposure_s if conditions.gate_ns is None else conditions.gate_ns * 1e-9


def _background(density: Array, conditions: Conditions, context: Context, rng: np.random.Generator,
                fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Photoelectrons in the dark, per second and pixel, and the light that would make as many."""
    open_s = _open_s(conditions)
    if not open_s:
        reason = (
            f"{np.median(density):.3g} photoelectrons per pixel and exposure: "
            "their rate needs the exposure_s or gate_ns of the darks"
        )
        plain = {key: value for key, value in fields.items() if key != "flags"}
        return [make_refusal("ebi", "pe/s/px", reason, **plain)]
    rate = density / open_s
    out = [measurement_from_draws("ebi", "pe/s/px", rate, **fields)]
    if context.sensor is not None:
        lux = rate / photoelectrons_per_lux_s(context, rng, len(rate))
        out.append(measurement_from_draws("ebi", "lm/cm2", 1e-4 * lux, **fields))
    return out
