"""Bloom diameter and streak length of every stack as measurements."""

from typing import Any

import numpy as np

from charact.bloom.spot import DETECTED, Spot
from labdata.measurement import Measurement, Provenance, from_sd, refused

# Frames of a screen that glows on are not independent: standard errors of means over them are wider by about this.
GLOW = 1.5


def bloom_measurements(spots: tuple[Spot, ...], *, square: bool, **fields: Any) -> list[Measurement]:
    """Return diameter and streak of every stack, refused where nothing reaches half of full scale."""
    notes = ("the row pitch is unknown: pixels are taken as square",) if square else ()
    out: list[Measurement] = []
    for spot in spots:
        flags = () if spot.dark_known else ("no-darks",)
        flags += ("window-too-small",) if spot.touches_border else ()
        common = {"stack": spot.label, "notes": notes, **fields}
        reason = _reason(spot)
        if reason is not None:
            out += [refused(name, "px", reason, **common) for name in ("bloom_diameter", "streak_length")]
            continue
        diameter_sd, streak_sd = _errors(spot)
        out.append(from_sd("bloom_diameter", "px", spot.bloom_px, diameter_sd, flags=flags, **common))
        out.append(from_sd("streak_length", "px", spot.streak_px, streak_sd, flags=flags, **common))
    return out


def _reason(spot: Spot) -> str | None:
    """Why a stack has no bloom, or None."""
    if spot.significance < DETECTED:
        return f"no point source: the brightest spot stands {spot.significance:.1f} standard deviations out of 8 needed"
    if spot.bloom_px <= 0:
        level = spot.dark_dn + 0.5 * (spot.full_scale_dn - spot.dark_dn)
        return f"the source stays below half of full scale, {level:.4g} DN"
    return None


def _errors(spot: Spot) -> tuple[float, float]:
    """Standard errors: scatter of single frames, and of counting whole pixels along the contour."""
    radius = max(spot.bloom_px / 2.0, 0.5)
    counting = 0.9 * np.sqrt(radius) / (np.pi * radius)
    steps = 1.0 / np.sqrt(12.0)
    if spot.frames < 2:
        return float(counting), float(2.0 * steps)
    share = GLOW / np.sqrt(spot.frames)
    diameter = np.hypot(spot.frame_bloom_px.std(ddof=1) * share, counting)
    streak = np.hypot(spot.frame_streak_px.std(ddof=1) * share, 2.0 * steps)
    return float(diameter), float(streak)


def provenance(context, **settings: Any) -> Provenance:
    """Return version, seed and settings."""
    from charact import __version__

    known = {"pitch_ratio": context.pitch_ratio, "quick": context.quick}
    return Provenance(version=__version__, seed=context.seed, settings=known | settings)


def overloads(spots: tuple[Spot, ...]) -> list[float | None]:
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


def _light(spot: Spot) -> float | None:
    if spot.conditions.illuminance_lux is None:
        return None
    return spot.conditions.illuminance_lux * (spot.conditions.gate_ns or 1.0)


def series_evidence(spots: tuple[Spot, ...], halos: dict[str, float] | None = None) -> dict[str, Any]:
    """Bloom diameter, streak and each level's own halo against the light, for the report."""
    overload = overloads(spots)
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
