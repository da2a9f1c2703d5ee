"""Thresholds and numerical settings of bar targets, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BarLimits:
    """Thresholds that decide about flags, refusals and candidates of bar targets."""

    length_over_width: float = 7.0  # Bar length over bar width of the standard target (STANAG 4349)
    # The standard length is kept if it reaches this fraction of the best match
    min_length_match: float = 0.9
    # Bars of the largest chart target (ISO 12233: 5 to 9, NBS 1963A: 15), with a factor of four
    max_bars: int = 60
    # Fraction of a profile's variance that N blurred bars must explain; an edge or a spot leaves
    # more than half.
    min_explained: float = 0.6
    # Relative to the best explanation; side lobes occasionally explain as much
    min_relative_explained: float = 0.9
    # Relative offset of a spectral peak from the stated frequency: the width f/N of three bars.
    max_frequency_offset: float = 0.15
    # Fraction of the maximum amplitude at the border of a uniform patch: one half
    patch_level: float = 0.5
    # Fundamental of a target, standard uncertainties; noise alone reaches about 5
    min_signal_sd: float = 5.0
    min_light_sd: float = 9.0  # Light of bars that cross the region, standard uncertainties
    max_zeros: float = 0.5  # Zeros adjacent to the fundamental, over it: above this another object
    max_zeros_sd: float = 3.5  # The same, standard uncertainties
    # Significance from which the zeros give the frequency better than the stated one.
    min_frequency_signal_sd: float = 30.0
    frequency_tolerance: float = 0.01  # Relative change of the frequency that is reported
    min_margin_px: float = 5.0  # A smaller margin cuts off the core's blur, not only a halo, px
    # Light that blur models may have beyond the window: lenses leave up to 0.06 further than 6 px,
    # and scatter tails of 18 % further than 11 px
    max_extrapolated_light: float = 0.06
    # Relative uncertainty of the MTF by quantisation; more is beyond first order
    max_rounding_sd: float = 0.1
    max_other_light: float = 0.04  # Other light over the target's height
    hidden_noise_dn: float = 0.4  # Noise that quantisation hides, DN
    # Noise over the bars' height below the error of the image's table
    hidden_noise_fraction: float = 1e-3
    # Zeros adjacent to the fundamental, over it: above this another frequency
    suspect_zeros: float = 0.15
    # Modulus half way to the lower zero over that expected; twice as many bars have none
    min_flank: float = 0.6
    max_field_offset_px: float = 0.04  # Displacement between fields, px
    max_upright_sine: float = 0.5  # Sine of the direction up to which bars count as upright
    significant_sd: float = 5.0  # Significance of a finding, standard uncertainties
    # Distance of fundamental and alias, in widths of either: two lobes that overlap by a tenth of
    # their rims.
    min_alias_distance: float = 1.8
    # Displacement of tilted bars over their rows that averages the alias, px
    min_travel_px: float = 0.8
    # Second harmonic over the fundamental of slightly unequal bars and gaps
    max_second_harmonic: float = 0.006
    max_second_harmonic_sd: float = 3.5  # Its noise, standard uncertainties
    max_misfit: float = 0.02  # Residual profile over the bars' height
    max_departure_sd: float = 3.5  # Model departure over its prior
    # MTF in standard uncertainties, below which it is an upper limit; a limit of two passes too
    # many by chance.
    min_mtf_sd: float = 3.0
    # Other light above the smoothed background, robust standard deviations
    max_other_sd: float = 6.0
    max_mtf: float = 1.5  # Upper bound of a sampled MTF
    # Larger values are refused: the MTF is at most 1, and sharpening cameras reach this at most
    max_reported_mtf: float = 1.1
    min_group_p_value: float = 0.001  # p-value of chi squared of the groups
    max_direction_spread_deg: float = 15.0  # Directions of one curve, deg
    max_axis_angle_deg: float = 30.0  # Angle to the rows or columns of their curve, deg
    min_frequency_ratio: float = 1.1  # Closer frequencies count as one
    max_lost_draws: float = 0.02  # Fraction of draws without an MTF50
    max_extrapolation: float = 1.5  # MTF50 may lie beyond the groups by this factor
    long_correlation: float = 0.2  # Correlation of neighbours from which that applies
    min_row_noise_sd: float = 6.0  # Significance of row noise, standard uncertainties
    max_background_height: float = 0.1  # Height of background pixels over that of the bars
    # Chi squared over that of the fit beyond which another number is not fitted
    max_count_chi2_ratio: float = 2.0
    # Chi squared that another number must save, over the correlation sum
    min_count_chi2_gain: float = 25.0
    min_count_chi2_fraction: float = 1.0 / 3.0  # Or this fraction of all of it
    # Overshoot of both sides of a step that is sharpening, fraction of the step: forms fitted to
    # rays of lenses overshoot by up to 0.022, unsharp masks of amount 0.8 by 0.03
    min_overshoot: float = 0.025
    # Attenuation at the bars of hardly any blur: lenses and filters of 0.2 px have 0.005 and more.
    # Summed correlation of residuals that are no noise: of pixels alone up to 1.2
    min_attenuation: float = 1e-3
    max_correlation_sum: float = 3.0
    overshoot_sd: float = 2.0  # Its significance for so large a size, standard uncertainties
    max_even_height: float = 0.02  # Height of pixels without structure over that of the bars
    # Match of a strip, standard uncertainties; noise alone does not reach it
    min_strip_match_sd: float = 6.0
    # Light at both ends of a region over that in its centre, of bars that cross it
    min_end_light: float = 0.6
    # Chi squared of the likeliest form over that of the first, below which the noise of a single
    # frame, read off the first one's residuals, is read again
    max_cost_ratio: float = 0.95
    # Background beyond the last gap that counting needs, periods
    min_background_periods: float = 0.0
    # Exponent of the covariance: standard uncertainties (stated a fifth too large) and tolerance.
    neighbour_power: tuple[float, float] = (2.3, 0.02)
    # Exponent of the variance, which read-out noise and PRNU change, likewise.
    pixel_power: tuple[float, float] = (3.0, 0.05)
    min_power_sd: float = 4.0  # Significance of the noise's scale, standard uncertainties
    max_single_frame_snr: float = 30.0  # Light over noise of single frames beyond which PRNU shows
    min_noise_dn: float = 0.5  # Noise that quantisation leaves unchanged, DN
    max_curvature_sd: float = 3.5  # Significance of a curvature, standard uncertainties
    # Curvature up to which that series holds: a response of one is no longer rising
    max_curvature: float = 0.5
    # Change of ln MTF by a curvature up to which its series of first order holds: within a seventh
    # at 0.2 (test_nonlinearity); one wide bar taken for four has more
    max_curvature_lift: float = 0.25
    # Response of the matched filter, robust standard deviations; noise over a frame stays below it.
    min_filter_response: float = 8.0
    max_frequency_error: float = 0.06  # Relative search range of the frequency


@dataclass(frozen=True)
class BarAccuracy:
    """Sampling, iteration limits, tolerances and resolution of bar targets."""

    # Standard deviation of the demodulation filter, periods; it leaves 1e-3 of the patch's own
    # light.
    smoothing_periods: float = 0.6
    count_range: int = 2  # The extent of a patch gives the number of bars within this
    min_lag_frames: int = 7  # Frames from which image lag is estimated
    other_margin_px: int = 8  # Margin excluded around other light, px
    shape_step: float = 0.1  # Finite difference of the shape parameters
    rough_tolerance: float = 0.1  # Gain of chi squared that ends a rough fit
    # The same of a first fit, in variances of the image: the noise is read off its residuals
    first_tolerance: float = 3e-4
    min_model_weight: float = 0.01  # A model of less weight changes no interval
    # Variance over the squared bar height that corresponds to the error of the image's table.
    min_variance: float = 1e-8
    # Highest frequencies of the image's spectrum across and along the bars, cy/px: of a blur whose
    # transfer is negligible at 1 cy/px, and of a sharper one, which is that of the pixel
    negligible_transfer: float = 0.01
    highest_cy_per_px: tuple[float, float] = 1.5, 1.0
    highest_sharp_cy_per_px: tuple[float, float] = 4.0, 3.0
    # Relative error of the MTF by forms that are not quite the blur: 0.0015 rms of the pictures of
    # outside programs whose noise leaves less; the image's table errs by 0.0003
    form_sd: float = 1e-3
    row_step_px: float = 0.18  # Distance of the table's rows at the bars' ends, px
    row_step_growth: float = 0.08  # Growth of that distance per px from the ends
    correlation_px: int = 2  # Range of the noise correlation, px
    long_correlation_px: int = 4  # The same of noise that is correlated over more than neighbours
    min_background_pixels: int = 300  # Background pixels that row noise needs
    # Shifts at which another number of bars is tried, periods.
    count_shifts_periods: tuple[float, ...] = (-0.5, 0.0, 0.5)
    profile_bin_px: float = 0.5  # Bins of a strip's profile, px
    # Trial blurs, standard deviations in periods: MTF of 0.88 to 0.02.
    trial_blurs: tuple[float, ...] = (0.08, 0.16, 0.24, 0.34, 0.44)
    neighbour_lag_px: int = 1  # Lag of neighbours along a row, px
    # Prior probability of a nonlinear response; one in four, as for edges, gave 73 % coverage of 68
    # % intervals of strips.
    nonlinear_prior: float = 0.1
    power_starts: tuple[float, ...] = (0.0, 1.0, 2.0)  # Starting exponents
    power_range: float = 20.0  # Range of exponent and ln scale about the start
    description_draws: int = 200  # Draws over the ranges of a sensor description


LIMITS = BarLimits()
ACCURACY = BarAccuracy()
