"""Fusion of visible and thermal frames, its scores, and colours from a simulated scene."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.api.inputs import Frames, frames_of, sensor_of
from charact.fusion import files, scores
from charact.fusion.alignment import align_bands, common_field, crop_bands
from charact.fusion.bands import Band, Span, display_planes
from charact.fusion.colour_table import ColourTable, fuse_by_table, make_colour_table
from charact.fusion.fuse import fuse_all
from charact.fusion.fused import Fused, codes_of
from charact.fusion.scores import Score
from charact.fusion.sequence import fuse_sequence, pair_frames
from charact.fusion.sources import Source, band_of, read_source
from charact.fusion.thresholds import FUSION
from charact.fusion.truth_scores import FusionTruth, truth_scores, with_restoration_errors
from charact.method.registry import Progress, ignore_progress, methods_of_kind
from labdata.camera.description import Camera, has_tube, is_thermal
from labdata.errors import BadInput
from labdata.measurement import Result
from labdata.sensors import load_camera
from labdata.session import StackEntry

Scores = Mapping[str, Sequence[Score]]
# Wavelengths whose reflectance is red, green and blue, nm, and the exponent of the display (IEC
# 61966-2-1, nearly).
COLOURS_NM, GAMMA = (610.0, 550.0, 465.0), 1.0 / 2.2
# Number of the sky in the truth, and its colour.
SKY, SKY_COLOUR = -1, (0.35, 0.45, 0.62)


@dataclass(frozen=True, kw_only=True)
class Fusion:
    """Fused pictures of one or several methods, or of a sequence."""

    pictures: Mapping[str, Fused]  #: Pictures by method; of a sequence its first one
    sources: tuple[str, ...]  #: Files or sessions that were fused
    bands: tuple[
        NDArray[np.uint8], ...
    ] = ()  #: Bands as fused, codes of 8 bits; none of a sequence
    region: files.Region | None = None  #: ROW, COL, HEIGHT, WIDTH of the visible frame; None: all
    frames: tuple[Fused, ...] = ()  #: All pictures of a sequence
    time_s: tuple[float, ...] | None = None  #: Times of these, s
    scores: Scores = field(default_factory=dict)  #: Scores by method, where there are several
    truth_scores: Scores = field(default_factory=dict)  #: Scores against a truth, likewise
    aspect: float = 1.0  #: Row pitch over column pitch of the visible camera

    @property
    def result(self) -> Result:
        """Measurements of all pictures: `fused_noise`, `fused_filled_area`, `fused_share`, and
        `fusion_error` against a truth.
        """
        return Result(
            measurements=tuple(m for fused in self.pictures.values() for m in fused.measurements)
        )

    def save(self, out: str | Path) -> None:
        """Write the pictures to a folder, those of several methods with a page of their scores, or
        one picture to a .png or .tif.
        """
        from charact.reporting.fusion_page import fusion_page
        from labdata.file_io import write_atomically

        target = Path(out)
        if self.frames:
            files.write_sequence(self.frames, target, self.sources, self.region, self.time_s)
            return
        files.write(self.pictures, self.bands, target, self.sources, self.region)
        if len(self.pictures) > 1:
            page = fusion_page(
                self.bands, self.pictures, self.scores, self.truth_scores, aspect=self.aspect
            )
            write_atomically(target / files.PAGE, page.encode())


def fuse(
    visible: Frames,
    thermal: Frames,
    *more: Frames,
    method: str | Sequence[str] = "auto",
    colour: bool = False,
    sensor: str | Path | Camera | None = None,
    imager: str | Path | Camera | None = None,
    mcp_v: float | None = None,
    black_dn: float | None = None,
    spans: Mapping[str, Span] | None = None,
    bloom: bool = True,
    registered: bool = False,
    range_m: float | None = None,
    whole: bool = False,
    sequence: bool = False,
    recursive: float | None = None,
    within_percent: float = FUSION.tolerance_percent,
    table: str | Path | ColourTable | None = None,
    truth: str | Path | FusionTruth | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    progress: Progress = ignore_progress,
) -> Fusion:
    """Fuse frames of a visible and a thermal camera into one picture with uncertainty.

    Parameters
    ----------
    visible, thermal, more
        Arrays (row, col) or (frame, row, col), DN; files; "SESSION#LABEL"; or stacks. Frames of
        several sizes need descriptions of both cameras, or a simulated session.
    method
        Name of a method, "auto" or "all"; several for one page of pictures and scores.
    colour
        Whether contrasts of opposite sign are kept, in colour.
    sensor, imager
        Description of the visible and of the thermal camera: a shipped name, a TOML file or an
        object; None: that of the session.
    mcp_v, black_dn
        MCP voltage, V, and black level, DN, of the visible frame; None: from session or file.
    spans
        Values shown as 0 and 1, DN above black or K, by band: "visible", "thermal", "band-3".
    bloom
        Whether blooming is estimated and subtracted.
    registered
        Whether the shift that geometry leaves is neither measured nor corrected.
    range_m
        Distance of the whole scene for parallax, m; None: range of each pixel.
    whole
        Whether pixels outside a field of view are kept; otherwise the field in common.
    sequence
        Whether stacks are fused frame by frame with one span, not their means.
    recursive
        Share of the newest frame in a running mean of a sequence, above 0 to 1; None: no filter.
    within_percent
        Restoration error that "auto" must meet, percent.
    table
        Colour table of `fusion_colours`, or its file: adds a picture "colour-table".
    truth
        Truth of the scene, or its file: adds restoration errors.
    seed
        Seed of every random step.
    out
        Folder, .png or .tif that the pictures are written to; None: none.
    progress
        Called with a sentence and the fraction done (0..1).

    Returns
    -------
    Fusion
        `pictures` by method, each with `picture`, `sd`, `share` and `marks`; `result`; `save`.

    Raises
    ------
    BadInput
        If frames do not fit each other, a description is of another kind of camera, or settings
        exclude each other.

    Examples
    --------
    >>> import numpy as np
    >>> visible, thermal = np.random.default_rng(1).normal(100.0, 3.0, (2, 64, 64))
    >>> fused = fuse(visible, thermal, method="weighted", registered=True).pictures["weighted"]
    >>> fused.picture.shape, fused.sd.shape, fused.share.shape
    ((64, 64), (64, 64), (2, 64, 64))
    """
    names = list(dict.fromkeys([method] if isinstance(method, str) else method))
    names = list(methods_of_kind("fusion")) if "all" in names else names
    if sequence and (len(names) > 1 or truth is not None or table is not None):
        raise BadInput("sequence needs one method and neither truth nor table")
    if recursive is not None and not sequence:
        raise BadInput("recursive filters a sequence, got it without sequence")
    if out is not None:
        files.require_place(Path(out), is_folder=len(names) > 1 or sequence or table is not None)
    inputs = (visible, thermal, *more)
    read = _read(inputs, sensor, imager, mcp_v=mcp_v, black_dn=black_dn)
    progress("bands", 0.1)
    bands = [band_of(source, bloom=bloom, seed=seed) for source in read]
    progress("registration", 0.5)
    bands, places = align_bands(bands, read, distance_m=range_m, registered=registered)
    region = None if whole else common_field(places)
    settings: dict[str, Any] = {
        "colour": colour,
        "spans": dict(spans or {}),
        "within_percent": within_percent,
    }
    given = tuple(
        str(f) if isinstance(f, str | Path) else "array" for f in (visible, thermal, *more)
    )
    if sequence:
        settings |= {"distance_m": range_m, "recursive": recursive, "bloom": bloom, "seed": seed}
        fusion = _fuse_frames(read, names[0], given, places, region, progress, **settings)
    else:
        bands = crop_bands(bands, region)
        progress("fusion", 0.8)
        pictures = fuse_all(bands, names, registered=registered, **settings)
        if table is not None:
            loaded = table if isinstance(table, ColourTable) else ColourTable.load(Path(table))
            pictures["colour-table"] = fuse_by_table(bands, loaded)
        fusion = _scored(pictures, bands, _truth(truth, region), settings["spans"], seed, progress)
        camera = read[0].camera
        aspect = camera.pitch_ratio if has_tube(camera) else 1.0
        fusion = replace(fusion, sources=given, region=region, aspect=aspect)
    if out is not None:
        fusion.save(out)
    return fusion


def _read(
    given: Sequence[Frames],
    sensor: str | Path | Camera | None,
    imager: str | Path | Camera | None,
    *,
    mcp_v: float | None,
    black_dn: float | None,
) -> list[Source]:
    """Read all sources; descriptions are of the first and of the second one, voltage and black
    level of the first.
    """
    from charact.fitting.described_camera import describe_camera

    described = sensor_of(sensor)
    thermal = load_camera(str(imager)) if isinstance(imager, str | Path) else imager
    if thermal is not None and not is_thermal(thermal):
        raise BadInput(f"imager must be a thermal camera, got {thermal.name!r}")
    names = ["visible", "thermal", *(f"band-{number}" for number in range(3, len(given) + 1))]
    cameras = [described, thermal, *(None for _ in given[2:])]
    return [
        read_source(
            frames if isinstance(frames, str | Path | StackEntry) else frames_of(frames),
            name,
            camera=camera,
            mcp_v=mcp_v,
            black_dn=black_dn if name == "visible" else None,
            describe=describe_camera,
        )
        for frames, name, camera in zip(given, names, cameras, strict=True)
    ]


def _fuse_frames(
    read: list[Source],
    method: str,
    given: tuple[str, ...],
    places: Sequence[Any],
    region: files.Region | None,
    progress: Progress,
    **settings: Any,
) -> Fusion:
    """Fuse a sequence frame by frame; its notes stand with the first picture."""
    pairs, notes = pair_frames(read)
    frames = []
    for fused in fuse_sequence(
        read, pairs, method=method, places=places, region=region, **settings
    ):
        frames.append(fused)
        progress(f"frame {len(frames)} of {len(pairs)}", 0.5 + 0.5 * len(frames) / len(pairs))
    rows = tuple(row.with_(notes=(*row.notes, *notes)) for row in frames[0].measurements)
    stamps = read[0].stack.time_s
    return Fusion(
        pictures={rows[0].method: replace(frames[0], measurements=rows)},
        sources=given,
        region=region,
        frames=tuple(frames),
        time_s=tuple(float(stamps[pair[0]]) for pair in pairs) if stamps.size else None,
    )


def _scored(
    pictures: dict[str, Fused],
    bands: Sequence[Band],
    truth: FusionTruth | None,
    spans: dict[str, Span],
    seed: int,
    progress: Progress,
) -> Fusion:
    """Return pictures with their errors against a truth, and where they are several their
    scores.
    """
    frames = None if truth is None else np.stack([band.image for band in bands])
    planes = display_planes(bands, bloom=False, spans=spans)
    shown = tuple(codes_of(plane.value) for plane in planes)
    by_method, against_truth = {}, {}
    for number, (name, fused) in enumerate(pictures.items()):
        if truth is not None and frames is not None:
            against_truth[name] = truth_scores(
                fused.picture, truth, frames, rng=np.random.default_rng(seed)
            )
            pictures[name] = with_restoration_errors(fused, against_truth[name])
        if len(pictures) > 1:
            progress(f"scores of {name}", 0.8 + 0.2 * number / len(pictures))
            rng = np.random.default_rng(seed)
            by_method[name] = scores.score(shown[0], shown[1], fused.codes, rng=rng)
    return Fusion(
        pictures=pictures, sources=(), bands=shown, scores=by_method, truth_scores=against_truth
    )


def _truth(
    truth: str | Path | FusionTruth | None, region: files.Region | None
) -> FusionTruth | None:
    """Return the truth of a scene, cut to the region of a fused picture if it is larger."""
    if isinstance(truth, str | Path):
        truth = FusionTruth.load(Path(truth))
    return None if truth is None else truth.cropped(region)


def fusion_scores(
    visible: str | Path | NDArray[np.uint8],
    thermal: str | Path | NDArray[np.uint8],
    fused: str | Path | NDArray[np.uint8],
    *,
    truth: str | Path | FusionTruth | None = None,
    seed: int = 0,
) -> tuple[Score, ...]:
    """Score a fused picture by eleven measures of the literature, with a noise and a copy control.

    Parameters
    ----------
    visible, thermal, fused
        Pictures of one size in codes of 8 bits, DN: arrays (row, col) or (row, col, 3), or files.
    truth
        Truth of the scene, or its file: adds scores against it.
    seed
        Seed of the noise control.

    Returns
    -------
    tuple of Score
        Rows of `quantity`, `unit`, `value`, `noise_control` and `copy_control`.

    Raises
    ------
    BadInput
        If a picture has other than 8 bits, or pictures differ in size.

    Examples
    --------
    >>> import numpy as np
    >>> visible, thermal = np.random.default_rng(1).integers(0, 256, (2, 32, 32), dtype=np.uint8)
    >>> rows = {row.quantity: row for row in fusion_scores(visible, thermal, visible)}
    >>> rows["entropy"].value == rows["entropy"].copy_control
    True
    """
    codes = [files.read_codes(picture) for picture in (visible, thermal, fused)]
    rows = scores.score(codes[0], codes[1], codes[2], rng=np.random.default_rng(seed))
    region = files.region_of(Path(fused)) if isinstance(fused, str | Path) else None
    known = _truth(truth, region)
    if known is None:
        return rows
    grey = np.stack([code if code.ndim == 2 else code.mean(axis=-1) for code in codes[:2]])
    return rows + truth_scores(codes[2], known, grey, rng=np.random.default_rng(seed))


def fusion_colours(
    visible: str | Path, thermal: str | Path, scene: str | Path
) -> tuple[ColourTable, tuple[str, ...]]:
    """Make a table of daylight colours for `fuse` from the truth of a simulated session.

    Parameters
    ----------
    visible, thermal
        "SESSION#LABEL" of the visible and of the thermal camera.
    scene
        The simulated scene: its TOML file, or the name of a shipped one.

    Returns
    -------
    table, materials
        The table, with `save`, and the names of the materials in the truth.

    Raises
    ------
    BadInput
        If the session has no truth, or the scene is not an outdoor one.
    """
    read = _read((visible, thermal), None, None, mcp_v=None, black_dn=None)
    bands, places = align_bands([band_of(source) for source in read], read)
    rows, cols = bands[0].image.shape
    region = row, col, height, width = common_field(places) or (0, 0, rows, cols)
    materials, names = read[0].materials()
    cut = materials[row : row + height, col : col + width]
    return make_colour_table(crop_bands(bands, region), cut, _daylight_colours(scene, names)), names


def _daylight_colours(
    scene: str | Path, names: Sequence[str]
) -> dict[int, tuple[float, float, float]]:
    """Return the daylight colour of each material of a scene, and of the sky, by the numbers of the
    truth.
    """
    from simulate.radiance.outdoor.scene import OutdoorScene
    from simulate.radiance.scene import load_scene

    loaded = load_scene(Path(scene))
    if not isinstance(loaded, OutdoorScene):
        raise BadInput(f"a colour table needs an outdoor scene, got {scene}")
    by_label = {surface.label: surface for surface in loaded.material}
    colours = {SKY: SKY_COLOUR}
    for number, name in enumerate(names):
        surface = by_label.get(name)
        # Panes show what is behind them, and measured surfaces have no one spectrum.
        if surface is not None and surface.measured is None and surface.pane_transmittance is None:
            red, green, blue = (
                np.clip(surface.material.reflectance_at(np.array(COLOURS_NM)), 0.0, 1.0) ** GAMMA
            )
            colours[number] = (float(red), float(green), float(blue))
    return colours
