"""Fusion of visible and thermal frames, its scores, and colours from a simulated scene."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from charact.api.inputs import camera_of, frames_of, sensor_of
from charact.api.settings import Frames, Span, WithinPercent, spans_of
from charact.fusion.thresholds import FUSION
from labdata.errors import BadInput
from labdata.settings import (
    Argument,
    CameraDescription,
    Progress,
    ProgressSink,
    Region,
    Seed,
    Setting,
    documented,
    ignore_progress,
)
from labdata.short_repr import short_repr

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from charact.fusion import Band, ColourTable, Fused, FusionTruth, Score, Source
    from labdata import Camera, Result

Scores = Mapping[str, "Sequence[Score]"]
Truth = Annotated[
    "str | Path | FusionTruth | None",
    Setting(
        "Truth of the scene (.npz with bands, objects, halos, zones): adds restoration errors."
    ),
]
# Wavelengths whose reflectance is red, green and blue, nm, and the exponent of the display (IEC
# 61966-2-1, nearly).
COLOURS_NM, GAMMA = (610.0, 550.0, 465.0), 1.0 / 2.2
# Number of the sky in the truth, and its colour.
SKY, SKY_COLOUR = -1, (0.35, 0.45, 0.62)


@dataclass(frozen=True, kw_only=True)
class Fusion:
    """Fused pictures of one or several methods, or of a sequence."""

    pictures: Mapping[str, "Fused"]  #: Pictures by method; of a sequence its first one
    sources: tuple[str, ...]  #: Files or sessions that were fused
    bands: "tuple[NDArray[np.uint8], ...]" = ()  #: Bands as fused, 8-bit codes; none of a sequence
    region: Region | None = None  #: ROW, COL, HEIGHT, WIDTH of the visible frame; None: all
    frames: "tuple[Fused, ...]" = ()  #: All pictures of a sequence
    time_s: tuple[float, ...] | None = None  #: Times of these, s
    scores: Scores = field(default_factory=dict)  #: Scores by method, where there are several
    truth_scores: Scores = field(default_factory=dict)  #: Scores against a truth, likewise
    aspect: float = 1.0  #: Row pitch over column pitch of the visible camera

    __repr__ = short_repr

    @property
    def result(self) -> "Result":
        """Measurements of all pictures: `fused_noise`, `fused_filled_area`, `fused_share`, and
        `fusion_error` against a truth.
        """
        from labdata import Result

        return Result(
            measurements=tuple(m for fused in self.pictures.values() for m in fused.measurements)
        )

    def save(self, out: str | Path) -> None:
        """Write the pictures to a folder, those of several methods with a page of their scores, or
        one picture to a .png or .tif.
        """
        from charact.fusion.files import PAGE, write, write_sequence
        from charact.reporting.fusion_page import fusion_page
        from labdata.file_io import write_atomically

        target = Path(out)
        if self.frames:
            write_sequence(self.frames, target, self.sources, self.region, self.time_s)
            return
        write(self.pictures, self.bands, target, self.sources, self.region)
        if len(self.pictures) > 1:
            page = fusion_page(
                self.bands, self.pictures, self.scores, self.truth_scores, aspect=self.aspect
            )
            write_atomically(target / PAGE, page.encode())


@documented
def fuse(
    visible: Annotated[
        Frames,
        Argument(
            'Array (row, col) or (frame, row, col), DN; a file; "SESSION#LABEL"; or a stack. '
            "Frames of several sizes need descriptions of both cameras, or a simulated session."
        ),
    ],
    thermal: Annotated[Frames, Argument("Frames of the thermal camera, likewise.")],
    *more: Annotated[Frames, Argument("Frames of further bands, likewise.")],
    method: Annotated[
        "str | Sequence[str]",
        Setting(
            "Method name, auto, or all; several for one page of pictures and scores.", repeated=True
        ),
    ] = "auto",
    colour: Annotated[bool, Setting("Colour: keeps contrasts of opposite sign.")] = False,
    sensor: CameraDescription = None,
    imager: Annotated[
        "str | Path | Camera | None",
        Setting(
            "Description of the thermal camera: shipped name or TOML file (default: that of the "
            "session)."
        ),
    ] = None,
    mcp_v: Annotated[
        float | None, Setting("MCP voltage of the visible frame, V (default: from the session).")
    ] = None,
    black_dn: Annotated[
        float | None, Setting("Black level of the visible frame, DN (default: from the file).")
    ] = None,
    spans: Annotated[
        Mapping[str, Span] | Sequence[str] | None,
        Setting(
            "Fixed display span by band (visible, thermal, band-3), DN above black or K, such as "
            "visible=12,38.",
            option="--span",
            metavar="BAND=LOW,HIGH",
            repeated=True,
        ),
    ] = None,
    bloom: Annotated[
        bool, Setting("Estimate and subtract blooming, if not switched off.", option="--no-bloom")
    ] = True,
    registered: Annotated[
        bool, Setting("Do not measure and correct the shift that geometry leaves.")
    ] = False,
    range_m: Annotated[
        float | None,
        Setting("Distance of the whole scene for parallax, m (default: range of each pixel)."),
    ] = None,
    whole: Annotated[
        bool, Setting("Keep pixels outside a field of view (default: the field in common).")
    ] = False,
    sequence: Annotated[
        bool, Setting("Fuse stacks frame by frame with one span, not their means.")
    ] = False,
    recursive: Annotated[
        float | None,
        Setting(
            "Filter a sequence in time: share of the newest frame in the running mean, above 0 to "
            "1."
        ),
    ] = None,
    within_percent: WithinPercent = FUSION.tolerance_percent,
    table: Annotated[
        "str | Path | ColourTable | None",
        Setting("Add a picture in the colours of a table: `fusion_colours`, charact fuse table."),
    ] = None,
    truth: Truth = None,
    seed: Seed = 0,
    out: Annotated[
        "str | Path | None",
        Argument("Folder, .png or .tif that the pictures are written to (default: none)."),
    ] = None,
    progress: ProgressSink = ignore_progress,
) -> Fusion:
    """Fuse frames of a visible and a thermal camera into one picture with uncertainty.

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
    from charact.fusion.alignment import align_bands, common_field, crop_bands
    from charact.fusion.files import require_place
    from charact.fusion.noise_aware import ColourTable, fuse_by_table
    from charact.fusion.pictures import fuse_all
    from charact.fusion.sources import band_of
    from charact.method.registry import methods_of_kind

    names = list(dict.fromkeys([method] if isinstance(method, str) else method))
    names = list(methods_of_kind("fusion")) if "all" in names else names
    if sequence and (len(names) > 1 or truth is not None or table is not None):
        raise BadInput("sequence needs one method and neither truth nor table")
    if recursive is not None and not sequence:
        raise BadInput("recursive filters a sequence, got it without sequence")
    if out is not None:
        require_place(Path(out), is_folder=len(names) > 1 or sequence or table is not None)
    inputs = (visible, thermal, *more)
    read = _read(inputs, sensor, imager, mcp_v=mcp_v, black_dn=black_dn)
    progress("bands", 0.1)
    bands = [band_of(source, bloom=bloom, seed=seed) for source in read]
    progress("registration", 0.5)
    bands, places = align_bands(bands, read, distance_m=range_m, registered=registered)
    region = None if whole else common_field(places)
    settings: dict[str, Any] = {
        "colour": colour,
        "spans": spans_of(spans or {}),
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
        aspect = camera.pitch_ratio if camera is not None and camera.has_tube else 1.0
        fusion = replace(fusion, sources=given, region=region, aspect=aspect)
    if out is not None:
        fusion.save(out)
    return fusion


def _read(
    given: Sequence[Frames],
    sensor: CameraDescription = None,
    imager: CameraDescription = None,
    *,
    mcp_v: float | None = None,
    black_dn: float | None = None,
) -> "list[Source]":
    """Read all sources; descriptions are of the first and of the second one, voltage and black
    level of the first.
    """
    from charact.fitting.described_camera import describe_camera
    from charact.fusion.sources import read_source
    from labdata import StackEntry

    described, thermal = sensor_of(sensor), camera_of(imager)
    if thermal is not None and not thermal.is_thermal:
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
    read: "list[Source]",
    method: str,
    given: tuple[str, ...],
    places: Sequence[Any],
    region: Region | None,
    progress: Progress,
    **settings: Any,
) -> Fusion:
    """Fuse a sequence frame by frame; its notes stand with the first picture."""
    from charact.fusion.pictures import fuse_sequence, pair_frames

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
    pictures: "dict[str, Fused]",
    bands: "Sequence[Band]",
    truth: "FusionTruth | None",
    spans: dict[str, Span],
    seed: int,
    progress: Progress,
) -> Fusion:
    """Return pictures with their errors against a truth, and where they are several their
    scores.
    """
    import numpy as np

    from charact.fusion.bands import display_planes
    from charact.fusion.fused import codes_of
    from charact.fusion.scores import score
    from charact.fusion.truth import truth_scores, with_restoration_errors

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
            by_method[name] = score(shown[0], shown[1], fused.codes, rng=rng)
    return Fusion(
        pictures=pictures, sources=(), bands=shown, scores=by_method, truth_scores=against_truth
    )


