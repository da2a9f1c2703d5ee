"""Response and noise of a camera without a tube, for many draws of its parameters at once.

    y = b + s (1 - c s / full scale),  s = K0 g eta p,  K0 = K 10^(G/20) / (1 - 2.1 c)

b: black level; p photons a pixel; eta: quantum efficiency; g: gain of the register; G: gain of the
camera, dB; c: compression. K is the slope of EMVA 1288, of variance over signal from none to 70 %
of full scale.
"""

import numpy as np

from charact.observables.observable import Values
from charact.observables.thresholds import SILICON
from labdata import Array
from labdata.camera.chip import excess_noise_factor
from labdata.conditions import Conditions

CONVERSION_GAIN = "video.conversion_gain_dn_per_e"
READ_NOISE = "ccd.read_noise_e"
DARK_CURRENT, DOUBLING = "ccd.dark_current_e_per_s", "ccd.dark_current_doubling_k"
BLACK_LEVEL = "video.black_level_dn"
HEIGHTS = "register.pulse_height_shape"
COMPRESSION, OFFSET = "readout.compression_fraction", "readout.exposure_offset_us"
ROW_NOISE, ROW_EXPONENT = "readout.row_noise_dn2", "readout.row_noise_exponent"
FINE_RATIO = "readout.fine_noise_ratio"
INTERFERENCE = "readout.interference_dn2"
ACROSS, DOWN = "readout.interference_x_cy_per_px", "readout.interference_y_cy_per_px"
EMVA_SLOPE = 3.0 * SILICON.emva_reach


def em_gain(values: Values, conditions: Conditions) -> Array:
    """Return the multiplication of the register: that of the conditions, else the description's."""
    return (
        values["register.em_gain"] if conditions.em_gain is None else np.array([conditions.em_gain])
    )


def dn_per_electron(values: Values, conditions: Conditions) -> Array:
    """Return DN per electron behind the register at no signal, with the camera's gain in dB."""
    amplified = values[CONVERSION_GAIN] * 10.0 ** ((conditions.camera_gain_db or 0.0) / 20.0)
    return amplified / (1.0 - EMVA_SLOPE * values[COMPRESSION])


def register_excess(values: Values, conditions: Conditions) -> Array:
    """Return F^2 = 1 + (F0^2 - 1) / shape of the register; F0^2 is that of exponential pulse
    heights.
    """
    gain, stages = em_gain(values, conditions), float(values["register.stages"][0])
    exponential = np.array([excess_noise_factor(float(draw_gain), stages) for draw_gain in gain])
    return 1.0 + (exponential - 1.0) / values[HEIGHTS]


def dark_electrons(values: Values, conditions: Conditions, seconds: float) -> Array:
    """Return the dark charge of an exposure at the camera's temperature, e-."""
    return values[DARK_CURRENT] * warmth(values, conditions) * seconds


def warmth(values: Values, conditions: Conditions) -> Array:
    """Return dark current over that at 25 C."""
    warmer = (
        0.0 if conditions.temperature_c is None else conditions.temperature_c - SILICON.reference_c
    )
    return 2.0 ** (warmer / values[DOUBLING])


def amplification(conditions: Conditions) -> tuple[str, ...]:
    """Return the paths of the gain from electrons to DN: that of a register only where none is
    stated.
    """
    register_gain = ("register.em_gain",) if conditions.em_gain is None else ()
    return (CONVERSION_GAIN, *register_gain)


def cooling(conditions: Conditions) -> tuple[str, ...]:
    """Return the path of the temperature law where a temperature other than the reference is
    stated.
    """
    return () if conditions.temperature_c in (None, SILICON.reference_c) else (DOUBLING,)


def dark_variance(values: Values, conditions: Conditions, seconds: float) -> Array:
    """Return the temporal variance of a dark frame, DN^2.

    K^2 (r^2 + g^2 F^2 (d + c)) + 1/12 with read noise r, gain g and excess noise factor F^2 of the
    register, dark charge d and clock-induced charge c.
    """
    charge = dark_electrons(values, conditions, seconds) + values["register.clock_induced_e"]
    multiplied = em_gain(values, conditions) ** 2 * register_excess(values, conditions) * charge
    return (
        dn_per_electron(values, conditions) ** 2 * (values[READ_NOISE] ** 2 + multiplied)
        + SILICON.rounding_dn2
    )


def row_density(values: Values, frequency: Array) -> Array:
    """Return the spectral density of the rows' offsets, s (4 f)^-a, shape (n, frequency), DN^2."""
    logarithm = -values[ROW_EXPONENT][:, None] * np.log(4.0 * frequency)
    # Exponents far beyond any prior must not overflow.
    return values[ROW_NOISE][:, None] * np.exp(np.minimum(logarithm, 300.0))


def row_variance(values: Values, rows: int) -> Array:
    """Return the variance of the rows' offsets within a frame of so many rows, shape (n,), DN^2."""
    return row_density(values, np.arange(1, rows // 2 + 1) / rows).mean(axis=1)


def neighbour_variance(values: Values, rows: int) -> Array:
    """Return the variance that offsets of rows and interference add to a pixel, shape (n,),
    DN^2.
    """
    return row_variance(values, rows) + values[INTERFERENCE]


def neighbour_covariance(values: Values, read_noise_dn: Array) -> Array:
    """Return the covariance of neighbours along a row by read noise, shape (n,), DN^2.

    A density 1 + 2 r cos(2 pi f) with the ratio q of 0.5 to 0 cy/px has r = (1 - q)/(2 (1 + q)).
    """
    ratio = values[FINE_RATIO]
    return 0.5 * (1.0 - ratio) / (1.0 + ratio) * read_noise_dn**2
