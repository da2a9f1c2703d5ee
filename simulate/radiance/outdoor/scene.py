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
from simulate.radiance.outdoor.objects import Object
from simulate.radiance.outdoor.poses import RigSensor, SceneCamera, pose_at
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
        for kind, rows in tables:
            labels = [scene_object.label for scene_object in rows]
            repeated = sorted({label for label in labels if labels.count(label) > 1})
            if repeated:
                raise BadInput(f"labels of {kind}s must differ, got {repeated[0]!r} twice")
        labels_known = {surface.label for surface in self.material}
        for scene_object in self.object:
            for name in scene_object.map_materials or (
                *scene_object.file_materials.values(),
                scene_object.material,
            ):
                if (name or not scene_object.file_materials) and name not in labels_known:
                    raise BadInput(
                        "the material of an object must be one of "
                        f"{', '.join(sorted(labels_known)) or 'none described'}, got {name!r} of "
                        f"{scene_object.label!r}"
                    )
        if self.place is None and self.sky != Sky():
            raise BadInput(
                f"a sky must have a place and a time, got [sky] without [place] in {self.name!r}"
            )
        numbers = [
            *self.camera.position_m,
            *(x for scene_object in self.object for x in scene_object.position_m),
        ]
        if not all(math.isfinite(number) for number in numbers):
            raise BadInput("places in a scene must be finite")

    @property
    def moves(self) -> bool:
        """Whether its camera or an object has keyframes."""
        return bool(self.camera.keyframe) or any(
            scene_object.keyframe for scene_object in self.object
        )

    def at(self, time_s: float) -> "OutdoorScene":
        """Return the scene, without motion, as it stands at a time after its own, s; light and
        weather stay.
        """
        if not self.moves:
            return self
        camera = pose_at(replace(self.camera, keyframe=()), self.camera.keyframe, time_s)
        objects = (
            pose_at(replace(scene_object, keyframe=()), scene_object.keyframe, time_s)
            for scene_object in self.object
        )
        return replace(self, camera=camera, object=tuple(objects))

    def for_sensor(self, sensor: str | None) -> "OutdoorScene":
        """Return the scene with its camera in the place of a sensor of the rig."""
        if sensor is None or sensor not in self.rig:
            return self
        return replace(self, camera=self.rig[sensor].camera(self.camera))

    def file(self, name: str) -> Path:
        """Return the path of a file that the scene names."""
        path = Path(name)
        return path if path.is_absolute() else Path(self.folder) / path
