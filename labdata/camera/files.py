"""Files of camera descriptions: the tables of each kind; which tables a file has says its kind."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from labdata.calibration import GainTable
from labdata.camera.chip import Ccd, Readout, Register, Silicon
from labdata.camera.description import THERMAL, Camera
from labdata.camera.optics import Band, InfraredOptics, Optics
from labdata.camera.parameters import Draws
from labdata.camera.thermal import Bolometer, CooledArray, Scanner
from labdata.camera.tube import MicrochannelPlate, Phosphor, Photocathode, Taper, Tube, TubeLimits
from labdata.camera.video import InfraredVideo, Video
from labdata.serialiser import from_mapping


@dataclass(frozen=True, kw_only=True)
class _CameraFile:
    """Tables of a camera's file."""

    def __post_init__(self) -> None:
        self.camera()  # Its rules are those of the file.

    def camera(self) -> Camera:
        """Return the camera of the file."""
        return Camera(**{item.name: getattr(self, item.name) for item in fields(self)})


@dataclass(frozen=True, kw_only=True)
class IntensifiedCameraFile(_CameraFile):
    """An image-intensified camera."""

    name: str
    optics: Optics
    photocathode: Photocathode
    microchannel_plate: MicrochannelPlate
    tube: Tube
    phosphor: Phosphor
    taper: Taper
    ccd: Ccd
    video: Video
    limits: TubeLimits = field(default_factory=TubeLimits)
    gain_table: GainTable | None = None  #: calibration of this very tube, where there is one
    draws: Draws = field(default_factory=Draws)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SolidStateCameraFile(_CameraFile):
    """A progressive, digital camera without an intensifier."""

    name: str
    optics: Optics
    silicon: Silicon
    ccd: Ccd
    register: Register
    video: Video
    readout: Readout = field(default_factory=Readout)
    draws: Draws = field(default_factory=Draws)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ThermalImagerFile(_CameraFile):
    """A thermal imager; the one of [scanner], [bolometer] and [cooled_array] that it has says of
    which kind it is.
    """

    name: str
    band: Band
    optics: InfraredOptics
    video: InfraredVideo
    scanner: Scanner | None = None
    bolometer: Bolometer | None = None
    cooled_array: CooledArray | None = None
    notes: tuple[str, ...] = ()


def camera_from_mapping(tables: Mapping[str, Any], where: str = "") -> Camera:
    """Return the camera of the tables of a file; `where` names it in messages."""
    form = IntensifiedCameraFile
    if "tube" not in tables and not tables.keys().isdisjoint(THERMAL):
        form = ThermalImagerFile
    elif "tube" not in tables and "silicon" in tables:
        form = SolidStateCameraFile
    return from_mapping(tables, form, where).camera()
