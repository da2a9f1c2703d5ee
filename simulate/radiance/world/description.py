"""A scene out of doors as its TOML file says it: place, weather, sky, camera, materials, objects and lamps."""

import math
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.materials.library import material
from simulate.radiance.materials.material import Finish, Material
from simulate.radiance.materials.pane import clearest
from simulate.radiance.world.viewpoint import Scan

Triple = tuple[float, float, float]
Unit = Literal["m", "cm", "mm", "km", "in", "ft"]
BEAMS = ("isotropic", "cosine", "spot")
# Refractive index of soda-lime glass.
WINDOW_GLASS = 1.52
METRE: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254, "ft": 0.3048}


@dataclass(frozen=True, kw_only=True)
class Where:
    """Place and time.

    Parameters
    ----------
    latitude_deg, longitude_deg
        North and east positive, deg.
    altitude_m
        Above the sea, m.
    time
        Date, time of day and offset from UTC, such as 1998-06-24T02:00:00-04:00.
    """

    latitude_deg: float
    longitude_deg: float
    time: str
    altitude_m: float = 0.0

    @property
    def moment(self) -> datetime:
        """The time, which knows its offset from UTC."""
        try:
            moment = datetime.fromisoformat(self.time)
        except ValueError:
            raise BadInput(f"time must be written like 1998-06-24T02:00:00-04:00, got {self.time!r}") from None
        if moment.tzinfo is None:
            raise BadInput(f"time must state its offset from UTC, like 02:00:00-04:00 or 06:00:00Z, got {self.time!r}")
        return moment

    def __post_init__(self) -> None:
        _ = self.moment


@dataclass(frozen=True, kw_only=True)
class Weather:
    """The air at the ground.

    Parameters
    ----------
    visibility_km
        Distance at which a black thing keeps 2 % of its contrast, km.
    relative_humidity
        0 to 1, dimensionless.
    temperature_c
        Air temperature, C.
    """

    visibility_km: float = 23.0
    relative_humidity: float = 0.5
    temperature_c: float = 15.0


@dataclass(frozen=True, kw_only=True)
class Town:
    """The glow of a town beyond the horizon; see `simulate.radiance.sky.town`."""

    azimuth_deg: float
    luminance_cd_m2: float
    height_deg: float = 10.0
    half_width_deg: float = 35.0
    lamp: str = "high-pressure-sodium"


