"""Scenes from TOML files, and the description of the lab bench: sphere, target plate, holder and
room light.
"""

from dataclasses import dataclass, replace
from datetime import datetime
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from labdata.errors import BadInput
from simulate.radiance.materials import Material

if TYPE_CHECKING:
    from simulate.radiance.outdoor.scene import OutdoorScene


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """Integrating sphere whose port lights the target from behind; the requested illuminance sets
    its radiance.

    Parameters
    ----------
    temperature_k
        Colour temperature, K.
    distance_m
        Distance of the port behind the target, m.
    """

    temperature_k: float
    distance_m: float


@dataclass(frozen=True, kw_only=True)
class RoomLight:
    """A small dim lamp in the room that lights the target from the camera's side.

    Parameters
    ----------
    temperature_k
        Colour temperature, K.
    relative_illuminance
        Illuminance it would give at the target's centre, over the exitance of the sphere's port,
        dimensionless.
    position_m
        Position (x, y, z) relative to the target's centre, m: x right and y down in the image, z
        away from the camera.
    """

    temperature_k: float
    relative_illuminance: float
    position_m: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Holder:
    """Ring around a pinhole.

    Parameters
    ----------
    inner_radius_px, outer_radius_px
        Radii in the image, column pitches.
    height_m
        Height of the ring towards the camera, m.
    """

    inner_radius_px: float
    outer_radius_px: float
    height_m: float


@dataclass(frozen=True, kw_only=True)
class LabScene:
    """A bench with one target at a time.

    Parameters
    ----------
    name
        Its name.
    distance_m
        Distance from lens to target, m.
    sphere, room_light, holder
        Lamp, room and ring.
    open, mask, ring
        Materials of the target's clear parts, its plate and the holder's ring.
    """

    name: str
    distance_m: float
    sphere: Sphere
    room_light: RoomLight
    holder: Holder
    open: Material
    mask: Material
    ring: Material

    def __post_init__(self) -> None:
        if not self.distance_m > self.holder.height_m >= 0.0:
            raise BadInput(
                f"the target must be farther away than the ring is high, got {self.distance_m:g} m "
                f"and {self.holder.height_m:g} m"
            )
        for name in ("open", "mask", "ring"):
            if getattr(self, name).finish != "diffuse":
                raise BadInput(
                    "materials of the bench must be diffuse, got a "
                    f"{getattr(self, name).finish} one for {name}"
                )
        if not self.holder.outer_radius_px > self.holder.inner_radius_px > 0.0:
            raise BadInput(
                f"a ring must be wider outside than inside, got {self.holder.outer_radius_px:g} "
                f"and {self.holder.inner_radius_px:g} px"
            )


def load_scene(name_or_path: str | Path = "bench") -> "LabScene | OutdoorScene":
    """Return a shipped scene by name, or a scene from a TOML file: a lab bench, or an outdoor scene
    with a camera.

    Raises BadInput if there is no such scene, or the file breaks a rule.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml":
        return _read(path)
    shipped = resources.files("simulate") / "scenes"
    names = sorted(
        file.name.removesuffix(".toml") for file in shipped.iterdir() if file.name.endswith(".toml")
    )
    if str(name_or_path) not in names:
        raise BadInput(
            f"a scene must be a .toml file or one of {', '.join(names)}, got {str(name_or_path)!r}"
        )
    with resources.as_file(shipped / f"{name_or_path}.toml") as file:
        return _read(file)


def load_bench(name_or_path: str | Path = "bench") -> LabScene:
    """Return a lab bench, as `load_scene`; raise BadInput for another kind of scene."""
    scene = load_scene(name_or_path)
    if not isinstance(scene, LabScene):
        raise BadInput(f"a lab bench needs a scene with a sphere and a target, got {scene.name!r}")
    return scene


def _read(path: Path) -> "LabScene | OutdoorScene":
    from labdata.serialiser import from_mapping, read_toml

    mapping = read_toml(path)
    if "camera" not in mapping:
        return from_mapping(mapping, LabScene, where=path.name)
    from simulate.radiance.outdoor.mesh_materials import with_materials_of_files
    from simulate.radiance.outdoor.scene import OutdoorScene

    mapping = with_materials_of_files(mapping, path.parent)
    place_table = mapping.get("place")
    if isinstance(place_table, dict) and isinstance(place_table.get("time"), datetime):
        place_table["time"] = place_table["time"].isoformat()
    return replace(from_mapping(mapping, OutdoorScene, where=path.name), folder=str(path.parent))
