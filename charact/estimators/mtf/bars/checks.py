"""Checks of a bar target: bar count, field motion, nonlinearity, misfit, sharpening, aliasing."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from charact.estimators.mtf.bars.amplitudes import Amplitudes
from charact.estimators.mtf.bars.bar_count import likelier_bar_count
from charact.estimators.mtf.bars.bar_image_model import BOUNDS, BarLikelihood
from charact.estimators.mtf.bars.fit import BarFit, rounding_sd
from charact.estimators.mtf.bars.target import BarTarget, core_margin_px
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.estimators.mtf.sharpening import noise_gain
from charact.estimators.mtf.target_motion import TargetMotion
from charact.frames.stack import Stack
from charact.transfer.stages import aperture
from charact.verdict import Finding
from labdata import Array, Mask

REGION = "`roi` around this group only, with one period of background on every side"
REMEDIES = {
    "model-misfit": REGION,
    "several-targets": REGION,
    "window-too-small": "a larger `roi`",
    "quantised": "more gain or light, so that the noise exceeds one quantisation step",
    "clipped": "less light or gain, or a higher black level",
    "drift": "a single frame, or a stationary target",
    "interlace-motion": "a single field, or a stationary target",
    "low-signal": "more frames or more light",
    "gamma": "frames without gamma; unequal bars and gaps have the same effect",
    "processed": "raw frames without sharpening",
}
CLIPPED = "pixels are clipped: MTF error up to the clipped fraction of the bars' height"
POSTERIOR_FINDINGS = {
    "not-converged": (
        "interval from the curvature at the optimum; it may be a third too narrow",
        "another `seed`",
    ),
    "several-modes": (
        "the posterior has two modes, separated by the width of the interval",
        "`bars` and `frequency_cy_per_px`",
    ),
}


def finding(flag: str, effect: str, remedy: str | None = None) -> Finding:
    """Return the finding of a flag with its effect and remedy."""
    return Finding(flag=flag, effect=effect, remedy=remedy or REMEDIES[flag])


def sharpening_findings(fit: BarFit) -> list[Finding]:
    """Return the finding of a camera that sharpens: of noise on even ground, or of a response to a
    step that overshoots.
    """
    noise, height = np.zeros(fit.window.shape), np.ones(fit.window.shape)
    noise[fit.window] = fit.residual_dn / np.sqrt(np.maximum(fit.noise.variance, 1e-30))
    height[fit.window] = np.abs((fit.model_dn - fit["pedestal_dn"]) / fit["level_dn"])
    gain = noise_gain(noise, height < LIMITS.max_even_height)
    overshoot, sd = _overshoot(fit)
    # An image sharper than that of the pixels alone leaves residuals that are no noise.
    if not (
        gain > 1.0
        or overshoot > max(LIMITS.min_overshoot, LIMITS.overshoot_sd * sd)
        or (
            np.exp(fit["log_attenuation"]) < LIMITS.min_attenuation
            and fit.noise.correlation_sum > LIMITS.max_correlation_sum
        )
    ):
        return []
    effect = (
        f"sharpened: overshoot of {100.0 * overshoot:.1f} % of a step, and noise is "
        f"{100.0 * (gain - 1.0):.0f} % larger; the MTF is that of the processed image"
    )
    return [finding("processed", effect)]


def _overshoot(fit: BarFit) -> tuple[float, float]:
    """Return the overshoot of both sides of a step under the fitted blur, and its standard
    uncertainty.

    E(x) = 1/2 + int_0^inf T(u) sin(2 pi u x)/(pi u) du, in periods x and cycles per period u.
    """
    names = ("log_attenuation", "form_one", "form_two")
    shape, index = fit.shape, [fit.names.index(name) for name in names]
    u = (np.arange(4000) + 0.5) / 100.0
    x = np.arange(1.0, 100.0) / 50.0
    kernel = np.sin(2.0 * np.pi * np.outer(x, u)) / (100.0 * np.pi * u)
    pixel = aperture(np.asarray(u * fit.target.frequency, np.float64), shape.angle_rad)
    ratio = np.log(u * fit.target.frequency / shape.reference)

    low, high = np.array([BOUNDS["log_attenuation"], *shape.form.bounds]).T

    def overshoot(theta: Array) -> float:
        attenuation, *parameters = np.clip(theta, low, high)
        core = np.exp(shape.form.ln(ratio, float(np.exp(attenuation)), *parameters))
        return 2.0 * float((kernel @ (core * pixel)).max() - 0.5)

    theta, step = fit.value[index], ACCURACY.shape_step
    moves = step * np.eye(len(index))
    slopes = np.array([overshoot(theta + move) - overshoot(theta - move) for move in moves])
    variance = slopes @ fit.covariance[np.ix_(index, index)] @ slopes / (2.0 * step) ** 2
    return overshoot(theta), float(np.sqrt(max(variance, 0.0)))


def window_findings(margin_px: float, least_px: float, *, crowded: bool = False) -> list[Finding]:
    """Return findings where other light reaches into the window, and where it cuts off part of the
    core's blur.
    """
    findings = []
    if crowded:
        height = f"{100 * LIMITS.max_other_light:.0f} % of the bars' height"
        findings.append(
            finding("several-targets", f"other light nearby exceeds {height}: MTF error up to that")
        )
    if margin_px < least_px:
        effect = f"light further than {margin_px:.0f} px from the bars is not included"
        findings.append(
            finding("window-too-small", f"{effect}: the MTF is too high by its fraction")
        )
    return findings


def clipping_findings(
    stack: Stack, windows: Iterable[Mask], fit: BarFit | None = None
) -> list[Finding]:
    """Return a finding where pixels of a window are clipped.

    If the frames have hardly any noise, a flat plateau proves clipping only at a stated full scale.
    """
    if (
        fit is not None
        and _is_noise_hidden(stack, fit)
        and (stack.ceiling_dn is None or stack.data.max() < stack.ceiling_dn)
    ):
        return []
    if not any(stack.is_clipped(window) for window in windows):
        return []
    return [finding("clipped", CLIPPED)]


def _is_noise_hidden(stack: Stack, fit: BarFit) -> bool:
    """Return whether a frame's noise is below the quantisation step, or below the error of the
    image's table.
    """
    sd = float(np.sqrt(np.median(fit.noise.variance) * len(stack.data)))
    return sd < (
        LIMITS.hidden_noise_dn
        if stack.data.dtype.kind in "ui"
        else LIMITS.hidden_noise_fraction * abs(fit["level_dn"])
    )


def findings_of_posterior(flags: Iterable[str]) -> list[Finding]:
    """Return the findings of a posterior's flags; an exponent at its bound is none."""
    return [
        finding(flag, *POSTERIOR_FINDINGS[flag]) for flag in flags if flag in POSTERIOR_FINDINGS
    ]


