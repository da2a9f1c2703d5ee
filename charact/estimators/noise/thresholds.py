"""Thresholds and accuracy of the noise analysis, one a line.

Fractions and probabilities are dimensionless. Without another source, values were set on simulated
cameras (`tests.truth.cases`).
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CheckLimits:
    """Flags of a flat series (`checks`)."""

    significant_sd: float = 5.0  # standard errors of a significant drift, flicker or deviation
    # standard errors of a difference between amplifiers that the chip's number must hold
    unlike_sd: float = 3.0
    drift_fraction: float = 0.02  # drift over signal
    flicker_fraction: float = 0.01  # flicker rms over signal
    # smallest exponent of signal against light without automatic gain control
    min_light_exponent: float = 0.5
    nonlinear_fraction: float = 0.05  # deviation of signal over light
    # DN; below it a rounding bias of a third of a step exceeds several percent
    coarse_signal_dn: float = 4.0
    # DN^2; below it rare pulses may dominate noise much finer than a step
    coarse_variance_dn2: float = 1.0
    # accepted change of variance over signal: charge repulsion in CCDs gives several percent
    curvature: float = 0.08
    curvature_sd: float = 2.5  # standard errors of a significant change
    min_levels: int = 3  # fewest levels that test a line of two parameters
    exposure_tolerance: float = 0.1  # relative difference of the exposures of flat and dark
    min_light_ratio: float = 1.3  # smallest ratio of light that tests the camera response
    line_fraction: float = 0.02  # of the variance: noise of rows or columns of 1 % of the noise
    max_clipped_fraction: float = 0.01  # clipped values of a dark with unbiased noise
    # fraction of clipped values from which nothing bounds the noise beneath
    unbounded_clipping: float = 0.5
    explained_clipping: float = 2.0  # mean over that of noise cut off as often: dead pixels beyond
    dark_pattern_fraction: float = 0.02  # dark pattern over PRNU below which its flags do not apply


@dataclass(frozen=True, kw_only=True)
class SceneLimits:
    """Photon transfer from unevenly lit frames (`uneven_scene`)."""

    least_span: float = 1.5  # brightest over dimmest level that show a slope of their own
    smoothing_px: int = 3  # px; side of the mean that sorts pixels by signal
    range: tuple[float, float] = 0.001, 0.999  # quantiles of the signal between which bins lie
    steps: int = 48  # narrowest bins
    # independent differences in a bin: its variance has an error of sqrt(2 / 3200) = 2.5 %, a
    # quarter of the fall by which a peak is known
    differences: int = 3200


@dataclass(frozen=True, kw_only=True)
class CorrelationLimits:
    """Correlated noise and camera processing (`undetected_correlation`)."""

    min_effect: float = 0.01  # smallest detected effect on the gain
    significant_sd: float = 3.0  # standard errors of a detected effect
    bound_sd: float = 1.96  # standard errors beyond a detected effect that bound it: 97.5 %
    negligible: float = 0.02  # undetected effects up to this size are neglected
    untestable: float = 0.1  # a test that cannot exclude this effect is void
    # charge diffusion: each of four neighbours gets up to 5 % of the charge, twice
    max_fraction: float = 0.4
    few_frames: int = 3  # stacks up to this length cannot compare near with far pairs of frames
    max_condition: float = 1e12  # condition number of the fit over levels
    min_correlation: float = 0.02  # smallest detected correlation by processing
    processing_sd: float = 4.0  # standard errors of detected processing
    # cy/px; blur never raises the outer band over the inner one
    inner_cy_per_px: tuple[float, float] = 0.0, 0.08
    outer_cy_per_px: tuple[float, float] = (0.15, 0.25)  # cy/px
    min_rise: float = 0.1  # relative rise of power by sharpening
    # spatial over temporal correlation: image lag also correlates pixels
    max_spatial_ratio: float = 0.25
    # px; separation of pixels that no smoothing connects, and equal neighbours beyond chance: a
    # median of 3 to 25 pixels has 13 to 40 %
    far_px: int = 16
    min_equal: float = 0.05
    median_tolerance: float = 0.03  # correlation of neighbours of a known median
    min_change: float = 0.05  # change of the neighbour correlation along the levels
    linear_exponents: tuple[float, float] = (0.85, 1.15)  # exponents that count as linear
    gamma_exponents: tuple[float, float] = (0.3, 3.0)  # exponents that count as gamma
    power_law_tolerance: float = 0.05  # relative deviation from a power law
    min_power_law_levels: int = 4  # levels that test a power law


@dataclass(frozen=True, kw_only=True)
class AgreementLimits:
    """Agreement of stacks with each other (`gain.stack_agreement`)."""

    max_averaged: float = 1000.5  # frames of one mean; a finer step is that of other values
    significant_sd: float = 4.0  # standard errors of unequal noise: 6e-5 of a normal distribution
    # variance of flats at no light over that of the darks, less one: two frames averaged have 1,
    # and a read noise that is wrong by less than a fifth is left to its interval
    dark_variance_fraction: float = 0.5
    min_change: float = 0.1  # change of a dark's level over the noise of a pixel that matters


@dataclass(frozen=True, kw_only=True)
class DarkCurrentLimits:
    """Dark current (`dark_current`)."""

    draws: int = 4000  # posterior draws
    same_temperature_k: float = 0.5  # K; smaller differences count as equal
    curvature: float = 0.05  # relative change of the slope that counts as nonlinear
    curvature_sd: float = 4.0  # standard errors of a significant curvature
    law_relative_sd: float = 0.02  # accuracy of exponential doubling between temperatures


@dataclass(frozen=True, kw_only=True)
class SurveyLimits:
    """Defective pixels (`pixel_survey`, `defective_pixels`, `prepared_session`)."""

    outlying_sd: float = 8.0  # robust standard deviations of a mean: 1e-14 of a normal distribution
    sudden_sd: float = 6.15  # standard deviations of a difference: 1e-9 of a normal distribution
    max_tracks: float = 0.1  # outliers beyond which they are not followed along tracks
    track_sd: float = 3.0  # standard deviations of a pixel of a track next to an outlier
    # chances, a decade apart, of which the tail is extrapolated; one pixel of 1000 may be hit
    tail_chances: tuple[float, float] = (10**-1.5, 10**-2.5)
    tail_decades: float = 4.5  # decades by which it is extrapolated, to 1e-7
    # variances over signal; exponential heights of F^2 = 2 exceed it with e^-50
    max_pulse: float = 25.0
    blinking_fraction: float = 0.006  # outlying pixels of a dark before they count as its own tail
    max_fraction: float = 0.02  # outliers beyond which nothing is masked
    false_alarm: float = 0.05  # chance that a session has one valid pixel counted as blinking
    rate_variation: float = 3.0  # variation of the outlier rate over the image by shading
    min_pixels: int = 1024  # px; smallest image
    min_side_px: int = 16  # px; smallest side of an image
    sample: int = 2**14  # values of quantiles
    mean_stacks: int = 8  # stacks whose means are compared pixel by pixel
    replacement_px: int = 32  # px; distance of replacing pixels
    fine_units: float = 100.0  # smallest noise of continuous values, units
    listed: int = 10  # positions in a note


@dataclass(frozen=True, kw_only=True)
class PredictiveLimits:
    """Posterior predictive check (`predictive_check`, `predictive_frames`)."""

    false_alarm: float = 0.01  # false-alarm probability over all statistics of all levels
    replicates: int = 24  # replicates per level
    exposures: int = 8  # exposures per replicate
    side_px: int = 192  # px; side of the image centre
    levels: int = 3  # levels compared
    min_side_px: int = 96  # px; smallest image centre
    smoothing_px: int = 17  # px; smoothing of the illumination
    # relative variance of heights: from equal to slightly beyond exponential
    height_variances: tuple[float, float] = (0.0, 1.2)
    # third moment of pulse heights over the second, in second over first: below 2, that of
    # infinitely many pulses
    max_skewness: float = 1.9
    patch: int = 6  # squares; side of a patch
    tail_quantile: float = 0.999  # quantile of the tail statistic
    min_exposures: int = 4  # fewest exposures of flicker and temporal correlation


@dataclass(frozen=True, kw_only=True)
class EventLimits:
    """Single photoelectrons: flags and refusals (`events`)."""

    min_frames: int = 8  # fewest dark frames
    min_inside_px: int = 24  # px; smallest image inside the filter margins
    min_snr: float = 1.2  # matched-filter output of a mean pulse over its noise: refused below
    low_snr: float = 3.0  # the same: flagged below
    max_relative_sd: float = 0.4  # relative uncertainty of density or height: refused above
    high_relative_sd: float = 0.2  # the same: flagged above
    few_events: int = 200  # flagged below
    min_chi2_gain: int = 40  # smallest decrease of chi2 by pulses
    max_unchanged: float = 0.53  # unchanged values between frames, that of rounded noise of 0.5 DN
    blinking_fraction: float = 0.01  # blinking pixels
    clipped_fraction: float = 0.02  # bright values at full scale
    contaminated_fraction: float = 0.5  # values near ion feedback
    min_p_value: float = 1e-4  # p-value of a misfit
    max_reduced_chi2: float = 8.0  # refused above
    # detection probability without a sensor: open area, film, recovery
    detection_range: tuple[float, float] = (0.45, 1.0)
    max_frames: int = 64  # frames used
    max_values: int = 4_000_000  # pixel values used
    quick_values: int = 600_000  # pixel values of a first look
    bright_sd: float = 6.0  # standard deviations of a bright value
    blinking_false_alarm: float = 1e-3  # false-alarm probability of a blinking pixel per image
    lag_sd: float = 2.5  # standard errors of detected image lag
    skewness_sd: float = 3.0  # third moment of detected pulses, standard errors
    outlier_fraction: float = 2e-5  # or filtered pixels beyond `outlier_sd`
    outlier_sd: float = 6.0  # standard deviations
    rare_pulses: float = 0.01  # expected pulses per stack above the ion-feedback limit
    min_ion_sd: float = 15.0  # smallest ion feedback event over the filtered noise
    ion_exposures: int = 6  # exposures excluded after ion feedback, with image lag
    restart_p_value: float = 1e-3  # p-value below which a fit is repeated from other decays
    restart_fractions: tuple[float, float] = (0.2, 0.6)  # slow fractions of these
    start_slow_fraction: float = 0.4  # start value of the slow fraction
    start_decay: float = 1.0  # start value of the slow decay, exposures of one parity
    rounds: int = 2  # rounds of covariance and fit
    exponent_sd: float = 0.05  # uncertainty of a described exponent
    wings_relative_sd: float = 0.25  # uncertainty of described wings
    fast_relative_sd: float = 0.2  # uncertainty of a described fast decay
    # exposures, mean and sd of the fast decay without a sensor, interlaced
    fast_of_fields: tuple[float, float] = (0.06, 0.04)
    fast_of_frames: tuple[float, float] = (0.03, 0.1)  # the same, progressive


@dataclass(frozen=True, kw_only=True)
class EventAccuracy:
    """Grids and tolerances of the pulse model (`events`)."""

    gap_px: int = 3  # px; gap between box and background of a filter
    background_px: int = 8  # px; length of the background on each side
    model_relative_sd: float = 1e-3  # discretisation and shape of the spot
    start_widths_px: tuple[float, ...] = (0.3, 0.7, 1.3, 2.2)  # px; start values of the spot
    # start values of heights over pixel noise
    start_heights: tuple[float, ...] = 2.0, 5.0, 12.0, 30.0, 80.0, 200.0
    derivative_step: float = 4e-3  # step of numerical derivatives
    max_iterations: int = 60  # Gauss-Newton steps
    chi2_tolerance: float = 0.01  # decrease of chi2 that ends the optimisation
    rough_chi2_tolerance: float = 0.5  # the same of a rough one
    sample: int = 60_000  # values of a standard deviation or quantile
    skewness_block_px: int = 16  # px; blocks of the skewness error
    min_decay: float = 1e-3  # fraction down to which phosphor decay is followed
    max_exposures: int = 40  # exposures of decay
    start_times: int = 8  # quadrature points of the start time of pulses
    heights: int = 20  # quadrature points of the pulse-height distribution
    strong_direction: float = 4.0  # relative variance of directions taken from the model
    block_loss: float = 1.4  # factor of the block variance lost at block borders
    steps_per_px: int = 4  # positions per pixel
    spot_px: int = 18  # px; extent of a spot around the filter
    max_log_transfer: float = 3.0  # largest ln transfer
    nodes: int = 48  # amplitude nodes
    frequencies: int = 6  # frequencies of a characteristic function
    lowest_frequency: float = 0.5  # times the brightest thousandth
    highest_frequency: float = 1.3  # times the noise
    bin_width: float = 0.1  # bin over 1 / the highest frequency
    bins: int = 640  # bins; brighter values are summed individually
    block_px: int = 24  # px; blocks of the covariance
    block_exposures: int = 4  # exposures of a block, if correlated
    max_blocks: int = 3000  # blocks
    figure_noise_sd: float = 5.0  # figure: standard deviations below zero
    figure_heights: float = 10.0  # figure: mean pulses above zero
    figure_bins: int = 120  # figure: bins
    figure_points: int = 8192  # figure: points of the distribution
    figure_margin: float = 4.0  # figure: span over the range, against wrap-around


@dataclass(frozen=True, kw_only=True)
class GainLimits:
    """Gain of one setting (`gain`, `covariance_sum`)."""

    fit_fraction: float = 0.7  # EMVA 1288 Release 4, 6.5: fits up to 70 % of saturation
    same_level: float = 0.01  # relative difference of equal levels
    exponential_gain: float = 20.0  # register gain with exponential heights: F^2 within 5 % of 2
    min_stages: float = 400.0  # Robbins & Hadwen (2003): 400 to 600 stages
    level_fraction: float = 0.06  # deviation of a level's covariance over signal
    level_sd: float = 5.0  # standard errors of such a deviation
    rise_sd: float = 3.0  # standard errors of a significant rise
    max_relative_sd: float = 0.35  # skewed posterior with unreliable intervals
    min_bins: int = 24  # fewest frequency bins for five blur parameters
    min_blur_factor: float = 0.5  # below it charge diffusion (8 % per neighbour) is no explanation
    low_cy_per_px: float = 0.02  # cy/px; frequency of the filter's leading term
    # cycles per row; aliases of odd and even rows differ in sign beyond
    odd_lag_cy_per_row: float = 0.08
    lag_false_alarm: float = 3e-6  # false-alarm probability of image lag: 4.5 standard errors
    open_lag: float = 0.02  # mean correlation at the last lags of unfinished image lag
    first_lag: int = 2  # exposures; earlier lags include fast decay
    min_decay_lags: int = 3  # fewest lags of a decay
    amplitude_sd: float = 5.0  # half range of amplitudes, standard errors
    amplitudes: int = 32  # amplitudes per decay
    # cy/px; the widest described band is used
    band_limits_cy_per_px: tuple[float, ...] = (0.25, 0.21, 0.18, 0.15, 0.12, 0.1)
    min_p_value: float = 0.05  # p-value of an accepted fit
    misfit_p_value: float = 1e-4  # p-value of a misfit
    evidence_power: float = 0.5  # root of the evidence, as no blur model is exact
    min_weight: float = 0.01  # smallest weight of a blur model
    draws: int = 1000  # posterior draws of all models
    min_effective_samples: float = 1000.0  # converged importance sampling
    points: int = 8  # integration points per axis of the quarter plane
    subdivisions: int = 12  # subdivisions of a step at the band limit
    max_pulse_ratio: float = 0.3  # pulse power beyond the band over the floor
    beyond_band_sd: float = 0.5  # relative error of the aliased blur beyond the band
    floor_sd: float = 3.0  # standard deviations of a detected floor
    floor_draws: int = 60  # draws of the blur beyond the band
    smoothed_correlation: float = 0.03  # neighbour correlation of darks by electronics
    max_floor_range: float = 0.1  # range of K over the covariance gain that separates pulses


@dataclass(frozen=True, kw_only=True)
class GainPriors:
    """Priors of the blur models (`gain.model`): bounds, or mean and standard deviation."""

    exponent_bounds: tuple[float, float] = (0.7, 2.5)
    exponent: tuple[float, float] = (1.3, 0.2)  # image tubes: 1.1 to 1.7
    tail_bounds: tuple[float, float] = (0.01, 3.0)
    tail: tuple[float, float] = (0.33, 0.33)  # 1/3 for exp(-r/a), 0 for a Gaussian
    electron_bounds: tuple[float, float] = (-0.5, 1.0)  # negative values avoid a bias at 0
    # K / (K + k F^2), if a white floor can be measured
    electron_fraction: tuple[float, float] = 0.0, 10.0
    # else: a photoelectron makes some hundred electrons
    few_electrons: tuple[float, float] = 0.003, 0.01
    fall_bounds: tuple[float, float] = (-1.0, 6.0)
    strength_bounds: tuple[float, float] = (-1.5, 6.0)
    tail_strength_bounds: tuple[float, float] = (0.0, 20.0)  # widest blur separable from shading
    spread_bounds: tuple[float, float] = (0.0, 0.6)  # fraction of an extended component
    # falls of extended Gaussians of 1.6 to 4.5 px
    spread_falls: tuple[float, ...] = 1.0, 2.8, 8.0
    spread_step: float = 1.7  # ratio halfway to the next fall
    spread_sd: float = 3.0  # standard errors of a fraction whose fall is fitted too
    reference_cy_per_px: float = 0.1  # cy/px; frequency of the falls
    max_log_transfer: float = 1.0  # upper limit of ln |H|^2 outside the fitted range
    min_tail: float = 1e-6  # equivalent to no tail to six digits
    min_transfer: float = 1e-9  # keeps the logarithm finite


@dataclass(frozen=True, kw_only=True)
class SnrLimits:
    """Signal-to-noise ratio and illumination (`snr`)."""

    interpolation_factor: float = 10.0  # dimmest flat over light: extrapolated beyond
    max_factor_below: float = 100.0  # dimmest flat over light: refused beyond
    max_factor_above: float = 2.0  # light over brightest flat: refused beyond
    max_unreached: float = 0.01  # draws that reach the ratio at no light
    # prior of the relative nonlinearity of shot noise at the brightest level
    nonlinearity_sd: float = 0.1
    min_p_value: float = 1e-4  # p-value of a misfit
    misfit_fraction: float = 0.03  # smallest misfit, fraction of the variance
    lit_sd: float = 5.0  # standard errors of an illuminated level
    draws: int = 2000  # posterior draws
    separation_draws: int = 4000  # posterior draws of separated gains
    min_agreement: float = 0.01  # effective fraction of draws of consistent light and pulses
    bins: int = 24  # bins of the detection probability
    squares: int = 6  # smallest image side, squares
    # relative deviation of levels from linear, log-uniform prior
    departure_range: tuple[float, float] = 1e-3, 0.1
    departures: int = 41  # grid points of this prior


@dataclass(frozen=True, kw_only=True)
class SweepLimits:
    """Gain sweep (`sweep`)."""

    min_loss: float = 0.01  # lower limit of a detected gain loss
    loss_sd: float = 4.0  # standard errors of a detected gain loss
    mcp_exponent: float = 1.0  # covariance over signal against response: MCP saturation
    camera_exponent: float = 3.0  # the same: camera nonlinearity (squared slope over signal)
    agreement_sd: float = 2.5  # standard errors of agreement with an exponent
    outlier_sd: float = 5.0  # standard errors of an outlying setting
    dark_model_sd: float = 0.02  # relative model error of the dark variance
    same_setting: float = 2e-3  # relative repeatability of settings
    same_setting_db: float = 0.05  # dB; repeatability of settings
    # median deviation of a setting in ln gain: supplies 1e-3, gain to the tenth power
    departure: float = 0.04
    departure_spread: float = 0.5  # standard deviation of its logarithm
    electron_fraction: float = 0.05  # electron noise over covariance gain, width of the prior
    max_electron_fraction: float = 0.9  # upper bound of the same
    # difference of blur between settings: blur arises behind the MCP
    blur_relative_sd: float = 0.02
    curvature: float = 0.03  # deviation of a parabola from its best line in ln gain
    curvature_sd: float = 3.0  # standard errors of the same
    light_sd: float = 0.03  # repeatability of lamps and filters in ln signal
    # gain loss at the brightest level, several lights at one setting
    loss_bounds: tuple[float, float] = -0.3, 0.95
    loss_sd_single_light: float = 0.1  # prior width otherwise: degenerate with the gain law
    min_light_ratio: float = 1.5  # ratio of lights that measures the loss
    max_quantisation: float = 0.02  # unreported quantisation noise, fraction of the variance


@dataclass(frozen=True, kw_only=True)
class DataSheetLimits:
    """Data sheet of EMVA 1288 Release 4.0 Linear (`data_sheet`, `nonuniformity`)."""

    levels: int = 50  # 6.5: fewest levels of light
    frames: int = 16  # 8.2: fewest frames of the stacks of the nonuniformity
    half: tuple[float, float] = 0.4, 0.6  # 8.2: signal of the flat at half of saturation over it
    exposures: int = 6  # 7.1: fewest exposures of the dark current
    full_fraction: float = 0.001  # 6.6: pixels at the largest value at the saturation exposure
    linear: tuple[float, float] = 0.05, 0.95  # 6.9: range of the linearity over saturation
    draws: int = 1000  # draws of the levels
    limit_sd: float = 3.0  # standard errors of the limit of a hidden pattern
    small_shift: float = 0.02  # shift of a nonuniformity over its 95 % interval that needs no note
    quantiles: tuple[float, ...] = 0.025, 0.16, 0.84, 0.975  # limits of both intervals
    points: int = 256  # figure: groups of lines of a profile
    bins: int = 128  # figure: bins of a histogram; the standard has at most 256


SCENE = SceneLimits()
CHECKS = CheckLimits()
CORRELATION = CorrelationLimits()
AGREEMENT = AgreementLimits()
DARK_CURRENT = DarkCurrentLimits()
SURVEY = SurveyLimits()
PREDICTIVE = PredictiveLimits()
EVENTS = EventLimits()
EVENT_ACCURACY = EventAccuracy()
GAIN = GainLimits()
GAIN_PRIORS = GainPriors()
SNR = SnrLimits()
SWEEP = SweepLimits()
DATA_SHEET = DataSheetLimits()
