"""Thresholds and numerical settings of MTF methods, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MtfLimits:
    """Thresholds that decide about flags, refusals and candidates of MTF methods."""

    # Fraction of the pixels at an extreme value.
    pile_up_fraction: float = 0.002
    # Its count over that of the adjacent value.
    pile_up_ratio: float = 3.0
    # Count ratio where noise is visible next to the pile.
    noisy_pile_up_ratio: float = 1.5
    # Steps that only clipped noise crosses between frames.
    clipped_steps: int = 3
    # Fraction of a pile's pixels that cross.
    min_crossing: float = 0.005
    # Fraction that stays: 1.6 standard deviations below a plateau.
    min_staying: float = 0.05
    # Number of either.
    min_pile_pixels: int = 10
    # Fraction of the brighter pixels at one value; normal noise of one step has 38 %.
    plateau_fraction: float = 0.6
    # Noise over the range; less is rounding of floats.
    min_relative_noise: float = 1e-5
    # Shift that matters, DN.
    min_rounding_shift_dn: float = 1e-3
    # Contrast of two levels, at least.
    min_contrast: float = 0.05
    # A dark side may lie this fraction of the step below black, by noise or drift.
    max_below_black: float = 0.1
    # Fall of the variance towards the light: factor, and standard uncertainties.
    falling_variance: tuple[float, float] = (1.15, 5.7)
    # Rise beyond the signals' ratio by PRNU and black level error, likewise.
    rising_variance: tuple[float, float] = (1.1, 4.0)
    # Significance of the covariance of neighbours, standard uncertainties.
    min_covariance_sd: float = 8.0
    # Pixels of a plateau.
    min_plateau_pixels: int = 50
    # Frames of the noise reduction check.
    min_smoothing_frames: int = 4
    # Slope over the steepest one of pixels on a slope.
    min_slope: float = 0.2
    # Such pixels in a row.
    min_slope_pixels: int = 3
    # Noise on slopes over that of plateaus: factor, and standard uncertainties.
    slope_noise: tuple[float, float] = (1.25, 5.0)
    # p-value of motion.
    motion_p_value: float = 1e-4
    # Effect of motion that needs no flag, standard uncertainties of the measurement.
    max_motion_sd: float = 0.5
    # Precision of a line's position over the median.
    min_line_power: float = 0.5


@dataclass(frozen=True)
class MtfAccuracy:
    """Sampling, iteration limits, tolerances and resolution of MTF methods."""

    # Lowest values of converters and of the video range, DN.
    video_floors_dn: tuple[int, int] = (0, 16)
    # Offsets of the black level between two steps.
    rounding_offsets: int = 8
    # Terms of the sawtooth's series.
    sawtooth_terms: int = 6
    # Standard uncertainty of a black level, DN.
    black_sd_dn: float = 0.2
    # Fields over which the decay is followed.
    lag_fields: int = 64
    # Arrival times within a field.
    arrival_times: int = 200
    # Rows by which identical frames are looked up.
    compared_rows: int = 8
    # Rows of a jackknife block, of independent noise.
    block_rows: int = 4
    # Number of blocks.
    min_blocks: int = 6
    # Lines of a group.
    max_group_lines: int = 8
    # The same, at least.
    min_group_lines: int = 3
    # Number of groups.
    line_groups: int = 4
    # The same, at least.
    min_line_groups: int = 3
    # Lines of a group from which two are left between groups, whose noise is correlated.
    wide_gap_lines: int = 5
    # Cells of the mean profile per px.
    profile_cells_per_px: int = 4
    # Its smoothing, px.
    profile_smoothing_px: float = 0.5


LIMITS = MtfLimits()
ACCURACY = MtfAccuracy()
