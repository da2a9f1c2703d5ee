"""Phosphor screens: the shipped ones by name, others by path."""

import os
from importlib import resources
from pathlib import Path

from labdata.errors import BadInput
from labdata.sensor import Phosphor
from labdata.serialiser import from_toml


def phosphor_names() -> tuple[str, ...]:
    """Names of the phosphors that come with the package."""
    files = resources.files("labdata.phosphors").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def load_phosphor(name_or_path: str | Path) -> Phosphor:
    """Read a shipped phosphor by name, "p20", "P43", or the TOML file of another with the keys of `Phosphor`."""
    name = str(name_or_path).lower()
    if name in phosphor_names():
        with resources.as_file(resources.files("labdata.phosphors") / f"{name}.toml") as path:
            return from_toml(path, Phosphor)
    if not os.path.isfile(name_or_path):
        raise BadInput(
            f"a phosphor must be one of {', '.join(phosphor_names())} or the path of a TOML file, "
            f"got {str(name_or_path)!r}"
        )
    return from_toml(Path(name_or_path), Phosphor)
