"""Limits of a specification, and the verdict of measurements on them.

A limit passes if the whole 95 % interval lies inside and fails if the whole interval lies outside;
anything else is undecided. The verdicts are saved in the session's folder.
"""

import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from charact import __version__
from charact.comparison.compare import same_frequency, turn_deg
from charact.comparison.thresholds import LIMITS
from charact.observables.size import Tolerance
from charact.verdict.purpose import FRAMES_OF, Answer, Decision, Shortfall, decision
from labdata import QUANTITIES, BadInput, sha256_of, write_atomically
from labdata.errors import check as check_numbers
from labdata.measurement import Interval, Measurement, Result, Status
from labdata.number_format import plus_minus_of, round_to_spread
from labdata.result_io import RESULTS
from labdata.session import Session
from labdata.short_repr import short_repr

CHECKED = "checked.json"
FORMAT = 1
Verdict = Literal["pass", "fail", "undecided"]
Cause = Literal["", "outside", "straddles", "suspect", "refused", "absent", "no-interval"]
#: Answer to whether a session is enough, of what keeps a limit from passing: frames settle the last
ANSWERS: dict[Cause, Answer] = {
    "outside": "not fit",
    "straddles": "undecided",
    "suspect": "undecided",
    "no-interval": "undecided",
    "refused": "not enough",
    "absent": "not enough",
}
SENTENCES: dict[str, str] = {
    "": "",
    "outside": "the whole 95 % interval lies outside",
    "straddles": "the 95 % interval contains a limit",
    "suspect": "the measurement is suspect: {detail}",
    "refused": "not measured: {detail}",
    "absent": "the session has no such measurement",
    "no-interval": "the measurement has no interval",
}


@dataclass(frozen=True, kw_only=True)
class Limit:
    """One [[limit]] of a limits file: the allowed range of a quantity, for all its measurements in
    the session.
    """

    quantity: str  #: Name of the quantity, such as mtf50
    #: Unit of the quantity and of min and max; required for a quantity with several units
    unit: str | None = None
    stack: str | None = None  #: Label of a stack; default: the whole session and every stack
    #: Frequency of an MTF value, cycles per pixel; default: all
    frequency_cy_per_px: float | None = None
    #: Direction within 10 degrees, 0 is horizontal frequency; default: all
    orientation_deg: float | None = None
    min: float | None = None  #: Smallest allowed value
    max: float | None = None  #: Largest allowed value

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            similar = difflib.get_close_matches(self.quantity, QUANTITIES, n=1)
            hint = f" (did you mean {similar[0]!r}?)" if similar else ""
            raise BadInput(
                f"quantity must be one that charact measures, got {self.quantity!r}{hint}"
            )
        units = QUANTITIES[self.quantity].units
        if self.unit not in units and (self.unit is not None or len(units) > 1):
            got = "none" if self.unit is None else repr(self.unit)
            raise BadInput(f"unit of {self.quantity} must be one of {', '.join(units)}, got {got}")
        if self.min is None and self.max is None:
            raise BadInput(f"a limit must have min or max, got neither for {self.quantity}")
        check_numbers(self, finite="min max orientation_deg", positive="frequency_cy_per_px")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise BadInput(
                f"min must not exceed max, got {self.min:g} and {self.max:g} for {self.quantity}"
            )

    def applies_to(self, m: Measurement) -> bool:
        """Return whether the limit is one of this measurement."""
        return (
            m.quantity == self.quantity
            and self.unit in (None, m.unit)
            and self.stack in (None, m.stack)
            and (
                self.frequency_cy_per_px is None
                or same_frequency(m.frequency_cy_per_px, self.frequency_cy_per_px)
            )
            and (
                self.orientation_deg is None
                or (
                    m.orientation_deg is not None
                    and turn_deg(m.orientation_deg, self.orientation_deg)
                    <= LIMITS.limit_direction_deg
                )
            )
        )


