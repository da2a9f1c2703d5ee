"""Sensor descriptions: the shipped ones by name, others by path."""

from dataclasses import replace
from pathlib import Path

from labdata.camera.description import Camera, camera_from_mapping
from labdata.camera.maps import load_maps, save_maps
from labdata.errors import BadInput
from labdata.file_io import names_of_shipped, path_of_shipped, write_atomically
from labdata.serialiser import read_toml, to_toml


def sensor_names() -> tuple[str, ...]:
    """Names of the camera descriptions that come with the package."""
    return names_of_shipped("sensors")


def load_sensor(name_or_path: str | Path, relative_to: str | Path | None = None) -> Camera:
    """Read the description of an intensified camera, as `load_camera`; one without a tube is
    BadInput.
    """
    camera = load_camera(name_or_path, relative_to)
    if not camera.has_tube:
        raise BadInput(
            f"a sensor must be an intensified camera, got {camera.name!r}, which has no [tube]"
        )
    return camera


def load_camera(name_or_path: str | Path, relative_to: str | Path | None = None) -> Camera:
    """Read a shipped camera description by name, or a TOML file: its tables say of which kind it
    is. A fitted one has the maps of its specimen next to it.
    """
    path = path_of_shipped("sensors", name_or_path, relative_to)
    camera = load_description(path)
    maps = load_maps(camera.draws, path)
    return camera if maps is None else replace(camera, maps=maps)


def load_description(path: Path) -> Camera:
    """Read a camera description without the maps of a specimen."""
    return camera_from_mapping(read_toml(path), path.name)


def save_sensor(camera: Camera, path: str | Path) -> None:
    """Write a camera description atomically, and next to it the maps of its specimen."""
    write_atomically(path, to_toml(replace(camera, maps=None)).encode())
    if camera.maps is not None:
        save_maps(camera.maps, camera.draws, Path(path))
