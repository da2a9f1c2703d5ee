"""Phosphor screens: the shipped ones by name, others by path."""

from pathlib import Path

from labdata.camera.tube import Phosphor
from labdata.file_io import names_of_shipped, path_of_shipped
from labdata.serialiser import from_toml


def phosphor_names() -> tuple[str, ...]:
    """Names of the phosphors that come with the package."""
    return names_of_shipped("phosphors")


def load_phosphor(name_or_path: str | Path) -> Phosphor:
    """Read a shipped phosphor by name, "p20", "P43", or the TOML file of another with the keys of
    `Phosphor`.
    """
    name = str(name_or_path).lower()
    return from_toml(
        path_of_shipped("phosphors", name if name in phosphor_names() else name_or_path), Phosphor
    )
