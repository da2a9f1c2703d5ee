"""What stands in a scene: shapes and mesh files, and how their copies stand: tables of the scene's file."""

from dataclasses import dataclass
from typing import Literal

from labdata.camera_description import must_be_positive
from labdata.errors import BadInput

Unit = Literal["m", "cm", "mm", "km", "in", "ft"]
METRE: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254, "ft": 0.3048}


@dataclass(frozen=True, kw_only=True)
class Pose:
    """How a copy of an object stands.

    Parameters
    ----------
    position_m
        Where its origin is (east, north, up), m.
    heading_deg
        Where its own +y points, clockwise from north, deg.
    pitch_deg, roll_deg
        Turn about its own x (nose up) and then, before it, about its own y, deg.
    scale
        Size over that described, dimensionless.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        must_be_positive(self, "scale")


@dataclass(frozen=True, kw_only=True)
class Object(Pose):
    """Something with a surface: a shape or a mesh file, standing once or several times.

    Parameters
    ----------
    label
        Its name.
    material
        Name of its material.
    shape, size_m
        A shape of `simulate.radiance.outdoor.shapes` and its sizes, m; or else:
    file, unit
        A mesh file (.obj, .ply, .stl, .glb), relative to the scene's file, and the unit of its numbers.
    map, map_materials
        Of a plane: a picture whose numbers say which of these materials lies where, see
        `simulate.radiance.outdoor.material_map`; in place of `material`.
    gaps
        Share of its surface that is open, as between leaves, dimensionless: triangles are left out of every copy alike.
    instances
        Poses of copies; without any it stands once, as its own pose says.
    temperature_c, above_air_k
        Temperature of all of its surface, in place of what its slab gives: constant, C, or above that of the air, K.
    heat_w_m2, heat_hours
        Heat that its surface gets from within, W m-2, and from which hour to which of the scene's local time, such as
        [22, 2.5]; without hours always.
    """

    label: str
    material: str = ""
    shape: str | None = None
    size_m: tuple[float, ...] = ()
    file: str | None = None
    unit: Unit | None = None
    map: str | None = None
    map_materials: tuple[str, ...] = ()
    gaps: float = 0.0
    instances: tuple[Pose, ...] = ()
    temperature_c: float | None = None
    above_air_k: float | None = None
    heat_w_m2: float = 0.0
    heat_hours: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.shape is None) == (self.file is None):
            raise BadInput(f"an object must have either a shape or a file, got {self.label!r}")
        if (self.map is None) != (not self.map_materials) or (self.map is None) == (not self.material):
            raise BadInput(f"an object must have either a material or a map and its materials, got {self.label!r}")
        if self.map is not None and self.shape != "plane":
            raise BadInput(f"a material map must lie on a plane, got {self.label!r}")
        if self.temperature_c is not None and (self.above_air_k is not None or self.temperature_c <= -273.15):
            raise BadInput(
                "an object must have either a temperature_c above -273.15 or above_air_k, got "
                f"{self.temperature_c:g} and {self.above_air_k} of {self.label!r}"
            )
        if self.heat_hours is not None and not all(0.0 <= hour <= 24.0 for hour in self.heat_hours):
            raise BadInput(f"heat_hours must lie between 0 and 24, got {list(self.heat_hours)} of {self.label!r}")
        if not 0.0 <= self.gaps < 1.0:
            raise BadInput(f"gaps must lie in [0, 1), got {self.gaps:g} of {self.label!r}")
        if self.file is not None and self.unit is None:
            raise BadInput(f"a mesh file has no unit of its own: unit must be one of {', '.join(METRE)}, "
                           f"got none for {self.label!r}")  # fmt: skip
