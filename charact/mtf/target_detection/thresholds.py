"""Thresholds and numerical settings of the target detection, each with its meaning and source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectionThresholds:
    """Decide flags, refusals and selections; set on simulated targets where no source is named."""

    # Fraction of the profile's variance that bars must explain.
    min_explained: float = 0.85
    # Mean over modulation of bars with dark gaps.
    min_box_over_wave: float = 0.65
    # Background next to the bars over their height.
    max_background: float = 0.4
    # Difference of first and last bar over their height.
    max_inequality: float = 0.4
    # Fraction of the profile's variance that may be noise.
    max_bar_noise: float = 0.3
    # Significance of the modulation, standard errors.
    modulation_sd: float = 5.0
    # Filter amplitude over its robust scatter.
    bar_filter_sd: float = 7.0
    # Modulation over the range of the frame.
    min_bar_contrast: float = 0.01
    # Length over width of a bar.
    min_bar_aspect: float = 3.5
    # Significance of a gradient that belongs to another object.
    foreign_sd: float = 6.5
    # Fraction of the edge's slope below which an aligned gradient is its tail.
    own_tail: float = 0.08
    # Angle within which a gradient is aligned, deg.
    own_direction_deg: float = 35.0
    # Least plateau, px.
    min_plateau_px: float = 8.0
    # Least plateau, standard deviations of the blur.
    min_plateau_blurs: float = 4.0
    # Rows of a rectangle.
    min_edge_rows: int = 24
    # Fraction of a segment's length that a finer scale must show in one piece.
    one_piece: float = 0.85
    # Significance along a segment at which a finer scale would have found it.
    finer_scale_sd: float = 8.0
    # Spacing over length below which alternating edges are bars.
    bar_aspect: float = 0.35
    # Relative difference of their spacings.
    bar_evenness: float = 0.35
    # Frames that separate a source from a flash.
    min_steady_frames: int = 3
    # Height over that of the brightest source.
    min_source: float = 0.02
    # Next-neighbour signal over the peak that every lens and pixel exceed.
    min_neighbours: float = 0.08
    # Axis ratio of a spot beyond which it is a line.
    max_axis_ratio: float = 2.5
    # Significance of a pixel of an edge.
    member_sd: float = 4.0
    # Significance that one of its pixels must reach.
    seed_sd: float = 6.5
    # Bow over length of a straight edge.
    max_bow: float = 0.02
    # Bow that is always accepted, px.
    min_bow_px: float = 0.6
    # Bow of the part of an edge that is used, px.
    used_bow_px: float = 0.4
    # Step over the range of the frame.
    min_step: float = 0.05


@dataclass(frozen=True)
class DetectionAccuracy:
    """Bounds draws, iterations, windows and tolerances."""

    # Fraction of the bars' length that the filter takes in.
    central_fraction: float = 0.8
    # Pixels per period that binning leaves.
    pixels_per_period: float = 8.0
    # Median of a Rayleigh distribution of unit scale.
    rayleigh_median: float = 1.1774
    # Filter maxima that are examined.
    max_detections: int = 600
    # Margin of a group's region, periods.
    bar_margin_periods: float = 1.5
    # Least margin, px.
    min_bar_margin_px: float = 14.0
    # Longest plateau of use, px.
    max_plateau_px: float = 64.0
    # Plateau at which rows count half, px.
    plateau_scale_px: float = 12.0
    # Positions tried for either end of a rectangle.
    cuts: int = 12
    # Coarsest smoothing at which other objects are searched, px.
    foreign_scale_px: float = 2.8
    # Cells along the segment for this test, px.
    finer_scale_cell_px: float = 3.0
    # Smoothing of the background, px.
    background_px: float = 8.0
    # Groups into which more frames are averaged.
    max_groups: int = 16
    # Quantile of the background whose height estimates its scatter.
    tail_quantile: float = 0.97
    # Its height for a normal distribution, standard deviations.
    tail_sd: float = 1.8808
    # The same farther out, where pulses contribute.
    far_quantile: float = 0.999
    # Its height for a normal distribution, standard deviations.
    far_sd: float = 3.0902
    # Pixels that estimate it.
    far_pixels: int = 20_000
    # Half side of a source's region, px.
    point_region_px: int = 48
    # Range of gradient directions in a segment, deg.
    direction_tolerance_deg: float = 28.0
    # Directions tried; neighbouring ones overlap by half.
    n_directions: int = 16
    # Gap across which collinear pieces are joined, px.
    gap_px: float = 12.0
    # Distance of collinear pieces from a common line, px.
    same_line_px: float = 1.5
    # Angle between collinear pieces, deg.
    same_line_deg: float = 4.0
    # Quantile of the gradient components in a block that structure hardly changes.
    quiet_quantile: float = 0.25
    # Its height for a normal distribution, standard deviations.
    quiet_sd: float = 0.318639
    # Blur of such a step, px.
    min_blur_px: float = 1.5
    # Signal levels at which the noise is estimated.
    noise_levels: int = 8


THRESHOLDS = DetectionThresholds()
ACCURACY = DetectionAccuracy()
