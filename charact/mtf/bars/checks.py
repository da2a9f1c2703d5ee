"""What may be wrong with a bar target measured, told by the target itself."""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.bars.amplitudes import Amplitudes
from charact.mtf.bars.fit import Fit
from charact.mtf.bars.sharpened import is_sharpened
from charact.mtf.bars.target import BarTarget, core_margin_px
from charact.mtf.codes import code_flags
from labdata.frames import FrameStack

Array = NDArray[np.float64]

# The zeros beside the fundamental, over it: more is bars of another frequency.
DOUBTFUL = 0.15
# Half way to the lower zero as many bars have at least their fundamental's share of light; twice as many have none.
LEAST_FLANK = 0.6
FIELD_OFFSET_PX, UPRIGHT = 0.04, 0.5
SIGNIFICANT = 5.0
# How far a fundamental and its alias must lie apart, in widths of either: two, of whose rims a tenth does no harm.
LOBES_APART = 1.8
# Travel of the bars over the rows that averages the alias away, px.
LEAST_TRAVEL_PX = 0.8
# Second harmonic over the fundamental that bars and gaps a little unequal make, and its noise in standard errors.
STRAIGHT, STRAIGHT_SD = 0.006, 3.5
# A fit's misfit over the bars' height, and its departure from the family over that expected.
MISFIT, DEPARTED = 0.02, 3.5
# Blurs fall no steeper than a Gaussian; one wide bar looks like narrow ones under a blur that does. Nor do those of
# lenses and tubes fall so slowly as a halo makes it look.
STEEPEST, SLOWEST, BEYOND_SD = 2.2, 1.0, 1.5
# An MTF of fewer standard errors is an upper limit: of those that chance lifts over two, too many would be ok.
LEAST_FUNDAMENTAL_SD = 3.0


def flags_of_sums(target: BarTarget, amplitudes: Amplitudes, second: float) -> list[str]:
    """Return what the sums over a whole target give away: other bars, motion between fields, a curved response."""
    flags = []
    noise = SIGNIFICANT / amplitudes.signal_to_noise
    if amplitudes.zeros > DOUBTFUL + noise or amplitudes.flank < LEAST_FLANK - noise:
        flags.append("model-misfit")
    apart = abs(amplitudes.fields_apart_px)
    # Bars that lie along rows are aliased in each field alone, which looks like motion.
    upright = abs(np.sin(target.angle_rad)) < UPRIGHT
    if upright and apart > max(SIGNIFICANT * amplitudes.fields_apart_sd_px, FIELD_OFFSET_PX):
        flags.append("interlace-motion")
    if abs(second) > STRAIGHT + STRAIGHT_SD / amplitudes.signal_to_noise:
        flags.append("gamma")
    return flags


def flags_of_fit(fit: Fit) -> list[str]:
    """Return what a fitted picture gives away: another object, motion between fields, a fundamental under the noise."""
    flags = []
    least, most = fit["log_exponent"] + BEYOND_SD * fit.sd("log_exponent") * np.array([-1.0, 1.0])
    if _misfit(fit) or least > np.log(STEEPEST) or most < np.log(SLOWEST):
        flags.append("model-misfit")
    if abs(fit["departure"]) > DEPARTED / np.sqrt(fit.precision[fit.names.index("departure")]):
        flags.append("model-misfit")
    if is_sharpened(fit):
        flags.append("processed")
    if abs(np.sin(fit.target.angle_rad)) < UPRIGHT and _fields_apart(fit):
        flags.append("interlace-motion")
    return flags


def light_in_standard_errors(fit: Fit) -> float:
    """Return the bars' light over its standard error, their shape and place taken as known: are there any?"""
    slope = fit.slope[[fit.names.index("level_dn"), fit.names.index("pedestal_dn")]]
    weighed = slope / fit.noise.variance
    estimator = np.asarray(np.linalg.solve(weighed @ slope.T, weighed), dtype=np.float64)
    return fit["level_dn"] / float(np.sqrt(fit.noise.spread(estimator, fit.window)[0, 0]))


