"""Measurements of every stack: bloom diameters, axis ratio, saturated area, streak."""

from dataclasses import replace
from typing import Any

import numpy as np

from charact.estimators.bloom.column_artefacts import streak_measurements
from charact.estimators.bloom.extent import Extent
from charact.estimators.bloom.findings import finding, judge_region
from charact.estimators.bloom.point_stack import DETECTED, PointStack
from charact.estimators.bloom.source_view import SECTORS
from charact.method import Context
from charact.verdict import Finding
from labdata import Camera, has_tube
from labdata.measurement import (
    Interval,
    Measurement,
    Provenance,
    Refusal,
    make_measurement,
    make_refusal,
    measurement_from_draws,
)


def ellipticity(extent: Extent, *, row_pitch: float) -> tuple[float, Interval, Interval] | None:
    """Return minor over major axis of a region with its 68 and 95 % intervals; None where it is too
    small.

    A contour gives the axes without pixels: those of an ellipse whose squared radius has the second
    harmonic 1 + e cos 2(phi - phi_0) have the ratio (1 - e/2)/(1 + e/2). Noise biases e upwards, so
    its mean square is subtracted. Regions with a streak or another source have the axes of the
    ellipse of equal second moments.
    """
    if extent.region.sum() < 12:
        return None
    if extent.contour is not None and not extent.pulled:
        sd = float(np.hypot(1.3 * extent.contour.oval_sd, 0.004))
        oval = float(np.sqrt(max(float(np.hypot(*extent.contour.oval)) ** 2 - sd**2, 0.0)))
        ends = np.maximum(oval + sd * np.array([0.0, 0.994, -0.994, 1.96, -1.96]), 0.0)
        value, low68, high68, low95, high95 = ((1.0 - 0.5 * ends) / (1.0 + 0.5 * ends)).tolist()
        return value, (low68, high68), (low95, high95)
    from skimage import measure

    region = measure.regionprops(extent.region.astype(np.uint8), spacing=(row_pitch, 1.0))[0]
    major = float(region.axis_major_length)
    value = float(region.axis_minor_length) / major if major > 0 else 1.0
    # Uncertainty of one row of pixels at either end.
    sd = (0.5 + value * 0.5) / max(major, 1.0)
    low, high = ((value - k * sd, min(value + k * sd, 1.0)) for k in (0.994, 1.96))
    return value, low, high


NO_DARKS = (
    "the black level is unknown, between 0 DN and the frame's median: a dark stack narrows "
    "the interval"
)
LEVELS = {
    "bloom_diameter": "half of full scale",
    "bloom_diameter_background": "twice the background above dark",
    "bloom_diameter_clip": "full scale",
}


def bloom_measurements(
    spots: tuple[PointStack, ...], *, square: bool, sensor: Camera | None = None, **fields: Any
) -> list[Measurement]:
    """Return the extents of every stack, refused where the source stays below the threshold.

    `spots`: stacks; `square`: whether pixels are assumed square since the pitches are unknown;
    `sensor`: sensor description, if known: areas are also given at the photocathode and in the
    field of view.
    """
    notes = ("the row pitch is unknown: pixels are assumed square",) if square else ()
    notes += () if all(spot.dark_known for spot in spots) else (NO_DARKS,)
    # Where blooms have merged, only fainter stacks show that there are two sources.
    sources = tuple(source for spot in spots for source in spot.other_sources)
    out: list[Measurement] = []
    for spot in (replace(spot, other_sources=sources) for spot in spots):
        common = {"stack": spot.label, "notes": notes, **fields}
        extents = {
            "bloom_diameter": spot.half,
            "bloom_diameter_background": spot.background,
            "bloom_diameter_clip": spot.clip,
        }
        out += [_diameter(name, spot, extent, **common) for name, extent in extents.items()]
        out += [_ellipticity(spot, **common), *_areas_at_full_scale(spot, sensor, **common)]
        out += streak_measurements(spot, Context(camera=sensor), **common)
    return out


