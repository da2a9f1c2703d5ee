"""Thresholds and numerical settings of point sources, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PointLimits:
    """Thresholds that decide about flags, refusals and candidates of point sources."""

    # Closer peaks belong to one spot: the smoothing leaves no saddle, px.
    min_peak_distance_px: int = 5
    # Light between two sources over the lower peak's height.
    max_saddle: float = 0.5
    # Height of the intended source over the brightest one.
    min_relative_height: float = 0.25
    # Distance at which the pixels of two sources do not touch, px.
    isolated_px: float = 6.0
    # Radius of a neighbour's own pixels: three sigma of a spot of 1 px.
    neighbour_px: float = 3.0
    # Distance to which neighbours are modelled: core corner (9 px) plus their extent (7 px).
    max_neighbour_px: float = 16.0
    # A source this many times the required height is independent of its neighbours.
    clear_height: float = 3.0
    # Neighbours that make a dense field.
    min_crowd: int = 3
    # Reduced chi squared.
    max_chi2: float = 1.8
    # Its noise, standard deviations.
    max_chi2_sd: float = 5.0
    # Light down to which intervals are validated, standard uncertainties.
    low_light_sd: float = 10.0
    # Distance of the cut-off from the description, standard deviations.
    max_prior_sd: float = 3.0
    # Significance of a halo, standard uncertainties.
    min_halo_sd: float = 3.0
    # Extra negative power of the noise that only a nonlinear response explains.
    max_negative_power: float = 0.35
    # Side of a region, px.
    min_region_px: int = 9
    # Light of a source, standard uncertainties.
    min_light_sd: float = 6.0
    # Fraction of the light in valid pixels.
    min_valid_light: float = 0.3
    # Fraction of full scale at which frames clip or the wells of a sensor fill.
    full_fraction: float = 0.97
    # Variance to which quantisation only adds its own, DN^2.
    min_variance_dn2: float = 0.25
    # Quantisation shift of faint light that is reported, DN.
    min_rounding_shift_dn: float = 0.02
    # Chi squared of model departures, standard deviations of its noise.
    max_departure_sd: float = 4.5
    # Ratio of the half frequencies along rows and columns of a single source.
    max_elongation: float = 1.5
    # Noise from which quantisation has no effect, DN.
    max_rounded_sd: float = 1.0
    # Significance of motion, standard uncertainties.
    motion_sd: float = 5.0
    # Displacement between fields, px.
    max_field_offset_px: float = 0.15
    # Displacement through the stack, px.
    max_drift_px: float = 0.3
    # Relative loss of MTF50 by motion.
    max_motion_loss: float = 0.01
    # p-value of motion.
    motion_p_value: float = 5e-4
    # MTF50 with pixel, cycles per sample, of a Gaussian of 0.3 px; sharper spots are undersampled.
    max_mtf50: float = 0.42
    # Fraction of the light in pixels below full scale.
    min_unclipped_light: float = 0.2
    # Range of pinhole diameters, column pitches.
    pinhole_px: tuple[float, float] = (0.0, 50.0)
    # Correlation of neighbours by chance, standard uncertainties.
    max_correlation_sd: float = 4.0
    # Fraction of the noise below the lowest grey value: MTF50 is then half a standard uncertainty high.
    max_clipped_noise: float = 0.04
    # Ratio of the standard deviations between them; that of pulses grows upwards.
    max_sd_ratio: float = 1.25
    # Significance of a nonlinear response; few pulses scatter more than a Gaussian.
    nonlinear_sd: float = 4.0
    # Power of the light in the noise.
    min_nonlinear_power: float = 0.1
    # Height of a source, standard deviations of the smoothed background.
    min_height_sd: float = 9.0
    # Light over the frames, standard uncertainties.
    min_steadiness_sd: float = 4.0
    # Height of another source over the first, outside the inner halo.
    min_other_height: float = 0.08
    # Radius of a source's surroundings, px.
    surroundings_px: float = 12.0
    # Background pixels.
    min_background_pixels: int = 60
    # Standard deviation of a smoothed background that quantisation hides, DN.
    min_background_sd_dn: float = 0.05
    # Rms radius of a spot that the disc holds, px.
    max_rms_radius_px: float = 3.2
    # Frames of the transform method.
    min_transform_frames: int = 3
    # Fraction of the light at the border.
    max_border_light: float = 0.005
    # Excess of the background ring that indicates a halo, standard uncertainties.
    min_halo_excess_sd: float = 3.0
    # Odd part of the transform over the light.
    max_asymmetry: float = 0.02
    # The same, standard uncertainties.
    max_asymmetry_sd: float = 5.0
    # Transfer of a pinhole that can be divided out.
    min_pinhole_mtf: float = 0.3


@dataclass(frozen=True)
class PointAccuracy:
    """Sampling, iteration limits, tolerances and resolution of point sources."""

    # Quantiles of an image of which at least half is background.
    background_quantiles: tuple[float, float] = (0.05, 0.25)
    # Their distance in standard deviations (normal distribution).
    background_quantile_sd: float = 0.97
    # Peaks of a region examined, for speed.
    max_peaks: int = 100
    # Cores tried with extended components, for speed.
    max_cores: int = 4
    # Factors of a single frame's residual noise in successive turns; misfit does not count as noise at first.
    noise_factors: tuple[float, float] = (0.1, 1.0)
    # Second start: half frequency in focus over the blurred one, defocus squared, waves^2; half a wave halves MTF50.
    defocus_start: tuple[float, float] = (2.0, 0.25)
    # Newton iterations for the light of clipped sources.
    light_iterations: int = 25
    # Gauss-Newton iterations.
    model_iterations: int = 40
    # Finite difference, fraction of the bounds' width.
    difference: float = 1e-5
    # Trial halo diameters of a camera without a description, px.
    trial_halos_px: tuple[float, ...] = (8.0, 11.0, 15.0, 20.0, 27.0, 36.0)
    # Softness of their rims, px.
    halo_rim_px: float = 2.0
    # Frames whose noise shows a nonlinear response.
    min_noise_frames: int = 4
    # Effective sample size of a quick answer.
    quick_ess: float = 500.0
    # First draws of a quick answer.
    quick_first_draws: int = 1000
    # Longest Markov chain.
    forward_chain_steps: int = 1200
    # A model of less weight contributes no draws.
    min_model_weight: float = 0.02
    # Models within this of the best ln evidence are refined.
    candidate_ln_evidence: float = 8.0
    # Cores within this are always tried with extended components, which noise may hide.
    extended_ln_evidence: float = 3.0
    # Others only where chi squared gains this much.
    min_extended_chi2_gain: float = 4.0
    # Starting sizes of an extended component.
    extended_sizes: int = 6
    # Half height of the core, px.
    half_rows: int = 6
    # Half width of the core, px.
    half_cols: int = 7
    # Borders of the rings, px.
    ring_borders_px: tuple[float, ...] = (7.0, 9.0, 12.0, 15.0, 18.0, 21.0, 24.0, 27.0, 31.0, 36.0)
    # Length of a ring's sectors, px.
    sector_px: float = 6.0
    # Longest correlation of noise across a ring's border, px.
    max_correlation_px: float = 1.0
    # Pixels of a ring.
    min_ring_pixels: int = 24
    # Distances that represent a ring.
    pixels_per_ring: int = 48
    # Columns after a full well that a causal filter affects.
    filter_tail_px: int = 8
    # Relative fixed pattern of a phosphor screen.
    phosphor_pattern: float = 0.015
    # Its correlation length, px.
    phosphor_pattern_px: float = 1.5
    # Mean square over squared mean of pulse heights.
    pulse_height_square: float = 3.0
    # Pulses per DN before they are estimated.
    pulses_per_dn: float = 1.0
    # Turns of noise and transfer.
    noise_turns: int = 3
    # Frequencies of transfers per batch; more exceed the processor's cache and take twice as long.
    batch_size: int = 100_000
    # Step and extent of landing positions near the core, px.
    near_landing_px: tuple[float, float] = (0.5, 3.0)
    # The same far from it, px.
    far_landing_px: tuple[float, float] = (1.5, 15.0)
    # Pixels whose frames are compared, px from the source.
    noise_radius_px: float = 5.5
    # Distance of periodic copies, beyond core and halo, px.
    image_period_px: float = 40.0
    # Frequency step of the rings' transform, cy/px.
    ring_frequency_step: float = 1.0 / 160.0
    # Its highest frequency, cy/px.
    ring_max_frequency: float = 0.5
    # Smoothing that ends the rings' integral, px; rings are wider.
    ring_smoothing_px: float = 1.0
    # Highest frequency along columns over that along rows.
    frequency_aspect: float = 0.85
    # Amplitude of the image that omitted frequencies may hold.
    negligible_amplitude: float = 1e-6
    # Distance from the optimum to which that holds, standard deviations.
    frequency_margin_sd: float = 5.0
    # Pixels in which motion is followed, px from the centre.
    motion_radius_px: float = 5.0
    # Their height over the peak.
    motion_min_height: float = 0.1
    # Frames that motion needs.
    min_motion_frames: int = 4
    # Radius that holds all light, also of a moving source, px.
    total_light_radius_px: float = 10.0
    # Draws of the parametric method.
    draws: int = 1000
    # The same for a quick answer.
    quick_draws: int = 500
    # Smallest fraction of them for a model of little weight.
    min_quick_effort: float = 0.25
    # The same of a full chain.
    min_full_effort: float = 0.25
    # Longest Markov chain.
    parametric_chain_steps: int = 1500
    # Rings that an extended component must leave empty.
    empty_rings: int = 2
    # Turns of the position.
    position_turns: int = 3
    # Pixels near a source whose noise is used.
    min_near_pixels: int = 9
    # Relative noise assumed for the first estimate, of the brightest pixel.
    first_relative_sd: float = 0.02
    # Relative error of the model's tables.
    model_relative_sd: float = 3e-4
    # Student's t variance of an estimate from 12 sectors.
    sector_variance_factor: float = 11.0 / 9.0
    # Distance of the surroundings from a source, px.
    noise_distance_px: float = 12.0
    # The same in a small region, fraction of its extent.
    noise_distance_fraction: float = 0.6
    # Frames whose noise is used.
    max_noise_frames: int = 16
    # Fractions of the blur after the gain; 0: independent pixels.
    pulse_fractions: tuple[float, ...] = (0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0)
    # Values that constrain a gain; Student's t of fewer has hardly a variance.
    min_gain_values: float = 6.0
    # Step of pulse positions, px.
    pulse_step_px: float = 0.6
    # Their extent, px.
    pulse_extent_px: float = 10.2
    # Pixels whose noise is compared, px from the source.
    pulse_radius_px: float = 5.0
    # Values below the lower of two grey values.
    min_values_below: int = 16
    # Noise that quantisation hides, DN.
    hidden_sd_dn: float = 0.2
    # Fraction of the values above the first of two higher grey values.
    upper_fraction: float = 0.5
    # The same of the second.
    top_fraction: float = 0.05
    # Values above the second.
    min_values_above: int = 20
    # Light over the brightest pixel that is informative.
    min_light_fraction: float = 0.02
    # Number of such pixels.
    min_lit_pixels: int = 6
    # Iterations for the size of the pulses.
    noise_iterations: int = 8
    # Smoothing before detection, px.
    detection_smoothing_px: float = 1.2
    # Radius of the transformed disc, px.
    spot_radius_px: float = 8.0
    # Outer radius of the background ring, px.
    background_radius_px: float = 14.0
    # Standard uncertainty factor of frames correlated by phosphor decay.
    lag_factor: float = 1.6
    # Inner radius of the disc's border, px.
    border_radius_px: float = 6.5
    # Outer radius of the ring compared with the background ring, px.
    halo_radius_px: float = 22.0
    # Light beyond the disc over that at its border, for tails of tubes.
    light_beyond: float = 6.0
    # Its effect on a crossing frequency.
    crossing_factor: float = 0.7
    # Frequencies of the asymmetry test, cy/px.
    asymmetry_cy_per_px: tuple[float, float] = (0.06, 0.1)


LIMITS = PointLimits()
ACCURACY = PointAccuracy()
