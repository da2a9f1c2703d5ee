"""The verb `fuse`: one picture of a visible and a thermal frame with uncertainty, and its
scores.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from charact import __version__
from charact.cli import options
from charact.cli.fuse_table import table
from charact.cli.output import exit_on_bad_input, print_message, print_result, progress_bar
from charact.cli.outputs import Force
from labdata.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from charact.fusion.bands import Band
    from charact.fusion.fused import Fused
    from charact.fusion.geometry import Placement
    from charact.fusion.scores import Score
    from charact.fusion.sources import Source
    from charact.fusion.truth_scores import FusionTruth


class _PicturesByDefault(TyperGroup):
    """Group whose first argument is a command or, otherwise, the first picture."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the command `pictures` where none is named."""
        if args and args[0] not in self.commands and args[0] not in ("-h", "--help"):
            args = ["pictures", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_PicturesByDefault,
    no_args_is_help=True,
    help=(
        "Fuse visible and thermal pictures: charact fuse visible.tif thermal.tif OUT; score one: "
        "charact fuse score."
    ),
)

app.command()(table)

Sources = Annotated[
    list[str],
    typer.Argument(
        help="Pictures, or SESSION#LABEL: VISIBLE THERMAL [MORE...] OUT; OUT is a new folder, "
        ".png or .tif. Frames of several sizes need descriptions of both cameras, or a simulated "
        "session."
    ),
]
Truth = Annotated[
    Path | None,
    typer.Option(
        help="Truth of the scene (.npz with bands, objects, halos, zones): adds restoration errors."
    ),
]


