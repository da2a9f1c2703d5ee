"""Sensor descriptions: the shipped ones by name, others by path."""

import tomllib
from pathlib import Path

from labdata.errors import BadInput
from labdata.file_io import names_of_shipped, path_of_shipped, write_atomically
from labdata.infrared_imager import KINDS, InfraredImager
from labdata.sensor import Sensor
from labdata.serialiser import from_toml, to_toml
from labdata.solid_state import SolidStateCamera

Camera = Sensor | SolidStateCamera | InfraredImager


def sensor_names() -> tuple[str, ...]:
    """Names of the camera descriptions that come with the package."""
    return names_of_shipped("sensors")


def load_sensor(name_or_path: str | Path, relative_to: str | Path | None = None) -> Sensor:
    """Read the description of an intensified camera, as `load_camera`; one without a tube is
    BadInput.
    """
    camera = load_camera(name_or_path, relative_to)
    if not isinstance(camera, Sensor):
        raise BadInput(
            f"a sensor must be an intensified camera, got {camera.name!r}, which has no [tube]"
        )
    return camera


def load_camera(name_or_path: str | Path, relative_to: str | Path | None = None) -> Camera:
    """Read a shipped camera description by name, or a TOML file: its tables say of which kind it
    is.
    """
    path = path_of_shipped("sensors", name_or_path, relative_to)
    return from_toml(path, _type_of(path))


def _type_of(path: Path) -> type[Camera]:
    """Return the type that a file describes; the serialiser refuses what is not TOML."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return Sensor
    if "tube" not in tables and not tables.keys().isdisjoint(KINDS):
        return InfraredImager
    return SolidStateCamera if "silicon" in tables and "tube" not in tables else Sensor


def save_sensor(camera: Camera, path: str | Path) -> None:
    """Write a camera description atomically."""
    write_atomically(path, to_toml(camera).encode())
