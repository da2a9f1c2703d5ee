"""The ways in which an edge deceives, each looked for in the data: what is found becomes a flag."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.pixels import fields
from charact.mtf.edge.pixels.line import RowFit
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.mean_frame import OrientedFrame
from charact.mtf.quantisation_checks import clipping_flags
from charact.mtf.target_motion import TargetMotion
from charact.robust import median

Array = NDArray[np.float64]

# Significance from which a departure counts, in standard errors, and the size from which it matters.
SIGNIFICANT = 4.0
# The same for a course that is bowed, of which few numbers tell.
COURSE_SIGNIFICANT = 3.5
SAGITTA_PX = 0.12
MIN_TRAVEL_PX = 1.0
BLOCKS = 12
# Rows over which noise ties their displacements.
CORRELATED_ROWS = 5
# How far from the edge pixels tell that fields lie apart, px.
NEAR_PX = 8.0
# Chi squared per bin beyond which the profile is not what the model says it is.
MISFIT = 1.6
# Illumination that changes by more than this share over the band is told, though the fit allows for it.
GRADIENT = 0.2
MIN_STEP_SD = 0.8
# Noise of one frame under which plateaus may lie anywhere between two codes, DN: normal noise of 0.2 shows as much, and
# a third of the numbers told beside it were off by more than twice their half interval.
QUANTISATION_NOISE_DN = 0.45


@dataclass(frozen=True, kw_only=True)
class FittedProfile:
    """A profile as a method fitted it.

    Parameters
    ----------
    model
        The best profile at the bins, DN.
    amplitude
        Step, level and both ways in which light slopes, DN and DN per px.
    chi2, free
        Chi squared, and the bins less the parameters that the data fix.
    """

    model: Array
    amplitude: Array
    chi2: float
    free: int


def picture_flags(data: NDArray, full_scale_dn: float | None) -> tuple[str, ...]:
    """Return the flags that the codes of the region give."""
    return clipping_flags(data, full_scale_dn)


def line_flags(picture: OrientedFrame, rows: RowFit, profile: EdgeProfile) -> tuple[str, ...]:
    """Return the flags of the edge's course: its tilt, its bow, and whether the two fields agree."""
    flags = []
    if abs(rows.line.slope) * picture.value.shape[0] < MIN_TRAVEL_PX:
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
    """Return the note on an edge that wanders about a straight line."""
    if not roughness.moves:
        return ()
    return (f"The edge wanders by {roughness.rms_px:.2g} px rms along its length, beyond what noise makes of it.",)


def _column_field_displacement(picture: OrientedFrame, profile: EdgeProfile) -> fields.Displacement:
    """Return how far fields lie apart whose lines run along the edge: they alternate across the picture's columns."""
    used = profile.gathered.used & (np.abs(profile.gathered.distance) < NEAR_PX)
    distance = profile.gathered.distance[used]
    residual = picture.value[used] - np.interp(distance, profile.distance, profile.value)
    noise = float(np.sqrt(max(profile.grain.dark_variance, profile.grain.bright_variance)))
    slopes = fields.steepness(profile.distance, profile.value, distance)
    return fields.field_displacement_of_pixels(picture.row_index[used] % 2, residual, slopes, noise)


