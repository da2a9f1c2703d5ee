"""A session validated, kept in its folder, and told: simulated beside measured, with both controls."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from charact import __version__
from charact.cli.output import print_message, progress_bar
from charact.cli.single_image import open_session_only
from labdata.errors import BadInput
from labdata.session import Session

if TYPE_CHECKING:
    from charact.validation import Statistic, Validation


def validate_and_save(folder: Path, sensor: str | Path, *, seed: int, events: bool) -> "Validation":
    """Validate a session against a fitted sensor and keep the outcome in the session's folder."""
    from charact import validation
    from labdata.sensors import load_sensor

    session = open_session_only(folder)
    if isinstance(sensor, Path) and not sensor.is_file():
        raise BadInput(
            f"validate needs a fitted sensor: run charact fit {folder} --sensor-out {sensor}, which is missing"
        )
    fitted = load_sensor(sensor)
    if not fitted.draws.values:
        print_message(
            f"{fitted.name} carries no posterior draws: it is simulated as it stands, without its uncertainty",
            events=events,
        )
    with progress_bar(events=events) as progress:
        done = validation.validate(session, fitted, seed=seed, progress=progress)
    validation.save(done, session.folder)
    return done


def load_validation(session: Session) -> "Validation | None":
    """The validation kept in a session's folder, or None."""
    from charact.validation import load

    return load(session.folder)


def print_validation(validation: "Validation", given: Path, *, as_json: bool) -> None:
    """Print a validation: one line a statistic, both controls, and the verdict."""
    if as_json:
        from charact.validation import as_json as document

        print(json.dumps({"charact": __version__, "input": str(given), "validation": document(validation)}))
        return
    print("\n".join(_lines(validation)))
    print(f"Next: charact report {given}")


def _lines(validation: "Validation") -> Iterator[str]:
    yield from map(_line, validation.statistics)
    for control in validation.controls:
        yield f"{control.name} control ({control.title}): {'held' if control.passed else 'DID NOT HOLD'}"
        yield from (f"    {_line(statistic)}" for statistic in control.statistics)
    yield f"validation: {'passed' if validation.passed else 'FAILED'}"


def _line(statistic: "Statistic") -> str:
    verdict = "agrees" if statistic.passed else "differs"
    return f"{statistic.title}: p {statistic.p_value:.3g} at level {statistic.level:.3g}, {verdict}"
