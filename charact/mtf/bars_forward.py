"""The forward method for bar targets: the exact spectrum of N finite bars, fitted to the pixels."""

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.bar_amplitudes import Amplitudes, amplitudes_of, frame_correlation
from charact.mtf.bar_light import ground_of, second_harmonic
from charact.mtf.bar_target import LENGTH_OVER_WIDTH, BarTarget, find, own_frequency
from charact.mtf.bar_window import fitting_margin, lost_share, margin_px
from charact.mtf.bars_checks import (
    LEAST_FUNDAMENTAL_SD,
    flags_of_codes,
    flags_of_fit,
    flags_of_sums,
    light_in_standard_errors,
    not_identifiable,
)
from charact.mtf.bars_fit import Fit, measured
from charact.mtf.bars_number import other_number
from charact.mtf.bars_picture import Problem
from charact.mtf.bars_place import runs_through, strip_of
from charact.mtf.bars_posterior import mtf_of, of_fit, of_sums
from charact.mtf.bars_profile import profile
from charact.mtf.region import Region
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Provenance, Result, from_draws, refused

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

METHOD = "bars-forward"
# A fundamental this many standard errors high over a whole target is bars; noise alone has up to about five.
LEAST_SIGNAL = 5.0
# The light of bars that run through a region, in its own standard errors.
LEAST_LIGHT = 9.0
# The zeros beside the fundamental, over it: more than this is another object.
OTHER_OBJECT = 0.5
# Significance from which the zeros tell the bars' own frequency better than whoever asked, and a change worth telling.
TELLS_FREQUENCY, TOLD_FREQUENCY = 30.0, 0.01
# A window that reaches less far beyond the bars cuts off their core's blur, not only a halo.
LEAST_CUT_PX = 5.0
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


@register(
    "bars",
    METHOD,
    quantities=("mtf",),
    preferred=True,
    scope=(
        "Two to forty bars on an even ground in any direction, whole with their blur inside the region and about seven "
        "times as long as wide, or running through it within 12 degrees of an axis; fundamental over 5 standard "
        "errors. A camera that is not described is taken to have a transfer near exp(-(f/fc)^n) and no halo. Broken by "
        "clipping, motion between fields (not told of bars along rows) and a curved response: an exponent within 0.9 "
        "to 1.1 changes the MTF by up to 8 % and shows only where the fundamental stands over 300 standard errors. "
        "Untilted bars near the sampling limit are refused; one bar more or fewer than asked for is told where each "
        "can be seen."
    ),
)
def bars_forward(
    stack: FrameStack, *, region: Region | None = None, bars: int, frequency_cy_per_px: float, context: Context
) -> Result:
    """Measure the MTF at the frequency of a bar target.

    Parameters
    ----------
    stack
        Frames of one target.
    region
        ROW, COL, HEIGHT, WIDTH that holds the whole target and its blur, or a strip across all bars; None: the whole
        frame.
    bars
        Number of bars.
    frequency_cy_per_px
        Their frequency, cycles per column pitch across them.
    context
        Seed, whether a Markov chain is wanted, and the camera.

    Returns
    -------
    Result
        `mtf` at the fundamental, and the profile across the bars as evidence.

    Notes
    -----
    The spectrum of N bars of width w = 1/(2 f) and pitch P is O(v) = w sinc(v w) sin(pi N v P) / sin(pi v P); at their
    own frequency it is (2/pi) O(0), so that MTF(f) = (pi/2) |I(f)| / I(0), I the spectrum of the image over its
    pedestal. The picture O times a transfer of the form exp(-(f/fc)^n), free to depart from it at f, and the pixel is
    fitted to the pixels as they are sampled. Of a camera described, whose halo is wide and known, whole targets are
    summed instead; what its tails carry beyond the window is a parameter with a prior from the camera's ranges.
    """
    began = time.perf_counter()
    used = stack if region is None else stack.region(*region)
    where = region or (0, 0, *used.shape[1:])
    found = _found(used, int(bars), float(frequency_cy_per_px), context)
    if isinstance(found, str):
        return _nothing(found, where, float(frequency_cy_per_px), context, began)
    # The share lost beyond the window and the exponent of a family lean on their bounds without harm.
    flags = (*found.flags, *(flag for flag in found.posterior.flags if flag != "prior-bound"))
    if np.quantile(found.mtf, 0.025) > 1.0:
        flags = (*flags, "model-misfit")
    if found.mtf.mean() < LEAST_FUNDAMENTAL_SD * found.mtf.std():
        flags = (*flags, "low-signal")
    measurement = from_draws(
        "mtf",
        "1",
        found.mtf,
        method=METHOD,
        flags=flags,
        notes=found.notes,
        region=where,
        frequency_cy_per_px=found.target.frequency,
        orientation_deg=float(np.rad2deg(found.target.angle_rad)) % 180.0,
        posterior=found.posterior,
        provenance=Provenance(
            version=charact.__version__,
            seed=context.seed,
            settings={"quick": context.quick, "bars": bars, "margin_px": found.margin_px},
        ),
        seconds=time.perf_counter() - began,
    )
    return Result(measurements=(measurement,), evidence={"bars": profile(used, found.target, measurement.value or 0.0)})