@dataclass(frozen=True, kw_only=True)
class Sky:
    """The sky's own light, each part over that of a dark site.

    Parameters
    ----------
    airglow, zodiacal, starlight
        Strengths, dimensionless.
    moon, sun
        False takes the body out of the sky.
    towns
        Glow of towns.
    """

    airglow: float = 1.0
    zodiacal: float = 1.0
    starlight: float = 1.0
    moon: bool = True
    sun: bool = True
    towns: tuple[Town, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Where the camera stands; its lens and pixels are the sensor's.

    Parameters
    ----------
    position_m
        Place of the lens (east, north, up), m.
    look_at_m
        A place on its axis, m.
    roll_deg
        Turn about the axis, clockwise as the camera sees it, deg.
    distortion_fraction
        Radial distortion of the rays at the corner; the sensor's lens has its own, so it is 0 unless a cube is made for
        something else.
    scan
        Motion of a line scanner; without it the camera frames.
    """

    position_m: Triple
    look_at_m: Triple
    roll_deg: float = 0.0
    distortion_fraction: float = 0.0
    scan: Scan | None = None

    def __post_init__(self) -> None:
        if self.position_m == self.look_at_m:
            raise BadInput(f"a camera must look at another place than it stands, got {list(self.position_m)} for both")


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

    position_m: Triple = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not self.scale > 0.0:
            raise BadInput(f"scale must be positive, got {self.scale:g}")


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A material by name: from the shelf of those that ship, or by its numbers; it may glow.

    Parameters
    ----------
    label
        Its name in the scene.
    library
        Name on the shelf (`simulate.radiance.materials.library`); or else:
    wavelength_nm, reflectance, finish, roughness, refractive_index, retroreflected_share, half_width_deg
        As of `simulate.radiance.materials.material.Material`.
    measured
        An .npz file of a measured BRDF (`simulate.radiance.world.measured_surface`), relative to the scene's, in place
        of library and numbers.
    pane_transmittance
        Transmittance at normal incidence of a thin pane of glass, for each wavelength or one for all, in place of
        library and numbers: its surfaces mirror and let through light on both sides (`materials.pane`), by the
        `refractive_index` given or that of window glass. Each triangle of its object is a whole pane.
    glow_lm_per_m2
        Luminous exitance of a surface that glows, lm/m2; its spectrum is that of `lamp`.
    lamp
        Kind of lamp whose spectrum the glow has.
    """

    label: str
    library: str | None = None
    wavelength_nm: tuple[float, ...] = (550.0,)
    reflectance: tuple[float, ...] | None = None
    finish: Finish = "matt"
    roughness: float | None = None
    refractive_index: float | None = None
    retroreflected_share: float | None = None
    half_width_deg: float | None = None
    measured: str | None = None
    pane_transmittance: tuple[float, ...] | None = None
    glow_lm_per_m2: float = 0.0
    lamp: str = "incandescent"

    def __post_init__(self) -> None:
        kinds = (self.library, self.reflectance, self.measured, self.pane_transmittance)
        if sum(given is not None for given in kinds) != 1:
            raise BadInput(
                "a material must have a library entry, a reflectance, a measured file or a pane's transmittance, "
                f"got {self.label!r}"
            )
        if not self.glow_lm_per_m2 >= 0.0:
            raise BadInput(f"glow_lm_per_m2 must not be negative, got {self.glow_lm_per_m2:g} of {self.label!r}")
        if any(self.made.transmittance):
            raise BadInput(
                f"out of doors light goes through panes alone (pane_transmittance), got {self.label!r} of another kind"
            )
        self._check_pane()

    def _check_pane(self) -> None:
        if self.pane_transmittance is None:
            return
        if self.glow_lm_per_m2 > 0.0:
            raise BadInput(f"a pane must not glow, got {self.label!r} of {self.glow_lm_per_m2:g} lm/m2")
        if not self.glass_index > 1.0:
            raise BadInput(f"refractive_index of a pane must exceed 1, got {self.glass_index:g} of {self.label!r}")
        count = len(self.pane_transmittance)
        if count not in (1, len(self.wavelength_nm)):
            raise BadInput(
                f"pane_transmittance must be one for all wavelengths or one for each, got {count} "
                f"for {len(self.wavelength_nm)} of {self.label!r}"
            )
        most = clearest(self.glass_index)
        for share in self.pane_transmittance:
            if not 0.0 <= share <= most:
                raise BadInput(
                    f"pane_transmittance must lie between 0 and what the faces leave, {most:.4f}, got {share:g} "
                    f"of {self.label!r}"
                )

    @property
    def glass_index(self) -> float:
        """Refractive index of a pane's glass."""
        return WINDOW_GLASS if self.refractive_index is None else self.refractive_index

    def let_through(self, wavelength_nm: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return a pane's transmittance at normal incidence, shape (band,)."""
        shares = self.pane_transmittance or (0.0,)
        each = shares * len(self.wavelength_nm) if len(shares) == 1 else shares
        return np.interp(wavelength_nm, self.wavelength_nm, each)

    @cached_property
    def made(self) -> Material:
        """The material; of a measured one only what glows."""
        if self.library is not None:
            return material(self.library)
        return Material(
            wavelength_nm=self.wavelength_nm,
            reflectance=self.reflectance or (0.0,),
            finish=self.finish,
            roughness=self.roughness,
            refractive_index=None if self.pane_transmittance is not None else self.refractive_index,
            retroreflected_share=self.retroreflected_share,
            half_width_deg=self.half_width_deg,
        )


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
        A shape of `simulate.radiance.world.shapes` and its sizes, m; or else:
    file, unit
        A mesh file (.obj, .ply, .stl, .glb), relative to the scene's file, and the unit of its numbers.
    map, map_materials
        Of a plane: a picture whose numbers say which of these materials lies where, see
        `simulate.radiance.world.material_map`; in place of `material`.
    gaps
        Share of its surface that is open, as between leaves, dimensionless: triangles are left out of every copy alike.
    instances
        Poses of copies; without any it stands once, as its own pose says.
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.shape is None) == (self.file is None):
            raise BadInput(f"an object must have either a shape or a file, got {self.label!r}")
        if (self.map is None) != (not self.map_materials) or (self.map is None) == (not self.material):
            raise BadInput(f"an object must have either a material or a map and its materials, got {self.label!r}")
        if self.map is not None and self.shape != "plane":
            raise BadInput(f"a material map must lie on a plane, got {self.label!r}")
        if not 0.0 <= self.gaps < 1.0:
            raise BadInput(f"gaps must lie in [0, 1), got {self.gaps:g} of {self.label!r}")
        if self.file is not None and self.unit is None:
            raise BadInput(f"a mesh file has no unit of its own: unit must be one of {', '.join(METRE)}, "
                           f"got none for {self.label!r}")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class LampPost:
    """A lamp at a place.

    Parameters
    ----------
    label
        Its name.
    kind
        Kind of its spectrum (`simulate.radiance.lamps.KINDS`), or a .csv file of two columns relative to the scene's.
    position_m
        Place (east, north, up), m.
    lumens
        Luminous flux, lm; None: that of its photometric file.
    aim_m
        Place at which its axis points, m; straight down without one.
    beam
        "isotropic", "cosine" (a matt emitter), "spot", or a photometric .ies file relative to the scene's.
    heading_deg
        Where the plane C0 of a photometric file lies, clockwise from north, deg.
    half_angle_deg
        Of a spot: where its intensity has fallen to half, deg from the axis.
    radius_m
        Radius of what shines, m.
    temperature_k
        Of an incandescent lamp, K.
    near_infrared_share
        Power of near-infrared lines over that of the visible, dimensionless; None: that of its kind.
    """

    label: str
    kind: str
    position_m: Triple
    lumens: float | None = None
    aim_m: Triple | None = None
    beam: str = "isotropic"
    heading_deg: float = 0.0
    half_angle_deg: float = 20.0
    radius_m: float = 0.05
    temperature_k: float = 2856.0
    near_infrared_share: float | None = None

    def __post_init__(self) -> None:
        if self.beam not in BEAMS and not self.measured:
            raise BadInput(f"a beam must be one of {', '.join(BEAMS)} or an .ies file, got {self.beam!r}")
        if self.lumens is None and not self.measured:
            raise BadInput(f"lumens must be given for a lamp without a photometric file, got none for {self.label!r}")
        if self.lumens is not None and not self.lumens >= 0.0:
            raise BadInput(f"lumens must not be negative, got {self.lumens:g} of {self.label!r}")
        if not self.radius_m > 0.0:
            raise BadInput(f"radius_m must be positive, got {self.radius_m:g} of {self.label!r}")
        if self.aim_m == self.position_m:
            raise BadInput(f"a lamp must aim at another place than its own, got {self.label!r}")

    @property
    def measured(self) -> bool:
        """Whether its beam is a photometric file."""
        return self.beam.lower().endswith(".ies")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene out of doors.

    Parameters
    ----------
    name
        Its name.
    camera, place, weather, sky
        Where one looks from, where and when it is, what the air is like and what shines in it; without a place there is
        no sky, only lamps.
    material, object, lamp
        Tables of materials, objects and lamps.
    folder
        Where its files lie.
    """

    name: str
    camera: Camera
    place: Where | None = None
    weather: Weather = field(default_factory=Weather)
    sky: Sky = field(default_factory=Sky)
    material: tuple[Surface, ...] = ()
    object: tuple[Object, ...] = ()
    lamp: tuple[LampPost, ...] = ()
    folder: str = "."

    def __post_init__(self) -> None:
        for kind, things in (("material", self.material), ("object", self.object), ("lamp", self.lamp)):
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
        numbers = [*self.camera.position_m, *(x for thing in self.object for x in thing.position_m)]
        if not all(math.isfinite(number) for number in numbers):
            raise BadInput("places in a scene must be finite")

    def file(self, name: str) -> Path:
        """Return the path of a file that the scene names."""
        path = Path(name)
        return path if path.is_absolute() else Path(self.folder) / path
