"""Thresholds of the bloom room that decide what is flagged or left out."""

# Standard deviations by which a pixel of the mean dark stands out of its neighbours: one in 1e15 of Gaussian noise.
DARK_DEFECT_SD = 8.0
# The same of a lit frame, whose four neighbours then show light of a real source in spite of noise.
DEFECT_SD = 30.0
# Least excess of a misbehaving pixel, DN: rounding leaves darks without noise.
LEAST_DEFECT_DN = 2.0
# Light of a pixel's neighbours but the brightest over its own below which no optics lit it (a Gaussian of 0.35 px gives
# 0.30), and what noise makes of the sum of seven, in standard deviations.
LIT_NEIGHBOURS, NEIGHBOUR_SD = 0.15, 9.0
# Fraction of the pixels from which on single bright ones are noise: twice what sensors on sale have.
MOST_DEFECTS = 0.01
# Distance of a Gaussian's peak from the middle of its draws, over their standard deviation, from which bounds cut it: a
# bound through the peak itself makes 1.1 (a half Gaussian's median over its deviation), and this is half as much.
CUT_SD = 0.5
