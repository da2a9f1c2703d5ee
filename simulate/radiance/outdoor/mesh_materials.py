"""Materials that a .glb mesh file brings along, as tables of a scene: by name from the library, or
by colour.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from labdata.errors import BadInput
from simulate.radiance.materials import material, material_names
from simulate.radiance.outdoor.build import _load, _material_of

# Wavelengths at which blue, green and red of a colour are taken, nm: the primaries of sRGB,
# rounded.
BLUE_GREEN_RED_NM = (450.0, 550.0, 610.0)
# Slab of a coloured material that the library does not know: paint, as most of what is coloured.
PAINTED = "steel-sheet-painted"
# Least roughness of a metal, and metallic factor from which a material is one.
LEAST_ROUGHNESS, METALLIC = 0.05, 0.5


def with_materials_of_files(mapping: dict[str, Any], folder: Path) -> dict[str, Any]:
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
    things, tables = [], list(mapping.get("material", ()))
    for thing in mapping.get("object", ()):
        file = thing.get("file") if isinstance(thing, dict) else None
        if (
            not isinstance(file, str)
            or not file.lower().endswith(".glb")
            or any(thing.get(key) for key in ("material", "file_materials", "map"))
        ):
            things.append(thing)
            continue
        label, label_of_material = str(thing.get("label", file)), {}
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
        things.append(thing | {"file_materials": label_of_material})
    return (
        mapping
        if tables == list(mapping.get("material", ()))
        else mapping | {"object": things, "material": tables}
    )


def _table(visual: Any, name: str, file: str) -> dict[str, Any]:
    """Return the table of a material of a file."""
    known = re.sub(r"[\s_]+", "-", re.sub(r"\.\d+$", "", name.strip().lower()))
    if known in material_names() and not any(material(known).transmittance):
        return {"library": known}
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
