"""The command run in this process, and what every refusal has in common."""

from dataclasses import replace
from pathlib import Path

from typer.testing import CliRunner, Result

from charact.cli.application import app
from labdata.sensors import load_camera, save_sensor


def charact(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def done_well(*arguments: object) -> Result:
    done = charact(*arguments)
    assert done.exit_code == 0, done.output
    return done


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
    save_sensor(replace(camera, ccd=replace(camera.ccd, rows=rows, columns=columns)), folder / f"{name}.toml")
    return folder / f"{name}.toml"
