"""Fused pictures of bands by a named method, and of a sequence frame by frame.

Frames of several stacks are paired by time, filtered, and fused one by one with held spans.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, repeat
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from charact.frames.noise_law import NoiseLaw
from charact.fusion.alignment import crop_band, move_band, place_source
from charact.fusion.bands import Band, Image, Span, display_planes
from charact.fusion.checks import noise_finding, registration_finding
from charact.fusion.fused import MARKS, Fused
from charact.fusion.geometry import Placement
from charact.fusion.noise_law import LEAST_FRAMES
from charact.fusion.sources import Source, band_of
from charact.fusion.thresholds import FILTER, FUSION
from charact.method import choose
from charact.method.descriptions import DESCRIPTIONS
from charact.verdict import judge
from labdata.errors import BadInput

# Methods with a colour picture, and those that check noise law and blooming themselves.
COLOURED, AWARE = ("noise-aware-colour", "opponent"), ("noise-aware", "noise-aware-colour")
# Pairs of frames, evenly spaced, whose spans are averaged by their median.
SPAN_FRAMES = 8


def fuse(
    bands: Sequence[Band],
    *,
    method: str = "auto",
    colour: bool = False,
    spans: Mapping[str, Span] | None = None,
    registered: bool = False,
    within_percent: float = FUSION.tolerance_percent,
) -> Fused:
    """Fuse two bands or more of one size into one picture with uncertainty, shares and marks.

    Parameters
    ----------
    bands
        Bands on one grid, the intensified one first.
    method
        A registered method of kind "fusion"; "auto": the quickest one of the accuracy chart whose
        restoration error meets `within_percent` of the truth's spread, otherwise the most accurate
        one, grey or, with `colour`, coloured.
    spans
        Values shown as 0 and 1, by the name of the band; None: from the frames.
    registered
        Whether the bands are known to be in register; otherwise their shift is measured.

    Raises
    ------
    BadInput
        If bands differ in shape, hold values that are not finite or are shifted by more than 2 px,
        or the method is unknown.
    """
    pictures = fuse_all(
        bands,
        (method,),
        colour=colour,
        spans=spans,
        registered=registered,
        within_percent=within_percent,
    )
    return next(iter(pictures.values()))


def fuse_all(
    bands: Sequence[Band],
    methods: Sequence[str],
    *,
    colour: bool = False,
    spans: Mapping[str, Span] | None = None,
    registered: bool = False,
    within_percent: float = FUSION.tolerance_percent,
) -> dict[str, Fused]:
    """Return the pictures of several methods by their names; the shift is measured once. See
    `fuse`.
    """
    if colour and (grey := [name for name in methods if name not in ("auto", *COLOURED)]):
        raise BadInput(
            f"colour needs the method auto or one of {', '.join(COLOURED)}, got {grey[0]!r}"
        )
    among = (
        COLOURED if colour else [name for name in DESCRIPTIONS["fusion"] if name not in COLOURED]
    )
    chosen = [
        choose("fusion", name, within_percent=within_percent, among=among) for name in methods
    ]
    planes = display_planes(bands, bloom=True, spans=spans)
    shift, notes = (None, ()) if registered else registration_finding(planes)
    # Every method states a standard deviation by the noise law.
    noise = (
        [noise_finding(plane) for plane in planes]
        if any(method.name not in AWARE for method in chosen)
        else []
    )
    pictures = {}
    for method in chosen:
        fused = method.function(bands, spans=spans)
        assert isinstance(fused, Fused)
        findings = [
            finding for finding in (shift, *(() if method.name in AWARE else noise)) if finding
        ]
        rows = tuple(
            judge(row.with_(notes=(*row.notes, *notes)), findings) for row in fused.measurements
        )
        marks = fused.marks | np.uint8(MARKS["unregistered"]) if shift else fused.marks
        pictures[method.name] = replace(fused, measurements=rows, marks=marks)
    return pictures


def pair_frames(sources: Sequence[Source]) -> tuple[list[tuple[int, ...]], tuple[str, ...]]:
    """Return numbers of frames that belong together, one of each source, and notes.

    Each frame of the first source goes with the frame nearest in time of every other; frames of the
    first that are farther from all of another than half of its frame interval are left out. Without
    time stamps frames go by their number. No frames that agree in time, or stacks of unlike length
    without time stamps, are BadInput.
    """
    first, *other_sources = sources
    count = len(first.stack)
    if any(source.stack.time_s.size == 0 for source in sources):
        if any(len(source.stack) != count for source in other_sources):
            lengths = " and ".join(f"{len(source.stack)} of {source.name}" for source in sources)
            raise BadInput(
                f"stacks without time stamps must have equally many frames, got {lengths}"
            )
        return [(i,) * len(sources) for i in range(count)], (
            "frames were paired by their number: no time stamps",
        )
    columns, paired = [np.arange(count)], np.ones(count, bool)
    largest_s = 0.0
    for other in other_sources:
        time_s, first_time_s = other.stack.time_s, first.stack.time_s
        nearest = np.abs(time_s[None, :] - first_time_s[:, None]).argmin(axis=1)
        interval_s = np.abs(time_s[nearest] - first_time_s)
        steps = [
            float(np.median(np.diff(times))) for times in (time_s, first_time_s) if times.size > 1
        ]
        paired &= interval_s <= 0.5 * max(steps, default=np.inf) * 1.01
        columns.append(nearest)
        largest_s = max(largest_s, float(interval_s[paired].max(initial=0.0)))
    if not paired.any():
        raise BadInput(
            "frames must be taken at the same time, got no pair within half a frame interval"
        )
    notes = [f"frames were paired by time, at most {1e3 * largest_s:.3g} ms apart"]
    if not paired.all():
        notes.append(
            f"{np.count_nonzero(~paired)} of {count} frames of {first.name} have no partner and "
            f"were left out"
        )
    return [tuple(int(column[i]) for column in columns) for i in np.flatnonzero(paired)], tuple(
        notes
    )


def held_spans(
    bands: Callable[[tuple[int, ...]], list[Band]], pairs: Sequence[tuple[int, ...]]
) -> dict[str, Span]:
    """Return one display span of each band for a sequence: medians over frames, so that brightness
    does not flicker.
    """
    sampled_pairs = [
        pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, SPAN_FRAMES).astype(int))
    ]
    spans = [
        {plane.band.name: plane.span for plane in display_planes(bands(pair), bloom=True)}
        for pair in sampled_pairs
    ]
    return {
        name: (
            float(np.median([spans_of_pair[name][0] for spans_of_pair in spans])),
            float(np.median([spans_of_pair[name][1] for spans_of_pair in spans])),
        )
        for name in spans[0]
    }


def fuse_sequence(
    sources: Sequence[Source],
    pairs: Sequence[tuple[int, ...]],
    *,
    method: str = "auto",
    colour: bool = False,
    spans: dict[str, Span] | None = None,
    places: Sequence[Placement | None],
    region: tuple[int, int, int, int] | None = None,
    distance_m: float | None = None,
    recursive: float | None = None,
    bloom: bool = True,
    seed: int = 0,
    within_percent: float = FUSION.tolerance_percent,
) -> Iterator[Fused]:
    """Yield the fused picture of each pair of frames, all with one span.

    `places`: place of each band's pixels in a still scene, see
    `charact.fusion.alignment.align_bands`; if frames have poses and ranges of their own, those are
    used, without a measured shift. `region`: ROW, COL, HEIGHT, WIDTH to which pictures are cut.
    `recursive`: gain of `reduce_noise`, which filters each band before the fusion; None: none.
    """
    moving = any(source.is_moving for source in sources)

    def read(number: int, pair: tuple[int, ...]) -> Band:
        return band_of(sources[number], pair[number], bloom=bloom, seed=seed)

    def place(bands: Sequence[Band], pair: tuple[int, ...]) -> list[Band]:
        placements = places
        if moving:
            posed = [source.at_frame(frame) for source, frame in zip(sources, pair, strict=True)]
            placements = [
                None,
                *(place_source(posed[0], other, distance_m)[0] for other in posed[1:]),
            ]
        placed = [
            band if placement is None else move_band(band, placement)
            for band, placement in zip(bands, placements, strict=True)
        ]
        return placed if region is None else [crop_band(band, region) for band in placed]

    count = range(len(sources))
    spans = held_spans(lambda pair: place([read(k, pair) for k in count], pair), pairs) | (
        spans or {}
    )
    streams = [map(read, repeat(number), pairs) for number in count]
    if recursive is not None:
        streams = [filter_bands(stream, recursive) for stream in streams]
    for pair, *bands in zip(pairs, *streams, strict=True):
        yield fuse(
            place(bands, pair),
            method=method,
            colour=colour,
            spans=spans,
            registered=True,
            within_percent=within_percent,
        )


def filter_bands(bands: Iterator[Band], gain: float) -> Iterator[Band]:
    """Yield the bands of a sequence filtered in time, with the noise that is left."""
    first = next(bands)
    if first.noise is None or not first.noise.is_known:
        needed = f"{LEAST_FRAMES} frames or more, or a description of the camera"
        raise BadInput(f"recursive needs the noise of {first.name}: {needed}")
    waiting: list[Band] = []

    def images() -> Iterator[NDArray[Any]]:
        for band in chain([first], bands):
            waiting.append(band)
            yield band.image

    for image in reduce_noise(images(), first.noise, gain=gain):
        band = waiting.pop()
        yield replace(band, image=image, noise=filtered_law(band.noise or first.noise, gain))


def reduce_noise(
    frames: Iterable[NDArray], law: NoiseLaw, *, gain: float = 0.2, motion: bool = True
) -> Iterator[Image]:
    """Yield filtered frames: each pixel is a running mean that starts again where something moves.

    `frames`: registered frames above dark in the order of time, each (row, col), in the unit of the
    noise law of one frame; `gain`: share g of the newest frame, above 0 to 1; `motion`: whether the
    mean starts again where something moves. Another gain, and frames of unlike size, are BadInput.

    Notes
    -----
    y_t = y_(t-1) + g_t (x_t - y_(t-1)). The first frames have g_t = 1/t until that is g, so that
    the variance falls from the start to g/(2 - g) of one frame's, see `variance_ratio`. The filter
    is linear in the light: its mean is unbiased whatever the law of the pulse heights, so that no
    variance-stabilising transform has to be inverted. The gate raises g_t up to 1 around places
    where the difference x_t - y_(t-1), between Gaussians of the size of an object and of its
    surroundings, exceeds several times its standard deviation by the noise law at the local mean.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> frames = rng.normal(5.0, 1.0, (40, 64, 64))
    >>> *_, last = reduce_noise(frames, NoiseLaw(gain_dn=0.0, read_dn=1.0), gain=0.2)
    >>> round(float(last.var()), 2)
    0.12
    """
    if not 0.0 < gain <= 1.0:
        raise BadInput(
            f"the gain of the recursive filter must be above 0 and at most 1, got {gain:g}"
        )
    mean: Image | None = None
    number = np.zeros(0, np.float32)  # frames in the mean of each pixel
    for frame in frames:
        image = np.asarray(frame, np.float32)
        if mean is None:
            mean, number = image.copy(), np.ones(image.shape, np.float32)
        elif image.shape != mean.shape:
            raise BadInput(
                f"filtered frames must have one size, got {mean.shape} and {image.shape}"
            )
        else:
            number += 1.0
            if motion:
                number = 1.0 + (number - 1.0) * (
                    1.0 - motion_of(image, mean, law, number, variance_ratio(gain))
                )
            mean = mean + np.maximum(1.0 / number, np.float32(gain)) * (image - mean)
        yield mean


def motion_of(image: Image, mean: Image, law: NoiseLaw, number: Image, settled: float) -> Image:
    """Return how surely a frame differs from the mean of earlier ones by more than noise, 0 to 1,
    shape (row, col).

    `number`: frames in the mean including this one, shape (row, col); `settled`: variance of a mean
    of many frames over that of one.
    """
    difference = image - mean
    small, large = (cv2.GaussianBlur(difference, (0, 0), sigma) for sigma in FILTER.scales_px)
    light = np.maximum(cv2.GaussianBlur(mean, (0, 0), FILTER.scales_px[1]), np.float32(0.0))
    power = law.gain_dn * light * band_variance(law.blur_px) + law.read_dn**2 * band_variance(0.0)
    # The mean of n - 1 earlier frames has noise of its own.
    variance_factor = 1.0 + np.maximum(1.0 / np.maximum(number - 1.0, 1.0), np.float32(settled))
    deviation = np.abs(small - large) / np.sqrt(variance_factor * power + 1e-12)
    low, high = FILTER.gate_sd
    motion = np.clip((deviation - low) / (high - low), 0.0, 1.0).astype(np.float32)
    side = 2 * FILTER.reach_px + 1
    return cv2.dilate(motion, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))


def band_variance(blur_px: float) -> float:
    """Return the variance of the difference of two Gaussians of noise of power 1, white before a
    blur.

    1/(4 pi) (1/s1^2 + 1/s2^2 - 4/(s1^2 + s2^2)), s the width of a Gaussian and the blur together.
    """
    first, second = (sigma**2 + blur_px**2 for sigma in FILTER.scales_px)
    return (1.0 / first + 1.0 / second - 4.0 / (first + second)) / (4.0 * np.pi)


def variance_ratio(gain: float, correlation: float = 0.0) -> float:
    """Return the noise variance of a filtered frame over that of one frame.

    It is g/(2 - g) (1 + r (1 - g))/(1 - r (1 - g)) for noise whose correlation from frame to frame
    is r, r^2, ... as of image lag; r = 0: g/(2 - g).
    """
    memory = correlation * (1.0 - gain)
    return gain / (2.0 - gain) * (1.0 + memory) / (1.0 - memory)


def filtered_law(law: NoiseLaw, gain: float, correlation: float = 0.0) -> NoiseLaw:
    """Return the noise law of filtered frames of a static scene, for
    `charact.fusion.bands.Band`.
    """
    return law.scaled(variance_ratio(gain, correlation))
