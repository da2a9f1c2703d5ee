"""Numbers that decide how a file of frames is read, with their sources."""

MOST_EXPANSION = 5000
"""Bytes of pixels that a byte of a packed file may stand for: deflate reaches 1032, LZW about 2700."""

MOST_PICTURE_PX = 2**28
"""Pixels of a picture, 268 million: the largest sensors of cameras have 247 million (Sony IMX811)."""

MOST_OF_MEMORY = 0.5
"""Part of the machine's memory for a file's unpacked frames; measuring them takes another copy of real numbers."""

LEAST_COLOUR_SIDE_PX = 8
"""Shortest side of a picture whose last axis of 3 or 4 is read as colours; no target is measured in fewer pixels."""

MOST_OBLONG = 4
"""Height over width beyond which pages read as a transposed stack; detectors and screens stay below 3 (cinema 2.4)."""

THUMBNAIL = 0.25
"""Largest ratio of pixels of a reduced copy: the next level of an image pyramid has half the rows and columns."""

MOST_MASKED = 0.005
"""Largest fraction of pixels inside the picture that are not finite; as many misbehaving pixels as sensors have."""

LEAST_PIXELS = 4
"""Pixels at the highest value that make it the end of a scale; fewer may be the single highest of a noise."""

LEAST_BITS = 9
"""Fewest bits of a digitiser in a wider type; 8 bits have a type of their own."""

MOST_BITS = 16
"""Most bits of a digitiser of pictures."""

MOSAIC_LEVEL = 0.01
"""Least checkerboard amplitude over the mean level of a mosaic; the PRNU of sensors averages out below it."""

MOSAIC_SIGNIFICANCE = 8.0
"""Least checkerboard amplitude in its standard errors; 1e-15 by chance."""
