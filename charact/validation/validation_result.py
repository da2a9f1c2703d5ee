"""Result of a validation: statistics, controls, overlays and frame pairs, stored as JSON and
arrays.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from charact.validation.likely_causes import LikelyCause
from charact.validation.statistic import Agreement, Statistic
from charact.verdict import Finding
from labdata.errors import BadInput
from labdata.frames import read_only
from labdata.short_repr import short_repr

# "agrees": within all tolerances; "differs": beyond one; "undecided": the fit or a control is in
# doubt, or a tolerance could not have been seen.
Verdict = Literal["agrees", "differs", "undecided"]
NUMBERS, PICTURES = "validation.json", "validation.npz"


@dataclass(frozen=True, kw_only=True)
class ValidationControl:
    """The same statistics on frames with a known outcome.

    "null": frames of the fitted camera itself, or one half of the measured frames against the
    other, none of which may differ beyond its tolerance; "negative": with one parameter changed or
    a fault put in, which chance must not explain.
    """

    name: Literal["null", "negative"]
    title: str
    statistics: tuple[Statistic, ...]

    @property
    def noticed_by(self) -> tuple[str, ...]:
        """Names of the statistics that differ; without tolerances those that fail."""
        return tuple(s.name for s in self.statistics if s.verdict == "differs")

    @property
    def passed(self) -> bool:
        """Whether the control came out as it must."""
        return (not self.noticed_by) == (self.name == "null")


@dataclass(frozen=True, kw_only=True)
class FramePair:
    """Measured and simulated image of a stack, shape (row, col), uint8, and the grey values of
    black and white, DN.

    `role`: what the stack is among those compared, such as "dim flat"; `kind`, `label`: as in the
    session; `frames`: number of frames compared.
    """

    role: str
    kind: str
    label: str
    measured: NDArray[np.uint8]
    simulated: NDArray[np.uint8]
    low_dn: float
    high_dn: float
    frames: int

    def __post_init__(self) -> None:
        for name in ("measured", "simulated"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclass(frozen=True, kw_only=True)
class ResidualMap:
    """Measured mean frame less that of the simulated sets.

    `difference_dn`: means of squares of `block_px`, DN, shape (row, col); `sd_dn`: standard
    deviation of one block by the spread of the simulated sets, DN.
    """

    role: str
    label: str
    block_px: int
    difference_dn: NDArray[np.float32]
    sd_dn: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "difference_dn", read_only(self.difference_dn))


@dataclass(frozen=True, kw_only=True)
class ValidationFigures:
    """Curves and pictures of a validation.

    Parameters
    ----------
    overlays
        Curves by name, JSON-ready mappings: "photon-transfer", "covariance", "autocorrelation",
        "mtf", "noise-spectrum-horizontal", "noise-spectrum-vertical", "histogram-dark",
        "histogram-flat", "point". Each has "title", "x_title", "y_title", "y_scale" unless it is
        linear, and "curves", each with "name", "x", "measured", "simulated", "low95" and "high95".
    pairs
        First frame of each stack that is shown.
    blind
        Frame of a stack by chance, for a reader to identify the measured one.
    patterns, residuals
        Fixed patterns and residuals of dark, dim and bright flat.
    """

    overlays: dict[str, dict[str, Any]] = field(default_factory=dict)
    pairs: tuple[FramePair, ...] = ()
    blind: tuple[FramePair, ...] = ()
    patterns: tuple[FramePair, ...] = ()
    residuals: tuple[ResidualMap, ...] = ()


@dataclass(frozen=True, kw_only=True)
class DetectableError:
    """Error of a parameter that the validation would have found.

    `title`: the parameter; `relative_error`: size found with the stated probability, NaN where none
    below 100 % is; `statistic`: the one that finds it.
    """

    title: str
    relative_error: float
    probability: float
    statistic: str

    @property
    def percent(self) -> str:
        """Error in percent with two digits."""
        percent = 100.0 * self.relative_error
        return f"{percent:.2g} %" if percent < 99.5 else f"{percent:.0f} %"


@dataclass(frozen=True, kw_only=True)
class Validation:
    """Comparison of a session with its simulation.

    Parameters
    ----------
    session, sensor
        Names of the session and of the simulated sensor.
    seed, draws, seconds
        Seed, number of posterior draws simulated and time taken, s.
    statistics, controls
        Measured against simulated, and null and negative controls under the same statistics.
    power
        Errors of parameters that would have been found.
    causes
        Named changes that explain most of the deviations, the likeliest first.
    figures, notes
        Curves and pictures, and notes for the reader.
    same_session
        Whether the camera was fitted to frames of this session, so that its fitted numbers agree by
        construction.
    converged
        Whether the posterior of the camera converged.
    """

    session: str
    sensor: str
    seed: int
    draws: int
    seconds: float
    statistics: tuple[Statistic, ...]
    controls: tuple[ValidationControl, ...]
    power: tuple[DetectableError, ...] = ()
    causes: tuple[LikelyCause, ...] = ()
    figures: ValidationFigures = field(default_factory=ValidationFigures)
    notes: tuple[str, ...] = ()
    same_session: bool = False
    converged: bool = True

    __repr__ = short_repr

    @property
    def origin(self) -> str:
        """Sentence on what the camera was fitted to."""
        if not self.same_session:
            return f"the camera, {self.sensor}, was not fitted to frames of this session"
        return (
            "the camera was fitted to frames of this session: its fitted numbers agree by "
            "construction; a second session, validated with this camera, tests them"
        )

    @property
    def pairs(self) -> tuple[FramePair, ...]:
        """First frame of each stack that is shown, measured and simulated."""
        return self.figures.pairs

    @property
    def likely_causes(self) -> tuple[Finding, ...]:
        """Faults of camera or session that the failing statistics show, the likeliest first."""
        return tuple(cause.finding for cause in self.causes)

    def of(self, verdict: Agreement) -> tuple[Statistic, ...]:
        """Return the statistics with a verdict, the largest departure over its tolerance first."""
        chosen = [statistic for statistic in self.statistics if statistic.verdict == verdict]
        return tuple(sorted(chosen, key=lambda statistic: -statistic.excess))

    @property
    def failed_nulls(self) -> tuple[ValidationControl, ...]:
        """Null controls that failed."""
        return tuple(c for c in self.controls if c.name == "null" and not c.passed)

    @property
    def noticed(self) -> bool:
        """Whether any negative control was noticed.

        One that was not is no failure: it is an effect that this validation cannot detect.
        """
        return any(c.passed for c in self.controls if c.name == "negative")

    @property
    def passed(self) -> bool:
        """Whether no statistic differs beyond its tolerance, and the controls came out as they must
        for a fit that converged.
        """
        sound = self.converged and self.noticed and not self.failed_nulls
        return sound and not self.of("differs")

    @property
    def verdict(self) -> Verdict:
        """What the validation says of the fitted camera."""
        if self.of("differs"):
            return "differs"
        return "agrees" if self.passed and not self.of("unseen") else "undecided"


def as_json(validation: Validation) -> dict[str, Any]:
    """Return all but the images as JSON-ready mappings."""

    def plain(statistics: Iterable[Statistic]) -> list[dict[str, Any]]:
        return [
            {**asdict(statistic), "passed": statistic.passed, "verdict": statistic.verdict}
            for statistic in statistics
        ]

    return {
        **vars(validation),
        "passed": validation.passed,
        "verdict": validation.verdict,
        "causes": [asdict(cause) for cause in validation.causes],
        "likely_causes": [asdict(cause) for cause in validation.likely_causes],
        "notes": list(validation.notes),
        "statistics": plain(validation.statistics),
        "power": [
            {
                **asdict(error),
                "relative_error": error.relative_error
                if np.isfinite(error.relative_error)
                else None,
            }
            for error in validation.power
        ],
        "controls": [
            {
                "name": c.name,
                "title": c.title,
                "held": c.passed,
                "noticed_by": list(c.noticed_by),
                "statistics": plain(c.statistics),
            }
            for c in validation.controls
        ],
        "figures": {
            "overlays": validation.figures.overlays,
            **{
                name: [_split(picture)[0] for picture in getattr(validation.figures, name)]
                for name in _PICTURES
            },
        },
    }


# Pictures of the figures by name.
_PICTURES: dict[str, Callable[..., Any]] = {
    "pairs": FramePair,
    "blind": FramePair,
    "patterns": FramePair,
    "residuals": ResidualMap,
}


def _split(picture: FramePair | ResidualMap) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Return the plain fields of a picture and its arrays, by name."""
    arrays = {name: value for name, value in vars(picture).items() if isinstance(value, np.ndarray)}
    return {name: value for name, value in vars(picture).items() if name not in arrays}, arrays


