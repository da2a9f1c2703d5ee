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
    # Largest departure of a form, fraction of the transfer: the prior's; a disc needs 0.19
    max_departure: float = 0.1
    # Noise over light of the residuals of one frame over that of neighbouring pixels, at most
    # that of 2 electrons of dark noise: counting cameras have 0.2
    max_noise_ratio: float = 10.0
    # Distance of a form's MTF from that of the light without a form, standard uncertainties, and
    # where they are compared
    max_gap_sd: float = 2.5
    compared_levels: tuple[float, ...] = (0.7, 0.5, 0.3, 0.15)
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
    # Chance of the noise of a linear camera below which its response is not linear, the pixels that
    # tell, fractions of the peak, and the largest dark noise, electrons: that of 90,000 of a sky
    min_noise_chance: float = 1e-3
    lit_levels: tuple[float, ...] = (0.05, 0.3)
    max_dark_e: float = 300.0
    min_height_sd: float = 9.0  # Height of a source, standard deviations of the smoothed background
    min_steadiness_sd: float = 4.0  # Light over the frames, standard uncertainties
    # Height of another source over the first, outside the inner halo
    min_other_height: float = 0.08
    surroundings_px: float = 12.0  # Radius of a source's surroundings, px
    min_background_pixels: int = 60  # Background pixels
    # Standard deviation of a smoothed background that quantisation hides, DN
    min_background_sd_dn: float = 0.05
    min_transform_frames: int = 3  # Frames of the transform method
    # Fraction of the light beyond R that a power law extrapolates: an Airy pattern from its first
    # ring on
    max_wings: float = 0.1
    max_lost_draws: float = 0.02  # Drawn curves that do not fall to a level
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
    # Light that the residual shows in an extended component, standard uncertainties
    component_sd: float = 1.5
    # Root of the light over its peak to which the core holds a spot, px: that of a Gaussian of 2.2
    # px; a ring out of focus reaches twice as far from its centre as a Gaussian
    max_extent_px: float = 5.5
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
    # Effective draws of the likeliest form at which its sampling ends, and first draws; the same
    # for a quick answer
    effective: tuple[float, int] = (2000.0, 4000)
    quick_effective: tuple[float, int] = (500.0, 1000)
    # Densities of a thousand draws that may be added: a second of processor time
    max_added: int = 8
    min_effective: float = 150.0  # Effective draws below which a posterior is not determined
    empty_rings: int = 2  # Rings that an extended component must leave empty
    # Relative noise assumed for the first estimate, of the brightest pixel
    first_relative_sd: float = 0.02
    model_relative_sd: float = 3e-4  # Relative error of the model's tables
    noise_distance_px: float = 12.0  # Distance of the surroundings from a source, px
    # ln of further prior odds for white noise of one frame's light: eight standard deviations
    # squared in -2 ln likelihood, which some fifty pixels rarely show by chance
    ln_white_odds: float = 4.0
    pulse_step_px: float = 0.6  # Step of pulse positions, px
    pulse_extent_px: float = 10.2  # Their extent, px
    hidden_sd_dn: float = 0.2  # Noise that quantisation hides, DN
    min_light_fraction: float = 0.02  # Light over the brightest pixel that is informative
    lag_factor: float = 1.6  # Standard uncertainty factor of frames correlated by phosphor decay


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


@dataclass(frozen=True)
class WingLimits:
    """Extent of a spot in its transform, its wings, and the noise that both have."""

    smoothing_px: float = 1.2  # Standard deviation of the smoothing that finds the spot, px
    background_quantile: float = 0.25  # Quantile of a frame of which at least half is background
    min_height_sd: float = 5.0  # Border of a spot, standard deviations of the smoothed background
    min_height: float = 0.002  # The same over its height: where an Airy pattern has its third ring
    core_height: float = 0.03  # The same of its core, without the wings
    max_radius: float = 0.75  # R over the distance to the border, so that a background is seen
    # R over the largest distance of the spot's pixels, and the smoothing's part of it, px
    margin: float = 1.2
    margin_px: float = 2.0
    # Light beyond R over the square root of light over peak and R: half of an Airy pattern's,
    # 2 / (pi^2 fc R), whose light over peak is 4 / (pi fc^2)
    at_width: float = 0.09
    max_fraction: float = 0.2  # The same at most: an Airy pattern beyond its first ring
    relative_sd: float = 0.4  # Light beyond R of wings between r^-3 and r^-5
    end_cy_per_px: float = 0.4  # Frequencies that show what the sampling folds back
    lit: float = 0.1  # Pixels whose noise is that of light, fraction of the peak
    # Read noise of a camera, electrons: central half of `DARK_LN`'s range that one frame may show
    read_e: tuple[float, float] = (2.0, 18.0)
    min_frames: int = 8  # Frames whose scatter is known to a quarter


@dataclass(frozen=True)
class SourceCount:
    """Fits that tell two sources in one spot, and when they do.

    Two images explain 14 % of what an ellipse leaves of most aberrated pupils that were drawn, of
    coma at 350 standard deviations 43 %; of pairs of Gaussian and Airy spots 0.9 full widths apart,
    1 : 0.5 and more, over 60 %. The limits were chosen on these drawings.
    """

    min_gain: float = 0.5  # S1 - S2 over S1 less its noise
    min_order: float = 1.4  # Moffat's b of two images: flatter wings fill what no image describes
    min_gain_sd: float = 6.0  # Root of S1 - S2, standard deviations of the brightest pixel
    min_distance: float = 0.7  # Distance over the full width at half maximum
    # Light of the fainter source over that of the brighter: a square pupil has side lobes of 0.05
    min_ratio: float = 0.1
    # Pixels whose moments give the axis, fraction of the peak: a fainter source counts too
    core: float = 0.12
    max_pixels: int = 31  # Side of the box, in its own pixels
    evaluations: int = 25
    first_order: float = 2.5  # Moffat's b - 1
    narrower: float = 0.7  # Width of each of two images over that of one
    sides: tuple[float, float] = (-0.3, 0.3)  # Half of the first distance over the full width
    ln_width: tuple[float, float] = (-2.0, 4.0)
    ln_order: tuple[float, float] = (-1.5, 3.0)
    stretch: tuple[float, float] = (-1.5, 1.5)
    tilt: tuple[float, float] = (-0.9, 0.9)


SOURCES = SourceCount()
WINGS = WingLimits()
PRIORS = PointPriors()
LIMITS = PointLimits()
ACCURACY = PointAccuracy()
