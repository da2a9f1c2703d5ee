"""Detection and measurement of bars: by fit, or by sums for a camera with a description."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from charact.estimators.mtf.bars.amplitudes import (
    amplitudes_of,
    frame_correlation,
    second_harmonic,
    target_background,
)
from charact.estimators.mtf.bars.bar_image_model import BarLikelihood
from charact.estimators.mtf.bars.checks import (
    clipping_findings,
    finding,
    findings_of_fit,
    findings_of_sums,
    fundamental_in_standard_errors,
    light_in_standard_errors,
    not_identifiable,
    sum_notes,
    window_findings,
)
from charact.estimators.mtf.bars.detection import target_in
from charact.estimators.mtf.bars.fit import BarFit, fit_all_models, fit_frames, mtf_bias
from charact.estimators.mtf.bars.nonlinearity import (
    linearise_mtf_draws,
    response_findings,
    response_of,
)
from charact.estimators.mtf.bars.posterior import mtf_of, sample_fit, sample_sums
from charact.estimators.mtf.bars.target import (
    BarTarget,
    core_margin_px,
    fitting_margin,
    lost_fraction,
    margin_px,
    measure_frequency,
)
from charact.estimators.mtf.bars.thresholds import LIMITS
from charact.frames.stack import Stack
from charact.method import Context
from charact.verdict import Finding
from labdata import Array, Mask, Posterior, has_tube


@dataclass(frozen=True, kw_only=True)
class BarMeasurement:
    """A measured bar target."""

    target: BarTarget  # Position of the bars
    # posterior, mtf: draws, and the MTF of each
    posterior: Posterior
    mtf: Array
    # findings, notes: findings, and notes
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    margin_px: float  # Margin of the window around the bars


class BarRefusal(NamedTuple):
    """Refusal of a bar target: reason and flag."""

    reason: str
    flag: str = "no-target"


@dataclass(frozen=True, kw_only=True)
class StatedBars:
    """Number of bars and cycles per column pitch as stated by the user; None: not stated."""

    bars: int | None
    frequency: float | None

    def __str__(self) -> str:
        bars = "bars" if self.bars is None else f"{self.bars} bars"
        return bars if self.frequency is None else f"{bars} at {self.frequency:g} cy/px"

    @property
    def remedy(self) -> str:
        """Settings that would help."""
        settings = [
            name
            for name, value in (("`bars`", self.bars), ("`frequency_cy_per_px`", self.frequency))
            if value is None
        ]
        return " and ".join([*settings, "`roi`"]) + " narrow the search"


def measure_bars_in(
    stack: Stack, asked: StatedBars, context: Context
) -> BarMeasurement | BarRefusal:
    """Detect and measure the target of a region."""
    mean = stack.mean_frame_dn
    if asked.frequency and max(mean.shape) < (asked.bars or 2) / asked.frequency:
        size = f"{mean.shape[0]} x {mean.shape[1]} px"
        return BarRefusal(f"no target: {asked} require a larger region, got {size}")
    located = target_in(
        mean, bars=asked.bars, frequency=asked.frequency, pitch_ratio=context.pitch_ratio
    )
    if located is None:
        return BarRefusal(f"no target: no group of {asked} found; {asked.remedy}")
    return (_measure_strip if located.through else _measure_complete_target)(
        stack, located.target, asked, context
    )


def _measure_strip(
    stack: Stack, target: BarTarget, asked: StatedBars, context: Context
) -> BarMeasurement | BarRefusal:
    """Measure bars that cross the region."""
    mean = stack.mean_frame_dn
    turned = abs(np.sin(target.angle_rad)) > np.sqrt(0.5)
    target = replace(
        target, length_px=mean.shape[1] if turned else mean.shape[0] * target.pitch_ratio
    )
    why = not_identifiable(target, target.length_px)
    if why is not None:
        return BarRefusal(why, "aliased")
    window = np.ones(mean.shape, bool)
    problem = BarLikelihood.of(mean, window, target, target.frequency, strip=True)
    fit, problem = fit_frames(
        stack.data, problem, target, inflation=frame_correlation(stack.data, window)
    )
    if not light_in_standard_errors(fit) > LIMITS.min_light_sd:
        required = f"at least {LIMITS.min_light_sd:g} standard uncertainties"
        return BarRefusal(f"no target: the light of the bars must be {required}")
    across, _ = fit.target.coordinates(mean.shape)
    # Of the region around the bars, on the nearer side.
    margin = float(min(-across.min(), across.max()) - fit.target.width_px / 2.0)
    return _sample_measurement(stack, fit, problem, context, asked, margin, [])


def _refuse_faint(standard_errors: float) -> BarRefusal:
    return BarRefusal(
        reason=f"no target: the fundamental is {standard_errors:.1f} standard uncertainties; "
        f"at least {LIMITS.min_signal_sd:g} are required"
    )


def _refuse_other_object(target: BarTarget, asked: StatedBars) -> BarRefusal:
    wanted = StatedBars(
        bars=target.bars, frequency=asked.frequency or float(f"{target.frequency:.4g}")
    )
    return BarRefusal(
        f"no target: the spectrum of the object does not match {wanted}; {asked.remedy}"
    )


def _is_in_region(fit: BarFit) -> bool:
    """Return whether the fitted bars have the detected sign and lie in the region."""
    (rows, cols), fitted = fit.window.shape, fit.target
    placed = 0 <= fitted.row < rows and 0 <= fitted.col < cols
    return placed and fit["level_dn"] * fitted.sign > 0 and bool(_count_lit_pixels(fit).any())


def _count_lit_pixels(fit: BarFit) -> Mask:
    """Return the fitted pixels that the bars illuminate, shape (pixel,)."""
    return (fit.model_dn - fit["pedestal_dn"]) / fit["level_dn"] > 0.02


def _sample_measurement(
    stack: Stack,
    fit: BarFit,
    problem: BarLikelihood,
    context: Context,
    asked: StatedBars,
    margin: float,
    target_findings: list[Finding],
) -> BarMeasurement | BarRefusal:
    """Sample the posterior of a fitted image and collect findings and notes."""
    if not _is_in_region(fit):
        return _refuse_other_object(fit.target, asked)
    fitted_frequency, notes = fit.target.frequency, []
    if asked.frequency is None:
        problem = replace(problem, asked=fitted_frequency)
    elif abs(np.log(fitted_frequency / problem.asked)) > max(
        LIMITS.frequency_tolerance, 3.0 * fit.sd("log_frequency")
    ):
        notes.append(
            f"Measured bar frequency {fitted_frequency:.4g} cy/px; the MTF is reported at "
            f"{problem.asked:.4g} cy/px."
        )
    if asked.bars is None:
        kind = "bright bars on a darker" if fit.target.sign > 0 else "dark bars on a brighter"
        notes.append(f"Found {fit.target.bars} {kind} background.")
    forms = fit_all_models(fit, problem)
    _, likeliest, likeliest_problem = forms[0]
    if len(stack.data) == 1 and likeliest.cost < LIMITS.max_cost_ratio * fit.cost:
        # The noise of one frame held what the first form left over.
        refitted = fit_frames(stack.data, likeliest_problem, likeliest.target, first=likeliest)
        forms = fit_all_models(*refitted)
    _, fit, problem = forms[0]
    # Blur models that fit alike have about the same bias; the full posterior is that of the
    # preferred one.
    bias = mtf_bias(fit, problem)
    posterior = sample_fit(fit, problem, context, bias)
    response = response_of(stack, fit)
    mtf = linearise_mtf_draws(
        _average_models(forms, mtf_of(posterior, fit, context), context, bias),
        response,
        context.seed,
    )
    notes.append(f"Normalised to the light within {margin:.0f} px of the bars.")
    notes.append("The width of the bars is fitted: half a period within 1 % before the data.")
    if not has_tube(context.camera):
        notes.append("Square pixels assumed.")
    lit = np.zeros(problem.window.shape, bool)
    lit[problem.window] = _count_lit_pixels(fit)
    return BarMeasurement(
        target=replace(fit.target, frequency=problem.asked),
        posterior=posterior,
        mtf=mtf,
        findings=(
            *target_findings,
            *_extrapolation_findings([model for _, model, _ in forms], margin),
            *findings_of_fit(fit, problem),
            *response_findings(response, float(np.mean(mtf))),
            # White clips where there is light, black mostly where there is none.
            *clipping_findings(stack, (lit, problem.window), fit),
        ),
        notes=tuple(notes),
        margin_px=margin,
    )


def _extrapolation_findings(fits: Iterable[BarFit], margin_px: float) -> list[Finding]:
    """Return the finding of light that blur models have where no pixel shows it, beyond the window.

    For a transfer M the light further off than X is 1 - (2/pi) int M(f) sin(2 pi f X)/f df, lost on
    both pairs of sides. If it is not there, the MTF is too low by its fraction.
    """
    f = (np.arange(4096) + 0.5) / 2048.0
    kernel = np.sin(2.0 * np.pi * f * margin_px) / f / 2048.0
    most, bound = 0.0, 0.0
    for fit in fits:
        shape = fit.shape
        parameters = float(np.exp(shape.log_attenuation)), shape.form_one, shape.form_two
        core = np.exp(shape.form.ln(np.log(f / shape.reference), *parameters))
        fraction = 2.0 * (1.0 - 2.0 / np.pi * float(core @ kernel))
        if fraction > max(most, LIMITS.max_extrapolated_light):
            most, bound = fraction, (fraction - LIMITS.max_extrapolated_light) * shape.mtf
    if bound == 0.0:
        return []
    effect = (
        f"of the light, {100.0 * most:.0f} % is further than {margin_px:.0f} px from the bars, by "
        "blur models alone"
    )
    return [replace(finding("window-too-small", effect), bound=bound, sign=-1)]


def _average_models(
    forms: list[tuple[float, BarFit, BarLikelihood]], drawn: Array, context: Context, bias: float
) -> Array:
    """Return draws over all blur models in proportion to their weights, given those of the
    first.
    """
    parts = [(forms[0][0], drawn)]
    parts += [
        (weight, mtf_of(sample_fit(fit, problem, context, bias), fit, context))
        for weight, fit, problem in forms[1:]
    ]
    return np.concatenate(
        [
            samples[np.linspace(0, samples.size - 1, round(weight * drawn.size)).astype(np.intp)]
            for weight, samples in parts
        ]
    )


def _measure_complete_target(
    stack: Stack, target: BarTarget, asked: StatedBars, context: Context
) -> BarMeasurement | BarRefusal:
    """Measure a target that lies completely in the region."""
    mean, wanted = stack.mean_frame_dn, target
    margin, cut = fitting_margin(target, mean.shape, margin_px(context, target.frequency))
    window = target.box(mean.shape, margin)
    if np.count_nonzero(~window) < 50:
        return BarRefusal(
            reason="no target: the region must include background beyond the bars (pedestal not "
            "measurable); enlarge `roi`"
        )
    background, crowded = target_background(mean, target, margin)
    amplitudes = amplitudes_of(stack, target, window, background)
    reported = target.frequency
    if amplitudes.signal_to_noise > LIMITS.min_frequency_signal_sd:
        target = replace(target, frequency=measure_frequency(mean, target, margin))
        # The measured frequency is uncertain too: if it equals the stated one, the MTF is reported
        # at that.
        is_as_stated = (
            asked.frequency is not None
            and abs(target.frequency / reported - 1.0) < LIMITS.frequency_tolerance
        )
        reported = reported if is_as_stated else target.frequency
        amplitudes = amplitudes_of(stack, target, window, background)
    if has_tube(context.camera):
        box = target.box(mean.shape, core_margin_px(wanted.frequency))
        core = amplitudes_of(stack, target, box, background)
        if core.signal_to_noise < LIMITS.min_signal_sd:
            return _refuse_faint(core.signal_to_noise)
    if (
        not amplitudes.light > 0
        or amplitudes.zeros > LIMITS.max_zeros + LIMITS.max_zeros_sd / amplitudes.signal_to_noise
    ):
        return _refuse_other_object(target, asked)
    # A close alias makes the measured frequency uncertain too.
    why = not_identifiable(wanted, wanted.length_px) or not_identifiable(target, target.length_px)
    if why is not None:
        return BarRefusal(why, "aliased")
    # A fitted image has the width of the bars and the curvature of the response instead.
    second = (
        second_harmonic(mean, target, window, float(mean[background].mean()), amplitudes)
        if has_tube(context.camera)
        else 0.0
    )
    target_findings = findings_of_sums(target, amplitudes, second)
    target_findings += window_findings(
        margin, LIMITS.min_margin_px if cut and has_tube(context.camera) else 0.0, crowded=crowded
    )
    if has_tube(context.camera):
        box = target.box(mean.shape, 1.0)
        posterior = sample_sums(amplitudes, lost_fraction(context, margin), context)
        notes = [f"Normalised to the light within {margin:.0f} px of the bars."] if cut else []
        return BarMeasurement(
            target=target,
            posterior=posterior,
            mtf=posterior["mtf"],
            findings=(*target_findings, *clipping_findings(stack, (box,))),
            notes=(
                *sum_notes(target, wanted, amplitudes, stated=asked.frequency is not None),
                *notes,
            ),
            margin_px=margin,
        )
    fit_margin_px = max(20.0, 1.5 / target.frequency)
    # Only the pixels that have no other light.
    problem = BarLikelihood.of(
        mean, target.box(mean.shape, fit_margin_px) & (background | window), target, reported
    )
    fit, problem = fit_frames(stack.data, problem, target, inflation=amplitudes.frame_correlation)
    standing = fundamental_in_standard_errors(fit)
    if standing < LIMITS.min_signal_sd:
        return _refuse_faint(standing)
    return _sample_measurement(stack, fit, problem, context, asked, margin, target_findings)