def fundamental_in_standard_errors(fit: Fit) -> float:
    """Return the modulus of the fundamental over the standard error of its parts, asked of the bars' core alone."""
    target, pixels = fit.target, fit.model_dn + fit.residual_dn - fit["pedestal_dn"]
    across, _ = target.coordinates((fit.window.shape[0], fit.window.shape[1]))
    core = target.box((fit.window.shape[0], fit.window.shape[1]), core_margin_px(target.frequency))[fit.window]
    phase = 2.0 * np.pi * target.frequency * across[fit.window]
    waves = np.where(core, np.stack([np.cos(phase), np.sin(phase)]), 0.0)
    spread = fit.noise.spread(waves, fit.window)
    modulus, sd = float(np.hypot(*(waves @ pixels))), float(np.sqrt(0.5 * np.trace(spread)))
    return modulus / max(sd, 1e-12 * modulus + 1e-30)


def _misfit(fit: Fit) -> bool:
    """Return whether the mean residual across the bars is more than noise and than forms that are not quite exact.

    Residuals of single pixels may have told the noise; along the bars noise averages away and a wrong picture stays.
    """
    across, _ = fit.target.coordinates((fit.window.shape[0], fit.window.shape[1]))
    near = np.abs(across[fit.window]) < fit.target.width_px / 2.0 + 1.0 / fit.target.frequency
    place = np.floor(across[fit.window][near]).astype(np.intp)
    place = place - place.min()
    count = np.bincount(place)
    shared = float(np.abs(fit.noise.correlation).sum()) * fit.noise.inflation
    mean = np.bincount(place, fit.residual_dn[near])[count > 0] / count[count > 0]
    expected = np.bincount(place, fit.noise.variance[near])[count > 0] * shared / count[count > 0] ** 2
    noise = SIGNIFICANT * np.sqrt(2.0 * float(np.sum(expected**2))) / mean.size
    return float(np.mean(mean**2 - expected)) > (MISFIT * fit["level_dn"]) ** 2 + noise


def _fields_apart(fit: Fit) -> bool:
    """Return whether odd rows lie elsewhere than even ones across the bars, beyond the noise."""
    odd = 1.0 - 2.0 * (np.nonzero(fit.window)[0] % 2)
    slope = fit.slope[fit.names.index("across_px")] * odd
    weight = 1.0 / float(slope @ slope)
    apart = 2.0 * weight * float(slope @ fit.residual_dn)
    sd = 2.0 * np.sqrt(weight * np.mean(fit.residual_dn**2))
    return abs(apart) > max(SIGNIFICANT * sd, FIELD_OFFSET_PX)


def flags_of_codes(used: FrameStack, window: NDArray[np.bool_], context: Context) -> tuple[str, ...]:
    """Return `clipped` where the pixels of a target pile up."""
    return code_flags(used.data[:, window], context.full_scale_dn or used.full_scale_dn)


def not_identifiable(target: BarTarget, length_px: float) -> str | None:
    """Return why the fundamental cannot be told from its alias; None where it can.

    Notes
    -----
    The alias of a component g along a grid axis lies at 1 - g. The spectrum of N bars is f/N wide on either side, so
    that the two run into each other where 1 - 2 g < 2 f/N, unless the bars travel through the pixel's phases.
    """
    cosine, sine = abs(np.cos(target.angle_rad)), abs(np.sin(target.angle_rad))
    ratio = target.pitch_ratio
    cases = [
        (target.frequency * cosine, length_px * sine),
        (target.frequency * sine * ratio, length_px * cosine / ratio),
    ]
    for sampled, travel in cases:
        if 1.0 - 2.0 * sampled < LOBES_APART * target.frequency / target.bars and travel < LEAST_TRAVEL_PX:
            return (
                f"not identifiable: {sampled:.3g} cycles per sample have their alias at {1.0 - sampled:.3g}, and the "
                f"bars travel only {travel:.2g} px over their length; tilt them by a few degrees"
            )
    return None
