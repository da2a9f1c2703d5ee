"""Thresholds of the importers, with their sources."""

# Shortest side, px, of an image whose last axis of 3 or 4 is colours; targets need more pixels
LEAST_COLOUR_SIDE_PX = 8

# Aspect ratio above which an array is a transposed stack; detectors have less than 3 (cinema 2.4)
MOST_OBLONG = 4
# Largest pixel ratio of a reduced copy: the next pyramid level has half the rows and columns
THUMBNAIL = 0.25
# Largest fraction of non-finite pixels inside the border, as of defective pixels of sensors
MOST_MASKED = 0.005
LEAST_PIXELS = 4  # Smallest number of pixels at full scale; a single highest pixel may be noise
LEAST_BITS = 9  # Fewest bits of a digitiser in a wider type; 8 bits have their own type
MOST_BITS = 16  # Most bits of an image digitiser
# Smallest relative checkerboard amplitude of a mosaic; the PRNU of sensors averages to less
MOSAIC_LEVEL = 0.01
# Smallest checkerboard amplitude of a mosaic in standard errors; chance 1e-15
MOSAIC_SIGNIFICANCE = 8.0
MOST_NAMED = 8  # Pictures of one file that a message lists; larger ones have their own index
# Conditions that a header can mean: drivers write -999 for no temperature, observatories kelvins;
# other settings are not 0, which stands for none
POSSIBLE = {
    "exposure_s": (0.0, 1e9),
    "em_gain": (1.0, 1e6),
    "camera_gain_db": (-100.0, 100.0),
    "temperature_c": (-150.0, 100.0),
}
POSSIBLE_SETTING = 1e-6, 1e12
MOST_EXPOSURES = 1e9  # Exposures in one frame, more than a year of the fastest cameras
