"""Limits beyond which a pixel misbehaves."""

# Robust standard deviations of a pixel's mean from those around it: a normal law puts one pixel of 10^14 beyond.
FAR = 8.0
# Standard deviations of a difference of two values: a normal law puts one of 10^9 beyond.
SUDDEN = 6.15
# Decades of probability by which the tail of the differences is extended from those of one in 100 and one in 1000. An
# exponential tail puts one of 10^7 beyond, a normal one of 10^9.
DECADES = 4.0
# Variance over signal of a stage that multiplies: exponential pulse heights of F^2 = 2 put e^-50 beyond, and the peak
# of a blurred pulse a third as far e^-17.
LARGEST_PULSE = 25.0
# Share of the pixels that may depart suddenly in a stack of darks before they count as its own law (issue: blinking
# pixels up to 0.5 % of all), and share beyond which what stands apart is no minority and nothing is masked.
BLINKING_SHARE = 0.006
MOST_SHARE = 0.02
# Chance that a session has one sound pixel taken for blinking, and by how much the rate of sudden departures may vary
# over the image, as shading makes that of pulses.
CHANCE = 0.05
UNEVEN = 3.0
# Smallest image, px, in which the few stand out from the many.
LEAST_PIXELS = 1024
LEAST_SIDE = 16
# Values that quantiles are taken from, and stacks whose means are compared pixel by pixel.
SAMPLE = 2**14
MEANS = 8
# Distance within which a pixel is replaced by another, px.
NEAR = 32
