"""Thresholds of the bloom room that decide what is flagged or left out, and the refusal of what
stays beyond one.
"""

from dataclasses import dataclass


class Unmeasurable(Exception):
    """What is sought cannot be measured; the message becomes the refusal's reason."""


# Significance of a defective pixel in the mean dark, standard deviations: 1e-15 for Gaussian noise.
DARK_DEFECT_SD = 8.0
# Significance in an illuminated frame, at which a real source is visible in the four neighbours in
# spite of noise.
DEFECT_SD = 30.0
# Minimum excess of a defective pixel, DN: quantisation may leave darks without noise.
LEAST_DEFECT_DN = 2.0
# Neighbours' signal (without the brightest) over the pixel's below which it is a defect (a Gaussian
# of 0.35 px gives 0.30), and the noise of their sum of seven, standard deviations.
LIT_NEIGHBOURS, NEIGHBOUR_SD = 0.15, 9.0
# Fraction of single bright pixels above which they are noise: twice the defects of commercial
# sensors.
MOST_DEFECTS = 0.01


@dataclass(frozen=True)
class RimThresholds:
    """Decide about the edge of a halo; chosen on drawn discs, rings and smooth halos, not blind."""

    # Step over a smooth curve alone, standard errors: the largest of the some 60 radii of a smooth
    # halo has 4, that of a disc of 2 % of the light 8 and more.
    least_sd: float = 6.0
    # Error of a mixture of Gaussians about the core, over that of noise: cores that are none give
    # steps of 5 standard errors on drawn smooth halos, small discs of 10 and more.
    about_core: float = 1.6
    # Significance of an edge other than the clearest one: the sides of a step have up to 3 % of it.
    other_edge: float = 0.25
    # Rings on either side of the edge that a step needs.
    rings_per_side: int = 3
    # Error of a ring over its light, and over that of the step: pixels and centre that are not as
    # modelled.
    model_error: float = 1e-3
    # Cost of a rim where no tube is known that makes one, and of one of any width, whose amplitudes
    # are more, there and behind a tube, in -2 ln of the odds of a stack: a judgement. With less,
    # rims of discs are made of errors that the stacks share.
    cost: float = 6.0
    cost_of_any: float = 8.0
    cost_in_tube: float = 30.0
    # Blur of a step that is no edge, standard deviations of the core, and px where that is unknown:
    # a judgement.
    soft_px: float = 4.0
    soft_cores: float = 1.85
    # Fall of chi squared by the rings of a core, and over that of the median frequency: the rings
    # of clear pupils have 50 to 2,600 and 2.5 to 35, other cores up to 60 and 2.
    ringing_gain: float = 50.0
    ringing_ratio: float = 2.2
    # Error of a radius by the centre and the shape of pixels, px.
    error_px: float = 0.007


RIM = RimThresholds()
