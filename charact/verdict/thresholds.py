"""Thresholds of what a session is enough for."""

#: Least number of levels of a photon transfer curve: two make a slope, a third shows whether the
#: variance follows the signal
LEVELS = 3
#: Least number of levels of a data sheet (EMVA 1288 Release 4.0 Linear, 6.5)
EMVA_LEVELS = 50
#: Least number of frames of which fixed patterns are a mean (EMVA 1288 Release 4.0 Linear, 8.1)
PATTERN_FRAMES = 16
#: Least MTF50 of a camera without a tube that is in focus, cy/px. A lens at f/16 has .16 at 550 nm
#: on pixels of 3.45 µm, and pixels below 2 µm at f/16 are used by nobody
LEAST_MTF50_CY_PER_PX = 0.08
#: Least angle between targets that show rows and columns: nearer to 90 than to 0 degrees
LEAST_TURN_DEG = 45.0
#: Largest half-width of the 95 % interval with which a quantity decides, percent of its value
LARGEST_PERCENT = {
    # Slanted edges of one camera repeat to 2 to 5 % (Burns, PICS 2000); less is no difference
    "mtf50": 5.0,
    # Data sheets of cameras state K to two digits
    "system_gain": 5.0,
    # Luminous gains of tubes of one type differ by a factor of 2, those of one tube by 10 % in use
    "covariance_gain": 10.0,
    # Two standard uncertainties of a calibrated photodiode of 3 to 5 % (EMVA 1288, 6.3)
    "quantum_efficiency": 10.0,
    # It contains K, and of saturation by frames the step between two levels
    "saturation_capacity": 10.0,
    # What limits dim pictures; makers state one digit
    "read_noise": 20.0,
    "dsnu": 20.0,
    "prnu": 20.0,
    # Diameters of one source differ by a pixel of some ten
    "bloom_diameter": 10.0,
    # NETD is stated in steps of 5 mK of some 50
    "netd": 10.0,
}
