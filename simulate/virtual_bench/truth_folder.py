"""The truth of a virtual bench, kept apart from the session: specimen, seed, the errors of meter, lamp and filters."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labdata.calibration import LampCalibration
from labdata.errors import BadInput
from labdata.sensor import Sensor
from labdata.serialiser import from_toml, to_toml
from simulate.virtual_bench.operator import METER_RELATIVE_SD, TargetPlacement
from simulate.virtual_bench.outputs import Outputs, replace_file
from simulate.virtual_bench.true_sensor import draw_true_sensor

TRUTH = "truth"
_LAMP = "lamp.toml"


@dataclass(frozen=True, kw_only=True)
class BenchTruth:
    """What the virtual bench really is.

    Parameters
    ----------
    sensor
        The specimen, every parameter exact.
    seed
        Seed of the specimen and of every frame.
    light_per_reading
        True illuminance over the meter's reading, dimensionless.
    lamp
        What the lamp of the bench truly makes of its currents; None: there is none.
    """

    sensor: Sensor
    seed: int
    light_per_reading: float
    lamp: LampCalibration | None = None

    def illuminance_lux(self, placement: TargetPlacement, outputs: Outputs) -> float:
        """True illuminance on the photocathode, lux: the room's, and the lamp's or, without one, an operator's."""
        return outputs.room_light_lux + self._source_lux(placement, outputs)

    def _source_lux(self, placement: TargetPlacement, outputs: Outputs) -> float:
        if outputs.lamp_a is None or self.lamp is None:
            return placement.illuminance_lux * self.light_per_reading
        position = outputs.filter_position if outputs.has_wheel else 1
        if position is None or position > len(self.lamp.filter_density) or outputs.lamp_a == 0.0:
            return 0.0  # the body of a turning wheel, and a position without a filter, are opaque
        # Below its calibration a diode's light goes on falling by the same power; so does the truth.
        return self.lamp.light_at(outputs.lamp_a, position, beyond_a=outputs.lamp_a).illuminance_lux or 0.0


def load_or_draw_truth(folder: Path, sensor: Sensor, seed: int, lamp: LampCalibration | None = None) -> BenchTruth:
    """Draw a specimen of a sensor, its meter and its lamp and keep them in a folder, or find the same ones there again.

    Raises
    ------
    BadInput
        If the folder holds the truth of another seed or sensor.
    """
    asked = {"seed": seed, "drawn_from": sensor.name}
    if lamp is not None:
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / _LAMP, to_toml(_true_lamp(lamp, seed)))
    if (folder / "truth.json").is_file():
        there = json.loads((folder / "truth.json").read_text())
        if {name: there[name] for name in asked} != asked:
            raise BadInput(f"a virtual bench must keep its seed and sensor, got {asked} for the bench of {there}")
        return read_truth(folder)
    meter = np.random.default_rng(np.random.SeedSequence((seed, 0x1D)))
    light_per_reading = float(np.exp(METER_RELATIVE_SD * meter.standard_normal()))
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / "sensor.toml", to_toml(draw_true_sensor(sensor, seed)))
    replace_file(folder / "truth.json", json.dumps({**asked, "light_per_reading": light_per_reading}))
    return read_truth(folder)


def read_truth(folder: Path) -> BenchTruth:
    """Read the truth kept in a folder."""
    values = json.loads((folder / "truth.json").read_text())
    return BenchTruth(
        sensor=from_toml(folder / "sensor.toml", Sensor),
        seed=values["seed"],
        light_per_reading=values["light_per_reading"],
        lamp=from_toml(folder / _LAMP, LampCalibration) if (folder / _LAMP).exists() else None,
    )


def _true_lamp(lamp: LampCalibration, seed: int) -> LampCalibration:
    """Draw what a lamp truly makes, within its calibration's uncertainty: one error for all currents, one a filter."""
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0x1A)))
    brighter = float(rng.standard_normal())
    densities = (
        density + (lamp.filter_density_sd * float(rng.standard_normal()) if density else 0.0)
        for density in lamp.filter_density
    )
    pairs = zip(lamp.illuminance_lux, lamp.relative_sd, strict=True)
    return replace(
        lamp,
        illuminance_lux=tuple(lux * float(np.exp(relative_sd * brighter)) for lux, relative_sd in pairs),
        relative_sd=(0.0,) * len(lamp.relative_sd),
        filter_density=tuple(max(0.0, density) for density in densities),
        filter_density_sd=0.0,
    )
