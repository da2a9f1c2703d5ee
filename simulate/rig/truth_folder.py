"""The truth of a virtual bench, kept apart from the session: the specimen, its seed, and the error of its meter."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labdata.border import from_toml, to_toml
from labdata.errors import BadInput
from labdata.sensor import Sensor
from simulate.rig.operator import METER_RELATIVE_SD
from simulate.rig.outputs import replace_file
from simulate.rig.truth import draw_truth

TRUTH = "truth"


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What the virtual bench really is.

    Parameters
    ----------
    sensor
        The specimen, every parameter exact.
    seed
        Seed of the specimen and of every frame.
    light_per_reading
        True illuminance over the meter's reading, dimensionless.
    """

    sensor: Sensor
    seed: int
    light_per_reading: float


def make_truth(folder: Path, sensor: Sensor, seed: int) -> Truth:
    """Draw a specimen of a sensor and its meter and keep them in a folder, or find the same ones there again.

    Raises
    ------
    BadInput
        If the folder holds the truth of another seed or sensor.
    """
    asked = {"seed": seed, "drawn_from": sensor.name}
    if (folder / "truth.json").is_file():
        there = json.loads((folder / "truth.json").read_text())
        if {name: there[name] for name in asked} != asked:
            raise BadInput(f"a virtual bench must keep its seed and sensor, got {asked} for the bench of {there}")
        return read_truth(folder)
    meter = np.random.default_rng(np.random.SeedSequence((seed, 0x1D)))
    light_per_reading = float(np.exp(METER_RELATIVE_SD * meter.standard_normal()))
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / "sensor.toml", to_toml(draw_truth(sensor, seed)))
    replace_file(folder / "truth.json", json.dumps({**asked, "light_per_reading": light_per_reading}))
    return read_truth(folder)


def read_truth(folder: Path) -> Truth:
    """Read the truth kept in a folder."""
    values = json.loads((folder / "truth.json").read_text())
    return Truth(
        sensor=from_toml(folder / "sensor.toml", Sensor),
        seed=values["seed"],
        light_per_reading=values["light_per_reading"],
    )