def findings_of(spot: PointStack, extent: Extent) -> list[Finding]:
    """Return the findings of a bloom extent."""
    interval_px = float(np.diff(np.quantile(extent.draws, [0.025, 0.975]))[0])
    is_uncertain = interval_px > max(3.0, 0.3 * extent.diameter_px)
    rows, cols = extent.region.shape
    pixels = [(round(source.row), round(source.col)) for source in spot.other_sources]
    # A background below the dark level indicates different conditions.
    is_below_dark = spot.dark_known and spot.light.level_dn < -5.0 * max(spot.light.sd_dn, 0.05)
    checks = {
        "quantised": is_quantised(spot),
        "window-too-small": extent.touches_border,
        "low-signal": is_uncertain or (extent.contour is None and not extent.pulled),
        "several-targets": any(
            extent.region[row, col] for row, col in pixels if row < rows and col < cols
        ),
        "unlike-conditions": is_below_dark,
    }
    return [finding(flag) for flag, is_raised in checks.items() if is_raised]


def is_quantised(spot: PointStack) -> bool:
    """Return whether few grey values shift threshold crossings and hide faint signal."""
    return spot.full_scale_dn - spot.dark_dn < 20


def _below_level(
    quantity: str, unit: str, spot: PointStack, name: str, **common: Any
) -> Measurement:
    """Refuse a quantity of the region at a level that the source does not reach."""
    levels = {
        "bloom_diameter": spot.half_dn,
        "bloom_diameter_clip": spot.full_scale_dn,
        "bloom_diameter_background": spot.dark_dn + 2 * spot.light.level_dn,
    }
    reason = f"the source stays below {LEVELS[name]}, {levels[name]:.4g} DN"
    kind: Refusal = "not-applicable"
    if spot.why_undetected:
        reason, kind = spot.why_undetected, "failed"
    elif name == "bloom_diameter_background":
        if not spot.dark_known:
            reason, kind = (
                "the dark level and the background above it are unknown: a dark frame is needed",
                "missing",
            )
        elif not spot.light.is_uniform:
            reason, kind = (
                "the signal still falls at the border of the frame: the background is not visible",
                "failed",
            )
        elif not spot.light.is_illuminated:
            reason = f"no measurable background: {spot.light.level_dn:.2g} DN above dark"
    return make_refusal(quantity, unit, reason, refusal=kind, **common)


def _diameter(name: str, spot: PointStack, extent: Extent | None, **common: Any) -> Measurement:
    if extent is None:
        return _below_level(name, "px", spot, name, **common)
    if extent.region.all():
        return make_refusal(
            name, "px", f"the complete frame is at or above {LEVELS[name]}", **common
        )
    number = _measurement_around(name, "px", extent.diameter_px, extent.draws, **common)
    return judge_region(number, findings_of(spot, extent))


def _measurement_around(
    name: str, unit: str, value: float, draws: Any, **common: Any
) -> Measurement:
    """Measurement with the quantiles of its draws; the intervals include the value."""
    drawn = measurement_from_draws(name, unit, draws, **common)
    ends = (drawn.interval68 or (value, value), drawn.interval95 or (value, value))
    around68, around95 = ((min(low, value), max(high, value)) for low, high in ends)
    return replace(drawn, value=value, interval68=around68, interval95=around95)


def _ellipticity(spot: PointStack, **common: Any) -> Measurement:
    if spot.half is None:
        return _below_level("bloom_ellipticity", "1", spot, "bloom_diameter", **common)
    if spot.half.contour is None and not spot.half.pulled:
        return make_refusal(
            "bloom_ellipticity", "1", "the noise prevents a contour of the region", **common
        )
    estimate = ellipticity(spot.half, row_pitch=spot.row_pitch)
    if estimate is None:
        return make_refusal(
            "bloom_ellipticity",
            "1",
            "the region has fewer than 12 pixels",
            refusal="not-applicable",
            **common,
        )
    number = make_measurement("bloom_ellipticity", "1", *estimate, **common)
    return judge_region(number, findings_of(spot, spot.half))


