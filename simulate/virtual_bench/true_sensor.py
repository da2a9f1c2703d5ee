"""The specimen behind the virtual bench: a camera of the sheet's type whose numbers nobody was told."""

import zlib
from dataclasses import replace

import numpy as np

from labdata.camera_description import Parameter
from labdata.sensor import Sensor

# A range holds its value with 95 % probability: 1.96 standard deviations on either side.
TWO_SIDED_95 = 1.959964

# The parameters in which specimens differ, where the camera has them; the rest are the type's.
VARIED = (
    "optics.aberration_blur_um",
    "photocathode.luminous_sensitivity_ua_per_lm",
    "photocathode.ebi_lm_per_cm2",
    "photocathode.gap_mm",
    "photocathode.halo_fraction",
    "photocathode.halo_elastic_share",
    "microchannel_plate.detection_probability",
    "tube.luminous_gain",
    "tube.mtf_frequency_lp_per_mm",
    "tube.mtf_exponent",
    "tube.post_gain_share",
    "taper.transmission",
    "ccd.quantum_efficiency",
    "ccd.read_noise_e",
    "ccd.prnu",
    "video.bandwidth_mhz",
)


def draw_true_sensor(sensor: Sensor, seed: int) -> Sensor:
    """Draw a specimen within the ranges of a description.

    Parameters
    ----------
    sensor
        The type: each varied parameter's `low` and `high` hold it with 95 % probability.
    seed
        Seed; it names the specimen.

    Returns
    -------
    Sensor
        The same description with the parameters of `VARIED` drawn and exact; its notes record the seed.

    Notes
    -----
    Each side of the value is half a normal law whose 95 % point is the bound, cut off at the bound: a specimen outside
    what the sheet calls possible would be another camera.
    """
    known = sensor.parameters()
    drawn = {path: _within(known[path], _stream(seed, path)) for path in VARIED if path in known}
    specimen = sensor.with_values({path: value for path, value in drawn.items() if value is not None})
    note = f"A specimen drawn within the ranges of {sensor.name} with the seed {seed}."
    return replace(specimen, name=f"{sensor.name}, specimen {seed}", notes=(*sensor.notes, note))


def _stream(seed: int, path: str) -> np.random.Generator:
    """A parameter's own random numbers: to vary one more moves none of the others."""
    return np.random.default_rng([seed, zlib.crc32(path.encode())])


def _within(parameter: Parameter, rng: np.random.Generator) -> float | None:
    """A value within a parameter's bounds; None where the parameter is exact."""
    if parameter.low is None or parameter.high is None:
        return None
    while True:
        deviate = float(rng.standard_normal())
        side = parameter.high if deviate > 0.0 else parameter.low
        if abs(deviate) <= TWO_SIDED_95:
            return parameter.value + abs(deviate) / TWO_SIDED_95 * (side - parameter.value)
