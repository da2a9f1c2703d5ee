"""Entry points of the MTF methods: method choice, argument checks and notes."""

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.target_detection import find_bar_groups, find_edges, find_pinholes
from charact.estimators.mtf.thresholds import ACCURACY
from charact.frames.session_layout import layout_notes, sound_session
from charact.frames.stack import Stack
from charact.method import Context, automatic, choose
from charact.method.registry import beyond_note
from charact.verdict import judge
from labdata import BadInput, FrameStack, Measurement, Result, Session, has_tube

# Default methods for a camera with a sensor description. Its stages are known within ranges, which
# the chart's cases, of one blur each, do not represent: on edges of 38 simulated cameras MTF10
# erred by 1.6 standard uncertainties (rms) with parametric models alone and by 0.7 with model
# departures and a free video bandwidth.
FOR_DESCRIBED_CAMERAS = {"edge": "edge-forward", "point": "point-forward"}
# What `auto` measures with in place of a method that fits blur models: on edges drawn by other
# programs the answer without a form is closer and holds more often, also where a form that agrees
# with it has the narrower interval.
FORM_FREE = {"edge-parametric": "edge-free"}
# Fallback of `auto` where the data reject every blur model of the first method.
WITHOUT_MODEL = {"point-parametric": "point-spread"}
NO_MODEL = "No blur model fits this {kind}; it was measured without one, with a wider interval."
# Suffix of a curve's name that states its region.
REGION_NAME = ":{},{},{},{}"
NAMES = {"edge": "edges", "bars": "groups of bars", "point": "points"}


