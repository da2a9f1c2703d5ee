"""Scenes from TOML files, with the materials that mesh files bring along, and the description of
the lab bench: sphere, target plate, holder and room light.
"""

import re
from dataclasses import dataclass, replace
from datetime import datetime
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labdata.errors import BadInput
from simulate.radiance.materials import Material, material, material_names

if TYPE_CHECKING:
    from simulate.radiance.outdoor.scene import OutdoorScene

# Wavelengths at which blue, green and red of a colour are taken, nm: the primaries of sRGB,
# rounded.
BLUE_GREEN_RED_NM = (450.0, 550.0, 610.0)
# Slab of a coloured material that the library does not know: paint, as most of what is coloured.
PAINTED = "steel-sheet-painted"
# Least roughness of a metal, and metallic factor from which a material is one.
LEAST_ROUGHNESS, METALLIC = 0.05, 0.5


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
    from simulate.radiance.outdoor.scene import OutdoorScene

    mapping = _with_materials_of_files(mapping, path.parent)
    place_table = mapping.get("place")
    if isinstance(place_table, dict) and isinstance(place_table.get("time"), datetime):
        place_table["time"] = place_table["time"].isoformat()
    return replace(from_mapping(mapping, OutdoorScene, where=path.name), folder=str(path.parent))


def _with_materials_of_files(mapping: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the tables of a scene with the materials of its .glb files, for objects that name no
    material.

    Parameters
    ----------
    mapping
        Tables of the scene's file.
    folder
        Folder of its files.

    Raises
    ------
    BadInput
        If a file cannot be read, or a material has neither a name of the library nor a colour.

    Notes
    -----
    A name of the library, in capitals, with blanks or underscores and with a number behind a dot
    too, gives reflectance and slab. Else `baseColorFactor` times the mean of `baseColorTexture` is
    the reflectance at 450, 550 and 610 nm, constant beyond; the slab is that of painted steel,
    stated in a note, and metals have none.
    """
    from simulate.radiance.outdoor.build import _load, _material_of

    objects, tables = [], list(mapping.get("material", ()))
    for scene_object in mapping.get("object", ()):
        file = scene_object.get("file") if isinstance(scene_object, dict) else None
        if (
            not isinstance(file, str)
            or not file.lower().endswith(".glb")
            or any(scene_object.get(key) for key in ("material", "file_materials", "map"))
        ):
            objects.append(scene_object)
            continue
        label, label_of_material = str(scene_object.get("label", file)), {}
        for part in _load(folder / file):
            name = _material_of(part)
            if not name:
                raise BadInput(
                    f"each part of {file} must have a material, or {label!r} one of the scene, "
                    f"got neither"
                )
            if name not in label_of_material:
                label_of_material[name] = f"{label}: {name}"
                tables.append(
                    {"label": label_of_material[name], **_table(part.visual.material, name, file)}
                )
        objects.append(scene_object | {"file_materials": label_of_material})
    return (
        mapping
        if tables == list(mapping.get("material", ()))
        else mapping | {"object": objects, "material": tables}
    )


def _table(visual: Any, name: str, file: str) -> dict[str, Any]:
    """Return the table of a material of a file."""
    library_name = re.sub(r"[\s_]+", "-", re.sub(r"\.\d+$", "", name.strip().lower()))
    if library_name in material_names() and not any(material(library_name).transmittance):
        return {"library": library_name}
    colour = _linear_colour(visual)
    if colour is None:
        raise BadInput(
            f"a material of {file} must have a name of the library "
            f"({', '.join(material_names())}) or a colour, got {name!r} without one; name a "
            "material of the scene in file_materials"
        )
    table = {
        "wavelength_nm": list(BLUE_GREEN_RED_NM),
        "reflectance": [round(float(reflectance), 4) for reflectance in colour[::-1]],
    }
    source = (
        f"{name!r} of {file} has the reflectance of its colour at 450, 550 and 610 nm, "
        f"constant beyond"
    )
    if float(getattr(visual, "metallicFactor", None) or 0.0) >= METALLIC:
        # The roughness of glTF is the root of that of the microfacets.
        rough = max(
            float(1.0 if visual.roughnessFactor is None else visual.roughnessFactor) ** 2,
            LEAST_ROUGHNESS,
        )
        return table | {"finish": "metal", "roughness": rough, "note": source}
    return table | {
        "slab": PAINTED,
        "note": f"{source}, and the slab and infrared emissivity of painted steel",
    }


def _linear_colour(visual: Any) -> np.ndarray | None:
    """Return red, green and blue of a material, linear, 0 to 1; None without a colour."""
    factor, texture = (
        getattr(visual, "baseColorFactor", None),
        getattr(visual, "baseColorTexture", None),
    )
    if factor is None and texture is None:
        return None
    colour = np.ones(3) if factor is None else np.asarray(factor, float)[:3] / 255.0
    if texture is not None:
        code = np.asarray(texture.convert("RGB"), float) / 255.0
        linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
        colour = colour * linear.mean(axis=(0, 1))
    return np.clip(colour, 0.0, 1.0)
