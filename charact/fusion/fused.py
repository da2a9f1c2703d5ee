"""The fused picture: values, standard deviation, shares of the bands, marks, and a status."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from charact import __version__
from charact.fusion.bands import Image, Plane, Span
from charact.fusion.pyramid import (
    collapse,
    decompose,
    fill_means,
    halved,
    object_response,
    resized,
    variance_of,
)
from charact.fusion.thresholds import FUSION
from charact.verdict import Finding, judge
from labdata import Measurement, Provenance, Result, make_measurement
from labdata.short_repr import short_repr

# Bits of a pixel's mark.
MARKS = {"filled": 1, "clipped": 2, "occluded": 4, "unregistered": 8, "no-band": 16}


@dataclass(frozen=True, kw_only=True)
class Fused(Result):
    """A fused picture, with its status as measurements.

    `picture`: display values, mostly 0 to 1, shape (row, col), or (row, col, 3) in colour (red,
    green, blue); `sd`: standard deviation of its noise, same shape; `share`: share of each band in
    the contrast of an object of 3 px, shape (band, row, col), sums to 1 where a band is known;
    `marks`: bits of `MARKS`, shape (row, col); `names`, `spans`: band names, and values shown as 0
    and 1. `sd` and `share` are empty where they were not asked for.
    """

    picture: Image
    sd: Image
    share: Image
    marks: NDArray[np.uint8]
    names: tuple[str, ...]
    spans: dict[str, Span] = field(default_factory=dict)
    shown_percent: tuple[float, float] | None = None

    __repr__ = short_repr

    @property
    def codes(self) -> NDArray[np.uint8]:
        """Picture in codes of 8 bits: display values 0 to 1, or each colour between its percentiles
        `shown_percent`.
        """
        if self.shown_percent is None:
            return codes_of(self.picture)
        low, high = np.percentile(self.picture, self.shown_percent, axis=(0, 1))
        return codes_of((self.picture - low) / np.maximum(high - low, 1e-9))


def codes_of(values: NDArray) -> NDArray[np.uint8]:
    """Return display values as codes of 8 bits; values below 0 and above 1 become 0 and 255."""
    return np.clip(255.0 * values + 0.5, 0.0, 255.0).astype(np.uint8)


# Weights of a band at each detail level, finest first, and at the base: maps of any size or
# numbers.
LevelWeights = Sequence[Image | np.float32 | float]
EMPTY: Image = np.empty(0, np.float32)
# Shifts of holes, in rows and columns of the frame.
FILL_SHIFTS = [
    (down / 4.0, across / 4.0) for down in (-1, 0, 1) for across in (-1, 0, 1) if down or across
]


def level_uncertainty(
    planes: Sequence[Plane], weights: Sequence[LevelWeights]
) -> tuple[Image, Image]:
    """Return standard deviation (row, col) and shares (band, row, col) of a picture built with
    weights of each level.

    `weights`: of each band; used at the rows and columns of `FUSION.map_level`, since weights vary
    slowly.

    The variance is that of repeated frames, `pyramid.variance_of` for the noise of the light and
    without light, and of the subtracted blooming, whose error has the shape of the halo, and of the
    level filled into holes. The share of a band is |sum_l q_l w_l| over that sum of all bands, q_l
    the share of a level in an object.
    """
    shape, small = planes[0].value.shape, planes[0].map_shape
    answer = object_response(planes[0].levels)
    variance, contrast = np.zeros(small, np.float32), []
    for plane, own in zip(planes, weights, strict=True):
        maps = [resized(weight, small) for weight in own]
        light, dark = plane.powers
        shot, white = plane.gains
        variance += np.float32(dark) * variance_of(maps, white.joint)
        if light is not None:
            variance += light[0] * variance_of(maps, shot.joint)
        if plane.bloom_sd is not None:
            halo = decompose(plane.bloom_sd, plane.levels - FUSION.map_level)
            coarse = [
                resized(weight, level.shape)
                for weight, level in zip(own[FUSION.map_level :], halo, strict=True)
            ]
            variance += (
                collapse([weight * level for weight, level in zip(coarse, halo, strict=True)]) ** 2
            )
        if plane.hole is not None:
            variance += fill_variance(plane, plane.hole, maps)
        contrast.append(
            np.abs(sum(np.float32(q) * one for q, one in zip(answer, maps, strict=True)))
        )
    total = np.maximum(sum(contrast), np.float32(1e-9))
    share = np.stack([resized(one / total, shape) for one in contrast])
    return resized(np.sqrt(variance), shape), share


def fill_variance(plane: Plane, hole: NDArray[np.bool_], maps: Sequence[Image]) -> Image:
    """Return the variance that filled holes leave in a picture, shape `Plane.map_shape`.

    Holes and their weights are shifted to places where the frame is known and filled there: the
    error against the frame itself, through the levels, is a draw of the error in the hole. Its
    square is averaged over shifts by a quarter of the frame and over 7 x 7 pixels of the map. The
    noise of the frame is part of it.
    """
    frame = cv2.resize(halved(plane.value, FUSION.map_level), plane.map_shape[::-1])
    known = cv2.resize(halved((~hole).astype(np.float32), FUSION.map_level), plane.map_shape[::-1])
    rows, cols = known.shape
    total, count = np.zeros(known.shape, np.float32), np.full(known.shape, 1e-6, np.float32)
    for down, across in FILL_SHIFTS:
        shift = round(down * rows), round(across * cols)
        moved = np.roll(known, shift, (0, 1))
        error = (fill_means(frame * moved, moved) - frame) * (1.0 - moved)
        levels = decompose(error, plane.levels - FUSION.map_level)
        for level, weight in zip(levels, maps[FUSION.map_level :], strict=True):
            cv2.multiply(level, resized(np.roll(weight, shift, (0, 1)), level.shape), level)
        back = -shift[0], -shift[1]
        trusted = np.roll(known, back, (0, 1)) > 0.5
        total += np.roll(collapse(levels), back, (0, 1)) ** 2 * trusted
        count += trusted
    size = (7, 7)
    return (known < 1.0) * cv2.blur(total, size) / cv2.blur(count, size)


def pixel_uncertainty(
    planes: Sequence[Plane], weights: Sequence[Image | np.float32 | float]
) -> tuple[Image, Image]:
    """Return standard deviation and shares of a sum of bands times weights; see
    `level_uncertainty`.

    `weights`: of each band, maps of any size or numbers.
    """
    shape, small = planes[0].value.shape, planes[0].map_shape
    variance, maps = (
        np.zeros(small, np.float32),
        [np.abs(resized(weight, small)) for weight in weights],
    )
    for plane, weight in zip(planes, maps, strict=True):
        variance += weight**2 * plane.pixel_variance
    total = np.maximum(sum(maps), np.float32(1e-9))
    return resized(np.sqrt(variance), shape), np.stack(
        [resized(one / total, shape) for one in maps]
    )


def marks_of(planes: Sequence[Plane]) -> NDArray[np.uint8]:
    """Return the bits of `MARKS` of every pixel, shape (row, col)."""
    marks = np.zeros(planes[0].value.shape, np.uint8)
    for plane in planes:
        for name, mask in (
            ("clipped", plane.clipped),
            ("filled", plane.hole),
            ("occluded", plane.band.no_data),
        ):
            if mask is not None:
                marks |= mask.astype(np.uint8) * np.uint8(MARKS[name])
    holes = [plane.hole for plane in planes if plane.hole is not None]
    if len(holes) == len(planes):
        marks |= np.logical_and.reduce(holes).astype(np.uint8) * np.uint8(MARKS["no-band"])
    return marks


def finish(
    method: str,
    planes: Sequence[Plane],
    picture: Image,
    uncertainty: tuple[Image, Image] | None,
    *,
    findings: Sequence[Finding] = (),
    notes: Sequence[str] = (),
    shown_percent: tuple[float, float] | None = None,
) -> Fused:
    """Return the fused picture with its measurements: median noise, filled area, and median share
    of each band.

    `uncertainty`: standard deviation and shares of the picture, see `level_uncertainty`; None: not
    asked for.
    """
    sd, share = uncertainty or (EMPTY, EMPTY)
    flags = tuple(dict.fromkeys(flag for plane in planes for flag in plane.band.flags))
    remarks = tuple(dict.fromkeys((*(n for plane in planes for n in plane.band.notes), *notes)))
    spans = {plane.band.name: plane.span for plane in planes}
    provenance = Provenance(
        version=__version__, settings={"spans": {name: list(one) for name, one in spans.items()}}
    )

    def measured(quantity: str, value: float, **fields: str) -> Measurement:
        number = make_measurement(
            quantity,
            "1",
            value,
            None,
            None,
            method=method,
            flags=flags,
            notes=remarks,
            provenance=provenance,
            **fields,
        )
        return judge(number, findings)

    marks = marks_of(planes)
    filled = float(np.count_nonzero(marks & MARKS["filled"])) / marks.size
    rows = [measured("fused_filled_area", filled)]
    if sd.size:
        rows.insert(0, measured("fused_noise", float(np.median(sd[::8, ::8]))))
    if share.size:
        rows += [
            measured("fused_share", float(np.median(own[::8, ::8])), stack=plane.band.name)
            for plane, own in zip(planes, share, strict=True)
        ]
    return Fused(
        measurements=tuple(rows),
        picture=picture,
        sd=sd,
        share=share,
        marks=marks,
        names=tuple(spans),
        spans=spans,
        shown_percent=shown_percent,
    )
