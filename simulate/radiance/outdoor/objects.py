"""Description of an object of an outdoor scene: its shape or mesh file, materials, copies and
temperature.
"""

from dataclasses import dataclass, field
from typing import Literal

from labdata.errors import BadInput
from simulate.radiance.outdoor.poses import ObjectKeyframe, Pose, check_keyframes

Unit = Literal["m", "cm", "mm", "km", "in", "ft"]
METRE: dict[str, float] = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "km": 1000.0,
    "in": 0.0254,
    "ft": 0.3048,
}


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
        A shape of `simulate.radiance.geometry.surfaces` and its sizes, m; or else:
    file, unit
        A mesh file (.obj, .ply, .stl, .glb), relative to the scene's file, and the unit of its
        numbers.
    file_materials
        Of a mesh file: the material of the scene for the name of each material in the file;
        `material`, if given, is that of all others.
    map, map_materials
        Of a plane, or of a mesh file with texture coordinates: an image of the material numbers,
        see `simulate.radiance.outdoor.build`; in place of `material`.
    gaps
        Fraction of its surface that is open, as between leaves, dimensionless; all copies omit the
        same triangles.
    instances
        Poses of copies; without any there is one object, in its own pose.
    keyframe
        Where it stands later; not with copies.
    temperature_c, above_air_k
        Temperature of all of its surface, in place of the slab's: constant, C, or excess over that
        of the air, K.
    heat_w_m2, heat_hours
        Heat that its surface gets from within, W m-2, and from which hour to which of the scene's
        local time, such as [22, 2.5]; without hours always.
    """

    label: str
    material: str = ""
    shape: str | None = None
    size_m: tuple[float, ...] = ()
    file: str | None = None
    unit: Unit | None = None
    file_materials: dict[str, str] = field(default_factory=dict)
    map: str | None = None
    map_materials: tuple[str, ...] = ()
    gaps: float = 0.0
    instances: tuple[Pose, ...] = ()
    keyframe: tuple[ObjectKeyframe, ...] = ()
    temperature_c: float | None = None
    above_air_k: float | None = None
    heat_w_m2: float = 0.0
    heat_hours: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_keyframes(self.keyframe, repr(self.label))
        if self.keyframe and self.instances:
            raise BadInput(
                f"an object with keyframes must have no copies, got {len(self.instances)} of "
                f"{self.label!r}"
            )
        if (self.shape is None) == (self.file is None):
            raise BadInput(f"an object must have either a shape or a file, got {self.label!r}")
        if self.file_materials and self.file is None:
            raise BadInput(
                f"file_materials must be those of a mesh file, got {self.label!r} without a file"
            )
        has_material = bool(self.material or self.file_materials)
        if (self.map is None) != (not self.map_materials) or (self.map is None) != has_material:
            raise BadInput(
                f"an object must have either a material or a map and its materials, got "
                f"{self.label!r}"
            )
        if self.map is not None and self.shape not in (None, "plane"):
            raise BadInput(
                f"a material map must lie on a plane or on a mesh file, got {self.label!r}"
            )
        if self.temperature_c is not None and (
            self.above_air_k is not None or self.temperature_c <= -273.15
        ):
            raise BadInput(
                "an object must have either a temperature_c above -273.15 or above_air_k, got "
                f"{self.temperature_c:g} and {self.above_air_k} of {self.label!r}"
            )
        if self.heat_hours is not None and not all(0.0 <= hour <= 24.0 for hour in self.heat_hours):
            raise BadInput(
                f"heat_hours must lie between 0 and 24, got {list(self.heat_hours)} of "
                f"{self.label!r}"
            )
        if not 0.0 <= self.gaps < 1.0:
            raise BadInput(f"gaps must lie in [0, 1), got {self.gaps:g} of {self.label!r}")
        if self.file is not None and self.unit is None:
            raise BadInput(
                f"a mesh file has no unit of its own: unit must be one of {', '.join(METRE)}, "
                f"got none for {self.label!r}"
            )
