"""What a session is to be enough for: the quantities of a purpose, the precision with which they
decide, the frames that they need, and the answer.

A session is fit for a purpose only if each quantity of it has a value that is ok and precise
enough, from frames that can show it: a photon transfer curve of one level is a point, and the MTF
of a target out of focus is that of the focus.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil, inf
from typing import Any, Literal

from charact.verdict import SETTLES
from charact.verdict.thresholds import (
    EMVA_LEVELS,
    LARGEST_PERCENT,
    LEAST_MTF50_CY_PER_PX,
    LEAST_TURN_DEG,
    LEVELS,
    PATTERN_FRAMES,
)
from labdata.camera.description import has_tube
from labdata.conditions import GAINS
from labdata.flags import FLAGS
from labdata.measurement import Measurement, Result, Status
from labdata.session import Session

Answer = Literal["fit", "not fit", "not enough", "undecided"]
#: From the gravest on, with the words before the title of a purpose
WORDS: dict[Answer, str] = {
    "not fit": "Not fit for",
    "not enough": "Not enough for",
    "undecided": "Undecided for",
    "fit": "Fit for",
}
#: Marks of a verdict by its status
MARKS = {"ok": "✓", "suspect": "▲", "refused": "✕"}
FLATS = f"flats of one gain setting at {LEVELS} levels or more below saturation"
SHEET_FLATS = (
    f"flats of one gain setting and known photons_per_px at {EMVA_LEVELS} levels or more up to "
    "saturation"
)
DARKS = "darks of the flats' settings"
MANY_DARKS = f"darks of {PATTERN_FRAMES} frames or more"
EDGE = "a slanted edge in focus"
TURNED_EDGE = "a slanted edge in focus, turned by 90 degrees"
DARK_FLAGS = {"no-darks", "dark-mismatch"}  # other darks settle them, and what follows from them


@dataclass(frozen=True, kw_only=True)
class Need:
    """A quantity of a purpose, the frames from which it is measured and how well it decides."""

    quantity: str
    frames: tuple[str, ...]
    levels: int = 0  #: Least number of levels of the flats of one gain setting
    least: float = 0.0  #: Value below which the frames do not show what the quantity is
    #: Whether a camera below `least`, or without the quantity, is not fit: no frames change it
    is_limit: bool = False
    is_of_both_axes: bool = False  #: Whether rows and columns decide, each by its own targets

    @property
    def percent(self) -> float:
        """Largest half-width of the 95 % interval that decides, percent of the value."""
        return LARGEST_PERCENT[self.quantity]


@dataclass(frozen=True, kw_only=True)
class Shortfall:
    """Why a quantity does not let a session be fit, and the frames to add."""

    answer: Answer
    why: str  #: Quantity, and why the frames of the session are not enough
    frames: tuple[str, ...] = ()  #: Frames to add


@dataclass(frozen=True, kw_only=True)
class Decision:
    """Answer to whether a session is enough for a purpose."""

    purpose: str  #: Name of the purpose, or of a file of limits
    title: str  #: What it is, as in "Fit for a detector"
    answer: Answer
    because: tuple[str, ...] = ()  #: Reasons, that of the answer first
    missing: tuple[Shortfall, ...] = ()  #: What lacks, each with `frames` to add and `why`
    is_usable: bool = True  #: Whether any quantity of the purpose can be used

    @property
    def heading(self) -> str:
        """The answer in one sentence: what decided it, or the frames to add."""
        decisive = [
            frames
            for shortfall in self.missing
            if self.answer == "not enough" or shortfall.why == self.because[0]
            for frames in shortfall.frames
        ]
        add = f"add {'; '.join(dict.fromkeys(decisive))}" if decisive else ""
        parts = (add,) if self.answer == "not enough" and add else (*self.because[:1], add)
        return f"{WORDS[self.answer]} {self.title}: {'; '.join(filter(None, parts))}"

    @property
    def status(self) -> Status:
        """The colour of the answer: ok if fit, refused if not fit or nothing is of use."""
        if self.answer == "fit":
            return "ok"
        return "refused" if self.answer == "not fit" or not self.is_usable else "suspect"

    @property
    def line(self) -> str:
        """The heading with its mark."""
        return f"{MARKS[self.status]} {self.heading}"

    def as_json(self) -> dict[str, Any]:
        """Return the answer as the JSON object of a measuring verb."""
        return {
            "purpose": self.purpose,
            "answer": self.answer,
            "because": list(self.because),
            "missing": [
                {"frames": frames, "why": lack.why}
                for lack in self.missing
                for frames in lack.frames
            ],
        }


def decision(
    name: str, title: str, shortfalls: Sequence[Shortfall], *, decided: str, is_usable: bool
) -> Decision:
    """Return the answer to which shortfalls lead: that of the gravest; without one what decided."""
    ordered = sorted(shortfalls, key=lambda shortfall: list(WORDS).index(shortfall.answer))
    return Decision(
        purpose=name,
        title=title,
        answer=ordered[0].answer if ordered else "fit",
        because=tuple(dict.fromkeys(shortfall.why for shortfall in ordered)) or (decided,),
        missing=tuple(shortfall for shortfall in ordered if shortfall.frames),
        is_usable=is_usable,
    )


@dataclass(frozen=True, kw_only=True)
class Purpose:
    """What measurements are to decide."""

    name: str
    title: str  #: What it is, as in "enough for a detector"
    needs: tuple[Need, ...]
    also: tuple[str, ...] = ()  #: Quantities that must be ok where they are measured

    def decide(self, session: Session, result: Result) -> Decision:
        """Return whether a session and its measurements are enough."""
        by_quantity = {need.quantity: _shortfall(session, result, need) for need in self.needs}
        shortfalls = [shortfall for shortfall in by_quantity.values() if shortfall is not None]
        for quantity in self.also:
            measured = leading_of(m for m in result.find(quantity) if m.value is not None)
            if measured is not None and measured.status != "ok":
                shortfalls.append(Shortfall(answer="undecided", why=_doubt(measured)))
        decided = [f"{need.quantity} within {need.percent:g} %" for need in self.needs]
        return decision(
            self.name,
            self.title,
            shortfalls,
            decided=", ".join(decided),
            is_usable=any(shortfall is None for shortfall in by_quantity.values()),
        )


SHARPNESS = Need(quantity="mtf50", frames=(EDGE,), least=LEAST_MTF50_CY_PER_PX)
PURPOSES = {
    purpose.name: purpose
    for purpose in (
        Purpose(
            name="emva1288",
            title="a data sheet of EMVA 1288",
            needs=tuple(
                Need(
                    quantity=name,
                    frames=frames,
                    levels=EMVA_LEVELS * (SHEET_FLATS in frames),
                    is_limit=name == "system_gain",
                )
                for name, frames in (
                    ("system_gain", (SHEET_FLATS, DARKS)),
                    ("quantum_efficiency", (SHEET_FLATS, DARKS)),
                    ("saturation_capacity", (SHEET_FLATS, DARKS)),
                    ("dsnu", (MANY_DARKS,)),
                    ("prnu", (f"{MANY_DARKS} and of a flat at half of saturation",)),
                )
            ),
            also=("read_noise", "linearity_error", "dark_current", "snr_max", "dynamic_range"),
        ),
        Purpose(
            name="tube",
            title="an image intensifier",
            needs=(
                Need(quantity="covariance_gain", frames=(FLATS, DARKS), levels=LEVELS),
                SHARPNESS,
            ),
            also=(
                "limiting_resolution",
                "tube_snr",
                "figure_of_merit",
                "ebi",
                "photoelectron_gain",
                "excess_noise_factor",
                "halo_diameter",
                "halo_fraction",
            ),
        ),
        Purpose(
            name="focus",
            title="the sharpness of a camera",
            needs=(
                Need(
                    quantity="mtf50",
                    frames=(EDGE, TURNED_EDGE),
                    least=LEAST_MTF50_CY_PER_PX,
                    is_limit=True,
                    is_of_both_axes=True,
                ),
            ),
        ),
        Purpose(
            name="detector",
            title="a detector",
            needs=(
                Need(quantity="system_gain", frames=(FLATS, DARKS), levels=LEVELS, is_limit=True),
                Need(quantity="read_noise", frames=(DARKS,)),
                SHARPNESS,
            ),
            also=(
                "quantum_efficiency",
                "snr_max",
                "saturation_capacity",
                "dynamic_range",
                "linearity_error",
                "dark_current",
                "dsnu",
                "prnu",
            ),
        ),
        Purpose(
            name="halo",
            title="halo and blooming",
            needs=(
                Need(
                    quantity="bloom_diameter",
                    frames=("a point source at rising levels up to saturation, with darks",),
                ),
            ),
            also=("halo_diameter", "halo_fraction", "streak_length"),
        ),
        Purpose(
            name="infrared",
            title="an infrared camera",
            needs=(
                Need(quantity="netd", frames=("flats of a black body at two temperatures",)),
                SHARPNESS,
            ),
            also=("sitf", "mrtd"),
        ),
    )
}
#: Frames from which a quantity is measured
FRAMES_OF = {need.quantity: need.frames for purpose in PURPOSES.values() for need in purpose.needs}


def is_tube(session: Session, result: Result) -> bool:
    """Return whether the camera is an image intensifier: it is described as one, or its noise is
    correlated.
    """
    if has_tube(session.camera):
        return True
    gains = [
        m
        for m in result.find("system_gain")
        if m.value is not None and "correlated-noise" not in m.flags
    ]
    return not gains and any(m.value is not None for m in result.find("covariance_gain"))


def purpose_of(session: Session, result: Result) -> Purpose:
    """Return the purpose that the frames of a session show: that of its flats, else of its
    targets.
    """
    kinds = {entry.kind for entry in session.stacks}
    photons_known = any(e.conditions.photons_per_px is not None for e in session.of_kind("flat"))
    has_black_body = any(e.conditions.blackbody_c is not None for e in session.stacks)
    if has_black_body or (session.camera is not None and session.camera.is_thermal):
        name = "infrared"
    elif "flat" not in kinds and kinds & {"edge", "bars"}:
        name = "focus"
    elif "flat" not in kinds and "point" in kinds:
        name = "halo"
    elif is_tube(session, result):
        name = "tube"
    elif photons_known and not kinds & {"edge", "bars", "point"}:
        name = "emva1288"
    else:
        name = "detector"
    return PURPOSES[name]


def leading_of(measurements: Iterable[Measurement]) -> Measurement | None:
    """Return the measurement that stands for several of one quantity and unit: the first suspect
    one where most are suspect, else the first ok one; None of none.
    """
    several = list(measurements)
    doubtful = 2 * sum(m.status != "ok" for m in several) > len(several)
    return min(several, key=lambda m: (m.status == "ok") == doubtful, default=None)


def _shortfall(session: Session, result: Result, need: Need) -> Shortfall | None:
    """Return why a quantity does not decide; None if it does."""
    measured = result.find(need.quantity)
    valued = [m for m in measured if m.value is not None]
    has_darks = bool(session.of_kind("dark"))
    frames = tuple(words for words in need.frames if not (has_darks and words == DARKS))
    lacking = frames or need.frames
    flats = Counter(
        tuple(getattr(entry.conditions, name) for name in GAINS)
        for entry in session.of_kind("flat")
    )
    if not valued:
        of_flats = result.find("covariance_gain") if need.levels else ()
        reasons = (m.reason for m in (*measured, *of_flats) if m.reason)
        why = f"{need.quantity}: {next(reasons, 'not measured')}"
        if need.is_limit and any(m.refusal == "not-applicable" for m in measured):
            return Shortfall(answer="not fit", why=why)
        return Shortfall(answer="not enough", why=why, frames=lacking)
    if (levels := max(flats.values(), default=0)) < need.levels:
        why = f"{need.quantity}: flats of one gain setting at {levels} level{'s' * (levels != 1)}"
        return Shortfall(answer="not enough", why=why, frames=lacking)
    leading = leading_of(m for m in valued if m.unit == valued[0].unit)
    assert leading is not None
    if leading.status != "ok":
        remedies = [_settles(leading, flag) for flag in leading.flags]
        frames = tuple(f"{lacking[0]} ({words})" if words else lacking[0] for words in remedies)
        if DARK_FLAGS & set(leading.flags):
            frames = (DARKS,)
        why = _doubt(leading).partition(SETTLES)[0]
        return Shortfall(answer="not enough", why=why, frames=frames)
    ok = [m for m in valued if m.unit == leading.unit and m.status == "ok"]
    checks = (
        _contradicted(result, need),
        _blurred(session, ok, need),
        _of_one_axis(ok, need),
        _imprecise(ok, need, lacking[0]),
    )
    return next((shortfall for shortfall in checks if shortfall is not None), None)


def _contradicted(result: Result, need: Need) -> Shortfall | None:
    """Return that the targets of a session have unlike MTFs."""
    agreement = result.evidence.get("agreement of targets", {})
    if need.quantity != "mtf50" or agreement.get("inside_joint_95_percent_region", True):
        return None
    why = "mtf50: the MTFs of the targets contradict each other (figure Agreement of targets)"
    return Shortfall(answer="undecided", why=why)


def _of_one_axis(ok: list[Measurement], need: Need) -> Shortfall | None:
    """Return that targets show the sharpness along rows alone, or along columns alone."""
    angles = [m.orientation_deg for m in ok if m.orientation_deg is not None]
    turns = [abs((angle - angles[0] + 90.0) % 180.0 - 90.0) for angle in angles]
    if not need.is_of_both_axes or max(turns, default=0.0) >= LEAST_TURN_DEG:
        return None
    why = f"{need.quantity} is that of one direction: a lens or a motion may blur the other"
    return Shortfall(answer="not enough", why=why, frames=(TURNED_EDGE,))


def _blurred(session: Session, ok: list[Measurement], need: Need) -> Shortfall | None:
    """Return that every target is out of focus, or moved, by the interval of the sharpest."""
    if not need.least or has_tube(session.camera):
        return None
    sharpest = max(ok, key=lambda m: m.value or 0.0)
    low, high = sharpest.interval95 or (sharpest.value or 0.0,) * 2
    if low >= need.least:
        return None
    percent = 100.0 * (1.0 - (sharpest.value or 0.0) / need.least)
    size = f"{percent:.0f} % below" if high < need.least else "not surely above"
    why = (
        f"{need.quantity} of {sharpest.value:.2g} cy/px is {size} the {need.least:g} of a target "
        "in focus that stands still"
    )
    is_decided = need.is_limit and high < need.least
    return Shortfall(answer="not fit" if is_decided else "not enough", why=why, frames=need.frames)


def _imprecise(ok: list[Measurement], need: Need, frames: str) -> Shortfall | None:
    """Return that every interval is too wide to decide, and how many times the frames narrow it."""
    halves = [
        50.0 * (m.interval95[1] - m.interval95[0]) / abs(m.value)
        for m in ok
        if m.value and m.interval95 is not None
    ]
    percent = min(halves, default=inf)
    if percent <= need.percent:
        return None
    times = ceil((percent / need.percent) ** 2) if halves else 2
    known = f"known to {percent:.2g} %" if halves else "known without an interval"
    why = f"{need.quantity} is {known}, and at most {need.percent:g} % decide"
    more = f"{frames} ({times} times as many frames)"
    return Shortfall(answer="not enough", why=why, frames=(more,))


def _doubt(m: Measurement) -> str:
    """Return why a measurement is suspect: quantity, flags, what was seen and what settles it."""
    findings = [note.partition(": ")[2] for note in m.notes if note.partition(":")[0] in m.flags]
    seen = findings[0] if findings else FLAGS[m.flags[0]]
    return f"{m.quantity} is suspect ({', '.join(m.flags)}): {seen}"


def _settles(m: Measurement, flag: str) -> str:
    """Return what settles the finding of a flag, as its note says; empty without one."""
    notes = (note for note in m.notes if note.startswith(f"{flag}: "))
    return next((note.partition(SETTLES)[2] for note in notes), "")
