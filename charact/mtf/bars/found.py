"""Bars found and measured: those through a region and whole ones fitted, those of a described camera summed."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.bars.amplitudes import Amplitudes, amplitudes_of, frame_correlation
from charact.mtf.bars.bias import rounding_sd
from charact.mtf.bars.checks import (
    flags_of_codes,
    flags_of_fit,
    flags_of_sums,
    fundamental_in_standard_errors,
    light_in_standard_errors,
    not_identifiable,
)
from charact.mtf.bars.fit import Fit, measured
from charact.mtf.bars.light import ground_of, second_harmonic
from charact.mtf.bars.number import other_number
from charact.mtf.bars.picture import Problem
from charact.mtf.bars.place import runs_through, strip_of
from charact.mtf.bars.posterior import mtf_of, of_fit, of_sums
from charact.mtf.bars.response import response_flags, response_notes, response_of, straightened
from charact.mtf.bars.target import LENGTH_OVER_WIDTH, BarTarget, core_margin_px, find, own_frequency
from charact.mtf.bars.window import fitting_margin, lost_share, margin_px
from charact.mtf.memory import memory_of
from labdata.frames import FrameStack
from labdata.measurement import Posterior

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A fundamental this many standard errors high over a whole target is bars; noise alone has up to about five.
LEAST_SIGNAL = 5.0
DARK = "no target: bars must be brighter than the ground around them, and what is here is darker"
# The light of bars that run through a region, in its own standard errors.
LEAST_LIGHT = 9.0
# The zeros beside the fundamental, over it, and in their standard errors: more than this is another object.
OTHER_OBJECT, OTHER_OBJECT_SD = 0.5, 3.5
# Significance from which the zeros tell the bars' own frequency better than whoever asked, and a change worth telling.
TELLS_FREQUENCY, TOLD_FREQUENCY = 30.0, 0.01
# A window that reaches less far beyond the bars cuts off their core's blur, not only a halo.
LEAST_CUT_PX = 5.0
# Share of the MTF that the digitiser's steps may move without a flag: more is beyond their first order.
COARSE = 0.1
# The fitted window reaches so far beyond the bars, px and periods.
FITTED_PX, FITTED_PERIODS = 20.0, 1.5


@dataclass(frozen=True, kw_only=True)
class Found:
    """A target measured.

    Parameters
    ----------
    target
        Where it lies.
    posterior, mtf
        Draws, and the MTF of each.
    flags, notes
        What to distrust, and what to know.
    margin_px
        How far the window reaches beyond the bars.
    """

    target: BarTarget
    posterior: Posterior
    mtf: Array
    flags: tuple[str, ...]
    notes: tuple[str, ...]
    margin_px: float


def found_in(used: FrameStack, bars: int, frequency: float, context: Context) -> Found | str:
    """Find and measure the target; a sentence where there is none."""
    mean = used.data.mean(axis=0, dtype=np.float64)
    if max(mean.shape) < bars / frequency:
        size = f"{mean.shape[0]} x {mean.shape[1]} px"
        return f"no target: {bars} bars at {frequency:g} cy/px need a larger region than {size}"
    if runs_through(mean, bars=bars, frequency=frequency):
        target = strip_of(mean, bars=bars, frequency=frequency, pitch_ratio=context.pitch_ratio)
        if target is not None:
            return _strip(used, mean, target, context)
    target = find(mean, bars=bars, frequency=frequency, pitch_ratio=context.pitch_ratio)
    if target is None:
        return f"no target: nothing in the region answers to {bars} bars at {frequency:g} cy/px"
    return _whole(used, mean, target, context)


def _strip(used: FrameStack, mean: Array, target: BarTarget, context: Context) -> Found | str:
    """Measure bars that run through the region."""
    turned = abs(np.sin(target.angle_rad)) > np.sqrt(0.5)
    problem = Problem(
        image=mean,
        window=np.ones(mean.shape, bool),
        variance=np.full(mean.size, float(mean.var()) or 1.0),
        asked=target.frequency,
        length_px=mean.shape[1] if turned else mean.shape[0] * target.pitch_ratio,
        strip=True,
    )
    why = not_identifiable(target, problem.length_px)
    if why is not None:
        return why
    fit, problem = measured(used.data, problem, target, inflation=frame_correlation(used.data, problem.window))
    if not light_in_standard_errors(fit) > LEAST_LIGHT:
        return f"no target: the light of the bars is under {LEAST_LIGHT:g} standard errors"
    margin = _reach_px(fit.target, mean.shape)
    if not _lies_there(fit):
        return _another(target, problem.asked)
    flags = flags_of_fit(fit)
    if margin < LEAST_CUT_PX:
        flags.append("window-too-small")
    return _of_fit(used, fit, problem, context, flags, margin)


def _faint(standard_errors: float) -> str:
    return (
        f"no target: the fundamental stands {standard_errors:.1f} standard errors out of the noise, "
        f"fewer than {LEAST_SIGNAL:g}"
    )


def _another(target: BarTarget, asked: float) -> str:
    return f"no target: the object's spectrum is not that of {target.bars} bars at {asked:g} cy/px"


def _lies_there(fit: Fit) -> bool:
    """Tell whether the fitted bars are bright, and lie in the region with their middle and with pixels of theirs."""
    (rows, cols), here = fit.window.shape, fit.target
    return fit["level_dn"] > 0 and 0 <= here.row < rows and 0 <= here.col < cols and bool(_lit(fit).any())


def _lit(fit: Fit) -> Mask:
    """Return the fitted pixels that the bars light, shape (pixel,)."""
    return fit.model_dn - fit["pedestal_dn"] > 0.02 * fit["level_dn"]


def _reach_px(target: BarTarget, shape: tuple[int, ...]) -> float:
    """Return how far a region reaches beyond bars that run through it, on the nearer side."""
    across, _ = target.coordinates((shape[0], shape[1]))
    return float(min(-across.min(), across.max()) - target.width_px / 2.0)


def _of_fit(used: FrameStack, fit: Fit, problem: Problem, context: Context, flags: list[str], margin: float) -> Found:
    """Draw the posterior of a fitted picture."""
    posterior = of_fit(fit, problem, context)
    asked, own = problem.asked, fit.target.frequency
    notes = [f"Normalised to the light within {margin:.0f} px of the bars."]
    if abs(own / asked - 1.0) > TOLD_FREQUENCY and abs(np.log(own / asked)) > 3.0 * fit.sd("log_frequency"):
        notes.append(f"The bars repeat at {own:.4g} cy/px, told is the MTF at {asked:.4g}.")
    notes.append("Bars taken to be half a period wide: of bars 1 % of that wider the MTF is told 1 % too low.")
    if context.sensor is None:
        notes.append("Pixels taken as square.")
    other = other_number(fit, problem)
    if other is not None:
        flags = [*flags, "model-misfit"]
        notes.append(f"The picture is rather that of {other} bars than of {fit.target.bars}.")
    if rounding_sd(fit) > COARSE:
        flags = [*flags, "quantised"]
    near = np.zeros(problem.window.shape, bool)
    near[problem.window] = _lit(fit)
    # White is cut off where there is light, black mostly where there is none.
    codes = [*flags_of_codes(used, near, context), *flags_of_codes(used, problem.window, context)]
    response = response_of(used, fit)
    return Found(
        target=replace(fit.target, frequency=asked),
        posterior=posterior,
        mtf=straightened(mtf_of(posterior, fit, context), response, context.seed),
        flags=(*flags, *response_flags(response), *dict.fromkeys(codes)),
        notes=(*notes, *response_notes(response)),
        margin_px=margin,
    )


def _whole(used: FrameStack, mean: Array, target: BarTarget, context: Context) -> Found | str:
    """Measure a target that lies whole in the region."""
    asked = target.frequency
    margin, cut = fitting_margin(target, (mean.shape[0], mean.shape[1]), margin_px(context, asked))
    window = target.box(mean.shape, margin)
    if np.count_nonzero(~window) < 50:
        return "no target: the region ends at the bars, and their pedestal cannot be told"
    ground = ground_of(mean, target, margin)
    memory = None if context.sensor is None else memory_of(context, len(used.data))
    amplitudes = amplitudes_of(used.data, target, window, ground.beyond, memory)
    told = asked
    if amplitudes.signal_to_noise > TELLS_FREQUENCY:
        target = replace(target, frequency=own_frequency(mean, target, margin))
        # The bars' own frequency is a measurement too: where it is the one asked for, that is where the MTF is told.
        told = asked if abs(target.frequency / asked - 1.0) < TOLD_FREQUENCY else target.frequency
        amplitudes = amplitudes_of(used.data, target, window, ground.beyond, memory)
    if context.sensor is not None:
        core = amplitudes_of(used.data, target, target.box(mean.shape, core_margin_px(asked)), ground.beyond, memory)
        if core.signal_to_noise < LEAST_SIGNAL:
            return _faint(core.signal_to_noise)
    if amplitudes.light < -LEAST_SIGNAL * np.sqrt(amplitudes.covariance[0, 0]):
        return DARK
    if not amplitudes.light > 0 or amplitudes.zeros > OTHER_OBJECT + OTHER_OBJECT_SD / amplitudes.signal_to_noise:
        return _another(target, asked)
    # Where the alias lies so near, the bars' own frequency is not known either.
    wanted = replace(target, frequency=asked)
    why = not_identifiable(wanted, wanted.length_px) or not_identifiable(target, target.length_px)
    if why is not None:
        return why
    second = second_harmonic(mean, target, window, float(mean[ground.beyond].mean()), amplitudes)
    flags = flags_of_sums(target, amplitudes, second)
    if ground.crowded:
        flags.append("several-targets")
    if cut and margin < LEAST_CUT_PX:
        flags.append("window-too-small")
    if context.sensor is not None:
        return _of_sums(used, target, amplitudes, context, flags, (asked, margin, cut))
    known = (flags, margin, amplitudes.frame_correlation)
    return _fitted(used, mean, target, ground.beyond | window, context, told, known)


def _fitted(
    used: FrameStack,
    mean: Array,
    target: BarTarget,
    clear: Mask,
    context: Context,
    asked: float,
    known: tuple[list[str], float, float],
) -> Found | str:
    """Fit the picture of a whole target to the pixels around it that hold no other light."""
    flags, margin, inflation = known
    window = target.box(mean.shape, max(FITTED_PX, FITTED_PERIODS / target.frequency)) & clear
    problem = Problem(
        image=mean,
        window=window,
        variance=np.full(np.count_nonzero(window), float(mean[window].var()) or 1.0),
        asked=asked,
        length_px=LENGTH_OVER_WIDTH / (2.0 * target.frequency),
        strip=False,
    )
    fit, problem = measured(used.data, problem, target, inflation=inflation)
    standing = fundamental_in_standard_errors(fit)
    if standing < LEAST_SIGNAL:
        return _faint(standing)
    if not _lies_there(fit):
        return _another(target, problem.asked)
    flags = [*flags, *(flag for flag in flags_of_fit(fit) if flag != "interlace-motion")]
    return _of_fit(used, fit, problem, context, flags, margin)


def _of_sums(
    used: FrameStack,
    target: BarTarget,
    amplitudes: Amplitudes,
    context: Context,
    flags: list[str],
    window: tuple[float, float, bool],
) -> Found:
    """Draw the posterior of the sums over a whole target of a camera described."""
    asked, margin, cut = window
    posterior = of_sums(amplitudes, lost_share(context, margin), context)
    notes = []
    if abs(target.frequency / asked - 1.0) > TOLD_FREQUENCY:
        notes.append(f"The bars repeat at {target.frequency:.4g} cy/px, asked were {asked:.4g}.")
    if cut:
        notes.append(f"Normalised to the light within {margin:.0f} px of the bars.")
    if amplitudes.frame_correlation > 1.2:
        factor = np.sqrt(amplitudes.frame_correlation)
        notes.append(
            f"Light lingers from frame to frame: the error of the mean is {factor:.2f} times that of fresh frames."
        )
    return Found(
        target=target,
        posterior=posterior,
        mtf=posterior["mtf"],
        flags=(*flags, *flags_of_codes(used, target.box(used.shape[1:], 1.0), context)),
        notes=tuple(notes),
        margin_px=margin,
    )
