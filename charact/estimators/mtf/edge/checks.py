"""Checks of edges: flags, the size of their effect on MTF50, and their remedies."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.nonlinearity import (
    NO_CURVATURE_ESTIMATE,
    CurvatureEstimate,
    max_bias_of,
)
from charact.estimators.mtf.edge.pixels.line import field_displacement, is_significant
from charact.estimators.mtf.edge.pixels.plateau_noise import noise_flags
from charact.estimators.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.estimators.mtf.edge.pixels.profile import EdgeProfile
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.mean_frame import OrientedFrame
from charact.estimators.mtf.target_motion import TargetMotion
from charact.estimators.mtf.thresholds import LIMITS
from charact.frames.robust import median
from charact.frames.stack import Stack
from charact.method import Context
from charact.verdict import Finding
from labdata.flags import FLAGS

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FittedProfile:
    """A profile as a method fitted it.

    Parameters
    ----------
    model
        The best profile at the bins, DN.
    amplitude
        Step, level and both components of the illumination gradient, DN and DN per px.
    chi2, free
        Chi squared and its degrees of freedom.
    """

    model: Array
    amplitude: Array
    chi2: float
    free: int


def edge_flags(
    edge: PreparedEdge, half: float, context: Context, least_loss: float
) -> Iterator[str]:
    """Yield the flags that every method gives an edge.

    Parameters
    ----------
    half
        MTF50, cy/px; NaN: unknown.
    least_loss
        Relative loss of MTF50 by motion or roughness from which on it is flagged; infinite: none
        is.
    """
    picture, profile = edge.picture, edge.profile
    if Stack.of(edge.frames, context).is_clipped():
        yield "clipped"
    if abs(edge.rows.line.slope) * picture.value.shape[0] < THRESHOLDS.min_travel_px:
        yield "tilt-too-small"
    if _has_bow(edge.rows.offset):
        yield "curved-edge"
    if is_significant(displacement_of_fields(edge)):
        yield "interlace-motion"
    if profile.defects:
        yield "defects"
    noise = profile.noise
    # Neither noise that grows with the light nor an unknown black level contradicts a line.
    if (
        picture.frames > 1
        or profile.black is not None
        or noise.bright_variance < noise.dark_variance
    ):
        yield from noise_flags(edge.noise_growth)
    yield from edge.flags
    processed = noise_gain_of(picture, profile) > 1.0 or overshoot_of(profile, half) > 0.0
    if processed:
        yield "processed"
    still = picture.frames < 2
    moves, rough = (
        motion.moves and np.isfinite(least_loss) and not motion.mtf_loss(half) < least_loss
        for motion in (TargetMotion() if still else edge.target_motion, edge.roughness)
    )
    if moves:
        yield "drift"
    if rough:
        yield "curved-edge"
    # An edge that moves far leaves more on its slopes than rows that move in one piece.
    several = picture.frames >= LIMITS.min_smoothing_frames
    if several and not (moves or processed) and edge.slope_noise.is_smoothed:
        yield "processed"


def displacement_of_fields(edge: PreparedEdge) -> tuple[float, float]:
    """Return the displacement of the two fields, px, with its standard uncertainty."""
    profile, gathered = edge.profile, edge.profile.gathered
    valid = gathered.valid & (np.abs(gathered.distance) < ACCURACY.field_distance_px)
    means = profile.distance, profile.value
    return field_displacement(
        edge.picture, edge.rows, valid, gathered.distance, means, profile.noise.max_sd
    )


def _has_bow(offset: Array) -> bool:
    """Return whether the rows' displacements follow a bow or a wave.

    The scatter of block means is estimated from rows, with the correlation of neighbouring rows
    (Geyer's initial positive sequence, Stat. Sci. 7, 473, 1992), and from differences of
    neighbouring blocks; the largest counts.
    """
    finite = np.isfinite(offset)
    if np.count_nonzero(finite) < 24:
        return False
    rows, value = np.flatnonzero(finite), offset[finite]
    # The polynomials span exactly the valid rows: beyond them they would grow.
    design = np.polynomial.legendre.legvander(
        2.0 * (rows - rows[0]) / (rows[-1] - rows[0]) - 1.0, 3
    )
    begin = np.arange(ACCURACY.bow_blocks) * value.size // ACCURACY.bow_blocks
    size = np.diff(begin, append=value.size)
    means = np.add.reduceat(value, begin) / size
    row_variance = np.mean((np.add.reduceat(value**2, begin) / size - means**2) / (size - 1.0))
    differences = 0.5 * median(np.diff(means) ** 2) / 0.455
    coefficients = np.linalg.lstsq(design, value, rcond=None)[0]
    residual = value - design @ coefficients
    shared = np.array(
        [
            float(np.mean(residual[:-lag] * residual[lag:]))
            for lag in range(1, ACCURACY.bow_lags + 1)
        ]
    )
    correlated = float(np.mean(residual**2)) + 2.0 * float(
        np.sum(shared[np.cumprod(shared > 0.0).astype(bool)])
    )
    error = np.sqrt(
        max(row_variance, differences, correlated / value.size * ACCURACY.bow_blocks)
        * ACCURACY.bow_blocks
    )
    # A Legendre amplitude of evenly spread values has the variance (2 k + 1) s^2 / n.
    shape, sd = coefficients[2:], error / ACCURACY.bow_blocks * np.sqrt([5.0, 7.0])
    return bool(
        np.any((np.abs(shape) > THRESHOLDS.bow_sd * sd) & (np.abs(shape) > THRESHOLDS.bow_px / 1.5))
    )


def fit_flags(
    picture: OrientedFrame, profile: EdgeProfile, fitted: FittedProfile, half_frequency: float
) -> Iterator[str]:
    """Yield the flags of a fitted profile."""
    step, slopes = abs(fitted.amplitude[0]), fitted.amplitude[-2:] @ profile.gradient_ways
    if fitted.chi2 / fitted.free > THRESHOLDS.max_reduced_chi2 + THRESHOLDS.misfit_sd * np.sqrt(
        2.0 / fitted.free
    ):
        yield "model-misfit"
    if np.abs(slopes).max() * 2.0 * profile.gathered.half_width_px > THRESHOLDS.max_gradient * step:
        yield "gradient"
    if step < THRESHOLDS.min_step_sd * profile.noise.mean_sd:
        yield "low-signal"
    if noise_below_quantisation(picture, profile):
        yield "quantised"
    if profile.gathered.half_width_px < 1.6 / half_frequency:
        yield "window-too-small"
    # Another step on the plateaus: a tenth of the edge's over several pixels.
    residual, weight = profile.value - fitted.model, profile.count
    cell = np.floor(profile.distance / 3.0).astype(int)
    cell -= cell.min()
    pixels = np.bincount(cell, weights=weight)
    means = np.abs(np.bincount(cell, weights=weight * residual)) / np.maximum(pixels, 1e-9)
    error = np.sqrt(
        profile.noise.covariance_over_variance
        * profile.noise.bright_variance
        / np.maximum(pixels, 1.0)
    )
    if np.any((means > 0.1 * step) & (means > THRESHOLDS.misfit_sd * error)):
        yield "several-targets"


def noise_below_quantisation(picture: OrientedFrame, profile: EdgeProfile) -> bool:
    """Return whether the noise of one frame is too small to dither the quantisation."""
    return (
        picture.whole_codes
        and profile.noise.mean_sd * np.sqrt(picture.frames) < THRESHOLDS.quantisation_noise_dn
    )


# Lags over which sharpening makes neighbours anticorrelated, px: half of them, as opposite ones are
# equal.
REACH_PX = 2
NEIGHBOURS = [
    (down, right)
    for down in range(REACH_PX + 1)
    for right in range(-REACH_PX, REACH_PX + 1)
    if down > 0 or right > 0
]


def overshoot_of(profile: EdgeProfile, half_frequency: float) -> float:
    """Return the overshoot of both plateaus together, fraction of the step; 0: none, or MTF50
    is unknown.

    Notes
    -----
    Overshoot = sum over both sides of max(w'y), with the variance w'V w: y bin means, V their
    covariance, w a window near the edge less the line through the plateau, extrapolated to it. A
    PSF is not negative, so the ESF is monotonic: overshoot comes from processing. On each side the
    highest windowed mean near the edge is compared with a straight line through the plateau beyond.
    The sum of both sides counts, as an illumination gradient raises one and lowers the other.
    """
    if not half_frequency > 0:
        return 0.0
    total, variance, sd = 0.0, 0.0, np.sqrt(np.diag(profile.covariance))
    for sign in (1.0, -1.0):
        periods = sign * profile.distance * half_frequency
        plateau = (periods > ACCURACY.plateau_range[0]) & (periods < ACCURACY.plateau_range[1])
        rim = np.flatnonzero(
            (periods > ACCURACY.overshoot_range[0]) & (periods < ACCURACY.overshoot_range[1])
        )
        if np.count_nonzero(plateau) < ACCURACY.overshoot_bins or not rim.size:
            return 0.0
        line = (
            np.stack([np.ones(np.count_nonzero(plateau)), profile.distance[plateau]]) / sd[plateau]
        )
        through = np.linalg.solve(line @ line.T, line) / sd[plateau]
        weights = np.zeros((rim.size, profile.distance.size))
        for row, middle in enumerate(profile.distance[rim]):
            window = rim[np.abs(profile.distance[rim] - middle) < ACCURACY.overshoot_window_px]
            weights[row, window] = 1.0 / window.size
            weights[row, plateau] -= np.array([1.0, np.mean(profile.distance[window])]) @ through
        rises = sign * (weights @ profile.value)
        largest = weights[int(np.argmax(rises))]
        total, variance = (
            total + float(rises.max()),
            variance + float(largest @ profile.covariance @ largest),
        )
    fraction = total / max(abs(profile.step), 1e-300)
    significant = total > THRESHOLDS.overshoot_sd * np.sqrt(variance)
    return fraction if significant and fraction > THRESHOLDS.min_overshoot else 0.0


def noise_gain_of(picture: OrientedFrame, profile: EdgeProfile) -> float:
    """Return the factor by which sharpening raised the noise; 1: neighbours are not anticorrelated.

    Notes
    -----
    Gain = C^(-1/2), C = 1 + 2 sum rho over half the lags up to 2 px. Blur correlates neighbours;
    only differences between pixels make them anticorrelated. Means over many pixels are unchanged,
    so C, the sum of the noise's correlation, falls below 1 and the noise rises. Each of the n
    pixels of a bin contributes 1/n of its mean, which is corrected for.
    """
    gathered, clip_sd = profile.gathered, ACCURACY.sharpening_clip_sd
    at_pixel = np.interp(gathered.distance, profile.distance, profile.value)
    level = (at_pixel - profile.dark) / (profile.step or 1.0)
    on_plateau = gathered.valid & (
        np.minimum(np.abs(level), np.abs(level - 1.0)) < ACCURACY.sharpening_plateau
    )
    pixels = int(np.count_nonzero(on_plateau))
    if pixels < ACCURACY.sharpening_pixels:
        return 1.0
    sd = np.sqrt(np.maximum(profile.noise.variance(level), profile.variance_floor))
    noise = np.where(on_plateau, np.clip((picture.value - at_pixel) / sd, -clip_sd, clip_sd), 0.0)
    # A variance below 1 is the residual of the bins, not noise.
    variance, total = max(float(np.sum(noise**2)) / pixels, 1.0), 0.0
    rows, cols = noise.shape
    for down, right in NEIGHBOURS:
        first = slice(0, rows - down), slice(max(-right, 0), cols - max(right, 0))
        second = slice(down, rows), slice(max(right, 0), cols - max(-right, 0))
        pairs = max(int(np.count_nonzero(on_plateau[first] & on_plateau[second])), 1)
        total += 2.0 * float(np.sum(noise[first] * noise[second])) / pairs / variance
    opposed = -(total + 2.0 * REACH_PX * float(np.mean(1.0 / profile.count)))
    error = 2.0 * np.sqrt(len(NEIGHBOURS) / pixels)
    if opposed > max(THRESHOLDS.min_anticorrelation, THRESHOLDS.anticorrelation_sd * error):
        return float(max(1.0 - opposed, 0.05) ** -0.5)
    return 1.0


def findings_of(
    flags: Iterable[str],
    edge: PreparedEdge,
    half: float,
    response: CurvatureEstimate = NO_CURVATURE_ESTIMATE,
    misfit: float = 0.0,
) -> list[Finding]:
    """Return the effect and the remedy of each flag that has one.

    Parameters
    ----------
    half
        MTF50, cy/px; NaN: not known.
    response
        Curvature of the camera response with its standard uncertainty.
    misfit
        Largest residual of the profile, fraction of the step.
    """
    return [
        Finding(
            flag=flag, effect=_effect(flag, edge, half, response, misfit), remedy=REMEDIES[flag]
        )
        for flag in flags
        if flag in REMEDIES
    ]


def _effect(
    flag: str, edge: PreparedEdge, half: float, response: CurvatureEstimate, misfit: float
) -> str:
    """Return what a flag means for this edge."""
    profile = edge.profile
    step = max(abs(profile.step), 1e-300)
    match flag:
        case "clipped":
            data = edge.frames.data
            shares = {
                float(end): 100.0 * float(np.mean(data == end)) for end in (data.max(), data.min())
            }
            # The other end of the scale has a few pixels of noise.
            ends = [
                f"{percent:.0f} % of the pixels sit at {end:g} DN"
                for end, percent in shares.items()
                if percent >= 0.5
            ]
            piles = ", ".join(ends) or "less than 1 % of the pixels sit at an end of the scale"
            return f"{piles}: the plateaus are lost, and MTF50 may be high by tens of percent"
        case "gamma":
            bias = 100.0 * max_bias_of(response, profile.contrast)
            return f"a nonlinear camera response may bias MTF50 by up to {bias:.1f} %"
        case "model-misfit":
            return (
                f"the blur model deviates from the profile by up to {100.0 * misfit:.1f} % of "
                f"the step"
            )
        case "defects":
            pixels = int(np.count_nonzero(profile.gathered.valid))
            return (
                f"{profile.defects} of {pixels} pixels were excluded; as many undetected ones may "
                f"move MTF50 by {100.0 * profile.defects / max(pixels, 1):.2g} %"
            )
        case "gradient":
            sides = [profile.value[side] for side in (profile.distance < 0, profile.distance > 0)]
            changes = max(
                float(np.ptp(levels[np.abs(levels - np.median(levels)) < 0.3 * step]))
                for levels in sides
                if levels.size
            )
            return (
                f"the illumination changes by {100.0 * changes / step:.0f} % of the step over "
                f"a side, as with glare"
            )
        case "low-signal":
            ratio = step / max(profile.noise.mean_sd, 1e-300)
            return (
                f"the step is {ratio:.1f} times the noise of a pixel: the limits of the "
                f"interval are uncertain"
            )
        case "quantised":
            return (
                f"either plateau may be off by 0.5 DN, {50.0 / step:.2g} % of the step, and "
                f"MTF50 by about as much"
            )
        case "window-too-small":
            half_width_px = profile.gathered.half_width_px
            return (
                f"light beyond {half_width_px:.0f} px from the edge is not included: MTF50 is "
                f"high by its fraction"
            )
        case "drift":
            motion = edge.target_motion
            return (
                f"the edge moves by {motion.rms_px:.2g} px rms: MTF50 is "
                f"{100.0 * motion.mtf_loss(half):.2g} % low"
            )
        case "curved-edge":
            rough = edge.roughness
            loss = 100.0 * rough.mtf_loss(half)
            return f"an edge roughness of {rough.rms_px:.2g} px rms lowers MTF50 by {loss:.2g} %"
        case "processed":
            over = overshoot_of(profile, half)
            gain = noise_gain_of(edge.picture, profile)
            if over > 0.0 or gain > 1.0:
                return (
                    f"sharpened: overshoot of {100.0 * over:.1f} % of the step, and noise is "
                    f"{100.0 * (gain - 1.0):.0f} % larger; MTF50 is that of the processed image "
                    "and may exceed the camera's by as many percent"
                )
            return (
                f"noise on the edge is {edge.slope_noise.ratio:.1f} times that of its "
                "plateaus: noise reduction sparing edges may have sharpened or blurred this one"
            )
        case "tilt-too-small":
            travel = abs(edge.rows.line.slope) * edge.picture.value.shape[0]
            return (
                f"the edge crosses {travel:.1f} pixels along its length: gaps between them are "
                f"not sampled"
            )
    return PLAIN_EFFECTS[flag]


CHAIN = "the interval is the Laplace approximation and may be a third too narrow"
PLAIN_EFFECTS: dict[str, str] = {
    "interlace-motion": "the two fields of the frame are displaced, which blurs their mean",
    "several-targets": "light of another step is attributed to this edge",
    "several-modes": (
        "two values fit the edge about equally well: the interval has both, its "
        "median may be neither"
    ),
    "prior-bound": CHAIN,
    "not-converged": CHAIN,
}
REMEDIES: dict[str, str] = {
    "clipped": "light, exposure and black level at which no pixel reaches an end of the scale",
    "gamma": "`black_dn`, linear frames (raw, without a gamma), or `sensor` with a description",
    "model-misfit": "`method` auto or edge-free, which need no blur model",
    "defects": "`roi` on a part without them, or defect correction switched on",
    "gradient": "uniform illumination, `black_dn`, or a `roi` nearer to the edge",
    "low-signal": "more frames, more light or a longer edge",
    "quantised": "more frames with noise of 0.5 DN, or a higher bit depth",
    "window-too-small": "a larger `roi`",
    "drift": "a steadier mount, or fewer frames",
    "curved-edge": "a straight target, or a shorter `roi` along the edge",
    "processed": "frames with sharpening and noise reduction switched off (raw)",
    "interlace-motion": "a stationary target, or progressive read-out",
    "tilt-too-small": "an edge tilted by 3 to 10 degrees",
    "several-targets": "`roi` around one edge",
    "several-modes": "more frames or more light",
    "prior-bound": "more frames or more light",
    "not-converged": "another `seed`, or more frames",
}
assert REMEDIES.keys() <= FLAGS.keys()
