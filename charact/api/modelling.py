"""Fit, simulation, validation and report as functions."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from charact.api.inputs import Frames, session_of
from charact.api.measuring import measure
from charact.method.registry import Progress, ignore_progress
from labdata.camera.description import Camera
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Result
from labdata.sensors import load_camera
from labdata.session import Session

if TYPE_CHECKING:
    from charact.validation import Validation


def fit(
    source: str | Path | Session,
    result: Result | None = None,
    *,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Camera:
    """Fit the description of a session's sensor to its measurements.

    Parameters
    ----------
    source
        A session, with a sensor description, or its folder.
    result
        Its measurements; None: the session is measured.
    seed
        Seed of every random step.
    progress
        Called with a sentence and the fraction done (0..1).

    Returns
    -------
    Camera
        Identified parameters with joint posterior draws, the others at their priors.
    """
    from charact.fitting import fit_sensor

    given = session_of(source)
    return fit_sensor(
        given, result or measure(given, seed=seed, progress=progress), seed=seed, progress=progress
    )


def validate(
    source: str | Path | Session,
    sensor: str | Path | Camera,
    *,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> "Validation":
    """Compare the frames of a session with frames simulated from a fitted sensor, by tests that can
    fail.

    Parameters
    ----------
    source
        A session or its folder.
    sensor
        The fitted camera, see `fit`, or its TOML file.
    seed, progress
        As for `fit`.
    """
    from charact.validation import validate as compare

    fitted = load_camera(sensor) if isinstance(sensor, str | Path) else sensor
    if fitted.is_thermal:
        raise BadInput(f"a validation needs a camera of visible light, got {fitted.name!r}")
    return compare(session_of(source), fitted, seed=seed, progress=progress)


def report(
    source: str | Path | Session,
    out: str | Path | None = None,
    *,
    result: Result | None = None,
    validation: "Validation | None" = None,
    pdf: bool = False,
    seed: int = 0,
) -> Path:
    """Write the report of a session as one HTML file.

    Parameters
    ----------
    source
        A session or its folder.
    out
        The HTML file; None: report.html in the session's folder.
    result
        The measurements; None: those saved in the session, else the session is measured.
    validation
        The comparison with simulated frames; None: that saved in the session, if any.
    pdf
        Also write a PDF next to it.
    seed
        Seed of every random step of a measurement.

    Returns
    -------
    Path
        The HTML file.

    Raises
    ------
    BadInput
        If there is no `out` for a session in memory, or no program that writes a PDF.
    """
    from charact.reporting.session_page import write
    from charact.validation import load
    from labdata import result_io

    given, on_disk = session_of(source), not isinstance(source, Session) or source.folder != Path()
    if out is None and not on_disk:
        raise BadInput("a report of a session in memory needs the path of its file, got no out")
    if on_disk:
        result = result or result_io.load(given.folder)
        validation = validation or load(given.folder)
    return write(
        given,
        result or measure(given, seed=seed),
        out or given.folder / "report.html",
        validation=validation,
        pdf=pdf,
    )


def simulate(
    source: Frames,
    *,
    sensor: str | Path | Camera,
    frames: int = 1,
    seed: int = 0,
    out: str | Path | None = None,
    kind: Any = None,
    error_budget_percent: float | None = 10.0,
    photoelectrons_per_dn: float | None = None,
    black_dn: float | None = None,
    target: Any = None,
    progress: Callable[[str, float], None] = ignore_progress,
    **conditions: Any,
) -> FrameStack:
    """Simulate frames of an image or a scene by a described camera.

    Parameters
    ----------
    source
        An array (row, col), DN; a file of an image; a radiance cube (.npz); or a scene (.toml, or a
        shipped name).
    sensor
        The camera: a shipped name, a TOML file, or a description, such as that of `fit`.
    frames
        Number of frames.
    seed
        Seed of every random step.
    out
        Folder of a session that the frames are also saved to; None: none.
    kind, target
        Kind of the stack and target on the bench, as for `simulate.api.SimulationRequest`.
    error_budget_percent
        Largest sum of neglected effects, percent of the temporal noise; None: no effect is
        neglected.
    photoelectrons_per_dn, black_dn
        Of an image: mean photoelectrons per pixel and exposure for each DN above the black level,
        and this level, DN.
    progress
        Called with a sentence and the fraction done (0..1).
    conditions
        Settings of the camera as for `simulate.api.conditions_of`, such as `gain` and `gate_ns`.

    Returns
    -------
    FrameStack
        The frames, with notes on what was neglected.

    Examples
    --------
    >>> import numpy as np
    >>> flat = np.full((40, 40), 100.0)
    >>> simulate(flat, sensor="gen3-digital-iccd", frames=2, photoelectrons_per_dn=0.1).data.dtype
    dtype('uint16')
    """
    from simulate import api, session_files

    described = api.load_described_camera(str(sensor)) if isinstance(sensor, str | Path) else sensor
    if frames < 1:
        raise BadInput(f"at least 1 frame must be simulated, got {frames}")
    settings = api.conditions_of(described, **conditions)
    request = api.SimulationRequest(
        source=Path(source) if isinstance(source, str | Path) else source,
        kind=kind,
        photoelectrons_per_dn=photoelectrons_per_dn,
        black_dn=black_dn,
        tolerance=None if error_budget_percent is None else error_budget_percent / 100.0,
        seed=seed,
    )
    if target is not None:
        request = replace(request, target=target)
    shot = api.simulate(request, described, settings, progress)
    if out is not None:
        session_files.save_session(
            shot, described, Path(out), frames=frames, seed=seed, progress=progress
        )
        return session_of(out).stacks[0].read()
    data = np.stack(list(shot.frames(seed=seed, count=frames)))
    bits = described.video.bit_depth
    return FrameStack(
        data=data,
        full_scale_dn=float(2**bits - 1),
        notes=(f"simulated, seed {seed}", *shot.notes, shot.economy_note),
    )
