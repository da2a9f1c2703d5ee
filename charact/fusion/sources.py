"""Sources of a fusion: a picture or stack with what a session and descriptions say of its camera,
as bands.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.bloom_map import BloomMap, bloom_map, spread_from
from charact.estimators.bloom.posterior_psf import PosteriorPsf
from charact.frames.noise_law import NoiseLaw
from charact.frames.stack import Stack
from charact.fusion.bands import Band
from charact.fusion.geometry import CameraGeometry
from charact.fusion.noise_law import measure_noise
from charact.fusion.thresholds import FUSION
from labdata import (
    MANIFEST,
    BadInput,
    FrameStack,
    Result,
    Session,
    StackEntry,
    load_camera,
    open_session,
    read_frames,
    result_io,
)
from labdata.camera.description import Camera, has_tube, is_thermal

Described = tuple[NoiseLaw, PosteriorPsf]
Describe = Callable[[Camera, float], Described]


@dataclass(frozen=True, kw_only=True)
class Source:
    """Frames of a band, and what is known of their camera.

    `sensor`, `imager`: description of an intensified or of a thermal camera; `described`: noise law
    and point spread function by it; `session`, `entry`, `result`: where the frames are from, and
    the session's measurements; `black_dn`: stated black level; `geometry`: pose, lens and range;
    `notes`: what was left out, and why.
    """

    name: str
    stack: FrameStack
    camera: Camera | None = None
    described: Described | None = None
    session: Session | None = None
    entry: StackEntry | None = None
    result: Result | None = None
    black_dn: float | None = None
    geometry: CameraGeometry | None = None
    notes: tuple[str, ...] = field(default=())

    @cached_property
    def black(self) -> tuple[float, tuple[str, ...]]:
        """Black level of an intensified camera, DN, and a flag where it was assumed."""
        for known in (self.black_dn, self.stack.black_level_dn):
            if known is not None:
                return float(known), ()
        if self.session is not None and self.entry is not None:
            dark = self.session.dark_like(self.entry.conditions)
            if dark is not None:
                return float(dark.read().mean_dn), ()
        if has_tube(self.camera):
            return float(self.camera.video.black_level_dn), ()
        return float(np.percentile(self.stack.data[0], 0.1)), ("no-darks",)

    @cached_property
    def noise(self) -> NoiseLaw | None:
        """Noise law of a frame, DN, measured from the differences of the frames; None of too
        few.
        """
        of_light = not is_thermal(self.camera)
        return measure_noise(self.stack, self.black[0] if of_light else 0.0, of_light=of_light)

    @cached_property
    def truth_files(self) -> dict[int, Path]:
        """Files of the truth of a simulated stack by the number of the first frame that they are
        of.
        """
        if self.session is None or self.entry is None:
            return {}
        stem = self.session.folder / "truth" / self.entry.label
        if len(self.session.stacks) == 1 and not stem.with_name(f"{stem.name}.npz").is_file():
            stem = self.session.folder / "truth"
        first = stem.with_name(f"{stem.name}.npz")
        numbers = {
            path: path.stem[len(stem.name) + 1 :] for path in stem.parent.glob(f"{stem.name}-*.npz")
        }
        numbered = {int(number): path for path, number in numbers.items() if number.isdigit()}
        return ({0: first} if first.is_file() else {}) | numbered

    @property
    def is_moving(self) -> bool:
        """Whether frames of a simulated stack have poses or ranges of their own."""
        return len(self.truth_files) > 1

    def at_frame(self, frame: int) -> "Source":
        """Return the source with pose and range at the time of a frame of a moving scene."""
        latest = max((number for number in self.truth_files if number <= frame), default=0)
        found = _read_geometry(self.truth_files[latest]) if latest else None
        return self if found is None else replace(self, geometry=found)

    def materials(self) -> tuple[NDArray[np.integer], tuple[str, ...]]:
        """Return the number of the material that each pixel of the frame shows, (row, col), and the
        names of the materials, from the truth of a simulated session.
        """
        truth = self.truth_files.get(0)
        if truth is None or self.geometry is None:
            raise BadInput(
                f"a colour table needs the truth of a simulated session, got none of {self.name}"
            )
        with np.load(truth) as file:
            numbers, names = self.geometry.on_frame(file["material"]), file["materials"]
            return numbers, tuple(str(name) for name in names)

    def values_of(self, quantity: str) -> list[float]:
        """Return the measured values of a quantity of the session."""
        return [
            float(one.value)
            for one in (self.result.find(quantity) if self.result else ())
            if one.value
        ]


def read_source(
    given: str | Path | FrameStack | StackEntry,
    name: str,
    *,
    camera: Camera | None = None,
    mcp_v: float | None = None,
    black_dn: float | None = None,
    describe: Describe | None = None,
) -> Source:
    """Return frames, or read a picture, or SESSION#LABEL with all that the session states of the
    camera of that stack.

    `camera`: its description, instead of the session's; `mcp_v`: MCP voltage,
    V, instead of the session's; `describe`: noise law and point spread function of a description at
    a voltage, such as `charact.fitting.described_camera.describe_camera`; None: descriptions state
    neither.
    """
    path, _, label = str(given).partition("#")
    session = entry = result = None
    if isinstance(given, FrameStack):
        stack = given
    elif isinstance(given, StackEntry):
        entry, stack = given, given.read()
    elif (Path(path) / MANIFEST).is_file():
        session = open_session(path)
        entry = session.stack(label)
        stack, result = entry.read(), result_io.load(session.folder)
        stated = session.camera
        if entry.sensor is not None:
            stated = load_camera(entry.sensor, session.folder)
        if has_tube(stated) or is_thermal(stated):
            camera = camera or stated
    else:
        _require_no_palette(Path(given))
        stack = read_frames(given)
    notes = list(stack.notes)
    described = None
    if has_tube(camera):
        volts = mcp_v or (None if entry is None else entry.conditions.mcp_v)
        if volts is None:
            volts = float(camera.microchannel_plate.reference_v)
            notes.append(f"{name}: MCP voltage unknown, {volts:g} V assumed (`mcp_v`)")
        described = None if describe is None else describe(camera, volts)
    source = Source(
        name=name,
        stack=stack,
        camera=camera,
        described=described,
        session=session,
        entry=entry,
        result=result,
        black_dn=black_dn,
    )
    geometry, left_out = _geometry(source)
    return replace(source, geometry=geometry, notes=(*notes, *left_out))


def _require_no_palette(path: Path) -> None:
    """Raise BadInput for a picture whose pixels are numbers of a palette of colours: their
    luminance is no signal.
    """
    if path.suffix.lower() not in (".png", ".bmp", ".tif", ".tiff") or not path.is_file():
        return
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            palette = picture.getpalette() if picture.mode == "P" else None
    except (UnidentifiedImageError, OSError, ValueError):
        return  # the reader of frames says what is wrong
    if palette is not None and any(
        palette[i] != palette[i + 1] or palette[i] != palette[i + 2]
        for i in range(0, len(palette) - 2, 3)
    ):
        raise BadInput(
            f"a band must hold grey values, got the palette picture {path}: export raw values of "
            "the camera"
        )


def _geometry(source: Source) -> tuple[CameraGeometry | None, tuple[str, ...]]:
    """Return pose, lens and range of a simulated session's truth, else the lens of a description,
    and notes.
    """
    name, shape, camera = source.name, source.stack.shape[1:], source.camera
    truth = source.truth_files.get(0)
    found = None if truth is None else _read_geometry(truth)
    if found is not None and found.shape == shape:
        return found, ()
    if camera is None:
        return None, (f"{name}: lens unknown without a description of the camera",)
    if camera.is_thermal:
        if camera.shape != shape or camera.array is None:
            return None, (
                f"{name}: {camera.name} describes no lens of a frame of {shape[0]} x {shape[1]} px",
            )
        down, across = camera.pitch_mrad
        return CameraGeometry(shape=shape, focal_px=(1e3 / across, 1e3 / down)), ()
    focal_um = 1e3 * float(camera.optics.focal_length_mm) / float(camera.taper.demagnification)
    return CameraGeometry(
        shape=shape,
        focal_px=(focal_um / float(camera.ccd.pitch_x_um), focal_um / float(camera.ccd.pitch_y_um)),
        frame_distortion=(
            float(camera.optics.distortion_fraction),
            float(camera.taper.distortion_fraction),
        ),
    ), ()


@lru_cache(maxsize=4)
def _read_geometry(truth: Path) -> CameraGeometry | None:
    """Return pose, lens and range of a truth file; None of one without a pose."""
    with np.load(truth) as file:
        if "focal_px" not in file.files:
            return None
        x, y = (float(one) for one in file["focal_px"])
        rows, cols = file["range_m"].shape
        return CameraGeometry(
            shape=(rows, cols),
            focal_px=(x, y),
            position_m=file["position_m"],
            rotation=file["rotation"],
            distortion_fraction=float(file["distortion_fraction"]),
            frame_distortion=tuple(float(one) for one in file["frame_distortion"]),
            range_m=file["range_m"],
        )


def band_of(source: Source, frame: int | None = None, *, bloom: bool = True, seed: int = 0) -> Band:
    """Return the mean of all frames of a source, or one frame, as a band with its noise law and
    blooming.

    `bloom`: whether the blooming of clipped lamps is estimated, with `seed` for draws of the point
    spread function.
    """
    stack, name = source.stack, source.name
    frames = len(stack) if frame is None else 1
    notes = list(source.notes)
    if frames > 1:
        moving = ", of a scene that moves: `sequence` fuses each" if source.is_moving else ""
        notes.append(f"{name} is the mean of {frames} frames{moving}")
    image = (
        stack.data.mean(axis=0, dtype=np.float64)
        if frame is None
        else np.asarray(stack.data[frame], np.float64)
    )
    if is_thermal(source.camera):
        kelvin, law = _thermal_scale(source, frames)
        return Band(name=name, image=image * kelvin, noise=law, notes=tuple(notes))
    black, flags = source.black
    signal, full = image - black, stack.full_scale_dn
    law = source.noise
    if law is not None:
        notes.append(f"the noise of {name} was measured from the differences of its frames")
    elif source.described is not None:
        law, _ = source.described
        measured = source.values_of("covariance_gain")
        law = replace(law, gain_dn=measured[0]) if len(measured) == 1 else law
    if law is not None:
        law = law.scaled(1.0 / frames)
    found = None
    if full is None or source.described is None or not bloom:
        why = (
            "no full scale"
            if full is None
            else "no description of the camera"
            if bloom
            else "`bloom`"
        )
        notes.append(f"{name}: blooming was left out: {why}")
    else:
        shown = stack.data if frame is None else stack.data[frame : frame + 1]
        clipped = Stack(frames=replace(stack, data=shown)).often_full(FUSION.clip_share)
        if np.count_nonzero(clipped) >= FUSION.lamp_px:
            found = _bloom(signal, full - black, clipped, source, seed, notes)
    return Band(
        name=name,
        image=signal,
        noise=law,
        clip=None if full is None else full - black,
        bloom=found,
        flags=flags,
        notes=tuple(notes),
    )


def _thermal_scale(source: Source, frames: int) -> tuple[float, NoiseLaw]:
    """Return kelvin per DN and the noise law of a mean of frames; in DN where the description
    states no span.

    The fixed pattern of pixels, columns and rows is the same in all frames.
    """
    imager = source.camera
    assert is_thermal(imager)
    video, array = imager.video, imager.bolometer
    full = source.stack.full_scale_dn or 2.0**video.bit_depth - 1.0
    kelvin = 1.0 if imager.span_k is None else imager.span_k / full
    measured = source.values_of("netd")
    if source.noise is not None:
        netd_k = source.noise.read_dn * kelvin
    elif measured or array is not None:
        netd_k = 1e-3 * (measured[0] if measured else float(array.netd_mk) if array else 0.0)
    else:
        return kelvin, NoiseLaw(gain_dn=0.0, read_dn=0.0, is_known=False)
    parts = (
        ()
        if array is None
        else (array.pixel_pattern_after_shutter, array.column_pattern, array.row_pattern)
    )
    pattern2 = sum(float(one) ** 2 for one in parts)
    return kelvin, NoiseLaw(gain_dn=0.0, read_dn=netd_k * (1.0 / frames + pattern2) ** 0.5)


def _bloom(
    signal: NDArray[np.float64],
    clip: float,
    clipped: NDArray[np.bool_],
    source: Source,
    seed: int,
    notes: list[str],
) -> BloomMap:
    """Return the bloom map of a frame from the measured point spread function, else from the
    described one.
    """
    sensor, rng = source.camera, np.random.default_rng(seed)
    assert sensor is not None and source.described is not None
    ratio = float(sensor.ccd.pitch_y_um) / float(sensor.ccd.pitch_x_um)
    try:
        if source.result is None:
            raise BadInput("no results")
        spread = spread_from(source.result, area_px=float(signal.size), pitch_ratio=ratio, rng=rng)
    except BadInput:
        _, spread = source.described
        notes.append(
            "blooming is that of the sensor description; a point series of this camera would "
            "measure it"
        )
    return bloom_map(
        signal, spread, clip_dn=clip, clipped=clipped, pitch_ratio=ratio, most_draws=8, rng=rng
    )
