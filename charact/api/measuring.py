"""The analyses as functions of arrays, files and sessions."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from charact.api.analysis import Analysis
from charact.api.inputs import Frames, frames_of, sensor_of, session, session_of, stack
from charact.method import Context
from charact.method.registry import Progress, ignore_progress
from labdata.camera.description import Camera
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Result
from labdata.session import Session, StackEntry

Region = tuple[int, int, int, int]
#: Conditions of light, which a dark has none of
LIGHT = ("photons_per_px", "illuminance_lux", "illuminance_relative_sd", "wavelength_nm", "lamp_a")


def mtf(
    frames: Frames,
    kind: str = "edge",
    *,
    roi: Region | None = None,
    method: str = "auto",
    within_percent: float = 2.0,
    quick: bool = False,
    seed: int = 0,
    sensor: str | Path | Camera | None = None,
    plane: str | None = None,
    axis: str | None = None,
    black_dn: float | None = None,
    max_targets: int = 24,
    progress: Progress = ignore_progress,
    **target: Any,
) -> Analysis:
    """Measure the MTF of the targets in an image or stack.

    Parameters
    ----------
    frames
        Array (row, col) or (frame, row, col), DN; a file of frames; or a
        `labdata.frames.FrameStack`.
    kind
        "edge" (slanted), "bars" or "point".
    roi
        Row, column, height and width of the target, px; None: all targets are found.
    method, within_percent
        Name of a method, or "auto" and the tolerance it must meet, percent.
    quick
        Skip posterior sampling.
    seed
        Seed of every random step.
    sensor
        Description of the camera: a shipped name, a TOML file or a `Camera`; None: unknown.
    plane, axis, black_dn
        As for `frames_of`.
    max_targets
        Maximum number of targets measured.
    progress
        Called with a sentence and the fraction done (0..1).
    target
        For bars, if known, `bars` (number) and `frequency_cy_per_px`; for a point `pinhole_px`
        (diameter, px).

    Returns
    -------
    Analysis
        `mtf50`, `mtf10`, `mtf` at single frequencies, and the curve `mtf`.

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
    >>> print(f"{mtf(frame, method='edge-slanted').mtf50.value:.2f}")
    0.18
    """
    from charact.estimators.mtf import measure, measure_all

    read = frames_of(frames, plane=plane, axis=axis, black_dn=black_dn)
    described = sensor_of(sensor)
    interlaced = described is not None and described.video.interlaced
    context = Context(
        seed=seed, quick=quick, camera=described, interlaced=interlaced, progress=progress
    )
    chosen = {"method": method, "within_percent": within_percent, "context": context, **target}
    if roi is None:
        result = measure_all(kind, read, max_targets=max_targets, **chosen)
    else:
        # The border of the file may have been cropped.
        inside = (roi[0] - read.origin[0], roi[1] - read.origin[1], *roi[2:])
        result = measure(kind, read, region=inside, **chosen)
    return Analysis.of(in_file_coordinates(result, read), _name(frames))


def noise(
    source: str | Path | Session | None = None,
    *,
    flats: Sequence[Frames] = (),
    darks: Sequence[Frames] = (),
    method: str = "auto",
    within_percent: float = 2.0,
    quick: bool = False,
    seed: int = 0,
    sensor: str | Path | Camera | None = None,
    bit_depth: int | None = None,
    progress: Progress = ignore_progress,
    **conditions: Any,
) -> Analysis:
    """Measure noise against gain from flats and darks.

    Parameters
    ----------
    source
        A session or its folder; None: the frames of `flats` and `darks`.
    flats, darks
        Stacks of one level each: arrays (frame, row, col), files, or stacks made by
        `charact.stack`.
    method, within_percent, quick, seed, sensor, progress
        As for `mtf`.
    bit_depth
        Bits of the digitiser; None: found from the data.
    conditions
        Fields of `labdata.conditions.Conditions`: a number for all stacks (of light: for the
        flats), or a sequence with one number for each flat.

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

    given = _session(source, flats, darks, conditions, sensor=sensor, bit_depth=bit_depth)
    return _analyse(measure_noise, given, source, method, within_percent, quick, seed, progress)


