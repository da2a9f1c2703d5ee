"""Extents of every stack as measurements: bloom diameters, ellipticity, saturated area, streak length."""

from dataclasses import replace
from typing import Any

import numpy as np

from charact.bloom.extent import Extent
from charact.bloom.point_stack import DETECTED, PointStack
from charact.bloom.polar import SECTORS
from charact.bloom.shape import ellipticity
from charact.bloom.streak import streak_measurements
from charact.method import Context
from labdata.measurement import Measurement, Provenance, make_measurement, make_refusal, measurement_from_draws
from labdata.sensor import Sensor

# Standard deviation of the number of pixels inside a circle thrown at random over them, over the root of its radius.
COUNTING = 0.84
# Width of a 95 % interval, px and share of the diameter, from which on the noise all but hides where light ends.
VAGUE_PX, VAGUE = 3.0, 0.3
NO_DARKS = "the level without light is unknown, between 0 DN and the frame's median: a dark stack narrows the interval"
# Codes from dark to the highest below which steps hide where light ends.
LEAST_CODES = 20
LEVELS = {
    "bloom_diameter": "half of full scale",
    "bloom_diameter_background": "twice the background over dark",
    "bloom_diameter_clip": "the highest code",
}


def bloom_measurements(spots: tuple[PointStack, ...], *, square: bool, sensor: Sensor | None = None,
                       **fields: Any) -> list[Measurement]:  # fmt: skip
    """Return the extents of every stack, refused where the source does not reach their level.

    Parameters
    ----------
    spots
        The stacks.
    square
        Whether pixels are taken as square because nobody knows better.
    sensor
        The camera, where known: areas are told at its cathode and in the field of view as well.
    """
    notes = ("the row pitch is unknown: pixels are taken as square",) if square else ()
    notes += () if all(spot.dark_known for spot in spots) else (NO_DARKS,)
    # Where blooms have run into one, only fainter levels show that there are two sources.
    beside = tuple(place for spot in spots for place in spot.others)
    out: list[Measurement] = []
    for spot in (replace(spot, others=beside) for spot in spots):
        common = {"stack": spot.label, "notes": notes, **fields}
        found = {"bloom_diameter": spot.half, "bloom_diameter_background": spot.background,
                 "bloom_diameter_clip": spot.clip}  # fmt: skip
        out += [_diameter(name, spot, extent, **common) for name, extent in found.items()]
        out += [_ellipticity(spot, **common), *_areas_at_full_scale(spot, sensor, **common)]
        out += streak_measurements(spot, Context(sensor=sensor), **common)
    return out


def flags_of(spot: PointStack, extent: Extent) -> tuple[str, ...]:
    """What is to be distrusted of an extent."""
    flags = quantisation_flags(spot)
    flags += ("window-too-small",) if extent.touches_border else ()
    wide = float(np.diff(np.quantile(extent.draws, [0.025, 0.975]))[0]) > max(VAGUE_PX, VAGUE * extent.diameter_px)
    flags += ("low-signal",) if wide or not (extent.has_contour or extent.pulled) else ()
    rows, cols = extent.region.shape
    within = [(round(one.row), round(one.col)) for one in spot.others]
    inside = [extent.region[row, col] for row, col in within if row < rows and col < cols]
    flags += ("several-targets",) if any(inside) else ()
    # A background below the dark level is none: one of both was taken otherwise.
    below = spot.dark_known and spot.light.level_dn < -5.0 * max(spot.light.sd_dn, 0.05)
    return flags + (("unlike-conditions",) if below else ())


def quantisation_flags(spot: PointStack) -> tuple[str, ...]:
    """Whether rounding to so few codes moves where light falls through a level, and eats what is faint."""
    return ("quantised",) if spot.full_scale_dn - spot.dark_dn < LEAST_CODES else ()


def _reason(spot: PointStack, name: str) -> str:
    """Why a stack has no region at a level."""
    if spot.significance < DETECTED:
        return f"no point source: the brightest spot stands {spot.significance:.1f} standard deviations out of 8 needed"
    level = {"bloom_diameter": spot.half_dn, "bloom_diameter_clip": spot.full_scale_dn}.get(name)
    if level is not None:
        return f"the source stays below {LEVELS[name]}, {level:.4g} DN"
    if not spot.dark_known:
        return "the dark level is unknown, and so is the background over it: a dark frame tells it"
    if not spot.light.even:
        return "the light still falls at the border of the frame: the background behind the source is not seen"
    if not spot.light.lit:
        return f"there is no background to take twice: {spot.light.level_dn:.2g} DN over dark"
    return f"the source stays below {LEVELS[name]}, {spot.dark_dn + 2 * spot.light.level_dn:.4g} DN"


def _diameter(name: str, spot: PointStack, extent: Extent | None, **common: Any) -> Measurement:
    if extent is None:
        return make_refusal(name, "px", _reason(spot, name), **common)
    if extent.region.all():
        return make_refusal(name, "px", f"the whole frame is at or above {LEVELS[name]}", **common)
    return _measurement_from_draws(name, "px", extent.diameter_px, extent.draws, flags=flags_of(spot, extent), **common)


