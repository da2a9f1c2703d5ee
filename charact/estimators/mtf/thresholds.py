"""Thresholds and numerical settings of MTF methods, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MtfLimits:
    """Thresholds that decide about flags, refusals and candidates of MTF methods."""

    min_contrast: float = 0.05  # Contrast of two levels, at least
    # A dark side may lie this fraction of the step below black, by noise or drift
    max_below_black: float = 0.1
    # Fall of the variance towards the light: factor, and standard uncertainties.
    falling_variance: tuple[float, float] = (1.15, 5.7)
    # Rise beyond the signals' ratio by PRNU and black level error, likewise.
    rising_variance: tuple[float, float] = (1.1, 4.0)
    # Significance of the covariance of neighbours, standard uncertainties
    min_covariance_sd: float = 8.0
    min_plateau_pixels: int = 50  # Pixels of a plateau
    min_smoothing_frames: int = 4  # Frames of the noise reduction check
    min_slope: float = 0.2  # Slope over the steepest one of pixels on a slope
    min_slope_pixels: int = 3  # Such pixels in a row
    # Noise on slopes over that of plateaus: factor, and standard uncertainties.
    slope_noise: tuple[float, float] = (1.25, 5.0)
    motion_p_value: float = 1e-4  # p-value of motion
    # Displacements over their rms as measured, at most: it is known to a fifth (test_roughness,
    # test_target_motion)
    max_rms_ratio: float = 1.2
    # Effect of motion on MTF50 that leaves the noise on slopes a test, standard uncertainties
    max_motion_sd: float = 0.5
    min_line_power: float = 0.5  # Precision of a line's position over the median
    # Fall of the summed noise correlation that is sharpening: white noise never shows it, an amount
    # of 0.3 does (study strangers_edges).
    min_anticorrelation: float = 0.1
    anticorrelation_sd: float = 4.0  # Its significance, standard errors: chance 3e-5 an edge


@dataclass(frozen=True)
class MtfAccuracy:
    """Sampling, iteration limits, tolerances and resolution of MTF methods."""

    black_sd_dn: float = 0.2  # Standard uncertainty of a black level, DN
    compared_rows: int = 8  # Rows by which identical frames are looked up
    block_rows: int = 4  # Rows of a jackknife block, of independent noise
    min_blocks: int = 6  # Number of blocks
    max_group_lines: int = 8  # Lines of a group
    min_group_lines: int = 3  # The same, at least
    line_groups: int = 4  # Number of groups
    min_line_groups: int = 3  # The same, at least
    # Lines of a group from which two are left between groups, whose noise is correlated
    wide_gap_lines: int = 5
    profile_cells_per_px: int = 4  # Cells of the mean profile per px
    profile_smoothing_px: float = 0.5  # Its smoothing, px
    sharpening_pixels: int = 1000  # Pixels below which no anticorrelation is tested
    sharpening_clip_sd: float = 5.0  # Standardised noise is clipped to this
    tail_points: int = 20_001  # Points of the integral of Fisher's F: within 1e-6 of it


LIMITS = MtfLimits()
ACCURACY = MtfAccuracy()