def _found(used: FrameStack, bars: int, frequency: float, context: Context) -> Found | str:
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


def _another(target: BarTarget, asked: float) -> str:
    return f"no target: the object's spectrum is not that of {target.bars} bars at {asked:g} cy/px"


def _lies_there(fit: Fit) -> bool:
    """Tell whether the fitted bars are bright and their middle lies in the region."""
    (rows, cols), here = fit.window.shape, fit.target
    return fit["level_dn"] > 0 and 0 <= here.row < rows and 0 <= here.col < cols


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
    if context.sensor is None:
        notes.append("Pixels taken as square.")
    other = other_number(fit, problem)
    if other is not None:
        flags = [*flags, "model-misfit"]
        notes.append(f"The picture is rather that of {other} bars than of {fit.target.bars}.")
    height = fit.model_dn - fit["pedestal_dn"] > 0.02 * fit["level_dn"]
    near = np.zeros(problem.window.shape, bool)
    near[problem.window] = height
    return Found(
        target=replace(fit.target, frequency=asked),
        posterior=posterior,
        mtf=mtf_of(posterior, fit),
        flags=(*flags, *flags_of_codes(used, near, context)),
        notes=tuple(notes),
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
    amplitudes = amplitudes_of(used.data, target, window, ground.beyond)
    if amplitudes.signal_to_noise > TELLS_FREQUENCY:
        target = replace(target, frequency=own_frequency(mean, target, margin))
        amplitudes = amplitudes_of(used.data, target, window, ground.beyond)
    if not amplitudes.light > 0 or amplitudes.signal_to_noise < LEAST_SIGNAL:
        return (
            f"no target: the fundamental stands {amplitudes.signal_to_noise:.1f} standard errors out of the noise, "
            f"fewer than {LEAST_SIGNAL:g}"
        )
    if amplitudes.zeros > OTHER_OBJECT:
        return _another(target, asked)
    why = not_identifiable(target, target.length_px)
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
    return _fitted(used, mean, target, ground.beyond | window, context, (flags, margin, amplitudes.frame_correlation))


def _fitted(
    used: FrameStack,
    mean: Array,
    target: BarTarget,
    clear: Mask,
    context: Context,
    known: tuple[list[str], float, float],
) -> Found | str:
    """Fit the picture of a whole target to the pixels around it that hold no other light."""
    flags, margin, inflation = known
    window = target.box(mean.shape, max(FITTED_PX, FITTED_PERIODS / target.frequency)) & clear
    problem = Problem(
        image=mean,
        window=window,
        variance=np.full(np.count_nonzero(window), float(mean[window].var()) or 1.0),
        asked=target.frequency,
        length_px=LENGTH_OVER_WIDTH / (2.0 * target.frequency),
        strip=False,
    )
    fit, problem = measured(used.data, problem, target, inflation=inflation)
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


def _nothing(reason: str, where: Region, frequency: float, context: Context, began: float) -> Result:
    provenance = Provenance(version=charact.__version__, seed=context.seed)
    flags = ("aliased",) if reason.startswith("not identifiable") else ("no-target",)
    one = refused(
        "mtf", "1", reason, method=METHOD, flags=flags, region=where, frequency_cy_per_px=frequency,
        seconds=time.perf_counter() - began, provenance=provenance,
    )  # fmt: skip
    return Result(measurements=(one,))
