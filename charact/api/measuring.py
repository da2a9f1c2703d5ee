"""The analyses as functions of arrays, files and sessions."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Unpack

from charact.api.inputs import (
    flats_of,
    frames_of,
    is_session,
    sensor_of,
    session,
    session_of,
    stack,
)
from charact.api.settings import (
    Also,
    Amplifier,
    BarFrequency,
    Bars,
    BitDepth,
    BlackDn,
    Disc,
    Frames,
    MaxTargets,
    MethodName,
    PinholePx,
    PurposeName,
    Quick,
    Scheduler,
    SourceSession,
    WithinPercent,
    amplifier_of,
    disc_of,
    purpose_for,
)
from labdata.conditions import FlatConditions
from labdata.errors import BadInput
from labdata.settings import (
    Argument,
    CameraDescription,
    Extension,
    FrameAxis,
    Partial,
    Plane,
    Progress,
    ProgressSink,
    Region,
    Roi,
    Seed,
    documented,
    ignore_progress,
    region_of,
)

if TYPE_CHECKING:
    from charact.api.analysis import Analysis
    from labdata import FrameStack, Result, Session, StackEntry

#: Conditions of light, which a dark has none of
LIGHT = ("photons_per_px", "illuminance_lux", "illuminance_relative_sd", "wavelength_nm", "lamp_a")
#: Settings that describe a target, by its kind
OF_TARGET = {"bars": ("bars", "frequency_cy_per_px"), "point": ("pinhole_px",)}


@documented
def mtf(
    frames: Annotated[
        "Frames | Session",
        Argument(
            "Array (row, col) or (frame, row, col), DN; a file of frames; or a "
            "`labdata.frames.FrameStack`. For flats also a session or its folder."
        ),
    ],
    kind: Annotated[
        str,
        Argument(
            'Target: "edge" (slanted), "bars", "point", or "flats" (no target: the MTF after the '
            "gain, from the noise power spectrum)."
        ),
    ] = "edge",
    *,
    roi: Roi = None,
    method: MethodName = "auto",
    within_percent: WithinPercent = 2.0,
    also: Also = None,
    quick: Quick = False,
    seed: Seed = 0,
    sensor: CameraDescription = None,
    plane: Plane = None,
    axis: FrameAxis = None,
    extension: Extension = None,
    partial: Partial = False,
    black_dn: BlackDn = None,
    max_targets: MaxTargets = 24,
    bars: Bars = None,
    frequency_cy_per_px: BarFrequency = None,
    pinhole_px: PinholePx = None,
    progress: ProgressSink = ignore_progress,
) -> "Analysis":
    """Measure the MTF of the targets in an image or stack, or of flat fields.

    Returns
    -------
    Analysis
        `mtf50`, `mtf10`, `mtf` at single frequencies, and the curve `mtf`; of flats
        `post_gain_mtf50` and its curve; with `also` "sfr" `sfr50`, `sfr50_difference` and the curve
        `sfr`.

    Raises
    ------
    BadInput
        If the frames are no image, or an argument breaks a rule.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.special import erf
    >>> row, col = np.mgrid[:60, :80]
    >>> edge = 1000 + 400 * erf((col - 40 + 0.1 * (row - 30)) / 1.5)
    >>> frame = np.random.default_rng(1).poisson(edge)
    >>> print(f"{mtf(frame, method='edge-slanted').mtf50.value:.1f}")
    0.2
    """
    from charact.api.analysis import Analysis
    from charact.estimators.mtf import measure, measure_all, measure_flats
    from charact.method import Context

    described = {
        "bars": bars,
        "frequency_cy_per_px": frequency_cy_per_px,
        "pinhole_px": pinhole_px,
    }
    target = {name: value for name, value in described.items() if value is not None}
    if foreign := [name for name in target if name not in OF_TARGET.get(kind, ())]:
        raise BadInput(f"`{foreign[0]}` describes another target than kind {kind!r}")
    reading = {"plane": plane, "axis": axis, "extension": extension, "partial": partial}
    if also is not None and kind != "edge":
        raise BadInput(f"`also` is of kind 'edge', got kind {kind!r}")
    if kind == "flats":
        flats = flats_of(frames, sensor=sensor, **reading)
        return _analyse(measure_flats, flats, frames, method, within_percent, quick, seed, progress)
    region = region_of(roi)
    image = frames_of(frames, black_dn=black_dn, **reading)
    camera = sensor_of(sensor)
    interlaced = camera is not None and camera.video.interlaced
    context = Context(
        seed=seed, quick=quick, camera=camera, interlaced=interlaced, progress=progress
    )
    settings = {"method": method, "within_percent": within_percent, "also": also, **target}
    settings["context"] = context
    if region is None:
        result = measure_all(kind, image, max_targets=max_targets, **settings)
    else:
        # The border of the file may have been cropped.
        cropped = (region[0] - image.origin[0], region[1] - image.origin[1], *region[2:])
        result = measure(kind, image, region=cropped, **settings)
    return Analysis.of(in_file_coordinates(result, image), _name(frames))


@documented
def noise(
    source: Annotated[
        "str | Path | Session | None",
        Argument("A session or its folder (default: the frames of `flats` and `darks`)."),
    ] = None,
    *,
    flats: Annotated[
        Sequence[Frames],
        Argument(
            "Stacks of one level each: arrays (frame, row, col), files, or stacks made by "
            "`charact.stack`."
        ),
    ] = (),
    darks: Annotated[Sequence[Frames], Argument("Stacks without light, as `flats`.")] = (),
    method: MethodName = "auto",
    within_percent: WithinPercent = 2.0,
    quick: Quick = False,
    seed: Seed = 0,
    sensor: CameraDescription = None,
    bit_depth: BitDepth = None,
    amplifier: Amplifier = "all",
    scheduler: Scheduler = None,
    progress: ProgressSink = ignore_progress,
    **conditions: Unpack[FlatConditions],
) -> "Analysis":
    """Measure noise against gain from flats and darks.

    Raises
    ------
    BadInput
        If there are no frames, both a session and frames, or a sequence has not one entry for each
        flat.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> flats = [2.0 * rng.poisson(level, (8, 64, 64)) + 100 for level in (100, 200, 400)]
    >>> darks = [100.0 + rng.normal(0, 3, (8, 64, 64))]
    >>> result = noise(flats=flats, darks=darks, method="variance", quick=True)
    >>> bool(abs(result.system_gain.value - 2.0) < 0.05)
    True
    """
    from charact.session_measurement import measure_noise

    if source is None:
        measured = _session_of_flats(
            flats, darks, dict(conditions), sensor=sensor, bit_depth=bit_depth
        )
    elif len(flats) or len(darks) or conditions:
        raise BadInput("noise takes a session, or flats and darks with their conditions, got both")
    else:
        measured = session_of(source, sensor)
    return _analyse(
        measure_noise,
        measured,
        source,
        method,
        within_percent,
        quick,
        seed,
        progress,
        scheduler,
        amplifier_of(amplifier),
    )


@documented
def bloom(
    source: Annotated[
        "Frames | Session",
        Argument(
            "A session or its folder (a series of source levels with darks), or one image or stack "
            "of a source, of which only the quantities of a single level can be measured."
        ),
    ],
    *,
    method: MethodName = "auto",
    within_percent: WithinPercent = 2.0,
    quick: Quick = False,
    seed: Seed = 0,
    sensor: CameraDescription = None,
    plane: Plane = None,
    axis: FrameAxis = None,
    extension: Extension = None,
    partial: Partial = False,
    progress: ProgressSink = ignore_progress,
) -> "Analysis":
    """Measure halo and blooming of overexposed point sources."""
    from charact.api.analysis import Analysis
    from charact.estimators.bloom import measure
    from charact.estimators.bloom.single_frame import measure_frame
    from charact.session_measurement import measure_bloom, method_context

    if is_session(source):
        measured = session_of(source, sensor)
        return _analyse(
            measure_bloom, measured, source, method, within_percent, quick, seed, progress
        )
    frames = frames_of(source, plane=plane, axis=axis, extension=extension, partial=partial)
    label = Path(source).stem if isinstance(source, str | Path) else "point"
    image = session([stack(frames, "point", label=label)], sensor=sensor)
    context = method_context(image, quick=quick, seed=seed, progress=progress)
    if method == "auto":
        result = measure_frame(image, context=context)
    else:
        result = measure(image, method=method, within_percent=within_percent, context=context)
    return Analysis.of(in_file_coordinates(result, frames), _name(source))


@documented
def measure(
    source: SourceSession,
    *,
    purpose: PurposeName = None,
    within_percent: WithinPercent = 2.0,
    also: Also = None,
    disc: Disc = "10,0.1",
    quick: Quick = False,
    seed: Seed = 0,
    amplifier: Amplifier = "all",
    scheduler: Scheduler = None,
    progress: ProgressSink = ignore_progress,
) -> "Analysis":
    """Measure everything that the stacks of a session support, and say whether it is enough.

    Returns
    -------
    Analysis
        All quantities; `verdict` with `answer` ("fit", "not fit", "not enough" or "undecided"),
        `because` and `missing`, the frames to add.

    Raises
    ------
    BadInput
        If there is no session, every stack is of kind scene, or there is no such purpose.
    """
    from charact.api.analysis import Analysis
    from charact.method.registry import parallel_map
    from charact.session_measurement import measure as measure_session
    from charact.verdict.purpose import purpose_of

    measured, chosen = session_of(source), purpose_for(purpose)
    with parallel_map(scheduler) as spread:
        result = measure_session(
            measured,
            quick=quick,
            seed=seed,
            within_percent=within_percent,
            also=also,
            disc=disc_of(disc),
            amplifier=amplifier_of(amplifier),
            progress=progress,
            spread=spread,
        )
    decision = (chosen or purpose_of(measured, result)).decide(measured, result)
    return Analysis.of(result, _name(source), measured, verdict=decision)


def _analyse(
    analysis: "Callable[..., Result]",
    measured: "Session",
    source: object,
    method: str,
    within_percent: float,
    quick: bool,
    seed: int,
    progress: Progress,
    scheduler: str | None = None,
    amplifier: int | None = None,
) -> "Analysis":
    """Return the result of one analysis of a session."""
    from charact.api.analysis import Analysis
    from charact.method.registry import parallel_map
    from charact.session_measurement import method_context

    with parallel_map(scheduler) as spread:
        context = method_context(
            measured,
            quick=quick,
            seed=seed,
            amplifier=amplifier,
            progress=progress,
            spread=spread,
        )
        result = analysis(measured, method=method, within_percent=within_percent, context=context)
    return Analysis.of(result, _name(source), measured)


def _session_of_flats(
    flats: Sequence[Frames],
    darks: Sequence[Frames],
    conditions: dict[str, Any],
    *,
    sensor: CameraDescription,
    bit_depth: int | None,
) -> "Session":
    """Return a session of flats and darks."""
    per_flat = {
        name: value
        for name, value in conditions.items()
        if isinstance(value, Sequence) or hasattr(value, "shape")
    }
    for name, values in per_flat.items():
        if len(values) != len(flats):
            raise BadInput(
                f"{name} must have one entry for each of {len(flats)} flats, got {len(values)}"
            )
    common = {name: value for name, value in conditions.items() if name not in per_flat}
    of_darks = {name: value for name, value in common.items() if name not in LIGHT}
    stacks = [
        _stack(
            frames,
            "flat",
            {**common, **{name: float(values[number]) for name, values in per_flat.items()}},
        )
        for number, frames in enumerate(flats)
    ]
    stacks += [_stack(frames, "dark", of_darks) for frames in darks]
    return session(stacks, sensor=sensor, bit_depth=bit_depth)


def _stack(frames: "Frames | StackEntry", kind: Any, conditions: dict[str, Any]) -> "StackEntry":
    from labdata.session import StackEntry

    if not isinstance(frames, StackEntry):
        return stack(frames, kind, **conditions)
    if frames.kind != kind:
        raise BadInput(f"a stack among the {kind}s must be of kind {kind!r}, got {frames.kind!r}")
    return frames


def _name(source: object) -> str:
    """Return the name of a source: its path, or what it is."""
    from labdata.session import Session

    if isinstance(source, str | Path):
        return str(source)
    return source.name if isinstance(source, Session) else "array"


def in_file_coordinates(result: "Result", frames: "FrameStack") -> "Result":
    """Return the result with regions in coordinates of the file and with the notes of the
    importer.
    """
    from charact.estimators.mtf.dispatch import REGION_NAME

    def shift(region: Region) -> Region:
        return region[0] + frames.origin[0], region[1] + frames.origin[1], region[2], region[3]

    names = {
        REGION_NAME.format(*m.region): REGION_NAME.format(*shift(m.region))
        for m in result.measurements
        if m.region
    }

    def rename(name: str) -> str:
        region = next((suffix for suffix in names if name.endswith(suffix)), None)
        return name if region is None else name.removesuffix(region) + names[region]

    return replace(
        result,
        measurements=tuple(
            m.with_(
                region=None if m.region is None else shift(m.region),
                notes=tuple(dict.fromkeys((*m.notes, *frames.notes))),
            )
            for m in result.measurements
        ),
        curves={rename(name): curve for name, curve in result.curves.items()},
        evidence={rename(name): shown for name, shown in result.evidence.items()},
    )
