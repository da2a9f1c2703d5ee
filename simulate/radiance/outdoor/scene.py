"""Description of an outdoor scene: camera, objects, lamps, location, weather and natural light:
tables of its file.
"""

import math
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

from labdata.errors import BadInput, check
from simulate.radiance.lamps.distribution import BEAMS
from simulate.radiance.lamps.spectra import NARROW
from simulate.radiance.outdoor.materials import MaterialSpec, Slab
from simulate.radiance.outdoor.poses import (
    ObjectKeyframe,
    Pose,
    RigSensor,
    SceneCamera,
    check_keyframes,
    pose_at,
)
from simulate.radiance.sky.moon import ObserverLocation

ConvectionLaw = Literal["buoyant", "mcadams", "watmuff", "constant"]


@dataclass(frozen=True, kw_only=True)
class Where(ObserverLocation):
    """Location and time.

    Parameters
    ----------
    latitude_deg, longitude_deg
        North and east positive, deg.
    altitude_m
        Above the sea, m.
    time
        Date, time of day and offset from UTC, such as 1998-06-24T02:00:00-04:00.
    """

    time: str

    @property
    def moment(self) -> datetime:
        """The time, with its offset from UTC."""
        try:
            moment = datetime.fromisoformat(self.time)
        except ValueError:
            raise BadInput(
                f"time must be written like 1998-06-24T02:00:00-04:00, got {self.time!r}"
            ) from None
        if moment.tzinfo is None:
            raise BadInput(
                f"time must state its offset from UTC, like 02:00:00-04:00 or 06:00:00Z, got "
                f"{self.time!r}"
            )
        return moment

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.moment


@dataclass(frozen=True, kw_only=True)
class Weather:
    """The air at the ground at the scene's time, and for surface temperatures its course over the
    day before.

    Parameters
    ----------
    visibility_km
        Distance at which a black object has a contrast of 2 %, km.
    relative_humidity
        0 to 1, dimensionless.
    temperature_c
        Air temperature, C.
    dew_point_c
        Dew point, C, in place of the relative humidity.
    wind_m_s
        Wind at 10 m, m/s; surface temperatures need it, or a file.
    cloud
        Fraction of the sky that low cloud covers, dimensionless.
    day
        How air and wind change over the day: "clear" (as on a clear day) or "constant".
    daily_swing_k
        Highest minus lowest air temperature of a clear day, K.
    linke_turbidity
        Turbidity of the air for sunlight (Linke), dimensionless.
    file
        Weather of the day up to the scene's time, in place of the numbers above from the
        temperature on: a file of kind EPW (.epw), TMY3 or `docs/thermal.md` (.csv) or SURFRAD
        (.dat), relative to the scene's.
    convection, convection_w_m2_k
        Law of convection (`simulate.thermal.slab`), and the coefficient of the law "constant", W
        m-2 K-1.
    atmosphere, modtran_folder
        Transmittance of paths in infrared images: "built-in" (`simulate.thermal.air`) or
        "modtran5", by the database of pyBSM (`simulate.thermal.air.ModtranAir`), and the folder of
        its files, relative to the scene's; without one, that of the installed package.
    """

    visibility_km: float = 23.0
    relative_humidity: float = 0.5
    temperature_c: float = 15.0
    dew_point_c: float | None = None
    wind_m_s: float | None = None
    cloud: float = 0.0
    day: Literal["clear", "constant"] = "clear"
    daily_swing_k: float = 12.0
    linke_turbidity: float = 3.8
    file: str | tuple[str, ...] | None = None
    convection: ConvectionLaw = "buoyant"
    convection_w_m2_k: float | None = None
    atmosphere: Literal["built-in", "modtran5"] = "built-in"
    modtran_folder: str | None = None

    def __post_init__(self) -> None:
        if self.modtran_folder is not None and self.atmosphere != "modtran5":
            raise BadInput(
                f'modtran_folder must come with atmosphere = "modtran5", got '
                f"{self.modtran_folder!r} and "
                f"{self.atmosphere!r}"
            )
        if self.dew_point_c is not None and self.dew_point_c > self.temperature_c:
            raise BadInput(
                f"dew_point_c must not exceed temperature_c {self.temperature_c:g}, got "
                f"{self.dew_point_c:g}"
            )
        if (self.convection == "constant") != (self.convection_w_m2_k is not None):
            raise BadInput(
                'convection_w_m2_k must be given with convection = "constant" and only then, got '
                f"{self.convection!r} and {self.convection_w_m2_k}"
            )
        check(
            self,
            fraction="cloud",
            not_negative="wind_m_s daily_swing_k convection_w_m2_k",
            one_or_more="linke_turbidity",
        )


