"""The command run in this process, and what every refusal has in common."""

import json
from dataclasses import replace
from pathlib import Path

from typer.testing import CliRunner, Result

from charact.cli.application import app
from labdata import load_camera, save_sensor


def charact(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def done_well(*arguments: object) -> Result:
    done = charact(*arguments)
    assert done.exit_code == 0, done.output
    return done


def json_of(*arguments: object) -> dict:
    """Return the JSON object that a command prints, whether it succeeds or not."""
    return json.loads(charact(*arguments, "--json").stdout)


def assert_one_sentence(done: Result, *words: str) -> None:
    assert done.exit_code == 1, done.output
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    sentence = done.stderr.strip()
    assert len(sentence.splitlines()) == 1, sentence
    assert "Traceback" not in done.output
    for word in words:
        assert word in sentence, sentence


def small_camera(folder: Path, rows: int, columns: int, name: str = "pulnix-ag5745ef3") -> Path:
    """Write the description of a shipped camera with a small chip, and return its path."""
    camera = load_camera(name)
    save_sensor(
        replace(camera, ccd=replace(camera.ccd, rows=rows, columns=columns)),
        folder / f"{name}.toml",
    )
    return folder / f"{name}.toml"


# A scene of level ground and a box, whose size and place are to be added at its end; CAMERA is
# where the camera stands.
LAWN = """
name = "a box on a lawn"
place = { latitude_deg = 43.16, longitude_deg = -77.61, time = 1998-06-24T02:00:00-04:00 }
weather = { temperature_c = 16, relative_humidity = 0.7, wind_m_s = 1 }
camera = { CAMERA }
[[material]]
label = "lawn"
library = "green-canopy"
[[material]]
label = "paint"
library = "olive-drab-paint"
[[object]]
label = "ground"
shape = "ground"
size_m = [400]
material = "lawn"
[[object]]
label = "box"
shape = "box"
material = "paint"
"""


def small_imager(folder: Path, name: str, table: str, **size: int) -> Path:
    """Write the description of a shipped thermal imager with few pixels as thermal.toml, and return
    its path.
    """
    imager = load_camera(name)
    few = replace(getattr(imager, table), **size)
    save_sensor(replace(imager, **{table: few}), folder / "thermal.toml")
    return folder / "thermal.toml"
