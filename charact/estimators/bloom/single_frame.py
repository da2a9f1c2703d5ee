"""Bloom quantities of a single frame of a point source, without darks and other source levels."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from charact.estimators.bloom.defects import with_sound_pixels
from charact.estimators.bloom.extent import DRAWS
from charact.estimators.bloom.extent_measurements import (
    bloom_measurements,
    provenance,
    series_evidence,
)
from charact.estimators.bloom.findings import finding
from charact.estimators.bloom.point_stack import (
    DETECTED,
    PointStack,
    SourcePosition,
    read_point_stacks,
    spot_of,
)
from charact.estimators.bloom.series.halo_edge_step import rim_of
from charact.estimators.bloom.series.ring_series import build_ring_series
from charact.estimators.bloom.series.series_measurements import NO_RINGS
from charact.estimators.bloom.source_view import SECTORS, Background, SourceView, view_of
from charact.estimators.bloom.thresholds import Unmeasurable
from charact.frames.stack import Stack
from charact.frames.thresholds import CLIPPING
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.verdict import judge
from labdata import (
    Array,
    Conditions,
    Measurement,
    Result,
    Session,
    StackEntry,
    has_tube,
    make_refusal,
    measurement_from_draws,
)

SHARES = (0.5, 0.9)
# Outermost ring of the sum, px: halos end inside, and the background's error grows with the area.
REACH_PX = 45.0
# Steps and directions of the interpolation near the source, px.
STEP_PX, ANGLES = 0.25, 48


def ring_energy_radii(view: SourceView, background: Background, *, seed: int) -> dict[float, Array]:
    """Return draws of the encircled-energy radii for each of `SHARES`, column pitches; else
    Unmeasurable.

    The total signal is that inside the largest ring of the frame, or within `REACH_PX`: wings
    beyond are excluded, and the background's error applies to the full area.
    """
    top = float((view.signal[view.polar.radius < view.rings.radius[-1]]).max())
    if top > CLIPPING.full_fraction * view.top:
        raise Unmeasurable(
            "the source's core is clipped, so that its total signal is unknown: a fainter stack "
            "is needed"
        )
    if not background.is_uniform:
        raise Unmeasurable(
            "the signal still falls at the border of the frame: a larger frame is needed"
        )
    border = (
        view.polar.radius[edge].min() for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])
    )
    rings = max(int(min(*border, REACH_PX)), 1)
    rng = np.random.default_rng(seed)
    sd = view.mean_sd(view.profile[1])
    area = np.diff(np.pi * np.arange(rings + 1.0) ** 2)
    mean = view.rings.mean()[:rings]
    noise = view.rings.draws(sd, DRAWS, rng, np.ones(SECTORS, bool))[:, :rings] - mean
    noise -= background.sd_dn * rng.standard_normal((DRAWS, 1))
    radius, encircled = _cumulative_light(
        view, mean - background.level_dn, area, background.level_dn
    )
    off = np.concatenate([np.zeros((DRAWS, 1)), np.cumsum(noise * area, axis=1)], axis=1)
    draws = encircled + np.array(
        [np.interp(radius, np.arange(rings + 1.0), light) for light in off]
    )
    total_light = draws[:, -1]
    if np.std(total_light) > 0.1 * np.mean(total_light):
        error = np.std(total_light) / abs(np.mean(total_light))
        raise Unmeasurable(
            f"the source's signal is uncertain by {error:.0%}: more frames are needed"
        )
    return {
        fraction: np.array([_first(light / light[-1], radius, fraction) for light in draws])
        for fraction in SHARES
    }


def _cumulative_light(
    view: SourceView, light: Array, area: Array, floor: float
) -> tuple[Array, Array]:
    """Radii and encircled signal: by spline interpolation near the source, by rings beyond."""
    from scipy import ndimage

    near_rings = min(12, len(light))
    fine = np.arange(0.0, near_rings + STEP_PX / 2, STEP_PX)
    angle = 2.0 * np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
    middle = fine[1:] - 0.5 * STEP_PX
    row, col = -view.polar.dy[0, 0] / view.polar.row_pitch, -view.polar.dx[0, 0]
    positions = [
        row + middle[:, None] * np.sin(angle) / view.polar.row_pitch,
        col + middle[:, None] * np.cos(angle),
    ]
    profile = (
        ndimage.map_coordinates(view.signal, positions, order=3, mode="nearest").mean(axis=1)
        - floor
    )
    inner = np.concatenate([[0.0], np.cumsum(2.0 * np.pi * middle * STEP_PX * profile)])
    outer = inner[-1] + np.cumsum((light * area)[near_rings:])
    return np.concatenate([fine, np.arange(near_rings + 1.0, len(light) + 1.0)]), np.concatenate(
        [inner, outer]
    )


def _first(encircled: Array, radius: Array, fraction: float) -> float:
    """Radius at which the encircled signal first reaches a fraction; between radii it grows with
    the area.
    """
    at = max(int(np.argmax(encircled >= fraction)), 1)
    part = (fraction - encircled[at - 1]) / max(encircled[at] - encircled[at - 1], 1e-12)
    return float(
        np.sqrt(
            radius[at - 1] ** 2 + np.clip(part, 0.0, 1.0) * (radius[at] ** 2 - radius[at - 1] ** 2)
        )
    )


METHOD = "one-frame"
# Half side of the region of another source, px.
BOX_PX = 12
# Quantities that one frame cannot determine: name, unit and reason.
BEYOND_ONE_FRAME = (
    (
        "halo_fraction",
        "1",
        (
            "the fraction of light in the halo needs stacks with unclipped core and with unclipped "
            "halo"
        ),
    ),
    (
        "halo_plateau",
        "1/px2",
        "the plateau over the source's signal needs a fainter stack of stated illuminance",
    ),
    ("halo_rim", "1", "the ratio of rim to plateau needs a fit of several stacks"),
    (
        "veiling_glare",
        "%",
        "glare needs stacks of different illuminance to separate it from background",
    ),
    ("smear_fraction", "1", "the smear fraction needs a fainter, unclipped stack"),
    (
        "background_depression",
        "dB",
        "a fall of the background needs a fainter stack for comparison",
    ),
    ("recovery_time_10", "s", "recovery needs a stack in which the source is switched off"),
)


def bare_session(path: str | Path) -> Session:
    """Return a session of one point stack from an image file without a session."""
    path = Path(path)
    entry = StackEntry(
        label=path.stem, kind="point", frames=path.name, conditions=Conditions(), folder=path.parent
    )
    return Session(folder=path.parent, name=path.name, stacks=(entry,))


@with_timing
def measure_frame(session: Session, *, context: Context) -> Result:
    """Measure the only stack, of kind "point", of a session; each source in it has its own
    region.
    """
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    session, _ = with_sound_pixels(session)
    (spot,) = read_point_stacks(session, context=context)
    (entry,) = session.of_kind("point")
    stack, of_spot = Stack.of(entry.read(), context), {"stack": spot.label, **fields}
    extents = partial(
        bloom_measurements, square=not has_tube(context.camera), sensor=context.camera, **fields
    )
    out = [
        *extents((spot,)),
        *_energy_radii(spot, stack, context, of_spot),
        _halo(session, spot, context, of_spot),
    ]
    out += [
        make_refusal(quantity, unit, reason, refusal="missing", **of_spot)
        for quantity, unit, reason in BEYOND_ONE_FRAME
    ]
    if spot.other_sources:
        out = [m.with_(region=_box(spot)) for m in out]
    first = SourcePosition(row=spot.row, col=spot.col, significance=spot.significance)
    for other in spot.other_sources[:8]:
        dark = spot.dark_dn if spot.dark_known else None
        second = replace(spot_of(entry, stack, dark, other, context, []), other_sources=(first,))
        out += [m.with_(region=_box(second)) for m in extents((second,))]
    return Result(
        measurements=tuple(out),
        evidence={"bloom-series": series_evidence((spot,))},
    )


def _box(spot: PointStack) -> tuple[int, int, int, int]:
    """Region (row, col, height, width) at half of full scale, or a few pixels around the source."""
    rows, cols = spot.image.shape
    if spot.half is not None:
        down, along = np.nonzero(spot.half.region)
        row, col = int(down.min()), int(along.min())
        return row, col, int(down.max()) - row + 1, int(along.max()) - col + 1
    row, col = max(0, round(spot.row) - BOX_PX), max(0, round(spot.col) - BOX_PX)
    return row, col, min(rows - row, 2 * BOX_PX + 1), min(cols - col, 2 * BOX_PX + 1)


def _energy_radii(
    spot: PointStack, stack: Stack, context: Context, common: dict[str, Any]
) -> list[Measurement]:
    names = [f"encircled_radius_{100 * fraction:.0f}" for fraction in SHARES]
    try:
        if spot.significance < DETECTED:
            raise Unmeasurable("no point source is detected")
        view = view_of(stack, spot.dark_dn, spot.row, spot.col, context.pitch_ratio)
        radii = ring_energy_radii(view, spot.light, seed=context.seed)
    except Unmeasurable as refusal:
        return [make_refusal(name, "px", str(refusal), **common) for name in names]
    (rows, cols), ratio = spot.image.shape, context.pitch_ratio
    reach_px = min(
        REACH_PX, spot.row * ratio, (rows - 1 - spot.row) * ratio, spot.col, cols - 1 - spot.col
    )
    common["notes"] = (f"the total signal is that within {reach_px:.0f} px of the source",)
    findings = [finding("several-targets")] if spot.other_sources else []
    return [
        judge(measurement_from_draws(name, "px", radii[fraction], **common), findings)
        for name, fraction in zip(names, SHARES, strict=True)
    ]


def _halo(
    session: Session, spot: PointStack, context: Context, common: dict[str, Any]
) -> Measurement:
    """Diameter of the halo where the rings have a clear step."""
    try:
        if spot.significance < DETECTED:
            raise Unmeasurable("no point source is detected")
        series, _ = build_ring_series(session, (spot,), context=context)
        # One frame does not show whether its camera has a tube.
        rim = rim_of(series, pitch_ratio=context.pitch_ratio, has_tube=True)
        no_edge = NO_RINGS if rim is None else rim.why_no_edge()
        if rim is not None and no_edge is None:
            draws = rim.draws(DRAWS, context.seed)
            notes = ("the clearest step of the rings; only a series distinguishes it from others",)
            return measurement_from_draws("halo_diameter", "px", draws, notes=notes, **common)
        cut = spot.clip is not None and spot.clip.diameter_px > 16.0
        fainter = "the frame is clipped beyond any step of the rings: a fainter stack would show it"
        raise Unmeasurable(fainter if cut else f"{no_edge}; a brighter stack may show one")
    except Unmeasurable as refusal:
        return make_refusal("halo_diameter", "px", str(refusal), **common)