def drop_duplicate_frames(stack: FrameStack) -> FrameStack:
    """Return a stack without frames identical to an earlier one, with a note of their number.

    Noise never produces two identical frames. Identical frames would make the noise, estimated from
    frame differences, too small.
    """
    step = max(1, stack.shape[1] // ACCURACY.compared_rows)
    alike_frames: dict[bytes, list[int]] = defaultdict(list)
    first = []
    for number, frame in enumerate(stack.data):
        before = alike_frames[frame[::step].tobytes()]
        if not any(np.array_equal(frame, stack.data[earlier]) for earlier in before):
            before.append(number)
            first.append(number)
    frames = len(stack)
    if len(first) == frames:
        return stack
    if len(first) == 1:
        note = f"All {frames} frames are identical and count as one."
    else:
        note = (
            f"{frames - len(first)} of {frames} frames are identical to an earlier one and do "
            f"not count."
        )
    stamps = {
        name: getattr(stack, name)[first]
        for name in ("time_s", "frame_number")
        if getattr(stack, name).size
    }
    return replace(stack, data=stack.data[first], notes=(*stack.notes, note), **stamps)


def measure(
    kind: str,
    stack: FrameStack,
    *,
    region: Region | None = None,
    method: str = "auto",
    within_percent: float = 2.0,
    also: str | None = None,
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
        ROW, COL, HEIGHT, WIDTH, px; None: the whole frame.
    method
        Name of a registered method, or "auto".
    within_percent
        Tolerance that "auto" must meet, percent; a note states where an interval exceeds it.
    also
        "sfr": the conventional SFR of an edge as well, with its difference.
    context
        Seed, speed and camera.
    target
        For bars, if known, their number `bars` and `frequency_cy_per_px`; for a point, if known,
        its diameter `pinhole_px` in column pitches.

    Raises
    ------
    BadInput
        If the kind or method is unknown, the region leaves the frame, or the stated bars are
        impossible.
    """
    if kind not in ("edge", "bars", "point"):
        raise BadInput(f"a target must be an edge, bars or a point, got {kind!r}")
    if region is not None:
        region = tuple(int(number) for number in region)  # type: ignore[assignment]
        stack.region(*region)  # type: ignore[misc]
    if kind == "bars":
        _require_valid_bars(**target)
    if also is not None and (kind, also) != ("edge", "sfr"):
        raise BadInput(f"`also` must be sfr, of an edge, got {also!r} of kind {kind!r}")
    described = (
        FOR_DESCRIBED_CAMERAS.get(kind) if method == "auto" and has_tube(context.camera) else None
    )
    name = described or method
    if name == "auto":
        name = automatic(kind, within_percent=within_percent)
        name = FORM_FREE.get(name, name)
    chosen = choose(kind, name)
    counted = drop_duplicate_frames(stack) if stack.shape[0] > 1 else stack
    notes = counted.notes[len(stack.notes) :]
    result = chosen.function(counted, region=region, context=context, **target)
    leading = result.find(chosen.quantities[0])
    if (
        method == "auto"
        and chosen.name in WITHOUT_MODEL
        and any("model-misfit" in measurement.flags for measurement in leading)
    ):
        chosen = choose(kind, WITHOUT_MODEL[chosen.name])
        without = chosen.function(counted, region=region, context=context, **target)
        if any(m.status == "ok" for m in without.find(chosen.quantities[0])):
            result, notes = without, (NO_MODEL.format(kind=kind), *notes)
    if also is not None:
        from charact.estimators.mtf.edge.sfr_comparison import add_sfr

        result = add_sfr(result, counted, region=region, context=context)
    findings, seen = Stack.of(counted, context).layout_findings(region)
    notes = (*notes, *seen)
    finished = []
    for measurement in result.measurements:
        measurement = judge(measurement, findings)
        added = [note for note in notes if note not in measurement.notes]
        # The tolerance holds for the charted quantity.
        charted = measurement.quantity == chosen.quantities[0] and measurement.status != "refused"
        if method == "auto" and charted and (excess := beyond_note(measurement, within_percent)):
            added.append(excess)
        changes: dict[str, Any] = {"notes": (*measurement.notes, *added)} if added else {}
        if stack.plane != "mono" and (provenance := measurement.provenance) is not None:
            settings = {**provenance.settings, "plane": stack.plane}
            changes["provenance"] = replace(provenance, settings=settings)
        finished.append(measurement.with_(**changes) if changes else measurement)
    return replace(result, measurements=tuple(finished))


def measure_flats(
    session: Session, *, method: str = "auto", within_percent: float = 2.0, context: Context
) -> Result:
    """Measure the post-gain MTF from the flats of a session.

    Parameters
    ----------
    session
        Session with at least one flat stack; dark stacks improve the precision.
    method, within_percent
        Name of a registered method of the kind "post-gain", or "auto" and its tolerance, percent.
    context
        Seed, speed and camera.

    Raises
    ------
    BadInput
        If there is no flat, the method is unknown or the frames are too small.
    """
    chosen = choose("post-gain", method, within_percent=within_percent)
    if not session.of_kind("flat"):
        raise BadInput(
            "a noise spectrum needs flat stacks, got only "
            f"{sorted({s.kind for s in session.stacks})}"
        )
    layout, session = sound_session(session)
    result, notes = chosen.function(session, context=context), layout_notes(layout)
    noted = (
        m if m.value is None else m.with_(notes=(*m.notes, *notes)) for m in result.measurements
    )
    return replace(result, measurements=tuple(noted)) if notes else result


def _require_valid_bars(bars: Any = None, frequency_cy_per_px: Any = None) -> None:
    if bars is not None and int(bars) < 2:
        raise BadInput(f"a bar target must have at least 2 bars, got {bars}")
    if frequency_cy_per_px is not None and not 0 < float(frequency_cy_per_px) <= 1:
        raise BadInput(
            f"the frequency of bars must lie in (0, 1] cycles per pixel, got {frequency_cy_per_px}"
        )


@dataclass(frozen=True, kw_only=True)
class LocatedTarget:
    """A located target: its region and the arguments for its method."""

    region: Region
    requested: dict[str, Any] = field(default_factory=dict)


def measure_all(
    kind: str,
    stack: FrameStack,
    *,
    method: str = "auto",
    within_percent: float = 2.0,
    also: str | None = None,
    max_targets: int = 24,
    context: Context,
    **target: Any,
) -> Result:
    """Find the targets of a frame and measure the MTF of each.

    Parameters
    ----------
    kind, stack, method, within_percent, also, context, target
        As for `measure`; for bars `frequency_cy_per_px` may be None: it is measured.
    max_targets
        Maximum number of targets measured; a note states how many are not. Edges and points are
        taken from all parts of the frame, the clearest of each part first; bar groups by clarity.

    Returns
    -------
    Result
        Measurements of every region in reading order. Curves carry their region, as in
        "mtf:100,200,80,60"; the curve "mtf" is the most precise one, as a note states. For bars
        "mtf" and "mtf_vertical" pass through the groups along rows and along columns, with an
        `mtf50` each and no region, where groups of two frequencies are ok. For a frame with at most
        one target the result is that of `measure`.

    Raises
    ------
    BadInput
        If `max_targets` is less than 1, or as for `measure`.
    """
    if max_targets < 1:
        raise BadInput(f"at least 1 target must be measured, got at most {max_targets}")
    arguments = {
        "method": method,
        "within_percent": within_percent,
        "also": also,
        "context": context,
    }
    if kind == "bars" and target.get("frequency_cy_per_px") is not None:
        return measure(kind, stack, **arguments, **target)
    located = targets(kind, stack, context, **target)
    if len(located) < (1 if kind == "bars" else 2):
        return measure(kind, stack, **arguments, **target)
    best_first = (
        located if kind == "bars" else spread_over_frame(located, stack.shape[1:], max_targets)
    )
    chosen = sorted(best_first[:max_targets], key=lambda chosen_target: chosen_target.region[:2])
    results = []
    for done, chosen_target in enumerate(chosen):
        context.progress(f"{kind} in {chosen_target.region}", done / len(chosen))
        results.append(
            measure(
                kind,
                stack,
                region=chosen_target.region,
                **arguments,
                **{**target, **chosen_target.requested},
            )
        )
    together = _merge_results(results, chosen, len(located) - len(chosen), kind)
    if kind != "bars":
        return together
    from charact.estimators.mtf.bars.group_curve import frame_curves

    return together + frame_curves(together, context=context)


def targets(kind: str, stack: FrameStack, context: Context, **target: Any) -> list[LocatedTarget]:
    """Return the targets of a kind in a frame, the clearest first."""
    if kind == "edge":
        return [LocatedTarget(region=edge.region) for edge in find_edges(stack)]
    if kind == "point":
        full_scale_dn = Stack.of(stack, context).ceiling_dn
        return [
            LocatedTarget(region=point.region)
            for point in find_pinholes(stack, full_scale_dn=full_scale_dn)
        ]
    if kind == "bars":
        ratio = {0.0: 1.0, 90.0: context.pitch_ratio}
        return [
            # The detector counts cycles per sample, the methods cycles per column pitch.
            LocatedTarget(
                region=group.region,
                requested={
                    "bars": group.bars,
                    "frequency_cy_per_px": group.frequency_cy_per_px / ratio[group.orientation_deg],
                },
            )
            for group in find_bar_groups(stack, target.get("bars"))
        ]
    raise BadInput(f"a target must be an edge, bars or a point, got {kind!r}")


def spread_over_frame(
    located: list[LocatedTarget], shape: tuple[int, ...], max_targets: int
) -> list[LocatedTarget]:
    """Order targets, given best first, so that the first `max_targets` cover the frame.

    The frame is divided into about `max_targets` parts; the best target of every part precedes the
    second of any.
    """
    parts = int(np.ceil(np.sqrt(max_targets)))
    counts: Counter[tuple[int, ...]] = Counter()
    turns = []
    for target in located:
        row, col, height, width = target.region
        centre = (row + 0.5 * height) / shape[0], (col + 0.5 * width) / shape[1]
        part = tuple(int(parts * fraction) for fraction in centre)
        turns.append(counts[part])
        counts[part] += 1
    return [located[index] for index in np.argsort(turns, kind="stable")]


def _merge_results(
    results: list[Result], chosen: list[LocatedTarget], left_out: int, kind: str
) -> Result:
    """Merge the results of several regions; the unsuffixed curves are those of the most precise
    region.
    """
    best = min(range(len(results)), key=lambda number: _quality_rank(results[number]))
    merged = Result(curves=dict(results[best].curves))
    for number, (result, target) in enumerate(zip(results, chosen, strict=True)):
        notes = tuple(
            _notes(number == best, len(results), left_out, number == 0, kind, bool(merged.curves))
        )
        suffix = REGION_NAME.format(*target.region)
        merged += Result(
            measurements=tuple(
                m.with_(region=m.region or target.region, notes=(*m.notes, *notes))
                for m in result.measurements
            ),
            curves={name + suffix: curve for name, curve in result.curves.items()},
            evidence={name + suffix: dict(shown) for name, shown in result.evidence.items()},
        )
    return merged


def _notes(
    best: bool, count: int, left_out: int, first: bool, kind: str, curves: bool
) -> Iterator[str]:
    if best and curves and count > 1:
        yield f"Curve `mtf` is from this region, the most precise of {count}."
    if first and left_out:
        yield (
            f"{left_out} further {NAMES[kind]} were not measured (limit {count}; see "
            f"`max_targets`)."
        )


def _quality_rank(result: Result) -> tuple[int, float]:
    """Return a sort key: ok before suspect before refused, then the relative interval width."""
    leading: Measurement | None = next(iter(result.find("mtf50") or result.measurements), None)
    if leading is None or leading.value is None or leading.interval95 is None:
        return 2, np.inf
    width = (leading.interval95[1] - leading.interval95[0]) / max(abs(leading.value), 1e-12)
    return int(leading.status != "ok"), width
