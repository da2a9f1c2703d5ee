"""The numbers that decide about bars, one a line with its source."""

# Length of a bar over its width of a target whose length the picture does not tell: STANAG 4349.
LENGTH_OVER_WIDTH = 7.0
# Share of the best match that the standard length must reach to be kept: a tenth of the length costs a tenth of it.
LENGTH_MATTERS = 0.9
# A grating of more bars than this is none that charts have (ISO 12233: 5 to 9, NBS 1963A: 15).
MAX_BARS = 60
# Share of a profile's variance that N blurred bars explain at least; an edge or a spot leaves more than half.
MIN_EXPLAINED = 0.6
# Share of the best explanation from which on a stronger wave is preferred: side lobes explain as much at times.
NEARLY = 0.9
# Peaks of a spectrum that are looked at: the bars', their harmonics', those of the patch along and across them.
PEAKS = 8
# A stated frequency and that of the peak differ by so much at most: the width f/N of the peak of three bars' rim.
STATED_SLACK = 0.15
# Share of its highest amplitude that a wave keeps within the bars: at an even patch's border it is one half.
PATCH_LEVEL = 0.5
# A demodulated picture is averaged so far, standard deviation in periods: the patch's own light is 1e-3 of itself then.
SMOOTHED_PERIODS = 0.6
# A patch's extent tells the number of its bars to so many.
COUNT_RANGE = 2

# A fundamental this many standard errors high over a whole target is bars; noise alone has up to about five.
MIN_SIGNAL_SD = 5.0
# The light of bars that run through a region, in its own standard errors.
MIN_LIGHT_SD = 9.0
# The zeros beside the fundamental, over it, and in their standard errors: more than this is another object.
OTHER_OBJECT, OTHER_OBJECT_SD = 0.5, 3.5
# Significance from which the zeros tell the bars' own frequency better than whoever asked, and a change worth telling.
MIN_FREQUENCY_SIGNAL_SD, FREQUENCY_TOLERANCE = 30.0, 0.01
# A window that reaches less far beyond the bars cuts off their core's blur, not only a halo.
MIN_MARGIN_PX = 5.0
# Share of the MTF that the digitiser's steps may move without a flag: more is beyond their first order.
COARSE = 0.1
# The fitted window reaches so far beyond the bars, px and periods.
FITTED_PX, FITTED_PERIODS = 20.0, 1.5
# Light elsewhere: over this share of the target's height.
OTHER_FRACTION = 0.04
# Noise of a frame that whole codes hide, DN, and that floats hide, of the bars' height: the table is off by as much.
STILL_DN, STILL_FRACTION = 0.4, 1e-3
# The zeros beside the fundamental, over it: more is bars of another frequency.
DOUBTFUL = 0.15
# Half way to the lower zero as many bars have at least their fundamental's share of light; twice as many have none.
MIN_FLANK = 0.6
# Distance between the bars of both fields that counts, px, and the sine of the direction up to which bars are upright.
FIELD_OFFSET_PX, UPRIGHT = 0.04, 0.5
# Standard errors of what is there for sure.
SIGNIFICANT = 5.0
# How far a fundamental and its alias must lie apart, in widths of either: two, of whose rims a tenth does no harm.
MIN_ALIAS_DISTANCE = 1.8
# Travel of the bars over the rows that averages the alias away, px.
MIN_TRAVEL_PX = 0.8
# Second harmonic over the fundamental that bars and gaps a little unequal make, and its noise in standard errors.
STRAIGHT, STRAIGHT_SD = 0.006, 3.5
# A fit's misfit over the bars' height, and its departure from the family over that expected.
MISFIT, DEPARTED = 0.02, 3.5
# An MTF of fewer standard errors is an upper limit: of those that chance lifts over two, too many would be ok.
MIN_FUNDAMENTAL_SD = 3.0
