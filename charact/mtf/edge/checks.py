"""Checks of edges: flags, the size of their effect on MTF50, and their remedies."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.nonlinearity import CurvatureEstimate, contrast, max_bias_of
from charact.mtf.edge.pixels import fields
from charact.mtf.edge.pixels.line import RowFit
from charact.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.mean_frame import OrientedFrame
from charact.mtf.quantisation_checks import clipping_flags
from charact.mtf.target_motion import TargetMotion
from charact.robust import median
from labdata.flags import FLAGS, Finding
from labdata.measurement import Measurement

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


def picture_flags(data: NDArray, full_scale_dn: float | None) -> tuple[str, ...]:
    """Return the flags of clipping in the region."""
    return clipping_flags(data, full_scale_dn)


def line_flags(picture: OrientedFrame, rows: RowFit, profile: EdgeProfile) -> tuple[str, ...]:
    """Return the flags of tilt, bow and displaced fields."""
    flags = []
    if abs(rows.line.slope) * picture.value.shape[0] < THRESHOLDS.min_travel_px:
        flags.append("tilt-too-small")
    if _has_bow(rows.offset):
        flags.append("curved-edge")
    moved = (
        _column_field_displacement(picture, profile)
        if picture.transposed
        else fields.field_displacement_of_rows(picture, rows)
    )
    if fields.is_significant(moved):
        flags.append("interlace-motion")
    return tuple(flags)


def course_notes(roughness: TargetMotion) -> tuple[str, ...]:
    """Return the note on edge roughness."""
    if not roughness.moves:
        return ()
    return (f"Edge roughness {roughness.rms_px:.2g} px rms along the edge, beyond the noise.",)


def _column_field_displacement(picture: OrientedFrame, profile: EdgeProfile) -> fields.Displacement:
    """Return the displacement of fields whose lines run along the edge: they alternate across the columns."""
    used = profile.gathered.used & (np.abs(profile.gathered.distance) < ACCURACY.field_distance_px)
    distance = profile.gathered.distance[used]
    residual = picture.value[used] - np.interp(distance, profile.distance, profile.value)
    noise = float(np.sqrt(max(profile.grain.dark_variance, profile.grain.bright_variance)))
    slopes = fields.steepness(profile.distance, profile.value, distance)
    return fields.field_displacement_of_pixels(picture.row_index[used] % 2, residual, slopes, noise)


def _has_bow(offset: Array) -> bool:
    """Return whether the rows' displacements follow a bow or a wave.

    The scatter of block means is estimated from rows, with the correlation of neighbouring rows, and from
    differences of neighbouring blocks; the largest estimate counts.
    """
    good = np.isfinite(offset)
    if np.count_nonzero(good) < 24:
        return False
    rows, value = np.flatnonzero(good), offset[good]
    # The polynomials span exactly the valid rows: beyond them they would grow.
    place = 2.0 * (rows - rows[0]) / (rows[-1] - rows[0]) - 1.0
    design = np.polynomial.legendre.legvander(place, 3)
    begin = np.arange(ACCURACY.bow_blocks) * value.size // ACCURACY.bow_blocks
    size = np.diff(begin, append=value.size)
    means = np.add.reduceat(value, begin) / size
    within = np.mean((np.add.reduceat(value**2, begin) / size - means**2) / (size - 1.0))
    differences = 0.5 * median(np.diff(means) ** 2) / 0.455
    coefficients = np.linalg.lstsq(design, value, rcond=None)[0]
    tied = _variance_with_correlation(value - design @ coefficients) / value.size * ACCURACY.bow_blocks
    error, shape = np.sqrt(max(within, differences, tied) * ACCURACY.bow_blocks), coefficients[2:]
    # A Legendre amplitude of evenly spread values has the variance (2 k + 1) s^2 / n.
    significant = np.abs(shape) > THRESHOLDS.bow_sd * error / ACCURACY.bow_blocks * np.sqrt([5.0, 7.0])
    return bool(np.any(significant & (np.abs(shape) > THRESHOLDS.bow_px / 1.5)))


def _variance_with_correlation(left: Array) -> float:
    """Return n times the variance of the mean of n rows, correlation of neighbouring rows included.

    Summed to the first non-positive lag (Geyer's initial positive sequence, Stat. Sci. 7, 473, 1992).
    """
    shared = np.array([float(np.mean(left[:-lag] * left[lag:])) for lag in range(1, ACCURACY.bow_lags + 1)])
    return float(np.mean(left**2)) + 2.0 * float(np.sum(shared[np.cumprod(shared > 0.0).astype(bool)]))


def fit_flags(
    picture: OrientedFrame, profile: EdgeProfile, fitted: FittedProfile, half_frequency: float
) -> tuple[str, ...]:
    """Return the flags of the fitted profile."""
    flags = []
    step, slopes = abs(fitted.amplitude[0]), profile.light.by_side(fitted.amplitude)[-2:]
    noise = noise_of(profile)
    if fitted.chi2 / fitted.free > THRESHOLDS.max_reduced_chi2 + THRESHOLDS.misfit_sd * np.sqrt(2.0 / fitted.free):
        flags.append("model-misfit")
    if profile.defects:
        flags.append("defects")
    if np.abs(slopes).max() * 2.0 * profile.gathered.half_width_px > THRESHOLDS.max_gradient * step:
        flags.append("gradient")
    if step < THRESHOLDS.min_step_sd * noise:
        flags.append("low-signal")
    if noise_below_quantisation(picture, profile):
        flags.append("quantised")
    if profile.gathered.half_width_px < 1.6 / half_frequency:
        flags.append("window-too-small")
    if _other_steps(profile, fitted):
        flags.append("several-targets")
    return tuple(flags)


def noise_below_quantisation(picture: OrientedFrame, profile: EdgeProfile) -> bool:
    """Return whether the noise of one frame is too small to dither the quantisation."""
    return picture.whole_codes and noise_of(profile) * np.sqrt(picture.frames) < THRESHOLDS.quantisation_noise_dn


def noise_of(profile: EdgeProfile) -> float:
    """Return the noise of a pixel, the mean of both sides, DN."""
    return float(np.sqrt(0.5 * (profile.grain.dark_variance + profile.grain.bright_variance)))


def _other_steps(profile: EdgeProfile, fitted: FittedProfile) -> bool:
    """Return whether the plateaus contain another step: a tenth of the edge's over several pixels."""
    left = profile.value - fitted.model
    weight = profile.count
    cell = np.floor(profile.distance / 3.0).astype(int)
    cell -= cell.min()
    means = np.bincount(cell, weights=weight * left) / np.maximum(np.bincount(cell, weights=weight), 1e-9)
    error = np.sqrt(profile.grain.covariance_over_variance * profile.grain.bright_variance)
    error = error / np.sqrt(np.maximum(np.bincount(cell, weights=weight), 1.0))
    return bool(
        np.any((np.abs(means) > 0.1 * abs(fitted.amplitude[0])) & (np.abs(means) > THRESHOLDS.misfit_sd * error))
    )


# How far sharpening sets neighbours against each other, px, and the half of all lags as far that tells both.
REACH_PX = 2
NEIGHBOURS = [
    (down, right) for down in range(REACH_PX + 1) for right in range(-REACH_PX, REACH_PX + 1) if down > 0 or right > 0
]


def overshoot_of(profile: EdgeProfile, half_frequency: float) -> float:
    """Return the overshoot of both plateaus together, fraction of the step; 0: none.

    Notes
    -----
    A PSF is not negative, so the ESF is monotonic: overshoot comes from processing. On each side the highest windowed
    mean near the edge is compared with a straight line through the plateau beyond. The sum of both sides counts, as
    an illumination gradient raises one and lowers the other.
    """
    bright, dark = (_overshoot(profile, half_frequency, sign) for sign in (1.0, -1.0))
    if bright is None or dark is None:
        return 0.0
    total, error = bright[0] + dark[0], float(np.hypot(bright[1], dark[1]))
    share = total / max(abs(profile.step), 1e-300)
    return share if total > THRESHOLDS.overshoot_sd * error and share > THRESHOLDS.min_overshoot else 0.0


def _overshoot(profile: EdgeProfile, half_frequency: float, sign: float) -> tuple[float, float] | None:
    """Return the overshoot of one side with its standard error, DN."""
    away = sign * profile.distance * half_frequency
    far, near = (
        (away > ACCURACY.plateau_range[0]) & (away < ACCURACY.plateau_range[1]),
        np.flatnonzero((away > ACCURACY.overshoot_range[0]) & (away < ACCURACY.overshoot_range[1])),
    )
    if np.count_nonzero(far) < ACCURACY.overshoot_bins or not near.size:
        return None
    line = np.stack([np.ones(np.count_nonzero(far)), profile.distance[far]]) / np.sqrt(np.diag(profile.covariance)[far])
    through = np.linalg.solve(line @ line.T, line) / np.sqrt(np.diag(profile.covariance)[far])
    weights = np.zeros((near.size, profile.distance.size))
    for row, middle in enumerate(profile.distance[near]):
        inside = near[np.abs(profile.distance[near] - middle) < ACCURACY.overshoot_window_px]
        weights[row, inside] = 1.0 / inside.size
        weights[row, far] -= np.array([1.0, np.mean(profile.distance[inside])]) @ through
    beyond = sign * (weights @ profile.value)
    most = weights[int(np.argmax(beyond))]
    return float(beyond.max()), float(np.sqrt(most @ profile.covariance @ most))


def noise_gain_of(picture: OrientedFrame, profile: EdgeProfile) -> float:
    """Return the factor by which sharpening raised the noise; 1: neighbours are not anticorrelated.

    Notes
    -----
    Blur correlates neighbours; only differences between pixels make them anticorrelated. Means over many pixels are
    unchanged, so the sum C of the noise's correlation falls below 1 and the noise rises by C^(-1/2). Each of the n
    pixels of a bin contributes 1/n of its mean, which is corrected for.
    """
    gathered, step = profile.gathered, profile.step or 1.0
    at_pixel = np.interp(gathered.distance, profile.distance, profile.value)
    level = (at_pixel - profile.dark) / step
    used = gathered.used & (np.minimum(np.abs(level), np.abs(level - 1.0)) < ACCURACY.sharpening_plateau)
    sd = np.sqrt(np.maximum(profile.grain.variance(level), profile.variance_floor))
    noise = np.where(
        used, np.clip((picture.value - at_pixel) / sd, -ACCURACY.sharpening_clip_sd, ACCURACY.sharpening_clip_sd), 0.0
    )
    pixels = int(np.count_nonzero(used))
    if pixels < ACCURACY.sharpening_pixels:
        return 1.0
    # A variance below 1 is the residual of the bins, not noise.
    variance = max(float(np.sum(noise**2)) / pixels, 1.0)
    shared = [_mean_product(noise, used, down, right) for down, right in NEIGHBOURS]
    total = 2.0 * sum(shared) / variance
    taken = 2.0 * REACH_PX * float(np.mean(1.0 / profile.count))
    error = np.sqrt(2.0 * len(shared) / pixels) * np.sqrt(2.0)
    opposed = -(total + taken)
    return (
        float(max(1.0 - opposed, 0.05) ** -0.5)
        if opposed > max(THRESHOLDS.min_anticorrelation, THRESHOLDS.anticorrelation_sd * error)
        else 1.0
    )


def _mean_product(noise: Array, used: NDArray[np.bool_], down: int, right: int) -> float:
    """Return the mean product of pixels `down` rows and `right` columns apart."""
    rows, cols = noise.shape
    one = slice(0, rows - down), slice(max(-right, 0), cols - max(right, 0))
    other = slice(down, rows), slice(max(right, 0), cols - max(-right, 0))
    return float(np.sum(noise[one] * noise[other])) / max(int(np.count_nonzero(used[one] & used[other])), 1)


LINEAR = "linear frames (raw, without a gamma), or --sensor with a description"


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Quantities from which the effects of flags are computed.

    Parameters
    ----------
    edge
        The edge.
    half
        MTF50, cy/px; NaN: not known.
    response
        Curvature of the camera response with its standard uncertainty; None: not estimated.
    misfit
        Largest residual of the profile, fraction of the step; None: no model.
    """

    edge: PreparedEdge
    half: float
    response: CurvatureEstimate | None = None
    misfit: float | None = None

    @property
    def step(self) -> float:
        return max(abs(self.edge.profile.step), 1e-300)


def with_findings(found: Measurement, facts: Facts) -> Measurement:
    """Return a measurement with the effect and the remedy of each flag."""
    known = [flag for flag in found.flags if flag in EFFECTS]
    return found.with_(
        findings=[Finding(flag=flag, effect=EFFECTS[flag](facts), remedy=REMEDIES[flag]) for flag in known]
    )


def sharpening_flags(edge: PreparedEdge, half: float) -> tuple[str, ...]:
    """Return `processed` if the edge overshoots or its noise is anticorrelated."""
    sharpened = noise_gain_of(edge.picture, edge.profile) > 1.0 or (half > 0 and overshoot_of(edge.profile, half) > 0.0)
    return ("processed",) if sharpened else ()


def _clipping(facts: Facts) -> str:
    data = facts.edge.used.data
    top, bottom = (100.0 * float(np.mean(data == end)) for end in (data.max(), data.min()))
    return (
        f"{top:.0f} % of the pixels sit at {data.max():g} DN, {bottom:.0f} % at {data.min():g} DN: the "
        "plateaus are lost, and MTF50 may be high by tens of percent"
    )


def _gamma(facts: Facts) -> str:
    most = 100.0 * max_bias_of(facts.response, contrast(facts.edge.profile))
    return f"a nonlinear camera response may bias MTF50 by up to {most:.1f} %"


def _misfit(facts: Facts) -> str:
    return f"the blur model deviates from the profile by up to {100.0 * (facts.misfit or 0.0):.1f} % of the step"


def _defects(facts: Facts) -> str:
    profile = facts.edge.profile
    used = int(np.count_nonzero(profile.gathered.used))
    return (
        f"{profile.defects} of {used} pixels were excluded; as many undetected ones may move MTF50 by "
        f"{100.0 * profile.defects / max(used, 1):.2g} %"
    )


def _gradient(facts: Facts) -> str:
    profile = facts.edge.profile
    sides = [profile.value[side] for side in (profile.distance < 0, profile.distance > 0)]
    changes = max(float(np.ptp(one[np.abs(one - np.median(one)) < 0.3 * facts.step])) for one in sides if one.size)
    return f"the illumination changes by {100.0 * changes / facts.step:.0f} % of the step over a side, as with glare"


def _low_signal(facts: Facts) -> str:
    noise = max(noise_of(facts.edge.profile), 1e-300)
    return f"the step is {facts.step / noise:.1f} times the noise of a pixel: the limits of the interval are uncertain"


def _quantisation(facts: Facts) -> str:
    return f"either plateau may be off by 0.5 DN, {50.0 / facts.step:.2g} % of the step, and MTF50 by about as much"


def _window(facts: Facts) -> str:
    half_width = facts.edge.profile.gathered.half_width_px
    return f"light beyond {half_width:.0f} px from the edge is not included: MTF50 is high by its fraction"


def _drift(facts: Facts) -> str:
    motion = facts.edge.target_motion
    return f"the edge moves by {motion.rms_px:.2g} px rms: MTF50 is {100.0 * motion.mtf_loss(facts.half):.2g} % low"


def _edge_roughness(facts: Facts) -> str:
    rough = facts.edge.roughness
    return f"an edge roughness of {rough.rms_px:.2g} px rms lowers MTF50 by {100.0 * rough.mtf_loss(facts.half):.2g} %"


def _processing(facts: Facts) -> str:
    edge, half = facts.edge, facts.half
    over = overshoot_of(edge.profile, half) if half > 0 else 0.0
    gain = noise_gain_of(edge.picture, edge.profile)
    if over > 0.0 or gain > 1.0:
        return (
            f"sharpened: overshoot of {100.0 * over:.1f} % of the step, and noise is {100.0 * (gain - 1.0):.0f} % "
            "larger; MTF50 is that of the processed image and may exceed the camera's by as many percent"
        )
    return (
        f"noise on the edge is {edge.slope_noise.ratio:.1f} times that of its plateaus: noise reduction sparing edges "
        "may have sharpened or blurred this one"
    )


def _interlace(facts: Facts) -> str:
    return "the two fields of the frame are displaced, which blurs their mean"


def _tilt(facts: Facts) -> str:
    travel = abs(facts.edge.rows.line.slope) * facts.edge.picture.value.shape[0]
    return f"the edge crosses {travel:.1f} pixels along its length: gaps between them are not sampled"


def _several(facts: Facts) -> str:
    return "light of another step is attributed to this edge"


def _modes(facts: Facts) -> str:
    return "two values fit the edge about equally well: the interval contains both, its median may be neither"


def _chain(facts: Facts) -> str:
    return "the interval is the Laplace approximation and may be a third too narrow"


EFFECTS: dict[str, Callable[[Facts], str]] = {
    "clipped": _clipping,
    "gamma": _gamma,
    "model-misfit": _misfit,
    "defects": _defects,
    "gradient": _gradient,
    "low-signal": _low_signal,
    "quantised": _quantisation,
    "window-too-small": _window,
    "drift": _drift,
    "curved-edge": _edge_roughness,
    "processed": _processing,
    "interlace-motion": _interlace,
    "tilt-too-small": _tilt,
    "several-targets": _several,
    "several-modes": _modes,
    "prior-bound": _chain,
    "not-converged": _chain,
}
REMEDIES: dict[str, str] = {
    "clipped": "less light or a shorter exposure",
    "gamma": f"--black-dn, {LINEAR}",
    "model-misfit": "--method auto or edge-free, which need no blur model",
    "defects": "--roi on a part without them, or defect correction switched on",
    "gradient": "uniform illumination, --black-dn, or a --roi nearer to the edge",
    "low-signal": "more frames, more light or a longer edge",
    "quantised": "more frames with noise of 0.5 DN, or a higher bit depth",
    "window-too-small": "a larger --roi",
    "drift": "a steadier mount, or fewer frames",
    "curved-edge": "a straight target, or a shorter --roi along the edge",
    "processed": "frames with sharpening and noise reduction switched off (raw)",
    "interlace-motion": "a stationary target, or progressive read-out",
    "tilt-too-small": "an edge tilted by 3 to 10 degrees",
    "several-targets": "--roi around one edge",
    "several-modes": "more frames or more light",
    "prior-bound": "more frames or more light",
    "not-converged": "another --seed, or more frames",
}
assert EFFECTS.keys() == REMEDIES.keys() <= FLAGS.keys()