def _has_bow(offset: Array) -> bool:
    """Tell whether the rows' displacements follow a bow or a wave rather than scatter.

    Blocks of rows are compared with what their rows' scatter allows; neighbouring rows share noise, so the scatter
    of blocks is taken from what they share, or from the differences of neighbouring blocks, where that is larger.
    """
    good = np.isfinite(offset)
    if np.count_nonzero(good) < 24:
        return False
    rows, value = np.flatnonzero(good), offset[good]
    # From end to end of the rows that hold the edge: polynomials carried on beyond them would grow.
    place = 2.0 * (rows - rows[0]) / (rows[-1] - rows[0]) - 1.0
    design = np.polynomial.legendre.legvander(place, 3)
    begin = np.arange(BLOCKS) * value.size // BLOCKS
    size = np.diff(begin, append=value.size)
    means = np.add.reduceat(value, begin) / size
    within = np.mean((np.add.reduceat(value**2, begin) / size - means**2) / (size - 1.0))
    differences = 0.5 * median(np.diff(means) ** 2) / 0.455
    coefficients = np.linalg.lstsq(design, value, rcond=None)[0]
    tied = _variance_with_correlation(value - design @ coefficients) / value.size * BLOCKS
    error, shape = np.sqrt(max(within, differences, tied) * BLOCKS), coefficients[2:]
    # A Legendre amplitude of evenly spread values has the variance (2 k + 1) s^2 / n.
    significant = np.abs(shape) > COURSE_SIGNIFICANT * error / BLOCKS * np.sqrt([5.0, 7.0])
    return bool(np.any(significant & (np.abs(shape) > SAGITTA_PX / 1.5)))


def _variance_with_correlation(left: Array) -> float:
    """Return the variance of what is left of rows, n-fold that of n rows' mean: with what neighbours share of it.

    Counted up to the first lag at which they share none (Geyer's initial positive sequence, Stat. Sci. 7, 473, 1992).
    """
    shared = np.array([float(np.mean(left[:-lag] * left[lag:])) for lag in range(1, CORRELATED_ROWS + 1)])
    return float(np.mean(left**2)) + 2.0 * float(np.sum(shared[np.cumprod(shared > 0.0).astype(bool)]))


def fit_flags(
    picture: OrientedFrame, profile: EdgeProfile, fitted: FittedProfile, half_frequency: float
) -> tuple[str, ...]:
    """Return the flags of the fitted profile."""
    flags = []
    step, slopes = abs(fitted.amplitude[0]), profile.light.by_side(fitted.amplitude)[-2:]
    noise = noise_of(profile)
    if fitted.chi2 / fitted.free > MISFIT + SIGNIFICANT * np.sqrt(2.0 / fitted.free):
        flags.append("model-misfit")
    if profile.defects:
        flags.append("defects")
    if np.abs(slopes).max() * 2.0 * profile.gathered.half_width_px > GRADIENT * step:
        flags.append("gradient")
    if step < MIN_STEP_SD * noise:
        flags.append("low-signal")
    if noise_below_quantisation(picture, profile):
        flags.append("quantised")
    if profile.gathered.half_width_px < 1.6 / half_frequency:
        flags.append("window-too-small")
    if _other_steps(profile, fitted):
        flags.append("several-targets")
    return tuple(flags)


def noise_below_quantisation(picture: OrientedFrame, profile: EdgeProfile) -> bool:
    """Tell whether the noise of one frame is so small that its plateaus may lie anywhere between two codes."""
    return picture.whole_codes and noise_of(profile) * np.sqrt(picture.frames) < QUANTISATION_NOISE_DN


def noise_of(profile: EdgeProfile) -> float:
    """Return the noise of a pixel, the mean of both sides, DN."""
    return float(np.sqrt(0.5 * (profile.grain.dark_variance + profile.grain.bright_variance)))


def _other_steps(profile: EdgeProfile, fitted: FittedProfile) -> bool:
    """Tell whether the plateaus hold another step: a tenth of the edge's own over several pixels."""
    left = profile.value - fitted.model
    weight = profile.count
    cell = np.floor(profile.distance / 3.0).astype(int)
    cell -= cell.min()
    means = np.bincount(cell, weights=weight * left) / np.maximum(np.bincount(cell, weights=weight), 1e-9)
    error = np.sqrt(profile.grain.covariance_over_variance * profile.grain.bright_variance)
    error = error / np.sqrt(np.maximum(np.bincount(cell, weights=weight), 1.0))
    return bool(np.any((np.abs(means) > 0.1 * abs(fitted.amplitude[0])) & (np.abs(means) > SIGNIFICANT * error)))
