"""The source that blur models are fitted to: one, not too bright, with the noise around it."""

from dataclasses import replace

import numpy as np

from charact.estimators.mtf.point.nonlinearity import chance_of_less_noise
from charact.estimators.mtf.point.parametric_noise import measure_surroundings_noise
from charact.estimators.mtf.point.source import PointRefusal, detect_source
from charact.estimators.mtf.point.source_count import two_sources
from charact.estimators.mtf.point.source_pixels import SourcePixels
from charact.estimators.mtf.point.source_window import neighbour_mask, source_window
from charact.estimators.mtf.point.spot_image_matrix import Aperture
from charact.estimators.mtf.point.spot_light import SpotLight, light_of_spot
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.stack import Stack
from charact.method import Context
from charact.transfer.video_filter import VideoFilter
from labdata import FrameStack, has_tube


def locate_source(
    part: FrameStack, context: Context, *, summed_px: int = 1
) -> SourcePixels | PointRefusal:
    """Return the pixels of the one source in frames, or why they show none.

    `summed_px`: side of the squares of pixels that the frames are means of: pixels are summed where
    the source is wider than the core.
    """
    if min(part.shape[1:]) < LIMITS.min_region_px:
        min_region = f"{LIMITS.min_region_px} x {LIMITS.min_region_px} px"
        return PointRefusal(
            f"a point needs a region of at least {min_region}, got {part.shape[1:]}",
            "window-too-small",
        )
    stack = Stack.of(part, context)
    full = stack.ceiling_dn
    source = detect_source(part.data, context.pitch_ratio)
    if isinstance(source, PointRefusal):
        bright = full is not None and np.median(part.data, axis=0).max() >= full
        return (
            PointRefusal("the source is too bright: there is no background", "saturated")
            if bright
            else source
        )
    window = source_window(stack, source, context)
    height = np.maximum(window.core - np.median(window.core), 0.0)
    if height[window.keep].sum() < LIMITS.min_unclipped_light * height.sum():
        reason = "the source is too bright: pixels below full scale contain too little of its light"
        return PointRefusal(reason, "saturated")
    is_plain = not has_tube(context.camera) and summed_px == 1
    light = (
        light_of_spot(part.data, source, context.pitch_ratio, has_tube=False) if is_plain else None
    )
    noise_chance = 1.0 if light is None else chance_of_less_noise(light, full)
    spot = light
    if light is not None and (
        window.cut or not window.sound or light.has_neighbours or light.is_cut
    ):
        # The light that the forms must agree with is that of the blur alone.
        spot = None
    pair = two_sources(spot) if spot is not None else None
    if pair is not None:
        return PointRefusal(pair.reason, "several-targets")
    step = 1 if spot is None or context.interlaced else _squares_px(spot, full)
    if step > 1:
        wide = locate_source(_summed(part, step), context, summed_px=step)
        if isinstance(wide, SourcePixels):
            return replace(wide, spot=spot, noise_chance=noise_chance)
    rows = 2.0 if context.interlaced else 1.0
    return SourcePixels(
        window=window,
        aperture=Aperture(
            height_px=rows * context.pitch_ratio,
            video=VideoFilter.of(context.camera),
            summed_px=summed_px,
        ),
        dark=measure_surroundings_noise(
            part.data,
            source.row,
            source.col,
            neighbour_mask(part.shape[1:], source.neighbours, context.pitch_ratio),
        ),
        memory=stack.image_lag,
        full_scale_dn=full,
        screen=has_tube(context.camera),
        spot=spot,
        noise_chance=noise_chance,
    )


def _squares_px(spot: SpotLight, ceiling_dn: float | None) -> int:
    """Return the side of the squares of pixels whose sums show a spot in the core, px; 1 where a
    pixel of it is at the ceiling.
    """
    if ceiling_dn is not None and spot.frames[:, spot.disc].max() >= ceiling_dn:
        return 1
    return int(np.ceil(spot.extent_px / ACCURACY.max_extent_px))


def _summed(part: FrameStack, step: int) -> FrameStack:
    """Return frames whose pixels are the means of squares of pixels."""
    frames, rows, cols = part.shape[0], part.shape[1] // step, part.shape[2] // step
    data = part.data[:, : rows * step, : cols * step]
    return replace(part, data=data.reshape(frames, rows, step, cols, step).mean(axis=(2, 4)))
