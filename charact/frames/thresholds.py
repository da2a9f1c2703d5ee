"""Thresholds and numerical settings of what is measured on frames, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ClippingLimits:
    """Ends of the scale and rounding (`clipping`, `rounding`)."""

    pile_up_fraction: float = 0.002  # Fraction of the pixels at an extreme value
    pile_up_ratio: float = 3.0  # Its count over that of the adjacent value
    noisy_pile_up_ratio: float = 1.5  # Count ratio where noise is visible next to the pile
    clipped_steps: int = 3  # Steps that only clipped noise crosses between frames
    min_crossing: float = 0.005  # Fraction of a pile's pixels that cross
    min_staying: float = 0.05  # Fraction that stays: 1.6 standard deviations below a plateau
    min_pile_pixels: int = 10  # Number of either
    # Fraction of the brighter pixels at one value; normal noise of one step has 38 %
    plateau_fraction: float = 0.6
    least_noise_codes: float = 0.4  # Steps; with less an even plateau has one value: 79 % at 0.4
    max_plateau_chance: float = 0.05  # That the pixels of a plateau have one value by chance
    # Full wells: fewest frames, pixels whose median variance counts, its ratio to that of the dark
    # up to which they are as quiet (3 degrees of freedom of 8 pixels: 2 once in 100), and of
    # half lit ones to that from which shot noise is seen
    well_frames: int = 4
    well_pixels: int = 8
    quiet_ratio: float = 2.0
    noisy_ratio: float = 5.0
    sample: int = 2**12  # Pixels that show whether a frame is a flat, and of which those are
    partly_full: float = 0.1  # Fraction of those pixels that may not be full
    ordinary_differences: float = 0.95  # Quantile of the differences of neighbours without edges
    min_relative_noise: float = 1e-5  # Noise over the range; less is rounding of floats
    min_rounding_shift_dn: float = 1e-3  # Shift that matters, DN
    # Fraction of full scale at which frames clip or the wells of a sensor fill: their spread from
    # pixel to pixel and the noise of the digitiser
    full_fraction: float = 0.97
    # Fraction of the range from black to full scale above which full scale cuts the peaks of the
    # noise of pixels, and of full scale above which it may have cut a single value
    linear_fraction: float = 0.75
    near_full_fraction: float = 0.95
    # Fraction of frames at the top from which the mean of a pixel underestimates its signal
    max_full_frames: float = 0.02
    # Quantile of a mean frame that is taken as black where black is not known: of scenes and edges,
    # which leave some pixels unlit, and of points, which leave most.
    unlit: float = 0.02
    unlit_around_points: float = 0.5
    # Fraction of the noise below the lowest grey value: MTF50 is then half a standard uncertainty
    # high.
    max_clipped_noise: float = 0.04
    # Ratio of the standard deviations between them; that of pulses grows upwards
    max_sd_ratio: float = 1.25
    # Lowest values of converters and of the video range, DN
    video_floors_dn: tuple[int, int] = 0, 16
    distinct_fraction: float = 0.5  # Distinct values beyond which values count as continuous
    step_tolerance: float = 0.02  # Steps; deviation from multiples in single precision
    rounding_offsets: int = 8  # Offsets of the black level between two steps
    sawtooth_terms: int = 6  # Terms of the sawtooth's series


@dataclass(frozen=True, kw_only=True)
class NoiseLimits:
    """A law of noise fitted to squared residuals (`noise_law`)."""

    outlier: float = 50.0  # Largest squared residual over their mean: 7 standard deviations
    # Least variance over the mean: of a line that is steep by chance, and of pixels without light
    # behind a tube
    least_fraction: float = 0.02


@dataclass(frozen=True, kw_only=True)
class LagSettings:
    """Image lag of a described phosphor (`image_lag`)."""

    lag_fields: int = 64  # Fields over which the decay is followed
    arrival_times: int = 200  # Arrival times within a field


@dataclass(frozen=True, kw_only=True)
class CubeLimits:
    """3-D noise (`components`, `cube`)."""

    min_frames: int = 8  # fewest frames of temporal components
    min_pixels: int = 16  # px; smallest side of a field with slow waves
    # power of alternating rows of a mean image over that of other rows
    alternating_power: float = 30.0
    alternating_sd: float = 8.0  # the same of many frames, standard errors
    # rows and columns of blocks that give the scatter of random noise power
    blocks: tuple[int, int] = 8, 8
    spectra: int = 2  # frame differences that give the number of independent pixels
    # relative error of extrapolating waves of one and two periods to the mean
    extrapolation_sd: float = 0.25
    # mean square of a standard normal error after shrinkage by 1 - 1/z^2
    shrunk_variance: float = 0.36
    significant_sd: float = 3.0  # standard errors of a significant excess
    chunk_frames: int = 8  # frames per pass; even, to keep pairs together
    pairs: int = 8  # pairs of successive frames for the scatter of the power
    slow_waves: int = 4  # sine and cosine of one and two periods
    shading_order: int = 4  # largest polynomial order of smooth shading
    pixels_per_order: int = 8  # px per polynomial order on short axes
    draws: int = 4000  # posterior draws
    false_alarm: float = 1e-3  # false-alarm probability of a component
    max_slope: float = 0.3  # fall of power from one to two periods beyond which extrapolation fails
    slope_weight: float = 0.25  # excess over the half interval from which this matters


@dataclass(frozen=True, kw_only=True)
class StackLimits:
    """Statistics of stacks (`stack_statistics`, `frame_block`, `spectrum`, `temporal`)."""

    accumulated: int = 8  # values per frame at the largest value that are not due to chance
    accumulated_sd: float = 5.0  # standard deviations above the next largest value
    block_frames: int = 32  # frames of a block: bounds memory and excludes slow drift
    false_alarm: float = 1e-4  # false-alarm probability of a flicker line or drift
    min_change_frames: int = 5  # fewest frames of which a step or drift leaves a residual
    slow_noise_sd: float = 3.0  # standard errors of slow noise in near pairs of exposures
    slow_noise_fraction: float = 0.02  # slow noise over the pattern variance
    # largest slow noise beyond the last pairs, fraction of the variance
    max_slow_noise: float = 0.1
    # rows and columns of blocks that give the error of the variance
    blocks: tuple[int, int] = 6, 8
    spectra: int = 8  # exposures whose spectra give the number of independent pixels
    side_px: int = 128  # px; side of the image centre of these spectra
    band_pixels: int = 2**17  # pixels of all exposures per pass, which fit the processor's cache
    max_lags: int = 12  # exposures; largest lag in the search for image lag
    few_lags: int = 2  # exposures; lags used if none is detected
    decay_exposures: int = 8  # exposures; separation of negligible image lag behind a tube
    max_dn: float = 1e9  # DN; squares of larger values exceed single precision
    rings: int = 25  # rings of the spectrum up to the band limit
    sectors: int = 4  # sectors of a quadrant
    min_modes: int = 8  # fewest modes in a bin
    min_ring_modes: int = 3  # fewest modes in a bin near frequency 0, where sectors are merged
    taper: float = 0.08  # tapered fraction of each side, against leakage to high frequency
    binning_sd: float = 0.01  # relative error of band integrals by binning


@dataclass(frozen=True, kw_only=True)
class LayoutLimits:
    """Parts of a chip (`layout`)."""

    bands: int = 8  # bands of a mean frame along a side; an even number
    # Signal over that of the picture up to which a column sees no light: deferred charge of a
    # serial overscan (Janesick, Scientific CCDs, ch. 5) and drift of the offset stay below
    unlit_fraction: float = 0.05
    lit_fraction: float = 0.1  # signal of a band over the brightest, below which it is all strip
    lit_sd: float = 10.0  # standard deviations of a column's signal that a picture must have
    min_strip_px: int = 2  # px; a single column may be a bad one
    # Signal of the second column after a strip over the next ones: crosstalk of pixels is less
    sharp_fraction: float = 0.5
    flat_fraction: float = 0.01  # scatter of its bands over that signal, without darks
    adjacent_px: int = 8  # px; these next columns
    windows: int = 12  # windows of a step along an axis; the outer ones cannot hold a border
    max_window_px: int = 16  # px
    # Standard errors of a step that every band but one must show: false alarm 1e-9 a column of
    # independent bands, 2e-9 where all bands have the same columns
    step_sd: float = 6.0
    max_borders: int = 7  # across an axis: eight taps
    same_border_px: int = 2  # px; borders of offset and response that are one
    lost_sd: float = 8.0  # standard deviations of a row by which a lost one may differ
    lost_chance: float = -30.0  # logarithm of the chance that noise makes a row of one value


CLIPPING = ClippingLimits()
NOISE = NoiseLimits()
LAG = LagSettings()
CUBE = CubeLimits()
STACK = StackLimits()
LAYOUT = LayoutLimits()