def _truth(truth: Truth, region: Region | None) -> "FusionTruth | None":
    """Return the truth of a scene, cut to the region of a fused picture if it is larger."""
    from charact.fusion.truth import FusionTruth

    if isinstance(truth, str | Path):
        truth = FusionTruth.load(Path(truth))
    return None if truth is None else truth.cropped(region)


Picture = Annotated[
    "str | Path | NDArray[np.uint8]",
    Argument("Picture of 8 bits, DN: an array (row, col) or (row, col, 3), or a file."),
]


@documented
def fusion_scores(
    visible: Picture,
    thermal: Picture,
    fused: Picture,
    *,
    truth: Truth = None,
    seed: Seed = 0,
) -> "tuple[Score, ...]":
    """Score a fused picture by eleven measures of the literature, with a noise and a copy control.

    The pictures are of one size; a truth adds scores against it.

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
    import numpy as np

    from charact.fusion.files import read_codes, region_of
    from charact.fusion.scores import score
    from charact.fusion.truth import truth_scores

    codes = [read_codes(picture) for picture in (visible, thermal, fused)]
    rows = score(codes[0], codes[1], codes[2], rng=np.random.default_rng(seed))
    region = region_of(Path(fused)) if isinstance(fused, str | Path) else None
    known = _truth(truth, region)
    if known is None:
        return rows
    grey = np.stack([code if code.ndim == 2 else code.mean(axis=-1) for code in codes[:2]])
    return rows + truth_scores(codes[2], known, grey, rng=np.random.default_rng(seed))


@documented
def fusion_colours(
    visible: Annotated[
        "str | Path", Argument('"SESSION#LABEL" of the visible camera of a simulated session.')
    ],
    thermal: Annotated["str | Path", Argument('"SESSION#LABEL" of the thermal camera.')],
    scene: Annotated[
        "str | Path", Argument("The simulated scene: its TOML file, or the name of a shipped one.")
    ],
) -> "tuple[ColourTable, tuple[str, ...]]":
    """Make a table of daylight colours for `fuse` from the truth of a simulated session.

    Returns
    -------
    table, materials
        The table, with `save`, and the names of the materials in the truth.

    Raises
    ------
    BadInput
        If the session has no truth, or the scene is not an outdoor one.
    """
    from charact.fusion.alignment import align_bands, common_field, crop_bands
    from charact.fusion.noise_aware import make_colour_table
    from charact.fusion.sources import band_of

    read = _read((visible, thermal))
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
    import numpy as np

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
