"""The shelf of materials that ship: `library.toml`, each with the source of its numbers."""

from dataclasses import dataclass
from functools import cache
from importlib import resources

from labdata.errors import BadInput
from labdata.serialiser import from_toml
from simulate.radiance.materials.material import Material


@dataclass(frozen=True, kw_only=True)
class Shelf:
    """Materials by name.

    Parameters
    ----------
    material
        Name and description of each.
    """

    material: dict[str, Material]


@cache
def shelf() -> Shelf:
    """Return the materials that ship."""
    with resources.as_file(resources.files("simulate.radiance.materials") / "library.toml") as path:
        return from_toml(path, Shelf)


def material_names() -> tuple[str, ...]:
    """Return the names of the materials that ship."""
    return tuple(sorted(shelf().material))


def material(name: str) -> Material:
    """Return a material that ships by its name.

    Raises
    ------
    BadInput
        If there is none of that name.
    """
    if name not in shelf().material:
        raise BadInput(f"a material must be one of {', '.join(material_names())}, got {name!r}")
    return shelf().material[name]
