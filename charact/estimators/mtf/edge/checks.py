"""Checks of edges: what they find, the largest effect on the MTF, and its remedy."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from charact.estimators.mtf.curve import FINE, CurveFinding, Undo, stretched
from charact.estimators.mtf.edge.pixels.bow import bow_of, rms_of
from charact.estimators.mtf.edge.pixels.line import field_displacement, is_significant
from charact.estimators.mtf.edge.pixels.plateau_noise import noise_flags
from charact.estimators.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.estimators.mtf.edge.pixels.profile import DEFECT_SD, EdgeProfile
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.mean_frame import OrientedFrame
from charact.estimators.mtf.noise_spectrum.processed import processing_findings
from charact.estimators.mtf.sharpening import REACH_PX, noise_gain
from charact.estimators.mtf.target_motion import TargetMotion
from charact.estimators.mtf.thresholds import LIMITS
from charact.method import Context
from charact.verdict import Finding
from labdata import FLAGS, Array, Measurement


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


class EdgeFinding(CurveFinding):
    """A finding of an edge, before it is one of a quantity."""

    def finding_of(self, measurement: Measurement, modulus: Array) -> Finding:
        """Return the finding of MTF50, MTF10 or an MTF; `modulus`: the MTF at `FINE`."""
        return self.of_number(measurement, FINE, modulus, REMEDIES[self.flag])


def scaled(factor: float) -> Undo:
    """Return what makes an MTF one normalised to more or less light by a factor."""
    return lambda frequency, modulus: np.where(frequency > 1e-3, modulus * factor, modulus)


def edge_findings(
    edge: PreparedEdge, half: float, context: Context, relative_sd: float, least_loss: float
) -> Iterator[EdgeFinding]:
    """Yield the findings of an edge by every method.

    Parameters
    ----------
    half
        MTF50, cy/px; NaN: unknown.
    relative_sd
        Relative standard uncertainty of MTF50.
    least_loss
        Relative loss of MTF50 by motion from which on the noise on the slopes is no test.
    """
    picture, profile = edge.picture, edge.profile
    if edge.picture.stack.is_clipped():
        yield EdgeFinding(flag="clipped", effect=_clipping(edge))
    bend = edge.rows.line.bend
    travel_px = abs(edge.rows.line.slope) * picture.value.shape[0]
    travel_px += 0.0 if bend is None else float(np.ptp(bend))
    if travel_px < THRESHOLDS.min_travel_px:
        effect = (
            f"the edge crosses {travel_px:.1f} pixels along its length: gaps between them are not "
            f"sampled"
        )
        yield EdgeFinding(flag="tilt-too-small", effect=effect)
    rough, bow_px = edge.roughness, rms_of(bow_of(edge.rows.offset))
    if rough.moves or bow_px > 0.0:
        shape = "its line" if bend is not None else "a straight line"
        rms_px = max(rough.rms_px if rough.moves else 0.0, bow_px)
        yield curved_finding(f"the edge deviates from {shape} by", rms_px, "beyond the noise")
    elif bend is not None:
        bend_px = float(np.std(bend))
        effect = f"the edge bends by {bend_px:.2g} px rms and its line follows, to"
        yield curved_finding(effect, THRESHOLDS.followed_bend * bend_px, "")
    if is_significant(displacement_of_fields(edge)):
        yield plain("interlace-motion")
    if profile.defects:
        yield _defects(profile, relative_sd)
    # Neither noise that grows with the light nor an unknown black level contradicts a line.
    if (
        len(picture.stack.data) > 1
        or profile.black is not None
        or profile.side_variances[1] < profile.side_variances[0]
    ) and noise_flags(edge.noise_growth):
        yield plain("gamma")
    yield from map(plain, edge.flags)
    expected, _, areas = edge.expected
    signs = tuple(processing_findings(picture.upright_frames[0], expected, areas))
    for sign in signs if picture.stack.holds_codes else ():
        yield EdgeFinding(flag=sign.flag, effect=sign.effect, undo=sign.undo)
    gain, overshoot = noise_gain_of(picture, profile), overshoot_of(profile, half)
    if gain > 1.0 or overshoot > 0.0:
        effect = (
            f"sharpened: overshoot of {100.0 * overshoot:.1f} % of the step, and noise is "
            f"{100.0 * (gain - 1.0):.0f} % larger; MTF50 is that of the processed image and may "
            "exceed the camera's by as many percent"
        )
        yield EdgeFinding(flag="processed", effect=effect)
    motion = TargetMotion() if len(picture.stack.data) < 2 else edge.target_motion
    if motion.moves:
        effect = f"the edge moves by {motion.rms_px:.2g} px rms"
        yield EdgeFinding(flag="drift", effect=effect, undo=motion.undo, sign=-1)
    # An edge that moves far leaves more on its slopes than rows that move in one piece.
    still = not motion.moves or motion.mtf_loss(half) < least_loss
    several = len(picture.stack.data) >= LIMITS.min_smoothing_frames
    if several and still and not (gain > 1.0 or overshoot > 0.0) and edge.slope_noise.is_smoothed:
        effect = (
            f"noise on the edge is {edge.slope_noise.ratio:.1f} times that of its plateaus: noise "
            "reduction sparing edges may have sharpened or blurred this one"
        )
        yield EdgeFinding(flag="processed", effect=effect)


def curved_finding(effect: str, rms_px: float, beyond: str) -> EdgeFinding:
    """Return the finding of an edge whose rows depart from the line by a root mean square, px."""
    return EdgeFinding(
        flag="curved-edge",
        effect=f"{effect} {rms_px:.2g} px rms {beyond}".rstrip(),
        undo=TargetMotion(rms_px=rms_px).undo,
        sign=-1,
    )


def plain(flag: str) -> EdgeFinding:
    """Return the unbounded finding of a flag whose effect is the same for every edge."""
    return EdgeFinding(flag=flag, effect=PLAIN_EFFECTS[flag])


def _clipping(edge: PreparedEdge) -> str:
    data = edge.picture.stack.data
    percents = {float(end): 100.0 * float(np.mean(data == end)) for end in (data.max(), data.min())}
    # The other end of the scale has a few pixels of noise.
    ends = [
        f"{percent:.0f} % of the pixels sit at {end:g} DN"
        for end, percent in percents.items()
        if percent >= 0.5
    ]
    piles = ", ".join(ends) or "less than 1 % of the pixels sit at an end of the scale"
    return f"{piles}: the plateaus are lost, and MTF50 may be high by tens of percent"


def _defects(profile: EdgeProfile, relative_sd: float) -> EdgeFinding:
    """Return the finding of excluded pixels, as many of which may be undetected.

    An undetected one is off by at most z standard deviations of the noise. As a measurement is a
    weighted sum of n pixels, d of them at random places change it by z sqrt(d / n) of its own
    standard deviations (rms); twice that is the bound. Where more of them lie on the slope than
    chance puts there, what is excluded is the edge, and nothing is known.
    """
    gathered, noise = profile.gathered, max(profile.noise_variance(0.5) ** 0.5, 1e-12)
    in_band = (gathered.distance >= gathered.borders[0]) & (
        gathered.distance < gathered.borders[-1]
    )
    at_pixel = np.interp(gathered.distance, profile.distance, profile.value)
    level = (at_pixel - profile.dark) / (profile.step or 1.0)
    on_slope = in_band & (np.abs(level - 0.5) < 0.5 - ACCURACY.plateau_fraction)
    pixels, excluded = np.count_nonzero(in_band), np.count_nonzero(on_slope & ~gathered.valid)
    expected = profile.defects * np.count_nonzero(on_slope) / max(pixels, 1)
    largest = max(DEFECT_SD, THRESHOLDS.min_defect * abs(profile.step) / noise)
    fraction = 2.0 * largest * np.sqrt(profile.defects / max(pixels, 1)) * relative_sd
    by_chance = excluded <= expected + THRESHOLDS.misfit_sd * np.sqrt(max(expected, 1.0))
    effect = f"{profile.defects} of {pixels} pixels were excluded, and as many may be undetected"
    undo = stretched(float(fraction)) if by_chance and np.isfinite(fraction) else None
    return EdgeFinding(flag="defects", effect=effect, undo=undo)


def displacement_of_fields(edge: PreparedEdge) -> tuple[float, float]:
    """Return the displacement of the two fields, px, with its standard uncertainty."""
    profile, gathered = edge.profile, edge.profile.gathered
    valid = gathered.valid & (np.abs(gathered.distance) < ACCURACY.field_distance_px)
    means = profile.distance, profile.value
    max_sd = max(profile.side_variances) ** 0.5
    return field_displacement(edge.picture, edge.rows, valid, gathered.distance, means, max_sd)


def fit_findings(
    picture: OrientedFrame, profile: EdgeProfile, fitted: FittedProfile, half_frequency: float
) -> Iterator[EdgeFinding]:
    """Yield the findings of a fitted profile."""
    step, slopes = abs(fitted.amplitude[0]), fitted.amplitude[-2:] @ profile.gradient_ways
    if fitted.chi2 / fitted.free > THRESHOLDS.max_reduced_chi2 + THRESHOLDS.misfit_sd * np.sqrt(
        2.0 / fitted.free
    ):
        yield misfit_finding(profile, fitted)
    if np.abs(slopes).max() * 2.0 * profile.gathered.half_width_px > THRESHOLDS.max_gradient * step:
        yield gradient_finding(profile, fitted=True)
    if step < THRESHOLDS.min_step_sd * profile.noise_variance(0.5) ** 0.5:
        yield low_signal_finding(profile)
    if noise_below_quantisation(picture, profile):
        yield quantisation_finding(profile)
    if profile.gathered.half_width_px < 1.6 / half_frequency:
        yield window_finding(profile)
    # Another step on the plateaus: a tenth of the edge's over several pixels.
    residual, weight = profile.value - fitted.model, profile.count
    cell = np.floor(profile.distance / 3.0).astype(int)
    cell -= cell.min()
    pixels = np.bincount(cell, weights=weight)
    means = np.abs(np.bincount(cell, weights=weight * residual)) / np.maximum(pixels, 1e-9)
    error = np.sqrt(
        profile.correlated_noise.correlation_factor
        * profile.side_variances[1]
        / np.maximum(pixels, 1.0)
    )
    if np.any((means > 0.1 * step) & (means > THRESHOLDS.misfit_sd * error)):
        yield plain("several-targets")


def misfit_finding(profile: EdgeProfile, fitted: FittedProfile) -> EdgeFinding:
    """Return the finding of a blur model that the profile contradicts."""
    misfit = float(np.abs(profile.value - fitted.model).max()) / _step_of(profile)
    effect = f"the blur model deviates from the profile by up to {100.0 * misfit:.1f} % of the step"
    return EdgeFinding(flag="model-misfit", effect=effect)


def gradient_finding(profile: EdgeProfile, *, fitted: bool = False) -> EdgeFinding:
    """Return the finding of uneven illumination.

    A fit that allows each side a slope mistakes a fraction of what changes over a side for light of
    the edge, `gradient_leak` at most, by which it normalises the MTF wrongly; what changes by more
    than `max_fitted_gradient` of the step is no illumination that a fit can tell from the edge.
    """
    step = _step_of(profile)
    sides = [profile.value[side] for side in (profile.distance < 0, profile.distance > 0)]
    changes = max(
        float(np.ptp(levels[np.abs(levels - np.median(levels)) < 0.3 * step]))
        for levels in sides
        if levels.size
    )
    effect = (
        f"the illumination changes by {100.0 * changes / step:.0f} % of the step over a side, as "
        f"with glare"
    )
    bounded = fitted and changes < THRESHOLDS.max_fitted_gradient * step
    leak = 1.0 + THRESHOLDS.gradient_leak * changes / step
    return EdgeFinding(flag="gradient", effect=effect, undo=scaled(leak) if bounded else None)


def low_signal_finding(profile: EdgeProfile) -> EdgeFinding:
    """Return the finding of a step that hardly exceeds the noise."""
    ratio = _step_of(profile) / max(profile.noise_variance(0.5) ** 0.5, 1e-300)
    effect = (
        f"the step is {ratio:.1f} times the noise of a pixel: the limits of the interval are "
        f"uncertain"
    )
    return EdgeFinding(flag="low-signal", effect=effect)


def quantisation_finding(profile: EdgeProfile) -> EdgeFinding:
    """Return the finding of plateaus that lie anywhere between two grey values."""
    step = _step_of(profile)
    effect = f"either plateau may be off by 0.5 DN, {50.0 / step:.2g} % of the step"
    undo = stretched(THRESHOLDS.quantisation_bias_dn / step)
    return EdgeFinding(flag="quantised", effect=effect, undo=undo)


def window_finding(profile: EdgeProfile) -> EdgeFinding:
    """Return the finding of a region that may hold less than the blur."""
    effect = (
        f"light farther than {profile.gathered.half_width_px:.0f} px from the edge is not "
        "included: MTF50 is too high by its fraction"
    )
    return EdgeFinding(flag="window-too-small", effect=effect)


def _step_of(profile: EdgeProfile) -> float:
    return max(abs(profile.step), 1e-300)


def noise_below_quantisation(picture: OrientedFrame, profile: EdgeProfile) -> bool:
    """Return whether the noise of one frame is too small to dither the quantisation."""
    return (
        picture.stack.holds_codes
        and profile.noise_variance(0.5) ** 0.5 * np.sqrt(len(picture.stack.data))
        < THRESHOLDS.quantisation_noise_dn
    )


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
    """Return the factor by which sharpening raised the noise of the plateaus.

    Each of the n pixels of a bin contributes 1/n of its mean, which is corrected for.
    """
    gathered = profile.gathered
    at_pixel = np.interp(gathered.distance, profile.distance, profile.value)
    level = (at_pixel - profile.dark) / (profile.step or 1.0)
    on_plateau = gathered.valid & (
        np.minimum(np.abs(level), np.abs(level - 1.0)) < ACCURACY.sharpening_plateau
    )
    sd = np.sqrt(np.maximum(profile.noise_variance(level), profile.variance_floor))
    absorbed = 2.0 * REACH_PX * float(np.mean(1.0 / profile.count))
    return noise_gain((picture.value - at_pixel) / sd, on_plateau, absorbed)


CHAIN = "the interval is the Laplace approximation and may be a third too narrow"
PLAIN_EFFECTS: dict[str, str] = {
    "interlace-motion": "the two fields of the frame are displaced, which blurs their mean",
    "several-targets": "light of another step is attributed to this edge",
    "several-modes": (
        "two values fit the edge about equally well: the interval has both, its "
        "median may be neither"
    ),
    "gamma": "noise that grows unlike the light speaks of a nonlinear camera response",
    "prior-bound": CHAIN,
    "not-converged": CHAIN,
}
REMEDIES: dict[str, str] = {
    "clipped": "light, exposure and black level at which no pixel reaches an end of the scale",
    "gamma": "linear frames (raw, without a gamma); noise of light in them shows that they are",
    "model-misfit": "a `roi` without other structure, or `method` auto instead of a blur model",
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
