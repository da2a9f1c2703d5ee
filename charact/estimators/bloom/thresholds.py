"""Thresholds of the bloom room that decide what is flagged or left out, and the refusal of what
stays beyond one.
"""


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
# Distance of a Gaussian's optimum from the median of its draws, over their standard deviation,
# above which bounds truncate it: half of the 1.1 of a bound through the optimum.
CUT_SD = 0.5
