"""Thresholds and numerical settings of point sources, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PointLimits:
    """Thresholds that decide about flags, refusals and candidates of point sources."""

    min_peak_distance_px: int = 5  # Closer peaks belong to one spot: the smoothing leaves no saddle, px
    max_saddle: float = 0.5  # Light between two sources over the lower peak's height
    min_relative_height: float = 0.25  # Height of the intended source over the brightest one
    isolated_px: float = 6.0  # Distance at which the pixels of two sources do not touch, px
    neighbour_px: float = 3.0  # Radius of a neighbour's own pixels: three sigma of a spot of 1 px
    # Distance to which neighbours are modelled: core corner (9 px) plus their extent (7 px).
    max_neighbour_px: float = 16.0
    clear_height: float = 3.0  # A source this many times the required height is independent of its neighbours
    min_crowd: int = 3  # Neighbours that make a dense field
    max_chi2: float = 1.8  # Reduced chi squared
    max_chi2_sd: float = 5.0  # Its noise, standard deviations
    low_light_sd: float = 10.0  # Light down to which intervals are validated, standard uncertainties
    max_prior_sd: float = 3.0  # Distance of the cut-off from the description, standard deviations
    max_negative_power: float = 0.35  # Extra negative power of the noise that only a nonlinear response explains
    min_region_px: int = 9  # Side of a region, px
    min_light_sd: float = 6.0  # Light of a source, standard uncertainties
    full_fraction: float = 0.97  # Fraction of full scale at which frames clip or the wells of a sensor fill
    min_variance_dn2: float = 0.25  # Variance to which quantisation only adds its own, DN^2
    min_rounding_shift_dn: float = 0.02  # Quantisation shift of faint light that is reported, DN
    max_departure_sd: float = 4.5  # Chi squared of model departures, standard deviations of its noise
    max_elongation: float = 1.5  # Ratio of the half frequencies along rows and columns of a single source
    max_rounded_sd: float = 1.0  # Noise from which quantisation has no effect, DN
    motion_sd: float = 5.0  # Significance of motion, standard uncertainties
    max_field_offset_px: float = 0.15  # Displacement between fields, px
    max_drift_px: float = 0.3  # Displacement through the stack, px
    max_motion_loss: float = 0.01  # Relative loss of MTF50 by motion
    motion_p_value: float = 5e-4  # p-value of motion
    # MTF50 with pixel, cycles per sample, of a Gaussian of 0.3 px; sharper spots are undersampled.
    max_mtf50: float = 0.42
    min_unclipped_light: float = 0.2  # Fraction of the light in pixels below full scale
    pinhole_px: tuple[float, float] = (0.0, 50.0)  # Range of pinhole diameters, column pitches
    max_correlation_sd: float = 4.0  # Correlation of neighbours by chance, standard uncertainties
    # Fraction of the noise below the lowest grey value: MTF50 is then half a standard uncertainty high.
    max_clipped_noise: float = 0.04
    max_sd_ratio: float = 1.25  # Ratio of the standard deviations between them; that of pulses grows upwards
    nonlinear_sd: float = 4.0  # Significance of a nonlinear response; few pulses scatter more than a Gaussian
    min_nonlinear_power: float = 0.1  # Power of the light in the noise
    min_height_sd: float = 9.0  # Height of a source, standard deviations of the smoothed background
    min_steadiness_sd: float = 4.0  # Light over the frames, standard uncertainties
    min_other_height: float = 0.08  # Height of another source over the first, outside the inner halo
    surroundings_px: float = 12.0  # Radius of a source's surroundings, px
    min_background_pixels: int = 60  # Background pixels
    min_background_sd_dn: float = 0.05  # Standard deviation of a smoothed background that quantisation hides, DN
    max_rms_radius_px: float = 3.2  # Rms radius of a spot that the disc holds, px
    min_transform_frames: int = 3  # Frames of the transform method
    max_border_light: float = 0.005  # Fraction of the light at the border
    min_halo_excess_sd: float = 3.0  # Excess of the background ring that indicates a halo, standard uncertainties
    max_asymmetry: float = 0.02  # Odd part of the transform over the light
    max_asymmetry_sd: float = 5.0  # The same, standard uncertainties
    min_pinhole_mtf: float = 0.3  # Transfer of a pinhole that can be divided out


@dataclass(frozen=True)
class PointAccuracy:
    """Sampling, iteration limits, tolerances and resolution of point sources."""

    # Quantiles of an image of which at least half is background.
    background_quantiles: tuple[float, float] = (0.05, 0.25)
    background_quantile_sd: float = 0.97  # Their distance in standard deviations (normal distribution)
    max_peaks: int = 100  # Peaks of a region examined, for speed
    max_cores: int = 4  # Cores tried with extended components, for speed
    # Factors of a single frame's residual noise in successive turns; misfit does not count as noise at first.
    noise_factors: tuple[float, float] = (0.1, 1.0)
    # Second start: half frequency in focus over the blurred one, defocus squared, waves^2; half a wave halves MTF50.
    defocus_start: tuple[float, float] = (2.0, 0.25)
    light_iterations: int = 25  # Newton iterations for the light of clipped sources
    model_iterations: int = 40  # Gauss-Newton iterations
    difference: float = 1e-5  # Finite difference, fraction of the bounds' width
    quick_ess: float = 500.0  # Effective sample size of a quick answer
    quick_first_draws: int = 1000  # First draws of a quick answer
    min_model_weight: float = 0.02  # A model of less weight contributes no draws
    candidate_ln_evidence: float = 8.0  # Models within this of the best ln evidence are refined
    # Cores within this are always tried with extended components, which noise may hide.
    extended_ln_evidence: float = 3.0
    min_extended_chi2_gain: float = 4.0  # Others only where chi squared gains this much
    extended_sizes: int = 6  # Starting sizes of an extended component
    half_rows: int = 6  # Half height of the core, px
    half_cols: int = 7  # Half width of the core, px
    # Borders of the rings, px.
    ring_borders_px: tuple[float, ...] = (7.0, 9.0, 12.0, 15.0, 18.0, 21.0, 24.0, 27.0, 31.0, 36.0)
    sector_px: float = 6.0  # Length of a ring's sectors, px
    max_correlation_px: float = 1.0  # Longest correlation of noise across a ring's border, px
    min_ring_pixels: int = 24  # Pixels of a ring
    pixels_per_ring: int = 48  # Distances that represent a ring
    filter_tail_px: int = 8  # Columns after a full well that a causal filter affects
    phosphor_pattern: float = 0.015  # Relative fixed pattern of a phosphor screen
    phosphor_pattern_px: float = 1.5  # Its correlation length, px
    pulse_height_square: float = 3.0  # Mean square over squared mean of pulse heights
    pulses_per_dn: float = 1.0  # Pulses per DN before they are estimated
    motion_radius_px: float = 5.0  # Pixels in which motion is followed, px from the centre
    motion_min_height: float = 0.1  # Their height over the peak
    min_motion_frames: int = 4  # Frames that motion needs
    total_light_radius_px: float = 10.0  # Radius that holds all light, also of a moving source, px
    draws: int = 1000  # Draws of the parametric method
    quick_draws: int = 500  # The same for a quick answer
    min_effort: float = 0.25  # Smallest fraction of them for a model of little weight
    chain_steps: int = 1500  # Longest Markov chain
    empty_rings: int = 2  # Rings that an extended component must leave empty
    position_turns: int = 3  # Turns of the position
    min_near_pixels: int = 9  # Pixels near a source whose noise is used
    first_relative_sd: float = 0.02  # Relative noise assumed for the first estimate, of the brightest pixel
    model_relative_sd: float = 3e-4  # Relative error of the model's tables
    sector_variance_factor: float = 11.0 / 9.0  # Student's t variance of an estimate from 12 sectors
    noise_distance_px: float = 12.0  # Distance of the surroundings from a source, px
    noise_distance_fraction: float = 0.6  # The same in a small region, fraction of its extent
    max_noise_frames: int = 16  # Frames whose noise is used
    # Fractions of the blur after the gain; 0: independent pixels.
    pulse_fractions: tuple[float, ...] = (0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0)
    min_gain_values: float = 6.0  # Values that constrain a gain; Student's t of fewer has hardly a variance
    pulse_step_px: float = 0.6  # Step of pulse positions, px
    pulse_extent_px: float = 10.2  # Their extent, px
    pulse_radius_px: float = 5.0  # Pixels whose noise is compared, px from the source
    min_values_below: int = 16  # Values below the lower of two grey values
    hidden_sd_dn: float = 0.2  # Noise that quantisation hides, DN
    upper_fraction: float = 0.5  # Fraction of the values above the first of two higher grey values
    top_fraction: float = 0.05  # The same of the second
    min_values_above: int = 20  # Values above the second
    min_light_fraction: float = 0.02  # Light over the brightest pixel that is informative
    min_lit_pixels: int = 6  # Number of such pixels
    noise_iterations: int = 8  # Iterations for the size of the pulses
    detection_smoothing_px: float = 1.2  # Smoothing before detection, px
    spot_radius_px: float = 8.0  # Radius of the transformed disc, px
    background_radius_px: float = 14.0  # Outer radius of the background ring, px
    lag_factor: float = 1.6  # Standard uncertainty factor of frames correlated by phosphor decay
    border_radius_px: float = 6.5  # Inner radius of the disc's border, px
    halo_radius_px: float = 22.0  # Outer radius of the ring compared with the background ring, px
    light_beyond: float = 6.0  # Light beyond the disc over that at its border, for tails of tubes
    crossing_factor: float = 0.7  # Its effect on a crossing frequency
    asymmetry_cy_per_px: tuple[float, float] = (0.06, 0.1)  # Frequencies of the asymmetry test, cy/px


@dataclass(frozen=True)
class PointPriors:
    """Bounds, means and standard deviations of the blur's parameters before the data."""

    stretch: tuple[float, float] = (-0.6, 0.6)  # ln ratio of horizontal to vertical half frequency
    stretch_sd: float = 0.15  # The same: lenses and tubes are nearly round
    # Exponent of a tube's tails next to a Gaussian of lens, fibres and pulse (physics reference 1.12: 1.1 to 2).
    tail: tuple[float, float] = (1.0, 2.0)
    tail_prior: tuple[float, float] = (1.3, 0.25)  # Its mean and standard deviation
    blur_px: tuple[float, float] = (0.05, 2.0)  # Standard deviation of that Gaussian, px
    wide_share_sd: float = 0.1  # Scattered fraction: half-normal, a few per cent
    defocus_square: tuple[float, float] = (0.0, 2.25)  # Square of the defocus, waves^2, in which a transfer is linear
    defocus_square_sd: float = 0.5  # Its half-normal prior
    cut_off_sd: float = 0.12  # ln cut-off of a camera about its description
    exponent_sd: float = 0.08  # Its exponent
    blur_sd: float = 0.25  # Its relative Gaussian blur
    described_stretch_sd: float = 0.03  # Its ln aspect


PRIORS = PointPriors()
LIMITS = PointLimits()
ACCURACY = PointAccuracy()
