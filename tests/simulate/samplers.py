"""Frames of a static scene by each way to draw them."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from labdata import Conditions
from simulate.camera import CameraModel, StageImage

Sampler = Literal["chain", "fast", "normal"]
SAMPLERS: tuple[Sampler, ...] = ("chain", "fast", "normal")


def drawn_by(
    sampler: Sampler,
    camera: CameraModel,
    light: StageImage,
    conditions: Conditions,
    *,
    seed: int,
    **more: Any,
) -> Iterator[np.ndarray]:
    """Yield frames stage by stage, by the fast sampler, or by it with a normal law of sums."""
    if sampler == "chain":
        return camera.chain_frames(light, conditions, seed=seed, **more)
    if sampler == "normal":
        camera = replace(camera, left_out=camera.left_out | {"pulse-height distribution"})
    return camera.frames(light, conditions, seed=seed, **more)
