"""A specimen: one camera of the kind that a description describes, drawn within its ranges."""

import zlib
from dataclasses import replace

import numpy as np

from labdata.parameter import Parameter
from labdata.sensor import Sensor

# What differs from one specimen to the next and what a bench can tell. The rest is the same in every camera of a kind.
VARYING = (
    "optics.aberration_blur_um",
    "photocathode.luminous_sensitivity_ua_per_lm",
    "photocathode.ebi_lm_per_cm2",
    "photocathode.gap_mm",
    "photocathode.halo_fraction",
    "microchannel_plate.detection_probability",
    "tube.luminous_gain",
    "tube.mtf_frequency_lp_per_mm",
    "tube.mtf_exponent",
    "tube.post_gain_share",
    "taper.transmission",
    "ccd.quantum_efficiency",
    "ccd.read_noise_e",
)
# Half of a 95 % range in standard deviations; also where the draw is cut off, so that ranges are kept.
HALF_RANGE_SD = 1.959964


def draw_truth(sensor: Sensor, seed: int) -> Sensor:
    """Return a specimen whose varying parameters are drawn within their ranges, every parameter exact.

    Parameters
    ----------
    sensor
        The description; ranges hold their parameter with 95 % probability.
    seed
        Seed; each parameter has its own stream, so that a new one does not move the others.

    Returns
    -------
    Sensor
        The specimen. Its name says from what and with which seed it was drawn.
    """
    drawn = {path: _drawn(path, parameter, seed) for path, parameter in sensor.parameters().items() if path in VARYING}
    return replace(sensor.with_values(drawn), name=f"{sensor.name}, specimen of seed {seed}")


def _drawn(path: str, parameter: Parameter, seed: int) -> float:
    """Draw from a normal distribution split at the best value and cut off at the ends of the range."""
    if parameter.low is None or parameter.high is None:
        return parameter.value
    rng = np.random.default_rng(np.random.SeedSequence((seed, zlib.crc32(path.encode()))))
    while abs(z := rng.standard_normal()) > HALF_RANGE_SD:
        pass
    end = parameter.high if z > 0 else parameter.low
    return parameter.value + abs(z) / HALF_RANGE_SD * (end - parameter.value)
