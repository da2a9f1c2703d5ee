"""Thresholds and numerical settings of the edge methods, each with its meaning and source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EdgeThresholds:
    """Decide flags, refusals and which models are fitted; set on simulated edges where no source is
    named.
    """

    # Excess of reduced chi squared and of other steps, standard errors: chance below 1e-4
    misfit_sd: float = 4.0
    bow_sd: float = 3.5  # Bow or wave of the edge's rows, standard errors: chance 5e-4
    bow_px: float = 0.12  # Bow or wave that matters to MTF50, px (simulated edges)
    # Fraction of a bend that a line which follows it may miss: a judgement, not measured
    followed_bend: float = 0.05
    # Scatter of a closed edge's sectors about its harmonics, px: squares of 30 px leave 1
    rim_scatter_px: float = 0.3
    rim_ovality: float = 0.15  # Amplitudes of its harmonics, fraction of its radius
    rim_value_range: float = 0.6  # Range of the values on a side of it, fraction of the step
    # Pixels that the edge crosses along its length: fewer leave gaps between samples
    min_travel_px: float = 1.0
    # Reduced chi squared that a sufficient blur model reaches (simulated edges)
    max_reduced_chi2: float = 1.6
    # Change of illumination over the band, fraction of the step (simulated edges)
    max_gradient: float = 0.2
    # Fraction of it that a fit takes for light of the edge, and the change, fraction of the step,
    # up to which that holds: chosen on 40 edges of three blurs, of which 39 intervals then held
    gradient_leak: float = 0.1
    max_fitted_gradient: float = 0.8
    # Step over the noise of a pixel: below it the interval's limits are unreliable
    min_step_sd: float = 0.8
    # Noise of one frame below which a plateau may lie anywhere in a step, DN (simulated edges).
    quantisation_noise_dn: float = 0.45
    # Relative bias of MTF50 by such plateaus, times the step, at most, DN: 1.7 on 200 simulated
    # edges of steps of 12 to 120 DN by each of four methods
    quantisation_bias_dn: float = 2.0
    # Overshoot of both plateaus together that is sharpening, fraction of the step: bins and
    # gradients leave 0.004 (study strangers_edges).
    min_overshoot: float = 0.01
    overshoot_sd: float = 5.0  # Its significance, standard errors: chance 5e-5 an edge
    conventional_rows: int = 20  # Rows that the conventional methods need
    conventional_cols: int = 16  # Columns that the conventional methods need
    # Step over the noise of a pixel below which noise biases them
    conventional_min_snr: float = 8.0
    conventional_step_sd: float = 3.0  # Step over the noise of a pixel below which they are refused
    # Step below which half a DN at a plateau matters compared with their bias, DN
    coarse_step_dn: float = 40.0
    # Relative loss of MTF50 by motion from which on the noise on slopes is no test
    conventional_motion: float = 0.01
    # Model departures from which on a defocused or obscured pupil is fitted, standard deviations.
    pupil_departure_sd: float = 1.0
    # Weight of a blur model below which it is left out of the average
    min_model_weight: float = 0.02
    # Power of the evidence: no model is exact, and the noise is estimated (doi 10.1214/17-BA1085).
    evidence_power: float = 0.7
    component_chi2: float = 6.0  # Gain in chi squared from which on an extended component is fitted
    component_bayes_factor: float = 0.6  # Bayes factor from which on it is fitted with less
    # The same gain where only an illumination gradient makes room for it
    component_in_gradient_chi2: float = 3.0
    # Ln evidence below the best within which a model is pursued
    competitive_ln_evidence: float = 8.0
    # Half width of a window that separates a disc from the core, px
    min_window_disc_px: float = 6.0
    # Half width of a window that separates halo or scatter from a disc, px
    min_window_halo_px: float = 16.0
    # Ln evidence below the best within which an illumination gradient is tried
    gradient_ln_evidence: float = 4.0
    max_start_chi2: float = 100.0  # Chi squared above the best from which on a start is abandoned
    # Model departures beyond noise that are a misfit, standard deviations
    departure_sd: float = 4.5
    # Ln evidence below the best within which a tail of the line spread is pursued
    competitive_setting: float = 6.0
    # Weight of a setting below which it is left out of the average
    min_setting_weight: float = 0.01
    curvature: float = 0.05  # Curvature of the camera response that moves the MTF by a percent
    curvature_sd: float = 3.0  # Its significance, standard errors
    # Relative bias of MTF50 by exponents up to 2.2 at contrast one; scales as contrast squared
    # (simulated edges).
    max_nonlinearity_bias: float = 0.23
    # Signal over noise of a pixel beyond which PRNU may dominate the noise
    photon_noise_snr: float = 80.0
    # Weight of glare wider than the window from which on the window is too small
    unresolved_glare_weight: float = 0.65
    # Fraction of a component's sizes that a window does not separate from unresolved glare
    widest_sizes: float = 0.15
    # Half frequency of a core that the pixel aperture hides: its posterior is not Gaussian, cy/px.
    sharp_half_frequency: float = 0.5
    # Relative uncertainty of MTF50 from which on the posterior is not Gaussian
    skewed_sd: float = 0.1
    uninformative_sd: float = 0.15  # That from which on no interval is reliable, whatever its tails
    # Displacement of fields that counts, standard errors of few rows
    field_displacement_sd: float = 3.5
    field_displacement_px: float = 0.04  # Displacement of fields that matters, px
    # Gain in chi squared of a correlation model with four parameters
    correlation_chi2: float = 25.0
    # Departure from the correlation model that is kept, standard errors: chance 1e-3 a frame.
    correlation_departure_sd: float = 4.7
    # Correlation that is kept where the model does not hold, standard errors
    correlation_sd: float = 2.5
    # Mean square of its departures there, in squared standard errors
    correlation_misfit: float = 4.0
    min_half_width_px: float = 3.0  # Least plateau on either side, px
    min_side_pixels: int = 16  # Least pixels on either side
    min_edge_chi2: float = 90.0  # Gain in chi squared of an edge: a search of noise finds up to 40
    no_edge_reduced_chi2: float = 1.5  # Reduced chi squared of what is not an edge
    # And the fraction of chi squared that the best step leaves unexplained
    no_edge_fraction: float = 0.2
    noisy_step_sd: float = 8.0  # Step over the noise of a pixel below which wider bins lose nothing
    min_defect: float = 0.02  # Deviation of a defective pixel that matters, fraction of the step
    # Fraction of a bin's pixels from which on they are no defects: those are single pixels (a
    # judgement)
    defects_of_bin: float = 0.25
    # Fraction of the pixels beyond 5 standard deviations that must be defects, else the noise is
    # heavy-tailed.
    defect_fraction: float = 0.5
    # Fraction of a gradient by which both sides may differ: stray light is the same on both.
    gradient_asymmetry: float = 0.2
    # Relative uncertainty beyond which the tails depend on the prior, at four standard errors.
    max_relative_sd: float = 0.14
    # Power of the light with which noise must grow under a linear response: photons under a gamma
    # of 1.8 reach 0.2
    linear_noise_power: float = 0.25
    max_noise_contrast: float = (
        0.82  # Contrast beyond which the dark side's noise is read-out noise
    )
    falling_noise_sd: float = 3.0  # Fall of the noise towards the light, standard errors: .1 %


@dataclass(frozen=True)
class EdgeAccuracy:
    """Bounds draws, iterations, windows and tolerances."""

    bow_blocks: int = 12  # Blocks of rows whose scatter tests for a bow
    rim_reach_px: float = 8.0  # Distance from a closed edge of pixels that place it, px
    rim_iterations: int = 4  # Gauss-Newton steps that place it
    rim_sectors: int = 32  # Sectors whose scatter tests its shape
    bow_lags: int = 5  # Lags at which displacements of rows may be correlated, rows
    # Distance from the edge of pixels that show a displacement of fields, px
    field_distance_px: float = 8.0
    overshoot_bins: int = 6  # Bins of a plateau below which no overshoot is tested
    overshoot_window_px: float = 0.5  # Half width of the mean whose maximum is the overshoot, px
    # Distances at which an edge overshoots, times MTF50
    overshoot_range: tuple[float, ...] = 0.35, 1.2
    # Distances of the plateau that it is compared with, times MTF50
    plateau_range: tuple[float, ...] = 2.0, 7.0
    # Distance from a level within which a pixel belongs to the plateau, fraction of the step.
    sharpening_plateau: float = 0.1
    jackknife_blocks: int = 20  # Blocks of rows of the jackknife
    # Range of frequency around a crossing over which the slope is fitted, fraction
    crossing_range: float = 0.3
    min_crossing_slope: float = 0.1  # Least slope of the MTF there, times the frequency
    max_shift_px: float = 6.0  # Bound of the edge's shift, px
    fit_iterations: int = 30  # Gauss-Newton steps of a fit
    component_sizes: int = 9  # Sizes of an extended component among which a fit begins
    first_iterations: int = 5  # Steps after which one of several starts is chosen
    size_separation: float = 0.5  # Ln of the ratio of two sizes whose fits may end apart
    forward_ess: float = 500.0  # Effective draws of a quick posterior of the forward method
    forward_first_draws: int = 1000  # Draws that it begins with
    # Steps of its chain: with a halo single walkers stay in a tail for some thousand steps
    forward_steps: int = 8000
    node_spacing_px: float = 0.2  # Spacing of the line spread's nodes near the edge, px
    node_spacing: float = 0.09  # Spacing farther out, fraction of the distance
    # Light beyond the region, times that of its outer half: a tube's tail holds 0.9, and plateau
    # levels hide half as much.
    max_light_beyond: float = 1.4
    # Relative standard uncertainty of an MTF by line spreads with sharper rims than those that are
    # likely before the data, as of discs and coma: 240 edges drawn by other programs
    line_spread_doubt: float = 0.0015
    line_spread_draws: int = 600  # Draws of the line spread
    quick_draws: int = 500  # Draws of a quick posterior
    chain_steps: int = 3000  # Steps of a Markov chain
    skew_draws: int = 100  # Draws that estimate it
    # Error of ln of the half frequency up to which a width's error is taken for it
    max_ln_error: float = 0.5
    quick_ess: float = 300.0  # Effective draws of a quick posterior
    quick_first_draws: int = 1000  # Draws that it begins with
    min_effort: float = 0.55  # Fraction of both for a model of low weight
    # Half width of the band in which fields that run along the edge are compared, px
    field_band_px: float = 16.0
    field_tolerance_px: float = 0.005  # Change of the displacement that ends them, px
    correlation_fit_px: int = 6  # Largest lag to which the correlation model is fitted, px
    strip_px: float = 1.0  # Width of the bins whose means are subtracted, px
    correlation_near_px: int = 2  # Lags that test the model, px
    # Distance from the line where the step of single rows begins to be measured, px
    step_near_px: float = 3.0
    step_far_px: float = 9.0  # Distance where it ends, px
    # Distance from a level within which a pixel belongs to the plateau, fraction of the step.
    plateau_fraction: float = 0.1
    # Distance from the edge at which plateaus are tested for shading, px
    plateau_from_px: float = 10.0
    shading_length_px: float = 10.0  # Correlation length of shading, px
    # Fraction of the squared slope of the profile within the pixels that locate a row
    slope_fraction: float = 0.95
    min_row_window_px: float = 3.0  # Least half width of these pixels, px
    max_row_window_px: float = 10.0  # Largest half width, px
    min_plateau_positions: int = 30  # Displacements on a plateau that estimate the noise
    roughness_lags: int = 4  # Lags at which they may be correlated, rows
    # Factor of the half width of a 95 % interval over the posterior's (coverage on simulated
    # edges).
    interval_margin: float = 1.03
    # More of it below and above a frequency, per relative uncertainty: the error of a frequency
    # grows as its square.
    frequency_margin: tuple[float, float] = (1.0, 3.0)
    # More of it below and above a modulus, per relative uncertainty
    modulus_margin: tuple[float, float] = 2.0, 2.0


THRESHOLDS = EdgeThresholds()
ACCURACY = EdgeAccuracy()
