"""Thresholds and numerical settings of the target detection, each with its meaning and source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectionThresholds:
    """Decide flags, refusals and selections; set on simulated targets where no source is named."""

    min_explained: float = 0.85  # Fraction of the profile's variance that bars must explain
    min_box_over_wave: float = 0.65  # Mean over modulation of bars with dark gaps
    max_background: float = 0.4  # Background next to the bars over their height
    max_inequality: float = 0.4  # Difference of first and last bar over their height
    max_bar_noise: float = 0.3  # Fraction of the profile's variance that may be noise
    modulation_sd: float = 5.0  # Significance of the modulation, standard errors
    bar_filter_sd: float = 7.0  # Filter amplitude over its robust scatter
    # Filter amplitude over the range of the frame that needs no scatter; noise has seven of its own
    clear_bars: float = 0.3
    min_bar_contrast: float = 0.01  # Modulation over the range of the frame
    min_bar_aspect: float = 3.5  # Length over width of a bar
    foreign_sd: float = 6.5  # Significance of a gradient that belongs to another object
    # Fraction of the edge's slope below which an aligned gradient is its tail
    own_tail: float = 0.08
    own_direction_deg: float = 35.0  # Angle within which a gradient is aligned, deg
    min_plateau_px: float = 8.0  # Least plateau, px
    min_plateau_blurs: float = 4.0  # Least plateau, standard deviations of the blur
    min_edge_rows: int = 24  # Rows of a rectangle
    # Fraction of a segment's length that a finer scale must show in one piece
    one_piece: float = 0.85
    # Significance along a segment at which a finer scale would have found it
    finer_scale_sd: float = 8.0
    bar_aspect: float = 0.35  # Spacing over length below which alternating edges are bars
    bar_evenness: float = 0.35  # Relative difference of their spacings
    min_steady_frames: int = 3  # Frames that separate a source from a flash
    min_source: float = 0.02  # Height over that of the brightest source
    # Next-neighbour signal over the peak that every lens and pixel exceed
    min_neighbours: float = 0.08
    max_axis_ratio: float = 2.5  # Axis ratio of a spot beyond which it is a line
    member_sd: float = 4.0  # Significance of a pixel of an edge
    seed_sd: float = 6.5  # Significance that one of its pixels must reach
    max_bow: float = 0.02  # Bow over length of a straight edge
    min_bow_px: float = 0.6  # Bow that is always accepted, px
    used_bow_px: float = 0.4  # Bow of the part of an edge that is used, px
    min_step: float = 0.05  # Step over the range of the frame


@dataclass(frozen=True)
class DetectionAccuracy:
    """Bounds draws, iterations, windows and tolerances."""

    central_fraction: float = 0.8  # Fraction of the bars' length that the filter takes in
    pixels_per_period: float = 8.0  # Pixels per period that binning leaves
    max_plateau_px: float = 64.0  # Longest plateau of use, px
    plateau_scale_px: float = 12.0  # Plateau at which rows count half, px
    cuts: int = 12  # Positions tried for either end of a rectangle
    # Margin of the outline of an edge that is not measured, standard deviations of its blur
    outline_blurs: float = 4.0
    finer_scale_cell_px: float = 3.0  # Cells along the segment for this test, px
    background_px: float = 8.0  # Smoothing of the background, px
    n_directions: int = 16  # Directions tried; neighbouring ones overlap by half
    gap_px: float = 12.0  # Gap across which collinear pieces are joined, px
    noise_levels: int = 8  # Signal levels at which the noise is estimated


THRESHOLDS = DetectionThresholds()
ACCURACY = DetectionAccuracy()