def findings_of_draws(
    mtf: Array, motion: TargetMotion, frequency: float, flags: Iterable[str]
) -> list[Finding]:
    """Return the findings of the draws of the MTF, their sampling and motion."""
    mean, sd = float(mtf.mean()), float(mtf.std())
    findings = findings_of_posterior(flags)
    if np.quantile(mtf, 0.025) > 1.0:
        findings.append(
            finding("model-misfit", f"the MTF must be at most 1, got {100 * mean - 100:.1f} % more")
        )
    if mean < LIMITS.min_mtf_sd * sd:
        findings.append(
            finding(
                "low-signal",
                f"the MTF is {mean / max(sd, 1e-30):.1f} standard errors: an upper limit",
            )
        )
    if motion.moves:
        findings.append(
            Finding(
                flag="drift",
                effect=f"the bars move by {motion.rms_px:.2g} px rms",
                remedy=REMEDIES["drift"],
                bound=motion.max_lift(mean, frequency),
                sign=-1,
            )
        )
    return findings


def sum_notes(
    target: BarTarget, wanted: BarTarget, amplitudes: Amplitudes, *, stated: bool
) -> tuple[str, ...]:
    """Return notes on sums over a target: measured frequency and image lag."""
    notes = []
    if stated and abs(target.frequency / wanted.frequency - 1.0) > LIMITS.frequency_tolerance:
        notes.append(
            f"Measured bar frequency {target.frequency:.4g} cy/px, {wanted.frequency:.4g} cy/px "
            "requested."
        )
    if amplitudes.frame_correlation > 1.2:
        factor = np.sqrt(amplitudes.frame_correlation)
        notes.append(
            f"Image lag: the standard error of the mean is {factor:.2f} times that of independent "
            "frames."
        )
    return tuple(notes)


