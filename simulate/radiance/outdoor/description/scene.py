"""A scene out of doors: its tables together, and what one must know of the other."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from labdata.errors import BadInput
from simulate.radiance.outdoor.description.camera import SceneCamera
from simulate.radiance.outdoor.description.lamp_placement import LampPlacement
from simulate.radiance.outdoor.description.material import MaterialSpec
from simulate.radiance.outdoor.description.objects import Object
from simulate.radiance.outdoor.description.slab import Slab
from simulate.radiance.outdoor.description.surroundings import Sky, Weather, Where


@dataclass(frozen=True, kw_only=True)
class OutdoorScene:
    """A scene out of doors.

    Parameters
    ----------
    name
        Its name.
    camera
        Where one looks from.
    place
        Where and when it is; without a place there is no sky, only lamps.
    weather
        What the air is like. Without a place there is no air unless a weather is given: that takes light of lamps and
        scatters none back.
    sky
        What shines in the sky of a place.
    material, object, lamp, slab
        Tables of materials, objects, lamps and slabs.
    folder
        Where its files lie.
    """

    name: str
    camera: SceneCamera
    place: Where | None = None
    weather: Weather | None = None
    sky: Sky = field(default_factory=Sky)
    material: tuple[MaterialSpec, ...] = ()
    object: tuple[Object, ...] = ()
    lamp: tuple[LampPlacement, ...] = ()
    slab: tuple[Slab, ...] = ()
    folder: str = "."

    def __post_init__(self) -> None:
        tables = ("material", self.material), ("object", self.object), ("lamp", self.lamp), ("slab", self.slab)
        for kind, things in tables:
            labels = [thing.label for thing in things]
            twice = sorted({label for label in labels if labels.count(label) > 1})
            if twice:
                raise BadInput(f"labels of {kind}s must differ, got {twice[0]!r} twice")
        known = {surface.label for surface in self.material}
        for thing in self.object:
            for name in thing.map_materials or (thing.material,):
                if name not in known:
                    raise BadInput(
                        f"the material of an object must be one of {', '.join(sorted(known)) or 'none described'}, "
                        f"got {name!r} of {thing.label!r}"
                    )
        if self.place is None and self.sky != Sky():
            raise BadInput(f"a sky must have a place and a time, got [sky] without [place] in {self.name!r}")
        numbers = [*self.camera.position_m, *(x for thing in self.object for x in thing.position_m)]
        if not all(math.isfinite(number) for number in numbers):
            raise BadInput("places in a scene must be finite")

    def file(self, name: str) -> Path:
        """Return the path of a file that the scene names."""
        path = Path(name)
        return path if path.is_absolute() else Path(self.folder) / path
