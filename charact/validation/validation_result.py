"""Result of a validation: statistics, controls, overlays and frame pairs, stored as JSON and arrays."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import read_only

NUMBERS = "validation.json"
PICTURES = "validation.npz"


@dataclass(frozen=True, kw_only=True)
class Statistic:
    """One comparison of measured with simulated frames.

    Parameters
    ----------
    name, title
        Short name, and description.
    distance
        Distance of the measured value from the simulated ones, about 1 if they agree.
    p_value
        Probability of a distance at least as large if the sensor is right, dimensionless.
    level
        p-value below which it fails, corrected for several comparisons.
    labels, measured, low95, high95
        Names of the numbers, measured values, and predicted 95 % intervals.
    note
        Note for the reader.
    """

    name: str
    title: str
    distance: float
    p_value: float
    level: float
    labels: tuple[str, ...] = ()
    measured: tuple[float, ...] = ()
    low95: tuple[float, ...] = ()
    high95: tuple[float, ...] = ()
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether the measured frames look like the simulated ones in this respect."""
        return self.p_value >= self.level


@dataclass(frozen=True, kw_only=True)
class ValidationControl:
    """The same statistics on frames with a known outcome.

    Parameters
    ----------
    name
        "null": frames of the fitted sensor itself, which must pass. "negative": of the fitted sensor with one stage
        removed, which must fail.
    title
        Description.
    statistics
        Statistics.
    """

    name: Literal["null", "negative"]
    title: str
    statistics: tuple[Statistic, ...]

    @property
    def passed(self) -> bool:
        """Whether the control came out as it must."""
        passed = all(statistic.passed for statistic in self.statistics)
        return passed if self.name == "null" else not passed


@dataclass(frozen=True, kw_only=True)
class FramePair:
    """Measured and simulated frame with a common display range.

    Parameters
    ----------
    kind, label
        Kind and label of the stack.
    measured, simulated
        Images, shape (row, col), uint8.
    low_dn, high_dn
        Grey values shown black and white, DN.
    """

    kind: str
    label: str
    measured: NDArray[np.uint8]
    simulated: NDArray[np.uint8]
    low_dn: float
    high_dn: float


@dataclass(frozen=True, kw_only=True)
class Validation:
    """Comparison of a session with its simulation.

    Parameters
    ----------
    session, sensor
        Names of the session and of the simulated sensor.
    seed, draws, seconds
        Seed, number of posterior draws simulated and time taken, s.
    statistics
        Measured against simulated.
    controls
        Null and negative controls under the same statistics.
    overlays
        Figure data by name, JSON-ready mappings: "mtf", "photon-transfer", "autocorrelation", "histogram". Each has "x"
        with "x_title", "measured", "simulated", "low95", "high95" and "title".
    pairs
        Images for display.
    notes
        Notes for the reader.
    """

    session: str
    sensor: str
    seed: int
    draws: int
    seconds: float
    statistics: tuple[Statistic, ...]
    controls: tuple[ValidationControl, ...]
    overlays: dict[str, dict[str, Any]] = field(default_factory=dict)
    pairs: tuple[FramePair, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for pair in self.pairs:
            object.__setattr__(pair, "measured", read_only(pair.measured))
            object.__setattr__(pair, "simulated", read_only(pair.simulated))

    @property
    def passed(self) -> bool:
        """Whether every statistic passed and both controls came out as they must."""
        return all(s.passed for s in self.statistics) and all(c.passed for c in self.controls)


def as_json(validation: Validation) -> dict[str, Any]:
    """Return all but the frame pairs as JSON-ready mappings."""
    plain = {name: value for name, value in vars(validation).items() if name not in ("pairs", "statistics", "controls")}
    return {
        **plain,
        "passed": validation.passed,
        "notes": list(validation.notes),
        "statistics": [_statistic(one) for one in validation.statistics],
        "controls": [
            {
                "name": c.name,
                "title": c.title,
                "held": c.passed,
                "statistics": [_statistic(one) for one in c.statistics],
            }
            for c in validation.controls
        ],
        "pairs": [
            {"kind": p.kind, "label": p.label, "low_dn": p.low_dn, "high_dn": p.high_dn} for p in validation.pairs
        ],
    }


def save(validation: Validation, folder: str | Path) -> Path:
    """Write a validation to a session's folder; return the JSON file."""
    folder = Path(folder)
    arrays = {}
    for index, pair in enumerate(validation.pairs):
        arrays[f"measured-{index}"], arrays[f"simulated-{index}"] = pair.measured, pair.simulated
    np.savez_compressed(folder / PICTURES, **arrays)
    path = folder / NUMBERS
    path.write_text(json.dumps(as_json(validation), indent=1, allow_nan=False) + "\n")
    return path


def load(folder: str | Path) -> Validation | None:
    """Return the validation stored in a session's folder, or None where there is none.

    Raises
    ------
    BadInput
        If the file is not what `save` wrote.
    """
    folder = Path(folder)
    if not (folder / NUMBERS).is_file():
        return None
    try:
        stored = json.loads((folder / NUMBERS).read_text())
        with np.load(folder / PICTURES) as arrays:
            pairs = tuple(
                FramePair(**pair, measured=arrays[f"measured-{i}"], simulated=arrays[f"simulated-{i}"])
                for i, pair in enumerate(stored["pairs"])
            )
        return Validation(
            session=stored["session"], sensor=stored["sensor"], seed=stored["seed"], draws=stored["draws"],
            seconds=stored["seconds"], statistics=_statistics(stored["statistics"]),
            controls=tuple(
                ValidationControl(name=c["name"], title=c["title"], statistics=_statistics(c["statistics"]))
                for c in stored["controls"]
            ),
            overlays=stored["overlays"], pairs=pairs, notes=tuple(stored["notes"]),
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{folder / NUMBERS} must be a validation kept by charact, got {error}") from error


def _statistic(one: Statistic) -> dict[str, Any]:
    return {**asdict(one), "passed": one.passed}


def _statistics(stored: list[dict[str, Any]]) -> tuple[Statistic, ...]:
    lists = {"labels", "measured", "low95", "high95"}
    out = []
    for one in stored:
        fields: dict[str, Any] = {key: tuple(value) if key in lists else value for key, value in one.items()}
        fields.pop("passed")
        out.append(Statistic(**fields))
    return tuple(out)
