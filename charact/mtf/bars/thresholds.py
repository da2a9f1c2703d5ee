"""Thresholds and numerical settings of bar targets, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BarLimits:
    """Thresholds that decide about flags, refusals and candidates of bar targets."""

    # Bar length over bar width of the standard target (STANAG 4349).
    length_over_width: float = 7.0
    # The standard length is kept if it reaches this fraction of the best match.
    min_length_match: float = 0.9
    # Bars of the largest chart target (ISO 12233: 5 to 9, NBS 1963A: 15), with a factor of four.
    max_bars: int = 60
    # Fraction of a profile's variance that N blurred bars must explain; an edge or a spot leaves more than half.
    min_explained: float = 0.6
    # Relative to the best explanation; side lobes occasionally explain as much.
    min_relative_explained: float = 0.9
    # Relative offset of a spectral peak from the stated frequency: the width f/N of three bars.
    max_frequency_offset: float = 0.15
    # Fraction of the maximum amplitude at the border of a uniform patch: one half.
    patch_level: float = 0.5
    # Fundamental of a target, standard uncertainties; noise alone reaches about 5.
    min_signal_sd: float = 5.0
    # Light of bars that cross the region, standard uncertainties.
    min_light_sd: float = 9.0
    # Zeros adjacent to the fundamental, over it: above this another object.
    max_zeros: float = 0.5
    # The same, standard uncertainties.
    max_zeros_sd: float = 3.5
    # Significance from which the zeros give the frequency better than the stated one.
    min_frequency_signal_sd: float = 30.0
    # Relative change of the frequency that is reported.
    frequency_tolerance: float = 0.01
    # A smaller margin cuts off the core's blur, not only a halo, px.
    min_margin_px: float = 5.0
    # Relative uncertainty of the MTF by quantisation; more is beyond first order.
    max_rounding_sd: float = 0.1
    # Other light over the target's height.
    max_other_light: float = 0.04
    # Noise that quantisation hides, DN.
    hidden_noise_dn: float = 0.4
    # Noise over the bars' height below the error of the image's table.
    hidden_noise_fraction: float = 1e-3
    # Zeros adjacent to the fundamental, over it: above this another frequency.
    suspect_zeros: float = 0.15
    # Modulus half way to the lower zero over that expected; twice as many bars have none.
    min_flank: float = 0.6
    # Displacement between fields, px.
    max_field_offset_px: float = 0.04
    # Sine of the direction up to which bars count as upright.
    max_upright_sine: float = 0.5
    # Significance of a finding, standard uncertainties.
    significant_sd: float = 5.0
    # Distance of fundamental and alias, in widths of either: two lobes that overlap by a tenth of their rims.
    min_alias_distance: float = 1.8
    # Displacement of tilted bars over their rows that averages the alias, px.
    min_travel_px: float = 0.8
    # Second harmonic over the fundamental of slightly unequal bars and gaps.
    max_second_harmonic: float = 0.006
    # Its noise, standard uncertainties.
    max_second_harmonic_sd: float = 3.5
    # Residual profile over the bars' height.
    max_misfit: float = 0.02
    # Model departure over its prior.
    max_departure_sd: float = 3.5
    # MTF in standard uncertainties, below which it is an upper limit; a limit of two passes too many by chance.
    min_mtf_sd: float = 3.0
    # Other light above the smoothed background, robust standard deviations.
    max_other_sd: float = 6.0
    # Preference for another model than the tube; it widens the intervals.
    min_model_preference_sd: float = 3.0
    # Upper bound of a sampled MTF.
    max_mtf: float = 1.5
    # Distance of the draws from the fit, standard deviations.
    max_posterior_offset_sd: float = 2.0
    # Modulation of the first-term method, standard uncertainties.
    min_modulation_sd: float = 6.0
    # Contrast of the profile method, standard uncertainties; noise has peaks below it.
    min_contrast_sd: float = 12.0
    # p-value of chi squared of the groups.
    min_group_p_value: float = 0.001
    # Directions of one curve, deg.
    max_direction_spread_deg: float = 15.0
    # Angle to the rows or columns of their curve, deg.
    max_axis_angle_deg: float = 30.0
    # Closer frequencies count as one.
    min_frequency_ratio: float = 1.1
    # Fraction of draws without an MTF50.
    max_lost_draws: float = 0.02
    # MTF50 may lie beyond the groups by this factor.
    max_extrapolation: float = 1.5
    # Correlation of neighbours from which that applies.
    long_correlation: float = 0.2
    # Significance of row noise, standard uncertainties.
    min_row_noise_sd: float = 6.0
    # Height of background pixels over that of the bars.
    max_background_height: float = 0.1
    # Chi squared over that of the fit beyond which another number is not fitted.
    max_count_chi2_ratio: float = 2.0
    # Chi squared that another number must save, over the correlation sum.
    min_count_chi2_gain: float = 25.0
    # Or this fraction of all of it.
    min_count_chi2_fraction: float = 1.0 / 3.0
    # Significance of missing light, standard uncertainties.
    min_sharpening_sd: float = 3.5
    # Missing fraction of a copy; the image's table errs by a few ten-thousandths.
    min_sharpening: float = 3e-3
    # Squared fraction of a copy that the parameters do not absorb.
    min_independent_fraction: float = 1e-5
    # Match of a strip, standard uncertainties; noise alone does not reach it.
    min_strip_match_sd: float = 6.0
    # Light at both ends of a region over that in its centre, of bars that cross it.
    min_end_light: float = 0.6
    # Background beyond the last gap that counting needs, periods.
    min_background_periods: float = 0.0
    # Height of background pixels over that of the bars.
    max_flat_height: float = 0.1
    # Exponent of the covariance: standard uncertainties (stated a fifth too large) and tolerance.
    neighbour_power: tuple[float, float] = (2.3, 0.02)
    # Exponent of the variance, which read-out noise and PRNU change, likewise.
    pixel_power: tuple[float, float] = (3.0, 0.05)
    # Significance of the noise's scale, standard uncertainties.
    min_power_sd: float = 4.0
    # Light over noise of single frames beyond which PRNU shows.
    max_single_frame_snr: float = 30.0
    # Noise that quantisation leaves unchanged, DN.
    min_noise_dn: float = 0.5
    # Significance of a curvature, standard uncertainties.
    max_curvature_sd: float = 3.5
    # Response of the matched filter, robust standard deviations; noise over a frame stays below it.
    min_filter_response: float = 8.0
    # Relative search range of the frequency.
    max_frequency_error: float = 0.06


@dataclass(frozen=True)
class BarAccuracy:
    """Sampling, iteration limits, tolerances and resolution of bar targets."""

    # Spectral peaks tried: bars, harmonics, and the patch along and across them.
    spectral_peaks: int = 8
    # Standard deviation of the demodulation filter, periods; it leaves 1e-3 of the patch's own light.
    smoothing_periods: float = 0.6
    # The extent of a patch gives the number of bars within this.
    count_range: int = 2
    # Margin of the fitted window, px.
    fit_margin_px: float = 20.0
    # The same, periods.
    fit_margin_periods: float = 1.5
    # Frames whose scatter gives the noise.
    min_covariance_frames: int = 4
    # Frames from which image lag is estimated.
    min_lag_frames: int = 7
    # Length of the slabs along the bars, px.
    slab_px: float = 4.0
    # Smoothing of that background, px.
    other_smoothing_px: float = 2.0
    # Margin excluded around other light, px.
    other_margin_px: int = 8
    # Finite difference of the shape parameters.
    shape_step: float = 0.1
    # Finite difference of the position, periods.
    position_step_periods: float = 0.06
    # The same, at most, px.
    max_position_step_px: float = 0.25
    # Relative uncertainty below which the bias, of the order of its square, is under a thousandth.
    negligible_bias_sd: float = 0.015
    # Gauss-Newton iterations.
    fit_iterations: int = 12
    # Gain in chi squared at which a fit has converged.
    fit_tolerance: float = 3e-3
    # The same for a rough fit.
    rough_tolerance: float = 0.1
    # Iterations before a hopeless fit is abandoned.
    give_up_after: int = 2
    # Fractions of a step that are tried.
    step_fractions: tuple[float, ...] = (1.0, 0.4, 0.1, 0.02)
    # A model of less weight changes no interval.
    min_model_weight: float = 0.01
    # Frequencies over the bar frequency at which models are matched.
    matched_range: tuple[float, float] = (0.02, 3.0)
    # Number of them.
    matched_points: int = 40
    # Variance over the squared bar height that corresponds to the error of the image's table.
    min_variance: float = 1e-8
    # Tabulated range of attenuation and exponent, standard deviations.
    table_range_sd: float = 4.0
    # Points of the table along either.
    table_points: int = 7
    # Degree of the interpolating polynomial.
    table_degree: int = 4
    # Width of a flat prior, standard deviations of the estimate.
    flat_prior_sd: float = 100.0
    # Relative error of the MTF by interpolation in the image's table.
    image_table_sd: float = 3e-4
    # Effective sample size of a quick answer.
    quick_ess: float = 500.0
    # Highest order of Coltman's series.
    series_order: int = 201
    # Pixels this close to the centre of a bar or gap are averaged, periods.
    extremum_periods: float = 0.06
    # Fraction of the bars' length that is used.
    inner_length: float = 0.3
    # Steps of matching one blur model to another.
    matching_steps: int = 12
    # Highest frequency of the image's spectrum across the bars, cy/px.
    max_frequency_across: float = 1.5
    # The same along the bars, cy/px.
    max_frequency_along: float = 1.0
    # Distance of the table's rows at the bars' ends, px.
    row_step_px: float = 0.18
    # Growth of that distance per px from the ends.
    row_step_growth: float = 0.08
    # Points of the table per period; linear interpolation errs by a few ten-thousandths.
    points_per_period: int = 100
    # Transfer at the bar frequency from which a fit starts.
    start_transfer: float = 0.4
    # Pixels used for motion beyond the outer bars, periods.
    motion_margin_periods: float = 0.5
    # Exponent of the tube in the figure.
    figure_exponent: float = 1.2
    # Range of the noise correlation, px.
    correlation_px: int = 2
    # Its range where neighbours are strongly correlated, px.
    long_correlation_px: int = 4
    # Lags along a row at which only row noise is common, px.
    row_lags_px: tuple[int, ...] = (8, 12, 16)
    # Background pixels that row noise needs.
    min_background_pixels: int = 300
    # Frames from which the correlation is taken.
    max_correlation_frames: int = 6
    # Shifts at which another number of bars is tried, periods.
    count_shifts_periods: tuple[float, ...] = (-0.5, 0.0, 0.5)
    # Standard deviations of the blurred copies, px.
    sharpening_widths_px: tuple[float, ...] = (2.0, 4.0, 8.0)
    # Bins of a strip's profile, px.
    profile_bin_px: float = 0.5
    # An end is this part of the region.
    end_divisor: int = 8
    # Trial blurs, standard deviations in periods: MTF of 0.88 to 0.02.
    trial_blurs: tuple[float, ...] = (0.08, 0.16, 0.24, 0.34, 0.44)
    # Points of the profile per period.
    profile_points_per_period: float = 12.0
    # Background in the profile, periods.
    profile_margin_periods: float = 1.2
    # Fraction of the patch's length that is used.
    profile_inner_length: float = 0.4
    # Lag of neighbours along a row, px.
    neighbour_lag_px: int = 1
    # Lags at which only row noise is common, px.
    distant_lags_px: tuple[int, ...] = (8, 9, 10)
    # Light over the brightest below which the black level is too uncertain.
    min_light: float = 0.01
    # Curvature that the blur of several stages mimics.
    curvature_floor: float = 0.01
    # Prior probability of a nonlinear response; one in four, as for edges, gave 73 % coverage of 68 % intervals of
    # strips.
    nonlinear_prior: float = 0.1
    # Starting exponents.
    power_starts: tuple[float, ...] = (0.0, 1.0, 2.0)
    # Gauss-Newton iterations.
    power_iterations: int = 60
    # Longest step.
    max_power_step: float = 1.0
    # Step at which they end.
    power_tolerance: float = 1e-5
    # Margin beyond a halo, px.
    halo_margin_px: float = 12.0
    # Smallest margin, px.
    window_margin_px: float = 12.0
    # Draws over the ranges of a sensor description.
    description_draws: int = 200


LIMITS = BarLimits()
ACCURACY = BarAccuracy()