@app.command()
def pictures(
    sources: Sources,
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            help="Method name, auto, or all; several for one page of pictures and scores.",
        ),
    ] = None,
    colour: Annotated[
        bool, typer.Option("--colour", help="Colour: keeps contrasts of opposite sign.")
    ] = False,
    sensor: options.SensorName = None,
    imager: Annotated[
        str | None,
        typer.Option(help="Description of the thermal camera: shipped name or TOML file."),
    ] = None,
    mcp_v: Annotated[
        float | None,
        typer.Option(
            "--mcp-v", help="MCP voltage of the visible frame, V (default: from the session)."
        ),
    ] = None,
    black_dn: Annotated[
        float | None,
        typer.Option(
            "--black-dn", help="Black level of the visible frame, DN (default: from the file)."
        ),
    ] = None,
    span: Annotated[
        list[str] | None,
        typer.Option(help="Fixed display span BAND=LOW,HIGH in DN above black or K."),
    ] = None,
    no_bloom: Annotated[
        bool, typer.Option("--no-bloom", help="Do not estimate and subtract blooming.")
    ] = False,
    registered: Annotated[
        bool,
        typer.Option(
            "--registered", help="Do not measure and correct the shift that geometry leaves."
        ),
    ] = False,
    range_m: Annotated[
        float | None,
        typer.Option(
            "--range-m",
            help="Distance of the whole scene for parallax, m (default: range of each pixel).",
        ),
    ] = None,
    whole: Annotated[
        bool,
        typer.Option(
            "--whole", help="Keep pixels outside a field of view (default: the field in common)."
        ),
    ] = False,
    sequence: Annotated[
        bool,
        typer.Option(
            "--sequence", help="Fuse stacks frame by frame with one span, not their means."
        ),
    ] = False,
    recursive: Annotated[
        float | None,
        typer.Option(
            help=(
                "Filter a sequence in time: share of the newest frame in the running mean, above "
                "0 to 1."
            )
        ),
    ] = None,
    within: options.Within = 60.0,
    colours: Annotated[
        Path | None,
        typer.Option(
            "--table", help="Add a picture in the colours of a table: charact fuse table."
        ),
    ] = None,
    truth: Truth = None,
    seed: options.Seed = 0,
    force: Force = False,
    everything: options.Everything = False,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Fuse pictures (default command).

    Writes fused.tif, fused.png, sd.tif, share.tif, mask.png, fused.json and each band as it was
    fused; of several methods one folder each, and index.html.

    Example: charact fuse visible.tif thermal.tif fused --sensor pulnix-ag5745ef3

    Example: charact fuse night#pulnix-ag5745ef3 night#vox-lwir-640 fused --method all
    """
    *given, out = sources
    with (
        exit_on_bad_input(" ".join(given), as_json=as_json, events=events),
        progress_bar(events=events) as progress,
    ):
        if len(given) < 2:
            raise BadInput(f"fuse needs VISIBLE THERMAL [MORE...] OUT, got {' '.join(sources)}")
        target, names = Path(out), _methods(method or ["auto"])
        if sequence and (len(names) > 1 or truth or colours):
            raise BadInput("--sequence needs one --method and neither --truth nor --table")
        if recursive is not None and not sequence:
            raise BadInput("--recursive filters a --sequence")
        _require_output(
            target, whole_folder=len(names) > 1 or sequence or colours is not None, force=force
        )
        read = _read(given, sensor=sensor, imager=imager, mcp_v=mcp_v, black_dn=black_dn)
        aligned = _align(
            read,
            bloom=not no_bloom,
            seed=seed,
            distance_m=range_m,
            registered=registered,
            whole=whole,
            progress=progress,
        )
        spans = _spans(span or [])
        if sequence:
            found = _fuse_frames(
                aligned,
                names[0],
                target,
                given,
                colour=colour,
                spans=spans,
                distance_m=range_m,
                recursive=recursive,
                bloom=not no_bloom,
                seed=seed,
                within_percent=within,
                progress=progress,
            )
        else:
            found = _fuse_means(
                aligned,
                names,
                target,
                given,
                colour=colour,
                spans=spans,
                registered=registered,
                colours=colours,
                truth=truth,
                seed=seed,
                within_percent=within,
                progress=progress,
            )
        progress("", 1.0)
        _print(found, target, given, as_json=as_json, events=events, everything=everything)


@dataclass(frozen=True, kw_only=True)
class _Aligned:
    """Sources, their bands on the pixels of the first one, the bands' places, and the region that
    all show.
    """

    read: "list[Source]"
    bands: "list[Band]"
    places: "list[Placement | None]"
    region: tuple[int, int, int, int] | None


def _require_output(target: Path, *, whole_folder: bool, force: bool) -> None:
    """Require a new output, and a folder where there is more than one picture."""
    from charact.cli.fuse_files import require_free_output

    if target.suffix and whole_folder:
        raise BadInput(
            f"OUT must be a folder for several methods or a sequence, got {target.name!r}"
        )
    require_free_output(target, force=force)


def _align(
    read: "list[Source]",
    *,
    bloom: bool,
    seed: int,
    distance_m: float | None,
    registered: bool,
    whole: bool,
    progress: Any,
) -> _Aligned:
    """Return the means of the sources as bands on common pixels; `whole`: all pixels, not the field
    in common.
    """
    from charact.fusion.alignment import align_bands, common_field
    from charact.fusion.sources import band_of

    progress("bands", 0.1)
    bands = [band_of(one, bloom=bloom, seed=seed) for one in read]
    progress("registration", 0.5)
    bands, places = align_bands(bands, read, distance_m=distance_m, registered=registered)
    return _Aligned(
        read=read, bands=bands, places=places, region=None if whole else common_field(places)
    )


def _fuse_frames(
    aligned: _Aligned,
    method: str,
    target: Path,
    given: list[str],
    *,
    progress: Any,
    **settings: Any,
) -> "dict[str, Fused]":
    """Fuse a sequence frame by frame and write it; return its first picture by the method that was
    used.
    """
    from charact.cli.fuse_files import write_sequence
    from charact.fusion.sequence import fuse_sequence, pair_frames

    pairs, notes = pair_frames(aligned.read)
    frames = fuse_sequence(
        aligned.read, pairs, method=method, places=aligned.places, region=aligned.region, **settings
    )
    made = []
    for one in frames:
        made.append(one)
        progress(f"frame {len(made)} of {len(pairs)}", 0.5 + 0.5 * len(made) / len(pairs))
    rows = tuple(row.with_(notes=(*row.notes, *notes)) for row in made[0].measurements)
    stamps = aligned.read[0].stack.time_s
    times = [float(stamps[pair[0]]) for pair in pairs] if stamps.size else None
    write_sequence(made, target, given, aligned.region, times)
    return {rows[0].method: replace(made[0], measurements=rows)}


def _fuse_means(
    aligned: _Aligned,
    names: list[str],
    target: Path,
    given: list[str],
    *,
    colours: Path | None,
    truth: Path | None,
    seed: int,
    progress: Any,
    spans: dict[str, tuple[float, float]],
    **settings: Any,
) -> "dict[str, Fused]":
    """Fuse the means of all frames by several methods, write the pictures and return them by
    name.
    """
    from charact.cli import fuse_files as files
    from charact.fusion.bands import display_planes
    from charact.fusion.colour_table import ColourTable, fuse_by_table
    from charact.fusion.fuse import fuse_all
    from charact.fusion.fused import codes_of

    bands, region = _crop(aligned), aligned.region
    progress("fusion", 0.8)
    found = fuse_all(bands, names, spans=spans, **settings)
    if colours is not None:
        found["colour-table"] = fuse_by_table(bands, ColourTable.load(colours))
    true = None if truth is None else _truth(truth, region)
    found = {
        name: one if true is None else _with_error(one, true, bands, seed)
        for name, one in found.items()
    }
    shown = [codes_of(plane.value) for plane in display_planes(bands, bloom=False, spans=spans)]
    files.write(found, shown, target, given, region)
    if len(found) > 1:
        _write_page(found, bands, shown, aligned.read, target, true, seed, progress)
    return found


def _crop(aligned: _Aligned) -> "list[Band]":
    """Return the bands cut to the region that all show, the first with a note of it."""
    from charact.fusion.alignment import crop_band

    if aligned.region is None:
        return aligned.bands
    bands = [crop_band(band, aligned.region) for band in aligned.bands]
    note = "ROW,COL,HEIGHT,WIDTH {},{},{},{} of {}, the field of view in common (--whole keeps all)"
    noted = replace(bands[0], notes=(*bands[0].notes, note.format(*aligned.region, bands[0].name)))
    return [noted, *bands[1:]]


def _print(
    found: "dict[str, Fused]",
    target: Path,
    given: list[str],
    *,
    as_json: bool,
    events: bool,
    everything: bool,
) -> None:
    """Print the measurements of all pictures, and how to score the first one."""
    from charact.cli.fuse_files import picture_of
    from labdata.measurement import Result

    result = Result(measurements=tuple(row for one in found.values() for row in one.measurements))
    picture = picture_of(target, next(iter(found)) if len(found) > 1 else None)
    inputs = [target / f"{name}.png" for name in next(iter(found.values())).names[:2]]
    print_result(
        result,
        given=" ".join(given),
        verb="fuse",
        as_json=as_json,
        events=events,
        everything=everything,
        next_verb=None
        if target.suffix
        else f"charact fuse score {inputs[0]} {inputs[1]} {picture}",
    )
    if not as_json:
        print_message(f"{target}: {', '.join(found)} of {', '.join(given)}", events=events)


@app.command()
def score(
    visible: Annotated[Path, typer.Argument(help="Visible picture of 8 bits.")],
    thermal: Annotated[Path, typer.Argument(help="Thermal picture of 8 bits.")],
    fused: Annotated[Path, typer.Argument(help="Fused picture of 8 bits, grey or colour.")],
    truth: Truth = None,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Score a fused picture by eleven measures of the literature, each with a noise and a copy
    control.

    Example: charact fuse score visible.png thermal.png fused/fused.png
    """
    with exit_on_bad_input(str(fused), as_json=as_json, events=events):
        import numpy as np

        from charact.cli.fuse_files import region_of
        from charact.fusion import scores
        from charact.fusion.truth_scores import truth_scores

        codes = [_codes(path) for path in (visible, thermal, fused)]
        rows = list(scores.score(codes[0], codes[1], codes[2], rng=np.random.default_rng(seed)))
        if truth is not None:
            grey = np.stack([one if one.ndim == 2 else one.mean(axis=-1) for one in codes[:2]])
            true = _truth(truth, region_of(fused))
            rows += truth_scores(codes[2], true, grey, rng=np.random.default_rng(seed))
        if as_json:
            found = [row._asdict() for row in rows]
            print(
                json.dumps(
                    {"charact": __version__, "input": str(fused), "scores": found}, allow_nan=False
                )
            )
            return
        print(f"{'score':24} {'value':>12} {'with noise':>12} {'copy':>12}  unit")
        for row in rows:
            columns = ("undefined" if one is None else f"{one:.5g}" for one in row[2:])
            print(
                f"{row.quantity:24} " + " ".join(f"{one:>12}" for one in columns) + f"  {row.unit}"
            )
        print(
            "with noise: the fused picture plus noise of 10 DN; copy: the visible picture instead"
        )


