"""Fusion that knows its cameras: weights from the noise of each pyramid level, blooming removed,
holes filled; in grey, in false colours, and in natural ones by a table.

The table is of visible and thermal values, made from a scene whose materials are known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from charact.fusion.bands import Band, Image, Plane, Span, display_planes
from charact.fusion.checks import find_problems
from charact.fusion.fused import Fused, LevelWeights, finish, level_uncertainty
from charact.fusion.pyramid import collapse, decompose, map_samples, weigh, weighted_sum
from charact.fusion.thresholds import FUSION
from charact.method.registry import register
from labdata.errors import BadInput
from labdata.short_repr import short_repr

# Values of each band that a table tells apart, a step being below the noise of either band, and the
# Gaussian over them.
SIZE, SMOOTH = 64, 1.5


@register("fusion", "noise-aware")
def fuse_noise_aware(
    bands: Sequence[Band],
    *,
    spans: Mapping[str, Span] | None = None,
    uncertainty: bool = True,
    check: bool = True,
) -> Fused:
    """Fuse bands into a grey picture, each detail weighted by the noise of its camera.

    `spans`: fixed display spans by the name of the band, None: from the trusted pixels;
    `uncertainty`, `check`: whether standard deviation and shares are computed, and noise law and
    blooming are checked against the frames. Bands of unlike shape, and an empty span, are BadInput.

    Notes
    -----
    At each level of a Laplacian pyramid the details D_b of the bands have the noise variance n_b(x)
    = s_l (gain mu(x) + r^2), with mu the light including the blooming that is subtracted and s_l
    the variance of the level for the camera's noise spectrum
    (`charact.fusion.pyramid.noise_gains`). The estimate of a contrast common to the bands is D =
    sum (D_b/n_b) / sum 1/n_b with the variance n = 1/sum 1/n_b, shrunk by P/(P + n), P = mean(D^2 -
    n) of the level. Where a band is clipped or occluded its 1/n_b is 0, so that the other bands
    fill its details; its base level is interpolated. The base is the mean of the bands: levels are
    no evidence. A band that holds nothing beyond its noise is left out. Opposite contrasts of equal
    evidence cancel in any grey picture; `noise-aware-colour` keeps them.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> from charact.frames.noise_law import NoiseLaw
    >>> law = NoiseLaw(gain_dn=0.0, read_dn=1.0)
    >>> frames = rng.normal(0.0, 1.0, (2, 64, 64))
    >>> frames[:, 24:40, 24:40] += 5.0
    >>> bands = [Band(name=n, image=image, noise=law) for n, image in zip("ab", frames)]
    >>> out = fuse_noise_aware(bands)
    >>> round(float(out.share[0].mean()), 2)
    0.49
    """
    planes = display_planes(bands, bloom=True, spans=spans)
    picture, weights, finest = fuse_levels(planes)
    spread = level_uncertainty(planes, weights) if uncertainty else None
    findings, notes = find_problems(planes, finest) if check else ((), ())
    empty = [
        plane.band.name
        for plane, plane_weights in zip(planes, weights, strict=True)
        if plane_weights[-1] == 0.0
    ]
    notes = (*notes, *(f"{name} holds nothing beyond its noise and was left out" for name in empty))
    return finish("noise-aware", planes, picture, spread, findings=findings, notes=notes)


def fuse_levels(
    planes: Sequence[Plane],
) -> tuple[Image, list[list[Image | np.float32]], list[Image]]:
    """Return the fused picture, the weights of each band at each level, and finest details of each
    band, sampled.

    See `fuse_noise_aware`; the samples are those of `charact.fusion.pyramid.map_samples`.
    """
    levels = planes[0].levels
    pyramids = [decompose(plane.value, levels) for plane in planes]
    shown = [has_signal(plane, pyramid) for plane, pyramid in zip(planes, pyramids, strict=True)]
    shown = shown if any(shown) else [True] * len(planes)
    finest = [map_samples(pyramid[0]) for pyramid in pyramids]
    out, weights = [], [[] for _ in planes]
    for level in range(levels):
        precisions = [
            _precision(plane, level) * np.float32(1.0 if is_shown else 1e-6)
            for plane, is_shown in zip(planes, shown, strict=True)
        ]
        noise = np.asarray(np.float32(1.0) / sum(precisions))
        details = [pyramid[level] for pyramid in pyramids]
        detail = weighted_sum(details, [precision * noise for precision in precisions])
        # Where no band is known the noise is a million times higher, and there are no details.
        mean_noise = float(np.mean(noise[noise < 1e3 * np.min(noise)]))
        power = max(
            float(cv2.norm(detail, cv2.NORM_L2SQR)) / detail.size - mean_noise,
            FUSION.signal_floor * mean_noise,
        )
        shrink = np.float32(power) / (np.float32(power) + noise)
        out.append(weigh(detail, shrink, details[0]))
        for plane_weights, precision in zip(weights, precisions, strict=True):
            plane_weights.append(precision * noise * shrink)
    fractions = [np.float32(is_shown / sum(shown)) for is_shown in shown]
    out.append(weighted_sum([pyramid[levels] for pyramid in pyramids], fractions))
    for plane_weights, fraction in zip(weights, fractions, strict=True):
        plane_weights.append(fraction)
    return collapse(out), weights, finest


def has_signal(plane: Plane, pyramid: Sequence[Image]) -> bool:
    """Return whether a band holds more than its noise: in the power of a coarser level, or in a
    single detail.
    """
    for level in range(FUSION.map_level, plane.levels):
        noise = np.maximum(plane.variance(level), np.float32(1e-12))
        relative = pyramid[level] ** 2 / noise
        # Neighbouring coefficients are correlated: half of them count.
        error = 2.0 / np.sqrt(relative.size)
        if (
            relative.mean() > 1.0 + FUSION.signal_floor + 3.0 * error
            or relative.max() > FUSION.signal_sd**2
        ):
            return True
    return False


def _precision(plane: Plane, level: int) -> Image | np.float32:
    """Return 1/n of the details of a level; nearly 0 in holes, so that a pixel without any band has
    no details.
    """
    inverse = np.float32(1.0) / np.maximum(plane.variance(level), np.float32(1e-12))
    if plane.known is None:
        return inverse
    return inverse * np.maximum(plane.known[max(level - FUSION.map_level, 0)], np.float32(1e-6))


@register("fusion", "noise-aware-colour")
def fuse_colour(
    bands: Sequence[Band],
    *,
    spans: Mapping[str, Span] | None = None,
    uncertainty: bool = True,
    check: bool = True,
) -> Fused:
    """Fuse bands into a colour picture of restored bands: green the first, red the second, blue the
    third.

    The parameters are those of `fuse_noise_aware`. Of two bands, blue is 0.5 + 0.5 (first -
    second): contrasts of opposite sign differ in hue, where a grey picture would lose them. Each
    band is restored by itself: blooming is subtracted, clipped pixels are filled by the level of
    their surroundings, and the details of each pyramid level are shrunk by P/(P + n) as in
    `fuse_noise_aware`. Of more than three bands, blue is the mean of all from the third.
    """
    planes = display_planes(bands, bloom=True, spans=spans)
    restored, weights, finest = restore_bands(planes)
    green, red, *more = restored
    mixture = np.zeros((3, len(planes)), np.float32)
    mixture[0, 1] = mixture[1, 0] = 1.0
    if more:
        mixture[2, 2:] = 1.0 / len(more)
        blue = weighted_sum(more, [1.0 / len(more)] * len(more))
    else:
        mixture[2] = 0.5, -0.5
        blue = cv2.addWeighted(green, 0.5, red, -0.5, 0.5)
    picture = cv2.merge([red, green, blue])
    spread = None
    if uncertainty:
        sd = np.sqrt(
            np.square(deviations(planes, weights)).transpose(1, 2, 0) @ np.square(mixture).T
        )
        # The share of a band is that in the contrasts of all colours.
        contrast = np.abs(mixture).sum(axis=0)
        _, share = level_uncertainty(
            planes,
            [
                [weight * contrast[k] for weight in plane_weights]
                for k, plane_weights in enumerate(weights)
            ],
        )
        spread = sd, share
    findings, notes = find_problems(planes, finest) if check else ((), ())
    return finish("noise-aware-colour", planes, picture, spread, findings=findings, notes=notes)


def restore_bands(
    planes: Sequence[Plane],
) -> tuple[list[Image], list[list[Image | np.float32]], list[Image]]:
    """Return each band restored by itself, its weight at each level, and its finest details; see
    `fuse_levels`.
    """
    pictures, weights, finest = zip(*(fuse_levels([plane]) for plane in planes), strict=True)
    return list(pictures), [single for (single,) in weights], [single for (single,) in finest]


def deviations(planes: Sequence[Plane], weights: Sequence[LevelWeights]) -> list[Image]:
    """Return the standard deviation of each restored band, shape (row, col)."""
    return [
        level_uncertainty([plane], [plane_weights])[0]
        for plane, plane_weights in zip(planes, weights, strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class ColourTable:
    """Colour for each pair of display values of two bands, and the spans in which they were shown.

    `colours`: red, green, blue, 0 to 1, shape (visible, thermal, 3), over both display ranges;
    `spans`: values shown as 0 and 1, of the first and the second band. A fixed table gives a
    material one colour over a sequence.
    """

    colours: Image
    spans: tuple[Span, Span]

    __repr__ = short_repr

    def save(self, path: Path) -> None:
        """Write an .npz of `colours` and `spans`."""
        np.savez_compressed(path, colours=self.colours, spans=np.array(self.spans))

    @classmethod
    def load(cls, path: Path) -> "ColourTable":
        """Read what `save` has written; anything else is BadInput."""
        try:
            with np.load(path) as file:
                colours, spans = (
                    np.asarray(file["colours"], np.float32),
                    np.asarray(file["spans"], float),
                )
            (a, b), (c, d) = spans
        except (OSError, ValueError, KeyError) as error:
            raise BadInput(
                f"a colour table must be an .npz of colours and spans, got {path}: {error}"
            ) from None
        if colours.ndim != 3 or colours.shape[2] != 3:
            raise BadInput(
                f"colours of a table must have the shape (visible, thermal, 3), got {colours.shape}"
            )
        return cls(colours=colours, spans=((float(a), float(b)), (float(c), float(d))))


def make_colour_table(
    bands: Sequence[Band],
    materials: NDArray[np.integer],
    colours: Mapping[int, tuple[float, float, float]],
) -> ColourTable:
    """Return the mean daylight colour of all pixels of a scene that have a pair of values.

    `bands`: visible and thermal frame of the scene; `materials`: number of the material of each
    pixel, (row, col), as in the truth of a simulated scene; `colours`: daylight colour (red, green,
    blue, 0 to 1) by that number, other pixels are left out. Sizes that differ, and no pixel with a
    colour, are BadInput.

    M. A. Hogervorst, A. Toet, Information Fusion 11 (2010) 69. Pairs that the scene does not have
    take the colour of the nearest one, and the table is smoothed, so that noise does not switch
    colours.
    """
    if len(bands) != 2 or materials.shape != bands[0].image.shape:
        got = f"{len(bands)} and {materials.shape}"
        raise BadInput(f"a colour table needs two bands and materials of their size, got {got}")
    planes = display_planes(bands, bloom=True)
    table_index = [
        np.clip(restored * SIZE, 0, SIZE - 1).astype(int) for restored in restore_bands(planes)[0]
    ]
    known = np.isin(materials, list(colours))
    if not known.any():
        raise BadInput(f"a colour table needs pixels of the materials {sorted(colours)}, got none")
    cell = (table_index[0] * SIZE + table_index[1])[known]
    count = np.bincount(cell, minlength=SIZE**2).reshape(SIZE, SIZE)
    numbers = np.unique(materials)
    paint = np.array([colours.get(int(number), (0.0, 0.0, 0.0)) for number in numbers])
    pixel_colour = paint[np.searchsorted(numbers, materials[known])]
    sums = np.stack(
        [np.bincount(cell, pixel_colour[:, k], SIZE**2).reshape(SIZE, SIZE) for k in range(3)],
        axis=-1,
    )
    nearest = distance_transform_edt(count == 0, return_distances=False, return_indices=True)
    table = (sums / np.maximum(count, 1)[..., None])[tuple(np.asarray(nearest))]
    table = cv2.GaussianBlur(
        table.astype(np.float32), (0, 0), SMOOTH, borderType=cv2.BORDER_REPLICATE
    )
    return ColourTable(colours=table, spans=(planes[0].span, planes[1].span))


def fuse_by_table(bands: Sequence[Band], table: ColourTable, *, uncertainty: bool = True) -> Fused:
    """Fuse two bands into the colours of a table; each band is restored as in `fuse_colour`.

    The standard deviation is that of the table's colours over the median noise of both bands,
    around the noisy value: up to twice the spread of repeated frames. The share of a band is that
    of its slope in the table.
    """
    if len(bands) != 2:
        raise BadInput(f"a colour table is of two bands, got {len(bands)}")
    spans = {band.name: span for band, span in zip(bands, table.spans, strict=True)}
    planes = display_planes(bands, bloom=True, spans=spans)
    restored, weights, finest = restore_bands(planes)
    sizes = table.colours.shape[:2]
    table_index = [
        np.clip(own * size - 0.5, 0.0, size - 1.0)
        for own, size in zip(restored, sizes, strict=True)
    ]
    picture = _look_up(table.colours, table_index)
    spread = None
    if uncertainty:
        own = zip(deviations(planes, weights), sizes, strict=True)
        rows, cols = (max(float(np.median(one)) * size, 0.1) for one, size in own)
        mean, square = (
            cv2.GaussianBlur(one, (0, 0), cols, sigmaY=rows)
            for one in (table.colours, table.colours**2)
        )
        sd = _look_up(np.sqrt(np.maximum(square - mean**2, 0.0)), table_index)
        parts = [
            np.abs(_look_up(slope, table_index)).sum(axis=-1) + 1e-6
            for slope in np.gradient(mean, axis=(0, 1))
        ]
        spread = sd, np.stack([part / sum(parts) for part in parts])
    findings, notes = find_problems(planes, finest)
    return finish("colour-table", planes, picture, spread, findings=findings, notes=notes)


def _look_up(table: Image, table_index: Sequence[Image]) -> Image:
    """Return the entries of a table at rows and columns, linearly interpolated."""
    rows, cols = (np.asarray(index, np.float32) for index in table_index)
    return cv2.remap(np.ascontiguousarray(table, np.float32), cols, rows, cv2.INTER_LINEAR)
