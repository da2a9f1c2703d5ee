"""One description of a camera: its sections, what it can do, and the tables of its files."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Self, TypeGuard

import numpy as np

from labdata.calibration import GainTable
from labdata.camera.chip import Ccd, Readout, Register, Silicon
from labdata.camera.maps import SpecimenMaps
from labdata.camera.optics import Band, InfraredOptics, Optics
from labdata.camera.parameters import Draws, Parameter
from labdata.camera.thermal import Bolometer, CooledArray, PixelArray, Scanner
from labdata.camera.tube import MicrochannelPlate, Phosphor, Photocathode, Taper, Tube, TubeLimits
from labdata.camera.video import InfraredVideo, Video
from labdata.errors import BadInput
from labdata.serialiser import from_mapping
from labdata.short_repr import short_repr

# ruff: noqa: RUF009 - `_section` returns a field.


def _section() -> Any:
    """Return the field of a section that not every camera has.

    Its type is that of the section: whoever reads one knows by a capability that it is there.
    """
    return field(default=None)


THERMAL = ("scanner", "bolometer", "cooled_array")  # a thermal imager has one of these sections
EFFICIENCY = "ccd.quantum_efficiency"


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera as sections of parameters, in the order of the light; those that it lacks are None.

    `float(camera.optics.f_number)` is a number; `camera.optics.f_number.source` says where it comes
    from. A photocathode is that of a tube before the chip, silicon is that of a chip without one,
    and a band is that of a thermal imager, whose optics and video are `InfraredOptics` and
    `InfraredVideo`.

    Of a camera without a tube `video.conversion_gain_dn_per_e` counts electrons at the output,
    after multiplication, and `ccd.quantum_efficiency` is the highest of the silicon's table.
    """

    name: str
    band: Band = _section()
    optics: Optics
    silicon: Silicon = _section()
    photocathode: Photocathode = _section()
    microchannel_plate: MicrochannelPlate = _section()
    tube: Tube = _section()
    phosphor: Phosphor = _section()
    taper: Taper = _section()
    ccd: Ccd = _section()
    register: Register = _section()
    video: Video
    readout: Readout = _section()
    scanner: Scanner | None = None
    bolometer: Bolometer | None = None
    cooled_array: CooledArray | None = None
    limits: TubeLimits = _section()
    gain_table: GainTable | None = None  #: calibration of this very tube, where there is one
    draws: Draws = field(default_factory=Draws)
    maps: SpecimenMaps | None = None  #: fixed patterns of this very camera, next to its file
    notes: tuple[str, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.is_thermal:
            _require_thermal_imager(self)
        elif self.silicon is not None:
            _require_solid_state(self)

    @property
    def has_tube(self) -> bool:
        """Whether an image intensifier stands before the chip."""
        return self.photocathode is not None

    @property
    def is_thermal(self) -> bool:
        """Whether it sees the thermal infrared, in kelvin."""
        return self.band is not None

    @property
    def multiplies(self) -> bool:
        """Whether a register multiplies the charge."""
        return self.register is not None and self.register.multiplies

    @property
    def interlaced(self) -> bool:
        """Whether a frame is two fields exposed one after the other."""
        return self.video.interlaced

    @property
    def fields(self) -> int:
        """Exposures in a frame."""
        return 2 if self.interlaced else 1

    @property
    def array(self) -> PixelArray | None:
        """The array of pixels of a thermal imager; None of a scanner and in visible light."""
        return self.bolometer or self.cooled_array

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        if self.scanner is not None:
            return 2 * self.scanner.lines_per_field, self.scanner.samples
        pixels = self.array or self.ccd
        return pixels.rows, pixels.columns

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second, of averaged ones where the imager averages."""
        averaged = 1 if self.scanner is None else self.scanner.averaged_frames
        return float(self.video.field_rate_hz) / (self.fields * averaged)

    @property
    def pitch_ratio(self) -> float:
        """Row pitch over column pitch."""
        if self.is_thermal:
            row, col = self.pitch_mrad
            return row / col
        return float(self.ccd.pitch_y_um) / float(self.ccd.pitch_x_um)

    @property
    def pitch_mrad(self) -> tuple[float, float]:
        """Angle between rows and between columns of a thermal imager, mrad."""
        if self.scanner is not None:
            (rows, columns), scanner = self.shape, self.scanner
            down, along = (
                float(np.radians(float(angle))) * 1e3
                for angle in (scanner.vertical_field_deg, scanner.horizontal_field_deg)
            )
            return down / rows, along / columns
        assert self.array is not None
        pitch = float(self.array.pitch_um) / float(self.optics.focal_length_mm)
        return pitch, pitch

    @property
    def span_k(self) -> float | None:
        """Temperatures from black to full scale, K; None of an imager without, and in visible
        light.
        """
        span_k: Parameter | None = getattr(self.video, "span_k", None)
        return None if span_k is None else float(span_k)

    @property
    def footprint_mrad(self) -> float:
        """Side of the footprint of a thermal imager's detector in the scene (IFOV), mrad."""
        return self.pitch_mrad[0] if self.scanner is None else float(self.scanner.ifov_mrad)

    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its path, such as "optics.f_number"."""
        return {
            f"{section.name}.{item.name}": value
            for section in fields(self)
            if is_dataclass(part := getattr(self, section.name))
            for item in fields(part)
            if isinstance(value := getattr(part, item.name), Parameter)
        }

    def with_parameters(self, changes: dict[str, Parameter]) -> Self:
        """Return a copy with parameters replaced by path; the silicon's table is scaled to a new
        highest efficiency.
        """
        self._require_known(changes)
        sections: dict[str, dict[str, Any]] = {}
        if self.silicon is not None and EFFICIENCY in changes:
            table, highest = self.silicon.quantum_efficiency, float(changes[EFFICIENCY])
            scaled = tuple(min(value * highest / max(table), highest) for value in table)
            sections["silicon"] = {"quantum_efficiency": scaled}
        for path, parameter in changes.items():
            section, name = path.split(".")
            sections.setdefault(section, {})[name] = parameter
        return replace(
            self,
            **{name: replace(getattr(self, name), **values) for name, values in sections.items()},
        )

    def with_values(self, values: dict[str, float]) -> Self:
        """Return a copy in which parameters have other values, exact, by path."""
        self._require_known(values)
        known = self.parameters()
        return self.with_parameters(
            {
                path: replace(known[path], value=float(value), low=None, high=None)
                for path, value in values.items()
            }
        )

    def _require_known(self, changes: dict[str, Any]) -> None:
        if unknown := changes.keys() - self.parameters().keys():
            raise BadInput(
                f"a sensor parameter must be one of its stages' own, got {sorted(unknown)}"
            )

    def draw(self, rng: np.random.Generator) -> Self:
        """Return the camera of one joint posterior draw; a description without draws is a
        BadInput.
        """
        if not self.draws.values:
            raise BadInput(
                "a camera to draw must be a fitted one with posterior draws, got a description "
                "without"
            )
        row = self.draws.values[int(rng.integers(len(self.draws.values)))]
        return self.with_values(dict(zip(self.draws.names, row, strict=True)))

    def with_phosphor(self, phosphor: Phosphor) -> Self:
        """Return the same tube with another screen, see `labdata.phosphors.load_phosphor`.

        Notes
        -----
        A luminous gain holds for the tube's own screen. What stays is the number of screen photons
        per photoelectron, G/(K_lm E_ph) / (S/e), so that G goes as K_lm E_ph of the screen: the
        plate makes up for a dimmer phosphor, its electron gain goes as one over the photons per
        electron, and its strip current limits it sooner. Only where the new screen's photons per
        electron were measured ("sheet" or "fitted") does the plate keep its electron gain and G
        goes with them too. Blur and the CCD's efficiency stay; a calibration of the old screen's
        gain is left out.
        """
        lumens = _lumens_per_photon(phosphor) / _lumens_per_photon(self.phosphor)
        brighter = float(phosphor.photons_per_electron) / float(self.phosphor.photons_per_electron)
        measured = phosphor.photons_per_electron.standing in ("sheet", "fitted")
        factors = {
            "tube.luminous_gain": lumens * (brighter if measured else 1.0),
            "microchannel_plate.electron_gain": 1.0 if measured else 1.0 / brighter,
        }
        known, words = self.parameters(), f"; scaled from {self.phosphor.name} to {phosphor.name}"
        changed = self.with_parameters(
            {path: known[path].times(factor, words) for path, factor in factors.items()}
        )
        constant = "electron gain of the plate" if measured else "photons per photoelectron"
        note = (
            f"Screen changed from {self.phosphor.name} to {phosphor.name}; the {constant} stayed."
        )
        draws, notes = self.draws.without_phosphor(factors), (*self.notes, note)
        return replace(changed, phosphor=phosphor, gain_table=None, draws=draws, notes=notes)


def has_tube(camera: Camera | None) -> TypeGuard[Camera]:
    """Whether a camera is known and has an image intensifier."""
    return camera is not None and camera.has_tube


def is_thermal(camera: Camera | None) -> TypeGuard[Camera]:
    """Whether a camera is known and sees the thermal infrared."""
    return camera is not None and camera.is_thermal


def _lumens_per_photon(phosphor: Phosphor) -> float:
    """Luminous efficacy times photon energy, lm s per photon up to the elementary charge."""
    return float(phosphor.luminous_efficacy_lm_per_w) * float(phosphor.photon_energy_ev)


def _require_solid_state(camera: Camera) -> None:
    """Require the rules of a camera without a tube."""
    highest = max(camera.silicon.quantum_efficiency)
    if abs(float(camera.ccd.quantum_efficiency) - highest) > 0.01 * highest:
        raise BadInput(
            f"quantum_efficiency of the ccd must be the silicon's highest, {highest:g}, "
            f"got {float(camera.ccd.quantum_efficiency):g}"
        )
    if camera.interlaced or not camera.video.digital:
        raise BadInput(
            "a camera without a tube must be progressive and digital, got video or interlace"
        )


def _require_thermal_imager(camera: Camera) -> None:
    """Require the rules of a thermal imager."""
    sections = [name for name in THERMAL if getattr(camera, name) is not None]
    if len(sections) != 1:
        raise BadInput(
            f"a thermal imager must have one of {', '.join(THERMAL)}, got "
            f"{', '.join(sections) or 'none'}"
        )
    scanner, video = camera.scanner, camera.video
    if video.interlaced != (scanner is not None):
        raise BadInput("a scanner must be interlaced and an array progressive, got the reverse")
    if scanner is not None:
        lines = 2.0 * float(scanner.mirror_hz) / float(video.field_rate_hz)
        if not scanner.lines_per_field <= lines:
            raise BadInput(
                "a mirror must scan all lines_per_field within a field, got "
                f"{scanner.lines_per_field} of {lines:.4g} lines"
            )
    if (camera.span_k is None) != (camera.cooled_array is not None):
        raise BadInput(
            "a cooled array must have no level_c and span_k, and other imagers must have both"
        )
    if (camera.optics.focal_length_mm is None) != (scanner is not None):
        raise BadInput("an array must have a focal_length_mm, and a scanner none")


@dataclass(frozen=True, kw_only=True)
class _CameraFile:
    """Tables of a camera's file; which of them a file has says its kind."""

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
