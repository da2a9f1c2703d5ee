"""Thresholds and numerical settings of point sources, one a line with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PointLimits:
    """Thresholds that decide about flags, refusals and candidates of point sources."""

    # Closer peaks belong to one spot: the smoothing leaves no saddle, px
    min_peak_distance_px: int = 5
    max_saddle: float = 0.5  # Light between two sources over the lower peak's height
    min_relative_height: float = 0.25  # Height of the intended source over the brightest one
    isolated_px: float = 6.0  # Distance at which the pixels of two sources do not touch, px
    neighbour_px: float = 3.0  # Radius of a neighbour's own pixels: three sigma of a spot of 1 px
    # Distance to which neighbours are modelled: core corner (9 px) plus their extent (7 px).
    max_neighbour_px: float = 16.0
    # A source this many times the required height is independent of its neighbours
    clear_height: float = 3.0
    min_crowd: int = 3  # Neighbours that make a dense field
    max_chi2: float = 1.8  # Reduced chi squared
    max_chi2_sd: float = 5.0  # Its noise, standard deviations
    # Light down to which intervals are validated, standard uncertainties
    low_light_sd: float = 10.0
    max_prior_sd: float = 3.0  # Distance of the cut-off from the description, standard deviations
    # Extra negative power of the noise that only a nonlinear response explains
    max_negative_power: float = 0.35
    min_region_px: int = 9  # Side of a region, px
    min_light_sd: float = 6.0  # Light of a source, standard uncertainties
    # -2 ln likelihood of the best model over the degrees of freedom: residuals of a hundred
    # standard deviations, where the likelihood is too steep to be explored.
    max_cost: float = 1e4
    min_variance_dn2: float = 0.25  # Variance to which quantisation only adds its own, DN^2
    min_rounding_shift_dn: float = 0.02  # Quantisation shift of faint light that is reported, DN
    # Chi squared of model departures, standard deviations of its noise
    max_departure_sd: float = 4.5
    # Ratio of the half frequencies along rows and columns of a single source
    max_elongation: float = 1.5
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
    # Significance of a nonlinear response; few pulses scatter more than a Gaussian
    nonlinear_sd: float = 4.0
    min_nonlinear_power: float = 0.1  # Power of the light in the noise
    min_height_sd: float = 9.0  # Height of a source, standard deviations of the smoothed background
    min_steadiness_sd: float = 4.0  # Light over the frames, standard uncertainties
    # Height of another source over the first, outside the inner halo
    min_other_height: float = 0.08
    surroundings_px: float = 12.0  # Radius of a source's surroundings, px
    min_background_pixels: int = 60  # Background pixels
    # Standard deviation of a smoothed background that quantisation hides, DN
    min_background_sd_dn: float = 0.05
    max_rms_radius_px: float = 3.2  # Rms radius of a spot that the disc holds, px
    min_transform_frames: int = 3  # Frames of the transform method
    max_border_light: float = 0.005  # Fraction of the light at the border
    # Excess of the background ring that indicates a halo, standard uncertainties
    min_halo_excess_sd: float = 3.0
    max_asymmetry: float = 0.02  # Odd part of the transform over the light
    max_asymmetry_sd: float = 5.0  # The same, standard uncertainties
    min_pinhole_mtf: float = 0.3  # Transfer of a pinhole that can be divided out


@dataclass(frozen=True)
class PointAccuracy:
    """Sampling, iteration limits, tolerances and resolution of point sources."""

    # Quantiles of an image of which at least half is background.
    background_quantiles: tuple[float, float] = (0.05, 0.25)
    # Their distance in standard deviations (normal distribution)
    background_quantile_sd: float = 0.97
    # Factors of a single frame's residual noise in successive turns; misfit does not count as noise
    # at first.
    noise_factors: tuple[float, float] = (0.1, 1.0)
    # Second start: half frequency in focus over the blurred one, defocus squared, waves^2; half a
    # wave halves MTF50.
    defocus_start: tuple[float, float] = (2.0, 0.25)
    min_model_weight: float = 0.02  # A model of less weight contributes no draws
    candidate_ln_evidence: float = 8.0  # Models within this of the best ln evidence are refined
    half_rows: int = 6  # Half height of the core, px
    half_cols: int = 7  # Half width of the core, px
    # Borders of the rings, px.
    ring_borders_px: tuple[float, ...] = (7.0, 9.0, 12.0, 15.0, 18.0, 21.0, 24.0, 27.0, 31.0, 36.0)
    sector_px: float = 6.0  # Length of a ring's sectors, px
    pixels_per_ring: int = 48  # Distances that represent a ring
    phosphor_pattern: float = 0.015  # Relative fixed pattern of a phosphor screen
    phosphor_pattern_px: float = 1.5  # Its correlation length, px
    pulse_height_square: float = 3.0  # Mean square over squared mean of pulse heights
    pulses_per_dn: float = 1.0  # Pulses per DN before they are estimated
    motion_radius_px: float = 5.0  # Pixels in which motion is followed, px from the centre
    draws: int = 1000  # Draws of the parametric method
    quick_draws: int = 500  # The same for a quick answer
    empty_rings: int = 2  # Rings that an extended component must leave empty
    # Relative noise assumed for the first estimate, of the brightest pixel
    first_relative_sd: float = 0.02
    model_relative_sd: float = 3e-4  # Relative error of the model's tables
    noise_distance_px: float = 12.0  # Distance of the surroundings from a source, px
    pulse_step_px: float = 0.6  # Step of pulse positions, px
    pulse_extent_px: float = 10.2  # Their extent, px
    hidden_sd_dn: float = 0.2  # Noise that quantisation hides, DN
    min_light_fraction: float = 0.02  # Light over the brightest pixel that is informative
    spot_radius_px: float = 8.0  # Radius of the transformed disc, px
    background_radius_px: float = 14.0  # Outer radius of the background ring, px
    lag_factor: float = 1.6  # Standard uncertainty factor of frames correlated by phosphor decay
    light_beyond: float = 6.0  # Light beyond the disc over that at its border, for tails of tubes
    crossing_factor: float = 0.7  # Its effect on a crossing frequency


@dataclass(frozen=True)
class PointPriors:
    """Bounds, means and standard deviations of the blur's parameters before the data."""

    stretch: tuple[float, float] = (-0.6, 0.6)  # ln ratio of horizontal to vertical half frequency
    stretch_sd: float = 0.15  # The same: lenses and tubes are nearly round
    # Exponent of a tube's tails next to a Gaussian of lens, fibres and pulse (physics reference
    # 1.12: 1.1 to 2).
    tail: tuple[float, float] = (1.0, 2.0)
    tail_prior: tuple[float, float] = (1.3, 0.25)  # Its mean and standard deviation
    blur_px: tuple[float, float] = (0.05, 2.0)  # Standard deviation of that Gaussian, px
    wide_share_sd: float = 0.1  # Scattered fraction: half-normal, a few per cent
    cut_off_sd: float = 0.12  # ln cut-off of a camera about its description
    exponent_sd: float = 0.08  # Its exponent
    blur_sd: float = 0.25  # Its relative Gaussian blur
    described_stretch_sd: float = 0.03  # Its ln aspect


PRIORS = PointPriors()
LIMITS = PointLimits()
ACCURACY = PointAccuracy()
