"""Findings of bar targets: flag, effect on the MTF, remedy."""

from collections.abc import Iterable
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.bars.amplitudes import Amplitudes
from charact.mtf.bars.bias import rounding_sd
from charact.mtf.bars.fit import BarFit
from charact.mtf.bars.target import BarTarget
from charact.mtf.bars.thresholds import COARSE, FREQUENCY_TOLERANCE, OTHER_FRACTION, STILL_DN, STILL_FRACTION
from charact.mtf.quantisation_checks import clipping_flags
from charact.mtf.target_motion import TargetMotion
from labdata.flags import Finding
from labdata.frames import FrameStack

Mask = NDArray[np.bool_]

REGION = "--roi around this group alone, with one period of its ground on every side"
POSTERIOR_FINDINGS = {
    "not-converged": ("the interval comes from the curvature and may be a third too narrow", "another --seed"),
    "several-modes": ("the draws have two peaks as far apart as the interval is wide", "--bars and --frequency"),
    "model-misfit": (
        "the full posterior lies over two standard deviations beside the fit: the MTF may be off by as much",
        "--sensor, whose halo is then known; or --quick, the fit alone",
    ),
}


def misfit_finding(effect: str, remedy: str = REGION) -> Finding:
    """Return the finding that the image differs from the model."""
    return Finding(flag="model-misfit", effect=effect, remedy=remedy)


def margin_findings(margin_px: float, least_px: float) -> list[Finding]:
    """Return a finding where the region cuts off part of the core's blur."""
    if margin_px >= least_px:
        return []
    effect = f"light further than {margin_px:.0f} px from the bars is not counted: the MTF is too high by its share"
    return [Finding(flag="window-too-small", effect=effect, remedy="a larger --roi")]


def crowding_findings(crowded: bool) -> list[Finding]:
    """Return a finding where other light reaches into the window."""
    if not crowded:
        return []
    effect = (
        f"other light, over {100 * OTHER_FRACTION:.0f} % of the bars' height, lies near: the MTF may be off by as much"
    )
    return [Finding(flag="several-targets", effect=effect, remedy=REGION)]


def bar_count_findings(other: int | None, asked: int) -> list[Finding]:
    """Return a finding where the data favour another number of bars."""
    if other is None:
        return []
    effect = f"the picture is rather that of {other} bars than of {asked}: the light of a bar is that of another number"
    return [misfit_finding(effect, f"--bars {other}")]


def rounding_findings(fit: BarFit) -> list[Finding]:
    """Return a finding where quantisation changes the MTF beyond first order."""
    moved = rounding_sd(fit)
    if moved <= COARSE:
        return []
    effect = f"the steps of whole codes may move the MTF by {100 * moved:.0f} %"
    return [Finding(flag="quantised", effect=effect, remedy="more gain or light, so that noise spans a code")]


def clipping_findings(
    used: FrameStack, windows: Iterable[Mask], context: Context, fit: BarFit | None = None
) -> list[Finding]:
    """Return a finding where pixels of a window are clipped.

    If the frames have hardly any noise, a flat plateau proves clipping only at a stated full scale.
    """
    full_scale_dn = context.full_scale_dn or used.full_scale_dn
    if fit is not None and _is_noise_hidden(used, fit) and (full_scale_dn is None or used.data.max() < full_scale_dn):
        return []
    if not any(chain.from_iterable(clipping_flags(used.data[:, one], full_scale_dn) for one in windows)):
        return []
    effect = "levels beyond the scale are lost: the MTF may be off by the share of the bars' height that is cut off"
    return [Finding(flag="clipped", effect=effect, remedy="less light or gain, or a higher black level")]


def _is_noise_hidden(used: FrameStack, fit: BarFit) -> bool:
    """Return whether a frame's noise is below the quantisation step, or below the error of the image's table."""
    sd = float(np.sqrt(np.median(fit.noise.variance) * len(used.data)))
    return sd < (STILL_DN if used.data.dtype.kind in "ui" else STILL_FRACTION * abs(fit["level_dn"]))


def motion_finding(wander: TargetMotion, frequency: float) -> Finding:
    """Return the finding that the bars move between frames."""
    effect = f"the bars move by {wander.rms_px:.2g} px rms: the MTF is {100 * wander.mtf_loss(frequency):.2g} % too low"
    return Finding(flag="drift", effect=effect, remedy="one frame alone, or frames in which the target stands still")


def faintness_finding(mtf: float, sd: float) -> Finding:
    """Return the finding that the MTF is close to its uncertainty."""
    effect = f"the MTF is {mtf / max(sd, 1e-30):.1f} standard errors: an upper limit"
    return Finding(flag="low-signal", effect=effect, remedy="more frames or more light")


def posterior_findings(flags: Iterable[str]) -> list[Finding]:
    """Return the findings from the flags of a posterior; an exponent at its bound is harmless."""
    return [
        Finding(flag=flag, effect=POSTERIOR_FINDINGS[flag][0], remedy=POSTERIOR_FINDINGS[flag][1])
        for flag in flags
        if flag in POSTERIOR_FINDINGS
    ]


def sum_notes(target: BarTarget, wanted: BarTarget, amplitudes: Amplitudes, *, stated: bool) -> tuple[str, ...]:
    """Return notes on sums over a target: measured frequency and image lag."""
    notes = []
    if stated and abs(target.frequency / wanted.frequency - 1.0) > FREQUENCY_TOLERANCE:
        notes.append(f"The bars repeat at {target.frequency:.4g} cy/px, asked were {wanted.frequency:.4g}.")
    if amplitudes.frame_correlation > 1.2:
        factor = np.sqrt(amplitudes.frame_correlation)
        notes.append(
            f"Light lingers from frame to frame: the error of the mean is {factor:.2f} times that of fresh frames."
        )
    return tuple(notes)