def _codes(path: Path) -> Any:
    """Return the 8-bit codes of a picture, (row, col) or (row, col, 3); a picture of other values
    is BadInput.
    """
    import numpy as np

    from labdata.importers import read_frames

    planes = []
    try:
        planes = [read_frames(path, plane).data[0] for plane in ("r", "g", "b")]
    except BadInput:
        planes = [read_frames(path).data[0]]
    codes = planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)
    if codes.dtype != np.uint8:
        raise BadInput(
            f"scores are of pictures of 8 bits, got {codes.dtype} in {path}: score fused.png, not "
            "fused.tif"
        )
    return codes


def _methods(given: list[str]) -> list[str]:
    """Return the names of the methods; all: every registered one."""
    if "all" not in given:
        return list(dict.fromkeys(given))
    from charact.method.registry import methods_of_kind

    return list(methods_of_kind("fusion"))


def _spans(texts: list[str]) -> dict[str, tuple[float, float]]:
    """Return spans by band of texts BAND=LOW,HIGH."""
    spans = {}
    for text in texts:
        name, _, ends = text.partition("=")
        try:
            low, high = (float(end) for end in ends.split(","))
        except ValueError:
            raise BadInput(f"--span must be BAND=LOW,HIGH, got {text!r}") from None
        spans[name] = (low, high)
    return spans


