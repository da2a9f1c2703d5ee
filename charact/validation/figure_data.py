"""Figure data of a validation: curves with the band of the simulated sets, and measured pictures
and simulated.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.observables.frame_view import FrameView
from charact.observables.thresholds import FRAMES
from charact.validation.frame_features import GROUPS, FrameFeatures
from charact.validation.frames import MatchedFrames, MatchedStacks
from charact.validation.target_features import FREQUENCY_CY_PER_PX, RADII_PX, point_features
from charact.validation.validation_result import FramePair, ResidualMap, ValidationFigures
from labdata import Array

Frames = Mapping[str, NDArray]

# Side of the squares over which a residual is averaged, px: structure stands out of the noise of
# pixels.
BLOCK_PX = 4
# Neighbouring frequencies of a cut of the spectrum that are averaged: one of few frames would be
# all noise.
NEIGHBOURS = 4
# Edges of the bins of temporal noise, standard deviations; the first and the last bin hold all
# beyond.
BINS_SD = np.arange(-8.0, 12.01, 0.5)
# Half of a two-sided 95 % interval of a Gaussian, standard deviations.
TWO_SIDED_95 = 1.96
# Share of the pixels that are shown as black, and as white.
EXTREME = 0.002
# Scales on which numbers of sets are nearly Gaussian, and the way back. Frames that repeat each
# other have no power.
SCALES: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "plain": (np.asarray, np.asarray),
    "log": (lambda values: np.log(np.maximum(values, 1e-12)), np.exp),
    "asinh": (np.arcsinh, np.sinh),
    "root": (np.sqrt, lambda values: np.square(np.maximum(values, 0.0))),
}


@dataclass(frozen=True, kw_only=True)
class FigureCurves:
    """Curves of one set of frames, by label of the stack.

    `blocks`: mean frame of a dark or flat in blocks, DN, shape (row, col); `horizontal`,
    `vertical`: noise power in time along the axes of the spectrum without the mean, DN^2, shape
    (frequency,); `counts`: number of values in `BINS_SD`; `rings`: level above the dark in the
    rings about a point source, DN, empty where none is found.
    """

    blocks: Mapping[str, Array]
    horizontal: Mapping[str, Array]
    vertical: Mapping[str, Array]
    counts: Mapping[str, Array]
    rings: Mapping[str, Array]


def curves_of(
    frames: Frames, chosen: MatchedStacks, levels: tuple[MatchedFrames, ...]
) -> FigureCurves:
    """Return the curves of a set of frames; `levels`: stacks of the point source besides the
    compared one.
    """
    horizontal, vertical, counts = {}, {}, {}
    dark_dn = float(frames[chosen.dark.label].mean())
    for shot in (chosen.dark, chosen.flats[-1]):
        data = np.asarray(frames[shot.label], np.float32)
        change = (data - data.mean(axis=0)) * np.float32(np.sqrt(len(data) / (len(data) - 1.0)))
        horizontal[shot.label] = _cut_of_spectrum(change.sum(axis=1), change[0].size)
        vertical[shot.label] = _cut_of_spectrum(change.sum(axis=2), change[0].size)
        sd = max(float(change.std()), 1e-6)  # Frames that repeat each other have none.
        deviation = np.clip(change / sd, BINS_SD[0], BINS_SD[-1])
        counts[shot.label] = np.histogram(deviation, BINS_SD)[0].astype(float)
    rings = {}
    for shot in _points(chosen, levels):
        numbers = point_features(frames[shot.label], dark_dn, None)
        values = np.sinh(
            [numbers.get(_ring(low, high), np.nan) for low, high in pairwise(RADII_PX)]
        )
        rings[shot.label] = values if np.isfinite(values).all() else np.array([])
    blocks = {
        shot.label: _block_means(frames[shot.label].mean(axis=0))
        for shot in _flat_fields(chosen).values()
    }
    return FigureCurves(
        blocks=blocks, horizontal=horizontal, vertical=vertical, counts=counts, rings=rings
    )


def figures_of(
    chosen: MatchedStacks,
    levels: tuple[MatchedFrames, ...],
    measured: tuple[Frames, FrameFeatures],
    simulated: tuple[Frames, Sequence[FrameFeatures], Sequence[FigureCurves]],
    *,
    seed: int,
) -> ValidationFigures:
    """Return curves and pictures of a validation.

    Parameters
    ----------
    chosen, levels
        Compared stacks, and those of the point source at other levels.
    measured
        Measured frames by label and their numbers.
    simulated
        Frames of the first simulated set by label, and numbers and curves of all sets.
    seed
        Chooses the stack of the blind pair.
    """
    (own_frames, own_features), (first, features, curves) = measured, simulated
    own_curves = curves_of(own_frames, chosen, levels)
    roles = _roles(chosen)
    compared = [(role, shot) for role, shot in roles.items() if shot not in chosen.display_only]
    role, shot = compared[int(np.random.default_rng([seed, 11]).integers(len(compared)))]
    return ValidationFigures(
        overlays={
            **_overlays_of_features(own_features, features, chosen),
            **_overlays_of_curves(own_curves, curves, chosen, levels),
        },
        pairs=tuple(_pair(role, shot, own_frames, first, 0) for role, shot in roles.items()),
        # Another frame than the pairs show, so that none of them gives the answer.
        blind=(_pair(role, shot, own_frames, first, 1),),
        patterns=tuple(
            _pattern_pair(role, shot, own_frames, first)
            for role, shot in _flat_fields(chosen).items()
        ),
        residuals=tuple(
            _residual(
                role,
                shot,
                own_curves.blocks[shot.label],
                [set_curves.blocks[shot.label] for set_curves in curves],
            )
            for role, shot in _flat_fields(chosen).items()
        ),
    )


def _flat_fields(chosen: MatchedStacks) -> dict[str, MatchedFrames]:
    """Return the dark, the dimmest and the brightest flat by role."""
    flats = dict(zip(("dim flat", "bright flat"), (chosen.flats[0], chosen.flats[-1]), strict=True))
    if len(chosen.flats) == 1:
        del flats["dim flat"]
    return {"dark": chosen.dark, **flats}


def _roles(chosen: MatchedStacks) -> dict[str, MatchedFrames]:
    """Return the stacks that are shown by role."""
    targets = {"edge": chosen.edge, "point source": chosen.point}
    display_only = {shot.kind: shot for shot in chosen.display_only}
    return {
        **_flat_fields(chosen),
        **{role: shot for role, shot in targets.items() if shot is not None},
        **display_only,
    }


def _points(chosen: MatchedStacks, levels: tuple[MatchedFrames, ...]) -> tuple[MatchedFrames, ...]:
    return () if chosen.point is None else (*levels, chosen.point)


def _cut_of_spectrum(lines: NDArray, pixels: int) -> Array:
    """Return the mean power of sums over lines (frame, place) per pixel, DN^2, at `_frequency`."""
    return _average((np.abs(np.fft.rfft(lines, axis=1)) ** 2).mean(axis=0) / pixels)


def _block_means(image: NDArray) -> Array:
    """Return the means of blocks of an image (row, col); incomplete blocks are omitted."""
    rows, cols = (size // BLOCK_PX for size in image.shape)
    cut = np.asarray(image, float)[: rows * BLOCK_PX, : cols * BLOCK_PX]
    return cut.reshape(rows, BLOCK_PX, cols, BLOCK_PX).mean(axis=(1, 3))


def _ring(low: float, high: float) -> str:
    return f"level at {low:g} to {high:g} px of the point"


def _residual(
    role: str, shot: MatchedFrames, measured: Array, simulated: list[Array]
) -> ResidualMap:
    """Return a measured mean frame less that of all sets, with the sd of a block by the sets."""
    sets = np.array(simulated)
    spread = float(np.sqrt(sets.var(axis=0, ddof=1).mean() * (1.0 + 1.0 / len(sets))))
    return ResidualMap(
        role=role,
        label=shot.label,
        block_px=BLOCK_PX,
        difference_dn=(measured - sets.mean(axis=0)).astype(np.float32),
        sd_dn=spread,
    )


def _pair(
    role: str, shot: MatchedFrames, measured: Frames, simulated: Frames, number: int
) -> FramePair:
    """Return one frame of a stack, measured and simulated, with a common grey scale."""
    images = [np.asarray(frames[shot.label][number], float) for frames in (measured, simulated)]
    low, high = np.quantile(
        np.concatenate([image.ravel() for image in images]), (EXTREME, 1.0 - EXTREME)
    )
    return _codes(role, shot, images, float(low), float(max(high, low + 1.0)))


def _pattern_pair(role: str, shot: MatchedFrames, measured: Frames, simulated: Frames) -> FramePair:
    """Return the mean frames without shading, measured and simulated, with a common grey scale
    about zero.
    """
    images = [
        np.asarray(FrameView(shot.label, frames[shot.label]).pattern, float)
        for frames in (measured, simulated)
    ]
    high = float(
        np.quantile(np.abs(np.concatenate([image.ravel() for image in images])), 1.0 - EXTREME)
    )
    return _codes(role, shot, images, -max(high, 1e-3), max(high, 1e-3))


def _codes(
    role: str, shot: MatchedFrames, images: list[Array], low: float, high: float
) -> FramePair:
    """Return two images as 8-bit grey values on one scale."""
    shown = [
        np.rint(255 * np.clip((image - low) / (high - low), 0, 1)).astype(np.uint8)
        for image in images
    ]
    return FramePair(
        role=role,
        kind=shot.kind,
        label=shot.label,
        measured=shown[0],
        simulated=shown[1],
        low_dn=low,
        high_dn=high,
        frames=shot.frames,
    )


def _overlays_of_features(
    measured: FrameFeatures, simulated: Sequence[FrameFeatures], chosen: MatchedStacks
) -> dict[str, dict[str, Any]]:
    """Return the overlays of compared numbers by name, JSON-ready."""
    out = {}
    for name, field, title in (
        ("photon-transfer", "variance_dn2", "Temporal variance, DN²"),
        ("covariance", "covariance_dn2", "Covariance sum within 6 px, DN²"),
    ):
        x = np.array([numbers.mean_dn for numbers in simulated]).mean(axis=0)
        curve = _curve(
            "",
            measured.mean_dn,
            getattr(measured, field),
            [getattr(numbers, field) for numbers in simulated],
            x,
        )
        out[name] = {"title": title, "x_title": "signal, DN", "y_title": title, "curves": [curve]}
    flat = chosen.flats[-1].label
    lags = [f"correlation at {row},{col} px of {flat}" for row, col in FRAMES.lags]
    frequencies = [f"MTF at {at:.2f} cy/px" for at in FREQUENCY_CY_PER_PX]
    for name, x, labels, x_title, y_title in (
        (
            "autocorrelation",
            [f"{row},{col}" for row, col in FRAMES.lags],
            lags,
            "lag (row, column), px",
            "correlation",
        ),
        ("mtf", FREQUENCY_CY_PER_PX.tolist(), frequencies, "frequency, cy/px", "MTF"),
    ):
        own_values, *sets = (
            np.array([numbers.groups.get(name, {}).get(label, np.nan) for label in labels])
            for numbers in (measured, *simulated)
        )
        if np.isfinite(own_values).all() and np.isfinite(sets).all():
            curve = _curve("", x, own_values, sets)
            out[name] = {
                "title": GROUPS[name].title,
                "x_title": x_title,
                "y_title": y_title,
                "curves": [curve],
            }
    return out


def _overlays_of_curves(
    measured: FigureCurves,
    sets: Sequence[FigureCurves],
    chosen: MatchedStacks,
    levels: tuple[MatchedFrames, ...],
) -> dict[str, dict[str, Any]]:
    """Return the overlays of noise spectra, histograms and profiles by name, JSON-ready."""
    out = {}
    for field in ("horizontal", "vertical"):
        power = {
            label: [getattr(set_curves, field)[label] for set_curves in sets]
            for label in getattr(measured, field)
        }
        curves = [
            _curve(
                label, _frequency(chosen, field), getattr(measured, field)[label], rows, scale="log"
            )
            for label, rows in power.items()
        ]
        out[f"noise-spectrum-{field}"] = {
            "title": f"Noise spectrum, {field} cut",
            "x_title": "frequency, cy/px",
            "y_title": "power of the noise in time, DN²",
            "y_scale": "log",
            "curves": curves,
        }
    for shot in (chosen.dark, chosen.flats[-1]):
        rows = [set_curves.counts[shot.label] for set_curves in sets]
        out[f"histogram-{shot.kind}"] = {
            "title": f"Histogram of the noise in time of {shot.label}",
            "x_title": "deviation from the mean frame; the ends hold all beyond, sd",
            "y_title": "values in half an sd",
            "y_scale": "symlog",
            "curves": [
                _curve(
                    "",
                    (BINS_SD[1:] + BINS_SD[:-1]) / 2.0,
                    measured.counts[shot.label],
                    rows,
                    scale="root",
                )
            ],
        }
    curves_of_points = [
        _curve(
            shot.label,
            [(low + high) / 2.0 for low, high in pairwise(RADII_PX)],
            measured.rings[shot.label],
            [set_curves.rings[shot.label] for set_curves in sets],
            scale="asinh",
        )
        for shot in _points(chosen, levels)
        if measured.rings[shot.label].size
        and all(set_curves.rings[shot.label].size for set_curves in sets)
    ]
    if curves_of_points:
        out["point"] = {
            "title": "Profile of the point source at each level",
            "x_title": "radius, px",
            "y_title": "level above the dark, DN",
            "y_scale": "symlog",
            "curves": curves_of_points,
        }
    return out


def _frequency(chosen: MatchedStacks, direction: str) -> Array:
    """Return the frequencies of a cut of the spectrum of darks and flats, cy/px."""
    rows, cols = chosen.dark.shape
    return _average(np.fft.rfftfreq(cols if direction == "horizontal" else rows))


def _average(spectrum: NDArray) -> Array:
    """Return means of neighbours of a spectrum without its first value, the mean; a remainder is
    left out.
    """
    count = (len(spectrum) - 1) // NEIGHBOURS
    return (
        np.asarray(spectrum[1 : 1 + count * NEIGHBOURS], float)
        .reshape(count, NEIGHBOURS)
        .mean(axis=1)
    )


def _curve(
    name: str,
    x: Any,
    measured: Any,
    simulated: Any,
    x_simulated: Any = None,
    *,
    scale: str = "plain",
) -> dict[str, Any]:
    """Return a measured curve with the mean of the simulated ones and the 95 % band of one more
    set, JSON-ready.

    `simulated`: shape (set, k); `scale`: that of `SCALES` on which mean and sd are taken; the root
    is of counts.
    """
    to, back = SCALES[scale]
    sets = to(np.asarray(simulated, float))
    # A root of a count has a variance of 1/4 by Poisson (Anscombe 1948), also where all sets have
    # none.
    variance = np.maximum(sets.var(axis=0, ddof=1), 0.25 if scale == "root" else 0.0)
    centre, half = sets.mean(axis=0), TWO_SIDED_95 * np.sqrt(variance * (1.0 + 1.0 / len(sets)))
    out = {"name": name, "x": list(x) if isinstance(x[0], str) else _round(x)}
    if x_simulated is not None:
        out["x_simulated"] = _round(x_simulated)
    values = {
        "measured": measured,
        "simulated": back(centre),
        "low95": back(centre - half),
        "high95": back(centre + half),
    }
    return {**out, **{key: _round(value) for key, value in values.items()}}


def _round(values: Any) -> list[float]:
    """Return numbers to five digits: more are invisible in a figure."""
    return [float(f"{value:.5g}") for value in np.asarray(values, float)]
