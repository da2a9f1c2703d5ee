"""Measurement of all targets of one frame, each in the region where it is found."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.mtf.dispatch import measure
from charact.mtf.region import Region
from charact.mtf.target_detection import find_bar_groups, find_edges, find_pinholes
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Result

# Suffix of a curve's name that states its region.
REGION_NAME = ":{},{},{},{}"
NAMES = {"edge": "edges", "bars": "groups of bars", "point": "points"}


@dataclass(frozen=True, kw_only=True)
class LocatedTarget:
    """A located target: its region and the arguments for its method."""

    region: Region
    told: dict[str, Any] = field(default_factory=dict)


@with_timing
def measure_all(
    kind: str,
    stack: FrameStack,
    *,
    method: str = "auto",
    within_percent: float = 2.0,
    at_most: int = 24,
    context: Context,
    **target: Any,
) -> Result:
    """Find the targets of a frame and measure the MTF of each.

    Parameters
    ----------
    kind, stack, method, within_percent, context, target
        As for `measure`; for bars `frequency_cy_per_px` may be None: it is measured.
    at_most
        Maximum number of targets measured; a note states how many are not. Edges and points are taken from all parts of
        the frame, the clearest of each part first; bar groups by clarity.

    Returns
    -------
    Result
        Measurements of every region in reading order. Curves carry their region, as in "mtf:100,200,80,60"; the curve
        "mtf" is the most precise one, as a note states. For bars "mtf" and "mtf_vertical" pass through the groups along
        rows and along columns, with an `mtf50` each and no region, where groups of two frequencies are ok. For a frame
        with at most one target the result is that of `measure`.

    Raises
    ------
    BadInput
        If `at_most` is less than 1, or as for `measure`.
    """
    if at_most < 1:
        raise BadInput(f"at least 1 target must be measured, got at most {at_most}")
    asked = {"method": method, "within_percent": within_percent, "context": context}
    if kind == "bars" and target.get("frequency_cy_per_px") is not None:
        return measure(kind, stack, **asked, **target)
    found = targets(kind, stack, context, **target)
    if len(found) < (1 if kind == "bars" else 2):
        return measure(kind, stack, **asked, **target)
    best_first = found if kind == "bars" else spread_over_frame(found, stack.shape[1:], at_most)
    chosen = sorted(best_first[:at_most], key=lambda one: one.region[:2])
    results = []
    for done, one in enumerate(chosen):
        context.progress(f"{kind} in {one.region}", done / len(chosen))
        results.append(measure(kind, stack, region=one.region, **asked, **{**target, **one.told}))
    together = _merge_results(results, chosen, len(found) - len(chosen), kind)
    if kind != "bars":
        return together
    from charact.mtf.bars.group_curve import frame_curves

    return together + frame_curves(together, context=context)


def targets(kind: str, stack: FrameStack, context: Context, **target: Any) -> list[LocatedTarget]:
    """Return the targets of a kind in a frame, the clearest first."""
    if kind == "edge":
        return [LocatedTarget(region=edge.region) for edge in find_edges(stack)]
    if kind == "point":
        full_scale_dn = context.full_scale_dn or stack.full_scale_dn
        return [LocatedTarget(region=point.region) for point in find_pinholes(stack, full_scale_dn=full_scale_dn)]
    if kind == "bars":
        ratio = {0.0: 1.0, 90.0: context.pitch_ratio}
        return [
            # The detector counts cycles per sample, the methods cycles per column pitch.
            LocatedTarget(
                region=group.region,
                told={
                    "bars": group.bars,
                    "frequency_cy_per_px": group.frequency_cy_per_px / ratio[group.orientation_deg],
                },
            )
            for group in find_bar_groups(stack, target.get("bars"))
        ]
    raise BadInput(f"a target must be an edge, bars or a point, got {kind!r}")


def spread_over_frame(found: list[LocatedTarget], shape: tuple[int, ...], at_most: int) -> list[LocatedTarget]:
    """Order targets, given best first, so that the first `at_most` cover the frame.

    The frame is divided into about `at_most` parts; the best target of every part precedes the second of any.
    """
    parts = int(np.ceil(np.sqrt(at_most)))
    taken: Counter[tuple[int, ...]] = Counter()
    turns = []
    for one in found:
        row, col, height, width = one.region
        middle = (row + 0.5 * height) / shape[0], (col + 0.5 * width) / shape[1]
        part = tuple(int(parts * share) for share in middle)
        turns.append(taken[part])
        taken[part] += 1
    return [found[index] for index in np.argsort(turns, kind="stable")]


def _merge_results(results: list[Result], chosen: list[LocatedTarget], left_out: int, kind: str) -> Result:
    """Merge the results of several regions; the unsuffixed curves are those of the most precise region."""
    best = min(range(len(results)), key=lambda number: _quality_rank(results[number]))
    merged = Result(curves=dict(results[best].curves))
    for number, (result, one) in enumerate(zip(results, chosen, strict=True)):
        notes = tuple(_notes(number == best, len(results), left_out, number == 0, kind, bool(merged.curves)))
        suffix = REGION_NAME.format(*one.region)
        merged += Result(
            measurements=tuple(
                m.with_(region=m.region or one.region, notes=(*m.notes, *notes)) for m in result.measurements
            ),
            curves={name + suffix: curve for name, curve in result.curves.items()},
            evidence={name + suffix: dict(shown) for name, shown in result.evidence.items()},
        )
    return merged


def _notes(best: bool, count: int, left_out: int, first: bool, kind: str, curves: bool) -> Iterator[str]:
    if best and curves and count > 1:
        yield f"The curve mtf is of this region, the one known best of {count}."
    if first and left_out:
        yield f"{left_out} more {NAMES[kind]} were found and left out: {count} are measured at most."


def _quality_rank(result: Result) -> tuple[int, float]:
    """Return a sort key: ok before suspect before refused, then the relative interval width."""
    leading: Measurement | None = next(iter(result.find("mtf50") or result.measurements), None)
    if leading is None or leading.value is None or leading.interval95 is None:
        return 2, np.inf
    width = (leading.interval95[1] - leading.interval95[0]) / max(abs(leading.value), 1e-12)
    return int(leading.status != "ok"), width
