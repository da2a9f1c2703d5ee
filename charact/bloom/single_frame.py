"""What one frame of a point source says by itself, without darks, without its light and without other levels.

Extents are there in any frame; a halo's edge only where the rings step; all that compares levels is refused, each with
the sentence that says what would give it.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from charact.bloom.defects import with_sound_pixels
from charact.bloom.encircled_energy import REACH_PX, SHARES, ring_energy_radii
from charact.bloom.extent_measurements import bloom_measurements, provenance, series_evidence
from charact.bloom.findings import add_findings
from charact.bloom.halo_edge_step import STEP_SEEN, edge_radius
from charact.bloom.point_stack import DETECTED, PointStack, read_point_stacks, spot_of
from charact.bloom.profile import profile_of, reach_of
from charact.bloom.source_position import SourcePosition
from charact.bloom.source_view import view_of
from charact.method import Context
from charact.method.stopwatch import with_timing
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Result, make_refusal, measurement_from_draws, measurement_from_sd
from labdata.session import Session, StackEntry

METHOD = "one-frame"
# The steepest step of a blurred rim lies within about half a pixel of its edge; in one frame nothing confirms it.
RADIUS_SD_PX = 0.7
# A region at the highest code as wide as this hides halos, px.
CUT_PX = 16.0
# Box of another source in the frame, px to either side.
BOX_PX = 12
MOST_OTHERS = 8
# What one frame cannot tell: quantity, unit, and what would.
BEYOND_ONE_FRAME = (
    ("halo_fraction", "1", "the halo's share of the light needs levels at which core and halo are each not cut"),
    ("halo_plateau", "1/px2", "the plateau over the source's light needs a fainter level of stated light"),
    ("halo_rim", "1", "rim over plateau needs a fit of several levels"),
    ("veiling_glare", "%", "glare is told from background by levels of different light"),
    ("smear_fraction", "1", "smear is a share of light that only a fainter level, not cut, tells"),
    ("background_depression", "dB", "a background that falls needs a fainter level beside this one"),
    ("recovery_time_10", "s", "recovery needs a stack in which the source goes out"),
)


def bare_session(path: str | Path) -> Session:
    """Return a session of one stack that shows a point source, from a picture that has no session.

    Parameters
    ----------
    path
        The file.
    """
    path = Path(path)
    entry = StackEntry(label=path.stem, kind="point", frames=path.name, conditions=Conditions(), folder=path.parent)
    return Session(folder=path.parent, name=path.name, stacks=(entry,))


@with_timing
def measure_frame(session: Session, *, context: Context) -> Result:
    """Measure what the only stack of a session says by itself, each source in it with its region.

    Parameters
    ----------
    session
        Session with one stack of kind "point".
    context
        Seed and settings.
    """
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    session, _ = with_sound_pixels(session)
    (spot,) = read_point_stacks(session, context=context)
    (entry,) = session.of_kind("point")
    stack = entry.read()
    out = [*_extents(spot, context, fields), *_energy_radii(spot, stack, context, fields), _halo(spot, context, fields)]
    out += [
        make_refusal(quantity, unit, reason, stack=spot.label, **fields) for quantity, unit, reason in BEYOND_ONE_FRAME
    ]
    if spot.others:
        out = [m.with_(region=_box(spot)) for m in out]
    for other in spot.others[:MOST_OTHERS]:
        beside = replace(spot_of(entry, stack, _dark_of(spot), other, context, []), others=(_place(spot),))
        out += [m.with_(region=_box(beside)) for m in _extents(beside, context, fields)]
    return Result(
        measurements=tuple(add_findings(one) for one in out), evidence={"bloom-series": series_evidence((spot,))}
    )


def _extents(spot: PointStack, context: Context, fields: dict[str, Any]) -> list[Measurement]:
    return bloom_measurements((spot,), square=context.sensor is None, sensor=context.sensor, **fields)


def _dark_of(spot: PointStack) -> float | None:
    return spot.dark_dn if spot.dark_known else None


def _place(spot: PointStack) -> SourcePosition:
    return SourcePosition(row=spot.row, col=spot.col, significance=spot.significance)


def _box(spot: PointStack) -> tuple[int, int, int, int]:
    """ROW, COL, HEIGHT, WIDTH of the region at half of full scale, or of a few pixels around the place."""
    rows, cols = spot.image.shape
    if spot.half is not None:
        down, along = np.nonzero(spot.half.region)
        row, col = int(down.min()), int(along.min())
        return row, col, int(down.max()) - row + 1, int(along.max()) - col + 1
    row, col = max(0, round(spot.row) - BOX_PX), max(0, round(spot.col) - BOX_PX)
    return row, col, min(rows - row, 2 * BOX_PX + 1), min(cols - col, 2 * BOX_PX + 1)


def _energy_radii(spot: PointStack, stack: FrameStack, context: Context, fields: dict[str, Any]) -> list[Measurement]:
    names = [f"encircled_radius_{100 * share:.0f}" for share in SHARES]
    common = {"stack": spot.label, **fields}
    if spot.significance < DETECTED:
        return [make_refusal(name, "px", "no point source stands out of its surroundings", **common) for name in names]
    view = view_of(stack.data, spot.dark_dn, spot.full_scale_dn, spot.row, spot.col, context.pitch_ratio)
    found = ring_energy_radii(view, spot.light, seed=context.seed)
    if isinstance(found, str):
        return [make_refusal(name, "px", found, **common) for name in names]
    flags = ("several-targets",) if spot.others else ()
    rows, cols = spot.image.shape
    reach = min(
        REACH_PX, *(m * context.pitch_ratio for m in (spot.row, rows - 1 - spot.row)), spot.col, cols - 1 - spot.col
    )
    notes = (f"the whole light is what lies within {reach:.0f} px of the source",)
    return [
        measurement_from_draws(name, "px", found[share], flags=flags, notes=notes, **common)
        for name, share in zip(names, SHARES, strict=True)
    ]


def _halo(spot: PointStack, context: Context, fields: dict[str, Any]) -> Measurement:
    """The halo's edge where the rings step clearly."""
    common = {"stack": spot.label, **fields}
    if spot.significance < DETECTED:
        return make_refusal("halo_diameter", "px", "no point source stands out of its surroundings", **common)
    radius, seen = edge_radius(profile_of(spot, reach_of(spot), context=context))
    if seen < STEP_SEEN and spot.clip is not None and spot.clip.diameter_px > CUT_PX:
        reason = "the frame is cut to beyond any step of the rings: a fainter level would show the halo's edge"
        return make_refusal("halo_diameter", "px", reason, **common)
    if seen < STEP_SEEN:
        reason = "the rings show no step: a brighter level, whose halo rises above the noise, would show one"
        return make_refusal("halo_diameter", "px", reason, **common)
    notes = ("the steepest step of the rings; a series of levels tells it from other steps",)
    return measurement_from_sd("halo_diameter", "px", 2 * radius, 2 * RADIUS_SD_PX, notes=notes, **common)