def _read(
    given: list[str],
    *,
    sensor: str | None,
    imager: str | None,
    mcp_v: float | None,
    black_dn: float | None,
) -> "list[Source]":
    """Read all sources; descriptions are of the first and of the second one, voltage and black
    level of the first.
    """
    from charact.fitting.described_camera import describe_camera
    from charact.fusion.sources import read_source
    from labdata.sensors import load_camera, load_sensor

    described = None if sensor is None else load_sensor(sensor)
    thermal: Any = None if imager is None else load_camera(imager)
    if thermal is not None and not thermal.is_thermal:
        raise BadInput(f"--imager must be a thermal camera, got {thermal.name!r}")
    names = ["visible", "thermal", *(f"band-{number}" for number in range(3, len(given) + 1))]
    return [
        read_source(
            given[0],
            names[0],
            camera=described,
            mcp_v=mcp_v,
            black_dn=black_dn,
            describe=describe_camera,
        ),
        *(
            read_source(
                source,
                name,
                camera=thermal if name == "thermal" else None,
                mcp_v=mcp_v,
                describe=describe_camera,
            )
            for source, name in zip(given[1:], names[1:], strict=True)
        ),
    ]


def _truth(path: Path, region: tuple[int, int, int, int] | None) -> "FusionTruth":
    """Return the truth of a scene, cut to the region of a fused picture if it is larger."""
    import numpy as np

    from charact.fusion.truth_scores import FusionTruth

    true = FusionTruth.load(path)
    if region is None or true.objects.shape == region[2:]:
        return true
    row, col, height, width = region
    cut = np.s_[row : row + height, col : col + width]
    return FusionTruth(
        bands=true.bands[(slice(None), *cut)],
        zones={name: mask[cut] for name, mask in true.zones.items()},
        objects=true.objects[cut],
        halos=true.halos - (row, col, 0),
    )


def _with_error(
    found: "Fused", truth: "FusionTruth", bands: "Sequence[Band]", seed: int
) -> "Fused":
    """Return a fused picture with its restoration error in each zone of the truth, percent."""
    from labdata.measurement import make_measurement

    method, errors = found.measurements[0].method, "restoration_error_"
    zones = {
        row.quantity.removeprefix(errors): 100.0 * row.value
        for row in _truth_rows(found, truth, bands, seed)
        if row.quantity.startswith(errors) and row.value is not None
    }
    rows = [
        make_measurement("fusion_error", "%", error, None, None, method=method, stack=zone)
        for zone, error in zones.items()
    ]
    return replace(found, measurements=(*found.measurements, *rows))


def _truth_rows(
    found: "Fused", truth: "FusionTruth", bands: "Sequence[Band]", seed: int
) -> "tuple[Score, ...]":
    import numpy as np

    from charact.fusion.truth_scores import truth_scores

    frames = np.stack([band.image for band in bands])
    return truth_scores(found.picture, truth, frames, rng=np.random.default_rng(seed))


def _write_page(
    found: "dict[str, Fused]",
    bands: "Sequence[Band]",
    shown: "Sequence[Any]",
    read: "Sequence[Source]",
    out: Path,
    truth: "FusionTruth | None",
    seed: int,
    progress: Any,
) -> None:
    """Write index.html: pictures, maps and scores of all methods."""
    import numpy as np

    from charact.fusion.scores import score as score_of
    from charact.reporting.fusion_page import fusion_page
    from labdata.camera.description import has_tube
    from labdata.file_io import write_atomically

    scores, truths = {}, {}
    for number, (name, one) in enumerate(found.items()):
        progress(f"scores of {name}", 0.8 + 0.2 * number / len(found))
        scores[name] = score_of(shown[0], shown[1], one.codes, rng=np.random.default_rng(seed))
        if truth is not None:
            truths[name] = _truth_rows(one, truth, bands, seed)
    camera = read[0].camera
    aspect = camera.pitch_ratio if has_tube(camera) else 1.0
    page = fusion_page(shown, found, scores, truths, aspect=aspect)
    write_atomically(out / "index.html", page.encode())
