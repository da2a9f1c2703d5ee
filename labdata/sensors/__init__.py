"""Sensor descriptions: the shipped ones by name, others by path."""

import tomllib
from pathlib import Path

from labdata.errors import BadInput
from labdata.file_io import shipped_file, shipped_names, write_atomically
from labdata.sensor import Sensor
from labdata.serialiser import from_toml, to_toml
from labdata.solid_state import SolidStateCamera


def sensor_names() -> tuple[str, ...]:
    """Names of the camera descriptions that come with the package."""
    return shipped_names("sensors")


def load_sensor(name_or_path: str | Path, relative_to: str | Path | None = None) -> Sensor:
    """Read the description of an intensified camera, as `load_camera`; one without a tube is BadInput."""
    camera = load_camera(name_or_path, relative_to)
    if isinstance(camera, SolidStateCamera):
        raise BadInput(f"a sensor must be an intensified camera, got {camera.name!r}, which has no [tube]")
    return camera


def load_camera(name_or_path: str | Path, relative_to: str | Path | None = None) -> Sensor | SolidStateCamera:
    """Read a shipped camera description by name, or a TOML file: intensified with a [tube], else [silicon]."""
    path = shipped_file("sensors", name_or_path, relative_to)
    return from_toml(path, _type_of(path))


def _type_of(path: Path) -> type[Sensor] | type[SolidStateCamera]:
    """Return the type that a file describes; the serialiser refuses what is not TOML."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return Sensor
    return SolidStateCamera if "silicon" in tables and "tube" not in tables else Sensor


def save_sensor(camera: Sensor | SolidStateCamera, path: str | Path) -> None:
    """Write a camera description atomically."""
    write_atomically(path, to_toml(camera).encode())
