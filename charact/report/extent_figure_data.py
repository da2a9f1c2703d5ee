"""What a report adds to the evidence of a point series: measured extents, those that the fit foretells, and frames."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.posterior_psf import spread_of
from charact.report.blooms import EXTENTS
from labdata.errors import BadInput
from labdata.measurement import Result
from labdata.session import Session, StackEntry

# Overloads between the least and the most for which diameters are foretold, and draws of the spread.
STEPS, DRAWS = 120, 40
FARTHEST_PX = 140.0


def add_extent_data(session: Session, result: Result) -> dict[str, dict[str, Any]]:
    """Return the evidence of a result, that of a point series with its measured extents and with annotated frames."""
    out = dict(result.evidence)
    series = [name for name, data in out.items() if data.get("figure") == "bloom-series"]
    for name in series:
        out[name] = {**out[name], **_extents_with_intervals(result), "foretold": _predict_diameters(out[name], result)}
    frames = _bloom_frame_data(session, out[series[0]], result) if series else None
    return out if frames is None else {**out, "frames of the point series": frames}


def _extents_with_intervals(result: Result) -> dict[str, Any]:
    """Extents by quantity and stack, and the halo's diameter, each with its 95 % interval."""
    told: dict[str, dict[str, list[float]]] = {}
    for m in result.measurements:
        if m.quantity in EXTENTS and m.value is not None and m.stack is not None:
            told.setdefault(m.quantity, {})[m.stack] = [m.value, *(m.interval95 or (m.value, m.value))]
    halo = [m for m in result.find("halo_diameter") if m.value is not None and m.interval95 is not None]
    line = [halo[0].value, *halo[0].interval95] if halo and halo[0].interval95 else None
    return {"measured": told, "halo_px": line}


def _predict_diameters(data: dict[str, Any], result: Result) -> dict[str, Any] | None:
    """Diameters that the fitted spread makes of a point at every overload, by quantity [2.5 %, median, 97.5 %]."""
    if not data.get("overload_known"):
        return None
    posteriors = [m.posterior for m in result.find("halo_diameter") if m.posterior is not None]
    try:
        spread = spread_of(posteriors[0]).subsample(DRAWS) if posteriors else None
    except BadInput:
        return None
    if spread is None:
        return None
    radius = np.arange(0.0, FARTHEST_PX, 0.25)
    density = np.maximum.accumulate(spread.density(radius)[:, ::-1], axis=1)[:, ::-1]
    light = np.array(data["overload"], float)
    overload = np.geomspace(light.min(), light.max(), STEPS)
    levels = _threshold_fractions(data, _background_share(data, result, overload))
    found = {quantity: _diameters(density, radius, overload, level) for quantity, level in levels.items()}
    return {"overload": overload.tolist(), **found}


def _background_share(data: dict[str, Any], result: Result, overload: NDArray) -> NDArray:
    """Background of every overload over dark, as a share of full scale over dark: the fit's own, else the stacks'."""
    dark, full = float(np.median(data["dark_dn"])), float(np.median(data["full_scale_dn"]))
    fitted = result.evidence.get("point-profile", {})
    light = dict(zip(data["label"], data["overload"], strict=True))
    own = dict(zip(fitted.get("label", ()), fitted.get("background_dn", ()), strict=False))
    known = sorted((light[label], level) for label, level in own.items() if label in light)
    if not known:
        return np.zeros(len(overload))
    at, level = np.array(known).T
    return np.maximum(np.interp(overload, at, (level - dark) / (full - dark)), 0.0)


def _threshold_fractions(data: dict[str, Any], background: NDArray) -> dict[str, NDArray]:
    """Levels of the extents over the background, as shares of full scale over dark, at every overload."""
    levels = {"bloom_diameter": 0.5 - background, "bloom_diameter_clip": 1.0 - background}
    faint = data.get("background_dn")
    if isinstance(faint, int | float) or (isinstance(faint, list) and any(faint)):
        levels["bloom_diameter_background"] = background
    return {name: level for name, level in levels.items() if (level > 0).all()}


def _diameters(density: NDArray, radius: NDArray, overload: NDArray, level: NDArray) -> list[list[float]]:
    """Diameter at which the light of a point falls to a level, 2.5, 50 and 97.5 % over the draws."""
    out = np.empty((len(density), len(overload)))
    for number, one in enumerate(density):
        # Light of overload 1 has a peak of 1.
        falling = one / one[0]
        out[number] = 2.0 * np.interp(level / overload, falling[::-1], radius[::-1], left=np.nan)
        out[number][overload < level] = 0.0
    return [np.nanquantile(out, share, axis=0).tolist() for share in (0.025, 0.5, 0.975)]


def _bloom_frame_data(session: Session, data: dict[str, Any], result: Result) -> dict[str, Any] | None:
    """Mean frames of the series' stacks with what is drawn over them."""
    by_label = {entry.label: entry for entry in session.of_kind("point")}
    labels = [label for label in data["label"] if label in by_label]
    if not labels:
        return None
    frames = [_mean(by_label[label]) for label in labels]
    number = [data["label"].index(label) for label in labels]
    place = _source_position(frames, float(np.median(data["dark_dn"])))
    rows, cols = (data.get(key) or [at] * len(data["label"]) for key, at in zip(("row", "col"), place, strict=True))
    extents = {
        key: [(data["measured"].get(quantity, {}).get(label) or [None])[0] for label in labels]
        for key, quantity in (("bloom_diameter_px", "bloom_diameter"), ("streak_length_px", "streak_length"))
    }
    from charact.report.report_images import aspect_of

    return {
        "figure": "bloom-frames",
        "label": labels,
        "frame_dn": frames,
        "row": [rows[n] for n in number],
        "col": [cols[n] for n in number],
        "dark_dn": [data["dark_dn"][n] for n in number],
        "full_scale_dn": [data["full_scale_dn"][n] for n in number],
        "halo_diameter_px": (data.get("halo_px") or [None])[0],
        "aspect": aspect_of(session),
        **extents,
    }


def _mean(entry: StackEntry) -> NDArray:
    return entry.read().data.mean(axis=0)


def _source_position(frames: list[NDArray], dark_dn: float) -> tuple[float, float]:
    """Middle of the bright part of the frame that stands out most without being wide: the light's centroid."""
    image = max(frames, key=lambda frame: float(frame.max()) - float(np.median(frame)))
    over = np.clip(image - dark_dn - 0.5 * (image.max() - dark_dn), 0.0, None)
    rows, cols = np.indices(image.shape)
    return float((rows * over).sum() / over.sum()), float((cols * over).sum() / over.sum())
