"""What a session is to be enough for: the quantities of a purpose, and the frames that they need.

A session is fit for a purpose only if each quantity of it has a value that is ok, from frames
that can show it: a photon transfer curve of one level is a point, and the MTF of a target out of
focus is that of the focus.
"""

from collections import Counter
from dataclasses import dataclass

from charact.verdict.thresholds import LEAST_MTF50_CY_PER_PX, LEVELS
from labdata.camera.description import has_tube
from labdata.conditions import GAINS
from labdata.measurement import Measurement, Result
from labdata.session import Session

FLATS = f"flats of one gain setting at {LEVELS} levels or more"
DARKS = "darks of the flats' settings"
EDGE = "a slanted edge in focus"


@dataclass(frozen=True, kw_only=True)
class Need:
    """A quantity of a purpose and the frames from which it is measured."""

    quantity: str
    frames: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Purpose:
    """What measurements are to decide."""

    name: str
    title: str  #: What it is, as in "enough for a photon transfer curve"
    needs: tuple[Need, ...]


@dataclass(frozen=True, kw_only=True)
class Lack:
    """A quantity of a purpose that the session does not support."""

    quantity: str
    frames: tuple[str, ...]  #: Frames to add
    reason: str  #: Why those of the session are not enough


SHARPNESS = Need(quantity="mtf50", frames=(EDGE,))
PURPOSES = {
    purpose.name: purpose
    for purpose in (
        Purpose(
            name="detector",
            title="a detector",
            needs=(
                Need(quantity="system_gain", frames=(FLATS, DARKS)),
                Need(quantity="read_noise", frames=(DARKS,)),
                SHARPNESS,
            ),
        ),
        Purpose(
            name="tube",
            title="an image intensifier",
            needs=(Need(quantity="covariance_gain", frames=(FLATS, DARKS)), SHARPNESS),
        ),
        Purpose(
            name="emva1288",
            title="a data sheet of EMVA 1288",
            needs=(
                Need(quantity="system_gain", frames=(FLATS, DARKS)),
                Need(quantity="quantum_efficiency", frames=(FLATS, DARKS)),
                Need(quantity="saturation_capacity", frames=("flats up to saturation",)),
                *(Need(quantity=name, frames=(FLATS, DARKS)) for name in ("dsnu", "prnu")),
            ),
        ),
        Purpose(name="focus", title="the sharpness of a camera", needs=(SHARPNESS,)),
        Purpose(
            name="halo",
            title="halo and blooming",
            needs=(
                Need(
                    quantity="bloom_diameter",
                    frames=("a point source at rising levels up to saturation, with darks",),
                ),
            ),
        ),
        Purpose(
            name="infrared",
            title="an infrared camera",
            needs=(
                Need(quantity="netd", frames=("flats of a black body at two temperatures",)),
                SHARPNESS,
            ),
        ),
    )
}


def purpose_of(session: Session, *, is_tube: bool) -> Purpose:
    """Return the purpose that the frames of a session show: that of its flats, else of its
    targets.
    """
    kinds = {entry.kind for entry in session.stacks}
    photons_known = any(e.conditions.photons_per_px is not None for e in session.of_kind("flat"))
    if session.camera is not None and session.camera.is_thermal:
        name = "infrared"
    elif "flat" not in kinds and kinds & {"edge", "bars"}:
        name = "focus"
    elif "flat" not in kinds and "point" in kinds:
        name = "halo"
    elif is_tube:
        name = "tube"
    elif photons_known and not kinds & {"edge", "bars", "point"}:
        name = "emva1288"
    else:
        name = "detector"
    return PURPOSES[name]


def lacks_of(session: Session, result: Result, purpose: Purpose) -> tuple[Lack, ...]:
    """Return the quantities of a purpose that have no value, or one from too few frames."""
    lacks = []
    for need in purpose.needs:
        measured = result.find(need.quantity)
        valued = [m for m in measured if m.value is not None]
        if not valued:
            reasons = [m.reason for m in measured if m.reason]
            reason = reasons[0] if reasons else "not measured"
        else:
            reason = _too_little(session, valued, need)
        if reason:
            has_darks = bool(session.of_kind("dark")) and len(need.frames) > 1
            frames = tuple(f for f in need.frames if not (has_darks and f == DARKS))
            lacks.append(Lack(quantity=need.quantity, frames=frames, reason=reason))
    return tuple(lacks)


def _too_little(session: Session, valued: list[Measurement], need: Need) -> str:
    """Return why frames cannot show what a quantity is of the camera; empty if they can."""
    if FLATS in need.frames:
        levels = Counter(
            tuple(getattr(entry.conditions, name) for name in GAINS)
            for entry in session.of_kind("flat")
        )
        if (number := max(levels.values(), default=0)) < LEVELS:
            return f"flats of one gain setting at {number} level{'s' * (number != 1)}"
    if need.quantity == "mtf50" and not has_tube(session.camera):
        sharpest = max(m.value or 0.0 for m in valued if m.unit == "cy/px")
        if sharpest < LEAST_MTF50_CY_PER_PX:
            return f"mtf50 {sharpest:.2g} cy/px is out of focus, or moved"
    return ""
