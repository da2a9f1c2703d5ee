"""Sensor descriptions: the shipped ones by name, others by path."""

from importlib import resources
from pathlib import Path

from labdata.border import from_toml, to_toml
from labdata.durable import write_durably
from labdata.errors import BadInput
from labdata.sensor import Sensor


def shipped() -> tuple[str, ...]:
    """Names of the sensor descriptions that come with the package."""
    files = resources.files("labdata.sensors").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def load_sensor(name_or_path: str | Path, relative_to: str | Path | None = None) -> Sensor:
    """Read a sensor description.

    Parameters
    ----------
    name_or_path
        Name of a shipped description, or path of a TOML file.
    relative_to
        Folder that a relative path starts from; None: the present one.

    Raises
    ------
    BadInput
        If there is no such description, or it breaks a rule.
    """
    if str(name_or_path) in shipped():
        with resources.as_file(resources.files("labdata.sensors") / f"{name_or_path}.toml") as path:
            return from_toml(path, Sensor)
    path = Path(relative_to or ".") / Path(name_or_path).expanduser()
    if not path.is_file():
        raise BadInput(
            f"a sensor must be one of {', '.join(shipped())} or the path of a TOML file, got {str(name_or_path)!r}"
        )
    return from_toml(path, Sensor)


def save_sensor(sensor: Sensor, path: str | Path) -> None:
    """Write a sensor description, whole or not at all."""
    write_durably(path, to_toml(sensor).encode())