def _areas_at_full_scale(
    spot: PointStack, sensor: Camera | None, **common: Any
) -> list[Measurement]:
    """Area at full scale in pixels and, if known, at the photocathode and in the field of view."""
    units = {"px": 1.0}
    if has_tube(sensor):
        side_mm = float(sensor.ccd.pitch_x_um) * 1e-3 * float(sensor.taper.demagnification)
        pixel_mm2 = side_mm**2 * spot.row_pitch
        units |= {
            "mm2": pixel_mm2,
            "mrad2": pixel_mm2 / (1e-3 * float(sensor.optics.focal_length_mm)) ** 2,
        }
    if spot.clip is None:
        return [_below_level("saturated_area", "px", spot, "bloom_diameter_clip", **common)]
    value, draws = (
        spot.clip.area / spot.row_pitch,
        np.pi / 4.0 * spot.clip.draws**2 / spot.row_pitch,
    )
    if spot.clip.pulled:
        # Streaks fill whole pixels, which are counted.
        value, draws = (
            float(spot.clip.region.sum()),
            draws - np.median(draws) + spot.clip.region.sum(),
        )
    # Standard deviation of the number of pixels inside a randomly placed circle, over the root of
    # its radius.
    pixel_count_error = (
        0.84 * (value / np.pi) ** 0.25 * np.random.default_rng(SECTORS).standard_normal(len(draws))
    )
    draws = np.maximum(draws + pixel_count_error, 0.0)
    return [
        judge_region(
            _measurement_around(
                "saturated_area", unit, value * pixel_area, draws * pixel_area, **common
            ),
            findings_of(spot, spot.clip),
        )
        for unit, pixel_area in units.items()
    ]


def provenance(context, **settings: Any) -> Provenance:
    """Return version, seed and settings."""
    from charact import __version__

    known = {"pitch_ratio": context.pitch_ratio, "quick": context.quick}
    return Provenance(version=__version__, seed=context.seed, settings=known | settings)


def series_evidence(
    spots: tuple[PointStack, ...], halos: dict[str, float] | None = None
) -> dict[str, Any]:
    """Bloom diameter, streak and halo diameter by overload, for the report.

    The overload is a source's signal over that which reaches full scale, from the brightest stack
    below it.
    """
    clear = [
        spot
        for spot in spots
        if spot.exposure_lux_ns
        and spot.significance > DETECTED
        and spot.image.max() < 0.8 * spot.full_scale_dn
    ]
    known = bool(clear) and all(spot.exposure_lux_ns is not None for spot in spots)
    overload: list[float] = list(range(1, len(spots) + 1))
    if known:
        spot = max(clear, key=lambda stack: stack.exposure_lux_ns or 0.0)
        row, col = round(spot.row), round(spot.col)
        peak = float(spot.image[row - 3 : row + 4, col - 3 : col + 4].max())
        relative = (peak - spot.dark_dn) / (spot.full_scale_dn - spot.dark_dn)
        per_light = relative / (spot.exposure_lux_ns or 1.0)
        overload = [(stack.exposure_lux_ns or 0.0) * per_light for stack in spots]
    return {
        "figure": "bloom-series",
        "label": [spot.label for spot in spots],
        "overload": overload,
        "overload_known": known,
        "illuminance_lux": [spot.conditions.illuminance_lux for spot in spots],
        "gate_ns": [spot.conditions.gate_ns for spot in spots],
        "bloom_diameter_px": [spot.bloom_px for spot in spots],
        "streak_length_px": [spot.streak_px for spot in spots],
        "halo_diameter_px": [(halos or {}).get(spot.label) for spot in spots],
        **{
            name: [getattr(spot, name) for spot in spots]
            for name in ("significance", "dark_dn", "full_scale_dn")
        },
    }
