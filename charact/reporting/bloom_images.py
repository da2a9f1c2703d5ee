"""Images of blooming: annotated frames of a point series, and the bloom map."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.posterior_psf import spread_of
from charact.method import Context
from charact.reporting.blooms import EXTENTS, pick_levels
from charact.reporting.style import DATA, MODEL, THIRD, WARN, panels
from labdata import BadInput, Result, Session, write_atomically

Data = Mapping[str, Any]


def plot_bloom_frames(data: Data) -> Any:
    """Plot frames of up to six source levels with bloom, halo and streak; pixels at full scale are
    tinted.

    Reads `label`, and per stack: `frame_dn` (row, col) over which `row`, `col` of the source are
    given, `dark_dn`, `full_scale_dn`, `bloom_diameter_px` and `streak_length_px` (or None);
    `halo_diameter_px`, common to all, or None; `aspect`, row pitch over column pitch.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    shown = pick_levels(len(data["label"]))
    cols = min(3, len(shown))
    rows = -(-len(shown) // cols)
    figure, grid = panels(rows, cols, size=(max(2.15 * cols + 0.3, 4.6), 2.25 * rows + 0.5))
    diameters = [float(d) for d in (*data["bloom_diameter_px"], data.get("halo_diameter_px")) if d]
    # Half the side of the image over the diameter of the halo or of the largest bloom.
    half = 0.5 * max(40, 1.5 * max(diameters, default=0.0))
    for axes, number in zip(grid.ravel(), shown, strict=False):
        _frame(axes, data, number, half)
    for axes in grid.ravel()[len(shown) :]:
        axes.set_axis_off()
    for axes in grid[-1, :]:
        axes.set_xlabel("column (px)")
    for axes in grid[:, 0]:
        axes.set_ylabel("row (px)")
    lines: list[tuple[str, str, Literal["-", "--"]]] = [
        ("bloom, half of full scale", DATA, "-"),
        ("halo", THIRD, "--"),
        ("streak", MODEL, "-"),
    ]
    handles: list[Any] = [
        Line2D([], [], color=colour, linestyle=style, label=words)
        for words, colour, style in lines
        if words != "halo" or data.get("halo_diameter_px")
    ]
    handles.append(Patch(facecolor=WARN, alpha=0.45, label="full scale"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def _frame(axes: Any, data: Data, number: int, half: float) -> None:
    from matplotlib.patches import Ellipse

    row, col, dark, full = (
        float(data[key][number]) for key in ("row", "col", "dark_dn", "full_scale_dn")
    )
    aspect = float(data.get("aspect") or 1.0)
    frame, extent = _cut(np.asarray(data["frame_dn"][number], float), row, col, half / aspect, half)
    limits = (0.0, np.log10(max(full - dark, 2.0)))
    axes.imshow(
        np.log10(np.maximum(frame - dark, 1.0)),
        cmap="gray",
        vmin=limits[0],
        vmax=limits[1],
        extent=extent,
        interpolation="nearest",
    )
    _tint(axes, frame >= full - 0.5, extent)
    axes.set_aspect(aspect)
    for diameter, colour, style in (
        (data.get("halo_diameter_px"), THIRD, "--"),
        (data["bloom_diameter_px"][number], DATA, "-"),
    ):
        if diameter:
            axes.add_patch(
                Ellipse(
                    (col, row),
                    diameter,
                    diameter / aspect,
                    fill=False,
                    color=colour,
                    linestyle=style,
                    linewidth=1.3,
                )
            )
    if length := data["streak_length_px"][number]:
        axes.plot([col, col], [row - length / 2, row + length / 2], color=MODEL, linewidth=1.3)
    axes.set_xlim(col - half, col + half)
    axes.set_ylim(row + half / aspect, row - half / aspect)
    axes.set_title(str(data["label"][number]))
    axes.grid(False)


def _cut(
    frame: NDArray, row: float, col: float, down: float, across: float
) -> tuple[NDArray, tuple[float, float, float, float]]:
    """Return the part of a frame around a position, and its limits: left, right, bottom, top,
    px.
    """
    first = max(0, int(row - down) - 1), max(0, int(col - across) - 1)
    cut = frame[first[0] : int(row + down) + 3, first[1] : int(col + across) + 3]
    top, first_col_edge = first[0] - 0.5, first[1] - 0.5
    return cut, (first_col_edge, first_col_edge + cut.shape[1], top + cut.shape[0], top)


def _tint(axes: Any, mask: NDArray, extent: tuple[float, float, float, float]) -> None:
    """Tint the pixels of a mask."""
    from matplotlib.colors import to_rgba

    layer = np.zeros((*mask.shape, 4))
    layer[mask] = to_rgba(WARN, 0.45)
    axes.imshow(layer, extent=extent, interpolation="nearest")


def plot_bloom_map(data: Data) -> Any:
    """Plot a frame, the fraction of every pixel's signal that is blooming, and its standard
    uncertainty.

    Reads `signal_dn`, `fraction`, `sd` (row, col), NaN where unknown, `near_px`, `sources`
    (mappings with `row`, `col`, `known`), `aspect`, row pitch over column pitch, and optionally
    `truth` (row, col), the true fraction.
    """
    signal, sd = np.asarray(data["signal_dn"], float), np.asarray(data["sd"], float)
    aspect = float(data.get("aspect") or 1.0)
    finite = np.isfinite(sd)
    sd_limit = max(0.02, float(np.quantile(sd[finite], 0.99)) if finite.any() else 1.0)
    fraction = f"fraction that entered more than {data['near_px']:g} px away (1)"
    shown = [
        (
            "frame",
            np.log10(np.maximum(signal, 1.0)),
            "gray",
            None,
            "log10 of the signal over dark (DN)",
        ),
        ("blooming (grey: unknown)", data["fraction"], "magma", 1.0, fraction),
        ("standard uncertainty", sd, "magma", sd_limit, "standard uncertainty of the fraction (1)"),
    ]
    if data.get("truth") is not None:
        shown.insert(2, ("true fraction", data["truth"], "magma", 1.0, fraction))
    cols = 2 if len(shown) == 4 else 3
    rows = -(-len(shown) // cols)
    tall = 4.4 * min(1.3, max(0.5, signal.shape[0] * aspect / signal.shape[1])) + 0.4
    figure, grid = panels(rows, cols, size=(4.6 * cols, tall * rows))
    for axes, (title, image, colours, top, words) in zip(grid.ravel(), shown, strict=True):
        axes.set_facecolor("#9a9a9a")
        low = None if top is None else 0.0
        drawn = axes.imshow(
            np.asarray(image, float), cmap=colours, vmin=low, vmax=top, aspect=aspect
        )
        figure.colorbar(drawn, ax=axes, shrink=0.8, label=words)
        axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
        axes.grid(False)
    for source in data.get("sources", ()):
        mark, colour = ("+", THIRD) if source["known"] else ("x", WARN)
        grid[0, 0].plot(
            source["col"], source["row"], mark, color=colour, markersize=9, markeredgewidth=1.6
        )
    return figure


def add_extent_data(session: Session, result: Result) -> dict[str, dict[str, Any]]:
    """Return the figure data of a result; that of a point series with measured and predicted
    extents and frames.
    """
    out, extents = dict(result.evidence), {}
    for m in result.measurements:
        if m.quantity in EXTENTS and m.value is not None and m.stack is not None:
            interval = m.interval95 or (m.value, m.value)
            extents.setdefault(m.quantity, {})[m.stack] = [m.value, *interval]
    halos = [
        [m.value, *m.interval95]
        for m in result.find("halo_diameter")
        if m.value is not None and m.interval95 is not None
    ]
    series = [name for name, data in out.items() if data.get("figure") == "bloom-series"]
    for name in series:
        out[name] = {
            **out[name],
            "measured": extents,
            "halo_px": halos[0] if halos else None,
            "foretold": _predict_diameters(out[name], result),
        }
    frames = _bloom_frame_data(session, out[series[0]], result) if series else None
    return out if frames is None else {**out, "frames of the point series": frames}


def _predict_diameters(data: dict[str, Any], result: Result) -> dict[str, Any] | None:
    """Return the diameters predicted by the fitted spread at every overload, by quantity [2.5 %,
    median, 97.5 %].
    """
    if not data.get("overload_known"):
        return None
    posteriors = [m.posterior for m in result.find("halo_diameter") if m.posterior is not None]
    try:
        spread = spread_of(posteriors[0]).subsample(40) if posteriors else None
    except BadInput:
        return None
    if spread is None:
        return None
    radius = np.arange(0.0, 140.0, 0.25)
    density = np.maximum.accumulate(spread.density(radius)[:, ::-1], axis=1)[:, ::-1]
    light = np.array(data["overload"], float)
    overload = np.geomspace(light.min(), light.max(), 120)
    # Thresholds above the background, fractions of full scale above dark.
    background = _background_fraction(data, result, overload)
    levels = {"bloom_diameter": 0.5 - background, "bloom_diameter_clip": 1.0 - background}
    diameters = {
        quantity: _diameters(density, radius, overload, level)
        for quantity, level in levels.items()
        if (level > 0).all()
    }
    return {"overload": overload.tolist(), **diameters}


def _background_fraction(data: dict[str, Any], result: Result, overload: NDArray) -> NDArray:
    """Return the fitted background at every overload, as a fraction of full scale, both above dark;
    0 without fit.
    """
    dark, full = float(np.median(data["dark_dn"])), float(np.median(data["full_scale_dn"]))
    fitted = result.evidence.get("point-profile", {})
    light = dict(zip(data["label"], data["overload"], strict=True))
    background_of_label = dict(
        zip(fitted.get("label", ()), fitted.get("background_dn", ()), strict=False)
    )
    known = sorted(
        (light[label], level) for label, level in background_of_label.items() if label in light
    )
    if not known:
        return np.zeros(len(overload))
    at, level = np.array(known).T
    return np.maximum(np.interp(overload, at, (level - dark) / (full - dark)), 0.0)


def _diameters(
    density: NDArray, radius: NDArray, overload: NDArray, level: NDArray
) -> list[list[float]]:
    """Return the diameters at which the signal falls to a threshold, 2.5, 50 and 97.5 % of the
    draws.
    """
    out = np.empty((len(density), len(overload)))
    for number, profile in enumerate(density):
        # At overload 1 the peak is 1.
        falling = profile / profile[0]
        out[number] = 2.0 * np.interp(level / overload, falling[::-1], radius[::-1], left=np.nan)
        out[number][overload < level] = 0.0
    return [np.nanquantile(out, quantile, axis=0).tolist() for quantile in (0.025, 0.5, 0.975)]


def _bloom_frame_data(
    session: Session, data: dict[str, Any], result: Result
) -> dict[str, Any] | None:
    """Return the mean frames of the stacks of a series with the annotations."""
    by_label = {entry.label: entry for entry in session.of_kind("point")}
    labels = [label for label in data["label"] if label in by_label]
    if not labels:
        return None
    frames = [by_label[label].read().data.mean(axis=0) for label in labels]
    number = [data["label"].index(label) for label in labels]
    row, col = _source_position(frames, float(np.median(data["dark_dn"])))
    extents = {
        key: [(data["measured"].get(quantity, {}).get(label) or [None])[0] for label in labels]
        for key, quantity in (
            ("bloom_diameter_px", "bloom_diameter"),
            ("streak_length_px", "streak_length"),
        )
    }
    from charact.reporting.report_images import aspect_of

    return {
        "figure": "bloom-frames",
        "label": labels,
        "frame_dn": frames,
        "row": [row] * len(labels),
        "col": [col] * len(labels),
        "dark_dn": [data["dark_dn"][n] for n in number],
        "full_scale_dn": [data["full_scale_dn"][n] for n in number],
        "halo_diameter_px": (data.get("halo_px") or [None])[0],
        "aspect": aspect_of(session),
        **extents,
    }


def _source_position(frames: list[NDArray], dark_dn: float) -> tuple[float, float]:
    """Return the centroid of the bright part of the frame with the highest peak."""
    image = max(frames, key=lambda frame: float(frame.max()) - float(np.median(frame)))
    over = np.clip(image - dark_dn - 0.5 * (image.max() - dark_dn), 0.0, None)
    rows, cols = np.indices(image.shape)
    return float((rows * over).sum() / over.sum()), float((cols * over).sum() / over.sum())


def write_bloom_map(
    session: Session, result: Result, context: Context, *, label: str | None, path: Path
) -> None:
    """Write the bloom map of a stack of a session.

    `session`, `result`: the session and its result by `charact.estimators.bloom.measure`;
    `context`: seed, full scale and pitches; `label`: stack; None: the scene, else the brightest
    point source; `path`: a .png file with the frame, the map and its standard deviation, or an .npz
    file with the arrays `signal_dn`, `fraction`, `sd`, `blooming_dn`, `clipped` and `near_border`,
    shape (row, col), and the number `near_px`. Raises BadInput if the file is of another kind,
    there is no such stack, or the result has no halo.
    """
    if path.suffix.lower() not in (".png", ".npz"):
        raise BadInput(f"a bloom map must be a .png or .npz file, got {path.name!r}")
    from charact.estimators.bloom.bloom_map import evidence_of, map_of

    frame_map, signal = map_of(session, result, label=label, context=context)
    content = io.BytesIO()
    if path.suffix.lower() == ".npz":
        np.savez_compressed(
            content,
            signal_dn=signal.astype(np.float32),
            fraction=frame_map.fraction,
            sd=frame_map.sd,
            blooming_dn=frame_map.blooming_dn,
            clipped=frame_map.clipped,
            near_border=frame_map.near_border,
            near_px=frame_map.near_px,
        )
        write_atomically(path, content.getbuffer())
        return
    from charact.reporting.style import white_style

    with white_style():
        plot_bloom_map({**evidence_of(frame_map, signal), "aspect": context.pitch_ratio}).savefig(
            content, format="png", dpi=130
        )
    write_atomically(path, content.getbuffer())