def bloom(
    source: Frames | Session,
    *,
    method: str = "auto",
    within_percent: float = 2.0,
    quick: bool = False,
    seed: int = 0,
    sensor: str | Path | Camera | None = None,
    progress: Progress = ignore_progress,
    label: str = "point",
) -> Analysis:
    """Measure halo and blooming of overexposed point sources.

    Parameters
    ----------
    source
        A session or its folder (a series of source levels with darks), or one image or stack of a
        source, of which only the quantities of a single level can be measured.
    method, within_percent, quick, seed, sensor, progress
        As for `mtf`.
    label
        Name of the stack that an image is.
    """
    from charact.estimators.bloom import measure
    from charact.estimators.bloom.single_frame import measure_frame

    if isinstance(source, Session) or _is_session(source):
        return _analyse(
            measure, session_of(source), source, method, within_percent, quick, seed, progress
        )
    frames = frames_of(source)
    given = session([stack(frames, "point", label=label)], sensor=sensor)
    context = _context(given, quick, seed, progress)
    if method == "auto":
        result = measure_frame(given, context=context)
    else:
        result = measure(given, method=method, within_percent=within_percent, context=context)
    return Analysis.of(in_file_coordinates(result, frames), _name(source))


def measure(
    source: str | Path | Session,
    *,
    within_percent: float = 2.0,
    quick: bool = False,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Analysis:
    """Measure everything that the stacks of a session support.

    Parameters
    ----------
    source
        A session or its folder.
    within_percent, quick, seed, progress
        As for `mtf`.

    Raises
    ------
    BadInput
        If there is no session, or every stack is of kind scene.
    """
    from charact.session_measurement import measure as measure_session

    given = session_of(source)
    result = measure_session(
        given, quick=quick, seed=seed, within_percent=within_percent, progress=progress
    )
    return Analysis.of(result, _name(source), given)


def _analyse(
    analysis: Callable[..., Result],
    given: Session,
    source: object,
    method: str,
    within_percent: float,
    quick: bool,
    seed: int,
    progress: Progress,
) -> Analysis:
    context = _context(given, quick, seed, progress)
    result = analysis(given, method=method, within_percent=within_percent, context=context)
    return Analysis.of(result, _name(source), given)


def _context(given: Session, quick: bool, seed: int, progress: Progress) -> Context:
    from charact.session_measurement import method_context

    return method_context(given, quick=quick, seed=seed, progress=progress)


def _session(
    source: str | Path | Session | None,
    flats: Sequence[Frames],
    darks: Sequence[Frames],
    conditions: dict[str, Any],
    *,
    sensor: str | Path | Camera | None,
    bit_depth: int | None,
) -> Session:
    """Return the session given, or one of flats and darks."""
    if source is not None:
        if len(flats) or len(darks) or conditions:
            raise BadInput(
                "noise takes a session, or flats and darks with their conditions, got both"
            )
        return session_of(source)
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
            one,
            "flat",
            {**common, **{name: float(values[number]) for name, values in per_flat.items()}},
        )
        for number, one in enumerate(flats)
    ]
    stacks += [_stack(one, "dark", of_darks) for one in darks]
    return session(stacks, sensor=sensor, bit_depth=bit_depth)


def _stack(frames: Frames | StackEntry, kind: Any, conditions: dict[str, Any]) -> StackEntry:
    if not isinstance(frames, StackEntry):
        return stack(frames, kind, **conditions)
    if frames.kind != kind:
        raise BadInput(f"a stack among the {kind}s must be of kind {kind!r}, got {frames.kind!r}")
    return frames


def _is_session(source: object) -> bool:
    from labdata.session import MANIFEST

    return isinstance(source, str | Path) and (
        Path(source).name == MANIFEST or (Path(source) / MANIFEST).is_file()
    )


def _name(source: object) -> str:
    """Return the name of a source: its path, or what it is."""
    if isinstance(source, str | Path):
        return str(source)
    return source.name if isinstance(source, Session) else "array"


def in_file_coordinates(result: Result, frames: FrameStack) -> Result:
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
        here = next((suffix for suffix in names if name.endswith(suffix)), None)
        return name if here is None else name.removesuffix(here) + names[here]

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
