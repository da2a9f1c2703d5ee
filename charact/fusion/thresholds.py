"""Thresholds of fusion: what is masked, flagged or refused."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FusionThresholds:
    """Decide marks, flags and refusals, and set the pyramid."""

    # Clipped pixels in one region from which it is a lamp; smaller ones are noise at the top of a
    # halo.
    lamp_px: int = 12
    # Border around a clipped region that holds its blurred edge, px: core of a lens and post-gain
    # blur.
    border_px: int = 2
    # Share of full scale from which a pixel is clipped: noise and rounding below the top code.
    clip_share: float = 0.985
    # Least signal power of a pyramid level over its noise power, so that a rare object is kept on
    # an empty level.
    signal_floor: float = 0.05
    # Standard deviations of a detail that is not noise: the largest of 50,000 Gaussian ones exceeds
    # it once in 500 frames.
    signal_sd: float = 5.5
    # Percentiles of smoothed trusted pixels shown as 0 and 1.
    low_percent: float = 1.0
    high_percent: float = 99.0
    # Side of the blocks in which the noise of an unknown camera is estimated, px, groups of blocks
    # of equal brightness, and share of the blocks of a group that hold no structure.
    noise_block_px: int = 16
    noise_groups: int = 6
    quiet_share: float = 0.1
    # Number of pyramid levels, and least side of the coarsest one, px: objects of 8 to 30 px fall
    # on the finer ones.
    most_levels: int = 5
    coarsest_px: int = 6
    # Level at whose rows and columns noise, weights and their uncertainty are computed for all
    # finer levels: noise follows the mean over about 2 px, since a finer mean would follow the
    # noise itself.
    map_level: int = 2
    # Variance of the finest details over that of the stated noise, outside of which the noise law
    # is wrong: the sampling error of the ratio is below 0.03, and fine scene structure adds up to a
    # third.
    least_noise_ratio: float = 0.7
    most_noise_ratio: float = 1.5
    # Step left at the rim of a subtracted halo over the halo's own step there, and in standard
    # errors: a radius of 4 px too large or too small leaves 0.5 and more.
    most_rim_share: float = 0.2
    rim_sd: float = 4.0
    # Least step of a halo that has a rim to be judged, in units of the display span.
    least_rim: float = 0.1
    # Misregistration, px, that is refused: 2 px cost a third of d'^2.
    refused_shift_px: float = 2.0
    # Shift that is flagged where the 95 % interval lies beyond it, px.
    flagged_shift_px: float = 0.25
    # Share of a band's pixels without information above which the picture is suspect.
    most_holes: float = 0.05
    # Restoration error of the worst zone that a method chosen by "auto" meets, percent of the
    # truth's spread.
    tolerance_percent: float = 60.0
    # Standard deviation of the object whose contrast defines the share of a band, px.
    object_px: float = 3.0
    # Deviation of a halo's amplitude by the ground around its lamp, over the spread of the ground's
    # levels: closed-form pairs of 16 seeds.
    halo_ground_sd: float = 0.47


FUSION = FusionThresholds()


@dataclass(frozen=True)
class RegistrationThresholds:
    """Set the search for a shift and its interval."""

    # Upper 95 % limit of the residual that is still in register.
    suspect_px: float = 0.5
    # Largest shift that is searched for; pairs of hand-aligned cameras differ by 1-5 px.
    reach_px: int = 12
    # Gaussian derivative; less follows noise, more loses small objects. Shifts of 40 closed-form
    # pairs are found within 0.16 px (68 %) with 1.5 px, 0.18 px with 2 px and 0.20 px (one in four
    # not at all) with 1 px.
    gradient_sigma_px: float = 1.5
    # Tiles of the jackknife, several times wider than the gradients' correlation.
    tile_px: int = 32
    # Tiles with structure for an interval.
    least_tiles: int = 8
    # Spacing of the nine shifts about the optimum.
    step_px: float = 0.75
    # Standard errors of a correlation that is not chance; the best of 625 chance shifts reaches
    # 3.5.
    significant: float = 5.0
    # Grey levels of the joint histogram.
    bins: int = 32
    # Shorter range, relative, of a surface that hides another: more than the range of ground
    # changes within a pixel.
    occlusion_depth: float = 0.02


REGISTRATION = RegistrationThresholds()


@dataclass(frozen=True)
class FilterThresholds:
    """Set the motion gate of the recursive filter."""

    # Gaussians whose difference shows objects of 5 to 15 px, px.
    scales_px: tuple[float, float] = (2.5, 6.0)
    # Standard deviations of a difference from which the mean starts again in part, and wholly:
    # chance raises the noise of a static scene by 3 %, and objects of any contrast that move by 2
    # px a frame keep nine tenths of their d'.
    gate_sd: tuple[float, float] = (2.5, 4.5)
    # Pixels around a moving place that start again: half an object.
    reach_px: int = 6


FILTER = FilterThresholds()


@dataclass(frozen=True)
class TruthThresholds:
    """Set zones and scores of a fused picture against the truth of its scene."""

    # Blooming over the light of the ground below which a place is dark, and above which it lies in
    # a halo.
    dark_share: float = 0.01
    halo_share: float = 0.25
    # Half side of the window around an object and radius of the Laguerre-Gauss channels: objects of
    # up to 20 px.
    window_px: int = 32
    channel_px: float = 14.0
    # Width of the rings on both sides of a halo's rim, number of its sectors, and the ring of
    # ground around an object.
    rim_px: float = 5.0
    sectors: int = 24
    ground_px: tuple[int, int] = (3, 9)
    # Artefact share: ceiling, slope and midpoint of the sigmoids of strength and of orientation;
    # the strength, in codes of 8 bits, from which a gradient counts with its power 1.5; and the
    # weight of weaker ones (Shreyamsha Kumar, Signal Image Video Process. 7, 2013).
    artefact_strength: tuple[float, float, float] = (0.9999, 19.0, 0.5)
    artefact_orientation: tuple[float, float, float] = (0.9995, 22.0, 0.5)
    artefact_least: float = 2.0
    artefact_weak: float = 0.001


TRUTH = TruthThresholds()
