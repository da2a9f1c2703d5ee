"""Thresholds of the search for points, of their neighbours and of the search for a form, each with its source."""

# px; peaks nearer than this are parts of one spot: the smoothing of the search leaves no saddle between them.
NEXT_PX = 5
# Part of the lower peak's height; light between two sources falls below it, on the flank of one spot it does not.
SADDLE = 0.5
# Part of the brightest source's height; a region is drawn around one that is not much fainter than its neighbours.
ALIKE = 0.25
# px; a source alone this far keeps its own pixels: those of two sources, `NEIGHBOUR_PX` about each, do not touch.
ALONE_PX = 6.0
# px; pixels this near a neighbour are its own: three sigma of a spot of 1 px.
NEIGHBOUR_PX = 3.0
# px; light of neighbours is modelled up to the corner of the core (9 px) and their own reach (7 px).
FELT_PX = 16.0
# Quantiles of a smoothed picture of which half or more is bare, and their distance in standard deviations (normal law).
BARE, BARE_SD = (0.05, 0.25), 0.97
# A source this many times as high as is needed stands out whatever its neighbours do; below, this many neighbours as
# bright as `ALIKE` make a dense field.
DENSE, MIN_NEIGHBOURS = 3.0, 3
# Peaks of a region that are looked at, for speed.
MAX_PEAKS = 100
# Cores that are tried with light beyond them, the likeliest ones, for speed.
MAX_CORES = 4
# Part of the noise that a form leaves of one frame by which the next turn weighs: forms that fit better are found where
# misfit does not pass for noise (strangers' draws: a defocus of 0.46 waves taken for a tube).
LOWER = (0.1, 1.0)
# Half frequency in focus over that of the blur, and square of the defocus, waves^2, of a second start: half a wave
# about halves MTF50 (`charact.mtf.blur_models.pupil_table`).
FAR_FROM_FOCUS = (2.0, 0.25)