@dataclass(frozen=True, kw_only=True)
class Town:
    """The glow of a town beyond the horizon; see `simulate.radiance.sky.night_sky`."""

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
class LampPlacement:
    """Spectrum, position and beam of a lamp.

    Parameters
    ----------
    label
        Its name.
    kind
        Kind of its spectrum (`simulate.radiance.lamps.spectra.KINDS`), "narrow-band" for a laser or
        a diode of one colour, or a .csv file of two columns relative to the scene's.
    position_m
        Place (east, north, up), m.
    lumens
        Luminous flux, lm; without lumens and watts that of its photometric file.
    watts
        Radiant flux, W, in place of lumens, for infrared lamps.
    wavelength_nm, width_nm
        Of a narrow band: its centre and full width at half maximum, 0 for a line, nm.
    aim_m
        Point on its axis, m; without one it shines straight down.
    beam
        "isotropic", "cosine" (a Lambertian emitter), "spot", or a photometric .ies file relative to
        the scene's.
    heading_deg
        Azimuth of the plane C0 of a photometric file, clockwise from north, deg.
    half_angle_deg
        Of a spot: angle from the axis at half intensity, deg.
    radius_m
        Radius of the emitter, m.
    temperature_k
        Of an incandescent lamp, K.
    near_infrared_share
        Power of near-infrared lines over that of the visible, dimensionless; None: that of its
        kind.
    """

    label: str
    kind: str
    position_m: tuple[float, float, float]
    lumens: float | None = None
    watts: float | None = None
    wavelength_nm: float | None = None
    width_nm: float = 0.0
    aim_m: tuple[float, float, float] | None = None
    beam: str = "isotropic"
    heading_deg: float = 0.0
    half_angle_deg: float = 20.0
    radius_m: float = 0.05
    temperature_k: float = 2856.0
    near_infrared_share: float | None = None

    def __post_init__(self) -> None:
        if self.beam not in BEAMS and not self.has_photometric_file:
            raise BadInput(
                f"a beam must be one of {', '.join(BEAMS)} or an .ies file, got {self.beam!r}"
            )
        powers = [power for power in (self.lumens, self.watts) if power is not None]
        if len(powers) == 2 or not (powers or self.has_photometric_file):
            raise BadInput(
                "a lamp must have either lumens or watts, or neither with a photometric file, got "
                f"{'both' if powers else 'none'} of {self.label!r}"
            )
        if not all(power >= 0.0 for power in powers):
            raise BadInput(
                f"lumens and watts must not be negative, got {powers[0]:g} of {self.label!r}"
            )
        if self.kind != NARROW and (self.wavelength_nm is not None or self.width_nm):
            raise BadInput(
                f"wavelength_nm and width_nm belong to a {NARROW} lamp, got {self.kind} for "
                f"{self.label!r}"
            )
        check(self, of=f" of {self.label!r}", positive="radius_m")
        if self.aim_m == self.position_m:
            raise BadInput(f"a lamp must aim at another place than its own, got {self.label!r}")

    @property
    def has_photometric_file(self) -> bool:
        """Whether its beam is a photometric file."""
        return self.beam.lower().endswith(".ies")


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


@dataclass(frozen=True, kw_only=True)
class OutdoorScene:
    """An outdoor scene.

    Parameters
    ----------
    name
        Its name.
    camera
        Pose of the camera.
    place
        Location and time; without a place there is no sky, only lamps.
    weather
        The air. Without a place there is no air unless a weather is given, which then only
        attenuates.
    sky
        Natural light of a place.
    material, object, lamp, slab
        Tables of materials, objects, lamps and slabs.
    rig
        Places of sensors by their names; one that is not there stands in the camera's place.
    folder
        Folder of its files.
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
    rig: dict[str, RigSensor] = field(default_factory=dict)
    folder: str = "."

    def __post_init__(self) -> None:
        tables = (
            ("material", self.material),
            ("object", self.object),
            ("lamp", self.lamp),
            ("slab", self.slab),
        )
        for kind, things in tables:
            labels = [thing.label for thing in things]
            twice = sorted({label for label in labels if labels.count(label) > 1})
            if twice:
                raise BadInput(f"labels of {kind}s must differ, got {twice[0]!r} twice")
        known = {surface.label for surface in self.material}
        for thing in self.object:
            for name in thing.map_materials or (*thing.file_materials.values(), thing.material):
                if (name or not thing.file_materials) and name not in known:
                    raise BadInput(
                        "the material of an object must be one of "
                        f"{', '.join(sorted(known)) or 'none described'}, got {name!r} of "
                        f"{thing.label!r}"
                    )
        if self.place is None and self.sky != Sky():
            raise BadInput(
                f"a sky must have a place and a time, got [sky] without [place] in {self.name!r}"
            )
        numbers = [*self.camera.position_m, *(x for thing in self.object for x in thing.position_m)]
        if not all(math.isfinite(number) for number in numbers):
            raise BadInput("places in a scene must be finite")

    @property
    def moves(self) -> bool:
        """Whether its camera or an object has keyframes."""
        return bool(self.camera.keyframe) or any(thing.keyframe for thing in self.object)

    def at(self, time_s: float) -> "OutdoorScene":
        """Return the scene, without motion, as it stands at a time after its own, s; light and
        weather stay.
        """
        if not self.moves:
            return self
        camera = pose_at(replace(self.camera, keyframe=()), self.camera.keyframe, time_s)
        things = (
            pose_at(replace(thing, keyframe=()), thing.keyframe, time_s) for thing in self.object
        )
        return replace(self, camera=camera, object=tuple(things))

    def for_sensor(self, sensor: str | None) -> "OutdoorScene":
        """Return the scene with its camera in the place of a sensor of the rig."""
        if sensor is None or sensor not in self.rig:
            return self
        return replace(self, camera=self.rig[sensor].camera(self.camera))

    def file(self, name: str) -> Path:
        """Return the path of a file that the scene names."""
        path = Path(name)
        return path if path.is_absolute() else Path(self.folder) / path