def _measurement_from_draws(name: str, unit: str, value: float, draws: Any, **common: Any) -> Measurement:
    """A value with the quantiles of its draws, which may lean to one side of it but never leave it out."""
    drawn = measurement_from_draws(name, unit, draws, **common)
    low68, high68 = drawn.interval68 or (value, value)
    low95, high95 = drawn.interval95 or (value, value)
    return make_measurement(name, unit, value, (min(low68, value), max(high68, value)), (min(low95, value), max(high95, value)),
                    **common)  # fmt: skip


def _ellipticity(spot: PointStack, **common: Any) -> Measurement:
    if spot.half is None:
        return make_refusal("bloom_ellipticity", "1", _reason(spot, "bloom_diameter"), **common)
    if not spot.half.has_contour and not spot.half.pulled:
        return make_refusal("bloom_ellipticity", "1", "the noise leaves open where the region ends", **common)
    found = ellipticity(spot.half, row_pitch=spot.row_pitch)
    if found is None:
        return make_refusal("bloom_ellipticity", "1", "a region of so few pixels has no shape", **common)
    return make_measurement("bloom_ellipticity", "1", *found, flags=flags_of(spot, spot.half), **common)


def _areas_at_full_scale(spot: PointStack, sensor: Sensor | None, **common: Any) -> list[Measurement]:
    """Area of the pixels at the highest code, in pixels, and at the cathode and in the field of view where known."""
    units = {"px": 1.0}
    if sensor is not None:
        side_mm = float(sensor.ccd.pitch_x_um) * 1e-3 * float(sensor.taper.demagnification)
        pixel_mm2 = side_mm**2 * spot.row_pitch
        units |= {"mm2": pixel_mm2, "mrad2": pixel_mm2 / (1e-3 * float(sensor.optics.focal_length_mm)) ** 2}
    if spot.clip is None:
        return [make_refusal("saturated_area", "px", _reason(spot, "bloom_diameter_clip"), **common)]
    value, draws = spot.clip.area / spot.row_pitch, np.pi / 4.0 * spot.clip.draws**2 / spot.row_pitch
    if spot.clip.pulled:
        # Streaks fill whole pixels: those are counted.
        value, draws = float(spot.clip.region.sum()), draws - np.median(draws) + spot.clip.region.sum()
    whole = COUNTING * (value / np.pi) ** 0.25 * np.random.default_rng(SECTORS).standard_normal(len(draws))
    flags = flags_of(spot, spot.clip)
    return [_measurement_from_draws("saturated_area", unit, value * one, np.maximum(draws + whole, 0.0) * one, flags=flags, **common)
            for unit, one in units.items()]  # fmt: skip


def provenance(context, **settings: Any) -> Provenance:
    """Return version, seed and settings."""
    from charact import __version__

    known = {"pitch_ratio": context.pitch_ratio, "quick": context.quick}
    return Provenance(version=__version__, seed=context.seed, settings=known | settings)


def overload_of_stacks(spots: tuple[PointStack, ...]) -> list[float | None]:
    """How many times each source is brighter than one whose peak just meets full scale; None where light is unknown."""
    light = [_light(spot) for spot in spots]
    clear = [
        (value, spot)
        for value, spot in zip(light, spots, strict=True)
        if value and spot.significance > DETECTED and spot.image.max() < 0.8 * spot.full_scale_dn
    ]
    if not clear:
        return [None] * len(spots)
    value, spot = max(clear, key=lambda one: one[0])
    peak = float(spot.image[round(spot.row) - 3 : round(spot.row) + 4, round(spot.col) - 3 : round(spot.col) + 4].max())
    share = (peak - spot.dark_dn) / (spot.full_scale_dn - spot.dark_dn)
    return [None if one is None else one / value * share for one in light]


def _light(spot: PointStack) -> float | None:
    if spot.conditions.illuminance_lux is None:
        return None
    return spot.conditions.illuminance_lux * (spot.conditions.gate_ns or 1.0)


def series_evidence(spots: tuple[PointStack, ...], halos: dict[str, float] | None = None) -> dict[str, Any]:
    """Bloom diameter, streak and each level's own halo against the light, for the report."""
    overload = overload_of_stacks(spots)
    known = all(value is not None for value in overload)
    return {
        "figure": "bloom-series",
        "label": [spot.label for spot in spots],
        "overload": overload if known else list(range(1, len(spots) + 1)),
        "overload_known": known,
        "illuminance_lux": [spot.conditions.illuminance_lux for spot in spots],
        "gate_ns": [spot.conditions.gate_ns for spot in spots],
        "bloom_diameter_px": [spot.bloom_px for spot in spots],
        "streak_length_px": [spot.streak_px for spot in spots],
        "halo_diameter_px": [(halos or {}).get(spot.label) for spot in spots],
        "significance": [spot.significance for spot in spots],
        "dark_dn": [spot.dark_dn for spot in spots],
        "full_scale_dn": [spot.full_scale_dn for spot in spots],
    }
