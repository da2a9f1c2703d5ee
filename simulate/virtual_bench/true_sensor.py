"""True state of a virtual bench: a random device of the described type, and the errors of meter,
lamp and filters.
"""

import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labdata import BadInput, Camera, LampCalibration, from_toml, load_sensor, to_toml
from labdata.camera.parameters import Parameter
from simulate.virtual_bench.outputs import METER_RELATIVE_SD, Outputs, TargetPlacement, replace_file

# A range holds its value with 95 % probability: 1.96 standard deviations on either side.
TWO_SIDED_95 = 1.959964

# The parameters in which devices differ, where the camera has them; the rest are the type's.
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


def draw_true_sensor(sensor: Camera, seed: int) -> Camera:
    """Draw a device within the ranges of a description: the parameters of `VARIED`, exact; `seed`
    names the device.

    Notes
    -----
    Each side of the value is half a normal law whose 95 % point is the bound, cut off at the bound:
    a device outside the range of the sheet would be another camera.
    """
    known = sensor.parameters()
    drawn = {path: _within(known[path], _stream(seed, path)) for path in VARIED if path in known}
    specimen = sensor.with_values(
        {path: value for path, value in drawn.items() if value is not None}
    )
    note = f"A specimen drawn within the ranges of {sensor.name} with the seed {seed}."
    return replace(specimen, name=f"{sensor.name}, specimen {seed}", notes=(*sensor.notes, note))


def _stream(seed: int, path: str) -> np.random.Generator:
    """Random generator of one parameter, independent of the other parameters."""
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


TRUTH = "truth"
_LAMP = "lamp.toml"


@dataclass(frozen=True, kw_only=True)
class BenchTruth:
    """True state of the virtual bench."""

    sensor: Camera  #: The device, every parameter exact
    seed: int  #: Seed of the device and of every frame
    light_per_reading: float  #: True illuminance over the meter's reading, dimensionless
    #: What the lamp of the bench truly makes of its currents; None: there is none
    lamp: LampCalibration | None = None

    def illuminance_lux(self, placement: TargetPlacement, outputs: Outputs) -> float:
        """True illuminance on the photocathode, lux: room light plus lamp or, without a lamp, the
        operator's light.
        """
        return outputs.room_light_lux + self._source_lux(placement, outputs)

    def _source_lux(self, placement: TargetPlacement, outputs: Outputs) -> float:
        if outputs.lamp_a is None or self.lamp is None:
            return placement.illuminance_lux * self.light_per_reading
        position = outputs.filter_position if outputs.has_wheel else 1
        if position is None or position > len(self.lamp.filter_density) or outputs.lamp_a == 0.0:
            return 0.0  # the body of a turning wheel, and a position without a filter, are opaque
        # Below its calibration a diode's light goes on falling by the same power; so does the
        # truth.
        return (
            self.lamp.light_at(outputs.lamp_a, position, beyond_a=outputs.lamp_a).illuminance_lux
            or 0.0
        )


def load_or_draw_truth(
    folder: Path, sensor: Camera, seed: int, lamp: LampCalibration | None = None
) -> BenchTruth:
    """Draw a device, its meter and its lamp into a folder, or load them; another seed or sensor is
    BadInput.
    """
    asked = {"seed": seed, "drawn_from": sensor.name}
    if lamp is not None:
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / _LAMP, to_toml(_true_lamp(lamp, seed)))
    if (folder / "truth.json").is_file():
        stored = json.loads((folder / "truth.json").read_text())
        if {name: stored[name] for name in asked} != asked:
            raise BadInput(
                f"a virtual bench must keep its seed and sensor, got {asked} for the bench of "
                f"{stored}"
            )
        return read_truth(folder)
    meter = np.random.default_rng(np.random.SeedSequence((seed, 0x1D)))
    light_per_reading = float(np.exp(METER_RELATIVE_SD * meter.standard_normal()))
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / "sensor.toml", to_toml(draw_true_sensor(sensor, seed)))
    replace_file(
        folder / "truth.json", json.dumps({**asked, "light_per_reading": light_per_reading})
    )
    return read_truth(folder)


def read_truth(folder: Path) -> BenchTruth:
    """Read the truth kept in a folder."""
    values = json.loads((folder / "truth.json").read_text())
    return BenchTruth(
        sensor=load_sensor(folder / "sensor.toml"),
        seed=values["seed"],
        light_per_reading=values["light_per_reading"],
        lamp=from_toml(folder / _LAMP, LampCalibration) if (folder / _LAMP).exists() else None,
    )


def _true_lamp(lamp: LampCalibration, seed: int) -> LampCalibration:
    """Draw the true lamp within its calibration uncertainty: one error for all currents, one per
    filter.
    """
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0x1A)))
    brighter = float(rng.standard_normal())
    densities = (
        density + (lamp.filter_density_sd * float(rng.standard_normal()) if density else 0.0)
        for density in lamp.filter_density
    )
    pairs = zip(lamp.illuminance_lux, lamp.relative_sd, strict=True)
    return replace(
        lamp,
        illuminance_lux=tuple(
            lux * float(np.exp(relative_sd * brighter)) for lux, relative_sd in pairs
        ),
        relative_sd=(0.0,) * len(lamp.relative_sd),
        filter_density=tuple(max(0.0, density) for density in densities),
        filter_density_sd=0.0,
    )