def findings_of_sums(target: BarTarget, amplitudes: Amplitudes, second: float) -> list[Finding]:
    """Return the findings from the sums over a target: bar count, motion between fields, nonlinear
    response.
    """
    findings = []
    noise = LIMITS.significant_sd / amplitudes.signal_to_noise
    if (
        amplitudes.zeros > LIMITS.suspect_zeros + noise
        or amplitudes.flank < LIMITS.min_flank - noise
    ):
        effect = (
            f"{100 * amplitudes.zeros:.0f} % of the fundamental at the zeros of the spectrum "
            f"of {target.bars} bars"
        )
        findings.append(
            finding(
                "model-misfit",
                f"{effect}: MTF error up to that",
                f"`bars`, `frequency_cy_per_px`; {REGION}",
            )
        )
    field_offset_px = abs(amplitudes.fields_apart_px)
    # Bars along rows are aliased in each field, which resembles motion.
    upright = abs(np.sin(target.angle_rad)) < LIMITS.max_upright_sine
    if upright and field_offset_px > max(
        LIMITS.significant_sd * amplitudes.fields_apart_sd_px, LIMITS.max_field_offset_px
    ):
        findings.append(_field_motion(field_offset_px, target.frequency))
    if (
        abs(second)
        > LIMITS.max_second_harmonic + LIMITS.max_second_harmonic_sd / amplitudes.signal_to_noise
    ):
        effect = (
            f"second harmonic {100 * abs(second):.1f} % of the fundamental: MTF error up to that"
        )
        findings.append(finding("gamma", effect))
    return findings


def findings_of_fit(fit: BarFit, problem: BarLikelihood) -> list[Finding]:
    """Return the findings of a fitted image: misfit, departure, sharpening, field motion, bar
    count, quantisation.
    """
    findings = []
    residual_rms = _profile_residual_rms(fit)
    if residual_rms > 0.0:
        residual_percent = 100.0 * residual_rms / abs(fit["level_dn"])
        findings.append(
            finding(
                "model-misfit",
                f"residual profile {residual_percent:.1f} % of the bars' height: "
                "MTF error up to that",
            )
        )
    departure, departure_sd = (
        abs(fit["departure"]),
        1.0 / np.sqrt(fit.precision[fit.names.index("departure")]),
    )
    if departure > LIMITS.max_departure_sd * departure_sd:
        effect = (
            f"the MTF at the bars departs by {100 * departure:.0f} % from the blur model of the "
            "image"
        )
        bound = departure * fit.shape.mtf
        findings.append(replace(finding("model-misfit", effect), bound=bound))
    findings += sharpening_findings(fit)
    upright = abs(np.sin(fit.target.angle_rad)) < LIMITS.max_upright_sine
    field_offset_px = _field_offset_px(fit) if fit.strip and upright else 0.0
    if field_offset_px:
        findings.append(_field_motion(field_offset_px, fit.target.frequency))
    other = likelier_bar_count(fit, problem)
    if other is not None:
        effect = (
            f"the data favour {other} bars over {fit.target.bars}; the light per bar changes "
            f"accordingly"
        )
        findings.append(finding("model-misfit", effect, f"`bars` {other}"))
    quantisation_sd = rounding_sd(fit)
    if quantisation_sd > LIMITS.max_rounding_sd:
        findings.append(
            finding(
                "quantised", f"quantisation may change the MTF by {100 * quantisation_sd:.0f} %"
            )
        )
    return findings


def _field_motion(apart_px: float, frequency: float) -> Finding:
    """Return the finding that the fields are displaced, with the loss of MTF in their mean."""
    lowered = 1.0 - np.cos(np.pi * frequency * apart_px)
    effect = (
        f"the fields are displaced by {apart_px:.2f} px: the MTF is {100 * lowered:.2g} % too low"
    )
    return finding("interlace-motion", effect)


