"""The one door to the MTF methods: choose one, check what was asked, hand over."""

from dataclasses import replace
from typing import Any

from charact.method import Context, Method, choose
from charact.method.registry import beyond_note
from charact.mtf.duplicate_frames import drop_duplicate_frames
from charact.mtf.region import Region
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Result
from labdata.session import Session

# The chart's cases have one blur each. A described camera is a cascade of stages, some known within a range only. On
# edges of 38 simulated specimens MTF10 by forms alone was off by 1.6 standard errors (rms), by departures from a form
# and a video whose bandwidth is found by 0.7. Points by forms have not been held against specimens.
FOR_DESCRIBED_CAMERAS = {"edge": "edge-forward", "point": "point-forward"}
# What `auto` takes where the data reject every form of its first method.
WITHOUT_MODEL = {"edge-parametric": "edge-free"}


def measure(
    kind: str,
    stack: FrameStack,
    *,
    region: Region | None = None,
    method: str = "auto",
    within_percent: float = 2.0,
    context: Context,
    **target: Any,
) -> Result:
    """Measure the MTF of one target.

    Parameters
    ----------
    kind
        "edge", "bars" or "point".
    stack
        Frames of the target.
    region
        ROW, COL, HEIGHT, WIDTH in px; None: the target is looked for in the whole frame.
    method
        Name of a registered method, or "auto".
    within_percent
        Tolerance that "auto" must meet, percent; a note says so where a number's own interval reaches further.
    context
        Seed, speed and camera.
    target
        For bars, if known, `bars`, their number, and `frequency_cy_per_px`; for a point, if known, its diameter
        `pinhole_px` in column pitches.

    Raises
    ------
    BadInput
        If the kind or method is unknown, the region leaves the image, or what is stated of bars cannot be.
    """
    if kind not in ("edge", "bars", "point"):
        raise BadInput(f"a target must be an edge, bars or a point, got {kind!r}")
    if region is not None:
        region = tuple(int(number) for number in region)  # type: ignore[assignment]
        stack.region(*region)  # type: ignore[misc]
    if kind == "bars":
        _require_valid_bars(**target)
    described = FOR_DESCRIBED_CAMERAS.get(kind) if method == "auto" and context.sensor is not None else None
    chosen = choose(kind, described or method, within_percent=within_percent)
    counted = drop_duplicate_frames(stack)
    first = chosen.function(counted, region=region, context=context, **target)
    if method == "auto" and chosen.name in WITHOUT_MODEL and _is_model_rejected(first, chosen):
        chosen = choose(kind, WITHOUT_MODEL[chosen.name])
        without = chosen.function(counted, region=region, context=context, **target)
        first = _note_without_model(without) if without.find(chosen.quantities[0]) else first
    found = _with_notes(first, counted, stack)
    if method == "auto":
        found = _note_tolerance(found, chosen, within_percent)
    return found if stack.plane == "mono" else _record_plane(found, stack.plane)


def _is_model_rejected(found: Result, chosen: Method) -> bool:
    """Tell whether the data reject the form that a method fitted."""
    return any("model-misfit" in one.flags for one in found.find(chosen.quantities[0]))


def _note_without_model(found: Result) -> Result:
    note = "No form of the point spread describes this edge: it was measured without one, by a wider interval."
    return replace(found, measurements=tuple(one.with_(notes=(*one.notes, note)) for one in found.measurements))


def measure_flats(session: Session, *, method: str = "auto", within_percent: float = 2.0, context: Context) -> Result:
    """Measure the MTF after the gain from the flats of a session.

    Parameters
    ----------
    session
        Session with at least one flat stack; darks make it surer.
    method, within_percent
        Name of a registered method of the kind "post-gain", or "auto" and its tolerance, percent.
    context
        Seed, speed and camera.

    Raises
    ------
    BadInput
        If there is no flat, the method is unknown or the images are too small.
    """
    chosen = choose("post-gain", method, within_percent=within_percent)
    if not session.of_kind("flat"):
        raise BadInput(f"a noise spectrum needs flat stacks, got only {sorted({s.kind for s in session.stacks})}")
    return chosen.function(session, context=context)


def _with_notes(found: Result, counted: FrameStack, given: FrameStack) -> Result:
    """Return a result that tells what frames did not count, whether or not its method passes a stack's notes on."""
    notes = counted.notes[len(given.notes) :]

    def add_notes(one: Measurement) -> Measurement:
        return one.with_(notes=(*one.notes, *(note for note in notes if note not in one.notes)))

    return replace(found, measurements=tuple(add_notes(one) for one in found.measurements)) if notes else found


def _note_tolerance(found: Result, chosen: Method, within_percent: float) -> Result:
    """Return a result whose numbers of the charted quantity say where the tolerance asked for may not be met."""

    def note_one(one: Measurement) -> Measurement:
        if one.quantity != chosen.quantities[0] or one.status == "refused":
            return one
        note = beyond_note(one, within_percent)
        return one if note is None else one.with_(notes=(*one.notes, note))

    return replace(found, measurements=tuple(note_one(one) for one in found.measurements))


def _record_plane(found: Result, plane: str) -> Result:
    """Return a result whose provenance says which colour plane was measured."""
    told = (
        m
        if m.provenance is None
        else m.with_(provenance=replace(m.provenance, settings={**m.provenance.settings, "plane": plane}))
        for m in found.measurements
    )
    return replace(found, measurements=tuple(told))


def _require_valid_bars(bars: Any = None, frequency_cy_per_px: Any = None) -> None:
    if bars is not None and int(bars) < 2:
        raise BadInput(f"a bar target must have at least 2 bars, got {bars}")
    if frequency_cy_per_px is not None and not 0 < float(frequency_cy_per_px) <= 1:
        raise BadInput(f"the frequency of bars must lie in (0, 1] cycles per pixel, got {frequency_cy_per_px}")
