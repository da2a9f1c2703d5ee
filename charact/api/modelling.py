"""Fit, simulation, validation and report as functions."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Unpack

from charact.api.inputs import camera_of, session_of
from charact.api.measuring import measure
from charact.api.settings import (
    FittedSensor,
    PurposeName,
    SavedResult,
    SourceSession,
    purpose_for,
)
from labdata.conditions import CameraSettings
from labdata.errors import BadInput
from labdata.settings import (
    Argument,
    OfType,
    ProgressSink,
    Seed,
    Setting,
    documented,
    ignore_progress,
)

if TYPE_CHECKING:
    from charact.comparison import Limits
    from charact.validation import Validation
    from labdata import Camera, FrameStack, Kind, Session, Target

FITTED = "fitted.toml"  # fitted camera in the folder of a session


@documented
def fit(
    source: Annotated[
        "str | Path | Session", Argument("A session with a camera description, or its folder.")
    ],
    result: SavedResult = None,
    *,
    seed: Seed = 0,
    progress: ProgressSink = ignore_progress,
) -> "Camera":
    """Fit the description of a session's sensor to its measurements.

    Returns
    -------
    Camera
        Identified parameters with joint posterior draws, the others at their priors, and the
        maps of the specimen that half of the frames support.
    """
    from charact.fitting import fit_sensor
    from charact.fitting.specimen_maps import with_maps

    session = session_of(source)
    measured = result or measure(session, seed=seed, progress=progress)
    return with_maps(session, fit_sensor(session, measured, seed=seed, progress=progress))


@documented
def validate(
    source: SourceSession,
    sensor: FittedSensor = None,
    *,
    of_type: OfType = False,
    limits: Annotated[
        "str | Path | Limits | None",
        Setting("TOML file of limits: [[tolerance]] with unit, max, and statistic, if not all."),
    ] = None,
    quick: Annotated[
        bool, Setting("Change three parameters only for negative controls, each once.")
    ] = False,
    seed: Seed = 0,
    progress: ProgressSink = ignore_progress,
) -> "Validation":
    """Compare the frames of a session with frames simulated from a fitted sensor, by tests that can
    fail.

    Raises
    ------
    BadInput
        If there is no fitted sensor, or it is an infrared imager.
    """
    from charact.comparison import load_limits
    from charact.validation import validate as compare

    session = session_of(source)
    tolerances = () if limits is None else load_limits(limits).tolerance
    fitted = fitted_sensor_of(session, sensor)
    compared = replace(fitted, maps=None) if of_type else fitted
    return compare(
        session, compared, tolerances=tolerances, quick=quick, seed=seed, progress=progress
    )


def fitted_sensor_of(session: "Session", sensor: FittedSensor) -> "Camera":
    """Return a camera that a validation can simulate, or load it."""
    file = session.folder / FITTED
    if sensor is None and not file.is_file():
        raise BadInput(
            f"a validation needs a fitted sensor, got no file {file}: charact fit "
            f"{session.folder} makes one"
        )
    fitted = camera_of(file if sensor is None else sensor)
    assert fitted is not None
    if fitted.is_thermal:
        raise BadInput(
            f"a validation needs a camera of visible light, got {fitted.name!r} of the thermal "
            "infrared"
        )
    return fitted


@documented
def report(
    source: SourceSession,
    out: Annotated[
        str | Path | None, Setting("Output HTML file (default: report.html in the session).")
    ] = None,
    *,
    result: SavedResult = None,
    validation: Annotated[
        "Validation | None",
        Argument("Comparison with simulated frames (default: that saved in the session, if any)."),
    ] = None,
    purpose: PurposeName = None,
    pdf: Annotated[bool, Setting("Also write a PDF.")] = False,
    serial_number: Annotated[
        str | None, Setting("Serial number in the head (default: from the session).")
    ] = None,
    operator: Annotated[
        str | None, Setting("Operator in the head (default: from the session).")
    ] = None,
    date: Annotated[
        str | None, Setting("Date of the frames in the head (default: from the session).")
    ] = None,
    remarks: Annotated[
        str | None, Setting("Remarks in the head (default: from the session).")
    ] = None,
    logo: Annotated[
        str | Path | None, Setting("Picture for the head (default: from the session).")
    ] = None,
    units: Annotated[
        str | None,
        Setting(
            "Unit of frequencies, as of `charact mtf` (default: from the session, else lp/mm at "
            "the cathode of a described tube, else cy/px)."
        ),
    ] = None,
    seed: Seed = 0,
) -> Path:
    """Write the report of a session as one HTML file.

    Returns
    -------
    Path
        The HTML file.

    Raises
    ------
    BadInput
        If there is no `out` for a session in memory, no such purpose, or no program that writes a
        PDF.
    """
    from charact.reporting.session_page import write
    from charact.validation import load
    from labdata import result_io

    session, chosen = session_of(source), purpose_for(purpose)
    on_disk = isinstance(source, str | Path) or session.folder != Path()
    if out is None and not on_disk:
        raise BadInput("`out` must name the report of a session in memory, got none")
    if on_disk:
        result = result or result_io.load(session.folder)
        validation = validation or load(session.folder)
    stated = {
        "serial_number": serial_number,
        "operator": operator,
        "date": date,
        "remarks": remarks,
        "units": units,
        "logo": None if logo is None else str(Path(logo).absolute()),
    }
    about = replace(session.about, **{key: text for key, text in stated.items() if text})
    return write(
        replace(session, about=about),
        result or measure(session, seed=seed),
        out or session.folder / "report.html",
        validation=validation,
        purpose=chosen,
        pdf=pdf,
    )


@documented
def simulate(
    source: Annotated[
        Any,
        Argument(
            "An array (row, col), DN; a file of an image; a radiance cube (.npz); or a scene "
            "(.toml, or a shipped name)."
        ),
    ],
    *,
    sensor: Annotated[
        "str | Path | Camera",
        Argument(
            "The camera: a shipped name, a TOML file, or a description, such as that of `fit`."
        ),
    ],
    frames: Annotated[int, Argument("Number of frames.")] = 1,
    seed: Seed = 0,
    out: Annotated[
        "str | Path | None",
        Argument("Folder of a session that the frames are also saved to (default: none)."),
    ] = None,
    kind: Annotated[
        "Kind | None",
        Argument("Kind of the stack, as for `simulate.SimulationRequest`."),
    ] = None,
    error_budget_percent: Annotated[
        float | None,
        Argument(
            "Largest sum of neglected effects, percent of the temporal noise; None: no effect is "
            "neglected."
        ),
    ] = 10.0,
    photoelectrons_per_dn: Annotated[
        float | None,
        Argument(
            "Of an image: mean photoelectrons per pixel and exposure for each DN above the black "
            "level."
        ),
    ] = None,
    black_dn: Annotated[float | None, Argument("Of an image: its black level, DN.")] = None,
    target: Annotated[
        "Target | None",
        Argument("Target on the bench, as for `simulate.SimulationRequest`."),
    ] = None,
    of_type: OfType = False,
    progress: ProgressSink = ignore_progress,
    **conditions: Unpack[CameraSettings],
) -> "FrameStack":
    """Simulate frames of an image or a scene by a described camera.

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
    import numpy as np

    from labdata.frames import FrameStack
    from simulate import api, conditions_of, load_described_camera, session_files

    described = load_described_camera(str(sensor)) if isinstance(sensor, str | Path) else sensor
    if of_type:
        described = replace(described, maps=None)
    if frames < 1:
        raise BadInput(f"at least 1 frame must be simulated, got {frames}")
    settings = conditions_of(described, **conditions)
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
