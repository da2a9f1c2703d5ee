"""The lab bench as a scene: lamp, target plate and its holder, room light; read from TOML."""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from labdata.errors import BadInput
from simulate.radiance.materials.material import Material


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """Integrating sphere whose port lights the target from behind; its radiance is set by the illuminance asked for.

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
        Illuminance it would give at the target's centre, over the exitance of the sphere's port, dimensionless.
    position_m
        Place (x, y, z) relative to the target's centre, m: x right and y down in the picture, z away from the camera.
    """

    temperature_k: float
    relative_illuminance: float
    position_m: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Holder:
    """Ring that holds a pinhole.

    Parameters
    ----------
    inner_radius_px, outer_radius_px
        Radii in the picture, column pitches.
    height_m
        How far it stands out towards the camera, m.
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
        Materials of the target's clear parts, of its plate and of the holder's ring.
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
            if getattr(self, name).finish != "matt":
                raise BadInput(
                    f"materials of the bench must be matt, got a {getattr(self, name).finish} one for {name}"
                )
        if not self.holder.outer_radius_px > self.holder.inner_radius_px > 0.0:
            raise BadInput(
                f"a ring must be wider outside than inside, got {self.holder.outer_radius_px:g} "
                f"and {self.holder.inner_radius_px:g} px"
            )


def load_scene(name_or_path: str | Path = "bench") -> LabScene:
    """Return a lab scene by the name of a shipped one, or from a TOML file.

    Raises
    ------
    BadInput
        If there is no such scene, or the file breaks a rule.
    """
    from labdata.border import from_toml

    path = Path(name_or_path)
    if path.suffix != ".toml":
        with resources.as_file(resources.files("simulate") / "scenes" / f"{name_or_path}.toml") as shipped:
            return from_toml(shipped, LabScene)
    return from_toml(path, LabScene)