def save(validation: Validation, folder: str | Path) -> Path:
    """Write a validation to a session's folder; return the JSON file."""
    folder = Path(folder)
    images = {
        f"{name}-{number}-{key}": image
        for name in _PICTURES
        for number, picture in enumerate(getattr(validation.figures, name))
        for key, image in _split(picture)[1].items()
    }
    np.savez_compressed(folder / PICTURES, allow_pickle=False, **images)
    path = folder / NUMBERS
    path.write_text(json.dumps(as_json(validation), indent=1, allow_nan=False) + "\n")
    return path


def load(folder: str | Path) -> Validation | None:
    """Return the validation stored in a session's folder, or None.

    Raises
    ------
    BadInput
        If the file was not written by `save`.
    """
    folder = Path(folder)
    if not (folder / NUMBERS).is_file():
        return None
    try:
        stored = json.loads((folder / NUMBERS).read_text())
        with np.load(folder / PICTURES) as arrays:
            figures = _figures(stored["figures"], dict(arrays))
        controls = tuple(
            ValidationControl(
                name=c["name"], title=c["title"], statistics=_statistics(c["statistics"])
            )
            for c in stored["controls"]
        )
        scalars = {name: stored[name] for name in ("session", "sensor", "seed", "draws", "seconds")}
        statistics, notes = _statistics(stored["statistics"]), tuple(stored["notes"])
        power = tuple(
            DetectableError(
                **{
                    **fields,
                    "relative_error": float("nan")
                    if fields["relative_error"] is None
                    else fields["relative_error"],
                }
            )
            for fields in stored["power"]
        )
        return Validation(
            **scalars,
            statistics=statistics,
            controls=controls,
            power=power,
            causes=tuple(LikelyCause(**cause) for cause in stored.get("causes", ())),
            figures=figures,
            notes=notes,
            same_session=stored.get("same_session", False),
            converged=stored.get("converged", True),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(
            f"{folder / NUMBERS} must be a validation kept by charact, got {error}"
        ) from error


def _figures(stored: dict[str, Any], arrays: dict[str, NDArray]) -> ValidationFigures:
    pictures = {
        name: tuple(
            make(
                **plain,
                **{
                    key.split("-", 2)[2]: image
                    for key, image in arrays.items()
                    if key.startswith(f"{name}-{number}-")
                },
            )
            for number, plain in enumerate(stored[name])
        )
        for name, make in _PICTURES.items()
    }
    return ValidationFigures(overlays=stored["overlays"], **pictures)


def _statistics(stored: list[dict[str, Any]]) -> tuple[Statistic, ...]:
    known = {entry.name for entry in fields(Statistic)}
    records: list[dict[str, Any]] = [
        {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in record.items()
            if key in known
        }
        for record in stored
    ]
    return tuple(Statistic(**record) for record in records)