@dataclass(frozen=True, kw_only=True)
class Limits:
    """A limits file."""

    limit: tuple[Limit, ...] = ()  #: The limits
    #: Departures of a validation that do not matter, in place of those that hold by default
    tolerance: tuple[Tolerance, ...] = ()

    def __post_init__(self) -> None:
        if not self.limit and not self.tolerance:
            raise BadInput(
                "a limits file must have at least one [[limit]] or [[tolerance]], got none"
            )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Verdict of one measurement on one limit."""

    quantity: str  #: Name of the quantity
    unit: str  #: Unit of the value and of the limits
    min: float | None  #: Smallest allowed value
    max: float | None  #: Largest allowed value
    verdict: Verdict
    cause: Cause = ""  #: Cause of a verdict other than pass
    detail: str = ""  #: Flags of a suspect measurement, reason of a refused one
    value: float | None = None  #: Measured value; None if there is none
    interval95: Interval | None = None  #: 95 % interval of the value
    status: Status | None = None  #: Status of the measurement; None if there is none
    method: str | None = None  #: Method of the measurement
    stack: str | None = None  #: Label of the stack
    frequency_cy_per_px: float | None = None  #: Frequency of the value, cycles per pixel
    orientation_deg: float | None = None  #: Direction, degrees
    amplifier: int | None = None  #: Number of the amplifier; None: the chip

    @property
    def reason(self) -> str:
        """Return why the limit does not pass, in words; empty for a pass."""
        return SENTENCES[self.cause].format(detail=self.detail)


@dataclass(frozen=True, kw_only=True)
class LimitCheck:
    """Verdicts of a session on the limits of a file."""

    outcomes: tuple[
        Outcome, ...
    ]  #: One for each measurement to which a limit applies, in the order of the limits
    name: str = "limits"  #: Name of the limits file

    __repr__ = short_repr

    @property
    def verdict(self) -> Verdict:
        """Return fail if any limit fails, else undecided if any is undecided, else pass."""
        verdicts = {outcome.verdict for outcome in self.outcomes}
        return "fail" if "fail" in verdicts else "undecided" if "undecided" in verdicts else "pass"

    def of(self, verdict: Verdict) -> tuple[Outcome, ...]:
        """Return the outcomes with a verdict."""
        return tuple(outcome for outcome in self.outcomes if outcome.verdict == verdict)


def check(result: Result, limits: Limits, *, name: str = "limits") -> LimitCheck:
    """Return the verdict of every measurement on the limits that apply to it.

    Parameters
    ----------
    result
        The measurements.
    limits
        The limits, see `load_limits`.
    name
        Name of the limits file.

    Returns
    -------
    LimitCheck
        A limit of a quantity that was not measured has one undecided outcome. A refusal because the
        camera has no such quantity is disregarded where the quantity has other measurements.

    Examples
    --------
    >>> from labdata.measurement import Result, measurement_from_sd
    >>> mtf50 = measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, method="edge-forward")
    >>> result = Result(measurements=(mtf50,))
    >>> check(result, Limits(limit=(Limit(quantity="mtf50", min=0.15),))).verdict
    'pass'
    >>> check(result, Limits(limit=(Limit(quantity="mtf50", min=0.19),))).outcomes[0].reason
    'the 95 % interval contains a limit'
    """
    if not limits.limit:
        raise BadInput(f"a check must have at least one [[limit]], got none in {name}")
    return LimitCheck(
        outcomes=tuple(outcome for limit in limits.limit for outcome in _outcomes(limit, result)),
        name=name,
    )


def _outcomes(limit: Limit, result: Result) -> Iterator[Outcome]:
    measurements = [m for m in result.measurements if limit.applies_to(m)]
    applicable = [m for m in measurements if m.value is not None or m.refusal != "not-applicable"]
    for m in applicable or measurements[:1]:
        verdict, cause, detail = _judge(limit, m)
        yield Outcome(
            quantity=m.quantity,
            unit=m.unit,
            min=limit.min,
            max=limit.max,
            verdict=verdict,
            cause=cause,
            detail=detail,
            value=m.value,
            interval95=m.interval95,
            status=m.status,
            method=m.method,
            stack=m.stack,
            frequency_cy_per_px=m.frequency_cy_per_px,
            orientation_deg=m.orientation_deg,
            amplifier=m.amplifier,
        )
    if not measurements:
        yield Outcome(
            quantity=limit.quantity,
            unit=limit.unit or QUANTITIES[limit.quantity].units[0],
            min=limit.min,
            max=limit.max,
            verdict="undecided",
            cause="absent",
            stack=limit.stack,
            frequency_cy_per_px=limit.frequency_cy_per_px,
            orientation_deg=limit.orientation_deg,
        )


def _judge(limit: Limit, m: Measurement) -> tuple[Verdict, Cause, str]:
    """Return verdict, its cause and detail."""
    if m.status == "refused":
        return "undecided", "refused", m.reason or ""
    if m.status == "suspect":
        return "undecided", "suspect", ", ".join(m.flags)
    if m.interval95 is None:
        return "undecided", "no-interval", ""
    low, high = m.interval95
    lowest = -float("inf") if limit.min is None else limit.min
    highest = float("inf") if limit.max is None else limit.max
    if lowest <= low and high <= highest:
        return "pass", "", ""
    return (
        ("fail", "outside", "")
        if high < lowest or low > highest
        else ("undecided", "straddles", "")
    )


def load_limits(source: str | Path | Limits | Sequence[Mapping[str, Any]]) -> Limits:
    """Return the limits of a TOML file, or of a list of mappings with the keys of its [[limit]]
    tables.

    Raises
    ------
    BadInput
        If the file is missing or no TOML, or a key or value breaks a rule.

    Examples
    --------
    >>> load_limits([{"quantity": "read_noise", "unit": "e-", "max": 3.0}]).limit[0].max
    3.0
    """
    from labdata.serialiser import from_mapping, from_toml

    if isinstance(source, Limits):
        return source
    if isinstance(source, str | Path):
        return from_toml(source, Limits)
    return from_mapping({"limit": [dict(limit) for limit in source]}, Limits, where="limits")


@dataclass(frozen=True, kw_only=True)
class Specification:
    """A limits file as the purpose of a session: its quantities decide, by its limits."""

    limits: Limits
    name: str  #: Name of the file

    def decide(self, session: Session, result: Result) -> Decision:
        """Return whether the measurements of a session lie within the limits, as `check` does."""
        outcomes = check(result, self.limits, name=self.name).outcomes
        failing = [outcome for outcome in outcomes if outcome.cause]
        return decision(
            self.name,
            f"the limits of {self.name}",
            [_shortfall(outcome) for outcome in failing],
            decided=f"all {len(outcomes)} pass" if len(outcomes) > 1 else "it passes",
            is_usable=len(failing) < len(outcomes),
        )


def _shortfall(outcome: Outcome) -> Shortfall:
    """Return why a limit does not pass, and the frames that its quantity needs if it has none."""
    assert outcome.cause
    where = f" of {outcome.stack}" if outcome.stack else ""
    unit = "" if outcome.unit == "1" else f" {outcome.unit}"
    number = size = ""
    if outcome.value is not None:
        value = round_to_spread(outcome.value)
        if outcome.interval95 is not None:
            value = plus_minus_of(outcome.value, *outcome.interval95)
        number = f" = {value}{unit}"
    bounds = [(n, b) for n, b in (("min", outcome.min), ("max", outcome.max)) if b is not None]
    if outcome.cause == "outside" and outcome.value is not None:
        size = f" by {min(abs(outcome.value - bound) for _, bound in bounds):.2g}{unit}"
    demanded = ", ".join(f"{name} {bound:g}" for name, bound in bounds)
    answer = ANSWERS[outcome.cause]
    unknown = (f"frames that show {outcome.quantity}",)
    return Shortfall(
        answer=answer,
        why=f"{outcome.quantity}{number}{where} ({demanded}): {outcome.reason}{size}",
        frames=FRAMES_OF.get(outcome.quantity, unknown) if answer == "not enough" else (),
    )


def load_specification(path: str | Path) -> Specification:
    """Return a limits file as the purpose of a session; BadInput as of `load_limits`."""
    limits = load_limits(path)
    if not limits.limit:
        raise BadInput(f"a purpose must have at least one [[limit]], got none in {path}")
    return Specification(limits=limits, name=Path(path).name)


def check_json(checked: LimitCheck) -> dict[str, Any]:
    """Return verdicts as JSON-ready mappings; of an outcome always limits, value, interval and
    status.
    """
    always = ("min", "max", "value", "interval95", "status")
    outcomes = [
        {
            name: value
            for name, value in asdict(outcome).items()
            if name in always or value not in (None, "")
        }
        | ({"reason": outcome.reason} if outcome.reason else {})
        for outcome in checked.outcomes
    ]
    return {"limits": checked.name, "verdict": checked.verdict, "outcomes": outcomes}


def save_check(checked: LimitCheck, folder: str | Path) -> Path:
    """Save the verdicts in a session's folder, with the digest of the result on which they are
    based.
    """
    folder = Path(folder)
    document = {
        "format": FORMAT,
        "charact": __version__,
        "limits": checked.name,
        "verdict": checked.verdict,
        "results_sha256": _digest(folder),
        "outcomes": [asdict(outcome) for outcome in checked.outcomes],
    }
    write_atomically(
        folder / CHECKED, (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()
    )
    return folder / CHECKED


def load_check(folder: str | Path) -> tuple[LimitCheck, bool] | None:
    """Return the verdicts saved in a session's folder, and whether its result is still the same;
    None without.

    Raises
    ------
    BadInput
        If the file cannot be read.
    """
    from labdata.serialiser import from_mapping

    path = Path(folder) / CHECKED
    if not path.is_file():
        return None
    try:
        stored = json.loads(path.read_bytes())
        if stored["format"] != FORMAT:
            raise BadInput(
                f"a saved check must have format {FORMAT}, got {stored['format']} in {path}"
            )
        outcomes = tuple(
            from_mapping(outcome, Outcome, where=CHECKED) for outcome in stored["outcomes"]
        )
        if any(outcome.unit not in QUANTITIES[outcome.quantity].units for outcome in outcomes):
            raise ValueError
        return LimitCheck(outcomes=outcomes, name=stored["limits"]), stored[
            "results_sha256"
        ] == _digest(path.parent)
    except BadInput:
        raise
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInput(
            f"a saved check must be whole and readable, got {path}; run charact check again"
        ) from None


def _digest(folder: Path) -> str | None:
    path = folder / RESULTS
    return sha256_of(path) if path.is_file() else None
