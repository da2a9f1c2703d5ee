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
# Light that grows with the source is glare where its level far from the source is at least this fraction of that near
# it; standard errors by which both must differ to tell.
EVEN, LEAK_SD = 0.5, 3.0
# Distance beyond the last ring, px, and number of pixels, from which on the frame has a level far from the source; the
# mean of whole codes is known no better than this, DN.
BEYOND_PX, LEAST_FAR, LEAST_LEVEL_DN = 4.0, 400, 0.02