def light_in_standard_errors(fit: BarFit) -> float:
    """Return the bars' light in its standard uncertainties at fixed shape and position."""
    slope = fit.slope[[fit.names.index("level_dn"), fit.names.index("pedestal_dn")]]
    weighted = slope / fit.noise.variance
    estimator = np.asarray(np.linalg.solve(weighted @ slope.T, weighted), dtype=np.float64)
    return abs(fit["level_dn"]) / float(np.sqrt(fit.noise.spread(estimator, fit.window)[0, 0]))


def fundamental_in_standard_errors(fit: BarFit) -> float:
    """Return the fundamental of the bars' core in its standard uncertainties."""
    target, pixels = fit.target, fit.model_dn + fit.residual_dn - fit["pedestal_dn"]
    across, _ = target.coordinates(fit.window.shape)
    core = target.box(fit.window.shape, core_margin_px(target.frequency))[fit.window]
    phase = 2.0 * np.pi * target.frequency * across[fit.window]
    waves = np.where(core, np.stack([np.cos(phase), np.sin(phase)]), 0.0)
    spread = fit.noise.spread(waves, fit.window)
    modulus, sd = float(np.hypot(*(waves @ pixels))), float(np.sqrt(0.5 * np.trace(spread)))
    return modulus / max(sd, 1e-12 * modulus + 1e-30)


def _profile_residual_rms(fit: BarFit) -> float:
    """Return the rms of the mean residual profile across the bars, DN, where it exceeds noise and
    model tolerance.

    Averaging along the bars suppresses noise, also where the noise was estimated from these
    residuals.
    """
    across, _ = fit.target.coordinates(fit.window.shape)
    on_bars = np.abs(across[fit.window]) < fit.target.width_px / 2.0 + 1.0 / fit.target.frequency
    position = np.floor(across[fit.window][on_bars]).astype(np.intp)
    position = position - position.min()
    count = np.bincount(position)
    shared = float(np.abs(fit.noise.correlation).sum()) * fit.noise.inflation
    mean = np.bincount(position, fit.residual_dn[on_bars])[count > 0] / count[count > 0]
    expected = (
        np.bincount(position, fit.noise.variance[on_bars])[count > 0]
        * shared
        / count[count > 0] ** 2
    )
    noise = LIMITS.significant_sd * np.sqrt(2.0 * float(np.sum(expected**2))) / mean.size
    square = float(np.mean(mean**2 - expected))
    return (
        float(np.sqrt(square))
        if square > (LIMITS.max_misfit * fit["level_dn"]) ** 2 + noise
        else 0.0
    )


def _field_offset_px(fit: BarFit) -> float:
    """Return the displacement of odd rows from even rows across the bars, px, where it is
    significant.
    """
    odd = 1.0 - 2.0 * (np.nonzero(fit.window)[0] % 2)
    slope = fit.slope[fit.names.index("across_px")] * odd
    weight = 1.0 / float(slope @ slope)
    offset_px = 2.0 * weight * float(slope @ fit.residual_dn)
    sd = 2.0 * np.sqrt(weight * np.mean(fit.residual_dn**2))
    return (
        abs(offset_px)
        if abs(offset_px) > max(LIMITS.significant_sd * sd, LIMITS.max_field_offset_px)
        else 0.0
    )


def not_identifiable(target: BarTarget, length_px: float) -> str | None:
    """Return why the fundamental cannot be separated from its alias; None where it can.

    Notes
    -----
    The alias of a component g along a grid axis lies at 1 - g. The spectrum of N bars is f/N wide
    on either side, so that the two overlap where 1 - 2 g < 2 f/N, unless the tilt of the bars
    covers the pixel's phases.
    """
    cosine, sine = abs(np.cos(target.angle_rad)), abs(np.sin(target.angle_rad))
    ratio = target.pitch_ratio
    cases = [
        (target.frequency * cosine, length_px * sine),
        (target.frequency * sine * ratio, length_px * cosine / ratio),
    ]
    for sampled, travel in cases:
        if (
            1.0 - 2.0 * sampled < LIMITS.min_alias_distance * target.frequency / target.bars
            and travel < LIMITS.min_travel_px
        ):
            return (
                f"not identifiable: {sampled:.3g} cycles per sample alias to {1.0 - sampled:.3g}, "
                f"and the bars shift only {travel:.2g} px over their length; tilt them by a few "
                "degrees"
            )
    return None
